//! Pictures of a board -> interior orientation.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | find | grey picture, board | board points and their pixels | `board.rs`, `find.rs`, `checkerboard.rs`, `aprilgrid.rs` |
//! | measure | grey values, about where | corner and its covariance | `saddle.rs`, `corner.rs` |
//! | start | views | camera constant, poses | `start.rs` |
//! | adjust | views, start | camera, board's bow and stretch, covariance | `adjust.rs`, `model.rs`, `shape.rs`, `bundle.rs` |
//! | leave out | residuals | pictures and points that fit, the model that they tell | `outliers.rs`, `fitting.rs` |
//! | judge | covariance, residuals | projection uncertainty, halves, patterns, verdict | `outcome.rs`, `quality.rs`, `check.rs`, `verdict.rs` |

mod adjust;
#[cfg(feature = "aprilgrid")]
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

pub use board::{Board, BoardError, BoardMismatch, BoardDetection, description_mismatch, missing_corner_lines};

use super::geometry::Lens;
pub use check::{Halves, ResidualPattern};
use fitting::CalibrationProblem;
pub use model::DISTANCES_M;
use model::ImageSize;
pub use outliers::ImageRejection;
pub use quality::ProjectionUncertainty;
pub use shape::{BoardBow, BoardStretch};
pub use verdict::{Verdict, judge_calibration, count_refusals};

/// A board point (board plane, m) and its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPoint {
    /// In the board's plane, m.
    pub board_m: Vector2<f64>,
    /// px.
    pub pixel: Vector2<f64>,
    /// Of the pixel as measured, px^2.
    pub covariance_px2: Matrix2<f64>,
}

impl BoardPoint {
    /// A point that is alike known in all directions; standard deviation of a coordinate, px.
    pub fn new(board_m: Vector2<f64>, pixel: Vector2<f64>, sigma_px: f64) -> Self {
        Self { board_m, pixel, covariance_px2: Matrix2::identity() * sigma_px * sigma_px }
    }
}

/// One picture's points.
pub type BoardView = Vec<BoardPoint>;

/// A calibrated camera with its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The estimate.
    pub lens: Lens,
    /// 9 x 9, order fx fy cx cy k1 k2 k3 p1 p2; scaled by the residuals. Of a rational lens: while its denominator stays
    /// as it is, with what that is uncertain by carried over.
    pub covariance: DMatrix<f64>,
    /// Standard deviations of k4, k5, k6; 0 for Brown's model.
    pub denominator_sigma: [f64; 3],
    /// Root mean square of the residual vectors, px.
    pub rms_px: f64,
    /// Standard deviation per coordinate that all points have beyond their own, px: what board and lens
    /// leave over.
    pub model_sigma_px: f64,
    /// The board's bow along its rows and its columns.
    pub bow: [BoardBow; 2],
    /// By how much more the board is stretched across its rows than along them; `None` where that cannot be told.
    pub stretch: Option<BoardStretch>,
    /// Per view: the root mean square of its residual vectors, px; `None` where it was rejected.
    pub view_rms_px: Vec<Option<f64>>,
    /// Per view: why it took no part.
    pub dropped: Vec<Option<ImageRejection>>,
    /// Per view: points that took part.
    pub view_points: Vec<usize>,
    /// Per view that took part: angle between the board and the image plane, degrees.
    pub tilt_deg: Vec<Option<f64>>,
    /// Root mean square angle of the boards' normals from their mean direction, degrees: 0 where all are parallel.
    pub spread_deg: f64,
    /// Points that took part in each ninth of the image: row, column from the upper left.
    pub coverage: [[usize; 3]; 3],
    /// Image points that took part.
    pub observations: usize,
    /// How far from the principal point boards were found, px; points that no model fits count too.
    pub shown_px: f64,
    /// Interior parameters that were held at 0, order as in the covariance.
    pub held: [bool; 9],
    /// Every second picture against the others; `None` where they are too few.
    pub halves: Option<Halves>,
    /// What the residuals have in common.
    pub pattern: ResidualPattern,
    /// Per view, empty where it took no part: each point's place in the image and observed - projected, px.
    pub residuals: Vec<Vec<(Vector2<f64>, Vector2<f64>)>>,
    /// Sides of the rectangle in which the board's points lie, m.
    pub board_side_m: [f64; 2],
    /// Uncertainty in the picture at [`DISTANCES_M`]; `None` where the lens has no inverse over the image.
    pub projections: Option<Vec<ProjectionUncertainty>>,
}

