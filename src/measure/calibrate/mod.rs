//! Pictures of a board -> interior orientation.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | find | grey picture, board | board points and their pixels | `checkerboard.rs`, `aprilgrid.rs` |
//! | measure | grey values, about where | corner and its covariance | `saddle.rs`, `corner.rs` |
//! | start | views | camera constant, poses | `start.rs` |
//! | adjust | views, start | camera, board's bow, covariance | `bundle.rs`, `shape.rs` |
//! | leave out | residuals | pictures and points that fit | `outliers.rs` |
//! | judge | covariance, residuals | projection uncertainty, halves, patterns, verdict | `quality.rs`, `check.rs`, `verdict.rs` |

#[cfg(feature = "aprilgrid")]
mod aprilgrid;
mod board;
mod bundle;
mod check;
mod checkerboard;
mod corner;
mod outliers;
mod quality;
mod reduced;
mod saddle;
mod shape;
mod start;
mod verdict;

use nalgebra::{DMatrix, Matrix2, Rotation3, SVector, Vector2, Vector3, Vector6};

pub use board::{Board, BoardError, Misfit, Sighting, misdescribed};

use super::geometry::Lens;
use bundle::{Bundle, GLOBAL, Global, INTERIOR, Prior, Solution};
pub use check::{Halves, Pattern};
pub use outliers::Dropped;
use outliers::Selection;
pub use quality::{DISTANCES_M, Projection};
pub use shape::Bow;
use shape::Shape;
pub use verdict::{Verdict, judge};

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
pub type View = Vec<BoardPoint>;

