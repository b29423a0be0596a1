//! What all markers of a frame show together: residuals that hang together, as JPEG leaves them about edges.

use super::blocks::at_least;
use super::measure::Measured;

/// How far the median ratio of a frame's markers exceeds 1 by chance: with twenty of them, two standard
/// deviations.
const CHANCE: f64 = 1.25;
/// Fewer markers do not tell.
const LEAST: usize = 8;

/// Raises every covariance to what the frame's markers show in the middle, in the directions in which its own residuals
/// do not show more. One marker alone shows it only where it is gross (`blocks.rs`): it has few blocks.
pub fn raise(measured: &mut [Measured]) {
    if measured.len() < LEAST {
        return;
    }
    let Some(middle) = super::middle(measured.iter().map(|m| m.clumped).collect()) else { return };
    let factor = middle / CHANCE;
    for marker in measured.iter_mut().filter(|_| factor > 1.0) {
        let covariance = &mut marker.detection.covariance_px2;
        if let Some((raised, _)) = at_least(&(marker.white * factor), covariance, 1.0) {
            *covariance = raised;
        }
    }
}
