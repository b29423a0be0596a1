//! Tapered cantilever that bends the rendered wing: physics, not the polynomial that [`wingd_measure::adjust`] fits.
//!
//! Euler and Bernoulli: curvature = M / EI with EI ~ chord^p. The net load (lift less the relief of the fuel) is vertical,
//! the lever arm is the horizontal one of the bent axis, and the axis keeps its length. The amplitude is chosen for the
//! given tip deflection.

/// Number of intervals along the beam.
const INTERVALS: usize = 800;
const ITERATIONS: usize = 60;

/// Distribution of the net load along the span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadShape {
    /// Fraction of a triangular load in an otherwise elliptic lift, 0 to 1.
    pub triangular: f64,
    /// Weight of the fuel that relieves the inner wing, as a fraction of the lift at the root.
    pub relief: f64,
}

impl LoadShape {
    /// Returns the load per length at the relative span `eta`, any unit.
    pub fn load(&self, eta: f64) -> f64 {
        let elliptic = (1.0 - eta * eta).max(0.0).sqrt();
        let lift = (1.0 - self.triangular) * elliptic + self.triangular * (1.0 - eta);
        // Tanks end near 80 % of the span.
        let fuel = (1.0 - (eta / 0.8).powi(4)).max(0.0);
        lift - self.relief * fuel
    }
}

/// Cantilever with linear taper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CantileverBeam {
    /// Length of the axis, m.
    pub length_m: f64,
    /// Chord at the tip over chord at the root.
    pub taper: f64,
    /// Exponent p of EI ~ chord^p.
    pub stiffness_power: f64,
}

/// Bent beam at equally spaced stations, root to tip.
#[derive(Clone, Debug, PartialEq)]
pub struct BentBeam {
    /// Distance between stations, m.
    pub step_m: f64,
    /// Change of slope against the unbent axis, rad.
    pub slope_rad: Vec<f64>,
    /// Bending moment, any unit.
    pub moment: Vec<f64>,
    /// Change of curvature, 1/m.
    pub curvature_per_m: Vec<f64>,
}

impl CantileverBeam {
    /// Returns the number of stations along the beam.
    pub fn stations(&self) -> usize {
        INTERVALS + 1
    }

    /// Returns the distance between stations, m.
    pub fn step_m(&self) -> f64 {
        self.length_m / INTERVALS as f64
    }

    fn relative_chord_at(&self, eta: f64) -> f64 {
        1.0 - (1.0 - self.taper) * eta
    }

    /// Returns the curvature of the second mode of a uniform cantilever per metre of tip displacement, 1/m2.
    fn second_mode(&self) -> Vec<f64> {
        /// Wave number times length of that mode, the second root of cos b cosh b = -1. The free end requires the factor
        /// (cosh b + cos b) / (sinh b + sin b).
        const ROOT: f64 = 4.694_091_132_974_175;
        let free = (ROOT.cosh() + ROOT.cos()) / (ROOT.sinh() + ROOT.sin());
        let unit = |i: usize| {
            let b = ROOT * i as f64 / INTERVALS as f64;
            b.cosh() + b.cos() - free * (b.sinh() + b.sin())
        };
        let slope = running_integral(self.step_m(), (0..=INTERVALS).map(unit));
        let tip = running_integral(self.step_m(), slope.into_iter())
            .last()
            .copied()
            .unwrap_or(1.0);
        (0..=INTERVALS).map(|i| unit(i) / tip).collect()
    }

    /// Bends the axis of unbent slope `ground_slope_rad` so that the load raises the tip by `tip_deflection_m`, and adds
    /// the second mode with `second_m` at the tip.
    pub fn bend(
        &self,
        ground_slope_rad: &[f64],
        load: &LoadShape,
        tip_deflection_m: f64,
        second_m: f64,
    ) -> BentBeam {
        let step = self.step_m();
        let second_curvature: Vec<f64> = match second_m {
            0.0 => vec![0.0; INTERVALS + 1],
            _ => self
                .second_mode()
                .into_iter()
                .map(|curvature| second_m * curvature)
                .collect(),
        };
        let shear = self.integral_from_tip(|i| load.load(i as f64 / INTERVALS as f64));
        let mut slope = vec![0.0; INTERVALS + 1];
        let mut moment = slope.clone();
        let mut curvature = slope.clone();
        let mut amplitude = 0.0;
        for _ in 0..ITERATIONS {
            moment = self.integral_from_tip(|i| shear[i] * (ground_slope_rad[i] + slope[i]).cos());
            let unit = |i: usize| {
                moment[i]
                    / self
                        .relative_chord_at(i as f64 / INTERVALS as f64)
                        .powf(self.stiffness_power)
            };
            if amplitude == 0.0 {
                // First guess for small slopes; the loop refines it.
                let mut unit_slope = running_integral(step, (0..=INTERVALS).map(unit));
                unit_slope = running_integral(step, unit_slope.into_iter());
                amplitude = tip_deflection_m / unit_slope[INTERVALS];
            }
            curvature = (0..=INTERVALS)
                .map(|i| amplitude * unit(i) + second_curvature[i])
                .collect();
            slope = running_integral(step, curvature.iter().copied());
            let deflection = tip_deflection(step, ground_slope_rad, &slope) - second_m;
            if (deflection - tip_deflection_m).abs() < 1e-12 || deflection == 0.0 {
                break;
            }
            amplitude *= tip_deflection_m / deflection;
        }
        BentBeam {
            step_m: step,
            slope_rad: slope,
            moment,
            curvature_per_m: curvature,
        }
    }

