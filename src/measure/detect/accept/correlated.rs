//! What all markers of a frame show together: residuals that hang together, as JPEG leaves them about edges.

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::CORRELATED;
use crate::detect::detection::covariance::CovarianceSource;
use crate::estimation::robust::median;

/// By how much a frame's markers show in the median that residuals hang together, beyond chance; at least 1.
pub fn correlation_factor(measured: &[MeasuredMarker]) -> f64 {
    let usual = median(measured.iter().map(|m| m.correlation).collect());
    usual
        .filter(|_| measured.len() >= CORRELATED.least)
        .map_or(1.0, |usual| (usual / CORRELATED.chance).max(1.0))
}

/// Raises a covariance by that, in the directions in which its own residuals do not show more. One marker alone shows it
/// only where it is gross (`estimate/sandwich.rs`): it has few blocks.
pub fn raise_for_correlation(marker: &mut MeasuredMarker, factor: f64) {
    let covariance = &mut marker.detection.covariance_px2;
    if factor > 1.0 {
        let shown = covariance.of(CovarianceSource::Fit) * factor;
        covariance.raise(CovarianceSource::FrameCorrelation, &shown);
    }
}
