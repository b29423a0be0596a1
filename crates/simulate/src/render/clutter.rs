//! Paint and clutter on the skin, which a detector must not take for markers.
//!
//! Reflectance 0 to 1 over material coordinates. Clutter is averaged over the pixel's footprint in closed form; markers are
//! left to the sampling in [`super::picture`].

use super::random::{SeededRandom, value_noise};
use super::wing::SceneWing;

/// Size of a pixel on the skin, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelFootprint {
    pub s: f64,
    pub z: f64,
}

/// Clutter item at a position on the skin.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ClutterSpot {
    s: f64,
    z: f64,
    reach_s: f64,
    reach_z: f64,
    kind: SpotKind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum SpotKind {
    /// Dark ring of an access cover: radius and width, m; darkness.
    Ring { radius: f64, width: f64, depth: f64 },
    /// Block of lettering, filling its reach; darkness.
    Block { depth: f64 },
    /// Dirt, a soft ellipse; darkness.
    Blob { depth: f64 },
}

/// Clutter on the skin: paint, panel lines, covers, lettering, dirt.
#[derive(Clone, Debug, PartialEq)]
pub struct SkinClutter {
    seed: u64,
    base: f64,
    mottle: f64,
    ribs_m: Vec<f64>,
    stringers: Vec<f64>,
    line_m: f64,
    line_depth: f64,
    spots: Vec<ClutterSpot>,
}

impl SkinClutter {
    /// Samples clutter for a wing; `density` 1 is typical.
    pub fn random(random: &mut SeededRandom, wing: &SceneWing, density: f64) -> Self {
        let length = wing.beam.length_m;
        let mut ribs_m = Vec::new();
        let mut s = random.uniform(1.0, 3.0);
        while s < length {
            ribs_m.push(s);
            s += random.uniform(1.6, 3.6);
        }
        let count = random.integer(3, 5);
        let stringers = (0..count)
            .map(|i| (i as f64 + random.uniform(0.2, 0.8)) / count as f64)
            .collect();
        let mut clutter = Self {
            seed: random.bits(),
            base: random.uniform(0.34, 0.56),
            mottle: random.uniform(0.02, 0.06),
            ribs_m,
            stringers,
            line_m: random.uniform(0.004, 0.010),
            line_depth: random.uniform(0.15, 0.4),
            spots: Vec::new(),
        };
        let count_of = |random: &mut SeededRandom, low: f64, high: f64| {
            (random.uniform(low, high) * density) as usize
        };
        for _ in 0..count_of(random, 5.0, 10.0) {
            clutter.add_access_cover(random, wing);
        }
        for _ in 0..count_of(random, 3.0, 7.0) {
            clutter.add_lettering(random, wing);
        }
        for _ in 0..count_of(random, 8.0, 18.0) {
            clutter.add_dirt(random, wing);
        }
        clutter
    }

    /// Creates uniform paint without clutter.
    #[cfg(test)]
    pub(super) fn bare(base: f64) -> Self {
        let (ribs_m, stringers, spots) = (Vec::new(), Vec::new(), Vec::new());
        Self {
            seed: 0,
            base,
            mottle: 0.0,
            ribs_m,
            stringers,
            line_m: 0.0,
            line_depth: 0.0,
            spots,
        }
    }

    fn random_skin_position(random: &mut SeededRandom, wing: &SceneWing) -> (f64, f64) {
        // More clutter is visible near the fuselage.
        let s = 4.0 + (wing.beam.length_m - 5.0) * random.unit().powf(1.5);
        let (low, high) = wing.edges(s);
        (s, random.uniform(0.85 * low, 0.85 * high))
    }

    fn add_access_cover(&mut self, random: &mut SeededRandom, wing: &SceneWing) {
        let (s, z) = Self::random_skin_position(random, wing);
        let radius = random.uniform(0.07, 0.22);
        let width = random.uniform(0.006, 0.02);
        let kind = SpotKind::Ring {
            radius,
            width,
            depth: random.uniform(0.2, 0.6),
        };
        let reach = radius + width;
        self.spots.push(ClutterSpot {
            s,
            z,
            reach_s: reach,
            reach_z: reach,
            kind,
        });
    }

