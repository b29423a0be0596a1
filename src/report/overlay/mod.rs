//! A frame is drawn with what was found in it: outlines, ids, error ellipses and candidates turned down.

mod canvas;
mod font;

use std::collections::BTreeMap;

use image::{Rgb, RgbImage};
use nalgebra::{Matrix2, Vector2, vector};

use super::labels::{Area, Labels, leader};
use super::number::count;
use crate::measure::detect::{Detection, Detections, Rejected};
use crate::measure::raster::Raster;
use canvas::Canvas;

const KNOWN: Rgb<u8> = Rgb([70, 235, 110]);
const UNKNOWN: Rgb<u8> = Rgb([80, 200, 255]);
const ERROR: Rgb<u8> = Rgb([255, 80, 200]);
const TURNED_DOWN: Rgb<u8> = Rgb([255, 165, 40]);
const PLAIN: Rgb<u8> = Rgb([235, 235, 235]);
/// A typical error ellipse is drawn about this large, px per unit of the canvas' scale.
const ERROR_SIZE: f64 = 10.0;
/// With more candidates turned down than this only some fit their reasons; the legend counts them.
const MANY: usize = 150;

/// Longest side of the picture, px: with markers drawn on it some 2 MB as PNG.
const MAX_SIDE_PX: usize = 2000;

/// Draws on a copy of the frame that is at most [`LONGEST`] px wide and high. `ids` in the order of the markers; may be
/// shorter or empty. Candidates turned down are counted, and with `rejected` drawn, too.
pub fn overlay(frame: &Raster, found: &Detections, ids: &[Option<String>], rejected: bool) -> RgbImage {
    let smaller = reduced(frame, found);
    let (frame, found) = smaller.as_ref().map_or((frame, found), |(frame, found)| (frame, found));
    let mut canvas = Canvas::new(frame);
    let enlarged = enlargement(&found.markers, ERROR_SIZE * canvas.scale as f64);
    let (width, height) = canvas.size();
    let mut labels = Labels::new(Area([0.0, 0.0, width, height]));
    labels.occupy(legend(&mut canvas, found, enlarged));
    for (i, marker) in found.markers.iter().enumerate() {
        let id = ids.get(i).and_then(Option::as_deref);
        labels.occupy(draw_marker(&mut canvas, marker, id, enlarged));
    }
    for rejected in found.rejected.iter().filter(|_| rejected) {
        let semi = [rejected.semi_major_px.max(3.0), rejected.semi_minor_px.max(3.0)];
        canvas.ellipse(rejected.centre_px, semi, rejected.angle_rad, TURNED_DOWN);
    }
    for (i, marker) in found.markers.iter().enumerate() {
        let known = ids.get(i).and_then(Option::as_deref);
        let text = known.unwrap_or(marker.shape.name());
        let colour = if known.is_some() { KNOWN } else { UNKNOWN };
        label(&mut canvas, &mut labels, marker.centre_px, reach(marker), text, colour);
    }
    for r in found.rejected.iter().filter(|_| rejected).take(MANY) {
        let text = r.reason.text();
        label(&mut canvas, &mut labels, r.centre_px, rejected_reach(r), text, TURNED_DOWN);
    }
    canvas.finish()
}

/// Frame and detections on fewer pixels, each the mean of a square; `None` where the frame is small enough.
fn reduced(frame: &Raster, found: &Detections) -> Option<(Raster, Detections)> {
    let side = frame.width().max(frame.height()).div_ceil(MAX_SIDE_PX);
    let (width, height) = (frame.width() / side.max(1), frame.height() / side.max(1));
    let mean = |x: usize, y: usize| {
        let rows = (0..side).filter_map(|dy| frame.row(side * y + dy).get(side * x..side * (x + 1)));
        let sum: usize = rows.flatten().map(|grey| usize::from(*grey)).sum();
        // The eye sees no step of four grey levels, and noise below it costs most of a file.
        ((sum / (side * side)) as u8) & GREY
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| mean(x, y)).collect();
    let small = (side > 1).then(|| Raster::new(width, height, pixels)).flatten()?;
    let by = 1.0 / side as f64;
    let place = |p: Vector2<f64>| p.map(|v| (v + 0.5) * by - 0.5);
    let mut found = found.clone();
    for m in &mut found.markers {
        m.centre_px = place(m.centre_px);
        m.covariance_px2 = (*m.covariance_px2 * (by * by)).into();
        (m.semi_major_px, m.semi_minor_px) = (m.semi_major_px * by, m.semi_minor_px * by);
    }
    for r in &mut found.rejected {
        r.centre_px = place(r.centre_px);
        (r.semi_major_px, r.semi_minor_px) = (r.semi_major_px * by, r.semi_minor_px * by);
    }
    Some((small, found))
}

