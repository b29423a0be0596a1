//! Intersection of rays with the skin.

use nalgebra::Vector3;

use super::wing::DeformedWing;

/// A point of the skin, material coordinates, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub s: f64,
    pub z: f64,
}

/// Step of the first search along the wing; a narrower crest may be missed.
const SEARCH_STEP_M: f64 = 0.6;
const BISECTIONS: usize = 40;
/// Height above the skin at which a ray has hit it, m.
const HIT_GAP_M: f64 = 1e-12;

impl DeformedWing {
    /// Returns the first point of the skin on a ray from the origin, so that parts behind crests are hidden; `None` if the
    /// ray misses the wing.
    pub fn first_hit(&self, direction: &Vector3<f64>) -> Option<Hit> {
        let length = self.wing.beam.length_m;
        let steps = (length / SEARCH_STEP_M).ceil() as usize;
        let (mut before, mut gap_before) = (0.0, self.signed_gap(0.0, direction));
        for i in 1..=steps {
            let s = length * i as f64 / steps as f64;
            let gap = self.signed_gap(s, direction);
            if gap <= 0.0 {
                if gap_before > 0.0 {
                    let hit = self.refine_hit([before, s], [gap_before, gap], direction);
                    if self.is_between_edges(&hit) {
                        return Some(hit);
                    }
                }
                // The ray enters from the side, through an edge.
                if self.is_inside(s, direction) {
                    return Some(
                        self.bisect(before, s, direction, |s| self.is_inside(s, direction)),
                    );
                }
            }
            (before, gap_before) = (s, gap);
        }
        None
    }

    /// Returns the root of the gap between two points of different sign: the Illinois variant of false position (Dowell and
    /// Jarratt 1971).
    fn refine_hit(
        &self,
        [mut a, mut b]: [f64; 2],
        [mut gap_a, mut gap_b]: [f64; 2],
        direction: &Vector3<f64>,
    ) -> Hit {
        for _ in 0..BISECTIONS {
            let s = (a * gap_b - b * gap_a) / (gap_b - gap_a);
            let (gap, z) = self.skin_gap(s, direction);
            if gap.abs() < HIT_GAP_M {
                return Hit { s, z };
            }
            if (gap > 0.0) == (gap_b > 0.0) {
                gap_a *= 0.5;
            } else {
                (a, gap_a) = (b, gap_b);
            }
            (b, gap_b) = (s, gap);
        }
        Hit {
            s: b,
            z: self.skin_gap(b, direction).1,
        }
    }

    fn is_between_edges(&self, hit: &Hit) -> bool {
        let (low, high) = self.wing.edges(hit.s);
        hit.z >= low && hit.z <= high
    }

    /// Returns true if the ray is below the skin and between the edges.
    fn is_inside(&self, s: f64, direction: &Vector3<f64>) -> bool {
        let (gap, z) = self.skin_gap(s, direction);
        gap <= 0.0 && self.is_between_edges(&Hit { s, z })
    }

    /// Returns the point at which `entered` turns true.
    fn bisect(
        &self,
        mut outside: f64,
        mut inside: f64,
        direction: &Vector3<f64>,
        entered: impl Fn(f64) -> bool,
    ) -> Hit {
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (outside + inside);
            if entered(middle) {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        Hit {
            s: inside,
            z: self.skin_gap(inside, direction).1,
        }
    }

    /// Returns the rates of gap and z along s near a hit; `None` if the ray does not approach the skin.
    pub fn hit_rates(&self, s: f64, direction: &Vector3<f64>) -> Option<HitRates> {
        let ((g0, z0), (g1, z1)) = (
            self.skin_gap(s - 0.02, direction),
            self.skin_gap(s + 0.02, direction),
        );
        let rates = HitRates {
            gap: (g1 - g0) / 0.04,
            z: (z1 - z0) / 0.04,
        };
        (rates.gap < 0.0).then_some(rates)
    }

    /// Returns the hit near a guess, by two chord steps; `None` if it moves further than `reach_m` or leaves the skin.
    pub fn near_hit(
        &self,
        guess_s: f64,
        rates: &HitRates,
        reach_m: f64,
        direction: &Vector3<f64>,
    ) -> Option<Hit> {
        let s = guess_s - self.skin_gap(guess_s, direction).0 / rates.gap;
        let (rest, z) = self.skin_gap(s, direction);
        let correction = -rest / rates.gap;
        let hit = Hit {
            s: s + correction,
            z: z + correction * rates.z,
        };
        let on_skin = self.is_between_edges(&hit) && hit.s <= self.wing.beam.length_m;
        ((hit.s - guess_s).abs() <= reach_m && correction.abs() < 0.02 && on_skin).then_some(hit)
    }
}

/// Derivatives along s on one ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitRates {
    /// Rate of the height above the skin.
    pub gap: f64,
    pub z: f64,
}

#[cfg(test)]
mod tests {
    use super::super::beam::LoadShape;
    use super::super::wing::{LinearTaper, SceneState, tests::wing};

    const LOAD: LoadShape = LoadShape {
        triangular: 0.3,
        relief: 0.2,
    };

    #[test]
    fn rays_return_to_the_points_they_were_shot_at() {
        let state = SceneState {
            tip_deflection_m: 2.5,
            ..SceneState::ground(LOAD)
        };
        let pose = wing().deform(&state);
        for (s, z) in [(6.0, 1.0), (15.0, -1.4), (24.0, 0.0), (32.0, 0.8)] {
            let direction = pose.skin_point(s, z).normalize();
            let hit = pose.first_hit(&direction).unwrap();
            assert!(
                (hit.s - s).abs() < 1e-6 && (hit.z - z).abs() < 1e-6,
                "{hit:?}"
            );
            let rates = pose.hit_rates(s + 0.02, &direction).unwrap();
            let near = pose.near_hit(s + 0.02, &rates, 0.5, &direction).unwrap();
            assert!(
                (near.s - s).abs() < 1e-5 && (near.z - z).abs() < 1e-6,
                "{near:?} {s} {z}"
            );
        }
    }

    #[test]
    fn skin_behind_the_crest_of_a_drooping_wing_is_hidden() {
        let wing = super::super::wing::SceneWing {
            slope_rad: LinearTaper {
                root: 0.1,
                tip: -0.25,
            },
            ..wing()
        };
        let pose = wing.deform(&SceneState::ground(LOAD));
        let hit = pose.first_hit(&pose.skin_point(31.0, 0.0).normalize());
        assert!(hit.is_none_or(|hit| hit.s < 30.0), "{hit:?}");
    }
}
