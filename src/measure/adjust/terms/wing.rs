//! What the wing does in flight and what drawings leave open of it.

use nalgebra::{DMatrix, DVector, Vector3};

use crate::measure::adjust::beam::{Grid, RAISE_TERMS, Section};
use crate::measure::adjust::curve::Curve;
use crate::measure::adjust::gauss_helmert::Prior;
use crate::measure::adjust::ground::GroundShape;
use crate::measure::adjust::input::Input;
use crate::measure::adjust::marker_state::MarkerState;
use crate::measure::adjust::shapes::shape_covariance;
use crate::measure::adjust::term::Term;
use crate::measure::adjust::values::Values;
use crate::measure::setup::Thermal;

/// Coefficients of the curvature, 1/m.
#[derive(Debug)]
pub struct Curvature {
    /// Their number.
    pub terms: usize,
    /// Leading coefficient that the ratios of the others are weighed with, 1/m; `None`: nothing is known of them here.
    pub amplitude_per_m: Option<f64>,
}

impl Term for Curvature {
    fn name(&self) -> &'static str {
        "bending"
    }

    fn missing(&self) -> &'static str {
        "bending cannot be determined from the markers at hand; markers along the whole span are needed"
    }

    fn size(&self) -> usize {
        self.terms
    }

    fn priors(&self) -> Vec<Prior> {
        let amplitude = self.amplitude_per_m.filter(|_| self.terms > 1);
        let known = |a: f64| Prior::centred("shape of bending", 1, shape_covariance(self.terms) * (a * a));
        amplitude.map(known).into_iter().collect()
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.curvature_per_m = x.to_vec();
    }

    fn position(&self, k: usize, state: &MarkerState) -> Vector3<f64> {
        state.by_curvature[k]
    }

    fn lifts(&self, k: usize, curve: &Curve) -> Vec<f64> {
        curve.bent.iter().map(|section| section.axis_by_curvature[k].y).collect()
    }
}

/// Standard deviation of the first two terms of the twist, rad: a few degrees.
const TWIST_SIGMA_RAD: f64 = 0.1;
/// Of the further ones, rad.
const TWIST_DETAIL_SIGMA_RAD: f64 = 0.02;

/// Coefficients of the twist, rad.
#[derive(Debug)]
pub struct Twist {
    /// Their number.
    pub terms: usize,
}

impl Term for Twist {
    fn name(&self) -> &'static str {
        "twist"
    }

    fn missing(&self) -> &'static str {
        "twist cannot be determined; markers near the leading and the trailing edge are needed"
    }

    fn size(&self) -> usize {
        self.terms
    }

    fn priors(&self) -> Vec<Prior> {
        let sigma = |k: usize| if k < 2 { TWIST_SIGMA_RAD } else { TWIST_DETAIL_SIGMA_RAD };
        (0..self.terms).map(|k| Prior::scalar(self.name(), k, 0.0, sigma(k))).collect()
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.twist_rad = x.to_vec();
    }

    fn position(&self, k: usize, state: &MarkerState) -> Vector3<f64> {
        state.by_twist[k]
    }

    fn twist(&self, k: usize, section: &Section) -> f64 {
        section.twist_by_terms[k]
    }
}

/// How the doubt of the axis' height is spread along the span: its mean, then Legendre's polynomials of degree
/// 1 to 3 over the span. A misjudged share of a section's height is misjudged alike along the wing: the difference from
/// root to tip, twice the second figure, is left two fifths of the mean's doubt, as much as sections differ in what
/// their spars look like; bends a half and a quarter of the slope. An assumption.
const SKIN_HEIGHT_SPREAD: [f64; RAISE_TERMS] = [1.0, 0.2, 0.1, 0.05];
/// Rows: Legendre's polynomials of degree 0 to 3 on (0, 1); columns: powers of s/L.
const LEGENDRE_BY_POWERS: [[f64; RAISE_TERMS]; RAISE_TERMS] =
    [[1.0, 0.0, 0.0, 0.0], [-1.0, 2.0, 0.0, 0.0], [1.0, -6.0, 6.0, 0.0], [-1.0, 12.0, -30.0, 20.0]];

/// Height of the bending axis over the surveyed one, coefficients of the powers of s/L, m.
#[derive(Debug)]
pub struct AxisHeight {
    covariance_m2: DMatrix<f64>,
}

impl AxisHeight {
    /// The surface through the markers as it was fitted, and the skin height.
    pub fn of(ground: &GroundShape) -> Self {
        let mut covariance_m2 =
            DMatrix::from_column_slice(RAISE_TERMS, RAISE_TERMS, ground.axis_covariance.as_slice());
        for (spread, powers) in SKIN_HEIGHT_SPREAD.into_iter().zip(LEGENDRE_BY_POWERS) {
            let powers = DVector::from_column_slice(&powers) * (spread * ground.skin_height_sigma_m);
            covariance_m2 += &powers * powers.transpose();
        }
        Self { covariance_m2 }
    }
}

