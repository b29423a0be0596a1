//! Choice between two measurements of one marker.

use crate::detect::detection::{Detection, covariance::squared_mahalanobis};
use crate::detect::numbers::IMPROBABLE_SIGMAS;

/// Returns whether a measurement is better than another one of the same marker:
///
/// - If one has half the size (product of semi-axes) or less, it is a part; the larger one explains more of the image.
/// - If both agree on the position, the more precise one is better.
/// - If they disagree, the one with the smaller residuals is better.
pub fn is_preferred(new: &Detection, old: &Detection) -> bool {
    let size = |d: &Detection| d.semi_major_px * d.semi_minor_px;
    let ratio = size(new) / size(old);
    if new.shape != old.shape || !(0.5..2.0).contains(&ratio) {
        return ratio > 1.0;
    }
    if positions_agree(new, old) {
        new.variance() < old.variance()
    } else {
        fits_better(new, old)
    }
}

/// Returns whether a measurement has smaller residuals than another one. This decides between measurements that assume
/// different parts to be hidden, whose precision is not comparable: each depends on the pixels that it uses, including
/// those that show something else.
pub fn fits_better(new: &Detection, old: &Detection) -> bool {
    new.fit_rms < old.fit_rms
}

/// Returns whether the positions of two measurements agree within their covariances.
fn positions_agree(one: &Detection, other: &Detection) -> bool {
    let both = *one.covariance_px2 + *other.covariance_px2;
    squared_mahalanobis(&(one.centre_px - other.centre_px), &both)
        < IMPROBABLE_SIGMAS * IMPROBABLE_SIGMAS
}
