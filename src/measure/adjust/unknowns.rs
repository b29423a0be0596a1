//! What the spatial methods do not know, and what is known of it beforehand.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, Vector3};

use super::beam::RAISE_TERMS;
use super::estimated::{self, ESTIMATED};
use super::gauss_helmert::Prior;
use super::ground::GroundShape;
use super::scene::Scene;
use super::{AdjustError, Observation, Options, shapes};
use crate::measure::setup::{Orientation, Setup, Thermal};

/// Standard deviation of the first two terms of the twist, rad: a few degrees.
const TWIST_SIGMA_RAD: f64 = 0.1;
/// Of the further ones, rad.
const TWIST_DETAIL_SIGMA_RAD: f64 = 0.02;
/// How the doubt of the axis' height is spread along the span: its mean, then Legendre's polynomials of degree
/// 1 to 3 over the span. A misjudged share of a section's height is misjudged alike along the wing: the difference from
/// root to tip, twice the second figure, is left two fifths of the mean's doubt, as much as sections differ in what
/// their spars look like; bends a half and a quarter of the slope. An assumption.
const SKIN_HEIGHT_SPREAD: [f64; RAISE_TERMS] = [1.0, 0.2, 0.1, 0.05];
/// Rows: Legendre's polynomials of degree 0 to 3 on (0, 1); columns: powers of s/L.
const LEGENDRE_BY_POWERS: [[f64; RAISE_TERMS]; RAISE_TERMS] =
    [[1.0, 0.0, 0.0, 0.0], [-1.0, 2.0, 0.0, 0.0], [1.0, -6.0, 6.0, 0.0], [-1.0, 12.0, -30.0, 20.0]];
/// Scale in flight where the installation has no `[thermal]`: all of what 70 K do to aluminium.
const UNTOLD_SCALE_SIGMA: f64 = 23.1e-6 * 70.0;
/// A mounting that is stated not to drift is taken to do so by this, rad: a prior needs a width (0.001 px at 8000 px).
pub(super) const LEAST_DRIFT_RAD: f64 = 1e-7;
/// A pane that is stated without error is taken at this, m: a thousandth of a pixel at 8 m, and a regular prior.
const LEAST_WINDOW_SIGMA_M: f64 = 1e-6;

/// Names of what is missing where the normal equations are singular, in the layout's order.
pub(super) const MISSING: [&str; 11] = [
    "bending cannot be determined from the markers at hand; markers along the whole span are needed",
    "twist cannot be determined; markers near the leading and the trailing edge are needed",
    "the mounting's rotation cannot be determined; give camera.mount_repeatability_px or more markers near the root",
    "the rotation on ground cannot be determined; more markers in the ground frame are needed",
    "the projection centre cannot be determined; give camera.projection_centre_sigma_m",
    "the thermal scale cannot be determined; give its standard deviation",
    "the height of the bending axis cannot be determined",
    "the panes' shift or bow cannot be determined; give the standard deviations in [window]",
    "the mounting's shift cannot be determined; give camera.mount_shift_m",
    "the interior orientation cannot be determined; give its covariance in camera.toml",
    "root offset, chord offset or span direction cannot be determined; give their standard deviations in [wing]",
];

/// What a frame is set up from.
pub(super) struct Input<'a> {
    pub setup: &'a Setup,
    pub orientation: &'a Orientation,
    pub scene: &'a Scene,
    pub options: &'a Options,
    /// Per marker of the survey.
    pub flight: Vec<Option<&'a Observation>>,
}

/// Reads observations into the survey's order.
pub(super) fn by_marker<'a>(
    setup: &Setup,
    observations: &'a [Observation],
) -> Result<Vec<Option<&'a Observation>>, AdjustError> {
    let mut list = vec![None; setup.markers.len()];
    for o in observations {
        let finite = o.pixel.iter().chain(o.covariance_px2.iter()).all(|v| v.is_finite());
        if !finite || o.covariance_px2.cholesky().is_none() {
            return Err(AdjustError::Input(
                "an image coordinate or its standard deviation is not a finite, positive number".into(),
            ));
        }
        let slot = list.get_mut(o.marker).ok_or_else(|| {
            AdjustError::Input("an observation names a marker that the survey does not list".into())
        })?;
        *slot = Some(o);
    }
    Ok(list)
}

/// How many of a frame's observations are of markers on the wing.
pub(super) fn on_the_wing(setup: &Setup, frame: &[Option<&Observation>]) -> usize {
    setup.markers.iter().zip(frame).filter(|(m, seen)| !m.fixed && seen.is_some()).count()
}

