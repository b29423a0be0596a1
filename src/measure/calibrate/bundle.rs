//! Camera, the board's form and its poses as one least-squares problem.

use nalgebra::{SMatrix, Vector6};

use super::model::{
    BoardPose, FORM, GLOBAL, GlobalParameters, INTERIOR, ImageSize, add_common_variance, board_form,
    lens_from_parameters, projection_jacobians,
};
use super::shape::BoardShape;
use super::{BoardPoint, BoardView};
use crate::estimation::arrow::{ArrowEquations, ArrowModel, LinearisedPoint};
use crate::geometry::Lens;

/// Observations of one bundle adjustment.
pub(super) struct BoardBundle<'a> {
    pub views: &'a [&'a BoardView],
    pub size: ImageSize,
    pub shape: BoardShape,
    /// Standard deviation that the points of each view have in addition to their own, px.
    pub common_px: &'a [f64],
}

impl ArrowModel<GLOBAL, 6> for BoardBundle<'_> {
    type Own = BoardPose;

    fn add_observations(
        &self,
        global: &GlobalParameters,
        poses: &[BoardPose],
        equations: &mut ArrowEquations<GLOBAL, 6>,
    ) -> Option<()> {
        let lens = lens_from_parameters(self.size, global);
        for ((pose, view), common_px) in poses.iter().zip(self.views).zip(self.common_px) {
            equations.add_group(view.iter().map(|p| self.point_row(&lens, global, pose, p, *common_px)))?;
        }
        Some(())
    }

    fn apply_step(pose: &BoardPose, step: &Vector6<f64>) -> BoardPose {
        pose.moved(step)
    }
}

impl BoardBundle<'_> {
    fn point_row(
        &self,
        lens: &Lens,
        global: &GlobalParameters,
        pose: &BoardPose,
        p: &BoardPoint,
        common_px: f64,
    ) -> Option<LinearisedPoint<GLOBAL, 6>> {
        let weight = add_common_variance(&p.covariance_px2, common_px).try_inverse()?;
        let point = pose.apply(&self.shape.surface_point(&p.board_m, &board_form(global)));
        let (pixel, by_point) = lens.project_with_jacobian(&point)?;
        // Poses are rotated about the camera, as the camera's motion is.
        let found = projection_jacobians(lens, &point)?;
        let mut by_global = SMatrix::<f64, 2, GLOBAL>::zeros();
        by_global.fixed_columns_mut::<INTERIOR>(0).copy_from(&found.by_lens);
        let by_form = by_point * pose.camera_from_board.matrix() * self.shape.form_jacobian(&p.board_m);
        by_global.fixed_columns_mut::<FORM>(INTERIOR).copy_from(&by_form);
        Some(LinearisedPoint { by_global, by_own: found.by_motion, weight, residual: p.pixel - pixel })
    }
}
