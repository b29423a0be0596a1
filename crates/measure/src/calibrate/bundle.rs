//! Camera, the board's form and its poses as one least-squares problem: few shared parameters, many images with a pose of
//! their own, thousands of points (bundle adjustment; Triggs et al. 2000).
//!
//! The normal equations are an arrow of small blocks of fixed sizes, and the poses are eliminated by their Schur complement.
//! Steps are damped (Levenberg and Marquardt) until the sum of squares falls; the covariance is computed without damping.

use nalgebra::{Matrix2, Matrix6, SMatrix, Vector2, Vector6};

use super::model::{
    BoardPose, FORM, GLOBAL, GlobalCovariance, GlobalParameters, INTERIOR, ImageSize,
    ProjectionJacobians, ScalarPrior, add_common_variance, board_form, lens_from_parameters,
    projection_jacobians,
};
use super::shape::BoardShape;
use super::{BoardPoint, BoardView};
use crate::geometry::Lens;

/// Maximum number of steps, so that a slowly creeping adjustment ends too.
const MAX_ITERATIONS: usize = 500;
/// Predicted decrease of the sum of squares by a full step below which the iteration has converged: a step of 0.001
/// standard deviations.
const CONVERGED: f64 = 1e-6;
/// Predicted decrease that is accepted if rounding or a long flat valley ends the steps early: a step of 0.1 standard
/// deviations.
const NEARLY_CONVERGED: f64 = 1e-2;
/// Relative rounding error of a sum of squares. If nothing else is left of it, camera and poses are inseparable.
const ROUNDING: f64 = 1e-12;
/// First damping of Levenberg and Marquardt, as a fraction of the normal matrix' diagonal.
const FIRST_DAMPING: f64 = 1e-4;
/// Lower bound of the damping, far below anything that changes a step in double precision.
const MIN_DAMPING: f64 = 1e-12;
/// Upper bound of the damping, beyond which no step changes anything in double precision.
const MAX_DAMPING: f64 = 1e12;
/// Number of parameters of a pose.
const POSE: usize = 6;

/// Observations and priors of one bundle adjustment.
pub(super) struct BoardBundle<'a> {
    pub views: &'a [&'a BoardView],
    pub size: ImageSize,
    pub shape: BoardShape,
    /// Standard deviation that the points of each view have in addition to their own, px.
    pub common_px: &'a [f64],
    /// Priors; those of fixed parameters are ignored.
    pub priors: &'a [ScalarPrior],
    /// Shared parameters that keep their start.
    pub fixed: &'a [bool; GLOBAL],
}

/// Solution of a bundle adjustment.
#[derive(Clone, Debug)]
pub(super) struct BundleSolution {
    pub global: GlobalParameters,
    /// Covariance of the shared parameters, a priori; 0 for fixed ones.
    pub covariance: GlobalCovariance,
    /// Weighted sum of squares, priors included.
    pub omega: f64,
    /// Observations and priors minus unknowns.
    pub redundancy: usize,
}

impl BundleSolution {
    /// Returns the a-posteriori variance of unit weight.
    pub(super) fn variance_factor(&self) -> f64 {
        self.omega / self.redundancy as f64
    }

    /// Returns the covariance of the shared parameters, scaled by the residuals.
    pub(super) fn scaled_covariance(&self) -> GlobalCovariance {
        self.covariance * self.variance_factor()
    }
}

