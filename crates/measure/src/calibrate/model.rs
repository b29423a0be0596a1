//! Observation model: camera parameters, board pose, and the derivatives of a pixel.

use nalgebra::{Matrix2, Rotation3, SMatrix, SVector, Vector2, Vector3, Vector6};

use crate::geometry::{BROWN, Lens, cross_matrix};

/// Number of interior parameters: Brown's, then k4, k5, k6 of the rational model's denominator. The board's form follows.
pub(super) const INTERIOR: usize = BROWN + 3;
/// Number of parameters of the board's form: bow along, bow across (m), stretch.
pub(super) const FORM: usize = 3;
/// Number of parameters that are common to all images.
pub(super) const GLOBAL: usize = INTERIOR + FORM;
/// Distances at which a wing's markers lie, m.
pub const DISTANCES_M: [f64; 3] = [5.0, 15.0, 40.0];
/// Index of the board's stretch.
pub(super) const STRETCH: usize = INTERIOR + 2;

/// Parameters common to all images: interior, then the board's form.
pub(super) type GlobalParameters = SVector<f64, GLOBAL>;
/// Covariance of the common parameters.
pub(super) type GlobalCovariance = SMatrix<f64, GLOBAL, GLOBAL>;
/// Values of the board's form.
pub(super) type BoardForm = SVector<f64, FORM>;
/// Derivatives of a pixel by the interior parameters.
pub(super) type InteriorJacobian = SMatrix<f64, 2, INTERIOR>;

/// Prior on one shared parameter.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScalarPrior {
    /// Index of the parameter.
    pub index: usize,
    /// Expected value.
    pub mean: f64,
    /// Standard deviation of the expected value.
    pub sigma: f64,
}

/// Image size, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ImageSize {
    pub width: u32,
    pub height: u32,
}

impl ImageSize {
    /// Returns the image size of a lens.
    pub(super) fn from_lens(lens: &Lens) -> Self {
        Self {
            width: lens.width,
            height: lens.height,
        }
    }

    /// Returns the image's centre, px.
    pub(super) fn centre(&self) -> Vector2<f64> {
        Vector2::new(
            0.5 * (f64::from(self.width) - 1.0),
            0.5 * (f64::from(self.height) - 1.0),
        )
    }
}

/// Extracts the board's form from all parameters.
pub(super) fn board_form(global: &GlobalParameters) -> BoardForm {
    global.fixed_rows::<FORM>(INTERIOR).into()
}

/// Packs a lens and a board's form into one parameter vector.
pub(super) fn pack_parameters(lens: &Lens, form: &BoardForm) -> GlobalParameters {
    GlobalParameters::from_iterator(
        lens.parameters()
            .iter()
            .chain(&lens.denominator)
            .chain(form.iter())
            .copied(),
    )
}

/// Extracts the lens from all parameters.
pub(super) fn lens_from_parameters(
    ImageSize { width, height }: ImageSize,
    p: &GlobalParameters,
) -> Lens {
    let zero = Lens::pinhole(width, height, 0.0, 0.0, 0.0);
    let lens = zero.with_changes(&p.fixed_rows::<BROWN>(0).into_owned());
    Lens {
        denominator: [p[BROWN], p[BROWN + 1], p[BROWN + 2]],
        ..lens
    }
}

/// Adds the common variance of all points to a point's own covariance.
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
    /// Transforms a point from the board frame to the camera frame, m.
    pub(super) fn apply(&self, board_m: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_board * board_m + self.translation_m
    }

    /// Returns the pose moved by a rotation about the camera and a translation.
    pub(super) fn moved(&self, step: &Vector6<f64>) -> Self {
        let turn = Rotation3::new(step.fixed_rows::<3>(0).clone_owned());
        let shift = step.fixed_rows::<3>(3).clone_owned();
        Self {
            camera_from_board: turn * self.camera_from_board,
            translation_m: turn * self.translation_m + shift,
        }
    }
}

/// Derivatives of a pixel.
pub(super) struct ProjectionJacobians {
    /// d pixel / d (rotation, shift of the camera).
    pub by_motion: SMatrix<f64, 2, 6>,
    /// d pixel / d interior parameters.
    pub by_lens: InteriorJacobian,
}

/// Returns the derivatives of the pixel of a camera-frame point, m; `None` behind the camera.
pub(super) fn projection_jacobians(
    lens: &Lens,
    point: &Vector3<f64>,
) -> Option<ProjectionJacobians> {
    let (_, by_point) = lens.project_with_jacobian(point)?;
    let mut by_motion = SMatrix::<f64, 2, 6>::zeros();
    by_motion
        .fixed_columns_mut::<3>(0)
        .copy_from(&(-by_point * cross_matrix(point)));
    by_motion.fixed_columns_mut::<3>(3).copy_from(&by_point);
    let mut by_lens = InteriorJacobian::zeros();
    by_lens
        .fixed_columns_mut::<BROWN>(0)
        .copy_from(&lens.parameter_jacobian(point));
    by_lens
        .fixed_columns_mut::<3>(BROWN)
        .copy_from(&lens.denominator_jacobian(point));
    Some(ProjectionJacobians { by_motion, by_lens })
}

/// Returns the root mean square of vectors' lengths.
pub(super) fn rms_length<'a>(vectors: impl Iterator<Item = &'a Vector2<f64>>) -> f64 {
    let (sum, n) = vectors.fold((0.0, 0usize), |(s, n), r| (s + r.norm_squared(), n + 1));
    (sum / n.max(1) as f64).sqrt()
}
