//! What all markers of a frame show together: residuals that hang together, as JPEG leaves them about edges.

use super::measure::Measured;

/// The ratio, between a centre's variance from blocks of residuals and that of the fit, at which fits say what they are
/// worth: what correlation adds, rounding to grey values takes off again.
const USUAL: f64 = 1.25;
/// How the errors' squares follow it, as a power: blocks of 8 px see more of what hangs together than moves a centre, and
/// the middle of a frame's markers is off by chance. Found in rendered frames (docs/validation).
const FOLLOWS: f64 = 0.5;
/// Fewer markers do not tell.
const LEAST: usize = 8;

/// By how much a frame's markers show in the middle that their variances are too small, or too large.
pub fn factor(measured: &[Measured]) -> f64 {
    let middle = super::middle(measured.iter().map(|m| m.clumped).collect());
    middle.filter(|_| measured.len() >= LEAST).map_or(1.0, |middle| (middle / USUAL).max(0.1).powf(FOLLOWS))
}

/// Multiplies a covariance by that.
pub fn change(marker: &mut Measured, factor: f64) {
    marker.detection.covariance_px2 *= factor;
}
