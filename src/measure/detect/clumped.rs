//! What all markers of a frame show together: residuals that hang together, as JPEG leaves them about edges.

use super::measure::Measured;

/// How far the median ratio of a frame's markers exceeds 1 by chance: with twenty of them, two standard
/// deviations.
const CHANCE: f64 = 1.25;
/// Fewer markers do not tell.
const LEAST: usize = 8;

/// Raises every covariance that does not yet allow for clumped residuals by what the frame's markers show
/// in the middle. One marker alone shows it only where it is gross (`blocks.rs`): it has few blocks.
pub fn raise(measured: &mut [Measured]) {
    if measured.len() < LEAST {
        return;
    }
    let Some(middle) = super::middle(measured.iter().map(|m| m.clumped).collect()) else { return };
    let factor = (middle / CHANCE).max(1.0);
    for marker in measured.iter_mut().filter(|m| !m.raised) {
        marker.detection.covariance_px2 *= factor;
    }
}
