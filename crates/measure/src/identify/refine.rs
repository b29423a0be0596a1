//! Least squares of the ground frames for the rotation; survey and projection centre have their configured standard
//! deviations. Their errors are common to all frames, so more frames do not reduce them.

use nalgebra::{DMatrix, DVector, Rotation3, Vector2, Vector3};

use super::scene::mahalanobis_squared;
use crate::environment::apparent_point;
use crate::estimation::{
    Block, BlockPoint, EstimationError, Fit, Group, Linearised, Prior, Problem, solve,
};
use crate::geometry::{cross_matrix, left_jacobian};
use crate::observation::{Estimate, Observation};
use crate::setup::{Orientation, Setup};

/// Gate of a residual: chi-square of two degrees of freedom, 1e-4.
const GATE: f64 = 18.4;
/// Smallest standard deviation of a surveyed point, m.
const MIN_SIGMA_M: f64 = 1e-5;

/// A marker's image in a ground frame, perspective bias removed.
#[derive(Clone, Debug)]
pub(super) struct GroundImage {
    pub(super) frame: usize,
    pub(super) detection: usize,
    pub(super) seen: Observation,
}

pub(super) struct AdjustedOrientation {
    pub(super) orientation: Orientation,
    pub(super) variance_factor: f64,
    pub(super) redundancy: usize,
    /// Images used, with residuals relative to the survey as given (observed minus computed), px.
    pub(super) used: Vec<(GroundImage, Vector2<f64>)>,
    pub(super) rejected: Vec<GroundImage>,
}

/// First columns of the unknowns after the small rotation: corrections of the projection centre and of every marker.
const CENTRE: usize = 3;
const MARKERS: usize = 6;
const MISSING: &str = "the identified markers do not determine the rotation";

/// Least-squares adjustment of the ground frames.
struct OrientationAdjustment<'a> {
    setup: &'a Setup,
    /// Rotation from survey to camera frame to which the small rotation is added.
    start: Rotation3<f64>,
    /// Displacement of each marker by a bend of the wing, survey frame, m per m at the tip; empty if no bend is estimated.
    bend: &'a [Vector3<f64>],
    list: Vec<GroundImage>,
}

/// Adjusts the orientation and rejects the worst image until all residuals pass the test.
pub(super) fn adjust_orientation(
    setup: &Setup,
    start: &Rotation3<f64>,
    list: Vec<GroundImage>,
) -> Option<AdjustedOrientation> {
    let mut adjustment = OrientationAdjustment {
        setup,
        start: *start,
        bend: &[],
        list,
    };
    let (fit, rejected) = adjustment.adjust_without_outliers()?;
    Some(adjustment.into_adjusted_orientation(&fit, rejected))
}

/// Estimates a bend of the wing since the survey with its standard deviation, at the tip, m: an additional unknown without
/// a prior. `by_bend`: displacement of each marker, survey frame, m per m.
pub(super) fn estimate_bend(
    setup: &Setup,
    start: &Rotation3<f64>,
    by_bend: &[Vector3<f64>],
    list: Vec<GroundImage>,
) -> Option<Estimate> {
    let mut adjustment = OrientationAdjustment {
        setup,
        start: *start,
        bend: by_bend,
        list,
    };
    let (fit, _) = adjustment.adjust_without_outliers()?;
    let column = adjustment.bend_column();
    let scale = fit
        .variance_factor()
        .map_or(1.0, |factor| factor.max(1.0))
        .sqrt();
    let sigma = scale * fit.covariance[(column, column)].max(0.0).sqrt();
    Some(Estimate {
        value: fit.global[column],
        sigma: Some(sigma),
    })
}

