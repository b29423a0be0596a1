//! Least squares of a cause: residuals of the named images with the covariance of all that a setup leaves uncertain.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Rotation3, SVector};

use super::super::attitude::rotation_from_many;
use super::super::beam::WingState;
use super::super::outline::DiscOutline;
use super::super::scene::WingView;
use super::super::wing_state::WING_SIGMAS;
use super::cause::Cause;
use super::subject::{NamedImage, ROWS, Subject, image_covariance};
use crate::estimation::quality::chi_square_limit;
use crate::observation::Estimate;
use crate::ordering::sort_by_value;
use crate::setup::{Orientation, Width};

/// Normalised residual of an outline of the other kind of marker.
const WRONG_SHAPE: f64 = 5.0;
/// Shift for derivatives by a position, m.
const SHIFT_M: f64 = 1e-3;
/// Steps of the differences by the state: three terms of curvature, 1/m, two of twist and three rotations, rad.
const STATE_STEPS: [f64; 8] = [1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6];
/// Number of Gauss-Newton steps after which a solution is taken as it is.
const MAX_ITERATIONS: usize = 15;
/// Number of halvings of a step, after which no shorter one is tried: 1/256 of it.
const MAX_HALVINGS: usize = 8;
/// Decrease of the sum of squares at convergence.
const SETTLED: f64 = 1e-3;

/// Images with the factor of their covariance.
pub(super) struct Evidence<'a> {
    pub(super) subject: Subject,
    /// Attitude of the ground frames, for a frame in flight.
    pub(super) orientation: Option<&'a Orientation>,
    factor: Cholesky<f64, Dyn>,
    /// Derivatives of all rows with respect to a common shift of the markers, 1/m.
    by_shift: DMatrix<f64>,
}

/// Camera and wing at a solution.
#[derive(Clone, Debug)]
pub(super) struct Pose {
    pub(super) camera_from_survey: Rotation3<f64>,
    pub(super) state: WingState,
}

impl Pose {
    /// Returns the rotation from survey to camera, with that of the state.
    pub(super) fn rotation(&self) -> Rotation3<f64> {
        Rotation3::new(self.state.fixed_rows::<3>(5).into_owned()) * self.camera_from_survey
    }
}

/// Solution with the parameters of a cause free.
#[derive(Clone, Debug)]
pub(super) struct CauseFit {
    pub(super) size: Vec<Estimate>,
    pub(super) sum_of_squares: f64,
    pub(super) pose: Pose,
    pub(super) subject: Subject,
    residuals: DVector<f64>,
    /// Derivatives by the state, whitened.
    design: DMatrix<f64>,
}

/// Predicts the outlines of all markers.
pub(super) fn predict_outlines(
    subject: &Subject,
    orientation: Option<&Orientation>,
    pose: &Pose,
) -> Vec<Option<DiscOutline>> {
    let camera_from_survey = subject.turn * pose.camera_from_survey;
    let ground = orientation.map_or(vec![], |o| o.ground.clone());
    let attitude = Orientation {
        camera_from_survey,
        covariance_rad2: None,
        ground,
        templates: vec![],
    };
    let view = WingView::with_beam(
        &subject.setup,
        &attitude,
        orientation.is_some(),
        subject.beam(&attitude),
    );
    let mut state = pose.state;
    state[0] += 3.0 * subject.bend_m / view.beam.length_m.powi(2);
    view.marker_outlines(&state)
}

/// Returns misclosures, observed minus predicted; `None` if a marker is behind the camera.
fn misclosures(
    subject: &Subject,
    orientation: Option<&Orientation>,
    pose: &Pose,
) -> Option<DVector<f64>> {
    let outlines = predict_outlines(subject, orientation, pose);
    let mut all = DVector::zeros(ROWS * subject.images.len());
    for (k, image) in subject.images.iter().enumerate() {
        let predicted = outlines.get(image.marker).copied().flatten()?;
        let off = image.pixel - predicted.point_px;
        let size = image
            .size_px()
            .map_or(0.0, |major| (major / predicted.semi_major_px).ln());
        all.fixed_rows_mut::<ROWS>(ROWS * k)
            .copy_from_slice(&[off.x, off.y, size]);
    }
    all.iter().all(|v| v.is_finite()).then_some(all)
}