/// A calibrated camera with its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The estimate.
    pub lens: Lens,
    /// 9 x 9, order fx fy cx cy k1 k2 k3 p1 p2; scaled by the residuals.
    pub covariance: DMatrix<f64>,
    /// Root mean square of the residual vectors, px.
    pub rms_px: f64,
    /// Standard deviation per coordinate that all points have beyond their own, px: what board and lens
    /// leave over.
    pub model_sigma_px: f64,
    /// The board's bow along its rows and its columns.
    pub bow: [Bow; 2],
    /// Per view: the root mean square of its residual vectors, px; `None` where it was rejected.
    pub view_rms_px: Vec<Option<f64>>,
    /// Per view: why it took no part.
    pub dropped: Vec<Option<Dropped>>,
    /// Per view: points that took part.
    pub view_points: Vec<usize>,
    /// Per view that took part: angle between the board and the image plane, degrees.
    pub tilt_deg: Vec<Option<f64>>,
    /// Points that took part in each ninth of the image: row, column from the upper left.
    pub coverage: [[usize; 3]; 3],
    /// Image points that took part.
    pub observations: usize,
    /// Interior parameters that were held at 0, order as in the covariance.
    pub held: [bool; 9],
    /// Every second picture against the others; `None` where they are too few.
    pub halves: Option<Halves>,
    /// What the residuals have in common.
    pub pattern: Pattern,
    /// Per view, empty where it took no part: each point's place in the image and observed - projected, px.
    pub residuals: Vec<Vec<(Vector2<f64>, Vector2<f64>)>>,
    /// Sides of the rectangle in which the board's points lie, m.
    pub board_side_m: [f64; 2],
    /// Uncertainty in the picture at [`DISTANCES_M`]; `None` where the lens has no inverse over the image.
    pub projections: Option<Vec<Projection>>,
}

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    /// Too few pictures with a board.
    #[error("{found} pictures show the board, at least {needed} in different attitudes are needed")]
    TooFewViews {
        /// With a board.
        found: usize,
        /// Needed.
        needed: usize,
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
const LEAST_VIEWS: usize = 3;
/// Points of one view needed for its pose and a check.
const LEAST_POINTS: usize = 8;
/// Rounds in which the points' common variance settles.
const MODEL_ROUNDS: usize = 8;
/// A change of the common standard deviation that no longer matters: its share, and px.
const MODEL_SETTLED: (f64, f64) = (0.05, 1e-3);

/// Calibrates from views of a plane board; `width` and `height` of the pictures, px.
pub fn calibrate(views: &[View], width: u32, height: u32) -> Result<Calibration, CalibrateError> {
    calibrate_with(views, width, height, false)
}

/// The same; with `select`, distortion terms that do not differ from 0 at 95 % are dropped, the least first and of
/// the radial ones the highest.
pub fn calibrate_with(
    views: &[View],
    width: u32,
    height: u32,
    select: bool,
) -> Result<Calibration, CalibrateError> {
    let mut selection = Selection::first(views, width, height);
    let mut adjusted = first(&selection.used, width, height)?;
    loop {
        adjusted = settled(adjusted, &selection.used)?;
        let before: Vec<usize> = selection.used.iter().map(|(k, _)| *k).collect();
        // Each round takes something out: they end.
        let apart = robust(&adjusted, &selection.used)?;
        if !selection.narrow(&apart, views) {
            let adjusted = if select { selected(adjusted, &selection.used)? } else { adjusted };
            return Ok(outcome(&adjusted, selection));
        }
        if selection.used.len() < LEAST_VIEWS {
            return Err(CalibrateError::TooFewViews { found: selection.used.len(), needed: LEAST_VIEWS });
        }
        let stays = |k: &usize| selection.used.iter().any(|(index, _)| index == k);
        let mut stay = before.iter().map(stays);
        adjusted.poses.retain(|_| stay.next().unwrap_or(false));
    }
}

/// Rounds in which the pictures' own variances settle.
const ROBUST_ROUNDS: usize = 10;

/// For the tests: each picture's points count as its own residuals deserve (a variance component each), so that
/// the many that agree are not pulled by one that does not. Its common variance is that of all pictures.
fn robust(adjusted: &Adjusted, used: &[(usize, View)]) -> Result<Adjusted, CalibrateError> {
    let mut start = Start::of(adjusted);
    let mut residuals = adjusted.residuals(used);
    for round in 1.. {
        let own: Vec<f64> = residuals.iter().map(|r| outliers::coordinate_px(r)).collect();
        let mut found = adjust_views(used, &start, &own, 1.0)?;
        if round == ROBUST_ROUNDS {
            found.model_sigma_px = found.common_sigma_px(used);
            return Ok(found);
        }
        (residuals, start) = (found.residuals(used), Start::of(&found));
    }
    Err(CalibrateError::NoFit)
}

/// Some hundred points leave Student's t at the normal's.
const SIGNIFICANT: f64 = 1.96;

/// Without the distortion terms that do not differ from 0.
fn selected(mut adjusted: Adjusted, used: &[(usize, View)]) -> Result<Adjusted, CalibrateError> {
    loop {
        let weak = check::droppable(&adjusted.held)
            .into_iter()
            .map(|k| (k, check::t_value(&adjusted, k)))
            .filter(|(_, t)| *t < SIGNIFICANT)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((k, _)) = weak else { return Ok(adjusted) };
        let mut start = Start::of(&adjusted);
        start.held[k] = true;
        start.lens = start
            .lens
            .changed(&SVector::from_fn(|i, _| if i == k { -adjusted.solution.global[k] } else { 0.0 }));
        adjusted = settled(adjust(used, &start, adjusted.model_sigma_px)?, used)?;
    }
}

/// Adjusted again until the variance that all points have in common no longer changes.
fn settled(mut adjusted: Adjusted, used: &[(usize, View)]) -> Result<Adjusted, CalibrateError> {
    for _ in 0..MODEL_ROUNDS {
        let before = adjusted.model_sigma_px;
        adjusted = adjust(used, &Start::of(&adjusted), before)?;
        let after = adjusted.common_sigma_px(used);
        if (after - before).abs() <= MODEL_SETTLED.0 * before.max(after) + MODEL_SETTLED.1 {
            break;
        }
        adjusted.model_sigma_px = after;
    }
    Ok(adjusted)
}

/// The board's pose in the camera frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    camera_from_board: Rotation3<f64>,
    translation_m: Vector3<f64>,
}

impl Pose {
    /// Camera-frame point, m.
    fn apply(&self, board_m: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_board * board_m + self.translation_m
    }

    /// Moved by a rotation about the camera and a shift.
    fn moved(&self, by: &Vector6<f64>) -> Self {
        let turn = Rotation3::new(by.fixed_rows::<3>(0).clone_owned());
        let shift = by.fixed_rows::<3>(3).clone_owned();
        Self {
            camera_from_board: turn * self.camera_from_board,
            translation_m: turn * self.translation_m + shift,
        }
    }
}

