//! Camera, the board's form and its poses by least squares (bundle adjustment; Triggs et al. 2000).
//!
//! Every pixel is one observation of one pose: the normal equations are an arrow of 6 x 6 blocks, and the
//! poses leave by their Schur complement. Steps are damped (Levenberg and Marquardt) until the sum of squares
//! falls; at the end no damping is left in the covariance.

use nalgebra::{Matrix2, Matrix6, SMatrix, SVector, Vector2, Vector6};

use super::adjust::{self, Pose};
use super::shape::{FORM, Form, Shape};
use super::{BoardPoint, View, quality};
use crate::measure::geometry::Lens;

/// Interior parameters of Brown's model, in the order fx fy cx cy k1 k2 k3 p1 p2.
pub(super) const BROWN: usize = 9;
/// With those of the rational model's denominator, k4 k5 k6; the board's form follows.
pub(super) const INTERIOR: usize = BROWN + 3;
/// All of them.
pub(super) const GLOBAL: usize = INTERIOR + FORM;
/// Index of the board's stretch.
pub(super) const STRETCH: usize = INTERIOR + 2;

pub(super) type Global = SVector<f64, GLOBAL>;
pub(super) type Covariance = SMatrix<f64, GLOBAL, GLOBAL>;
/// The board's form among them.
pub(super) fn form_of(global: &Global) -> Form {
    global.fixed_rows::<FORM>(INTERIOR).into()
}

type Cross = SMatrix<f64, GLOBAL, 6>;

/// Steps at most, so that an adjustment that creeps ends too.
const ITERATIONS: usize = 500;
/// Fall of the sum of squares that a full step still promises, below which it is at the end: a step of a
/// thousandth of a standard deviation.
const CONVERGED: f64 = 1e-6;
/// The same where rounding or a long flat valley ends the steps before: a tenth of a standard deviation.
const NEARLY: f64 = 1e-2;
/// What rounding may take from a sum of squares: where nothing else is left of it, the boards were parallel.
const ROUNDING: f64 = 1e-12;
/// Levenberg's and Marquardt's damping, a share of the normal matrix' diagonal: to begin with, and its bounds, far below
/// and above what changes a step in double precision.
const FIRST_DAMPING: f64 = 1e-4;
/// See [`FIRST_DAMPING`].
const LEAST_DAMPING: f64 = 1e-12;
/// See [`FIRST_DAMPING`].
const MOST_DAMPING: f64 = 1e12;

/// Knowledge of a parameter from elsewhere.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    pub index: usize,
    pub mean: f64,
    pub sigma: f64,
}

/// What is adjusted.
pub(super) struct Bundle<'a> {
    pub views: &'a [&'a View],
    pub size: (u32, u32),
    pub shape: Shape,
    pub priors: Vec<Prior>,
    /// Parameters that keep their start.
    pub held: [bool; GLOBAL],
    /// Per view: standard deviation that its points have beyond their own, px.
    pub common_px: &'a [f64],
}

/// A solution.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub global: Global,
    pub poses: Vec<Pose>,
    /// Of the global parameters, a priori; 0 where held.
    pub covariance: Covariance,
    /// Weighted sum of squares, priors included.
    pub omega: f64,
    /// Observations and priors less unknowns.
    pub redundancy: usize,
}

impl Solution {
    /// Of the unit weight, a posteriori.
    pub(super) fn variance_factor(&self) -> f64 {
        self.omega / self.redundancy as f64
    }
}

struct ViewNormal {
    own: Matrix6<f64>,
    cross: Cross,
    right: Vector6<f64>,
}

struct Normal {
    global: Covariance,
    right: Global,
    views: Vec<ViewNormal>,
    omega: f64,
}

