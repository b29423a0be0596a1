//! Least squares of the ground frames for the rotation.

use nalgebra::{Rotation3, Vector2};

use super::image_problem::{FREE, ImageContext, ImageProblem, NamedImage, WING};
use super::scene::mahalanobis_squared;
use crate::environment::apparent_point;
use crate::estimation::Fit;
use crate::geometry::left_jacobian;
use crate::observation::{Estimate, Observation};
use crate::setup::{Orientation, Setup};

/// Gate of a residual: chi-square of two degrees of freedom, 1e-4.
const GATE: f64 = 18.4;

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

/// Adjusts the orientation and rejects the worst image until all residuals pass the test.
pub(super) fn adjust_orientation(
    setup: &Setup,
    start: &Rotation3<f64>,
    mut list: Vec<GroundImage>,
) -> Option<AdjustedOrientation> {
    let (problem, fit, rejected) = adjust_without_outliers(setup, start, &mut list, &[])?;
    let rotation = problem.camera_from_survey(&fit.global);
    let residual = |seen: &Observation| {
        let ground = setup.markers[seen.marker].position_m - setup.projection_centre_m;
        let p = apparent_point(setup.window.as_ref(), &rotation, &ground, false);
        let pixel = setup.lens.project(&p);
        pixel.map_or(Vector2::zeros(), |pixel| seen.pixel - pixel)
    };
    let by_turn = left_jacobian(&fit.global.fixed_rows::<3>(0).into_owned());
    let covariance = fit.covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let ground = list.iter().map(|image| image.seen);
    Some(AdjustedOrientation {
        orientation: Orientation {
            camera_from_survey: rotation,
            covariance_rad2: Some(by_turn * covariance * by_turn.transpose()),
            ground: Observation::mean_observations(setup.markers.len(), ground),
            templates: vec![],
        },
        variance_factor: fit.omega / fit.redundancy.max(1) as f64,
        redundancy: fit.redundancy,
        used: list
            .iter()
            .map(|s| (s.clone(), residual(&s.seen)))
            .collect(),
        rejected,
    })
}

/// Estimates a bend of the wing since the survey with its standard deviation, at the tip, m: an additional unknown without
/// a prior.
pub(super) fn estimate_bend(
    setup: &Setup,
    start: &Rotation3<f64>,
    mut list: Vec<GroundImage>,
) -> Option<Estimate> {
    let (problem, fit, _) = adjust_without_outliers(setup, start, &mut list, &[(WING, FREE)])?;
    let factor = fit.variance_factor().map_or(1.0, |factor| factor.max(1.0));
    let variance = factor * fit.covariance[(WING, WING)].max(0.0);
    Some(Estimate {
        value: problem.tip_by_curvature() * fit.global[WING],
        sigma: Some(problem.tip_by_curvature() * variance.sqrt()),
    })
}

/// Solves with some unknowns free; moves rejected images from the list to the result.
fn adjust_without_outliers<'a>(
    setup: &'a Setup,
    start: &Rotation3<f64>,
    list: &mut Vec<GroundImage>,
    freed: &[(usize, f64)],
) -> Option<(ImageProblem<'a>, Fit, Vec<GroundImage>)> {
    let mut rejected = Vec::new();
    loop {
        let images = list.iter().map(|image| NamedImage::new(&image.seen, None));
        let context = ImageContext::Orientation;
        let problem = ImageProblem::new(setup, images.collect(), *start, context, 0.0);
        let fit = problem.solve(&problem.with_freed(freed), false)?;
        let tests = (0..list.len()).map(|k| (residual_test(&fit, &list[k], k), k));
        match tests.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((t, k)) if t > GATE && list.len() > 2 => rejected.push(list.remove(k)),
            _ => return Some((problem, fit, rejected)),
        }
    }
}

/// Returns `v' Qv^-1 v` of an image: chi-square with two degrees of freedom unless it is an outlier.
fn residual_test(fit: &Fit, image: &GroundImage, k: usize) -> f64 {
    let residual = &fit.groups[0].blocks[k].residuals;
    let adjusted = fit.adjusted_covariance(0, k);
    mahalanobis_squared(
        &Vector2::new(residual[0], residual[1]),
        &(image.seen.covariance_px2 - adjusted.fixed_view::<2, 2>(0, 0)),
    )
}
