//! Image of a frame with its markers, for the report, the pages and the overlays of `wingd detect`.

use base64::Engine;
use maud::{Markup, html};
use nalgebra::{Matrix2, Vector2, vector};

use super::super::number::{count_text, format_fixed};
use super::plot::{NamedSpot, draw_names, px, round_step};
use crate::frame_format::Format;
use crate::pipeline::decode::decode_image;
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::pipeline::shrink::small_jpeg;
use crate::record::{ImageRecord, MarkerRecord};
use crate::results::FramePicture;
use wingd_measure::detect::detect;
use wingd_measure::detect::{Detection, Detections, Rejected};
use wingd_measure::estimation::robust::median;
use wingd_measure::raster::Raster;

/// Maximum width and height of the embedded image, px.
const MAX_IMAGE_PX: usize = 1600;
/// JPEG quality, percent.
const JPEG_QUALITY: u8 = 82;
const USED_COLOUR: &str = "#3dea6d";
const UNUSED_COLOUR: &str = "#ffd23d";
const UNIDENTIFIED_COLOUR: &str = "#57c8ff";
const REJECTED_COLOUR: &str = "#ffa528";
const ERROR_COLOUR: &str = "#ff58c8";
/// Of the legend.
const LEGEND_COLOUR: &str = "#ebebeb";
/// Maximum number of rejected candidates drawn; the caption counts all.
const MAX_DRAWN_REJECTED: usize = 200;

/// Draws a frame with its markers and a caption; a warning if the frame cannot be decoded.
pub fn draw_picture(picture: &FramePicture, record: Option<&ImageRecord>) -> Markup {
    let broken = || html! { p.warning { (picture.image) ": " (PANIC_REASON) } };
    catch_panic(|| draw_decoded(picture, record)).unwrap_or_else(broken)
}

fn draw_decoded(picture: &FramePicture, record: Option<&ImageRecord>) -> Markup {
    if picture.fault.is_some() {
        return html! {};
    }
    let raster = match decode_image(&picture.bytes, picture.format.as_ref()) {
        Ok(raster) => raster,
        Err(error) => return html! { p.warning { (picture.image) ": " (error) } },
    };
    let found = detect(&raster);
    let markers = record.map_or(&[][..], |r| &r.markers[..]);
    let names = found.markers.iter().map(|d| match_detection(d, markers));
    let names: Vec<DetectionName> = names.collect();
    let enlarged = ellipse_enlargement(&raster, &found);
    let Some(drawing) = draw_detections(&raster, &found, &names, None, vec![]) else {
        return html! { p.warning { (picture.image) ": the image is too large to be shown" } };
    };
    html! {
        (drawing)
        p.caption {
            (picture.series) "/" (picture.image) ": " (count_text(found.markers.len(), "marker")) " detected ("
            span style="color:#0b7a2e" { "used" } ", " span style="color:#806200" { "not used" } ", "
            span style="color:#0d6fa8" { "without identity" } "), "
            (count_text(found.rejected.len(), "candidate")) " rejected (" span style="color:#8f5400" { "dashed" } "). "
            @if !found.markers.is_empty() {
                "Error ellipses (" span style="color:#b3177f" { "pink" } "): 1 sigma, enlarged " (format_fixed(Some(enlarged), 0)) " times."
            }
        }
    }
}

/// Draws the detections of a frame as an SVG file, with a legend; `None` if the frame is too large for a JPEG. `ids` are in
/// the order of the markers and may be shorter or empty. Rejected candidates have their reasons as labels if `with_reasons`.
pub fn overlay_svg(
    raster: &Raster,
    found: &Detections,
    ids: &[Option<String>],
    with_reasons: bool,
) -> Option<String> {
    let name = |(k, d): (usize, &Detection)| match ids.get(k).cloned().flatten() {
        Some(id) => (id, USED_COLOUR),
        None => (d.shape.name().to_owned(), UNIDENTIFIED_COLOUR),
    };
    let names: Vec<DetectionName> = found.markers.iter().enumerate().map(name).collect();
    let legend = NamedSpot {
        at: vector![0.0, 0.0],
        half: vector![0.0, 0.0],
        name: format!(
            "{}, {} rejected, error ellipses of 1 sigma enlarged {:.0} times",
            count_text(found.markers.len(), "marker"),
            count_text(found.rejected.len(), "candidate"),
            ellipse_enlargement(raster, found)
        ),
        colour: LEGEND_COLOUR,
    };
    let reason = |r: &Rejected| NamedSpot {
        at: r.centre_px,
        half: ellipse_extent(drawn_semi_axes(r), r.angle_rad),
        name: r.reason.text().to_owned(),
        colour: REJECTED_COLOUR,
    };
    let rejected = found.rejected.iter().take(MAX_DRAWN_REJECTED);
    let reasons = rejected.filter(|_| with_reasons).map(reason);
    draw_detections(raster, found, &names, Some(legend), reasons.collect()).map(Markup::into_string)
}