impl<'a> Evidence<'a> {
    /// Creates the evidence of a subject; `near`: a subject and a pose at which its images are linearised.
    pub(super) fn new(
        subject: Subject,
        orientation: Option<&'a Orientation>,
        near: (&Subject, &Pose),
    ) -> Option<Self> {
        let (linear, pose) = near;
        let start = misclosures(linear, orientation, pose)?;
        let column = |changed: Subject, step: f64| {
            Some((&start - misclosures(&changed, orientation, pose)?) / step)
        };
        let shifted = |axis: usize| {
            let mut changed = linear.clone();
            changed
                .setup
                .markers
                .iter_mut()
                .for_each(|m| m.position_m[axis] += SHIFT_M);
            column(changed, SHIFT_M)
        };
        let by_shift = DMatrix::from_columns(&[shifted(0)?, shifted(1)?, shifted(2)?]);
        let setup = &linear.setup;
        let mut covariance = image_covariance(linear, orientation.is_some(), &by_shift);
        let shift = if orientation.is_some() {
            setup.uncertainty[Width::MountShift]
        } else {
            0.0
        };
        let centre_m = setup.projection_centre_sigma_m.hypot(shift);
        covariance += &by_shift * by_shift.transpose() * centre_m.powi(2);
        if let Some(lens) = &setup.uncertainty.lens {
            let scales: SVector<f64, 9> = lens.diagonal().map(|v| v.sqrt().max(1e-12));
            let by = |k: usize| {
                let mut changed = linear.clone();
                let mut step = SVector::zeros();
                step[k] = scales[k];
                changed.setup.lens = setup.lens.with_changes(&step);
                column(changed, scales[k])
            };
            let columns: Option<Vec<_>> = (0..9).map(by).collect();
            let by_lens = DMatrix::from_columns(&columns?);
            covariance +=
                &by_lens * DMatrix::from_column_slice(9, 9, lens.as_slice()) * by_lens.transpose();
        }
        let widths: &[(Cause, f64)] = match orientation {
            Some(_) => &[(Cause::ImageScale, setup.uncertainty[Width::FlightScale])],
            None => &[(Cause::Bend, setup.uncertainty[Width::GroundBend])],
        };
        for (cause, sigma) in widths {
            let by = column(cause.apply(linear, &[cause.step()]), cause.step())?;
            covariance += &by * by.transpose() * sigma.powi(2);
        }
        Some(Self {
            subject,
            orientation,
            factor: covariance.cholesky()?,
            by_shift,
        })
    }

    /// Returns the number of observations less the unknowns without a cause.
    pub(super) fn redundancy(&self) -> usize {
        let rows: usize = self
            .subject
            .images
            .iter()
            .map(|i| if i.size_px().is_some() { 3 } else { 2 })
            .sum();
        rows.saturating_sub(3)
    }

