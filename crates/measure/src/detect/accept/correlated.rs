//! Correlation of residuals that all markers of a frame have in common, as JPEG compression leaves it around edges.

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::CORRELATED;
use crate::detect::detection::covariance::CovarianceSource;
use crate::estimation::robust::median;

/// Returns the factor by which the median marker's residuals are more correlated than expected from noise alone; at least
/// 1.
pub fn correlation_factor(measured: &[MeasuredMarker]) -> f64 {
    let median_ratio = median(measured.iter().map(|m| m.correlation).collect());
    median_ratio
        .filter(|_| measured.len() >= CORRELATED.min_markers)
        .map_or(1.0, |median_ratio| {
            (median_ratio / CORRELATED.chance_level).max(1.0)
        })
}

/// Raises a marker's covariance by the frame's correlation factor, in directions in which the marker's own residuals do not
/// already show more. A single marker has few blocks of residuals and reveals only strong correlation
/// (`estimate/sandwich.rs`).
pub fn raise_for_correlation(marker: &mut MeasuredMarker, factor: f64) {
    let covariance = &mut marker.detection.covariance_px2;
    if factor > 1.0 {
        let shown = covariance.contribution(CovarianceSource::Fit) * factor;
        covariance.raise(CovarianceSource::FrameCorrelation, &shown);
    }
}
