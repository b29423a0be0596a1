//! Three orthographic views of ground shape, flight shape and lines of sight (figure 9 of the publication).

use maud::{Markup, html};
use nalgebra::{Vector3, vector};

use wingd_evaluation::figures::figure::MAIN_COLOUR;
use wingd_evaluation::figures::plot::{
    Axis, NamedSpot, Plot, draw_names, px, round_step, svg_drawing,
};
use wingd_evaluation::record::ImageRecord;
use wingd_evaluation::results::{GroundMarker, ReportSite};
use wingd_measure::geometry::WingFrame;
use wingd_measure::ordering::sort_by_value;

const WIDTH: f64 = 1040.0;
const LEFT: f64 = 64.0;
const GAP: f64 = 84.0;
/// Space for the title of a view; that of a narrow one begins to the left of it.
const TITLE_WIDTH: f64 = 156.0;
pub(super) const GROUND_COLOUR: &str = "#6d737d";
const SIGHT_COLOUR: &str = "#a8730f";

/// Marker positions in the wing frame, m.
pub(super) struct PlacedMarker {
    pub(super) id: String,
    pub(super) ground: Option<Vector3<f64>>,
    pub(super) flight: Option<Vector3<f64>>,
}

/// Drawing of the views.
pub struct OrthographicViews {
    pub drawing: Markup,
    /// Whether the installation is known; if not, axes and ground are guessed from the results.
    pub surveyed: bool,
}

/// Draws the views of one solved frame; `None` without positions.
pub fn orthographic_views(
    record: &ImageRecord,
    site: Option<&ReportSite>,
) -> Option<OrthographicViews> {
    let frame = wing_frame(record, site)?;
    let placed = place_markers(record, site, &frame);
    let camera = site.map(|_| Vector3::zeros());
    let points: Vec<Vector3<f64>> = placed
        .iter()
        .flat_map(|p| p.ground.into_iter().chain(p.flight))
        .chain(camera)
        .collect();
    if points.is_empty() {
        return None;
    }
    Some(OrthographicViews {
        drawing: draw_three_views(&placed, camera, &points),
        surveyed: site.is_some(),
    })
}

/// Returns the wing frame of the installation, or one guessed from the results.
pub(super) fn wing_frame(record: &ImageRecord, site: Option<&ReportSite>) -> Option<WingFrame> {
    site.map(|s| s.wing).or_else(|| guessed_frame(record))
}

pub(super) fn place_markers(
    record: &ImageRecord,
    site: Option<&ReportSite>,
    frame: &WingFrame,
) -> Vec<PlacedMarker> {
    let flight = |id: &str| {
        let marker = record.markers.iter().find(|m| m.id == id)?;
        Some(Vector3::from(marker.position_m?)).filter(is_finite_point)
    };
    let surveyed = |g: &GroundMarker| PlacedMarker {
        id: g.id.clone(),
        ground: Some(frame.wing_point(&Vector3::from(g.position_m))).filter(is_finite_point),
        flight: flight(&g.id).map(|p| frame.wing_point(&p)),
    };
    if let Some(site) = site {
        return site.ground.iter().map(surveyed).collect();
    }
    let lowered = |m: &wingd_evaluation::record::MarkerRecord| {
        let position = flight(&m.id)?;
        let ground = m
            .deflection_m
            .map(|l| frame.wing_point(&(position - Vector3::z() * l)));
        Some(PlacedMarker {
            id: m.id.clone(),
            ground,
            flight: Some(frame.wing_point(&position)),
        })
    };
    record.markers.iter().filter_map(lowered).collect()
}

/// Guesses a wing frame along the line from the nearest to the farthest marker, with its origin in the nearest.
fn guessed_frame(record: &ImageRecord) -> Option<WingFrame> {
    let known = record
        .markers
        .iter()
        .filter_map(|m| Some((m.distance_m?, Vector3::from(m.position_m?))));
    let mut known: Vec<_> = known
        .filter(|(d, p)| d.is_finite() && is_finite_point(p))
        .collect();
    sort_by_value(&mut known, |one| one.0);
    let (near, far) = (known.first()?.1, known.last()?.1);
    let direction = (far - near).xy();
    (direction.norm() > 1e-6).then(|| WingFrame::new(near, direction))
}

fn is_finite_point(p: &Vector3<f64>) -> bool {
    p.iter().all(|v| v.is_finite())
}

