//! A wing that vibrates in its second bending mode, exactly: the mode's curvature is added to that of the load, and the axis keeps
//! its length. It shares no code with the fitted model.

use nalgebra::Vector3;

use super::{STEPS, Truth};

/// Exponent of the mass as a power of the chord: a box with skins of constant thickness, plus systems.
const MASS_POWER: f64 = 2.0;
const ITERATIONS: usize = 60;

/// Source of the second mode's shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModeShape {
    /// Second mode of a uniform cantilever, as in the renderer.
    Uniform,
    /// Second mode of the wing's own stiffness and of masses that follow its chord.
    AsItIs,
}

/// Curvature per metre of the tip, 1/m2, at STEPS + 1 stations.
#[derive(Clone, Debug)]
pub struct SecondMode(Vec<f64>);

/// Running integral from the root.
fn integrate_from_root(step: f64, values: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; values.len()];
    for k in 1..values.len() {
        sums[k] = sums[k - 1] + 0.5 * step * (values[k - 1] + values[k]);
    }
    sums
}

/// Running integral from the tip.
fn integrate_from_tip(step: f64, values: &[f64]) -> Vec<f64> {
    let reversed: Vec<f64> = values.iter().rev().copied().collect();
    integrate_from_root(step, &reversed)
        .into_iter()
        .rev()
        .collect()
}

fn dot(a: &[f64], b: &[f64], mass: &[f64]) -> f64 {
    a.iter().zip(b).zip(mass).map(|((a, b), m)| a * b * m).sum()
}

impl Truth {
    /// The wing's second mode.
    pub fn second_mode(&self, shape: ModeShape) -> SecondMode {
        let (length_m, step) = (self.wing.length_m, self.wing.length_m / STEPS as f64);
        let chord = |k: usize| match shape {
            ModeShape::Uniform => 1.0,
            ModeShape::AsItIs => 1.0 - (1.0 - self.wing.taper) * k as f64 / STEPS as f64,
        };
        let mass: Vec<f64> = (0..=STEPS).map(|k| chord(k).powf(MASS_POWER)).collect();
        // Deflection under the inertia of a deflection (Stodola and Vianello), and its curvature.
        let answer = |w: &[f64]| -> (Vec<f64>, Vec<f64>) {
            let load: Vec<f64> = w.iter().zip(&mass).map(|(w, m)| w * m).collect();
            let moment = integrate_from_tip(step, &integrate_from_tip(step, &load));
            let curvature: Vec<f64> = moment
                .iter()
                .enumerate()
                .map(|(k, m)| m / chord(k).powf(self.wing.power))
                .collect();
            (
                integrate_from_root(step, &integrate_from_root(step, &curvature)),
                curvature,
            )
        };
        let start = |power: i32| -> Vec<f64> {
            (0..=STEPS)
                .map(|k| (step * k as f64 / length_m).powi(power))
                .collect()
        };
        let mut first = start(2);
        for _ in 0..ITERATIONS {
            first = answer(&first).0;
            let size = dot(&first, &first, &mass).sqrt();
            first.iter_mut().for_each(|w| *w /= size);
        }
        let (mut second, mut curvature) = (start(3), vec![]);
        for _ in 0..ITERATIONS {
            let of_first = dot(&first, &second, &mass);
            second
                .iter_mut()
                .zip(&first)
                .for_each(|(w, f)| *w -= of_first * f);
            (second, curvature) = answer(&second);
            let tip = second[STEPS];
            second.iter_mut().for_each(|w| *w /= tip);
            curvature.iter_mut().for_each(|c| *c /= tip);
        }
        SecondMode(curvature)
    }

    /// Survey-frame positions in flight, with a second-mode amplitude, m at the tip.
    pub fn vibrating_positions(
        &self,
        tip_deflection_m: f64,
        fuel: f64,
        mode: &SecondMode,
        second_m: f64,
    ) -> Vec<Vector3<f64>> {
        let scale = self.setup.thermal.map_or(1.0, |t| t.scale());
        let (mut curvature, factor) = self.load_curvature(tip_deflection_m, fuel);
        curvature
            .iter_mut()
            .zip(&mode.0)
            .for_each(|(c, swing)| *c = factor * *c + second_m * swing);
        let frame = self.setup.wing_frame();
        let axis = self
            .wing
            .bend_in_space(&curvature, scale, self.wing.twist_at(tip_deflection_m));
        let carried = self.points_on(&axis, scale);
        carried.iter().map(|p| frame.survey_point(p)).collect()
    }
}
