//! Projection uncertainty: the effect of the camera's uncertainty in the image.
//!
//! Parameters alone are not conclusive: an error of the focal length can be compensated by the boards' distances. So the
//! camera's errors are propagated to image points of objects at some distance, after removing the part that a rotation and
//! a translation of the camera explain **at the boards** (the mean-pose method of mrcal's projection uncertainty): near the
//! boards' distance the errors cancel, at other distances they do not.

use nalgebra::{DMatrix, Matrix6, SMatrix, Vector2, Vector3};

use super::BoardView;
use super::adjust::CameraAdjustment;
use super::model::{
    DISTANCES_M, GlobalCovariance, INTERIOR, ProjectionJacobians, projection_jacobians,
};
use crate::geometry::{BROWN, Lens};

/// Number of cells over the width and over the height of the image.
const CELLS: usize = 9;

type CompensatingMotion = SMatrix<f64, 6, INTERIOR>;

/// Standard deviation of a projected point (length of its error vector) over the image, px.
#[derive(Clone, Debug, PartialEq)]
pub struct ProjectionUncertainty {
    pub distance_m: f64,
    /// Root mean square over the image, px.
    pub sigma_px: f64,
    /// Column and row of the worst ninth of the image, 0 to 2 from the upper left.
    pub worst: (usize, usize),
    /// Root mean square in the worst ninth, px.
    pub worst_sigma_px: f64,
    /// Standard deviations over the image, rows from the top, px; `None` if the lens has no inverse there.
    pub cells_px: Vec<Vec<Option<f64>>>,
}

/// Returns the uncertainties at [`DISTANCES_M`]; `None` if the lens has no inverse somewhere in the image.
pub(super) fn projection_uncertainties(
    adjusted: &CameraAdjustment,
    used: &[(usize, BoardView)],
    covariance: &GlobalCovariance,
) -> Option<Vec<ProjectionUncertainty>> {
    let motion = compensating_motion(adjusted, used)?;
    let found = DISTANCES_M
        .into_iter()
        .map(|d| projection_uncertainty(adjusted, &motion, covariance, d));
    let whole = |p: &ProjectionUncertainty| p.cells_px.iter().flatten().all(Option::is_some);
    found.map(|p| p.filter(whole)).collect()
}

/// Returns the uncertainty at one distance, over the part of the image for which the lens has an inverse.
pub(super) fn uncertainty_at_distance(
    adjusted: &CameraAdjustment,
    used: &[(usize, BoardView)],
    covariance: &GlobalCovariance,
    distance_m: f64,
) -> Option<ProjectionUncertainty> {
    projection_uncertainty(
        adjusted,
        &compensating_motion(adjusted, used)?,
        covariance,
        distance_m,
    )
}

fn projection_uncertainty(
    adjusted: &CameraAdjustment,
    motion: &CompensatingMotion,
    covariance: &GlobalCovariance,
    distance_m: f64,
) -> Option<ProjectionUncertainty> {
    let interior = covariance.fixed_view::<INTERIOR, INTERIOR>(0, 0);
    let variance = |row: usize, column: usize| {
        let point = cell_ray(&adjusted.camera.lens, column, row)? * distance_m;
        let ProjectionJacobians { by_motion, by_lens } =
            projection_jacobians(&adjusted.camera.lens, &point)?;
        let error = by_lens + by_motion * motion;
        Some((error * interior * error.transpose()).trace())
    };
    let mut ninths = [[(0.0, 0usize); 3]; 3];
    let mut cells_px = vec![vec![None; CELLS]; CELLS];
    for (row, column) in (0..CELLS * CELLS).map(|k| (k / CELLS, k % CELLS)) {
        if let Some(v) = variance(row, column) {
            cells_px[row][column] = Some(v.sqrt());
            let ninth = &mut ninths[row * 3 / CELLS][column * 3 / CELLS];
            *ninth = (ninth.0 + v, ninth.1 + 1);
        }
    }
    summarize_projection_cells(distance_m, &ninths, cells_px)
}

