//! Camera calibration: images of a board in, interior orientation out.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | find | grey image, board | board points and their pixels | `board.rs`, `find.rs`, `checkerboard.rs`, `aprilgrid.rs`, `other_tags.rs` |
//! | measure | grey values, approximate position | corner and its covariance | `saddle.rs`, `corner.rs` |
//! | start | views | focal length, poses | `start.rs` |
//! | adjust | views, start | camera, board's bow and stretch, covariance | `adjust.rs`, `model.rs`, `shape.rs`, `bundle.rs` |
//! | remove outliers | residuals | images and points that fit, the lens model | `outliers.rs`, `fitting.rs` |
//! | judge | covariance, residuals | projection uncertainty, halves, patterns, verdict | `outcome.rs`, `quality.rs`, `check.rs`, `verdict.rs` |

mod adjust;
#[cfg(feature = "boards")]
mod aprilgrid;
mod board;
mod bundle;
mod check;
#[cfg(feature = "boards")]
mod checkerboard;
#[cfg(feature = "boards")]
mod corner;
#[cfg(feature = "boards")]
mod find;
mod fitting;
mod model;
#[cfg(feature = "boards")]
mod other_tags;
mod outcome;
mod outliers;
mod quality;
#[cfg(feature = "boards")]
mod reduced;
#[cfg(feature = "boards")]
mod saddle;
mod shape;
mod start;
mod verdict;

use nalgebra::{DMatrix, Matrix2, Vector2};

pub use board::{
    Board, BoardDetection, BoardError, BoardMismatch, description_mismatch, missing_corner_lines,
};

use super::geometry::Lens;
pub use check::{Halves, ResidualPattern};
use fitting::CalibrationProblem;
pub use model::DISTANCES_M;
use model::ImageSize;
pub use outliers::ImageRejection;
pub use quality::ProjectionUncertainty;
pub use shape::{BoardBow, BoardStretch};
pub use verdict::{Verdict, count_refusals, judge_calibration};

/// A board point (board plane, m) and its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPoint {
    /// Position in the board's plane, m.
    pub board_m: Vector2<f64>,
    /// Position in the image, px.
    pub pixel: Vector2<f64>,
    /// Covariance of the measured pixel.
    pub covariance_px2: Matrix2<f64>,
}

impl BoardPoint {
    /// Creates a point with the standard deviation `sigma_px` in every direction.
    pub fn new(board_m: Vector2<f64>, pixel: Vector2<f64>, sigma_px: f64) -> Self {
        Self {
            board_m,
            pixel,
            covariance_px2: Matrix2::identity() * sigma_px * sigma_px,
        }
    }
}

/// Points of one image.
pub type BoardView = Vec<BoardPoint>;

/// A calibrated camera with its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    pub lens: Lens,
    /// Covariance, 9 x 9, order fx fy cx cy k1 k2 k3 p1 p2; scaled by the residuals. For a rational lens: with the
    /// denominator fixed, its uncertainty being transferred to these parameters.
    pub covariance: DMatrix<f64>,
    /// Standard deviations of k4, k5, k6; 0 for Brown's model.
    pub denominator_sigma: [f64; 3],
    /// Root mean square of the residual vectors, px.
    pub rms_px: f64,
    /// Standard deviation per coordinate that all points have in addition to their own, px: deviations of board and lens
    /// from their models.
    pub model_sigma_px: f64,
    /// The board's bow along its rows and its columns.
    pub bow: [BoardBow; 2],
    /// Stretch of the board across its rows against along them; `None` if it cannot be estimated.
    pub stretch: Option<BoardStretch>,
    /// Root mean square of the residual vectors of each view, px; `None` if it was rejected.
    pub view_rms_px: Vec<Option<f64>>,
    /// Reason for the rejection of each view.
    pub rejections: Vec<Option<ImageRejection>>,
    /// Number of points used of each view.
    pub view_points: Vec<usize>,
    /// Angle between the board and the image plane in each view, degrees; `None` if it was rejected.
    pub tilt_deg: Vec<Option<f64>>,
    /// Root mean square angle of the boards' normals from their mean direction, degrees: 0 if they are parallel.
    pub spread_deg: f64,
    /// Points used in each ninth of the image: row, column from the upper left.
    pub coverage: [[usize; 3]; 3],
    /// Number of image points used.
    pub observations: usize,
    /// Largest distance of a board point from the principal point, px; rejected points count too.
    pub covered_radius_px: f64,
    /// Interior parameters that were fixed at 0, order as in the covariance.
    pub fixed: [bool; 9],
    /// Comparison of two halves of the images; `None` if there are too few.
    pub halves: Option<Halves>,
    pub pattern: ResidualPattern,
    /// Image position and observed - projected, px, of each point of each view; empty for rejected views.
    pub residuals: Vec<Vec<(Vector2<f64>, Vector2<f64>)>>,
    /// Sides of the rectangle in which the board's points lie, m.
    pub board_side_m: [f64; 2],
    /// Projection uncertainty at [`DISTANCES_M`]; `None` if the lens has no inverse over the whole image.
    pub projections: Option<Vec<ProjectionUncertainty>>,
}

