//! A bundle adjustment: start values in; camera, board and poses out.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::bundle::{BoardBundle, BundleSolution};
use super::model::{
    BoardForm, BoardPose, GLOBAL, INTERIOR, ImageSize, ScalarPrior, add_common_variance,
    board_form, lens_from_parameters, pack_parameters,
};
use super::shape::BoardShape;
use super::{BoardPoint, BoardView, CalibrateError, start};
use crate::estimation::robust::{MEDIAN_SQUARE, common_variance};
use crate::geometry::Lens;

/// Camera, board and poses: start and result of an adjustment.
#[derive(Clone)]
pub(super) struct CameraState {
    pub lens: Lens,
    pub form: BoardForm,
    /// Prior standard deviation of the stretch; not used if the stretch is fixed.
    pub stretch_sigma: f64,
    pub poses: Vec<BoardPose>,
    /// Parameters that keep their start value.
    pub fixed: [bool; GLOBAL],
}

/// Result of an adjustment.
pub(super) struct CameraAdjustment {
    pub camera: CameraState,
    pub shape: BoardShape,
    pub solution: BundleSolution,
    /// Standard deviation common to all points, in addition to their own, px.
    pub model_sigma_px: f64,
}

impl CameraAdjustment {
    /// Returns a board point of view `k` (index among the views used) in the camera frame, m.
    pub(super) fn camera_point(&self, k: usize, p: &BoardPoint) -> Vector3<f64> {
        self.camera.poses[k].apply(&self.shape.surface_point(&p.board_m, &self.camera.form))
    }

    /// Returns observed - projected, px, for each point of each view.
    pub(super) fn residuals(&self, used: &[(usize, BoardView)]) -> Vec<Vec<Vector2<f64>>> {
        // A point behind the camera gets a huge residual that stays finite when squared.
        let far = Vector2::new(1e6, 1e6);
        let one = |k: usize, p: &BoardPoint| {
            self.camera
                .lens
                .project(&self.camera_point(k, p))
                .map_or(far, |q| p.pixel - q)
        };
        used.iter()
            .enumerate()
            .map(|(k, (_, v))| v.iter().map(|p| one(k, p)).collect())
            .collect()
    }

    /// Returns the covariance of a measured point, including the common variance.
    pub(super) fn covariance_px2(&self, p: &BoardPoint) -> Matrix2<f64> {
        add_common_variance(&p.covariance_px2, self.model_sigma_px)
    }

    /// Returns the squared residual lengths normalised by the points' covariances.
    pub(super) fn normalized_squares(
        &self,
        used: &[(usize, BoardView)],
        residuals: &[Vec<Vector2<f64>>],
    ) -> Vec<Vec<f64>> {
        let square = |(p, r): (&BoardPoint, &Vector2<f64>)| {
            self.covariance_px2(p)
                .try_inverse()
                .map_or(0.0, |w| r.dot(&(w * r)))
        };
        used.iter()
            .zip(residuals)
            .map(|((_, v), r)| v.iter().zip(r).map(square).collect())
            .collect()
    }

    /// Estimates the common standard deviation, px, for which the median of the squared residual lengths has its expected
    /// value (Paule and Mandel 1982, with the median for the mean), by bisection.
    pub(super) fn common_sigma_px(&self, used: &[(usize, BoardView)]) -> f64 {
        let residuals = self.residuals(used).concat();
        let own: Vec<f64> = used
            .iter()
            .flat_map(|(_, v)| v)
            .map(|p| 0.5 * p.covariance_px2.trace())
            .collect();
        let squares: Vec<f64> = residuals.iter().map(Vector2::norm_squared).collect();
        // The adjustment reduces the residuals by the fraction of redundancy.
        let share = self.solution.redundancy as f64 / (2 * residuals.len()).max(1) as f64;
        common_variance(&squares, &own, MEDIAN_SQUARE * share).sqrt()
    }
}

/// Common standard deviation of the points before residuals determine it, px.
const FIRST_SIGMA_PX: f64 = 0.1;