/// Standard deviation of the thermal scale, where it is known.
pub(super) fn scale_sigma(thermal: &Thermal) -> f64 {
    let difference = thermal.flight_temperature_c - thermal.ground_temperature_c;
    let coefficient = thermal.expansion_sigma_per_k.unwrap_or(0.0) * difference;
    let temperature = thermal.flight_temperature_sigma_k.unwrap_or(0.0) * thermal.expansion_per_k;
    coefficient.hypot(temperature)
}

/// Columns handed out one after the other.
#[derive(Default)]
pub(super) struct Columns {
    pub missing: Vec<&'static str>,
}

impl Columns {
    pub fn take(&mut self, n: usize, missing: &'static str) -> usize {
        let first = self.missing.len();
        self.missing.extend(std::iter::repeat_n(missing, n));
        first
    }
}

/// The unknowns of camera and temperature, with their priors.
pub(super) struct Common {
    pub ground: Option<usize>,
    pub centre: Option<usize>,
    pub window: Option<usize>,
    pub bow: Option<usize>,
    pub scale: Option<usize>,
    pub raise: usize,
    pub lens: Option<usize>,
    pub estimated: [Option<usize>; ESTIMATED],
    pub priors: Vec<Prior>,
}

/// Takes columns for what all frames share.
pub(super) fn common(input: &Input, columns: &mut Columns) -> Common {
    let setup = input.setup;
    let mut priors = vec![];
    let ground = input.scene.has_ground_sights().then(|| columns.take(3, MISSING[3]));
    let centre_sigma = setup.projection_centre_sigma_m;
    let centre = (centre_sigma > 0.0).then(|| columns.take(3, MISSING[4]));
    priors.extend(
        centre.iter().flat_map(|&first| (0..3).map(move |k| Prior::scalar(first + k, 0.0, centre_sigma))),
    );
    let window = window(input, columns, &mut priors);
    let bow_sigma = input.scene.bow_sigma().filter(|s| *s > 0.0);
    let bow = bow_sigma.map(|_| columns.take(1, MISSING[7]));
    priors.extend(bow.zip(bow_sigma).map(|(column, sigma)| Prior::scalar(column, 0.0, sigma)));
    let sigma = setup.thermal.as_ref().map_or(UNTOLD_SCALE_SIGMA, scale_sigma);
    let scale = (sigma > 0.0).then(|| columns.take(1, MISSING[5]));
    priors.extend(scale.map(|column| Prior::scalar(column, 0.0, sigma)));
    let raise = columns.take(RAISE_TERMS, MISSING[6]);
    priors.push(raise_prior(&input.scene.ground, raise));
    let lens = setup.uncertainty.lens.map(|covariance| {
        let first = columns.take(9, MISSING[9]);
        priors.push(lens_prior(&covariance, first));
        first
    });
    let mut estimated = [None; ESTIMATED];
    for (slot, sigma) in estimated.iter_mut().zip(estimated::sigmas(&setup.uncertainty)) {
        if sigma > 0.0 {
            let column = columns.take(1, MISSING[10]);
            priors.push(Prior::scalar(column, 0.0, sigma));
            *slot = Some(column);
        }
    }
    Common { ground, centre, window, bow, scale, raise, lens, estimated, priors }
}

/// Variance of an interior parameter that the calibration held, in its own unit squared: none that shows.
const HELD_LENS_VARIANCE: f64 = 1e-16;

/// Interior orientation as calibrated; a thousand-millionth of each variance keeps a covariance that rounding
/// left without an inverse regular.
fn lens_prior(covariance: &SMatrix<f64, 9, 9>, first: usize) -> Prior {
    let mut covariance = DMatrix::from_column_slice(9, 9, covariance.as_slice());
    for k in 0..9 {
        covariance[(k, k)] = (covariance[(k, k)] * (1.0 + 1e-9)).max(HELD_LENS_VARIANCE);
    }
    Prior { columns: (first..first + 9).collect(), mean: DVector::zeros(9), covariance }
}

/// Takes columns for a mounting's shift of the projection centre, where there may be one.
pub(super) fn shift_columns(input: &Input, columns: &mut Columns, priors: &mut Vec<Prior>) -> Option<usize> {
    let sigma = input.setup.uncertainty.mount_shift_m;
    (sigma > 0.0).then(|| {
        let first = columns.take(3, MISSING[8]);
        priors.extend((0..3).map(|k| Prior::scalar(first + k, 0.0, sigma)));
        first
    })
}

