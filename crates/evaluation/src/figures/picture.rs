//! Image of a frame with its markers, for the report.

use base64::Engine;
use maud::{Markup, html};
use nalgebra::{Vector2, vector};

use super::super::number::{count_text, format_fixed};
use super::plot::{NamedSpot, draw_names, px};
use crate::figures::overlay::{ellipse_enlargement, ellipse_extent};
use crate::frame_format::Format;
use crate::pipeline::decode::decode_image;
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::pipeline::shrink::small_jpeg;
use crate::record::{ImageRecord, MarkerRecord};
use crate::results::FramePicture;
use wingd_measure::detect::detect;
use wingd_measure::detect::{Detection, Detections};

/// Maximum width and height of the embedded image, px.
const MAX_IMAGE_PX: usize = 1600;
/// JPEG quality, percent.
const JPEG_QUALITY: u8 = 82;
const USED_COLOUR: &str = "#3dea6d";
const UNUSED_COLOUR: &str = "#ffd23d";
const UNIDENTIFIED_COLOUR: &str = "#57c8ff";
const REJECTED_COLOUR: &str = "#ffa528";
const ERROR_COLOUR: &str = "#ff58c8";
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
    let Some(jpeg) = small_jpeg(&raster, MAX_IMAGE_PX, JPEG_QUALITY) else {
        return html! { p.warning { (picture.image) ": the image is too large to be shown" } };
    };
    let found = detect(&raster);
    let markers = record.map_or(&[][..], |r| &r.markers[..]);
    let enlarged = ellipse_enlargement(
        &found.markers,
        raster.width().max(raster.height()) as f64 / 150.0,
    );
    let (w, h) = (raster.width() as f64, raster.height() as f64);
    let name_spot = |d: &Detection| {
        let (name, colour) = match_detection(d, markers);
        let half = ellipse_extent(d.semi_major_px, d.semi_minor_px, d.angle_rad);
        NamedSpot {
            at: d.centre_px,
            half,
            name,
            colour,
        }
    };
    let named: Vec<NamedSpot> = found.markers.iter().map(name_spot).collect();
    let data = format!(
        "data:image/jpeg;base64,{}",
        base64::engine::general_purpose::STANDARD.encode(jpeg)
    );
    html! {
        svg.photo viewBox=(format!("0 0 {w} {h}")) role="img" aria-label="Frame with detected markers"
            style=(format!("stroke-width:{}px", px(w / 900.0))) {
            image href=(data) x="-0.5" y="-0.5" width=(w) height=(h) {}
            (draw_outlines(&found, markers, enlarged))
            (draw_names(&named, [0.0, 0.0, w, h], w / 75.0, PLATE_OPACITY))
        }
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

/// Draws a frame of at most `largest` px as an SVG file, with the markers of its result; `None` if it cannot be read.
pub fn svg_thumbnail(
    bytes: &[u8],
    format: Option<&Format>,
    record: Option<&ImageRecord>,
    largest: usize,
) -> Option<String> {
    let raster = decode_image(bytes, format).ok()?;
    let jpeg = base64::engine::general_purpose::STANDARD.encode(small_jpeg(
        &raster,
        largest,
        JPEG_QUALITY,
    )?);
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
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {w} {h}")) width=(w) height=(h) {
            image href=(format!("data:image/jpeg;base64,{jpeg}")) x="-0.5" y="-0.5" width=(w) height=(h) {}
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

fn draw_outlines(found: &Detections, markers: &[MarkerRecord], enlarged: f64) -> Markup {
    html! {
        @for r in found.rejected.iter().take(MAX_DRAWN_REJECTED) {
            (draw_ellipse(r.centre_px, [r.semi_major_px.max(4.0), r.semi_minor_px.max(4.0)], r.angle_rad, REJECTED_COLOUR, r.reason.text(), true))
        }
        @for d in &found.markers {
            @let (text, colour) = match_detection(d, markers);
            (draw_ellipse(d.centre_px, [d.semi_major_px, d.semi_minor_px], d.angle_rad, colour, &text, false))
            @let (semi, angle) = crate::figures::overlay::principal_axes(&d.covariance_px2);
            (draw_ellipse(d.centre_px, semi.map(|s| s * enlarged), angle, ERROR_COLOUR, "error ellipse", false))
        }
    }
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
fn match_detection(d: &Detection, markers: &[MarkerRecord]) -> (String, &'static str) {
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