    /// Solves with the parameters of a cause free, from `values` of them: Gauss-Newton steps, halved until they help.
    pub(super) fn solve(&self, cause: Option<Cause>, values: &[f64]) -> Option<CauseFit> {
        let states = self.free_states();
        let count = cause.map_or(0, Cause::parameters);
        let unknowns = states.len() + count;
        let mut x = DVector::from_fn(unknowns, |k, _| {
            k.checked_sub(states.len())
                .map_or(0.0, |k| values.get(k).copied().unwrap_or(0.0))
        });
        let apply = |x: &DVector<f64>| {
            let values = &x.as_slice()[states.len()..];
            cause.map_or_else(
                || self.subject.clone(),
                |cause| cause.apply(&self.subject, values),
            )
        };
        let start = start_pose(&apply(&x), self.orientation)?;
        let place = |x: &DVector<f64>| {
            let mut pose = start.clone();
            states
                .clone()
                .enumerate()
                .for_each(|(k, state)| pose.state[state] = x[k]);
            pose
        };
        let evaluate = |x: &DVector<f64>| self.whitened(&apply(x), &place(x));
        let weights = self.prior_weights(cause, unknowns);
        let cost =
            |r: &DVector<f64>, x: &DVector<f64>| r.norm_squared() + weights.component_mul(x).dot(x);
        let mut now = evaluate(&x)?;
        for iteration in 0.. {
            let column = |k: usize| {
                let step = if k < states.len() {
                    STATE_STEPS[states.start + k]
                } else {
                    cause.map_or(1.0, Cause::step)
                };
                let mut other = x.clone();
                other[k] += step;
                Some((&now - evaluate(&other)?) / step)
            };
            let columns: Option<Vec<DVector<f64>>> = (0..unknowns).map(column).collect();
            let design = DMatrix::from_columns(&columns?);
            let normal = design.transpose() * &design + DMatrix::from_diagonal(&weights);
            let cholesky = normal.cholesky()?;
            let mut step = cholesky.solve(&(design.transpose() * &now - weights.component_mul(&x)));
            let before = cost(&now, &x);
            let mut better = None;
            for _ in 0..MAX_HALVINGS {
                let next = &x + &step;
                better = evaluate(&next)
                    .map(|r| (cost(&r, &next), r, next))
                    .filter(|(cost, ..)| *cost < before);
                if better.is_some() {
                    break;
                }
                step *= 0.5;
            }
            let after = better.as_ref().map_or(before, |(cost, ..)| *cost);
            if let Some((_, r, next)) = better {
                (now, x) = (r, next);
            }
            if before - after < SETTLED * (1.0 + 1e-6 * after) || iteration == MAX_ITERATIONS {
                let covariance = cholesky.inverse();
                let estimate = |k: usize| Estimate {
                    value: x[k],
                    sigma: Some(covariance[(k, k)].max(0.0).sqrt()),
                };
                return Some(CauseFit {
                    size: (states.len()..unknowns).map(estimate).collect(),
                    sum_of_squares: after,
                    pose: place(&x),
                    subject: apply(&x),
                    design: design.columns(0, states.len()).into_owned(),
                    residuals: now,
                });
            }
        }
        None
    }

    /// Estimates a single coordinate of each marker in one linear step from a solution, and returns the causes with the
    /// decrease of the sum of squares, the largest first.
    pub(super) fn score_points(&self, base: &CauseFit) -> Vec<(Cause, f64)> {
        let Some(normal) = (base.design.transpose() * &base.design).cholesky() else {
            return vec![];
        };
        // The position of a manual mark is more likely wrong than its marker's survey.
        let detected = self
            .subject
            .images
            .iter()
            .filter(|image| image.outline.is_some());
        let mut markers: Vec<usize> = detected.map(|i| i.marker).collect();
        markers.sort_unstable();
        markers.dedup();
        let mut scores: Vec<(Cause, f64)> = vec![];
        for marker in markers {
            for axis in 0..3 {
                let mut by = DVector::zeros(self.by_shift.nrows());
                for k in (0..self.subject.images.len())
                    .filter(|k| self.subject.images[*k].marker == marker)
                {
                    by.rows_mut(ROWS * k, ROWS)
                        .copy_from(&self.by_shift.view((ROWS * k, axis), (ROWS, 1)));
                }
                let Some(by) = self.factor.l_dirty().solve_lower_triangular(&by) else {
                    continue;
                };
                let mut by = with_row(by, 0.0);
                by -= &base.design * normal.solve(&(base.design.transpose() * &by));
                let score =
                    by.dot(&base.residuals).powi(2) / by.norm_squared().max(f64::MIN_POSITIVE);
                scores.push((Cause::Point(marker, axis), score));
            }
        }
        sort_by_value(&mut scores, |one| -one.1);
        scores
    }