impl BoardBundle<'_> {
    /// Minimises the sum of squares from a start; returns the poses too. `None` if no step decreases it, a point has no image, or a parameter stays
    /// undetermined.
    pub(super) fn solve(
        &self,
        mut global: GlobalParameters,
        poses: &[BoardPose],
    ) -> Option<(BundleSolution, Vec<BoardPose>)> {
        let mut poses = poses.to_vec();
        let mut equations = self.assemble(&global, &poses)?;
        let mut damping = FIRST_DAMPING;
        for _ in 0..MAX_ITERATIONS {
            let trial =
                equations
                    .solve_damped_step(damping, self.fixed)
                    .and_then(|(step, pose_steps)| {
                        let next: Vec<_> = poses
                            .iter()
                            .zip(&pose_steps)
                            .map(|(pose, s)| pose.moved(s))
                            .collect();
                        let at = self
                            .assemble(&(global + step), &next)
                            .filter(|n| n.omega <= equations.omega * (1.0 + ROUNDING))?;
                        Some((global + step, next, at))
                    });
            match trial {
                Some(next) => {
                    (global, poses, equations) = next;
                    damping = (damping * 0.1).max(MIN_DAMPING);
                }
                None if damping < MAX_DAMPING => damping *= 10.0,
                None => break,
            }
            if equations
                .predicted_decrease(self.fixed)
                .is_some_and(|p| p < CONVERGED)
            {
                return self.build_solution(&equations, global, poses);
            }
        }
        let near = equations
            .predicted_decrease(self.fixed)
            .is_some_and(|p| p < NEARLY_CONVERGED);
        near.then(|| self.build_solution(&equations, global, poses))
            .flatten()
    }

    fn free_priors(&self) -> impl Iterator<Item = &ScalarPrior> {
        self.priors.iter().filter(|p| !self.fixed[p.index])
    }

    /// Returns the normal equations at these parameters; `None` if a point has no image.
    fn assemble(&self, global: &GlobalParameters, poses: &[BoardPose]) -> Option<BundleEquations> {
        let lens = lens_from_parameters(self.size, global);
        let mut all = BundleEquations::default();
        for ((pose, view), common_px) in poses.iter().zip(self.views).zip(self.common_px) {
            let mut own = PoseEquations::default();
            for p in view.iter() {
                all.add_point(
                    &mut own,
                    self.linearise_point(&lens, global, pose, p, *common_px)?,
                );
            }
            all.poses.push(own);
        }
        for prior in self.free_priors() {
            let weight = prior.sigma.powi(-2);
            let off = prior.mean - global[prior.index];
            all.global[(prior.index, prior.index)] += weight;
            all.right[prior.index] += weight * off;
            all.omega += weight * off * off;
        }
        all.omega.is_finite().then_some(all)
    }

    fn linearise_point(
        &self,
        lens: &Lens,
        global: &GlobalParameters,
        pose: &BoardPose,
        p: &BoardPoint,
        common_px: f64,
    ) -> Option<LinearisedPoint> {
        let weight = add_common_variance(&p.covariance_px2, common_px).try_inverse()?;
        let point = pose.apply(&self.shape.surface_point(&p.board_m, &board_form(global)));
        let (pixel, by_point) = lens.project_with_jacobian(&point)?;
        // Poses are rotated about the camera, as the camera's motion is.
        let ProjectionJacobians { by_motion, by_lens } = projection_jacobians(lens, &point)?;
        let mut by_global = SMatrix::<f64, 2, GLOBAL>::zeros();
        by_global
            .fixed_columns_mut::<INTERIOR>(0)
            .copy_from(&by_lens);
        let by_form =
            by_point * pose.camera_from_board.matrix() * self.shape.form_jacobian(&p.board_m);
        by_global
            .fixed_columns_mut::<FORM>(INTERIOR)
            .copy_from(&by_form);
        Some(LinearisedPoint {
            by_global,
            by_pose: by_motion,
            weight,
            residual: p.pixel - pixel,
        })
    }

    fn build_solution(
        &self,
        equations: &BundleEquations,
        global: GlobalParameters,
        poses: Vec<BoardPose>,
    ) -> Option<(BundleSolution, Vec<BoardPose>)> {
        let covariance = scaled_inverse(&fix_parameters_in_matrix(
            equations.reduced_equations(0.0)?.0,
            self.fixed,
        ))?;
        let free = |k: usize| if self.fixed[k] { 0.0 } else { 1.0 };
        let covariance = GlobalCovariance::from_fn(|i, j| covariance[(i, j)] * free(i) * free(j));
        let unknowns = self.fixed.iter().filter(|h| !**h).count() + POSE * poses.len();
        let observations = 2 * self.views.iter().map(|view| view.len()).sum::<usize>()
            + self.free_priors().count();
        let redundancy = observations.checked_sub(unknowns).filter(|r| *r > 0)?;
        Some((
            BundleSolution {
                global,
                covariance,
                omega: equations.omega,
                redundancy,
            },
            poses,
        ))
    }
}

/// A point's derivatives, weight and residual.
struct LinearisedPoint {
    by_global: SMatrix<f64, 2, GLOBAL>,
    by_pose: SMatrix<f64, 2, POSE>,
    /// Inverse of the observation's covariance.
    weight: Matrix2<f64>,
    /// Observed minus computed.
    residual: Vector2<f64>,
}