/// Draws the front view at the top left, the top view below it, the side view to its right, in one scale.
fn draw_three_views(
    placed: &[PlacedMarker],
    camera: Option<Vector3<f64>>,
    points: &[Vector3<f64>],
) -> Markup {
    let range = |k: usize, margin: f64| {
        let values = || points.iter().map(|p| p[k]);
        let (low, high) = (
            values().fold(f64::MAX, f64::min),
            values().fold(f64::MIN, f64::max),
        );
        (low - margin, high + margin)
    };
    let (x, y, z) = (range(0, 1.0), range(1, 0.5), range(2, 0.7));
    let step = round_step((x.1 - x.0) / 9.0);
    let fine = round_step((y.1 - y.0).max(z.1 - z.0) / 5.0);
    let axis =
        |(low, high): (f64, f64), step: f64, label: &str| Axis::from_range(low, high, step, label);
    let span = || axis(x, step, "span / m");
    let height = || axis(y, fine, "up / m");
    let (scale, side) = {
        let metres = span().length() + axis(z, fine, "").length();
        ((WIDTH - LEFT - GAP - 20.0) / metres, LEFT + GAP)
    };
    let size = |a: &Axis| a.length() * scale;
    let front_height = size(&height());
    let chord = axis(z, fine, "Z (chord) / m");
    let top_at = 30.0 + front_height + 76.0;
    let front = Plot {
        area: [LEFT, 30.0, size(&span()), front_height],
        x: span(),
        y: height(),
    };
    let right = side + size(&span());
    let end = Plot {
        area: [right, 30.0, size(&chord), front_height],
        x: chord.clone(),
        y: height(),
    };
    let top = Plot {
        area: [LEFT, top_at, size(&span()), size(&chord)],
        x: span(),
        y: chord.clone().reversed(),
    };
    let total = top_at + size(&chord) + 48.0;
    let content = html! {
        (draw_view(&front, "View along the chord", placed, camera, |p| (p.x, p.y)))
        (draw_view(&end, "View along the span", placed, camera, |p| (p.z, p.y)))
        (draw_view(&top, "View from above", placed, camera, |p| (p.x, -p.z)))
        (draw_ids(&top, placed))
        (draw_key(right, top_at + 20.0, camera.is_some()))
    };
    svg_drawing(WIDTH, total, "Three orthographic views", &content)
}

fn draw_view(
    plot: &Plot,
    name: &str,
    placed: &[PlacedMarker],
    camera: Option<Vector3<f64>>,
    flat: impl Fn(&Vector3<f64>) -> (f64, f64),
) -> Markup {
    let at = |p: &Vector3<f64>| {
        let (a, b) = flat(p);
        plot.point_at(a, b)
    };
    let line = |from: (f64, f64), to: (f64, f64), class: &str, colour: &str| {
        html! { line class=(class) x1=(px(from.0)) y1=(px(from.1)) x2=(px(to.0)) y2=(px(to.1)) stroke=(colour) {} }
    };
    html! {
        (plot.frame())
        text.title x=(px(plot.area[0].min(WIDTH - TITLE_WIDTH))) y=(px(plot.area[1] - 9.0)) { (name) }
        @for (camera, flight) in camera.iter().flat_map(|c| placed.iter().filter_map(move |p| Some((c, p.flight?)))) {
            (line(at(camera), at(&flight), "sight", SIGHT_COLOUR))
        }
        @for p in placed {
            @if let (Some(ground), Some(flight)) = (&p.ground, &p.flight) {
                (line(at(ground), at(flight), "deflection", MAIN_COLOUR))
            }
            @if let Some((x, y)) = p.ground.as_ref().map(at) {
                circle.hollow cx=(px(x)) cy=(px(y)) r="2.6" stroke=(GROUND_COLOUR) { title { (p.id) " on ground" } }
            }
            @if let Some((x, y)) = p.flight.as_ref().map(at) {
                circle cx=(px(x)) cy=(px(y)) r="2.6" fill=(MAIN_COLOUR) { title { (p.id) " in flight" } }
            }
        }
        @if let Some((x, y)) = camera.as_ref().map(at) { (draw_camera(x, y)) }
    }
}

fn draw_camera(x: f64, y: f64) -> Markup {
    let corner = |dx: f64, dy: f64| format!("{},{}", px(x + dx), px(y + dy));
    let points = [corner(0.0, -5.5), corner(5.0, 4.0), corner(-5.0, 4.0)].join(" ");
    html! { polygon points=(points) fill="#111" { title { "camera" } } }
}

/// Draws the marker ids in the view from above.
fn draw_ids(plot: &Plot, placed: &[PlacedMarker]) -> Markup {
    let [left, top, width, height] = plot.area;
    let spot = |p: &PlacedMarker| {
        let at = p.flight.or(p.ground)?;
        let (x, y) = plot.point_at(at.x, -at.z);
        let name = p.id.chars().take(12).collect();
        Some(NamedSpot {
            at: vector![x, y],
            half: vector![3.0, 3.0],
            name,
            colour: "#4d5663",
        })
    };
    let spots: Vec<NamedSpot> = placed.iter().filter_map(spot).collect();
    draw_names(&spots, [left, top, left + width, top + height], 10.0, 0.0)
}

fn draw_key(x: f64, y: f64, camera: bool) -> Markup {
    let text = |row: f64, words: &str| {
        html! { text.name x=(px(x + 24.0)) y=(px(y + 20.0 * row + 4.0)) fill="#333" { (words) } }
    };
    html! {
        circle.hollow cx=(px(x + 8.0)) cy=(px(y)) r="2.6" stroke=(GROUND_COLOUR) {}
        (text(0.0, "on ground"))
        circle cx=(px(x + 8.0)) cy=(px(y + 20.0)) r="2.6" fill=(MAIN_COLOUR) {}
        (text(1.0, "in flight"))
        line.deflection x1=(px(x)) y1=(px(y + 40.0)) x2=(px(x + 16.0)) y2=(px(y + 40.0)) stroke=(MAIN_COLOUR) {}
        (text(2.0, "deflection"))
        @if camera {
            line.sight x1=(px(x)) y1=(px(y + 60.0)) x2=(px(x + 16.0)) y2=(px(y + 60.0)) stroke=(SIGHT_COLOUR) {}
            (text(3.0, "line of sight"))
            (draw_camera(x + 8.0, y + 80.0))
            (text(4.0, "camera"))
        }
    }
}