/// What is left of the panes' shift where only the flight is seen through them: a shift of the projection
/// centre that all frames share. Where ground and flight are seen alike it is a part of the centre's.
fn window(input: &Input, columns: &mut Columns, priors: &mut Vec<Prior>) -> Option<usize> {
    let covariance = input.scene.window_covariance_m2()?;
    let first = columns.take(3, MISSING[7]);
    let least = DMatrix::identity(3, 3) * (LEAST_WINDOW_SIGMA_M * LEAST_WINDOW_SIGMA_M);
    priors.push(Prior {
        columns: (first..first + 3).collect(),
        mean: DVector::zeros(3),
        covariance: DMatrix::from_column_slice(3, 3, covariance.as_slice()) + least,
    });
    Some(first)
}

/// Height of the bending axis: the surface through the markers as it was fitted, and the skin height.
fn raise_prior(ground: &GroundShape, first: usize) -> Prior {
    let mut covariance =
        DMatrix::from_column_slice(RAISE_TERMS, RAISE_TERMS, ground.axis_covariance.as_slice());
    for (spread, powers) in SKIN_HEIGHT_SPREAD.into_iter().zip(LEGENDRE_BY_POWERS) {
        let powers = DVector::from_column_slice(&powers) * (spread * ground.skin_sigma_m);
        covariance += &powers * powers.transpose();
    }
    Prior { columns: (first..first + RAISE_TERMS).collect(), mean: DVector::zeros(RAISE_TERMS), covariance }
}

/// Of the rotation where the camera stayed since the ground frames, camera frame, rad: it drifts.
pub(super) fn stayed_prior(input: &Input, first: usize) -> Prior {
    let drift = input.setup.uncertainty.mount_drift_rad.max(LEAST_DRIFT_RAD);
    Prior {
        columns: (first..first + 3).collect(),
        mean: DVector::zeros(3),
        covariance: DMatrix::identity(3, 3) * (drift * drift),
    }
}

/// What is known of the mounting's rotation before a frame is seen, camera frame, rad.
pub(super) fn mount_prior(input: &Input, first: usize) -> Prior {
    let shift = input.setup.mount_repeatability_px.max(1e-3) / input.setup.lens.focal_px();
    let stated = input.orientation.covariance_rad2.filter(|_| !input.scene.has_ground_sights());
    let own = Matrix3::identity() * (shift * shift) + stated.unwrap_or_else(Matrix3::zeros);
    let (mean, covariance) = input.options.mount_prior.unwrap_or((Vector3::zeros(), own));
    Prior {
        columns: (first..first + 3).collect(),
        mean: DVector::from_column_slice(mean.as_slice()),
        covariance: DMatrix::from_column_slice(3, 3, covariance.as_slice()),
    }
}

/// Prior on the ratios of the curvature's coefficients, times an amplitude; from the second term on.
pub(super) fn shape_prior(first: usize, terms: usize, amplitude: f64) -> Option<Prior> {
    let n = terms.saturating_sub(1);
    (n > 0).then(|| Prior {
        columns: (first..first + n).collect(),
        mean: DVector::zeros(n),
        covariance: shape_covariance(terms) * (amplitude * amplitude),
    })
}

/// Prior on the change of the ratios from a flight's heaviest frame to its lightest.
pub(super) fn burning_prior(first: usize, terms: usize) -> Prior {
    let n = terms.saturating_sub(1);
    Prior {
        columns: (first..first + n).collect(),
        mean: DVector::zeros(n),
        covariance: DMatrix::from_fn(n, n, |i, j| shapes::burning()[(i, j)]),
    }
}

/// Covariance of the ratios of the curvature's coefficients, from the second term on.
pub(super) fn shape_covariance(terms: usize) -> DMatrix<f64> {
    let n = terms.saturating_sub(1);
    DMatrix::from_fn(n, n, |i, j| shapes::spread()[(i, j)])
}

/// Loose priors on the twist.
pub(super) fn twist_priors(twist: usize, t: usize) -> impl Iterator<Item = Prior> {
    let sigma = |k: usize| if k < 2 { TWIST_SIGMA_RAD } else { TWIST_DETAIL_SIGMA_RAD };
    (0..t).map(move |k| Prior::scalar(twist + k, 0.0, sigma(k)))
}
