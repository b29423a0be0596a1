//! The report embeds a frame with the markers drawn on it.

use base64::Engine;
use maud::{Markup, html};
use nalgebra::{Vector2, vector};

use super::super::Picture;
use super::super::labels::{Area, Labels, leader};
use super::super::number::{count, fixed};
use super::super::overlay::{enlargement, extent};
use super::plot::px;
use crate::camera::Format;
use crate::measure::detect::{Detection, Detections, detect};
use crate::pipeline::decode::decode;
use crate::pipeline::guard::{BROKE_OFF, guarded};
use crate::pipeline::shrink::small_jpeg;
use crate::record::{ImageRecord, MarkerRecord};

/// The embedded picture is at most this wide and high, px.
const MAX_IMAGE_PX: usize = 1600;
/// Of its JPEG, percent.
const QUALITY: u8 = 82;
const USED: &str = "#3dea6d";
const UNUSED: &str = "#ffd23d";
const UNKNOWN: &str = "#57c8ff";
const TURNED_DOWN: &str = "#ffa528";
const ERROR: &str = "#ff58c8";
/// Candidates turned down that are drawn at most; the caption counts all.
const MANY: usize = 200;

/// The frame with its markers and a line on what is drawn; a sentence where it cannot be read, or the program breaks off
/// at it.
pub fn picture(picture: &Picture, record: Option<&ImageRecord>) -> Markup {
    let broken = || html! { p.warning { (picture.image) ": " (BROKE_OFF) } };
    guarded(|| drawn(picture, record)).unwrap_or_else(broken)
}

fn drawn(picture: &Picture, record: Option<&ImageRecord>) -> Markup {
    if picture.fault.is_some() {
        return html! {};
    }
    let raster = match decode(&picture.bytes, picture.format.as_ref()) {
        Ok(raster) => raster,
        Err(error) => return html! { p.warning { (picture.image) ": " (error) } },
    };
    let Some(jpeg) = small_jpeg(&raster, MAX_IMAGE_PX, QUALITY) else {
        return html! { p.warning { (picture.image) ": the frame is too large to be shown" } };
    };
    let found = detect(&raster);
    let markers = record.map_or(&[][..], |r| &r.markers[..]);
    let enlarged = enlargement(&found.markers, raster.width().max(raster.height()) as f64 / 150.0);
    let (w, h) = (raster.width() as f64, raster.height() as f64);
    let data = format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(jpeg));
    html! {
        svg.photo viewBox=(format!("0 0 {w} {h}")) role="img" aria-label="Frame with detected markers"
            style=(format!("font-size:{}px;stroke-width:{}px", px(w / 75.0), px(w / 900.0))) {
            image href=(data) x="-0.5" y="-0.5" width=(w) height=(h) {}
            (outlines(&found, markers, enlarged))
            (names(&found, markers, w, h))
        }
        p.caption {
            (picture.series) "/" (picture.image) ": " (count(found.markers.len(), "marker")) " detected ("
            span style="color:#0b7a2e" { "used" } ", " span style="color:#806200" { "not used" } ", "
            span style="color:#0d6fa8" { "without identity" } "), "
            (count(found.rejected.len(), "candidate")) " turned down (" span style="color:#8f5400" { "dashed" } "). "
            @if !found.markers.is_empty() {
                "Error ellipses (" span style="color:#b3177f" { "pink" } "): 1 sigma, enlarged " (fixed(Some(enlarged), 0)) " times."
            }
        }
    }
}

/// A frame at most `largest` px wide and high as an SVG file of its own, with the markers of its result;
/// `None` where it cannot be read.
pub fn thumbnail(
    bytes: &[u8],
    format: Option<&Format>,
    record: Option<&ImageRecord>,
    largest: usize,
) -> Option<String> {
    let raster = decode(bytes, format).ok()?;
    let jpeg = base64::engine::general_purpose::STANDARD.encode(small_jpeg(&raster, largest, QUALITY)?);
    let (w, h) = (raster.width() as f64, raster.height() as f64);
    let radius = w.max(h) / 70.0;
    let seen = |m: &MarkerRecord| Some((m.u_px?, m.v_px?)).filter(|(u, v)| u.is_finite() && v.is_finite());
    let markers: Vec<(&MarkerRecord, (f64, f64))> =
        record.iter().flat_map(|r| &r.markers).filter_map(|m| Some((m, seen(m)?))).collect();
    let named = if largest >= NAMED {
        names_of(&markers, radius, w, h)
    } else {
        html! {}
    };
    let markup = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {w} {h}")) width=(w) height=(h) {
            image href=(format!("data:image/jpeg;base64,{jpeg}")) x="-0.5" y="-0.5" width=(w) height=(h) {}
            @for (m, (u, v)) in &markers {
                @let colour = if m.used { USED } else { UNUSED };
                circle cx=(px(*u)) cy=(px(*v)) r=(px(radius)) fill="none" stroke=(colour) stroke-width=(px(radius / 4.0)) {}
            }
            (named)
        }
    };
    Some(markup.into_string())
}

