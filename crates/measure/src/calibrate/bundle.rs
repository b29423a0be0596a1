//! Camera, the board's form and its poses as one least-squares problem: few shared parameters, many images with a pose of
//! their own, thousands of points (bundle adjustment; Triggs et al. 2000).

use nalgebra::{DMatrix, DVector};

use super::BoardView;
use super::model::{
    BoardPose, GLOBAL, GlobalCovariance, GlobalParameters, INTERIOR, ImageSize, ScalarPrior,
    add_common_variance, board_form, lens_from_parameters, projection_jacobians,
};
use super::shape::BoardShape;
use crate::estimation::{
    Block, EstimationError, EstimationResult, Group, GroupPoint, Linearised, Prior, Problem,
    SolveOptions, solve_groups,
};
use crate::geometry::{cross_matrix, left_jacobian};

/// Number of parameters of a pose: rotation about the camera, translation.
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
    /// Minimises the sum of squares from a start; returns the poses too. `None` if it does not converge, a point has no
    /// image, or a parameter stays undetermined.
    pub(super) fn solve(
        &self,
        start: GlobalParameters,
        poses: &[BoardPose],
    ) -> Option<(BundleSolution, Vec<BoardPose>)> {
        let free: Vec<usize> = (0..GLOBAL).filter(|k| !self.fixed[*k]).collect();
        let prior = |p: &ScalarPrior| {
            let column = free.iter().position(|k| *k == p.index)?;
            Some(Prior::scalar("camera", column, p.mean, p.sigma))
        };
        let problem = Problem {
            start: DVector::from_iterator(free.len(), free.iter().map(|k| start[*k])),
            missing: vec!["the images do not determine the camera"; free.len()],
            priors: self.priors.iter().filter_map(prior).collect(),
            known: None,
            groups: self.groups(),
        };
        let all = |values: &DVector<f64>| {
            let mut all = start;
            free.iter()
                .zip(values)
                .for_each(|(k, value)| all[*k] = *value);
            all
        };
        let fit = solve_groups(&problem, &SolveOptions::default(), |at, blocks| {
            self.linearise(&all(at.global), &free, &poses[at.group], at, blocks)
        })
        .ok()?;
        let mut covariance = GlobalCovariance::zeros();
        for (i, row) in free.iter().enumerate() {
            for (j, column) in free.iter().enumerate() {
                covariance[(*row, *column)] = fit.covariance[(i, j)];
            }
        }
        let moved = poses.iter().zip(&fit.groups);
        let poses =
            moved.map(|(pose, group)| pose.moved(&group.local.fixed_rows::<POSE>(0).into()));
        let solution = BundleSolution {
            global: all(&fit.global),
            covariance,
            omega: fit.omega,
            redundancy: fit.redundancy,
        };
        (fit.redundancy > 0).then(|| (solution, poses.collect()))
    }

    /// Returns one group per view, whose local parameters move its pose.
    fn groups(&self) -> Vec<Group> {
        let group = |(view, common_px): (&&BoardView, &f64)| {
            let blocks = view.iter().map(|p| {
                let covariance = add_common_variance(&p.covariance_px2, *common_px);
                Block {
                    observed: DVector::from_column_slice(p.pixel.as_slice()),
                    covariance: DMatrix::from_column_slice(2, 2, covariance.as_slice()),
                }
            });
            Group {
                local: DVector::zeros(POSE),
                priors: vec![],
                blocks: blocks.collect(),
            }
        };
        self.views.iter().zip(self.common_px).map(group).collect()
    }

    /// Linearises the points of a view.
    fn linearise(
        &self,
        global: &GlobalParameters,
        free: &[usize],
        start: &BoardPose,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> EstimationResult<()> {
        let (lens, form) = (lens_from_parameters(self.size, global), board_form(global));
        let step = at.local.fixed_rows::<POSE>(0).into_owned();
        let pose = start.moved(&step);
        let (turn, shift) = (
            step.fixed_rows::<3>(0).into_owned(),
            step.fixed_rows::<3>(3).into_owned(),
        );
        let by_turn = left_jacobian(&turn);
        blocks.clear();
        for (p, observed) in self.views[at.group].iter().zip(at.observed) {
            let behind = || EstimationError::Input("a point has no image".into());
            let point = pose.apply(&self.shape.surface_point(&p.board_m, &form));
            let (pixel, by_point) = lens.project_with_jacobian(&point).ok_or_else(behind)?;
            let by_lens = projection_jacobians(&lens, &point)
                .ok_or_else(behind)?
                .by_lens;
            let by_form =
                by_point * pose.camera_from_board.matrix() * self.shape.form_jacobian(&p.board_m);
            let mut out = Linearised::empty(2, (0..free.len()).collect(), POSE, 2);
            for (mut column, k) in out.global.column_iter_mut().zip(free) {
                match k.checked_sub(INTERIOR) {
                    None => column.copy_from(&by_lens.column(*k)),
                    Some(of_form) => column.copy_from(&by_form.column(of_form)),
                }
            }
            out.local
                .fixed_columns_mut::<3>(0)
                .copy_from(&(-by_point * cross_matrix(&(point - shift)) * by_turn));
            out.local.fixed_columns_mut::<3>(3).copy_from(&by_point);
            out.misclosure.copy_from(&(pixel - observed));
            out.observations.fill_with_identity();
            out.observations.neg_mut();
            blocks.push(out);
        }
        Ok(())
    }
}