#[derive(Default)]
struct PoseEquations {
    own: Matrix6<f64>,
    cross: SMatrix<f64, GLOBAL, POSE>,
    right: Vector6<f64>,
}

impl PoseEquations {
    fn damped_matrix(&self, damping: f64) -> Matrix6<f64> {
        let mut own = self.own;
        (0..POSE).for_each(|k| own[(k, k)] *= 1.0 + damping);
        own
    }
}

/// Normal equations of shared parameters and poses.
#[derive(Default)]
struct BundleEquations {
    global: GlobalCovariance,
    right: GlobalParameters,
    poses: Vec<PoseEquations>,
    omega: f64,
}

impl BundleEquations {
    fn add_point(&mut self, pose: &mut PoseEquations, point: LinearisedPoint) {
        let LinearisedPoint {
            by_global,
            by_pose,
            weight,
            residual,
        } = point;
        let (weighted, by_pose_weighted) =
            (by_global.transpose() * weight, by_pose.transpose() * weight);
        self.global += weighted * by_global;
        self.right += weighted * residual;
        pose.cross += weighted * by_pose;
        pose.own += by_pose_weighted * by_pose;
        pose.right += by_pose_weighted * residual;
        self.omega += residual.dot(&(weight * residual));
    }

    /// Returns the normal equations of the shared parameters alone.
    fn reduced_equations(&self, damping: f64) -> Option<(GlobalCovariance, GlobalParameters)> {
        let mut matrix = self.global;
        (0..GLOBAL).for_each(|k| matrix[(k, k)] *= 1.0 + damping + ROUNDING);
        let mut right = self.right;
        for pose in &self.poses {
            let solved = pose.damped_matrix(damping).cholesky()?;
            matrix -= pose.cross * solved.solve(&pose.cross.transpose());
            right -= pose.cross * solved.solve(&pose.right);
        }
        Some((matrix, right))
    }

    fn solve_damped_step(
        &self,
        damping: f64,
        fixed: &[bool; GLOBAL],
    ) -> Option<(GlobalParameters, Vec<Vector6<f64>>)> {
        let (matrix, right) = self.reduced_equations(damping)?;
        let step = scaled_inverse(&fix_parameters_in_matrix(matrix, fixed))?
            * fix_parameters_in_vector(right, fixed);
        let back = |pose: &PoseEquations| {
            Some(
                pose.damped_matrix(damping)
                    .cholesky()?
                    .solve(&(pose.right - pose.cross.transpose() * step)),
            )
        };
        Some((step, self.poses.iter().map(back).collect::<Option<_>>()?))
    }

    /// Returns the decrease of the sum of squares that an undamped step promises.
    fn predicted_decrease(&self, fixed: &[bool; GLOBAL]) -> Option<f64> {
        let (step, pose_steps) = self.solve_damped_step(0.0, fixed)?;
        let own: f64 = self
            .poses
            .iter()
            .zip(&pose_steps)
            .map(|(pose, step)| pose.right.dot(step))
            .sum();
        Some(fix_parameters_in_vector(self.right, fixed).dot(&step) + own)
    }
}

fn fix_parameters_in_matrix(
    mut matrix: GlobalCovariance,
    fixed: &[bool; GLOBAL],
) -> GlobalCovariance {
    for k in (0..GLOBAL).filter(|k| fixed[*k]) {
        matrix.row_mut(k).fill(0.0);
        matrix.column_mut(k).fill(0.0);
        matrix[(k, k)] = 1.0;
    }
    matrix
}

fn fix_parameters_in_vector(
    mut right: GlobalParameters,
    fixed: &[bool; GLOBAL],
) -> GlobalParameters {
    (0..GLOBAL)
        .filter(|k| fixed[*k])
        .for_each(|k| right[k] = 0.0);
    right
}

/// Inverts a symmetric matrix whose parameters have very different units.
fn scaled_inverse(matrix: &GlobalCovariance) -> Option<GlobalCovariance> {
    let scale = matrix.diagonal().map(|d| d.sqrt().recip());
    let scales = scale * scale.transpose();
    let scaled = matrix.component_mul(&scales).cholesky()?;
    Some(scaled.inverse().component_mul(&scales))
}
