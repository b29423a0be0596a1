//! Least squares of the ground frames: rotation, with survey and projection centre as uncertain as
//! they are stated. Their errors are common to all frames, so that more frames do not hide them.

use nalgebra::{DMatrix, DVector, Matrix2, Rotation3, Vector2, Vector3};

use super::scene::mahalanobis_squared;
use crate::environment::Plate;
use crate::estimation::{Block, EstimationError, Fit, Group, Linearised, Point, Prior, Problem, solve};
use crate::geometry::{left_jacobian, cross_matrix};
use crate::observation::Estimate;
use crate::setup::{GroundObservation, Orientation, Setup};

/// Chi-square of two degrees of freedom, 1e-4.
const GATE: f64 = 18.4;
/// A survey that claims no error at all is taken at this, m.
const MIN_SIGMA_M: f64 = 1e-5;

/// One marker seen in one ground frame, perspective bias removed.
#[derive(Clone, Debug)]
pub(super) struct GroundImage {
    pub(super) frame: usize,
    pub(super) detection: usize,
    pub(super) marker: usize,
    pub(super) pixel: Vector2<f64>,
    pub(super) covariance_px2: Matrix2<f64>,
}

impl GroundImage {
    fn to_observation(&self) -> GroundObservation {
        GroundObservation { marker: self.marker, pixel: self.pixel, covariance_px2: self.covariance_px2 }
    }
}

/// The adjusted orientation.
pub(super) struct Adjusted {
    pub(super) orientation: Orientation,
    pub(super) variance_factor: f64,
    pub(super) redundancy: usize,
    /// With residuals against the survey as given, observed - computed, px.
    pub(super) used: Vec<(GroundImage, Vector2<f64>)>,
    pub(super) taken_out: Vec<GroundImage>,
}

/// First columns of the unknowns: small rotation, correction of the projection centre, of every marker.
const CENTRE: usize = 3;
const MARKERS: usize = 6;
const MISSING: &str = "the markers at hand do not tell the rotation";

/// The ground frames' least squares.
struct OrientationAdjustment<'a> {
    setup: &'a Setup,
    /// Rotation that the small one is counted from, camera from survey.
    start: Rotation3<f64>,
    /// Per marker, survey frame: displacement by a bend of the wing, m per m at the tip; nothing where it is not sought.
    bend: &'a [Vector3<f64>],
    list: Vec<GroundImage>,
}

/// Adjusts, taking out the worst sight while its residual fails the test.
pub(super) fn adjust_orientation(setup: &Setup, start: &Rotation3<f64>, list: Vec<GroundImage>) -> Option<Adjusted> {
    let mut sights = OrientationAdjustment { setup, start: *start, bend: &[], list };
    let (fit, taken_out) = sights.solve_without_outliers()?;
    Some(sights.into_adjusted(&fit, taken_out))
}

/// A bend of the wing since the survey, at the tip, with its standard deviation, m: one unknown more, of which nothing is
/// known beforehand. `by_bend`: per marker, survey frame, m per m.
pub(super) fn estimate_bend(
    setup: &Setup,
    start: &Rotation3<f64>,
    by_bend: &[Vector3<f64>],
    list: Vec<GroundImage>,
) -> Option<Estimate> {
    let mut sights = OrientationAdjustment { setup, start: *start, bend: by_bend, list };
    let (fit, _) = sights.solve_without_outliers()?;
    let column = sights.bend_column();
    let scale = fit.variance_factor().map_or(1.0, |factor| factor.max(1.0)).sqrt();
    let sigma = scale * fit.covariance[(column, column)].max(0.0).sqrt();
    Some(Estimate { value: fit.global[column], sigma: Some(sigma) })
}