/// The markers' names where there is room, none over another.
fn names_of(markers: &[(&MarkerRecord, (f64, f64))], radius: f64, width: f64, height: f64) -> Markup {
    let letter = 1.1 * radius;
    let half = vector![radius, radius];
    let mut labels = Labels::new(Area([0.0, 0.0, width, height]));
    for (_, (u, v)) in markers {
        labels.occupy(Area([u - radius, v - radius, u + radius, v + radius]));
    }
    html! {
        @for (m, (u, v)) in markers {
            @let colour = if m.used { USED } else { UNUSED };
            @let size = vector![m.id.chars().count() as f64 * letter * 0.66, letter];
            @if let Some(place) = labels.place(vector![*u, *v], half, size, letter * 0.3) {
                @let [from, to] = leader(vector![*u, *v], half, place, size);
                line x1=(px(from.x)) y1=(px(from.y)) x2=(px(to.x)) y2=(px(to.y)) stroke=(colour) stroke-width=(px(radius / 8.0)) {}
                text x=(px(place.x)) y=(px(place.y + 0.85 * letter)) fill=(colour) font-size=(px(letter))
                    font-family="sans-serif" stroke="#10141c" stroke-width=(px(radius / 3.0)) paint-order="stroke" { (m.id) }
            }
        }
    }
}

/// Pictures from this size on bear the markers' names, px.
const NAMED: usize = 1000;

fn outlines(found: &Detections, markers: &[MarkerRecord], enlarged: f64) -> Markup {
    html! {
        @for r in found.rejected.iter().take(MANY) {
            (ellipse(r.centre_px, [r.semi_major_px.max(4.0), r.semi_minor_px.max(4.0)], r.angle_rad, TURNED_DOWN, r.reason.text(), true))
        }
        @for d in &found.markers {
            @let (text, colour) = known(d, markers);
            (ellipse(d.centre_px, [d.semi_major_px, d.semi_minor_px], d.angle_rad, colour, &text, false))
            @let (semi, angle) = super::super::overlay::principal(&d.covariance_px2);
            (ellipse(d.centre_px, semi.map(|s| s * enlarged), angle, ERROR, "error ellipse", false))
        }
    }
}

fn ellipse(at: Vector2<f64>, semi: [f64; 2], angle: f64, colour: &str, title: &str, dashed: bool) -> Markup {
    if !(at.iter().chain(&semi).all(|v| v.is_finite()) && angle.is_finite()) {
        return html! {};
    }
    let turn = format!("translate({} {}) rotate({})", px(at.x), px(at.y), px(angle.to_degrees()));
    html! {
        ellipse rx=(px(semi[0])) ry=(px(semi[1])) transform=(turn) fill="none" stroke=(colour)
            stroke-dasharray=[dashed.then_some("8 6")] { title { (title) } }
    }
}

/// The marker of the results that this detection became.
fn known(d: &Detection, markers: &[MarkerRecord]) -> (String, &'static str) {
    let distance = |m: &MarkerRecord| {
        let at = vector![m.u_px?, m.v_px?];
        Some((at - d.centre_px).norm()).filter(|v| v.is_finite())
    };
    let nearest = markers.iter().filter_map(|m| Some((distance(m)?, m))).min_by(|a, b| a.0.total_cmp(&b.0));
    // The perspective bias moves a centre by less than a pixel or two, never by a marker's size.
    match nearest.filter(|(away, _)| *away < 3.0_f64.max(0.1 * d.semi_minor_px)) {
        Some((_, m)) if m.used => (m.id.clone(), USED),
        Some((_, m)) => (m.id.clone(), UNUSED),
        None => (d.shape.name().to_owned(), UNKNOWN),
    }
}

fn names(found: &Detections, markers: &[MarkerRecord], width: f64, height: f64) -> Markup {
    let letter = width / 75.0;
    let mut labels = Labels::new(Area([0.0, 0.0, width, height]));
    for d in &found.markers {
        let half = extent(d.semi_major_px, d.semi_minor_px, d.angle_rad);
        let (low, high) = (d.centre_px - half, d.centre_px + half);
        labels.occupy(Area([low.x, low.y, high.x, high.y]));
    }
    html! {
        @for d in &found.markers {
            @let (text, colour) = known(d, markers);
            @let half = extent(d.semi_major_px, d.semi_minor_px, d.angle_rad);
            @let size = vector![text.chars().count() as f64 * letter * 0.66 + letter * 0.3, letter * 1.15];
            @if let Some(place) = labels.place(d.centre_px, half, size, letter * 0.4) {
                @let [from, to] = leader(d.centre_px, half, place, size);
                line x1=(px(from.x)) y1=(px(from.y)) x2=(px(to.x)) y2=(px(to.y)) stroke=(colour) {}
                rect x=(px(place.x)) y=(px(place.y)) width=(px(size.x)) height=(px(size.y)) fill="#10141c" fill-opacity="0.75" {}
                text x=(px(place.x + letter * 0.15)) y=(px(place.y + letter * 0.93)) fill=(colour) stroke="none" { (text) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_at_which_the_decoder_breaks_is_a_sentence() {
        let bytes = crate::pipeline::decode::BREAKS.to_vec();
        let frame = Picture { bytes, ..Picture::default() };
        assert!(picture(&frame, None).into_string().contains("decoder broke off"));
    }
}
