//! A camera that looks at a board: its parameters, the board's pose, and how a pixel answers to both.

use nalgebra::{Matrix2, Rotation3, SMatrix, SVector, Vector2, Vector3, Vector6};

use crate::geometry::{BROWN, Lens, cross_matrix};

/// Interior parameters: Brown's, then those of the rational model's denominator, k4 k5 k6; the board's form follows.
pub(super) const INTERIOR: usize = BROWN + 3;
/// Unknowns of the board's form: bow along, bow across (m), stretch.
pub(super) const FORM: usize = 3;
/// All that the pictures have in common.
pub(super) const GLOBAL: usize = INTERIOR + FORM;
/// Distances at which a wing's markers lie, m.
pub const DISTANCES_M: [f64; 3] = [5.0, 15.0, 40.0];
/// Index of the board's stretch.
pub(super) const STRETCH: usize = INTERIOR + 2;

pub(super) type GlobalParameters = SVector<f64, GLOBAL>;
pub(super) type GlobalCovariance = SMatrix<f64, GLOBAL, GLOBAL>;
/// Values of the board's form.
pub(super) type BoardForm = SVector<f64, FORM>;
pub(super) type InteriorJacobian = SMatrix<f64, 2, INTERIOR>;

/// Of the pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ImageSize {
    /// px.
    pub width: u32,
    /// px.
    pub height: u32,
}

impl ImageSize {
    /// Of a lens's pictures.
    pub(super) fn from_lens(lens: &Lens) -> Self {
        Self { width: lens.width, height: lens.height }
    }

    /// The image's centre, px.
    pub(super) fn centre(&self) -> Vector2<f64> {
        Vector2::new(0.5 * (f64::from(self.width) - 1.0), 0.5 * (f64::from(self.height) - 1.0))
    }
}

/// The board's form among all parameters.
pub(super) fn board_form(global: &GlobalParameters) -> BoardForm {
    global.fixed_rows::<FORM>(INTERIOR).into()
}

/// All parameters of a lens and a board's form.
pub(super) fn pack_parameters(lens: &Lens, form: &BoardForm) -> GlobalParameters {
    GlobalParameters::from_iterator(lens.parameters().iter().chain(&lens.denominator).chain(form.iter()).copied())
}

/// The lens of pictures of a size among all parameters.
pub(super) fn lens_from_parameters(ImageSize { width, height }: ImageSize, p: &GlobalParameters) -> Lens {
    let nothing = Lens::pinhole(width, height, 0.0, 0.0, 0.0);
    let lens = nothing.with_changes(&p.fixed_rows::<BROWN>(0).into_owned());
    Lens { denominator: [p[BROWN], p[BROWN + 1], p[BROWN + 2]], ..lens }
}

/// A point's covariance with what all points have in common.
pub(super) fn add_common_variance(own_px2: &Matrix2<f64>, model_sigma_px: f64) -> Matrix2<f64> {
    own_px2 + Matrix2::identity() * model_sigma_px.powi(2)
}

/// The board's pose in the camera frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BoardPose {
    pub camera_from_board: Rotation3<f64>,
    pub translation_m: Vector3<f64>,
}

impl BoardPose {
    /// Camera-frame point, m.
    pub(super) fn apply(&self, board_m: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_board * board_m + self.translation_m
    }

    /// Moved by a rotation about the camera and a shift.
    pub(super) fn moved(&self, by: &Vector6<f64>) -> Self {
        let turn = Rotation3::new(by.fixed_rows::<3>(0).clone_owned());
        let shift = by.fixed_rows::<3>(3).clone_owned();
        Self {
            camera_from_board: turn * self.camera_from_board,
            translation_m: turn * self.translation_m + shift,
        }
    }
}

/// How a pixel answers.
pub(super) struct ProjectionJacobians {
    /// d pixel / d (rotation, shift of the camera).
    pub by_motion: SMatrix<f64, 2, 6>,
    /// d pixel / d interior parameters.
    pub by_lens: InteriorJacobian,
}

/// At a camera-frame point, m; `None` behind the camera.
pub(super) fn projection_jacobians(lens: &Lens, point: &Vector3<f64>) -> Option<ProjectionJacobians> {
    let (_, by_point) = lens.project_with_jacobian(point)?;
    let mut by_motion = SMatrix::<f64, 2, 6>::zeros();
    by_motion.fixed_columns_mut::<3>(0).copy_from(&(-by_point * cross_matrix(point)));
    by_motion.fixed_columns_mut::<3>(3).copy_from(&by_point);
    let mut by_lens = InteriorJacobian::zeros();
    by_lens.fixed_columns_mut::<BROWN>(0).copy_from(&lens.parameter_jacobian(point));
    by_lens.fixed_columns_mut::<3>(BROWN).copy_from(&lens.denominator_jacobian(point));
    Some(ProjectionJacobians { by_motion, by_lens })
}

/// Root mean square of vectors' lengths.
pub(super) fn rms_length<'a>(vectors: impl Iterator<Item = &'a Vector2<f64>>) -> f64 {
    let (sum, n) = vectors.fold((0.0, 0usize), |(s, n), r| (s + r.norm_squared(), n + 1));
    (sum / n.max(1) as f64).sqrt()
}
