//! Pictures of a board -> interior orientation.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | find | grey picture, board | board points and their pixels | `checkerboard.rs`, `aprilgrid.rs` |
//! | measure | grey values, about where | corner and its covariance | `saddle.rs`, `corner.rs` |
//! | start | views | camera constant, poses | `start.rs` |
//! | adjust | views, start | camera, board's bow and stretch, covariance | `adjust.rs`, `bundle.rs`, `shape.rs` |
//! | leave out | residuals | pictures and points that fit | `outliers.rs` |
//! | judge | covariance, residuals | projection uncertainty, halves, patterns, verdict | `quality.rs`, `check.rs`, `verdict.rs` |

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
mod outliers;
mod quality;
#[cfg(feature = "boards")]
mod reduced;
#[cfg(feature = "boards")]
mod saddle;
mod shape;
mod start;
mod verdict;

use nalgebra::{DMatrix, Matrix2, Vector2, Vector3};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use adjust::{Adjusted, Start, adjust, adjust_views, first, with_parameters};
pub use board::{Board, BoardError, Misfit, Sighting, misdescribed, never_whole};

use super::geometry::Lens;
use bundle::{BROWN, GLOBAL, INTERIOR, STRETCH};
pub use check::{Halves, Pattern};
pub use outliers::Dropped;
use outliers::Selection;
pub use quality::{DISTANCES_M, Projection};
pub use shape::{Bow, Stretch};
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
    pub bow: [Bow; 2],
    /// By how much more the board is stretched across its rows than along them; `None` where that cannot be told.
    pub stretch: Option<Stretch>,
    /// Per view: the root mean square of its residual vectors, px; `None` where it was rejected.
    pub view_rms_px: Vec<Option<f64>>,
    /// Per view: why it took no part.
    pub dropped: Vec<Option<Dropped>>,
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
    pub told_px: f64,
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

/// Share of the way from the principal point to the image's farthest corner to which boards must have been shown for
/// a lens's model to be told: beyond, any is a guess.
const TOLD: f64 = 0.9;

impl Calibration {
    /// From the principal point to the image's farthest corner, px.
    fn farthest_corner_px(&self) -> Vector2<f64> {
        let (w, h) = (f64::from(self.lens.width) - 1.0, f64::from(self.lens.height) - 1.0);
        let middle = Vector2::new(self.lens.cx, self.lens.cy);
        let corners = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(u, v)| Vector2::new(u, v) - middle);
        corners.into_iter().fold(Vector2::zeros(), |a, b| if b.norm() > a.norm() { b } else { a })
    }

    /// Whether boards were shown into a corner of the image.
    fn is_told(&self) -> bool {
        self.told_px >= TOLD * self.farthest_corner_px().norm()
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
        dropped: Vec<Option<Dropped>>,
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

/// What may be asked of a calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Distortion terms that do not differ from 0 at 95 % are dropped, the least first and of the radial ones the
    /// highest.
    pub select: bool,
    /// To which share the board's lengths along and across are each known, one standard deviation; `None`: exactly.
    pub scale_sigma: Option<f64>,
}

/// Calibrates from views of a plane board that is exactly as described; `width` and `height` of the pictures, px.
pub fn calibrate(views: &[View], width: u32, height: u32) -> Result<Calibration, CalibrateError> {
    calibrate_with(views, width, height, &Options::default())
}

/// The same with options.
pub fn calibrate_with(
    views: &[View],
    width: u32,
    height: u32,
    options: &Options,
) -> Result<Calibration, CalibrateError> {
    let set = Set { views, size: (width, height), options };
    let (brown, selection) = set.fitted(false)?;
    let found = set.outcome(&brown, &selection);
    // The richer model only where Brown's does not do: elsewhere its terms tell nothing and blur the others. And only
    // where boards told the lens up to the image's border: it bends as it likes beyond.
    let does = found.projections.is_some() && found.pattern.image_px <= Verdict::PATTERN_PX;
    if does || !found.is_told() {
        return Ok(found);
    }
    let richer = set.richer(&brown, &selection).filter(|r| r.projections.is_some());
    Ok(richer.unwrap_or(found))
}

/// What is calibrated.
struct Set<'a> {
    views: &'a [View],
    size: (u32, u32),
    options: &'a Options,
}