/// Adjusts a camera without start values: begins with the focal length from the homographies or, if the adjustment
/// does not converge from there, with the typical one that leaves the smallest residuals.
pub(super) fn initial_adjustment(
    used: &[(usize, BoardView)],
    size: ImageSize,
    fixed: [bool; GLOBAL],
    stretch_sigma: f64,
) -> Result<CameraAdjustment, CalibrateError> {
    let views: Vec<&BoardView> = used.iter().map(|(_, v)| v).collect();
    let adjust_from = |f_px: Option<f64>| {
        let (lens, poses) =
            start::start_from_homographies(&views, size, f_px).ok_or(CalibrateError::NoStart)?;
        let common_px = vec![FIRST_SIGMA_PX; used.len()];
        // A stiff lens without distortion first: with all parameters free at once, few images diverge.
        let start = CameraState {
            lens,
            form: BoardForm::zeros(),
            stretch_sigma,
            poses,
            fixed,
        };
        let mut rough = start.adjust_weighted(used, &common_px, PRIOR_STIFFNESS[0])?;
        for stiff in &PRIOR_STIFFNESS[1..] {
            rough = rough.camera.adjust_weighted(used, &common_px, *stiff)?;
        }
        Ok(CameraAdjustment {
            model_sigma_px: FIRST_SIGMA_PX,
            ..rough
        })
    };
    let estimated = adjust_from(None);
    if estimated.is_ok() {
        return estimated;
    }
    let tried = start::TYPICAL_FOCAL_RATIOS
        .iter()
        .filter_map(|f| adjust_from(Some(f * f64::from(size.width))).ok());
    tried
        .min_by(|a, b| a.solution.omega.total_cmp(&b.solution.omega))
        .map_or(estimated, Ok)
}

/// Factors on the prior standard deviations of focal length and distortion in the first rounds: with both free at once,
/// a constant that hardly tilted boards leave undetermined diverges together with the distortion.
const PRIOR_STIFFNESS: [f64; 4] = [1e-3, 1e-2, 1e-1, 1.0];

impl CameraState {
    /// Adjusts with one common standard deviation of the points, px.
    pub(super) fn adjust(
        &self,
        used: &[(usize, BoardView)],
        model_sigma_px: f64,
    ) -> Result<CameraAdjustment, CalibrateError> {
        let found = self.adjust_weighted(used, &vec![model_sigma_px; used.len()], 1.0)?;
        Ok(CameraAdjustment {
            model_sigma_px,
            ..found
        })
    }

    /// Adjusts with a common standard deviation for each view, px, and the priors of focal length and distortion scaled by
    /// `stiff`.
    pub(super) fn adjust_weighted(
        &self,
        used: &[(usize, BoardView)],
        common_px: &[f64],
        stiff: f64,
    ) -> Result<CameraAdjustment, CalibrateError> {
        let views: Vec<&BoardView> = used.iter().map(|(_, v)| v).collect();
        let size = ImageSize::from_lens(&self.lens);
        let shape = BoardShape::from_views(&views);
        let priors = [
            lens_priors(&self.lens, stiff),
            shape.priors(INTERIOR, self.stretch_sigma),
        ]
        .concat();
        let bundle = BoardBundle {
            views: &views,
            size,
            shape,
            common_px,
            priors: &priors,
            fixed: &self.fixed,
        };
        let start = pack_parameters(&self.lens, &self.form);
        let (solution, poses) = bundle
            .solve(start, &self.poses)
            .ok_or(CalibrateError::NoFit)?;
        let camera = Self {
            lens: lens_from_parameters(size, &solution.global),
            form: board_form(&solution.global),
            poses,
            ..*self
        };
        Ok(CameraAdjustment {
            camera,
            shape,
            solution,
            model_sigma_px: 0.0,
        })
    }
}

/// Returns weak priors for images that do not determine the lens: the focal length within 100 % of its start, the
/// principal point within 10 % of the image width of the centre, and each distortion term moves the image's corner by at
/// most its distance from the centre (one standard deviation). They keep solutions from few images finite. The sizes are an
/// assumption, chosen wide.
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
    sigmas
        .into_iter()
        .map(|(index, sigma)| ScalarPrior {
            index,
            mean: mean(index),
            sigma,
        })
        .collect()
}