impl OrientationAdjustment<'_> {
    fn adjust_without_outliers(&mut self) -> Option<(Fit, Vec<GroundImage>)> {
        let mut rejected = Vec::new();
        loop {
            let fit = self.adjust_once()?;
            let tests = (0..self.list.len()).map(|k| (self.residual_test(&fit, k), k));
            match tests.max_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((t, k)) if t > GATE && self.list.len() > 2 => {
                    rejected.push(self.list.remove(k))
                }
                _ => return Some((fit, rejected)),
            }
        }
    }

    /// Returns the column of the bend, the last one.
    fn bend_column(&self) -> usize {
        MARKERS + 3 * self.setup.markers.len()
    }

    fn adjust_once(&self) -> Option<Fit> {
        let Self { setup, list, .. } = self;
        let unknowns = self.bend_column() + usize::from(!self.bend.is_empty());
        let block = |image: &GroundImage| Block {
            observed: DVector::from_column_slice(image.seen.pixel.as_slice()),
            covariance: DMatrix::from_column_slice(2, 2, image.seen.covariance_px2.as_slice()),
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

    fn linearise(&self, at: &BlockPoint) -> Result<Linearised, EstimationError> {
        let Self { setup, list, .. } = self;
        let behind = || EstimationError::Input("a marker is behind the camera".into());
        let marker = list[at.block].seen.marker;
        let first = MARKERS + 3 * marker;
        let turn = at.global.fixed_rows::<3>(0).into_owned();
        let rotation = Rotation3::new(turn) * self.start;
        let centre_m = setup.projection_centre_m + at.global.fixed_rows::<3>(CENTRE);
        let by_bend = self.bend.get(marker);
        let bent_m = by_bend.map_or_else(Vector3::zeros, |by| by * at.global[self.bend_column()]);
        let marker_m = setup.markers[marker].position_m + at.global.fixed_rows::<3>(first) + bent_m;
        let p = apparent_point(
            setup.window.as_ref(),
            &rotation,
            &(marker_m - centre_m),
            false,
        );
        let (pixel, by_point) = setup.lens.project_with_jacobian(&p).ok_or_else(behind)?;
        let by_shift = by_point * rotation.matrix();
        let bend = by_bend.map(|_| self.bend_column());
        let columns = (0..MARKERS).chain(first..first + 3).chain(bend);
        let mut out = Linearised::empty(2, columns.collect(), 0, 2);
        out.global
            .fixed_columns_mut::<3>(0)
            .copy_from(&(by_point * -cross_matrix(&p) * left_jacobian(&turn)));
        out.global
            .fixed_columns_mut::<3>(CENTRE)
            .copy_from(&-by_shift);
        out.global
            .fixed_columns_mut::<3>(MARKERS)
            .copy_from(&by_shift);
        if let Some(by) = by_bend {
            out.global
                .column_mut(MARKERS + 3)
                .copy_from(&(by_shift * by));
        }
        out.misclosure.copy_from(&(pixel - at.observed));
        out.observations.fill_with_identity();
        out.observations.neg_mut();
        Ok(out)
    }

    /// Returns `v' Qv^-1 v` of an image: chi-square with two degrees of freedom unless it is an outlier.
    fn residual_test(&self, fit: &Fit, k: usize) -> f64 {
        let residual = &fit.groups[0].blocks[k].residuals;
        let adjusted = fit
            .adjusted_covariance(0, k)
            .fixed_view::<2, 2>(0, 0)
            .into_owned();
        mahalanobis_squared(
            &Vector2::new(residual[0], residual[1]),
            &(self.list[k].seen.covariance_px2 - adjusted),
        )
    }

    fn into_adjusted_orientation(
        self,
        fit: &Fit,
        rejected: Vec<GroundImage>,
    ) -> AdjustedOrientation {
        let (setup, rotation) = (self.setup, self.camera_from_survey(fit));
        let residual = |GroundImage { seen, .. }: &GroundImage| {
            let ground = setup.markers[seen.marker].position_m;
            let p = apparent_point(
                setup.window.as_ref(),
                &rotation,
                &(ground - setup.projection_centre_m),
                false,
            );
            setup
                .lens
                .project(&p)
                .map_or(Vector2::zeros(), |pixel| seen.pixel - pixel)
        };
        let by_turn = left_jacobian(&fit.global.fixed_rows::<3>(0).into_owned());
        let covariance = fit.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        AdjustedOrientation {
            orientation: Orientation {
                camera_from_survey: rotation,
                covariance_rad2: Some(by_turn * covariance * by_turn.transpose()),
                ground: Observation::mean_observations(
                    setup.markers.len(),
                    self.list.iter().map(|image| image.seen),
                ),
                templates: vec![],
            },
            variance_factor: fit.omega / fit.redundancy.max(1) as f64,
            redundancy: fit.redundancy,
            used: self.list.iter().map(|s| (s.clone(), residual(s))).collect(),
            rejected,
        }
    }
}