/// Minimum distance from the principal point at which boards must have been shown, as a fraction of that of the farthest
/// corner: beyond it the lens model is an extrapolation.
const MIN_COVERED_FRACTION: f64 = 0.9;

impl Calibration {
    /// Returns the vector from the principal point to the image's farthest corner, px.
    fn farthest_corner_px(&self) -> Vector2<f64> {
        let (w, h) = (
            f64::from(self.lens.width) - 1.0,
            f64::from(self.lens.height) - 1.0,
        );
        let centre = Vector2::new(self.lens.cx, self.lens.cy);
        let corners =
            [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(u, v)| Vector2::new(u, v) - centre);
        corners.into_iter().fold(
            Vector2::zeros(),
            |a, b| if b.norm() > a.norm() { b } else { a },
        )
    }

    /// Returns true if boards were shown close to a corner of the image.
    fn covers_corner(&self) -> bool {
        self.covered_radius_px >= MIN_COVERED_FRACTION * self.farthest_corner_px().norm()
    }
}

/// Reason why a calibration failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    /// Too few usable images of the board.
    #[error(
        "only {found} images of the board are usable; at least {needed} in different orientations are \
         needed, and 15 to 20 for a camera used in flight"
    )]
    TooFewViews {
        /// Usable images.
        found: usize,
        needed: usize,
        /// Reason for the rejection of each view.
        rejections: Vec<Option<ImageRejection>>,
    },
    /// Focal length not determined: for example, boards parallel to the sensor.
    #[error(
        "the images do not determine the focal length; tilt the board by 20 to 40 degrees in several of \
         them, and check its rows and columns: a wrong description has the same effect"
    )]
    NoStart,
    /// No convergence.
    #[error(
        "no camera fits the images; check the board's description (rows, columns, gaps), tilt it by 20 to \
         40 degrees and show it in all corners of the image"
    )]
    NoFit,
}

/// Minimum number of views. With fewer, the nine interior parameters cannot be checked.
const MIN_VIEWS: usize = 3;
/// Minimum number of points of a view, for its pose and a check.
const MIN_POINTS: usize = 8;
/// Two-sided 95 % limit of Student's t, for hundreds of points.
const T_LIMIT_95: f64 = 1.96;

/// Options of a calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CalibrationOptions {
    /// Fixes distortion terms at 0 that do not differ from it at 95 %, the least significant first and the highest radial
    /// one first.
    pub select: bool,
    /// Relative standard deviation of the board's lengths along and across; `None`: exact.
    pub scale_sigma: Option<f64>,
}

/// Calibrates from views of a plane board with exact dimensions; `width` and `height` of the images, px.
///
/// # Errors
/// Returns an error if too few views are usable or no camera fits them.
pub fn calibrate(
    views: &[BoardView],
    width: u32,
    height: u32,
) -> Result<Calibration, CalibrateError> {
    calibrate_with_options(views, width, height, &CalibrationOptions::default())
}

/// Calibrates like [`calibrate`], with options.
///
/// # Errors
/// Returns an error if too few views are usable or no camera fits them.
pub fn calibrate_with_options(
    views: &[BoardView],
    width: u32,
    height: u32,
    options: &CalibrationOptions,
) -> Result<Calibration, CalibrateError> {
    let set = CalibrationProblem {
        views,
        size: ImageSize { width, height },
        options,
    };
    let (brown, selection) = set.fit_without_outliers(false)?;
    let found = set.calibration(&brown, &selection);
    // The rational model only if Brown's does not fit, as its terms would otherwise only weaken the others,
    // and only if boards cover the image up to the corners, as it is arbitrary beyond.
    let brown_fits = found.projections.is_some() && found.pattern.image_px <= Verdict::PATTERN_PX;
    if brown_fits || !found.covers_corner() {
        return Ok(found);
    }
    let rational = set
        .rational_calibration(&brown, &selection)
        .filter(|r| r.projections.is_some());
    Ok(rational.unwrap_or(found))
}
