//! One adjustment: from where it begins to camera, board and poses.

use nalgebra::{Matrix2, Rotation3, SVector, Vector2, Vector3, Vector6};

use super::bundle::{Bundle, GLOBAL, Global, INTERIOR, Prior, Solution, form_of};
use super::shape::{FORM, Form, Shape};
use super::{BoardPoint, CalibrateError, View, outliers, start};
use crate::measure::geometry::Lens;

/// The board's pose in the camera frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pose {
    pub camera_from_board: Rotation3<f64>,
    pub translation_m: Vector3<f64>,
}

impl Pose {
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

fn parameters(lens: &Lens) -> SVector<f64, INTERIOR> {
    let brown = [lens.fx, lens.fy, lens.cx, lens.cy, lens.k1, lens.k2, lens.k3, lens.p1, lens.p2];
    SVector::from_iterator(brown.into_iter().chain(lens.denominator))
}

pub(super) fn with_parameters(size: (u32, u32), p: &Global) -> Lens {
    let (width, height) = size;
    Lens {
        width,
        height,
        fx: p[0],
        fy: p[1],
        cx: p[2],
        cy: p[3],
        k1: p[4],
        k2: p[5],
        k3: p[6],
        p1: p[7],
        p2: p[8],
        denominator: [p[9], p[10], p[11]],
    }
}

/// A point's covariance with what all points have in common.
pub(super) fn with_common(own_px2: &Matrix2<f64>, model_sigma_px: f64) -> Matrix2<f64> {
    own_px2 + Matrix2::identity() * model_sigma_px.powi(2)
}

/// Camera, board and poses of one adjustment.
pub(super) struct Adjusted {
    pub lens: Lens,
    pub shape: Shape,
    pub form: Form,
    /// Of the stretch beforehand.
    pub stretch_sigma: f64,
    pub poses: Vec<Pose>,
    /// Parameters that keep their start.
    pub held: [bool; GLOBAL],
    pub solution: Solution,
    /// Common to all points, beyond their own, px.
    pub model_sigma_px: f64,
}

impl Adjusted {
    /// A point of a view (counted among those used), camera frame, m.
    pub(super) fn point(&self, k: usize, p: &BoardPoint) -> Vector3<f64> {
        self.poses[k].apply(&self.shape.point(&p.board_m, &self.form))
    }

    /// Per view, per point: observed - projected, px.
    pub(super) fn residuals(&self, used: &[(usize, View)]) -> Vec<Vec<Vector2<f64>>> {
        // Behind the camera: as gross as an error can be, and still finite when squared.
        let far = Vector2::new(1e6, 1e6);
        let one =
            |k: usize, p: &BoardPoint| self.lens.project(&self.point(k, p)).map_or(far, |q| p.pixel - q);
        used.iter().enumerate().map(|(k, (_, v))| v.iter().map(|p| one(k, p)).collect()).collect()
    }

    pub(super) fn covariance_px2(&self, p: &BoardPoint) -> Matrix2<f64> {
        with_common(&p.covariance_px2, self.model_sigma_px)
    }

    /// Squared lengths of the residuals in standard deviations.
    pub(super) fn squares(&self, used: &[(usize, View)], residuals: &[Vec<Vector2<f64>>]) -> Vec<Vec<f64>> {
        let square = |(p, r): (&BoardPoint, &Vector2<f64>)| {
            self.covariance_px2(p).try_inverse().map_or(0.0, |w| r.dot(&(w * r)))
        };
        used.iter().zip(residuals).map(|((_, v), r)| v.iter().zip(r).map(square).collect()).collect()
    }

