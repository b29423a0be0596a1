//! Conversion of the last adjustment to a [`Calibration`].

use nalgebra::{DMatrix, Vector3};

use super::adjust::CameraAdjustment;
use super::model::{BoardPose, INTERIOR, STRETCH, rms_length};
use super::outliers::Selection;
use super::shape::{BoardBow, BoardStretch};
use super::{BoardView, Calibration, check, quality};
use crate::geometry::{BROWN, Lens};

/// Prior standard deviation of the stretch for the check of a board that is taken as exact, relative: an assumption, more
/// than paper shrinks.
const LOOSE_STRETCH_SIGMA: f64 = 0.01;

/// Estimates the stretch, or its value and effect if the board is taken as exact.
fn estimate_stretch(
    adjusted: &CameraAdjustment,
    used: &[(usize, BoardView)],
) -> Option<BoardStretch> {
    let is_unknown = !adjusted.camera.fixed[STRETCH];
    let mut start = adjusted.camera.clone();
    start.fixed[STRETCH] = is_unknown;
    start.form[STRETCH - INTERIOR] = 0.0;
    start.stretch_sigma = LOOSE_STRETCH_SIGMA;
    let other = start.adjust(used, adjusted.model_sigma_px).ok()?;
    let with = if is_unknown { adjusted } else { &other };
    let change = other.solution.global - adjusted.solution.global;
    let effect = quality::uncertainty_at_distance(
        adjusted,
        used,
        &(change * change.transpose()),
        BoardStretch::DISTANCE_M,
    )?;
    let variance = with.solution.scaled_covariance()[(STRETCH, STRETCH)];
    Some(BoardStretch {
        value: with.camera.form[STRETCH - INTERIOR],
        sigma: variance.max(0.0).sqrt(),
        projection_change_px: effect.sigma_px,
        prior_sigma: is_unknown.then_some(adjusted.camera.stretch_sigma),
    })
}

/// Builds the calibration from the last adjustment.
pub(super) fn build_calibration(adjusted: &CameraAdjustment, selection: &Selection) -> Calibration {
    let Selection {
        used,
        rejections: dropped,
    } = selection;
    let residuals = adjusted.residuals(used);
    let covariance = adjusted.solution.scaled_covariance();
    let brown = quality::brown_covariance(adjusted, &covariance)
        .unwrap_or_else(|| covariance.fixed_view::<BROWN, BROWN>(0, 0).into());
    let bow = |k: usize| BoardBow {
        value_m: adjusted.camera.form[k],
        sigma_m: covariance[(INTERIOR + k, INTERIOR + k)].max(0.0).sqrt(),
    };
    let mut found = Calibration {
        stretch: estimate_stretch(adjusted, used),
        lens: adjusted.camera.lens,
        bow: [bow(0), bow(1)],
        covariance: DMatrix::from_fn(BROWN, BROWN, |i, j| brown[(i, j)]),
        denominator_sigma: std::array::from_fn(|k| {
            covariance[(BROWN + k, BROWN + k)].max(0.0).sqrt()
        }),
        rms_px: rms_length(residuals.iter().flatten()),
        model_sigma_px: adjusted.model_sigma_px,
        view_rms_px: vec![None; dropped.len()],
        view_points: vec![0; dropped.len()],
        tilt_deg: vec![None; dropped.len()],
        spread_deg: board_tilt_spread_deg(adjusted),
        coverage: count_points_per_ninth(&adjusted.camera.lens, used),
        rejections: dropped.clone(),
        observations: residuals.iter().map(Vec::len).sum(),
        covered_radius_px: 0.0,
        fixed: std::array::from_fn(|k| adjusted.camera.fixed[k]),
        halves: check::compare_halves(adjusted, used),
        pattern: check::residual_pattern(adjusted, used),
        residuals: vec![vec![]; dropped.len()],
        board_side_m: adjusted.shape.sides_m(),
        projections: quality::projection_uncertainties(adjusted, used, &covariance),
    };
    for (((index, view), r), pose) in used.iter().zip(&residuals).zip(&adjusted.camera.poses) {
        found.view_rms_px[*index] = Some(rms_length(r.iter()));
        found.view_points[*index] = view.len();
        found.residuals[*index] = view
            .iter()
            .map(|p| p.pixel)
            .zip(r.iter().copied())
            .collect();
        let normal_z = pose.camera_from_board.matrix()[(2, 2)];
        found.tilt_deg[*index] = Some(normal_z.abs().min(1.0).acos().to_degrees());
    }
    found
}

fn board_tilt_spread_deg(adjusted: &CameraAdjustment) -> f64 {
    let normal = |pose: &BoardPose| {
        let normal: Vector3<f64> = pose.camera_from_board.matrix().column(2).into();
        normal * normal.z.signum()
    };
    let normals: Vec<Vector3<f64>> = adjusted.camera.poses.iter().map(normal).collect();
    let mean = normals.iter().sum::<Vector3<f64>>();
    let sum: f64 = normals.iter().map(|n| n.angle(&mean).powi(2)).sum();
    (sum / normals.len().max(1) as f64).sqrt().to_degrees()
}

fn count_points_per_ninth(lens: &Lens, used: &[(usize, BoardView)]) -> [[usize; 3]; 3] {
    let ninth = |value: f64, side: u32| ((3.0 * value / f64::from(side)).max(0.0) as usize).min(2);
    let mut counts = [[0; 3]; 3];
    for p in used.iter().flat_map(|(_, v)| v) {
        counts[ninth(p.pixel.y, lens.height)][ninth(p.pixel.x, lens.width)] += 1;
    }
    counts
}
