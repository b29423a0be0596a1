//! Three orthographic views show ground, flight and lines of sight (the publication's figure 9).

use maud::{Markup, html};
use nalgebra::{Vector2, Vector3, vector};

use super::super::labels::{Area, Labels, leader};
use super::super::{GroundMarker, Site};
use super::plot::{Axis, Plot, drawing, px, round_step};
use crate::measure::geometry::WingFrame;
use crate::record::ImageRecord;

const WIDTH: f64 = 1040.0;
const LEFT: f64 = 64.0;
const GAP: f64 = 84.0;
const GROUND: &str = "#6d737d";
const FLIGHT: &str = "#17456f";
const SIGHT: &str = "#a8730f";

/// A marker in the wing frame, m.
pub(super) struct Placed {
    pub(super) id: String,
    pub(super) ground: Option<Vector3<f64>>,
    pub(super) flight: Option<Vector3<f64>>,
}

/// What the views show, and how much of it is known.
pub struct Views {
    /// The drawing.
    pub drawing: Markup,
    /// False: axes and ground are guessed from the results alone.
    pub surveyed: bool,
}

/// Views of one solved frame; `None` without positions.
pub fn views(record: &ImageRecord, site: Option<&Site>) -> Option<Views> {
    let frame = frame_of(record, site)?;
    let placed = placed(record, site, &frame);
    let camera = site.map(|_| Vector3::zeros());
    let points: Vec<Vector3<f64>> =
        placed.iter().flat_map(|p| p.ground.into_iter().chain(p.flight)).chain(camera).collect();
    if points.is_empty() {
        return None;
    }
    Some(Views { drawing: draw(&placed, camera, &points), surveyed: site.is_some() })
}

/// The installation's wing frame, or one guessed from the results.
pub(super) fn frame_of(record: &ImageRecord, site: Option<&Site>) -> Option<WingFrame> {
    site.map(|s| s.wing).or_else(|| guessed_frame(record))
}

pub(super) fn placed(record: &ImageRecord, site: Option<&Site>, frame: &WingFrame) -> Vec<Placed> {
    let flight = |id: &str| {
        let marker = record.markers.iter().find(|m| m.id == id)?;
        Some(Vector3::from(marker.position_m?)).filter(finite)
    };
    let surveyed = |g: &GroundMarker| Placed {
        id: g.id.clone(),
        ground: Some(frame.wing_point(&Vector3::from(g.position_m))).filter(finite),
        flight: flight(&g.id).map(|p| frame.wing_point(&p)),
    };
    if let Some(site) = site {
        return site.ground.iter().map(surveyed).collect();
    }
    let lowered = |m: &crate::record::MarkerRecord| {
        let position = flight(&m.id)?;
        let ground = m.deflection_m.map(|l| frame.wing_point(&(position - Vector3::z() * l)));
        Some(Placed { id: m.id.clone(), ground, flight: Some(frame.wing_point(&position)) })
    };
    record.markers.iter().filter_map(lowered).collect()
}

/// Along the line from the nearest to the farthest marker, origin in the nearest.
fn guessed_frame(record: &ImageRecord) -> Option<WingFrame> {
    let known = record.markers.iter().filter_map(|m| Some((m.distance_m?, Vector3::from(m.position_m?))));
    let mut known: Vec<_> = known.filter(|(d, p)| d.is_finite() && finite(p)).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (near, far) = (known.first()?.1, known.last()?.1);
    let direction = (far - near).xy();
    (direction.norm() > 1e-6).then(|| WingFrame::new(near, direction))
}

fn finite(p: &Vector3<f64>) -> bool {
    p.iter().all(|v| v.is_finite())
}

/// Front view top left, top view below it, side view at its right; one scale for all.
fn draw(placed: &[Placed], camera: Option<Vector3<f64>>, points: &[Vector3<f64>]) -> Markup {
    let range = |k: usize, margin: f64| {
        let values = || points.iter().map(|p| p[k]);
        let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
        (low - margin, high + margin)
    };
    let (x, y, z) = (range(0, 1.0), range(1, 0.5), range(2, 0.7));
    let step = round_step((x.1 - x.0) / 9.0);
    let fine = round_step((y.1 - y.0).max(z.1 - z.0) / 5.0);
    let axis = |(low, high): (f64, f64), step: f64, label: &str| Axis::between(low, high, step, label);
    let span = || axis(x, step, "span / m");
    let height = || axis(y, fine, "up / m");
    let (scale, side) = {
        let metres = span().width() + axis(z, fine, "").width();
        ((WIDTH - LEFT - GAP - 20.0) / metres, LEFT + GAP)
    };
    let size = |a: &Axis| a.width() * scale;
    let front_height = size(&height());
    let chord = axis(z, fine, "Z (chord) / m");
    let top_at = 30.0 + front_height + 76.0;
    let front = Plot { area: [LEFT, 30.0, size(&span()), front_height], x: span(), y: height() };
    let right = side + size(&span());
    let end = Plot { area: [right, 30.0, size(&chord), front_height], x: chord.clone(), y: height() };
    let top =
        Plot { area: [LEFT, top_at, size(&span()), size(&chord)], x: span(), y: chord.clone().turned() };
    let total = top_at + size(&chord) + 48.0;
    let content = html! {
        (view(&front, "View along the chord", placed, camera, |p| (p.x, p.y)))
        (view(&end, "View along the span", placed, camera, |p| (p.z, p.y)))
        (view(&top, "View from above", placed, camera, |p| (p.x, -p.z)))
        (ids(&top, placed))
        (key(right, top_at + 20.0, camera.is_some()))
    };
    drawing(WIDTH, total, "Three orthographic views", &content)
}

