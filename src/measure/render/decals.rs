//! What is on the skin: markers, and the clutter that a detector must not take for them.
//!
//! Reflectance 0 to 1 over material coordinates. Clutter is averaged over the pixel's footprint in
//! closed form; markers are left to the sampling in [`super::picture`].

use super::random::{Random, value_noise};
use super::wing::Wing;

/// Size of a pixel on the skin, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Along s.
    pub s: f64,
    /// Across.
    pub z: f64,
}

/// A small thing at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spot {
    s: f64,
    z: f64,
    reach_s: f64,
    reach_z: f64,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Dark ring of an access cover: radius and width, m; darkness.
    Ring { radius: f64, width: f64, depth: f64 },
    /// Block of lettering, filling its reach; darkness.
    Block { depth: f64 },
    /// Dirt, a soft ellipse; darkness.
    Blob { depth: f64 },
}

/// Everything but the markers.
#[derive(Clone, Debug, PartialEq)]
pub struct Clutter {
    seed: u64,
    base: f64,
    mottle: f64,
    ribs_m: Vec<f64>,
    stringers: Vec<f64>,
    line_m: f64,
    line_depth: f64,
    spots: Vec<Spot>,
}

impl Clutter {
    /// Clutter for a wing; `density` 1 is a usual one.
    pub fn random(random: &mut Random, wing: &Wing, density: f64) -> Self {
        let length = wing.beam.length_m;
        let mut ribs_m = Vec::new();
        let mut s = random.between(1.0, 3.0);
        while s < length {
            ribs_m.push(s);
            s += random.between(1.6, 3.6);
        }
        let count = random.integer(3, 5);
        let stringers = (0..count).map(|i| (i as f64 + random.between(0.2, 0.8)) / count as f64).collect();
        let mut clutter = Self {
            seed: random.bits(),
            base: random.between(0.34, 0.56),
            mottle: random.between(0.02, 0.06),
            ribs_m,
            stringers,
            line_m: random.between(0.004, 0.010),
            line_depth: random.between(0.15, 0.4),
            spots: Vec::new(),
        };
        let many = |random: &mut Random, low: f64, high: f64| (random.between(low, high) * density) as usize;
        for _ in 0..many(random, 5.0, 10.0) {
            clutter.cover(random, wing);
        }
        for _ in 0..many(random, 3.0, 7.0) {
            clutter.lettering(random, wing);
        }
        for _ in 0..many(random, 8.0, 18.0) {
            clutter.dirt(random, wing);
        }
        clutter
    }

    /// Even paint and nothing on it.
    #[cfg(test)]
    pub(super) fn bare(base: f64) -> Self {
        let (ribs_m, stringers, spots) = (Vec::new(), Vec::new(), Vec::new());
        Self { seed: 0, base, mottle: 0.0, ribs_m, stringers, line_m: 0.0, line_depth: 0.0, spots }
    }

    fn place(random: &mut Random, wing: &Wing) -> (f64, f64) {
        // Near the fuselage more is seen.
        let s = 4.0 + (wing.beam.length_m - 5.0) * random.unit().powf(1.5);
        let (low, high) = wing.edges(s);
        (s, random.between(0.85 * low, 0.85 * high))
    }

    fn cover(&mut self, random: &mut Random, wing: &Wing) {
        let (s, z) = Self::place(random, wing);
        let radius = random.between(0.07, 0.22);
        let width = random.between(0.006, 0.02);
        let kind = Kind::Ring { radius, width, depth: random.between(0.2, 0.6) };
        let reach = radius + width;
        self.spots.push(Spot { s, z, reach_s: reach, reach_z: reach, kind });
    }

    fn lettering(&mut self, random: &mut Random, wing: &Wing) {
        let (s, z) = Self::place(random, wing);
        let (height, width) = (random.between(0.05, 0.14), random.between(0.02, 0.06));
        let depth = random.between(0.4, 0.8);
        for i in 0..random.integer(4, 9) {
            for (along, across, reach_s, reach_z) in [
                (0.0, 0.0, 0.5 * height, 0.12 * width),
                (random.between(-0.5, 0.5) * height, 0.3 * width, 0.1 * height, 0.4 * width),
                (random.between(-0.5, 0.5) * height, 0.3 * width, 0.1 * height, 0.4 * width),
            ] {
                let z = z + 1.5 * width * i as f64 + across;
                self.spots.push(Spot { s: s + along, z, reach_s, reach_z, kind: Kind::Block { depth } });
            }
        }
    }

    fn dirt(&mut self, random: &mut Random, wing: &Wing) {
        let (s, z) = Self::place(random, wing);
        let streak = random.unit() < 0.35;
        let reach_s = random.between(0.05, 0.5);
        let reach_z = if streak { random.between(0.8, 2.0) } else { random.between(0.05, 0.4) };
        let kind = Kind::Blob { depth: random.between(0.05, 0.45) };
        self.spots.push(Spot { s, z, reach_s, reach_z, kind });
    }