/// Bits of a grey value that are kept in a reduced picture.
const GREY: u8 = 0b1111_1100;

fn draw_marker(canvas: &mut Canvas, m: &Detection, id: Option<&str>, enlarged: f64) -> Area {
    let colour = if id.is_some() { KNOWN } else { UNKNOWN };
    canvas.ellipse(m.centre_px, [m.semi_major_px, m.semi_minor_px], m.angle_rad, colour);
    canvas.cross(m.centre_px, 3.0 * canvas.scale as f64, colour);
    let (semi, angle) = principal(&m.covariance_px2);
    canvas.ellipse(m.centre_px, semi.map(|s| s * enlarged), angle, ERROR);
    let half = reach(m);
    Area([m.centre_px.x - half.x, m.centre_px.y - half.y, m.centre_px.x + half.x, m.centre_px.y + half.y])
}

fn reach(m: &Detection) -> Vector2<f64> {
    extent(m.semi_major_px, m.semi_minor_px, m.angle_rad)
}

fn rejected_reach(r: &Rejected) -> Vector2<f64> {
    extent(r.semi_major_px.max(3.0), r.semi_minor_px.max(3.0), r.angle_rad)
}

/// Half width and half height of an ellipse's bounding box.
pub(super) fn extent(major: f64, minor: f64, angle: f64) -> Vector2<f64> {
    let (sin, cos) = angle.sin_cos();
    vector![(major * cos).hypot(minor * sin), (major * sin).hypot(minor * cos)]
}

/// Standard deviations along the principal axes, larger first, and the direction of the larger.
pub(super) fn principal(covariance: &Matrix2<f64>) -> ([f64; 2], f64) {
    let (a, b, c) = (covariance.m11, covariance.m12, covariance.m22);
    let (mean, half) = ((a + c) / 2.0, ((a - c) / 2.0).hypot(b));
    let sigma = |v: f64| v.max(0.0).sqrt();
    ([sigma(mean + half), sigma(mean - half)], 0.5 * (2.0 * b).atan2(a - c))
}

/// 1, 2 or 5 times a power of ten, so that the median error ellipse comes near `wanted_px`.
pub(super) fn enlargement(markers: &[Detection], wanted_px: f64) -> f64 {
    let mut sigmas: Vec<f64> = markers.iter().map(|m| principal(&m.covariance_px2).0[0]).collect();
    sigmas.retain(|s| s.is_finite() && *s > 0.0);
    sigmas.sort_by(f64::total_cmp);
    let Some(median) = sigmas.get(sigmas.len() / 2) else {
        return 1.0;
    };
    let wanted = wanted_px / median;
    let decade = 10f64.powf(wanted.log10().floor());
    [5.0, 2.0, 1.0].into_iter().find(|f| f * decade <= wanted).unwrap_or(1.0) * decade
}

fn legend(canvas: &mut Canvas, found: &Detections, enlarged: f64) -> Area {
    let mut lines = vec![(count(found.markers.len(), "marker"), PLAIN)];
    if !found.markers.is_empty() {
        lines.push((format!("error ellipses 1 sigma, enlarged {enlarged:.0} times"), ERROR));
    }
    lines.push((format!("{} turned down", count(found.rejected.len(), "candidate")), TURNED_DOWN));
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for r in &found.rejected {
        *counts.entry(r.reason.text()).or_default() += 1;
    }
    lines.extend(counts.iter().map(|(reason, n)| (format!("  {n} {reason}"), TURNED_DOWN)));
    let (mut right, mut y) = (0.0_f64, 4.0 * canvas.scale as f64);
    let x = y;
    for (text, colour) in lines {
        canvas.text(x, y, &text, colour);
        let [_, _, r, bottom] = canvas.text_area(x, y, &text).0;
        (right, y) = (right.max(r), bottom);
    }
    Area([0.0, 0.0, right, y])
}