impl Bundle<'_> {
    /// From a start; `None` where no step leads further down, a board comes to lie behind the camera, or
    /// something stays undetermined.
    pub(super) fn solve(&self, start: Global, poses: &[Pose]) -> Option<Solution> {
        let (mut global, mut poses) = (start, poses.to_vec());
        let mut normal = self.normal(&global, &poses)?;
        let mut damping = FIRST_DAMPING;
        for _ in 0..ITERATIONS {
            let tried = normal.step(damping, &self.held).and_then(|(step, turns)| {
                let next: Vec<Pose> = poses.iter().zip(&turns).map(|(p, t)| p.moved(t)).collect();
                let at = self
                    .normal(&(global + step), &next)
                    .filter(|n| n.omega <= normal.omega * (1.0 + 1e-12))?;
                Some((global + step, next, at))
            });
            match tried {
                Some((g, p, n)) => {
                    (global, poses, normal) = (g, p, n);
                    damping = (damping * 0.1).max(LEAST_DAMPING);
                }
                None if damping < MOST_DAMPING => damping *= 10.0,
                None => break,
            }
            if normal.promise(&self.held).is_some_and(|p| p < CONVERGED) {
                return self.outcome(global, poses, &normal);
            }
        }
        let near = normal.promise(&self.held).is_some_and(|p| p < NEARLY);
        near.then(|| self.outcome(global, poses, &normal)).flatten()
    }

    fn outcome(&self, global: Global, poses: Vec<Pose>, normal: &Normal) -> Option<Solution> {
        let covariance = inverse(&masked(normal.reduced(0.0)?.0, &self.held))?;
        let free = |k: usize| if self.held[k] { 0.0 } else { 1.0 };
        let covariance = Covariance::from_fn(|i, j| covariance[(i, j)] * free(i) * free(j));
        let points: usize = self.views.iter().map(|v| v.len()).sum();
        let unknowns = self.held.iter().filter(|h| !**h).count() + 6 * self.views.len();
        let priors = self.priors.iter().filter(|p| !self.held[p.index]).count();
        let redundancy = (2 * points + priors).checked_sub(unknowns).filter(|r| *r > 0)?;
        Some(Solution { global, poses, covariance, omega: normal.omega, redundancy })
    }

    fn normal(&self, global: &Global, poses: &[Pose]) -> Option<Normal> {
        let lens = adjust::with_parameters(self.size, global);
        let mut all =
            Normal { global: Covariance::zeros(), right: Global::zeros(), views: vec![], omega: 0.0 };
        for ((pose, view), common_px) in poses.iter().zip(self.views).zip(self.common_px) {
            let mut own =
                ViewNormal { own: Matrix6::zeros(), cross: Cross::zeros(), right: Vector6::zeros() };
            for p in view.iter() {
                let weight = adjust::with_common(&p.covariance_px2, *common_px).try_inverse()?;
                self.point(&lens, (global, pose), p, &weight, (&mut own, &mut all))?;
            }
            all.views.push(own);
        }
        for prior in self.priors.iter().filter(|p| !self.held[p.index]) {
            let weight = prior.sigma.powi(-2);
            let off = prior.mean - global[prior.index];
            all.global[(prior.index, prior.index)] += weight;
            all.right[prior.index] += weight * off;
            all.omega += weight * off * off;
        }
        all.omega.is_finite().then_some(all)
    }

    fn point(
        &self,
        lens: &Lens,
        (global, pose): (&Global, &Pose),
        p: &BoardPoint,
        weight: &Matrix2<f64>,
        (own, all): (&mut ViewNormal, &mut Normal),
    ) -> Option<()> {
        let point = pose.apply(&self.shape.point(&p.board_m, &form_of(global)));
        let (pixel, by_point) = lens.project_with_jacobian(&point)?;
        let (by_motion, by_lens) = quality::jacobians(lens, &point)?;
        // The camera's motion turns about the camera; a pose's turn here does the same.
        let mut by = SMatrix::<f64, 2, GLOBAL>::zeros();
        by.fixed_columns_mut::<INTERIOR>(0).copy_from(&by_lens);
        let by_form = by_point * pose.camera_from_board.matrix() * self.shape.by_form(&p.board_m);
        by.fixed_columns_mut::<FORM>(INTERIOR).copy_from(&by_form);
        let residual: Vector2<f64> = p.pixel - pixel;
        let (weighted, turned) = (by.transpose() * weight, by_motion.transpose() * weight);
        all.global += weighted * by;
        all.right += weighted * residual;
        own.cross += weighted * by_motion;
        own.own += turned * by_motion;
        own.right += turned * residual;
        all.omega += residual.dot(&(weight * residual));
        Some(())
    }
}

impl Normal {
    /// Normal equations of the global parameters alone.
    fn reduced(&self, damping: f64) -> Option<(Covariance, Global)> {
        let mut matrix = self.global;
        (0..GLOBAL).for_each(|k| matrix[(k, k)] *= 1.0 + damping + ROUNDING);
        let mut right = self.right;
        for v in &self.views {
            let solved = v.damped(damping).cholesky()?;
            matrix -= v.cross * solved.solve(&v.cross.transpose());
            right -= v.cross * solved.solve(&v.right);
        }
        Some((matrix, right))
    }

    fn step(&self, damping: f64, held: &[bool; GLOBAL]) -> Option<(Global, Vec<Vector6<f64>>)> {
        let (matrix, right) = self.reduced(damping)?;
        let step = inverse(&masked(matrix, held))? * masked_vector(right, held);
        let back = |v: &ViewNormal| {
            Some(v.damped(damping).cholesky()?.solve(&(v.right - v.cross.transpose() * step)))
        };
        Some((step, self.views.iter().map(back).collect::<Option<_>>()?))
    }

    /// By how much an undamped step would lessen the sum of squares.
    fn promise(&self, held: &[bool; GLOBAL]) -> Option<f64> {
        let (step, turns) = self.step(0.0, held)?;
        let own: f64 = self.views.iter().zip(&turns).map(|(v, t)| v.right.dot(t)).sum();
        Some(masked_vector(self.right, held).dot(&step) + own)
    }
}

impl ViewNormal {
    fn damped(&self, damping: f64) -> Matrix6<f64> {
        let mut own = self.own;
        (0..6).for_each(|k| own[(k, k)] *= 1.0 + damping);
        own
    }
}

fn masked(mut matrix: Covariance, held: &[bool; GLOBAL]) -> Covariance {
    for k in (0..GLOBAL).filter(|k| held[*k]) {
        matrix.row_mut(k).fill(0.0);
        matrix.column_mut(k).fill(0.0);
        matrix[(k, k)] = 1.0;
    }
    matrix
}

fn masked_vector(mut right: Global, held: &[bool; GLOBAL]) -> Global {
    (0..GLOBAL).filter(|k| held[*k]).for_each(|k| right[k] = 0.0);
    right
}

/// Of a symmetric matrix whose parameters have very different units.
fn inverse(matrix: &Covariance) -> Option<Covariance> {
    let scale = matrix.diagonal().map(|d| d.sqrt().recip());
    let scales = scale * scale.transpose();
    let scaled = matrix.component_mul(&scales).cholesky()?;
    Some(scaled.inverse().component_mul(&scales))
}
