//! Pictures of a board -> interior orientation.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | find | grey picture, board | board points and their pixels | `checkerboard.rs`, `aprilgrid.rs` |
//! | refine | pixels | saddle points | `saddle.rs` |
//! | start | views | camera constant, poses | `start.rs` |
//! | adjust | views, start | camera, board's bow, covariance | here and `shape.rs`, on the Gauss-Helmert engine |
//! | leave out | residuals | pictures and points that fit | `outliers.rs` |
//! | judge | covariance, residuals | projection uncertainty, verdict | `quality.rs`, `verdict.rs` |

#[cfg(feature = "aprilgrid")]
mod aprilgrid;
mod board;
mod checkerboard;
mod outliers;
mod quality;
mod saddle;
mod shape;
mod start;
mod verdict;

use nalgebra::{DMatrix, DVector, Rotation3, Vector2, Vector3};

pub use board::{Board, BoardError};

use super::adjust::AdjustError;
use super::adjust::gauss_helmert::{self, Block, Fit, Group, Linearised, Point, Prior, Problem};
use super::geometry::{Lens, skew};
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
    /// The adjustment failed.
    #[error("{0}; is the board as described, are its rows, columns and gaps counted and measured?")]
    Adjust(#[from] AdjustError),
}

/// Views needed: below, the nine interior parameters are barely checked.
const LEAST_VIEWS: usize = 4;
/// Points of one view needed for its pose and a check.
const LEAST_POINTS: usize = 8;
/// Unit weight of an image coordinate, px; the covariance is scaled by the residuals.
const UNIT_SIGMA_PX: f64 = 0.1;

/// Calibrates from views of a plane board; `width` and `height` of the pictures, px.
pub fn calibrate(views: &[View], width: u32, height: u32) -> Result<Calibration, CalibrateError> {
    let mut selection = Selection::first(views, width, height);
    loop {
        let adjusted = adjust(&selection.used, width, height)?;
        // Each round takes something out: they end.
        if !selection.narrow(&adjusted, views) {
            return Ok(outcome(&adjusted, selection));
        }
    }
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

    /// Moved by a small rotation (left) and a shift.
    fn moved(&self, local: &DVector<f64>) -> Self {
        let turn = Rotation3::new(Vector3::new(local[0], local[1], local[2]));
        let shift = Vector3::new(local[3], local[4], local[5]);
        Self { camera_from_board: turn * self.camera_from_board, translation_m: self.translation_m + shift }
    }
}

fn parameters(lens: &Lens) -> [f64; 9] {
    [lens.fx, lens.fy, lens.cx, lens.cy, lens.k1, lens.k2, lens.k3, lens.p1, lens.p2]
}