/// Puts a text beside an outline where nothing else is; leaves it out where there is no room.
fn label(
    canvas: &mut Canvas,
    labels: &mut Labels,
    at: Vector2<f64>,
    half: Vector2<f64>,
    text: &str,
    colour: Rgb<u8>,
) {
    let [_, _, w, h] = canvas.text_area(0.0, 0.0, text).0;
    let Some(place) = labels.place(at, half, vector![w, h], 3.0 * canvas.scale as f64) else { return };
    let [from, to] = leader(at, half, place, vector![w, h]);
    canvas.line(from, to, colour);
    canvas.text(place.x, place.y, text, colour);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::measure::detect::RejectReason;
    use crate::measure::setup::Shape;

    fn marker(x: f64, y: f64) -> Detection {
        Detection {
            shape: Shape::Circle,
            centre_px: vector![x, y],
            covariance_px2: Matrix2::new(0.01, 0.0, 0.0, 0.0004).into(),
            semi_major_px: 60.0,
            semi_minor_px: 12.0,
            angle_rad: 0.2,
            fit_rms: 1.0,
            contrast: 100.0,
        }
    }

    fn coloured(picture: &RgbImage, colour: Rgb<u8>) -> Vec<(u32, u32)> {
        picture.enumerate_pixels().filter(|p| *p.2 == colour).map(|p| (p.0, p.1)).collect()
    }

    #[test]
    fn the_outline_is_drawn_where_the_marker_is() {
        let frame = Raster::new(1200, 800, vec![128; 1200 * 800]).unwrap();
        let found = Detections { markers: vec![marker(700.0, 500.0)], ..Detections::default() };
        let picture = overlay(&frame, &found, &[Some("M07".to_owned())], false);
        let end = vector![700.0 + 60.0 * 0.2_f64.cos(), 500.0 + 60.0 * 0.2_f64.sin()];
        let near = |p: &(u32, u32)| (vector![f64::from(p.0), f64::from(p.1)] - end).norm() < 1.5;
        assert!(coloured(&picture, KNOWN).iter().any(near));
        assert!(coloured(&picture, UNKNOWN).is_empty());
        // sigma 0.1 px enlarged 100 times reaches 10 px to either side.
        let error = coloured(&picture, ERROR);
        let reach = error.iter().filter(|p| p.1 > 300).map(|p| p.0).max().unwrap();
        assert_eq!(reach, 710);
    }

    #[test]
    fn candidates_turned_down_have_their_own_colour() {
        let frame = Raster::new(1200, 800, vec![128; 1200 * 800]).unwrap();
        let rejected = Rejected {
            centre_px: vector![400.0, 600.0],
            semi_major_px: 30.0,
            semi_minor_px: 10.0,
            angle_rad: 0.0,
            reason: RejectReason::PoorFit,
        };
        let found = Detections { rejected: vec![rejected], ..Detections::default() };
        let drawn = coloured(&overlay(&frame, &found, &[], true), TURNED_DOWN);
        assert!(drawn.contains(&(430, 600)) && drawn.iter().any(|p| p.0 > 440));
    }

    #[test]
    fn nothing_outside_the_frame_or_not_finite_panics() {
        for (w, h) in [(1, 1), (3, 900), (64, 64)] {
            let frame = Raster::new(w, h, vec![7; w * h]).unwrap();
            let mut odd = marker(f64::NAN, 3.0);
            odd.covariance_px2 = Matrix2::repeat(f64::INFINITY).into();
            let far = marker(-5000.0, 1e9);
            let mut wide = marker(1.0, 1.0);
            wide.semi_major_px = 1e300;
            let found = Detections { markers: vec![odd, far, wide], ..Detections::default() };
            assert_eq!(overlay(&frame, &found, &[None], true).dimensions(), (w as u32, h as u32));
        }
    }
}