    /// Returns the markers whose images have the largest whitened misclosures.
    pub(super) fn worst_images(&self, base: &CauseFit, count: usize) -> Vec<usize> {
        let images = &self.subject.images;
        let square = |k: usize| {
            let wrong = if self.subject.has_wrong_shape(&images[k]) {
                WRONG_SHAPE.powi(2)
            } else {
                0.0
            };
            wrong + self.image_square(base, k)
        };
        let mut order: Vec<usize> = (0..images.len()).collect();
        sort_by_value(&mut order, |one| -square(*one));
        order
            .iter()
            .take(count)
            .map(|k| images[*k].marker)
            .collect()
    }

    /// Returns the sum of the squared normalised misclosures of an image, given the images before it.
    pub(super) fn image_square(&self, fit: &CauseFit, image: usize) -> f64 {
        fit.residuals.rows(ROWS * image, ROWS).norm_squared()
    }

    /// Returns the limit of the decrease of the sum of squares by a cause for a level of significance.
    pub(super) fn limit(&self, cause: Cause, alpha: f64) -> f64 {
        let alpha = alpha / cause.alternatives(self.subject.setup.markers.len()) as f64;
        match cause.parameters() {
            0 => -2.0 * alpha.ln(),
            k => chi_square_limit(k as f64, alpha),
        }
    }

    /// Returns the columns of the state that are free: all in flight, the rotation on the ground.
    fn free_states(&self) -> std::ops::Range<usize> {
        if self.orientation.is_some() {
            0..8
        } else {
            5..8
        }
    }

    /// Returns the prior weights of state and cause, 0 without a prior.
    fn prior_weights(&self, cause: Option<Cause>, unknowns: usize) -> DVector<f64> {
        let mut sigmas = DVector::repeat(unknowns, f64::INFINITY);
        let states = self.free_states().len();
        if let Some(orientation) = self.orientation {
            sigmas
                .rows_mut(0, WING_SIGMAS.len())
                .copy_from_slice(&WING_SIGMAS);
            let turn = WingView::in_flight(&self.subject.setup, orientation).turn_sigmas();
            sigmas.rows_mut(WING_SIGMAS.len(), 3).copy_from_slice(&turn);
        }
        (states..unknowns)
            .for_each(|k| sigmas[k] = cause.map_or(1.0, |cause| cause.prior_sigma(k - states)));
        sigmas.map(|sigma| sigma.powi(-2))
    }

    fn whitened(&self, subject: &Subject, pose: &Pose) -> Option<DVector<f64>> {
        let mut off = misclosures(subject, self.orientation, pose)?;
        off = self.factor.l_dirty().solve_lower_triangular(&off)?;
        let wrong = subject
            .images
            .iter()
            .filter(|image| subject.has_wrong_shape(image))
            .count();
        Some(with_row(off, WRONG_SHAPE * (wrong as f64).sqrt()))
    }
}

/// Returns the attitude of the ground frames, or for a ground frame the rotation that fits the directions best.
pub(super) fn start_pose(subject: &Subject, orientation: Option<&Orientation>) -> Option<Pose> {
    let fitted = || {
        let setup = &subject.setup;
        let direction = |image: &NamedImage| {
            let target = setup.markers.get(image.marker)?.position_m - setup.projection_centre_m;
            Some((
                target.try_normalize(1e-9)?,
                setup.lens.ray(&image.pixel).ok()?,
                1.0,
            ))
        };
        rotation_from_many(subject.images.iter().filter_map(direction))
    };
    let camera_from_survey = orientation.map(|o| o.camera_from_survey).or_else(fitted)?;
    Some(Pose {
        camera_from_survey,
        state: WingState::zeros(),
    })
}

/// Appends a value.
fn with_row(vector: DVector<f64>, value: f64) -> DVector<f64> {
    let last = vector.len();
    vector.insert_row(last, value)
}
