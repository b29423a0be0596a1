//! One adjustment: from where it begins to camera, board and poses.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::bundle::BoardBundle;
use super::model::{BoardForm, GLOBAL, INTERIOR, BoardPose, ImageSize, board_form, lens_from_parameters, pack_parameters, add_common_variance};
use super::shape::BoardShape;
use super::{BoardPoint, CalibrateError, BoardView, start};
use crate::estimation::arrow::{self, ScalarPrior, Solution};
use crate::estimation::robust::{MEDIAN_SQUARE, common_variance};
use crate::geometry::Lens;

/// Camera, board and poses of one adjustment.
pub(super) struct CameraAdjustment {
    pub lens: Lens,
    pub shape: BoardShape,
    pub form: BoardForm,
    /// Of the stretch beforehand.
    pub stretch_sigma: f64,
    pub poses: Vec<BoardPose>,
    /// Parameters that keep their start.
    pub held: [bool; GLOBAL],
    pub solution: Solution<GLOBAL, BoardPose>,
    /// Common to all points, beyond their own, px.
    pub model_sigma_px: f64,
}

impl CameraAdjustment {
    /// A point of a view (counted among those used), camera frame, m.
    pub(super) fn camera_point(&self, k: usize, p: &BoardPoint) -> Vector3<f64> {
        self.poses[k].apply(&self.shape.surface_point(&p.board_m, &self.form))
    }

    /// Per view, per point: observed - projected, px.
    pub(super) fn residuals(&self, used: &[(usize, BoardView)]) -> Vec<Vec<Vector2<f64>>> {
        // Behind the camera: as gross as an error can be, and still finite when squared.
        let far = Vector2::new(1e6, 1e6);
        let one =
            |k: usize, p: &BoardPoint| self.lens.project(&self.camera_point(k, p)).map_or(far, |q| p.pixel - q);
        used.iter().enumerate().map(|(k, (_, v))| v.iter().map(|p| one(k, p)).collect()).collect()
    }

    pub(super) fn covariance_px2(&self, p: &BoardPoint) -> Matrix2<f64> {
        add_common_variance(&p.covariance_px2, self.model_sigma_px)
    }

    /// Squared lengths of the residuals in standard deviations.
    pub(super) fn normalized_squares(&self, used: &[(usize, BoardView)], residuals: &[Vec<Vector2<f64>>]) -> Vec<Vec<f64>> {
        let square = |(p, r): (&BoardPoint, &Vector2<f64>)| {
            self.covariance_px2(p).try_inverse().map_or(0.0, |w| r.dot(&(w * r)))
        };
        used.iter().zip(residuals).map(|((_, v), r)| v.iter().zip(r).map(square).collect()).collect()
    }

    /// The variance that the points must have in common for the median of their squared lengths to be
    /// what it should (Paule and Mandel 1982, with the median for the mean), by bisection.
    pub(super) fn common_sigma_px(&self, used: &[(usize, BoardView)]) -> f64 {
        let residuals = self.residuals(used).concat();
        let own: Vec<f64> =
            used.iter().flat_map(|(_, v)| v).map(|p| 0.5 * p.covariance_px2.trace()).collect();
        let squares: Vec<f64> = residuals.iter().map(Vector2::norm_squared).collect();
        // The adjustment takes its share of the residuals.
        let share = self.solution.redundancy as f64 / (2 * residuals.len()).max(1) as f64;
        common_variance(&squares, &own, MEDIAN_SQUARE * share).sqrt()
    }
}

/// Where an adjustment begins.
pub(super) struct AdjustmentStart {
    pub lens: Lens,
    pub form: BoardForm,
    /// Standard deviation of the stretch beforehand; where it is held, without meaning.
    pub stretch_sigma: f64,
    pub poses: Vec<BoardPose>,
    pub held: [bool; GLOBAL],
}

impl AdjustmentStart {
    pub(super) fn from_adjustment(adjusted: &CameraAdjustment) -> Self {
        Self {
            lens: adjusted.lens,
            form: adjusted.form,
            stretch_sigma: adjusted.stretch_sigma,
            poses: adjusted.poses.clone(),
            held: adjusted.held,
        }
    }
}

/// Points' common standard deviation before residuals tell it, px.
const FIRST_SIGMA_PX: f64 = 0.1;