fn view(
    plot: &Plot,
    name: &str,
    placed: &[Placed],
    camera: Option<Vector3<f64>>,
    flat: impl Fn(&Vector3<f64>) -> (f64, f64),
) -> Markup {
    let at = |p: &Vector3<f64>| {
        let (a, b) = flat(p);
        plot.at(a, b)
    };
    let line = |from: (f64, f64), to: (f64, f64), class: &str, colour: &str| {
        html! { line class=(class) x1=(px(from.0)) y1=(px(from.1)) x2=(px(to.0)) y2=(px(to.1)) stroke=(colour) {} }
    };
    html! {
        (plot.frame())
        text.title x=(px(plot.area[0])) y=(px(plot.area[1] - 9.0)) { (name) }
        @for (camera, flight) in camera.iter().flat_map(|c| placed.iter().filter_map(move |p| Some((c, p.flight?)))) {
            (line(at(camera), at(&flight), "sight", SIGHT))
        }
        @for p in placed {
            @if let (Some(ground), Some(flight)) = (&p.ground, &p.flight) {
                (line(at(ground), at(flight), "deflection", FLIGHT))
            }
            @if let Some((x, y)) = p.ground.as_ref().map(at) {
                circle.hollow cx=(px(x)) cy=(px(y)) r="2.6" stroke=(GROUND) { title { (p.id) " on ground" } }
            }
            @if let Some((x, y)) = p.flight.as_ref().map(at) {
                circle cx=(px(x)) cy=(px(y)) r="2.6" fill=(FLIGHT) { title { (p.id) " in flight" } }
            }
        }
        @if let Some((x, y)) = camera.as_ref().map(at) { (camera_sign(x, y)) }
    }
}

fn camera_sign(x: f64, y: f64) -> Markup {
    let corner = |dx: f64, dy: f64| format!("{},{}", px(x + dx), px(y + dy));
    let points = [corner(0.0, -5.5), corner(5.0, 4.0), corner(-5.0, 4.0)].join(" ");
    html! { polygon points=(points) fill="#111" { title { "camera" } } }
}

/// The markers' ids in the view from above.
fn ids(plot: &Plot, placed: &[Placed]) -> Markup {
    let [left, top, width, height] = plot.area;
    let mut labels = Labels::new(Area([left, top, left + width, top + height]));
    let spots: Vec<(&str, Vector2<f64>)> = placed
        .iter()
        .filter_map(|p| {
            let at = p.flight.or(p.ground)?;
            let (x, y) = plot.at(at.x, -at.z);
            Some((p.id.as_str(), vector![x, y]))
        })
        .collect();
    for (_, at) in &spots {
        labels.occupy(Area([at.x - 3.0, at.y - 3.0, at.x + 3.0, at.y + 3.0]));
    }
    html! {
        @for (id, at) in &spots {
            @let id: String = id.chars().take(12).collect();
            @let size = vector![id.chars().count() as f64 * 6.2, 10.0];
            @let half = vector![3.0, 3.0];
            @if let Some(place) = labels.place(*at, half, size, 1.5) {
                @let [from, to] = leader(*at, half, place, size);
                line.leader x1=(px(from.x)) y1=(px(from.y)) x2=(px(to.x)) y2=(px(to.y)) {}
                text.id x=(px(place.x)) y=(px(place.y + 9.0)) { (id) }
            }
        }
    }
}

fn key(x: f64, y: f64, camera: bool) -> Markup {
    let text = |row: f64, words: &str| {
        html! { text.name x=(px(x + 24.0)) y=(px(y + 20.0 * row + 4.0)) fill="#333" { (words) } }
    };
    html! {
        circle.hollow cx=(px(x + 8.0)) cy=(px(y)) r="2.6" stroke=(GROUND) {}
        (text(0.0, "on ground"))
        circle cx=(px(x + 8.0)) cy=(px(y + 20.0)) r="2.6" fill=(FLIGHT) {}
        (text(1.0, "in flight"))
        line.deflection x1=(px(x)) y1=(px(y + 40.0)) x2=(px(x + 16.0)) y2=(px(y + 40.0)) stroke=(FLIGHT) {}
        (text(2.0, "deflection"))
        @if camera {
            line.sight x1=(px(x)) y1=(px(y + 60.0)) x2=(px(x + 16.0)) y2=(px(y + 60.0)) stroke=(SIGHT) {}
            (text(3.0, "line of sight"))
            (camera_sign(x + 8.0, y + 80.0))
            (text(4.0, "camera"))
        }
    }
}