fn summarize_projection_cells(
    distance_m: f64,
    ninths: &[[(f64, usize); 3]; 3],
    cells_px: Vec<Vec<Option<f64>>>,
) -> Option<ProjectionUncertainty> {
    let mean = |(sum, n): (f64, usize)| if n > 0 { sum / n as f64 } else { 0.0 };
    let worst = (0..9)
        .map(|k| (k % 3, k / 3))
        .max_by(|a, b| mean(ninths[a.1][a.0]).total_cmp(&mean(ninths[b.1][b.0])))?;
    let (sum, n) = ninths
        .iter()
        .flatten()
        .fold((0.0, 0), |(s, n), c| (s + c.0, n + c.1));
    (n > 0).then(|| ProjectionUncertainty {
        distance_m,
        sigma_px: mean((sum, n)).sqrt(),
        worst,
        worst_sigma_px: mean(ninths[worst.1][worst.0]).sqrt(),
        cells_px,
    })
}

/// Returns the unit ray through a cell; the rays of the outermost cells run through the image's border.
fn cell_ray(lens: &Lens, column: usize, row: usize) -> Option<Vector3<f64>> {
    let share = |k: usize| k as f64 / (CELLS - 1) as f64;
    let pixel = Vector2::new(
        share(column) * (f64::from(lens.width) - 1.0),
        share(row) * (f64::from(lens.height) - 1.0),
    );
    lens.ray(&pixel).ok().map(|r| r.normalize())
}

/// Estimates the camera motion that best compensates, at the boards, errors of the interior parameters.
fn compensating_motion(
    adjusted: &CameraAdjustment,
    used: &[(usize, BoardView)],
) -> Option<CompensatingMotion> {
    let (mut normal, mut right) = (Matrix6::zeros(), CompensatingMotion::zeros());
    for (k, (_, view)) in used.iter().enumerate() {
        for p in view {
            let point = adjusted.camera_point(k, p);
            let ProjectionJacobians { by_motion, by_lens } =
                projection_jacobians(&adjusted.camera.lens, &point)?;
            normal += by_motion.transpose() * by_motion;
            right += by_motion.transpose() * by_lens;
        }
    }
    Some(-(normal.cholesky()?.solve(&right)))
}

/// Returns the covariance of Brown's parameters with the same effect in the image and the denominator fixed: errors of the
/// denominator are transferred to them by least squares over the image.
pub(super) fn brown_covariance(
    adjusted: &CameraAdjustment,
    covariance: &GlobalCovariance,
) -> Option<SMatrix<f64, BROWN, BROWN>> {
    let interior = covariance.fixed_view::<INTERIOR, INTERIOR>(0, 0);
    let rays: Vec<Vector3<f64>> = (0..CELLS * CELLS)
        .filter_map(|k| cell_ray(&adjusted.camera.lens, k % CELLS, k / CELLS))
        .collect();
    let mut derivatives = DMatrix::zeros(2 * rays.len(), INTERIOR);
    for (k, ray) in rays.iter().enumerate() {
        derivatives
            .fixed_view_mut::<2, INTERIOR>(2 * k, 0)
            .copy_from(&projection_jacobians(&adjusted.camera.lens, ray)?.by_lens);
    }
    // Columns of equal norm, for the condition of the inverse.
    let size: Vec<f64> = (0..INTERIOR)
        .map(|k| derivatives.column(k).norm().max(f64::MIN_POSITIVE))
        .collect();
    let unit = DMatrix::from_fn(derivatives.nrows(), INTERIOR, |i, j| {
        derivatives[(i, j)] / size[j]
    });
    let transfer = unit
        .columns(0, BROWN)
        .svd(true, true)
        .solve(&unit.columns(BROWN, 3), 1e-12)
        .ok()?;
    let onto = SMatrix::<f64, BROWN, INTERIOR>::from_fn(|i, j| match j {
        _ if j == i => 1.0,
        BROWN.. => transfer[(i, j - BROWN)] * size[j] / size[i],
        _ => 0.0,
    });
    Some(onto * interior * onto.transpose())
}
