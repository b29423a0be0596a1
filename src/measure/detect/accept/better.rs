//! Which of two answers for one thing is kept.

use nalgebra::Vector2;

use crate::measure::detect::accept::options::BETTER;
use crate::measure::detect::detection::Detection;

/// Whether an answer is better than another one for the same thing.
///
/// - One that is far smaller is a part of it: the larger one tells more of the picture.
/// - Where both say the same place, the surer one: that with the smaller standard ellipse.
/// - Where they contradict one another, the one that leaves less of the picture untold.
pub fn is_better(new: &Detection, old: &Detection) -> bool {
    let size = |d: &Detection| d.semi_major_px * d.semi_minor_px;
    let ratio = size(new) / size(old);
    if new.shape != old.shape || !(1.0 / BETTER.part..BETTER.part).contains(&ratio) {
        return ratio > 1.0;
    }
    let area = |d: &Detection| d.covariance_px2.determinant();
    if agree(new, old) { area(new) < area(old) } else { new.fit_rms < old.fit_rms }
}

/// Whether two answers say the same place.
fn agree(one: &Detection, other: &Detection) -> bool {
    let apart: Vector2<f64> = one.centre_px - other.centre_px;
    let both = one.covariance_px2 + other.covariance_px2;
    let off = both.try_inverse().map_or(f64::INFINITY, |inverse| apart.dot(&(inverse * apart)));
    off < BETTER.alike_sigmas * BETTER.alike_sigmas
}