/// From nothing: the camera constant that the homographies tell, or where the adjustment does not converge
/// from there, that of the usual lenses from which it comes closest.
pub(super) fn initial_adjustment(
    used: &[(usize, BoardView)],
    size: ImageSize,
    held: [bool; GLOBAL],
    stretch_sigma: f64,
) -> Result<CameraAdjustment, CalibrateError> {
    let views: Vec<&BoardView> = used.iter().map(|(_, v)| v).collect();
    let from = |f_px: Option<f64>| {
        let (lens, poses) = start::start_from_homographies(&views, size, f_px).ok_or(CalibrateError::NoStart)?;
        // A lens without distortion first: all at once, few pictures run away.
        let start = AdjustmentStart { lens, form: BoardForm::zeros(), stretch_sigma, poses, held };
        let mut rough = adjust_with_stiffness(used, &start, FIRST_SIGMA_PX, STIFF[0])?;
        for stiff in &STIFF[1..] {
            rough = adjust_with_stiffness(used, &AdjustmentStart::from_adjustment(&rough), FIRST_SIGMA_PX, *stiff)?;
        }
        Ok(rough)
    };
    let told = from(None);
    if told.is_ok() {
        return told;
    }
    let tried = start::USUAL.iter().filter_map(|f| from(Some(f * f64::from(size.width))).ok());
    tried.min_by(|a, b| a.solution.omega.total_cmp(&b.solution.omega)).map_or(told, Ok)
}

/// Prior standard deviations of camera constant and distortion while both are rough, over those that hold at the end:
/// let free at once, a constant that hardly tilted boards leave open runs away with the distortion.
const STIFF: [f64; 4] = [1e-3, 1e-2, 1e-1, 1.0];

pub(super) fn adjust_bundle(
    used: &[(usize, BoardView)],
    start: &AdjustmentStart,
    model_sigma_px: f64,
) -> Result<CameraAdjustment, CalibrateError> {
    adjust_with_stiffness(used, start, model_sigma_px, 1.0)
}

pub(super) fn adjust_with_stiffness(
    used: &[(usize, BoardView)],
    start: &AdjustmentStart,
    model_sigma_px: f64,
    stiff: f64,
) -> Result<CameraAdjustment, CalibrateError> {
    let found = adjust_with_view_sigmas(used, start, &vec![model_sigma_px; used.len()], stiff)?;
    Ok(CameraAdjustment { model_sigma_px, ..found })
}

/// With a common standard deviation for each view, px.
pub(super) fn adjust_with_view_sigmas(
    used: &[(usize, BoardView)],
    start: &AdjustmentStart,
    common_px: &[f64],
    stiff: f64,
) -> Result<CameraAdjustment, CalibrateError> {
    let views: Vec<&BoardView> = used.iter().map(|(_, v)| v).collect();
    let size = ImageSize::from_lens(&start.lens);
    let shape = BoardShape::from_views(&views);
    let priors = [lens_priors(&start.lens, stiff), shape.priors(INTERIOR, start.stretch_sigma)].concat();
    let bundle = BoardBundle { views: &views, size, shape, common_px };
    let global = pack_parameters(&start.lens, &start.form);
    let solution =
        arrow::solve_arrow(&bundle, &priors, &start.held, global, &start.poses).ok_or(CalibrateError::NoFit)?;
    Ok(CameraAdjustment {
        lens: lens_from_parameters(size, &solution.global),
        shape,
        form: board_form(&solution.global),
        stretch_sigma: start.stretch_sigma,
        poses: solution.own.clone(),
        held: start.held,
        solution,
        model_sigma_px: 0.0,
    })
}

/// What every lens keeps to, for pictures that do not tell: the camera constant is within its own size of where
/// it began, the principal point lies within a tenth of the image's width of its middle, and no term of the
/// distortion moves the image's corner by more than its distance from the middle (one standard deviation). It keeps few pictures from running
/// away. The sizes are an assumption, chosen wide.
fn lens_priors(start: &Lens, stiff: f64) -> Vec<ScalarPrior> {
    let (width, height) = (f64::from(start.width), f64::from(start.height));
    let corner = 0.5 * width.hypot(height) / start.fx;
    let centre = ImageSize::from_lens(start).centre();
    let mean = |k: usize| match k {
        0 | 1 => start.fx,
        2 | 3 => centre[k - 2],
        _ => 0.0,
    };
    let sigmas = [
        (0, stiff * start.fx),
        (1, stiff * start.fx),
        (2, 0.1 * width),
        (3, 0.1 * width),
        (4, stiff * corner.powi(-2)),
        (5, stiff * corner.powi(-4)),
        (6, stiff * corner.powi(-6)),
        (7, stiff * corner.recip()),
        (8, stiff * corner.recip()),
        (9, stiff * corner.powi(-2)),
        (10, stiff * corner.powi(-4)),
        (11, stiff * corner.powi(-6)),
    ];
    sigmas.into_iter().map(|(index, sigma)| ScalarPrior { index, mean: mean(index), sigma }).collect()
}