    fn add_lettering(&mut self, random: &mut SeededRandom, wing: &SceneWing) {
        let (s, z) = Self::random_skin_position(random, wing);
        let (height, width) = (random.uniform(0.05, 0.14), random.uniform(0.02, 0.06));
        let depth = random.uniform(0.4, 0.8);
        for i in 0..random.integer(4, 9) {
            for (along, across, reach_s, reach_z) in [
                (0.0, 0.0, 0.5 * height, 0.12 * width),
                (
                    random.uniform(-0.5, 0.5) * height,
                    0.3 * width,
                    0.1 * height,
                    0.4 * width,
                ),
                (
                    random.uniform(-0.5, 0.5) * height,
                    0.3 * width,
                    0.1 * height,
                    0.4 * width,
                ),
            ] {
                let z = z + 1.5 * width * i as f64 + across;
                self.spots.push(ClutterSpot {
                    s: s + along,
                    z,
                    reach_s,
                    reach_z,
                    kind: SpotKind::Block { depth },
                });
            }
        }
    }

    fn add_dirt(&mut self, random: &mut SeededRandom, wing: &SceneWing) {
        let (s, z) = Self::random_skin_position(random, wing);
        let streak = random.unit() < 0.35;
        let reach_s = random.uniform(0.05, 0.5);
        let reach_z = if streak {
            random.uniform(0.8, 2.0)
        } else {
            random.uniform(0.05, 0.4)
        };
        let kind = SpotKind::Blob {
            depth: random.uniform(0.05, 0.45),
        };
        self.spots.push(ClutterSpot {
            s,
            z,
            reach_s,
            reach_z,
            kind,
        });
    }

    /// Adds a salient structure at a position, one of four kinds in turn: the end of a gap between panels, the corner of a
    /// flap, a letter, crossing rows of fasteners.
    pub(super) fn add_structure(&mut self, random: &mut SeededRandom, kind: usize, s: f64, z: f64) {
        let gap = random.uniform(0.02, 0.05);
        let arm = |random: &mut SeededRandom| random.uniform(0.25, 0.6);
        let (along, across) = (arm(random), arm(random));
        let depth = random.uniform(0.25, 0.6);
        let mut block = |ds: f64, dz: f64, reach_s: f64, reach_z: f64| {
            self.spots.push(ClutterSpot {
                s: s + ds,
                z: z + dz,
                reach_s,
                reach_z,
                kind: SpotKind::Block { depth },
            });
        };
        match kind % 4 {
            0 => {
                block(along, 0.0, along, 0.3 * gap);
                block(-0.5 * gap, 0.0, 0.5 * gap, across);
            }
            1 => {
                block(along, -0.5 * gap, along, 0.5 * gap);
                block(-gap, across - gap, gap, across);
            }
            2 => {
                block(0.25, 0.0, 0.25, gap);
                block(0.45, 2.0 * gap, 0.05, 2.0 * gap);
                block(0.2, 1.5 * gap, 0.05, 1.5 * gap);
            }
            _ => (-7_i8..=7).for_each(|k| {
                block(0.0, 0.06 * f64::from(k), 0.02, 0.008);
                block(0.1 * f64::from(k), 0.0, 0.02, 0.008);
            }),
        }
    }

    /// Returns the reflectance of the paint with its slow variation.
    pub fn paint_reflectance(&self, s: f64, z: f64) -> f64 {
        let slow = value_noise(s / 2.3, z / 1.1, self.seed);
        let fine = value_noise(s / 0.5, z / 0.3, self.seed ^ 0x55);
        self.base * (1.0 + self.mottle * (slow + 0.4 * fine))
    }

    /// Selects the clutter that may touch a patch of skin.
    pub fn select_nearby(
        &self,
        wing: &SceneWing,
        s: (f64, f64),
        z: (f64, f64),
        footprint: &PixelFootprint,
    ) -> NearbyClutter {
        let reaches = |spot: &ClutterSpot| {
            let soft = if matches!(spot.kind, SpotKind::Blob { .. }) {
                3.0
            } else {
                1.2
            };
            let (ds, dz) = (soft * spot.reach_s, soft * spot.reach_z);
            spot.s + ds > s.0 && spot.s - ds < s.1 && spot.z + dz > z.0 && spot.z - dz < z.1
        };
        let wide = self.line_m + footprint.s;
        let rib = |rib: &&f64| **rib > s.0 - wide && **rib < s.1 + wide;
        let (low, high) = wing.edges(0.5 * (s.0 + s.1));
        let chord = high - low;
        // A margin allows for taper within the patch.
        let wide = (self.line_m + footprint.z + 0.3 * (s.1 - s.0)) / chord;
        let (from, to) = ((z.0 - low) / chord - wide, (z.1 - low) / chord + wide);
        let stringer = |place: &&f64| **place > from && **place < to;
        NearbyClutter {
            ribs_m: self.ribs_m.iter().filter(rib).copied().collect(),
            stringers: self.stringers.iter().filter(stringer).copied().collect(),
            spots: (0..self.spots.len())
                .filter(|&i| reaches(&self.spots[i]))
                .collect(),
        }
    }

