//! Solutions of the problem of named images with the unknowns of one cause free, and the tests of a cause.

use super::super::image_problem::{ImageProblem, MARKERS, WING};
use super::cause::Cause;
use super::subject::Subject;
use crate::estimation::quality::chi_square_limit;
use crate::estimation::{Fit, Problem};
use crate::observation::Estimate;
use crate::ordering::sort_by_value;
use crate::setup::Orientation;
use nalgebra::Rotation3;

/// Normalised residual of an outline of the other kind of marker.
const WRONG_SHAPE: f64 = 5.0;
/// Smallest fraction of a prior variance that the images must determine for a score: less is rounding.
const MIN_DETERMINED: f64 = 1e-6;

/// A subject and, for a frame in flight, the attitude of the ground frames.
#[derive(Clone, Copy)]
pub(super) struct Evidence<'a> {
    pub(super) subject: &'a Subject,
    pub(super) orientation: Option<&'a Orientation>,
}

/// Solution with the unknowns of a cause free.
pub(super) struct CauseFit {
    pub(super) size: Vec<Estimate>,
    pub(super) sum_of_squares: f64,
    pub(super) camera_from_survey: Rotation3<f64>,
    problem: Problem,
    fit: Fit,
}

impl Evidence<'_> {
    /// Returns the number of observations less the unknowns without a cause.
    pub(super) fn redundancy(&self) -> usize {
        let images = self.subject.images.iter();
        let rows: usize = images.map(|i| 2 + usize::from(i.size().is_some())).sum();
        rows.saturating_sub(3)
    }

    /// Solves with the unknowns of a cause free, from `values` of them.
    pub(super) fn solve(&self, cause: Option<Cause>, values: &[f64]) -> Option<CauseFit> {
        let unknowns = cause.map_or(vec![], Cause::unknowns);
        let near = cause.map(|cause| cause.apply(self.subject, values));
        let near = near.as_ref().unwrap_or(self.subject);
        let subject = match unknowns.is_empty() {
            true => near,
            false => self.subject,
        };
        let start = self.subject.start_rotation(near, self.orientation)?;
        let mut problem: ImageProblem = subject.image_problem(start, self.orientation);
        if let Some(Cause::Mark(marker)) = cause {
            problem.wrong_mark = Some(marker);
        }
        let mut freed = problem.with_freed(&unknowns);
        let unit = |column: usize| match column {
            WING => problem.tip_by_curvature(),
            _ => 1.0,
        };
        let given = freed.start.clone();
        for ((column, _), value) in unknowns.iter().zip(values) {
            freed.start[*column] += value / unit(*column);
        }
        let fit = problem.solve(&freed, true)?;
        // The error of a value as configured includes that of a right one.
        let estimate = |(column, _): &(usize, f64)| {
            let variance = fit.covariance[(*column, *column)] + problem.prior_variance(*column);
            Estimate {
                value: (fit.global[*column] - given[*column]) * unit(*column),
                sigma: Some(variance.max(0.0).sqrt() * unit(*column)),
            }
        };
        let wrong = subject
            .images
            .iter()
            .filter(|image| subject.has_wrong_shape(image));
        Some(CauseFit {
            size: unknowns.iter().map(estimate).collect(),
            sum_of_squares: fit.omega + wrong.count() as f64 * WRONG_SHAPE.powi(2),
            camera_from_survey: problem.camera_from_survey(&fit.global),
            problem: freed,
            fit,
        })
    }

    /// Returns the coordinates of the survey with the decrease of the sum of squares if each were free, to first order, the
    /// largest first.
    pub(super) fn score_points(&self, base: &CauseFit) -> Vec<(Cause, f64)> {
        let mut scores: Vec<(Cause, f64)> = vec![];
        for prior in base
            .problem
            .priors
            .iter()
            .filter(|prior| prior.columns[0] >= MARKERS)
        {
            let marker = (prior.columns[0] - MARKERS) / 3;
            // The position of a manual mark is more likely wrong than its marker's survey.
            let is_detected =
                |image: &super::NamedImage| image.marker == marker && image.outline.is_some();
            if !self.subject.images.iter().any(is_detected) {
                continue;
            }
            for (axis, column) in prior.columns.iter().enumerate() {
                let variance = prior.covariance[(axis, axis)];
                let determined = variance - base.fit.covariance[(*column, *column)];
                let score =
                    base.fit.global[*column].powi(2) / determined.max(MIN_DETERMINED * variance);
                scores.push((Cause::Point(marker, axis), score));
            }
        }
        sort_by_value(&mut scores, |one| -one.1);
        scores
    }

    /// Returns the markers whose images have the largest normalised misclosures.
    pub(super) fn worst_images(&self, base: &CauseFit, count: usize) -> Vec<usize> {
        let images = &self.subject.images;
        let square = |k: usize| {
            let wrong = f64::from(u8::from(self.subject.has_wrong_shape(&images[k])));
            wrong * WRONG_SHAPE.powi(2) + base.image_square(k)
        };
        let mut order: Vec<usize> = (0..images.len()).collect();
        sort_by_value(&mut order, |one| -square(*one));
        order
            .iter()
            .take(count)
            .map(|k| images[*k].marker)
            .collect()
    }

    /// Returns the limit of the decrease of the sum of squares by a cause for a level of significance.
    pub(super) fn limit(&self, cause: Cause, alpha: f64) -> f64 {
        let alpha = alpha / cause.alternatives(self.subject.setup.markers.len()) as f64;
        match cause.unknowns().len() {
            0 => -2.0 * alpha.ln(),
            k => chi_square_limit(k as f64, alpha),
        }
    }
}

impl CauseFit {
    /// Returns the sum of the squared normalised misclosures of an image: of its residuals, and of its marker's survey.
    pub(super) fn image_square(&self, image: usize) -> f64 {
        let solved = &self.fit.groups[0].blocks[image];
        let weighted = self.problem.groups[0].blocks[image]
            .covariance
            .clone()
            .cholesky();
        let own = weighted.map_or(0.0, |weight| {
            solved.residuals.dot(&weight.solve(&solved.residuals))
        });
        let survey = self.problem.priors.iter().filter(|prior| {
            prior.columns[0] >= MARKERS && solved.linearised.columns.contains(&prior.columns[0])
        });
        let square = |(k, column): (usize, &usize), covariance: &nalgebra::DMatrix<f64>| {
            self.fit.global[*column].powi(2) / covariance[(k, k)]
        };
        let survey = survey.flat_map(|prior| {
            let columns = prior.columns.iter().enumerate();
            columns.map(|one| square(one, &prior.covariance))
        });
        own + survey.sum::<f64>()
    }
}
