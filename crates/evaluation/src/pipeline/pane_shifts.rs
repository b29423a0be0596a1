//! Detection of image positions at which the window pane displaces markers: drops, frost and streaks.
//!
//! A single frame cannot show this, since the residuals may be the marker's own. In a flight the wing moves and the pane
//! does not: a remark is added if markers have other residuals at a position than elsewhere.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector2;

use crate::record::ImageRecord;

/// Radius of the affected area, rad. Derived: an object on a pane 0.5 m away is blurred by the width of the aperture, 12 mm
/// at a focal length of 50 mm and f/4; half of that.
const REACH_RAD: f64 = 0.012;
/// Smallest number of frames that show the shift, and of observations of the same markers elsewhere. Derived: one of two
/// may be an outlier.
const MIN_FRAMES: usize = 3;
/// Significance level of the test over all positions of a flight.
const ALPHA: f64 = 0.001;

/// Residual of one marker in one frame.
#[derive(Clone, Debug)]
struct MarkerOffset<'a> {
    frame: usize,
    id: &'a str,
    position_px: Vector2<f64>,
    /// Observed minus adjusted, px.
    off: Vector2<f64>,
    /// Weights of the components, 1/px^2.
    weight: Vector2<f64>,
}

/// Image position at which markers are displaced.
#[derive(Debug)]
struct PaneShift<'a> {
    position_px: Vector2<f64>,
    /// Displacement, px.
    shift: Vector2<f64>,
    /// Squared displacement in its standard deviations: chi-square distributed with two degrees of freedom if there is
    /// none.
    square: f64,
    frames: BTreeSet<usize>,
    markers: BTreeSet<&'a str>,
}

/// Adds remarks about positions that displace markers to the frames of a flight; `focal_px` is the focal length.
pub fn remark_pane_shifts(records: &mut [ImageRecord], focal_px: f64) {
    let found = find_shifts(used_markers(records), REACH_RAD * focal_px);
    let places: Vec<(BTreeSet<usize>, String)> = found
        .into_iter()
        .map(|place| (place.frames.clone(), place.warning_text()))
        .collect();
    for (frames, sentence) in places {
        for frame in frames {
            records
                .get_mut(frame)
                .into_iter()
                .for_each(|r| r.remarks.push(sentence.clone()));
        }
    }
}

/// Collects the residuals of the markers used in the solutions.
fn used_markers(records: &[ImageRecord]) -> Vec<MarkerOffset<'_>> {
    let mut out = Vec::new();
    for (frame, record) in records.iter().enumerate().filter(|(_, r)| r.is_solved()) {
        let factor = record.variance_factor.unwrap_or(1.0).max(1.0);
        out.extend(record.markers.iter().filter(|m| m.used).filter_map(|m| {
            let weight = |sigma: f64| 1.0 / (factor * sigma * sigma);
            Some(MarkerOffset {
                frame,
                id: &m.id,
                position_px: Vector2::new(m.u_px?, m.v_px?),
                off: -Vector2::new(m.residual_u_px?, m.residual_v_px?),
                weight: Vector2::new(weight(m.sigma_u_px?), weight(m.sigma_v_px?)),
            })
        }));
    }
    out
}

/// Finds positions with a significant displacement, the most significant first.
fn find_shifts(mut offsets: Vec<MarkerOffset<'_>>, reach_px: f64) -> Vec<PaneShift<'_>> {
    let cell = |s: &MarkerOffset<'_>| {
        [s.position_px.x, s.position_px.y].map(|v| (v / reach_px).floor() as i64)
    };
    let cells: BTreeSet<[i64; 2]> = offsets.iter().map(cell).collect();
    // Chi square with two degrees of freedom exceeds T with probability exp(-T / 2).
    let least = 2.0 * (cells.len().max(1) as f64 / ALPHA).ln();
    let mut out = Vec::new();
    loop {
        let centres = cells
            .iter()
            .map(|c| Vector2::from(c.map(|v| (v as f64 + 0.5) * reach_px)));
        let all = centres.filter_map(|centre| measure_shift(&offsets, centre, reach_px));
        let Some(best) = all
            .max_by(|a, b| a.square.total_cmp(&b.square))
            .filter(|p| p.square > least)
        else {
            return out;
        };
        offsets.retain(|s| (s.position_px - best.position_px).norm() > reach_px);
        out.push(best);
    }
}

