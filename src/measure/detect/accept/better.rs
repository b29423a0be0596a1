//! Which of two answers for one thing is kept.

use crate::detect::accept::options::BETTER;
use crate::detect::detection::{Detection, covariance::mahalanobis};

/// Whether an answer is better than another one for the same thing.
///
/// - One that is far smaller is a part of it: the larger one tells more of the picture.
/// - Where both say the same place, the surer one.
/// - Where they contradict one another, the one that explains the picture better.
pub fn is_preferred(new: &Detection, old: &Detection) -> bool {
    let size = |d: &Detection| d.semi_major_px * d.semi_minor_px;
    let ratio = size(new) / size(old);
    if new.shape != old.shape || !(1.0 / BETTER.part..BETTER.part).contains(&ratio) {
        return ratio > 1.0;
    }
    if positions_agree(new, old) { new.variance() < old.variance() } else { fits_better(new, old) }
}

/// Whether an answer leaves less of the picture untold than another one: so two are told apart that suppose different things
/// hidden. Each is as sure as its own pixels make it, also those that show something else.
pub fn fits_better(new: &Detection, old: &Detection) -> bool {
    new.fit_rms < old.fit_rms
}

/// Whether two answers say the same place.
fn positions_agree(one: &Detection, other: &Detection) -> bool {
    let both = *one.covariance_px2 + *other.covariance_px2;
    mahalanobis(&(one.centre_px - other.centre_px), &both) < BETTER.alike_sigmas * BETTER.alike_sigmas
}