/// Share of the way from the principal point to the image's farthest corner to which boards must have been shown for
/// a lens's model to be told: beyond, any is a guess.
const SHOWN: f64 = 0.9;

impl Calibration {
    /// From the principal point to the image's farthest corner, px.
    fn farthest_corner_px(&self) -> Vector2<f64> {
        let (w, h) = (f64::from(self.lens.width) - 1.0, f64::from(self.lens.height) - 1.0);
        let centre = Vector2::new(self.lens.cx, self.lens.cy);
        let corners = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(u, v)| Vector2::new(u, v) - centre);
        corners.into_iter().fold(Vector2::zeros(), |a, b| if b.norm() > a.norm() { b } else { a })
    }

    /// Whether boards were shown into a corner of the image.
    fn covers_corner(&self) -> bool {
        self.shown_px >= SHOWN * self.farthest_corner_px().norm()
    }
}

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    /// Too few pictures with a board.
    #[error(
        "{found} of the pictures with a board can be used, at least {needed} in different attitudes are needed, fifteen to \
         twenty for a camera to fly with"
    )]
    TooFewViews {
        /// That can be used.
        found: usize,
        /// Needed.
        needed: usize,
        /// Per view: why it took no part.
        dropped: Vec<Option<ImageRejection>>,
    },
    /// All boards parallel to the sensor, or the like.
    #[error(
        "the pictures do not determine the camera constant; tilt the board by 20 to 40 degrees in several of them, \
         and count its rows and columns: a board that is not as described shows the same"
    )]
    NoStart,
    /// No camera fits the pictures.
    #[error(
        "no camera fits the pictures; is the board as described, are its rows, columns and gaps counted and \
         measured? Tilt it by 20 to 40 degrees and show it in all corners of the image"
    )]
    NoFit,
}

/// Views needed: below, the nine interior parameters are not checked at all.
const MIN_VIEWS: usize = 3;
/// Points of one view needed for its pose and a check.
const MIN_POINTS: usize = 8;
/// Some hundred points leave Student's t at the normal's.
const SIGNIFICANT: f64 = 1.96;

/// What may be asked of a calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CalibrationOptions {
    /// Distortion terms that do not differ from 0 at 95 % are dropped, the least first and of the radial ones the
    /// highest.
    pub select: bool,
    /// To which share the board's lengths along and across are each known, one standard deviation; `None`: exactly.
    pub scale_sigma: Option<f64>,
}

/// Calibrates from views of a plane board that is exactly as described; `width` and `height` of the pictures, px.
pub fn calibrate(views: &[BoardView], width: u32, height: u32) -> Result<Calibration, CalibrateError> {
    calibrate_with_options(views, width, height, &CalibrationOptions::default())
}

/// The same with options.
pub fn calibrate_with_options(
    views: &[BoardView],
    width: u32,
    height: u32,
    options: &CalibrationOptions,
) -> Result<Calibration, CalibrateError> {
    let set = CalibrationProblem { views, size: ImageSize { width, height }, options };
    let (brown, selection) = set.fit_without_outliers(false)?;
    let found = set.calibration(&brown, &selection);
    // The richer model only where Brown's does not do: elsewhere its terms tell nothing and blur the others. And only
    // where boards told the lens up to the image's border: it bends as it likes beyond.
    let does = found.projections.is_some() && found.pattern.image_px <= Verdict::PATTERN_PX;
    if does || !found.covers_corner() {
        return Ok(found);
    }
    let richer = set.rational_calibration(&brown, &selection).filter(|r| r.projections.is_some());
    Ok(richer.unwrap_or(found))
}