    /// Returns the twist along the span: torque of an aerodynamic moment ~ chord^2 over GJ ~ chord^3, scaled to `tip_rad`.
    pub fn twist(&self, tip_rad: f64) -> Vec<f64> {
        let torque =
            self.integral_from_tip(|i| self.relative_chord_at(i as f64 / INTERVALS as f64).powi(2));
        let rate =
            |i: usize| torque[i] / self.relative_chord_at(i as f64 / INTERVALS as f64).powi(3);
        let twist = running_integral(self.step_m(), (0..=INTERVALS).map(rate));
        let scale = tip_rad / twist[INTERVALS];
        twist.into_iter().map(|phi| phi * scale).collect()
    }

    fn integral_from_tip(&self, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut sums = running_integral(self.step_m(), (0..=INTERVALS).rev().map(value));
        sums.reverse();
        sums
    }
}

/// Returns the trapezoidal running integral, starting with 0.
pub fn running_integral(step: f64, values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut last = None;
    let mut sum = 0.0;
    values
        .map(|value| {
            sum += last.map_or(0.0, |previous| 0.5 * step * (previous + value));
            last = Some(value);
            sum
        })
        .collect()
}

fn tip_deflection(step: f64, ground_slope: &[f64], slope: &[f64]) -> f64 {
    let rise = ground_slope
        .iter()
        .zip(slope)
        .map(|(&ground, &bent)| (ground + bent).sin() - ground.sin());
    running_integral(step, rise).last().copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beam(taper: f64) -> CantileverBeam {
        CantileverBeam {
            length_m: 33.0,
            taper,
            stiffness_power: 3.5,
        }
    }

    fn flat(beam: &CantileverBeam) -> Vec<f64> {
        vec![0.0; beam.stations()]
    }

    #[test]
    fn the_tip_rises_as_given_and_has_no_moment() {
        let beam = beam(0.3);
        for deflection in [3.1, -0.8, 0.0] {
            let bent = beam.bend(
                &flat(&beam),
                &LoadShape {
                    triangular: 0.3,
                    relief: 0.2,
                },
                deflection,
                0.0,
            );
            let rise = tip_deflection(bent.step_m, &flat(&beam), &bent.slope_rad);
            assert!((rise - deflection).abs() < 1e-9, "{rise} for {deflection}");
            assert_eq!(*bent.moment.last().unwrap(), 0.0);
            assert_eq!(*bent.curvature_per_m.last().unwrap(), 0.0);
            assert_eq!(bent.slope_rad[0], 0.0);
        }
    }

    #[test]
    fn the_second_mode_has_a_node_near_80_percent_and_a_free_tip() {
        // A uniform cantilever: node at 0.783 of the length (any textbook on vibrations).
        let beam = beam(0.3);
        let load = LoadShape {
            triangular: 0.3,
            relief: 0.2,
        };
        let rise = |second_m: f64| {
            let bent = beam.bend(&flat(&beam), &load, 2.0, second_m);
            running_integral(bent.step_m, bent.slope_rad.iter().map(|t| t.sin()))
        };
        let mode: Vec<f64> = rise(0.01)
            .iter()
            .zip(rise(0.0))
            .map(|(a, b)| a - b)
            .collect();
        assert!((mode[INTERVALS] - 0.01).abs() < 1e-9, "{}", mode[INTERVALS]);
        let node = mode.iter().skip(10).position(|w| *w > 0.0).unwrap() + 10;
        assert!(
            (node as f64 / INTERVALS as f64 - 0.783).abs() < 0.02,
            "{node}"
        );
        let curvature = beam.second_mode();
        assert!(curvature[INTERVALS].abs() < 1e-9 * curvature[0].abs());
    }

    #[test]
    fn a_uniform_beam_under_a_triangular_load_matches_the_textbook() {
        // EI w = q0 L^4 (10 x^2 - 10 x^3 + 5 x^4 - x^5) / 120 for q = q0 (1 - x): slope at the tip
        // over tip deflection times L is 5/4.
        let beam = CantileverBeam {
            taper: 1.0,
            ..beam(1.0)
        };
        let bent = beam.bend(
            &flat(&beam),
            &LoadShape {
                triangular: 1.0,
                relief: 0.0,
            },
            0.01,
            0.0,
        );
        let ratio = bent.slope_rad.last().unwrap() * beam.length_m / 0.01;
        assert!((ratio - 1.25).abs() < 1e-4, "{ratio}");
    }

    #[test]
    fn twist_increases_from_zero_to_the_tip() {
        let twist = beam(0.3).twist(0.05);
        assert_eq!(twist[0], 0.0);
        assert!((twist.last().unwrap() - 0.05).abs() < 1e-15);
        assert!(twist.windows(2).all(|pair| pair[1] >= pair[0]));
    }
}