impl Term for AxisHeight {
    fn name(&self) -> &'static str {
        "height of the bending axis"
    }

    fn missing(&self) -> &'static str {
        "the height of the bending axis cannot be determined"
    }

    fn size(&self) -> usize {
        RAISE_TERMS
    }

    fn priors(&self) -> Vec<Prior> {
        vec![Prior::centred(self.name(), 0, self.covariance_m2.clone())]
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.raise_m.iter_mut().zip(x).for_each(|(raise, x)| *raise += x);
    }

    fn position(&self, k: usize, state: &MarkerState) -> Vector3<f64> {
        state.by_raise[k]
    }

    fn lifts(&self, k: usize, curve: &Curve) -> Vec<f64> {
        curve.bent.iter().map(|section| section.axis_by_raise[k].y - section.raise_by_terms[k]).collect()
    }
}

/// Scale in flight where the installation has no `[thermal]`: all of what 70 K do to aluminium.
const UNSTATED_SCALE_SIGMA: f64 = 23.1e-6 * 70.0;

/// Thermal scale less its expected value.
#[derive(Debug)]
pub struct ThermalScale {
    sigma: f64,
}

impl ThermalScale {
    /// `None`: held.
    pub fn of(thermal: Option<&Thermal>) -> Option<Self> {
        let sigma = thermal.map_or(UNSTATED_SCALE_SIGMA, scale_sigma);
        (sigma > 0.0).then_some(Self { sigma })
    }
}

/// Standard deviation of the thermal scale, where it is known.
fn scale_sigma(thermal: &Thermal) -> f64 {
    let difference = thermal.flight_temperature_c - thermal.ground_temperature_c;
    let coefficient = thermal.expansion_sigma_per_k.unwrap_or(0.0) * difference;
    let temperature = thermal.flight_temperature_sigma_k.unwrap_or(0.0) * thermal.expansion_per_k;
    coefficient.hypot(temperature)
}

impl Term for ThermalScale {
    fn name(&self) -> &'static str {
        "thermal scale"
    }

    fn missing(&self) -> &'static str {
        "the thermal scale cannot be determined; give its standard deviation"
    }

    fn size(&self) -> usize {
        1
    }

    fn priors(&self) -> Vec<Prior> {
        vec![Prior::scalar(self.name(), 0, 0.0, self.sigma)]
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.scale += x[0];
    }

    fn position(&self, _k: usize, state: &MarkerState) -> Vector3<f64> {
        state.by_scale
    }

    fn lifts(&self, _k: usize, curve: &Curve) -> Vec<f64> {
        let by = |section: &Section| (section.axis_m.y - curve.root_m.y) / curve.values.scale;
        curve.bent.iter().map(by).collect()
    }
}

/// Names of [`Drawn`], in the order of [`super::super::estimated::sigmas`].
const DRAWN: [&str; 3] = ["root offset", "chord offset of the bending axis", "direction of the span"];

/// One of what a user takes from drawings: where bending starts, where the axis lies, in which direction the span runs.
#[derive(Debug)]
pub struct Drawn {
    which: usize,
    sigma: f64,
}

impl Drawn {
    /// Those that are not held.
    pub fn all(input: &Input) -> Vec<Self> {
        let sigmas = crate::measure::adjust::estimated::sigmas(&input.setup.uncertainty);
        let one = |(which, sigma): (usize, f64)| Self { which, sigma };
        sigmas.into_iter().enumerate().filter(|(_, sigma)| *sigma > 0.0).map(one).collect()
    }
}

impl Term for Drawn {
    fn name(&self) -> &'static str {
        DRAWN[self.which]
    }

    fn missing(&self) -> &'static str {
        "root offset, chord offset or span direction cannot be determined; give their standard deviations in [wing]"
    }

    fn size(&self) -> usize {
        1
    }

    fn priors(&self) -> Vec<Prior> {
        vec![Prior::scalar(self.name(), 0, 0.0, self.sigma)]
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.estimated[self.which] += x[0];
    }

    fn position(&self, _k: usize, state: &MarkerState) -> Vector3<f64> {
        state.by_estimated[self.which]
    }

    /// From the lifts of a wing that differs in it, at the same places.
    fn lifts(&self, _k: usize, curve: &Curve) -> Vec<f64> {
        let Some(neighbour) = &curve.scene.neighbours[self.which] else { return vec![] };
        let own: Vec<f64> = curve.arcs_m.iter().map(|arc| (arc - neighbour.root_m).max(0.0)).collect();
        let there = curve.lifts_on(&Grid::new(&neighbour.ground, &own));
        there.iter().zip(curve.lifts_m()).map(|(there, here)| (there - here) / neighbour.step).collect()
    }
}