fn with_parameters(size: (u32, u32), p: &DVector<f64>) -> Lens {
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

const MISSING: &str =
    "the views do not determine the camera; tilt the board and cover the corners of the image";

/// Interior parameters; the board's bow follows them among the global ones.
const INTERIOR: usize = 9;

/// Camera, board and poses of one adjustment.
struct Adjusted {
    lens: Lens,
    shape: Shape,
    bow_m: [f64; 2],
    poses: Vec<Pose>,
    fit: Fit,
}

impl Adjusted {
    /// Per view, per point: observed - projected, px.
    fn residuals(&self, used: &[(usize, View)]) -> Vec<Vec<Vector2<f64>>> {
        // Behind the camera: as gross as an error can be, and still finite when squared.
        let far = Vector2::new(1e6, 1e6);
        let one = |pose: &Pose, p: &BoardPoint| {
            let point = pose.apply(&self.shape.point(&p.board_m, &self.bow_m));
            self.lens.project(&point).map_or(far, |q| p.pixel - q)
        };
        self.poses.iter().zip(used).map(|(pose, (_, v))| v.iter().map(|p| one(pose, p)).collect()).collect()
    }
}

fn adjust(used: &[(usize, View)], width: u32, height: u32) -> Result<Adjusted, CalibrateError> {
    if used.len() < LEAST_VIEWS {
        return Err(CalibrateError::TooFewViews { found: used.len(), needed: LEAST_VIEWS });
    }
    let views: Vec<&View> = used.iter().map(|(_, v)| v).collect();
    let (lens, poses) = start::start(&views, width, height).ok_or(CalibrateError::NoStart)?;
    let block = |p: &BoardPoint| Block {
        observed: DVector::from_column_slice(p.pixel.as_slice()),
        covariance: DMatrix::identity(2, 2) * UNIT_SIGMA_PX * UNIT_SIGMA_PX,
    };
    let group =
        |v: &&View| Group { local: DVector::zeros(6), priors: vec![], blocks: v.iter().map(block).collect() };
    let shape = Shape::of(&views);
    let start = [&parameters(&lens)[..], &[0.0; 2]].concat();
    let problem = Problem {
        missing: vec![MISSING; start.len()],
        start: DVector::from_vec(start),
        priors: [lens_priors(&lens), shape.priors(INTERIOR)].concat(),
        groups: views.iter().map(group).collect(),
    };
    let fit = gauss_helmert::solve(&problem, |at| {
        let pose = poses[at.group].moved(at.local);
        linearise(at, (width, height), &pose, &shape, &views[at.group][at.block].board_m)
    })?;
    let poses = poses.iter().zip(&fit.groups).map(|(p, g)| p.moved(&g.local)).collect();
    let lens = with_parameters((width, height), &fit.global);
    Ok(Adjusted { lens, shape, bow_m: bow_of(&fit.global), poses, fit })
}

/// What every lens keeps to, for pictures that do not tell: the principal point lies within a tenth of
/// the image's width of its middle, and no term of the distortion moves the image's corner by more
/// than its distance from the middle (one standard deviation). It keeps few pictures from running
/// away. The sizes are an assumption, chosen wide.
fn lens_priors(start: &Lens) -> Vec<Prior> {
    let (width, height) = (f64::from(start.width), f64::from(start.height));
    let corner = 0.5 * width.hypot(height) / start.fx;
    let values = parameters(start);
    let sigmas = [
        (2, 0.1 * width),
        (3, 0.1 * width),
        (4, corner.powi(-2)),
        (5, corner.powi(-4)),
        (6, corner.powi(-6)),
        (7, corner.recip()),
        (8, corner.recip()),
    ];
    sigmas.into_iter().map(|(k, sigma)| Prior::scalar(k, values[k], sigma)).collect()
}

fn bow_of(global: &DVector<f64>) -> [f64; 2] {
    [global[INTERIOR], global[INTERIOR + 1]]
}

/// observed - projected = 0.
fn linearise(
    at: &Point,
    size: (u32, u32),
    pose: &Pose,
    shape: &Shape,
    board_m: &Vector2<f64>,
) -> Result<Linearised, AdjustError> {
    let lens = with_parameters(size, at.global);
    let point = pose.apply(&shape.point(board_m, &bow_of(at.global)));
    let behind =
        || AdjustError::Input("a board came to lie behind the camera; leave poor pictures out".into());
    let (pixel, by_point) = lens.project_with_jacobian(&point).ok_or_else(behind)?;
    // The left perturbation acts around the camera-frame point without the translation.
    let arm = point - pose.translation_m;
    let mut by_pose = DMatrix::zeros(3, 6);
    by_pose.view_mut((0, 0), (3, 3)).copy_from(&(-skew(&arm) * left_jacobian(at.local)));
    by_pose.view_mut((0, 3), (3, 3)).fill_with_identity();
    let by_bow = by_point * pose.camera_from_board.matrix().column(2) * shape.by_bow(board_m);
    let by_point = DMatrix::from_iterator(2, 3, by_point.iter().copied());
    let mut global = DMatrix::zeros(2, INTERIOR + 2);
    global.columns_mut(0, INTERIOR).copy_from(&-lens.by_parameters(&point));
    global.columns_mut(INTERIOR, 2).copy_from(&-by_bow);
    Ok(Linearised {
        misclosure: at.observed - DVector::from_column_slice(pixel.as_slice()),
        columns: (0..INTERIOR + 2).collect(),
        global,
        local: -(by_point * by_pose),
        observations: DMatrix::identity(2, 2),
    })
}

/// d exp(w) in the left perturbation: the left Jacobian of SO(3) (Barfoot, *State Estimation*, 7.77).
fn left_jacobian(local: &DVector<f64>) -> nalgebra::Matrix3<f64> {
    let w = Vector3::new(local[0], local[1], local[2]);
    let angle = w.norm();
    let k = skew(&w);
    let (a, b) = if angle < 1e-6 {
        (0.5, 1.0 / 6.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / (angle * angle * angle))
    };
    nalgebra::Matrix3::identity() + k * a + k * k * b
}

/// Root mean square of vectors' lengths.
fn rms<'a>(vectors: impl Iterator<Item = &'a Vector2<f64>>) -> f64 {
    let (sum, n) = vectors.fold((0.0, 0usize), |(s, n), r| (s + r.norm_squared(), n + 1));
    (sum / n.max(1) as f64).sqrt()
}

fn outcome(adjusted: &Adjusted, selection: Selection) -> Calibration {
    let Selection { used, dropped } = selection;
    let fit = &adjusted.fit;
    let residuals = adjusted.residuals(&used);
    let covariance = &fit.covariance * fit.variance_factor().unwrap_or(1.0);
    let bow = |k: usize| Bow {
        value_m: adjusted.bow_m[k],
        sigma_m: covariance[(INTERIOR + k, INTERIOR + k)].max(0.0).sqrt(),
    };
    let mut found = Calibration {
        lens: adjusted.lens,
        bow: [bow(0), bow(1)],
        covariance: covariance.view((0, 0), (INTERIOR, INTERIOR)).into(),
        rms_px: rms(residuals.iter().flatten()),
        view_rms_px: vec![None; dropped.len()],
        view_points: vec![0; dropped.len()],
        tilt_deg: vec![None; dropped.len()],
        coverage: coverage(&adjusted.lens, &used),
        dropped,
        observations: residuals.iter().map(Vec::len).sum(),
        projections: quality::projections(adjusted, &used, &covariance),
    };
    for (((index, view), r), pose) in used.iter().zip(&residuals).zip(&adjusted.poses) {
        found.view_rms_px[*index] = Some(rms(r.iter()));
        found.view_points[*index] = view.len();
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