impl Set<'_> {
    /// With Brown's or the rational model, and without the pictures and points that do not fit.
    fn fitted(&self, rational: bool) -> Result<(Adjusted, Selection), CalibrateError> {
        let mut selection = Selection::first(self.views, self.size.0, self.size.1);
        selection.enough()?;
        let mut held = [false; GLOBAL];
        held[BROWN..INTERIOR].fill(!rational);
        held[STRETCH] = self.options.scale_sigma.is_none();
        // The two directions err independently: their difference by root two of one.
        let stretch_sigma = self.options.scale_sigma.unwrap_or_default() * std::f64::consts::SQRT_2;
        let mut adjusted = first(&selection.used, self.size, held, stretch_sigma)?;
        loop {
            adjusted = settled(adjusted, &selection.used)?;
            let before: Vec<usize> = selection.used.iter().map(|(k, _)| *k).collect();
            // Each round takes something out: they end.
            let apart = robust(&adjusted, &selection.used)?;
            if !selection.narrow(&apart, self.views) {
                let select = self.options.select;
                let adjusted = if select { selected(adjusted, &selection.used)? } else { adjusted };
                return Ok((adjusted, selection));
            }
            selection.enough()?;
            let stays = |k: &usize| selection.used.iter().any(|(index, _)| index == k);
            let mut stay = before.iter().map(stays);
            adjusted.poses.retain(|_| stay.next().unwrap_or(false));
        }
    }

    fn outcome(&self, adjusted: &Adjusted, selection: &Selection) -> Calibration {
        let middle = Vector2::new(adjusted.lens.cx, adjusted.lens.cy);
        let off = self.views.iter().flatten().map(|p| (p.pixel - middle).norm());
        Calibration { told_px: off.fold(0.0, f64::max), ..outcome(adjusted, selection) }
    }

    /// With the rational model, where the sum of squares says at 99 % that it is another one (F-test).
    fn richer(&self, brown: &Adjusted, selection: &Selection) -> Option<Calibration> {
        let mut start = Start::of(brown);
        start.held[BROWN..INTERIOR].fill(false);
        let tried = adjust(&selection.used, &start, brown.model_sigma_px).ok()?.solution;
        let terms = (INTERIOR - BROWN) as f64;
        let ratio = (brown.solution.omega - tried.omega) / terms / tried.variance_factor();
        let limit = FisherSnedecor::new(terms, tried.redundancy as f64).ok()?.inverse_cdf(0.99);
        let (adjusted, selection) = (ratio > limit).then(|| self.fitted(true).ok()).flatten()?;
        Some(self.outcome(&adjusted, &selection))
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
        let mut global = adjusted.solution.global;
        global[k] = 0.0;
        start.lens = with_parameters((start.lens.width, start.lens.height), &global);
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

/// Root mean square of vectors' lengths.
fn rms<'a>(vectors: impl Iterator<Item = &'a Vector2<f64>>) -> f64 {
    let (sum, n) = vectors.fold((0.0, 0usize), |(s, n), r| (s + r.norm_squared(), n + 1));
    (sum / n.max(1) as f64).sqrt()
}

/// Standard deviation of a stretch beforehand where it is only looked for, a share: an assumption, more than paper shrinks.
const LOOSE_STRETCH: f64 = 0.01;

/// As estimated, or where the board is taken as described, as it would be.
fn stretch(adjusted: &Adjusted, used: &[(usize, View)]) -> Option<Stretch> {
    let is_unknown = !adjusted.held[STRETCH];
    let mut start = Start::of(adjusted);
    start.held[STRETCH] = is_unknown;
    start.form[STRETCH - INTERIOR] = 0.0;
    start.stretch_sigma = LOOSE_STRETCH;
    let other = adjust(used, &start, adjusted.model_sigma_px).ok()?;
    let with = if is_unknown { adjusted } else { &other };
    let change = other.solution.global - adjusted.solution.global;
    let worth = quality::projection_at(adjusted, used, &(change * change.transpose()), Stretch::DISTANCE_M)?;
    let variance = with.solution.covariance[(STRETCH, STRETCH)] * with.solution.variance_factor();
    Some(Stretch {
        value: with.form[STRETCH - INTERIOR],
        sigma: variance.max(0.0).sqrt(),
        worth_px: worth.sigma_px,
        stated: is_unknown.then_some(adjusted.stretch_sigma),
    })
}

fn outcome(adjusted: &Adjusted, selection: &Selection) -> Calibration {
    let Selection { used, dropped } = selection;
    let solution = &adjusted.solution;
    let residuals = adjusted.residuals(used);
    let covariance = solution.covariance * solution.variance_factor();
    let brown = quality::of_brown(adjusted, &covariance)
        .unwrap_or_else(|| covariance.fixed_view::<BROWN, BROWN>(0, 0).into());
    let bow = |k: usize| Bow {
        value_m: adjusted.form[k],
        sigma_m: covariance[(INTERIOR + k, INTERIOR + k)].max(0.0).sqrt(),
    };
    let mut found = Calibration {
        stretch: stretch(adjusted, used),
        lens: adjusted.lens,
        bow: [bow(0), bow(1)],
        covariance: DMatrix::from_fn(BROWN, BROWN, |i, j| brown[(i, j)]),
        denominator_sigma: std::array::from_fn(|k| covariance[(BROWN + k, BROWN + k)].max(0.0).sqrt()),
        rms_px: rms(residuals.iter().flatten()),
        model_sigma_px: adjusted.model_sigma_px,
        view_rms_px: vec![None; dropped.len()],
        view_points: vec![0; dropped.len()],
        tilt_deg: vec![None; dropped.len()],
        spread_deg: spread_deg(adjusted),
        coverage: coverage(&adjusted.lens, used),
        dropped: dropped.clone(),
        observations: residuals.iter().map(Vec::len).sum(),
        told_px: 0.0,
        held: std::array::from_fn(|k| adjusted.held[k]),
        halves: check::halves(adjusted, used),
        pattern: check::pattern(adjusted, used),
        residuals: vec![vec![]; dropped.len()],
        board_side_m: adjusted.shape.sides_m(),
        projections: quality::projections(adjusted, used, &covariance),
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

fn spread_deg(adjusted: &Adjusted) -> f64 {
    let normal = |pose: &adjust::Pose| {
        let normal: Vector3<f64> = pose.camera_from_board.matrix().column(2).into();
        normal * normal.z.signum()
    };
    let normals: Vec<Vector3<f64>> = adjusted.poses.iter().map(normal).collect();
    let mean = normals.iter().sum::<Vector3<f64>>();
    let sum: f64 = normals.iter().map(|n| n.angle(&mean).powi(2)).sum();
    (sum / normals.len().max(1) as f64).sqrt().to_degrees()
}

fn coverage(lens: &Lens, used: &[(usize, View)]) -> [[usize; 3]; 3] {
    let ninth = |value: f64, side: u32| ((3.0 * value / f64::from(side)).max(0.0) as usize).min(2);
    let mut counts = [[0; 3]; 3];
    for p in used.iter().flat_map(|(_, v)| v) {
        counts[ninth(p.pixel.y, lens.height)][ninth(p.pixel.x, lens.width)] += 1;
    }
    counts
}
