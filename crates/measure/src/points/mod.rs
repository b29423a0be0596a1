//! Points without a decal: a patch of the ground frame is matched to a frame by least squares (docs/detection/points.md).
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | patch | frame, predicted map of a template | patch of the frame as the ground frame would show it | `patch.rs` |
//! | correlation | template, patch | places that look similar | `correlation.rs` |
//! | adjustment | template, patch, a place | shift | `least_squares.rs` |
//! | covariance | adjusted shift | its covariance | `shift_covariance.rs` |
//! | decision | shift forward and backward, other places | place of the point, or the reason why there is none | `decide.rs` |

mod correlation;
mod decide;
mod least_squares;
mod patch;
mod shift_covariance;

use nalgebra::Vector2;

use crate::identify::PATCH_REACH_PX;
use crate::raster::Raster;
use crate::setup::PointTemplate;

pub use decide::{PointMatch, find_places, match_point};

/// Half side of a stored template, px: the patch that is matched, and a margin for the shift of the check backward.
const TEMPLATE_REACH_PX: usize = PATCH_REACH_PX + 9;
/// Side of a stored template, px.
pub const TEMPLATE_SIDE_PX: usize = 2 * TEMPLATE_REACH_PX + 1;

/// Standard deviation of a point's place that plans assume, px: twice that of rendered structures with a contrast of a
/// third, of which real ones have less.
pub const TYPICAL_SIGMA_PX: f64 = 0.1;

/// Reason why a point has no place in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PointRejection {
    /// Seen too flat, or hidden behind the wing's crest.
    Grazing,
    /// Patch that is not completely in the frame.
    OutsideFrame,
    /// Patch without a structure that determines a place, given the noise.
    NoStructure,
    /// Nothing like the template in the area in which the point is expected.
    Unlike,
    /// Patch that differs from the template by more than light and noise: shadow edge, reflection, rain, moved part.
    Changed,
    /// Saturated patch.
    Saturated,
    /// Two places that look similar.
    Ambiguous,
    /// Match from the frame back to the template that leads to another place.
    Inconsistent,
    /// Adjustment without convergence.
    NoConvergence,
    /// Place that contradicts the other markers.
    Displaced,
}

impl PointRejection {
    /// Returns a short description for people.
    pub fn text(self) -> &'static str {
        match self {
            Self::Grazing => "seen too flat or hidden by the wing",
            Self::OutsideFrame => "its patch is not completely in the frame",
            Self::NoStructure => "its patch has no structure that determines a place",
            Self::Unlike => "nothing in the expected area looks like its template",
            Self::Changed => {
                "its patch changed since the ground frame: a shadow edge, a reflection, rain or a moved part"
            }
            Self::Saturated => "its patch is saturated",
            Self::Ambiguous => "two places look like its template",
            Self::Inconsistent => "the match back to the ground frame leads to another place",
            Self::NoConvergence => "the match did not converge",
            Self::Displaced => "its place contradicts the other markers",
        }
    }
}

/// Cuts the template of a point from a ground frame; `None` if the patch is not completely in the frame.
pub fn cut_template(
    frame: &Raster,
    marker: usize,
    place_px: Vector2<f64>,
) -> Option<PointTemplate> {
    let reach = TEMPLATE_REACH_PX as f64;
    let first = place_px.map(|v| v.round() - reach);
    let side = TEMPLATE_SIDE_PX;
    let limit =
        Vector2::new(frame.width() as f64, frame.height() as f64).add_scalar(-(side as f64));
    if !(first.min() >= 0.0 && first.x <= limit.x && first.y <= limit.y) {
        return None;
    }
    let [left, top] = [first.x as usize, first.y as usize];
    let rows = (top..top + side).flat_map(|y| frame.row(y).iter().skip(left).take(side).copied());
    let patch = Raster::new(side, side, rows.collect())?;
    Some(PointTemplate {
        marker,
        patch,
        origin_px: [left, top],
        place_px,
    })
}