impl OrientationAdjustment<'_> {
    fn solve_without_outliers(&mut self) -> Option<(Fit, Vec<GroundImage>)> {
        let mut taken_out = Vec::new();
        loop {
            let fit = self.solve_images()?;
            let tests = (0..self.list.len()).map(|k| (self.residual_test(&fit, k), k));
            match tests.max_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((t, k)) if t > GATE && self.list.len() > 2 => taken_out.push(self.list.remove(k)),
                _ => return Some((fit, taken_out)),
            }
        }
    }

    /// Behind all others.
    fn bend_column(&self) -> usize {
        MARKERS + 3 * self.setup.markers.len()
    }

    fn solve_images(&self) -> Option<Fit> {
        let Self { setup, list, .. } = self;
        let unknowns = self.bend_column() + usize::from(!self.bend.is_empty());
        let block = |sight: &GroundImage| Block {
            observed: DVector::from_column_slice(sight.pixel.as_slice()),
            covariance: DMatrix::from_column_slice(2, 2, sight.covariance_px2.as_slice()),
        };
        let known = |name, first: usize, sigma_m: f64| {
            let variance = sigma_m.max(MIN_SIGMA_M).powi(2);
            Prior::centred(name, first, DMatrix::identity(3, 3) * variance)
        };
        let markers = setup.markers.iter().enumerate();
        let markers = markers.map(|(j, marker)| known("survey", MARKERS + 3 * j, marker.sigma_m));
        let centre = known("projection centre", CENTRE, setup.projection_centre_sigma_m);
        let problem = Problem {
            start: DVector::zeros(unknowns),
            missing: vec![MISSING; unknowns],
            priors: markers.chain([centre]).collect(),
            known: None,
            groups: vec![Group {
                local: DVector::zeros(0),
                priors: vec![],
                blocks: list.iter().map(block).collect(),
            }],
        };
        solve(&problem, |at| self.linearise(at)).ok()
    }

    fn camera_from_survey(&self, fit: &Fit) -> Rotation3<f64> {
        let mut rotation = Rotation3::new(fit.global.fixed_rows::<3>(0)) * self.start;
        rotation.renormalize();
        rotation
    }

    fn linearise(&self, at: &Point) -> Result<Linearised, EstimationError> {
        let Self { setup, list, .. } = self;
        let behind = || EstimationError::Input("a marker comes to lie behind the camera".into());
        let marker = list[at.block].marker;
        let first = MARKERS + 3 * marker;
        let turn = at.global.fixed_rows::<3>(0).into_owned();
        let rotation = Rotation3::new(turn) * self.start;
        let centre_m = setup.projection_centre_m + at.global.fixed_rows::<3>(CENTRE);
        let by_bend = self.bend.get(marker);
        let bent_m = by_bend.map_or_else(Vector3::zeros, |by| by * at.global[self.bend_column()]);
        let marker_m = setup.markers[marker].position_m + at.global.fixed_rows::<3>(first) + bent_m;
        let p = apparent_point(setup, &rotation, &marker_m, &centre_m);
        let (pixel, by_point) = setup.lens.project_with_jacobian(&p).ok_or_else(behind)?;
        let by_shift = by_point * rotation.matrix();
        let bend = by_bend.map(|_| self.bend_column());
        let columns = (0..MARKERS).chain(first..first + 3).chain(bend);
        let mut out = Linearised::empty(2, columns.collect(), 0, 2);
        out.global.fixed_columns_mut::<3>(0).copy_from(&(by_point * -cross_matrix(&p) * left_jacobian(&turn)));
        out.global.fixed_columns_mut::<3>(CENTRE).copy_from(&-by_shift);
        out.global.fixed_columns_mut::<3>(MARKERS).copy_from(&by_shift);
        if let Some(by) = by_bend {
            out.global.column_mut(MARKERS + 3).copy_from(&(by_shift * by));
        }
        out.misclosure.copy_from(&(pixel - at.observed));
        out.observations.fill_with_identity();
        out.observations.neg_mut();
        Ok(out)
    }

    /// v' Qv^-1 v of a sight: chi-square with two degrees of freedom where it is no blunder.
    fn residual_test(&self, fit: &Fit, k: usize) -> f64 {
        let residual = &fit.groups[0].blocks[k].residuals;
        let adjusted = fit.adjusted_covariance(0, k).fixed_view::<2, 2>(0, 0).into_owned();
        mahalanobis_squared(&Vector2::new(residual[0], residual[1]), &(self.list[k].covariance_px2 - adjusted))
    }

    fn into_adjusted(self, fit: &Fit, taken_out: Vec<GroundImage>) -> Adjusted {
        let (setup, rotation) = (self.setup, self.camera_from_survey(fit));
        let residual = |s: &GroundImage| {
            let ground = setup.markers[s.marker].position_m;
            let p = apparent_point(setup, &rotation, &ground, &setup.projection_centre_m);
            setup.lens.project(&p).map_or(Vector2::zeros(), |pixel| s.pixel - pixel)
        };
        let by_turn = left_jacobian(&fit.global.fixed_rows::<3>(0).into_owned());
        let covariance = fit.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        Adjusted {
            orientation: Orientation {
                camera_from_survey: rotation,
                covariance_rad2: Some(by_turn * covariance * by_turn.transpose()),
                ground: GroundObservation::means(
                    setup.markers.len(),
                    self.list.iter().map(GroundImage::to_observation),
                ),
            },
            variance_factor: fit.omega / fit.redundancy.max(1) as f64,
            redundancy: fit.redundancy,
            used: self.list.iter().map(|s| (s.clone(), residual(s))).collect(),
            taken_out,
        }
    }
}

/// Where the camera sees a surveyed point on ground, through the window where that is stated; camera frame.
fn apparent_point(
    setup: &Setup,
    rotation: &Rotation3<f64>,
    survey_m: &Vector3<f64>,
    centre_m: &Vector3<f64>,
) -> Vector3<f64> {
    let p = rotation * (survey_m - centre_m);
    Plate::from_window(setup.window.as_ref(), rotation, false).map_or(p, |pane| pane.apparent_point(&p))
}
