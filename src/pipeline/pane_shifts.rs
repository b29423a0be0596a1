//! Places of the picture that shift whatever passes them, as drops, frost and streaks on the pane do: no single frame tells, since
//! its residuals may as well be the marker's own. In a flight the wing moves and the pane does not. Where markers leave other
//! residuals at a place than they leave elsewhere, that is said.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector2;

use crate::record::ImageRecord;

/// How far a place reaches, rad, radius. Derived: what lies on a pane half a metre away is as far out of focus as the aperture is wide,
/// 12 mm at a focal length of 50 mm and f/4; half of that.
const REACH_RAD: f64 = 0.012;
/// Frames that must show it, and as many sights of its markers elsewhere. Derived: of two one may be a blunder.
const FRAMES: usize = 3;
/// Level of the test, of all places of a flight together.
const ALPHA: f64 = 0.001;

/// A marker in one frame.
#[derive(Clone, Debug)]
struct Sight<'a> {
    frame: usize,
    id: &'a str,
    at: Vector2<f64>,
    /// Observed less adjusted, px.
    off: Vector2<f64>,
    /// Weights of its components, 1/px^2.
    weight: Vector2<f64>,
}

/// A place that shifts what passes it.
#[derive(Debug)]
struct Place<'a> {
    at: Vector2<f64>,
    /// By how much, px.
    shift: Vector2<f64>,
    /// The square of that in its standard deviations: chi square with two degrees of freedom if there were none.
    square: f64,
    frames: BTreeSet<usize>,
    markers: BTreeSet<&'a str>,
}

/// Says of the frames of a flight which places of the picture shift what passes them; `focal_px` is the camera constant.
pub fn name(records: &mut [ImageRecord], focal_px: f64) {
    let found = found(sights(records), REACH_RAD * focal_px);
    let places: Vec<(BTreeSet<usize>, String)> =
        found.into_iter().map(|place| (place.frames.clone(), place.sentence())).collect();
    for (frames, sentence) in places {
        for frame in frames {
            records.get_mut(frame).into_iter().for_each(|r| r.remarks.push(sentence.clone()));
        }
    }
}

/// What took part in the solutions.
fn sights(records: &[ImageRecord]) -> Vec<Sight<'_>> {
    let mut out = Vec::new();
    for (frame, record) in records.iter().enumerate().filter(|(_, r)| r.is_solved()) {
        let factor = record.variance_factor.unwrap_or(1.0).max(1.0);
        out.extend(record.markers.iter().filter(|m| m.used).filter_map(|m| {
            let weight = |sigma: f64| 1.0 / (factor * sigma * sigma);
            Some(Sight {
                frame,
                id: &m.id,
                at: Vector2::new(m.u_px?, m.v_px?),
                off: -Vector2::new(m.residual_u_px?, m.residual_v_px?),
                weight: Vector2::new(weight(m.sigma_u_px?), weight(m.sigma_v_px?)),
            })
        }));
    }
    out
}

