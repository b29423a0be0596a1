//! Camera, the board's form and its poses as one least-squares problem.

use nalgebra::{SMatrix, Vector6};

use super::model::{FORM, GLOBAL, Global, INTERIOR, Pose, Size, form_of, jacobians, lens_of, with_common};
use super::shape::Shape;
use super::{BoardPoint, View};
use crate::estimation::arrow::{Equations, Model, Row};
use crate::geometry::Lens;

/// What is adjusted.
pub(super) struct Bundle<'a> {
    pub views: &'a [&'a View],
    pub size: Size,
    pub shape: Shape,
    /// Per view: standard deviation that its points have beyond their own, px.
    pub common_px: &'a [f64],
}

impl Model<GLOBAL, 6> for Bundle<'_> {
    type Own = Pose;

    fn observe(&self, global: &Global, poses: &[Pose], equations: &mut Equations<GLOBAL, 6>) -> Option<()> {
        let lens = lens_of(self.size, global);
        for ((pose, view), common_px) in poses.iter().zip(self.views).zip(self.common_px) {
            equations.add_group(view.iter().map(|p| self.row(&lens, global, pose, p, *common_px)))?;
        }
        Some(())
    }

    fn moved(pose: &Pose, step: &Vector6<f64>) -> Pose {
        pose.moved(step)
    }
}

impl Bundle<'_> {
    fn row(
        &self,
        lens: &Lens,
        global: &Global,
        pose: &Pose,
        p: &BoardPoint,
        common_px: f64,
    ) -> Option<Row<GLOBAL, 6>> {
        let weight = with_common(&p.covariance_px2, common_px).try_inverse()?;
        let point = pose.apply(&self.shape.point(&p.board_m, &form_of(global)));
        let (pixel, by_point) = lens.project_with_jacobian(&point)?;
        // The camera's motion turns about the camera; a pose's turn here does the same.
        let found = jacobians(lens, &point)?;
        let mut by_global = SMatrix::<f64, 2, GLOBAL>::zeros();
        by_global.fixed_columns_mut::<INTERIOR>(0).copy_from(&found.by_lens);
        let by_form = by_point * pose.camera_from_board.matrix() * self.shape.by_form(&p.board_m);
        by_global.fixed_columns_mut::<FORM>(INTERIOR).copy_from(&by_form);
        Some(Row { by_global, by_own: found.by_motion, weight, residual: p.pixel - pixel })
    }
}