fn parameters(lens: &Lens) -> [f64; 9] {
    [lens.fx, lens.fy, lens.cx, lens.cy, lens.k1, lens.k2, lens.k3, lens.p1, lens.p2]
}

fn with_parameters(size: (u32, u32), p: &Global) -> Lens {
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
    }
}

/// A point's covariance with what all points have in common.
fn with_common(own_px2: &Matrix2<f64>, model_sigma_px: f64) -> Matrix2<f64> {
    own_px2 + Matrix2::identity() * model_sigma_px.powi(2)
}

/// Camera, board and poses of one adjustment.
struct Adjusted {
    lens: Lens,
    shape: Shape,
    bow_m: [f64; 2],
    poses: Vec<Pose>,
    /// Parameters that keep their start.
    held: [bool; GLOBAL],
    solution: Solution,
    /// Common to all points, beyond their own, px.
    model_sigma_px: f64,
}

impl Adjusted {
    /// A point of a view (counted among those used), camera frame, m.
    fn point(&self, k: usize, p: &BoardPoint) -> Vector3<f64> {
        self.poses[k].apply(&self.shape.point(&p.board_m, &self.bow_m))
    }

    /// Per view, per point: observed - projected, px.
    fn residuals(&self, used: &[(usize, View)]) -> Vec<Vec<Vector2<f64>>> {
        // Behind the camera: as gross as an error can be, and still finite when squared.
        let far = Vector2::new(1e6, 1e6);
        let one =
            |k: usize, p: &BoardPoint| self.lens.project(&self.point(k, p)).map_or(far, |q| p.pixel - q);
        used.iter().enumerate().map(|(k, (_, v))| v.iter().map(|p| one(k, p)).collect()).collect()
    }

    fn covariance_px2(&self, p: &BoardPoint) -> Matrix2<f64> {
        with_common(&p.covariance_px2, self.model_sigma_px)
    }

    /// Squared lengths of the residuals in standard deviations.
    fn squares(&self, used: &[(usize, View)], residuals: &[Vec<Vector2<f64>>]) -> Vec<Vec<f64>> {
        let square = |(p, r): (&BoardPoint, &Vector2<f64>)| {
            self.covariance_px2(p).try_inverse().map_or(0.0, |w| r.dot(&(w * r)))
        };
        used.iter().zip(residuals).map(|((_, v), r)| v.iter().zip(r).map(square).collect()).collect()
    }