    /// The variance that the points must have in common for the median of their squared lengths to be
    /// what it should (Paule and Mandel 1982, with the median for the mean), by bisection.
    pub(super) fn common_sigma_px(&self, used: &[(usize, View)]) -> f64 {
        let residuals = self.residuals(used).concat();
        let own: Vec<f64> =
            used.iter().flat_map(|(_, v)| v).map(|p| 0.5 * p.covariance_px2.trace()).collect();
        let squares: Vec<f64> = residuals.iter().map(Vector2::norm_squared).collect();
        // The adjustment takes its share of the residuals.
        let share = self.solution.redundancy as f64 / (2 * residuals.len()).max(1) as f64;
        outliers::common_variance(&squares, &own, outliers::MEDIAN_SQUARE * share).sqrt()
    }
}

/// Where an adjustment begins.
pub(super) struct Start {
    pub lens: Lens,
    pub form: Form,
    /// Standard deviation of the stretch beforehand; where it is held, without meaning.
    pub stretch_sigma: f64,
    pub poses: Vec<Pose>,
    pub held: [bool; GLOBAL],
}

impl Start {
    pub(super) fn of(adjusted: &Adjusted) -> Self {
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
pub(super) fn first(
    used: &[(usize, View)],
    (width, height): (u32, u32),
    held: [bool; GLOBAL],
    stretch_sigma: f64,
) -> Result<Adjusted, CalibrateError> {
    let views: Vec<&View> = used.iter().map(|(_, v)| v).collect();
    let from = |f_px: Option<f64>| {
        let (lens, poses) = start::start(&views, width, height, f_px).ok_or(CalibrateError::NoStart)?;
        // A lens without distortion first: all at once, few pictures run away.
        let start = Start { lens, form: Form::zeros(), stretch_sigma, poses, held };
        let mut rough = adjust_with(used, &start, FIRST_SIGMA_PX, STIFF[0])?;
        for stiff in &STIFF[1..] {
            rough = adjust_with(used, &Start::of(&rough), FIRST_SIGMA_PX, *stiff)?;
        }
        Ok(rough)
    };
    let told = from(None);
    if told.is_ok() {
        return told;
    }
    let tried = start::USUAL.iter().filter_map(|f| from(Some(f * f64::from(width))).ok());
    tried.min_by(|a, b| a.solution.omega.total_cmp(&b.solution.omega)).map_or(told, Ok)
}

/// Prior standard deviations of camera constant and distortion while both are rough, over those that hold at the end:
/// let free at once, a constant that hardly tilted boards leave open runs away with the distortion.
const STIFF: [f64; 4] = [1e-3, 1e-2, 1e-1, 1.0];

pub(super) fn adjust(
    used: &[(usize, View)],
    start: &Start,
    model_sigma_px: f64,
) -> Result<Adjusted, CalibrateError> {
    adjust_with(used, start, model_sigma_px, 1.0)
}

pub(super) fn adjust_with(
    used: &[(usize, View)],
    start: &Start,
    model_sigma_px: f64,
    stiff: f64,
) -> Result<Adjusted, CalibrateError> {
    let found = adjust_views(used, start, &vec![model_sigma_px; used.len()], stiff)?;
    Ok(Adjusted { model_sigma_px, ..found })
}

/// With a common standard deviation for each view, px.
pub(super) fn adjust_views(
    used: &[(usize, View)],
    start: &Start,
    common_px: &[f64],
    stiff: f64,
) -> Result<Adjusted, CalibrateError> {
    let views: Vec<&View> = used.iter().map(|(_, v)| v).collect();
    let size = (start.lens.width, start.lens.height);
    let shape = Shape::of(&views);
    let priors = [lens_priors(&start.lens, stiff), shape.priors(INTERIOR, start.stretch_sigma)].concat();
    let held = start.held;
    let bundle = Bundle { views: &views, size, shape, priors, held, common_px };
    let mut global = Global::zeros();
    global.fixed_rows_mut::<INTERIOR>(0).copy_from(&parameters(&start.lens));
    global.fixed_rows_mut::<FORM>(INTERIOR).copy_from(&start.form);
    let solution = bundle.solve(global, &start.poses).ok_or(CalibrateError::NoFit)?;
    let lens = with_parameters(size, &solution.global);
    let form = form_of(&solution.global);
    let poses = solution.poses.clone();
    let stretch_sigma = start.stretch_sigma;
    Ok(Adjusted { lens, shape, form, stretch_sigma, poses, held, solution, model_sigma_px: 0.0 })
}

/// What every lens keeps to, for pictures that do not tell: the camera constant is within its own size of where
/// it began, the principal point lies within a tenth of the image's width of its middle, and no term of the
/// distortion moves the image's corner by more than its distance from the middle (one standard deviation). It keeps few pictures from running
/// away. The sizes are an assumption, chosen wide.
fn lens_priors(start: &Lens, stiff: f64) -> Vec<Prior> {
    let (width, height) = (f64::from(start.width), f64::from(start.height));
    let corner = 0.5 * width.hypot(height) / start.fx;
    let middle = start::middle(start.width, start.height);
    let mean = |k: usize| match k {
        0 | 1 => start.fx,
        2 | 3 => middle[k - 2],
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
    sigmas.into_iter().map(|(index, sigma)| Prior { index, mean: mean(index), sigma }).collect()
}