/// Compares the residuals of markers near `at` with those of the same markers elsewhere; `None` with too few of either.
fn measure_shift<'a>(
    offsets: &[MarkerOffset<'a>],
    at: Vector2<f64>,
    reach_px: f64,
) -> Option<PaneShift<'a>> {
    let mut by_marker: BTreeMap<&str, [Vec<&MarkerOffset<'a>>; 2]> = BTreeMap::new();
    for offset in offsets {
        let far = (offset.position_px - at).norm();
        if !(reach_px..=2.0 * reach_px).contains(&far) {
            by_marker.entry(offset.id).or_default()[usize::from(far > reach_px)].push(offset);
        }
    }
    by_marker.retain(|_, [here, elsewhere]| !here.is_empty() && !elsewhere.is_empty());
    let frames: BTreeSet<usize> = by_marker
        .values()
        .flat_map(|[here, _]| here)
        .map(|s| s.frame)
        .collect();
    let elsewhere: usize = by_marker
        .values()
        .map(|[_, elsewhere]| elsewhere.len())
        .sum();
    if frames.len().min(elsewhere) < MIN_FRAMES {
        return None;
    }
    let (mut sum, mut weight) = (Vector2::zeros(), Vector2::zeros());
    for [here, elsewhere] in by_marker.values() {
        let (one, other) = (weighted_mean(here), weighted_mean(elsewhere));
        let own = one.1.zip_map(&other.1, |a, b| 1.0 / (1.0 / a + 1.0 / b));
        sum += own.component_mul(&(one.0 - other.0));
        weight += own;
    }
    let shift = sum.component_div(&weight);
    let square = shift.component_mul(&shift).dot(&weight);
    Some(PaneShift {
        position_px: at,
        shift,
        square,
        frames,
        markers: by_marker.into_keys().collect(),
    })
}

/// Computes the weighted mean of residuals, px, and its weights.
fn weighted_mean(offsets: &[&MarkerOffset<'_>]) -> (Vector2<f64>, Vector2<f64>) {
    let weight: Vector2<f64> = offsets.iter().map(|s| s.weight).sum();
    let sum: Vector2<f64> = offsets.iter().map(|s| s.weight.component_mul(&s.off)).sum();
    (sum.component_div(&weight), weight)
}

impl PaneShift<'_> {
    fn warning_text(&self) -> String {
        let markers: Vec<&str> = self.markers.iter().copied().collect();
        format!(
            "near pixel ({:.0}, {:.0}), markers are displaced by ({:+.2}, {:+.2}) px compared with elsewhere ({} in {} frames); \
             check the window pane there for drops, frost or streaks",
            self.position_px.x,
            self.position_px.y,
            self.shift.x,
            self.shift.y,
            markers.join(", "),
            self.frames.len()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{MarkerRecord, RecordStatus};

    /// Creates a flight in which markers move down by 40 px per frame; `off` returns the residual of a marker at a
    /// position, px.
    fn flight(off: impl Fn(&str, Vector2<f64>) -> [f64; 2]) -> Vec<ImageRecord> {
        let marker = |id: &str, at: Vector2<f64>, scatter: f64| {
            let [du, dv] = off(id, at);
            let json = serde_json::json!({
                "id": id, "shape": "circle", "u_px": at.x, "v_px": at.y, "sigma_u_px": 0.1, "sigma_v_px": 0.1, "used": true,
                "residual_u_px": -du - scatter, "residual_v_px": -dv + scatter,
            });
            serde_json::from_value::<MarkerRecord>(json).expect("a marker")
        };
        let frame = |k: usize| {
            // Scatter with about the given standard deviation.
            let scatter = |j: usize| 0.14 * ((k * 7 + j * 13) as f64).sin();
            let at = |x: f64| Vector2::new(x, 500.0 + 40.0 * k as f64);
            let markers = vec![
                marker("A", at(1000.0), scatter(1)),
                marker("B", at(1800.0), scatter(2)),
            ];
            ImageRecord {
                status: RecordStatus::Ok,
                markers,
                ..ImageRecord::default()
            }
        };
        (0..24).map(frame).collect()
    }

    fn remarks(mut records: Vec<ImageRecord>) -> Vec<usize> {
        remark_pane_shifts(&mut records, 7700.0);
        (0..records.len())
            .filter(|&k| !records[k].remarks.is_empty())
            .collect()
    }

    #[test]
    fn a_shift_that_stays_with_the_image_position_is_reported_there() {
        let drop = Vector2::new(1000.0, 900.0);
        let seen = remarks(flight(|_, at| {
            if (at - drop).norm() < 90.0 {
                [0.5, -0.2]
            } else {
                [0.0; 2]
            }
        }));
        assert!(
            seen.contains(&10) && seen.iter().all(|k| (7..=13).contains(k)),
            "{seen:?}"
        );
    }

    #[test]
    fn a_shift_that_stays_with_the_marker_is_not_reported() {
        assert!(remarks(flight(|_, _| [0.0; 2])).is_empty());
        assert!(
            remarks(flight(|id, _| if id == "B" {
                [0.5, -0.2]
            } else {
                [0.0; 2]
            }))
            .is_empty()
        );
    }
}