/// Name and colour of a detection.
type DetectionName = (String, &'static str);

/// Namespace of a file; a drawing within a page has none.
const SVG_NAMESPACE: &str = "http://www.w3.org/2000/svg";

/// Draws a frame with outlines, names and error ellipses of its detections; `None` if too large. A file has a `legend`.
fn draw_detections(
    raster: &Raster,
    found: &Detections,
    names: &[DetectionName],
    legend: Option<NamedSpot>,
    reasons: Vec<NamedSpot>,
) -> Option<Markup> {
    let image = embedded_image(raster, MAX_IMAGE_PX)?;
    let enlarged = ellipse_enlargement(raster, found);
    let (w, h) = (raster.width() as f64, raster.height() as f64);
    let spot = |(d, (name, colour)): (&Detection, &DetectionName)| NamedSpot {
        at: d.centre_px,
        half: ellipse_extent([d.semi_major_px, d.semi_minor_px], d.angle_rad),
        name: name.clone(),
        colour,
    };
    let xmlns = legend.as_ref().map(|_| SVG_NAMESPACE);
    let spots = found.markers.iter().zip(names).map(spot);
    let labels: Vec<_> = legend.into_iter().chain(spots).chain(reasons).collect();
    Some(html! {
        svg.photo xmlns=[xmlns] viewBox=(format!("0 0 {w} {h}")) role="img"
            aria-label="Frame with detected markers" style=(format!("stroke-width:{}px", px(w / 900.0))) {
            (image)
            @for r in found.rejected.iter().take(MAX_DRAWN_REJECTED) {
                (draw_ellipse(r.centre_px, drawn_semi_axes(r), r.angle_rad, REJECTED_COLOUR, r.reason.text(), true))
            }
            @for (d, (name, colour)) in found.markers.iter().zip(names) {
                (draw_ellipse(d.centre_px, [d.semi_major_px, d.semi_minor_px], d.angle_rad, colour, name, false))
                @let (semi, angle) = principal_axes(&d.covariance_px2);
                (draw_ellipse(d.centre_px, semi.map(|s| s * enlarged), angle, ERROR_COLOUR, "error ellipse", false))
            }
            (draw_names(&labels, [0.0, 0.0, w, h], w / 75.0, PLATE_OPACITY))
        }
    })
}

/// Embeds a frame of at most `largest` px in a drawing in its pixels; `None` if it is too large for a JPEG.
fn embedded_image(raster: &Raster, largest: usize) -> Option<Markup> {
    let jpeg = small_jpeg(raster, largest, JPEG_QUALITY)?;
    let data = base64::engine::general_purpose::STANDARD.encode(jpeg);
    Some(html! {
        image href=(format!("data:image/jpeg;base64,{data}")) x="-0.5" y="-0.5" width=(raster.width()) height=(raster.height()) {}
    })
}

/// Draws a frame of at most `largest` px as an SVG file, with the markers of its result; `None` if it cannot be read.
pub fn svg_thumbnail(
    bytes: &[u8],
    format: Option<&Format>,
    record: Option<&ImageRecord>,
    largest: usize,
) -> Option<String> {
    let raster = decode_image(bytes, format).ok()?;
    let image = embedded_image(&raster, largest)?;
    let (w, h) = (raster.width() as f64, raster.height() as f64);
    let radius = w.max(h) / 70.0;
    let seen =
        |m: &MarkerRecord| Some((m.u_px?, m.v_px?)).filter(|(u, v)| u.is_finite() && v.is_finite());
    let markers: Vec<(&MarkerRecord, (f64, f64))> = record
        .iter()
        .flat_map(|r| &r.markers)
        .filter_map(|m| Some((m, seen(m)?)))
        .collect();
    let named: Vec<NamedSpot> = markers
        .iter()
        .filter(|_| largest >= MIN_NAMED_PX)
        .map(|(m, (u, v))| NamedSpot {
            at: vector![*u, *v],
            half: vector![radius, radius],
            name: m.id.clone(),
            colour: if m.used { USED_COLOUR } else { UNUSED_COLOUR },
        })
        .collect();
    let markup = html! {
        svg xmlns=(SVG_NAMESPACE) viewBox=(format!("0 0 {w} {h}")) width=(w) height=(h) {
            (image)
            @for (m, (u, v)) in &markers {
                @let colour = if m.used { USED_COLOUR } else { UNUSED_COLOUR };
                circle cx=(px(*u)) cy=(px(*v)) r=(px(radius)) fill="none" stroke=(colour) stroke-width=(px(radius / 4.0)) {}
            }
            (draw_names(&named, [0.0, 0.0, w, h], 1.1 * radius, PLATE_OPACITY))
        }
    };
    Some(markup.into_string())
}

/// Opacity of the ground of the names.
const PLATE_OPACITY: f64 = 0.75;
/// Minimum size of an image with marker names, px.
const MIN_NAMED_PX: usize = 1000;

/// Smallest semi-axis of a drawn candidate, px.
const MIN_SEMI_AXIS_PX: f64 = 4.0;

fn drawn_semi_axes(r: &Rejected) -> [f64; 2] {
    [r.semi_major_px, r.semi_minor_px].map(|semi| semi.max(MIN_SEMI_AXIS_PX))
}

/// Returns half width and half height of an ellipse's bounding box.
fn ellipse_extent([major, minor]: [f64; 2], angle: f64) -> Vector2<f64> {
    let (sin, cos) = angle.sin_cos();
    vector![
        (major * cos).hypot(minor * sin),
        (major * sin).hypot(minor * cos)
    ]
}

/// Returns the standard deviations along the principal axes, larger first, and the direction of the larger.
fn principal_axes(covariance: &Matrix2<f64>) -> ([f64; 2], f64) {
    let (a, b, c) = (covariance.m11, covariance.m12, covariance.m22);
    let (mean, half) = ((a + c) / 2.0, ((a - c) / 2.0).hypot(b));
    let sigma = |v: f64| v.max(0.0).sqrt();
    (
        [sigma(mean + half), sigma(mean - half)],
        0.5 * (2.0 * b).atan2(a - c),
    )
}

/// Size of the frame over the size of the median error ellipse.
const ELLIPSES_PER_FRAME: f64 = 150.0;

/// Returns the round factor by which error ellipses are enlarged.
fn ellipse_enlargement(raster: &Raster, found: &Detections) -> f64 {
    let sigmas = found
        .markers
        .iter()
        .map(|m| principal_axes(&m.covariance_px2).0[0]);
    let sigmas = sigmas.filter(|s| s.is_finite() && *s > 0.0).collect();
    let target_px = raster.width().max(raster.height()) as f64 / ELLIPSES_PER_FRAME;
    median(sigmas).map_or(1.0, |sigma| round_step(0.5 * target_px / sigma))
}

fn draw_ellipse(
    at: Vector2<f64>,
    semi: [f64; 2],
    angle: f64,
    colour: &str,
    title: &str,
    dashed: bool,
) -> Markup {
    if !(at.iter().chain(&semi).all(|v| v.is_finite()) && angle.is_finite()) {
        return html! {};
    }
    let turn = format!(
        "translate({} {}) rotate({})",
        px(at.x),
        px(at.y),
        px(angle.to_degrees())
    );
    html! {
        ellipse rx=(px(semi[0])) ry=(px(semi[1])) transform=(turn) fill="none" stroke=(colour)
            stroke-dasharray=[dashed.then_some("8 6")] { title { (title) } }
    }
}

/// Returns id and colour of the marker of the result at this detection; shape and colour of an unidentified one if there is
/// none.
fn match_detection(d: &Detection, markers: &[MarkerRecord]) -> DetectionName {
    let distance = |m: &MarkerRecord| {
        let at = vector![m.u_px?, m.v_px?];
        Some((at - d.centre_px).norm()).filter(|v| v.is_finite())
    };
    let nearest = markers
        .iter()
        .filter_map(|m| Some((distance(m)?, m)))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    // The perspective bias shifts a centre by at most 1 to 2 px, much less than the size of a marker.
    match nearest.filter(|(away, _)| *away < 3.0_f64.max(0.1 * d.semi_minor_px)) {
        Some((_, m)) if m.used => (m.id.clone(), USED_COLOUR),
        Some((_, m)) => (m.id.clone(), UNUSED_COLOUR),
        None => (d.shape.name().to_owned(), UNIDENTIFIED_COLOUR),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decoder_crash_gives_a_warning() {
        let bytes = crate::pipeline::decode::BREAKS.to_vec();
        let frame = FramePicture {
            bytes,
            ..FramePicture::default()
        };
        assert!(
            draw_picture(&frame, None)
                .into_string()
                .contains("decoder failed")
        );
    }
}