    /// Reflectance of the bare paint with its slow changes.
    pub fn paint(&self, s: f64, z: f64) -> f64 {
        let slow = value_noise(s / 2.3, z / 1.1, self.seed);
        let fine = value_noise(s / 0.5, z / 0.3, self.seed ^ 0x55);
        self.base * (1.0 + self.mottle * (slow + 0.4 * fine))
    }

    /// What may touch a patch of skin.
    pub fn near(&self, wing: &Wing, s: (f64, f64), z: (f64, f64), footprint: &Footprint) -> Near {
        let reaches = |spot: &Spot| {
            let soft = if matches!(spot.kind, Kind::Blob { .. }) { 3.0 } else { 1.2 };
            let (ds, dz) = (soft * spot.reach_s, soft * spot.reach_z);
            spot.s + ds > s.0 && spot.s - ds < s.1 && spot.z + dz > z.0 && spot.z - dz < z.1
        };
        let wide = self.line_m + footprint.s;
        let rib = |rib: &&f64| **rib > s.0 - wide && **rib < s.1 + wide;
        let (low, high) = wing.edges(0.5 * (s.0 + s.1));
        let chord = high - low;
        // Taper within the patch is covered by a margin.
        let wide = (self.line_m + footprint.z + 0.3 * (s.1 - s.0)) / chord;
        let (from, to) = ((z.0 - low) / chord - wide, (z.1 - low) / chord + wide);
        let stringer = |place: &&f64| **place > from && **place < to;
        Near {
            ribs_m: self.ribs_m.iter().filter(rib).copied().collect(),
            stringers: self.stringers.iter().filter(stringer).copied().collect(),
            spots: (0..self.spots.len()).filter(|&i| reaches(&self.spots[i])).collect(),
        }
    }

    /// The factor of panel lines and spots.
    pub fn factor(&self, near: &Near, wing: &Wing, s: f64, z: f64, footprint: &Footprint) -> f64 {
        self.lines(near, wing, s, z, footprint) * self.spots(&near.spots, s, z, footprint)
    }

    fn lines(&self, near: &Near, wing: &Wing, s: f64, z: f64, footprint: &Footprint) -> f64 {
        let share = |distance: f64, pixel: f64| overlap(distance, 0.5 * self.line_m, pixel);
        let mut cover = near.ribs_m.iter().map(|rib| share(s - rib, footprint.s)).fold(0.0, f64::max);
        if !near.stringers.is_empty() {
            let (low, high) = wing.edges(s);
            let place = |stringer: &f64| share(z - low - stringer * (high - low), footprint.z);
            cover = near.stringers.iter().map(place).fold(cover, f64::max);
        }
        1.0 - self.line_depth * cover
    }

    fn spots(&self, indices: &[usize], s: f64, z: f64, footprint: &Footprint) -> f64 {
        indices.iter().filter_map(|&i| self.spots.get(i)).map(|spot| spot.factor(s, z, footprint)).product()
    }
}

/// Indices and places of what a patch of skin may show.
#[derive(Clone, Debug, Default)]
pub struct Near {
    ribs_m: Vec<f64>,
    stringers: Vec<f64>,
    spots: Vec<usize>,
}

impl Spot {
    fn factor(&self, s: f64, z: f64, footprint: &Footprint) -> f64 {
        let (ds, dz) = (s - self.s, z - self.z);
        match self.kind {
            Kind::Ring { radius, width, depth } => {
                let r = ds.hypot(dz).max(1e-6);
                let pixel = ((ds * footprint.s).powi(2) + (dz * footprint.z).powi(2)).sqrt() / r;
                1.0 - depth * overlap(r - radius, 0.5 * width, pixel)
            }
            Kind::Block { depth } => {
                let share = overlap(ds, self.reach_s, footprint.s) * overlap(dz, self.reach_z, footprint.z);
                1.0 - depth * share
            }
            Kind::Blob { depth } => {
                let q = (ds / self.reach_s).powi(2) + (dz / self.reach_z).powi(2);
                1.0 - depth * (-q).exp()
            }
        }
    }
}

/// Share of a pixel of the given size, `distance` from a bar's middle, that the bar covers.
fn overlap(distance: f64, half_width: f64, pixel: f64) -> f64 {
    let half_pixel = 0.5 * pixel.max(1e-6);
    let low = (distance - half_pixel).max(-half_width);
    let high = (distance + half_pixel).min(half_width);
    (high - low).max(0.0) / (2.0 * half_pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_covers_its_share_of_a_pixel() {
        assert!((overlap(0.0, 0.5, 2.0) - 0.5).abs() < 1e-12);
        assert!((overlap(0.0, 5.0, 2.0) - 1.0).abs() < 1e-12);
        assert!((overlap(5.0, 5.0, 2.0) - 0.5).abs() < 1e-12);
        assert_eq!(overlap(7.0, 5.0, 2.0), 0.0);
    }
}