    /// The variance that the points must have in common for the median of their squared lengths to be
    /// what it should (Paule and Mandel 1982, with the median for the mean), by bisection.
    fn common_sigma_px(&self, used: &[(usize, View)]) -> f64 {
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
struct Start {
    lens: Lens,
    bow_m: [f64; 2],
    poses: Vec<Pose>,
    held: [bool; GLOBAL],
}

impl Start {
    fn of(adjusted: &Adjusted) -> Self {
        Self {
            lens: adjusted.lens,
            bow_m: adjusted.bow_m,
            poses: adjusted.poses.clone(),
            held: adjusted.held,
        }
    }
}

/// Points' common standard deviation before residuals tell it, px.
const FIRST_SIGMA_PX: f64 = 0.1;

/// From nothing: the camera constant that the homographies tell, or where the adjustment does not converge
/// from there, that of the usual lenses from which it comes closest.
fn first(used: &[(usize, View)], width: u32, height: u32) -> Result<Adjusted, CalibrateError> {
    if used.len() < LEAST_VIEWS {
        return Err(CalibrateError::TooFewViews { found: used.len(), needed: LEAST_VIEWS });
    }
    let views: Vec<&View> = used.iter().map(|(_, v)| v).collect();
    let from = |f_px: Option<f64>| {
        let (lens, poses) = start::start(&views, width, height, f_px).ok_or(CalibrateError::NoStart)?;
        // A lens without distortion first: all at once, few pictures run away.
        let start = Start { lens, bow_m: [0.0; 2], poses, held: [false; GLOBAL] };
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

fn adjust(used: &[(usize, View)], start: &Start, model_sigma_px: f64) -> Result<Adjusted, CalibrateError> {
    adjust_with(used, start, model_sigma_px, 1.0)
}

fn adjust_with(
    used: &[(usize, View)],
    start: &Start,
    model_sigma_px: f64,
    stiff: f64,
) -> Result<Adjusted, CalibrateError> {
    let found = adjust_views(used, start, &vec![model_sigma_px; used.len()], stiff)?;
    Ok(Adjusted { model_sigma_px, ..found })
}

/// With a common standard deviation for each view, px.
fn adjust_views(
    used: &[(usize, View)],
    start: &Start,
    common_px: &[f64],
    stiff: f64,
) -> Result<Adjusted, CalibrateError> {
    let views: Vec<&View> = used.iter().map(|(_, v)| v).collect();
    let size = (start.lens.width, start.lens.height);
    let shape = Shape::of(&views);
    let priors = [lens_priors(&start.lens, stiff), shape.priors(INTERIOR)].concat();
    let held = start.held;
    let bundle = Bundle { views: &views, size, shape, priors, held, common_px };
    let mut global = Global::zeros();
    global.fixed_rows_mut::<INTERIOR>(0).copy_from(&SVector::from(parameters(&start.lens)));
    global.fixed_rows_mut::<2>(INTERIOR).copy_from(&Vector2::from(start.bow_m));
    let solution = bundle.solve(global, &start.poses).ok_or(CalibrateError::NoFit)?;
    let lens = with_parameters(size, &solution.global);
    let bow_m = [solution.global[INTERIOR], solution.global[INTERIOR + 1]];
    let poses = solution.poses.clone();
    Ok(Adjusted { lens, shape, bow_m, poses, held, solution, model_sigma_px: 0.0 })
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
    ];
    sigmas.into_iter().map(|(index, sigma)| Prior { index, mean: mean(index), sigma }).collect()
}

/// Root mean square of vectors' lengths.
fn rms<'a>(vectors: impl Iterator<Item = &'a Vector2<f64>>) -> f64 {
    let (sum, n) = vectors.fold((0.0, 0usize), |(s, n), r| (s + r.norm_squared(), n + 1));
    (sum / n.max(1) as f64).sqrt()
}

fn outcome(adjusted: &Adjusted, selection: Selection) -> Calibration {
    let Selection { used, dropped } = selection;
    let dropped_count = dropped.len();
    let solution = &adjusted.solution;
    let residuals = adjusted.residuals(&used);
    let covariance = solution.covariance * solution.variance_factor();
    let bow = |k: usize| Bow {
        value_m: adjusted.bow_m[k],
        sigma_m: covariance[(INTERIOR + k, INTERIOR + k)].max(0.0).sqrt(),
    };
    let mut found = Calibration {
        lens: adjusted.lens,
        bow: [bow(0), bow(1)],
        covariance: DMatrix::from_fn(INTERIOR, INTERIOR, |i, j| covariance[(i, j)]),
        rms_px: rms(residuals.iter().flatten()),
        model_sigma_px: adjusted.model_sigma_px,
        view_rms_px: vec![None; dropped.len()],
        view_points: vec![0; dropped.len()],
        tilt_deg: vec![None; dropped.len()],
        coverage: coverage(&adjusted.lens, &used),
        dropped,
        observations: residuals.iter().map(Vec::len).sum(),
        held: std::array::from_fn(|k| adjusted.held[k]),
        halves: check::halves(adjusted, &used),
        pattern: check::pattern(adjusted, &used),
        residuals: vec![vec![]; dropped_count],
        board_side_m: adjusted.shape.sides_m(),
        projections: quality::projections(adjusted, &used, &covariance),
    };
    for (((index, view), r), pose) in used.iter().zip(&residuals).zip(&adjusted.poses) {
        found.view_rms_px[*index] = Some(rms(r.iter()));
        found.view_points[*index] = view.len();
        found.residuals[*index] = view.iter().map(|p| p.pixel).zip(r.iter().copied()).collect();
        let normal_z = pose.camera_from_board.matrix()[(2, 2)];
        found.tilt_deg[*index] = Some(normal_z.abs().min(1.0).acos().to_degrees());
    }
    found
}

fn coverage(lens: &Lens, used: &[(usize, View)]) -> [[usize; 3]; 3] {
    let ninth = |value: f64, side: u32| ((3.0 * value / f64::from(side)).max(0.0) as usize).min(2);
    let mut counts = [[0; 3]; 3];
    for p in used.iter().flat_map(|(_, v)| v) {
        counts[ninth(p.pixel.y, lens.height)][ninth(p.pixel.x, lens.width)] += 1;
    }
    counts
}