    /// Returns the factor of panel lines and spots on the reflectance.
    pub fn reflectance_factor(
        &self,
        near: &NearbyClutter,
        wing: &SceneWing,
        s: f64,
        z: f64,
        footprint: &PixelFootprint,
    ) -> f64 {
        self.line_factor(near, wing, s, z, footprint)
            * self.spot_factor(&near.spots, s, z, footprint)
    }

    /// Returns the factor by which ribs and stringers darken the paint seen by a pixel.
    fn line_factor(
        &self,
        near: &NearbyClutter,
        wing: &SceneWing,
        s: f64,
        z: f64,
        footprint: &PixelFootprint,
    ) -> f64 {
        let covered = |distance: f64, pixel: f64| bar_overlap(distance, 0.5 * self.line_m, pixel);
        let mut cover = near
            .ribs_m
            .iter()
            .map(|rib| covered(s - rib, footprint.s))
            .fold(0.0, f64::max);
        if !near.stringers.is_empty() {
            let (low, high) = wing.edges(s);
            let place = |stringer: &f64| covered(z - low - stringer * (high - low), footprint.z);
            cover = near.stringers.iter().map(place).fold(cover, f64::max);
        }
        1.0 - self.line_depth * cover
    }

    fn spot_factor(&self, indices: &[usize], s: f64, z: f64, footprint: &PixelFootprint) -> f64 {
        indices
            .iter()
            .filter_map(|&i| self.spots.get(i))
            .map(|spot| spot.spot_reflectance(s, z, footprint))
            .product()
    }
}

/// Clutter that a patch of skin may show.
#[derive(Clone, Debug, Default)]
pub struct NearbyClutter {
    ribs_m: Vec<f64>,
    stringers: Vec<f64>,
    spots: Vec<usize>,
}

impl ClutterSpot {
    fn spot_reflectance(&self, s: f64, z: f64, footprint: &PixelFootprint) -> f64 {
        let (ds, dz) = (s - self.s, z - self.z);
        match self.kind {
            SpotKind::Ring {
                radius,
                width,
                depth,
            } => {
                let r = ds.hypot(dz).max(1e-6);
                let pixel = ((ds * footprint.s).powi(2) + (dz * footprint.z).powi(2)).sqrt() / r;
                1.0 - depth * bar_overlap(r - radius, 0.5 * width, pixel)
            }
            SpotKind::Block { depth } => {
                let covered = bar_overlap(ds, self.reach_s, footprint.s)
                    * bar_overlap(dz, self.reach_z, footprint.z);
                1.0 - depth * covered
            }
            SpotKind::Blob { depth } => {
                let q = (ds / self.reach_s).powi(2) + (dz / self.reach_z).powi(2);
                1.0 - depth * (-q).exp()
            }
        }
    }
}

/// Returns the fraction of a pixel that a bar covers; `distance` between their centres.
fn bar_overlap(distance: f64, half_width: f64, pixel: f64) -> f64 {
    let half_pixel = 0.5 * pixel.max(1e-6);
    let low = (distance - half_pixel).max(-half_width);
    let high = (distance + half_pixel).min(half_width);
    (high - low).max(0.0) / (2.0 * half_pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_covers_its_fraction_of_a_pixel() {
        assert!((bar_overlap(0.0, 0.5, 2.0) - 0.5).abs() < 1e-12);
        assert!((bar_overlap(0.0, 5.0, 2.0) - 1.0).abs() < 1e-12);
        assert!((bar_overlap(5.0, 5.0, 2.0) - 0.5).abs() < 1e-12);
        assert_eq!(bar_overlap(7.0, 5.0, 2.0), 0.0);
    }
}
