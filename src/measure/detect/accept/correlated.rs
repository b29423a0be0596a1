//! What all markers of a frame show together: residuals that hang together, as JPEG leaves them about edges.

use super::verdict::Measured;
use crate::measure::detect::accept::options::CORRELATED;
use crate::measure::detect::estimate::sandwich::at_least;
use crate::measure::detect::image::histogram::middle;

/// By how much a frame's markers show in the middle that residuals hang together, beyond chance; at least 1.
pub fn factor(measured: &[Measured]) -> f64 {
    let middle = middle(measured.iter().map(|m| m.correlation).collect());
    middle
        .filter(|_| measured.len() >= CORRELATED.least)
        .map_or(1.0, |middle| (middle / CORRELATED.chance).max(1.0))
}

/// Raises a covariance by that, in the directions in which its own residuals do not show more. One marker alone shows it
/// only where it is gross (`estimate/sandwich.rs`): it has few blocks.
pub fn raise(marker: &mut Measured, factor: f64) {
    let covariance = &mut marker.detection.covariance_px2;
    if let Some((raised, _)) = at_least(&(marker.white * factor), covariance, 1.0).filter(|_| factor > 1.0) {
        *covariance = raised;
    }
}