/// The places that no chance explains, the surest first.
fn found(mut sights: Vec<Sight<'_>>, reach_px: f64) -> Vec<Place<'_>> {
    let cell = |s: &Sight<'_>| [s.at.x, s.at.y].map(|v| (v / reach_px).floor() as i64);
    let cells: BTreeSet<[i64; 2]> = sights.iter().map(cell).collect();
    // Of two degrees of freedom a share exp(-T / 2) exceeds T.
    let least = 2.0 * (cells.len().max(1) as f64 / ALPHA).ln();
    let mut out = Vec::new();
    loop {
        let centres = cells.iter().map(|c| Vector2::from(c.map(|v| (v as f64 + 0.5) * reach_px)));
        let all = centres.filter_map(|centre| place(&sights, centre, reach_px));
        let Some(best) = all.max_by(|a, b| a.square.total_cmp(&b.square)).filter(|p| p.square > least) else {
            return out;
        };
        sights.retain(|s| (s.at - best.at).norm() > reach_px);
        out.push(best);
    }
}

/// What a place does to the markers that pass it, against what they show elsewhere.
fn place<'a>(sights: &[Sight<'a>], at: Vector2<f64>, reach_px: f64) -> Option<Place<'a>> {
    let mut by_marker: BTreeMap<&str, [Vec<&Sight<'a>>; 2]> = BTreeMap::new();
    for sight in sights {
        let far = (sight.at - at).norm();
        if !(reach_px..=2.0 * reach_px).contains(&far) {
            by_marker.entry(sight.id).or_default()[usize::from(far > reach_px)].push(sight);
        }
    }
    by_marker.retain(|_, [here, elsewhere]| !here.is_empty() && !elsewhere.is_empty());
    let frames: BTreeSet<usize> = by_marker.values().flat_map(|[here, _]| here).map(|s| s.frame).collect();
    let elsewhere: usize = by_marker.values().map(|[_, elsewhere]| elsewhere.len()).sum();
    if frames.len().min(elsewhere) < FRAMES {
        return None;
    }
    let (mut sum, mut weight) = (Vector2::zeros(), Vector2::zeros());
    for [here, elsewhere] in by_marker.values() {
        let (one, other) = (mean(here), mean(elsewhere));
        let own = one.1.zip_map(&other.1, |a, b| 1.0 / (1.0 / a + 1.0 / b));
        sum += own.component_mul(&(one.0 - other.0));
        weight += own;
    }
    let shift = sum.component_div(&weight);
    let square = shift.component_mul(&shift).dot(&weight);
    Some(Place { at, shift, square, frames, markers: by_marker.into_keys().collect() })
}

/// The weighted mean of what markers are off, px, and its weights.
fn mean(sights: &[&Sight<'_>]) -> (Vector2<f64>, Vector2<f64>) {
    let weight: Vector2<f64> = sights.iter().map(|s| s.weight).sum();
    let sum: Vector2<f64> = sights.iter().map(|s| s.weight.component_mul(&s.off)).sum();
    (sum.component_div(&weight), weight)
}

impl Place<'_> {
    fn sentence(&self) -> String {
        let markers: Vec<&str> = self.markers.iter().copied().collect();
        format!(
            "about ({:.0}, {:.0}) px the picture shifts what passes by ({:+.2}, {:+.2}) px against what it shows elsewhere ({} in {} \
             frames): look there at the pane for drops, frost or a streak",
            self.at.x,
            self.at.y,
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
    use crate::record::{MarkerRecord, Status};

    /// A flight of frames in which markers move down by 40 px each time; `off` says by how much one is off at a place, px.
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
            // Scatter with about the standard deviation that is stated.
            let scatter = |j: usize| 0.14 * ((k * 7 + j * 13) as f64).sin();
            let at = |x: f64| Vector2::new(x, 500.0 + 40.0 * k as f64);
            let markers = vec![marker("A", at(1000.0), scatter(1)), marker("B", at(1800.0), scatter(2))];
            ImageRecord { status: Status::Ok, markers, ..ImageRecord::default() }
        };
        (0..24).map(frame).collect()
    }

    fn remarks(mut records: Vec<ImageRecord>) -> Vec<usize> {
        name(&mut records, 7700.0);
        (0..records.len()).filter(|&k| !records[k].remarks.is_empty()).collect()
    }

    #[test]
    fn what_stays_with_the_place_is_named_where_it_is() {
        let drop = Vector2::new(1000.0, 900.0);
        let seen = remarks(flight(|_, at| if (at - drop).norm() < 90.0 { [0.5, -0.2] } else { [0.0; 2] }));
        assert!(seen.contains(&10) && seen.iter().all(|k| (7..=13).contains(k)), "{seen:?}");
    }

    #[test]
    fn what_stays_with_the_marker_is_none() {
        assert!(remarks(flight(|_, _| [0.0; 2])).is_empty());
        assert!(remarks(flight(|id, _| if id == "B" { [0.5, -0.2] } else { [0.0; 2] })).is_empty());
    }
}
