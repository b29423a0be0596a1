//! Overlay of the detections on a frame: outlines, ids, error ellipses and rejected candidates.

mod canvas;
mod font;

use std::collections::BTreeMap;

use image::{Rgb, RgbImage};
use nalgebra::{Matrix2, Vector2, vector};

use super::labels::{LabelArea, LabelLayout, leader_line};
use crate::number::count_text;
use canvas::Canvas;
use wingd_measure::detect::{Detection, Detections, Rejected};
use wingd_measure::raster::Raster;
use wingd_measure::setup::Shape;

const IDENTIFIED_COLOUR: Rgb<u8> = Rgb([70, 235, 110]);
const UNIDENTIFIED_COLOUR: Rgb<u8> = Rgb([80, 200, 255]);
const ERROR_COLOUR: Rgb<u8> = Rgb([255, 80, 200]);
const REJECTED_COLOUR: Rgb<u8> = Rgb([255, 165, 40]);
const TEXT_COLOUR: Rgb<u8> = Rgb([235, 235, 235]);
/// Approximate size of a typical error ellipse, px per unit of the canvas scale.
const ERROR_SIZE: f64 = 10.0;
/// Maximum number of rejected candidates labelled with their reasons; the legend counts all.
const MAX_LABELLED_REJECTED: usize = 150;

/// Maximum width and height of the image, px: about 2 MB as PNG with markers drawn on it.
const MAX_SIDE_PX: usize = 2000;

/// Draws the detections on a copy of the frame of at most [`MAX_SIDE_PX`] px in width and height. `ids` are in the order of
/// the markers and may be shorter or empty. Rejected candidates are counted, and drawn if `rejected`.
pub fn draw_overlay(
    frame: &Raster,
    found: &Detections,
    ids: &[Option<String>],
    rejected: bool,
) -> RgbImage {
    let smaller = reduce_frame(frame, found);
    let (frame, found) = smaller
        .as_ref()
        .map_or((frame, found), |(frame, found)| (frame, found));
    let mut canvas = Canvas::new(frame);
    let enlarged = ellipse_enlargement(&found.markers, ERROR_SIZE * canvas.scale as f64);
    let (width, height) = canvas.size();
    let mut labels = LabelLayout::new(LabelArea([0.0, 0.0, width, height]));
    labels.occupy(draw_legend(&mut canvas, found, enlarged));
    for (i, marker) in found.markers.iter().enumerate() {
        let id = ids.get(i).and_then(Option::as_deref);
        labels.occupy(draw_marker(&mut canvas, marker, id, enlarged));
    }
    for rejected in found.rejected.iter().filter(|_| rejected) {
        let semi = [
            rejected.semi_major_px.max(3.0),
            rejected.semi_minor_px.max(3.0),
        ];
        canvas.ellipse(
            rejected.centre_px,
            semi,
            rejected.angle_rad,
            REJECTED_COLOUR,
        );
    }
    for (i, marker) in found.markers.iter().enumerate() {
        let known = ids.get(i).and_then(Option::as_deref);
        let text = known.unwrap_or(marker.shape.name());
        let colour = if known.is_some() {
            IDENTIFIED_COLOUR
        } else {
            UNIDENTIFIED_COLOUR
        };
        draw_label(
            &mut canvas,
            &mut labels,
            marker.centre_px,
            marker_extent(marker),
            text,
            colour,
        );
    }
    for r in found
        .rejected
        .iter()
        .filter(|_| rejected)
        .take(MAX_LABELLED_REJECTED)
    {
        let text = r.reason.text();
        draw_label(
            &mut canvas,
            &mut labels,
            r.centre_px,
            rejected_extent(r),
            text,
            REJECTED_COLOUR,
        );
    }
    canvas.finish()
}

/// Reduces frame and detections in size, each pixel the mean of a square; `None` if the frame is small enough.
fn reduce_frame(frame: &Raster, found: &Detections) -> Option<(Raster, Detections)> {
    let side = frame.width().max(frame.height()).div_ceil(MAX_SIDE_PX);
    let (width, height) = (frame.width() / side.max(1), frame.height() / side.max(1));
    let mean = |x: usize, y: usize| {
        let rows =
            (0..side).filter_map(|dy| frame.row(side * y + dy).get(side * x..side * (x + 1)));
        let sum: usize = rows.flatten().map(|grey| usize::from(*grey)).sum();
        // Steps of 4 grey levels are invisible, and noise below them accounts for most of the file size.
        ((sum / (side * side)) as u8) & GREY_MASK
    };
    let pixels = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| mean(x, y))
        .collect();
    let small = (side > 1)
        .then(|| Raster::new(width, height, pixels))
        .flatten()?;
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

/// Bits of a grey value kept in a reduced image.
const GREY_MASK: u8 = 0b1111_1100;

fn draw_marker(canvas: &mut Canvas, m: &Detection, id: Option<&str>, enlarged: f64) -> LabelArea {
    let colour = if id.is_some() {
        IDENTIFIED_COLOUR
    } else {
        UNIDENTIFIED_COLOUR
    };
    if m.shape != Shape::Point {
        canvas.ellipse(
            m.centre_px,
            [m.semi_major_px, m.semi_minor_px],
            m.angle_rad,
            colour,
        );
    }
    canvas.cross(m.centre_px, 3.0 * canvas.scale as f64, colour);
    let (semi, angle) = principal_axes(&m.covariance_px2);
    canvas.ellipse(m.centre_px, semi.map(|s| s * enlarged), angle, ERROR_COLOUR);
    let half = marker_extent(m);
    LabelArea([
        m.centre_px.x - half.x,
        m.centre_px.y - half.y,
        m.centre_px.x + half.x,
        m.centre_px.y + half.y,
    ])
}

fn marker_extent(m: &Detection) -> Vector2<f64> {
    ellipse_extent(m.semi_major_px, m.semi_minor_px, m.angle_rad)
}

fn rejected_extent(r: &Rejected) -> Vector2<f64> {
    ellipse_extent(
        r.semi_major_px.max(3.0),
        r.semi_minor_px.max(3.0),
        r.angle_rad,
    )
}

/// Returns half width and half height of an ellipse's bounding box.
pub(super) fn ellipse_extent(major: f64, minor: f64, angle: f64) -> Vector2<f64> {
    let (sin, cos) = angle.sin_cos();
    vector![
        (major * cos).hypot(minor * sin),
        (major * sin).hypot(minor * cos)
    ]
}

/// Returns the standard deviations along the principal axes, larger first, and the direction of the larger.
pub(super) fn principal_axes(covariance: &Matrix2<f64>) -> ([f64; 2], f64) {
    let (a, b, c) = (covariance.m11, covariance.m12, covariance.m22);
    let (mean, half) = ((a + c) / 2.0, ((a - c) / 2.0).hypot(b));
    let sigma = |v: f64| v.max(0.0).sqrt();
    (
        [sigma(mean + half), sigma(mean - half)],
        0.5 * (2.0 * b).atan2(a - c),
    )
}

/// Returns 1, 2 or 5 times a power of ten for which the median error ellipse comes close to `target_px`.
pub(super) fn ellipse_enlargement(markers: &[Detection], target_px: f64) -> f64 {
    let mut sigmas: Vec<f64> = markers
        .iter()
        .map(|m| principal_axes(&m.covariance_px2).0[0])
        .collect();
    sigmas.retain(|s| s.is_finite() && *s > 0.0);
    sigmas.sort_by(f64::total_cmp);
    let Some(median) = sigmas.get(sigmas.len() / 2) else {
        return 1.0;
    };
    let ratio = target_px / median;
    let decade = 10f64.powf(ratio.log10().floor());
    [5.0, 2.0, 1.0]
        .into_iter()
        .find(|f| f * decade <= ratio)
        .unwrap_or(1.0)
        * decade
}

fn draw_legend(canvas: &mut Canvas, found: &Detections, enlarged: f64) -> LabelArea {
    let mut lines = vec![(count_text(found.markers.len(), "marker"), TEXT_COLOUR)];
    if !found.markers.is_empty() {
        lines.push((
            format!("error ellipses 1 sigma, enlarged {enlarged:.0} times"),
            ERROR_COLOUR,
        ));
    }
    lines.push((
        format!("{} rejected", count_text(found.rejected.len(), "candidate")),
        REJECTED_COLOUR,
    ));
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for r in &found.rejected {
        *counts.entry(r.reason.text()).or_default() += 1;
    }
    lines.extend(
        counts
            .iter()
            .map(|(reason, n)| (format!("  {n} {reason}"), REJECTED_COLOUR)),
    );
    let (mut right, mut y) = (0.0_f64, 4.0 * canvas.scale as f64);
    let x = y;
    for (text, colour) in lines {
        canvas.text(x, y, &text, colour);
        let [_, _, r, bottom] = canvas.text_area(x, y, &text).0;
        (right, y) = (right.max(r), bottom);
    }
    LabelArea([0.0, 0.0, right, y])
}

/// Draws a text next to an outline without overlap; omits it if there is no room.
fn draw_label(
    canvas: &mut Canvas,
    labels: &mut LabelLayout,
    at: Vector2<f64>,
    half: Vector2<f64>,
    text: &str,
    colour: Rgb<u8>,
) {
    let [_, _, w, h] = canvas.text_area(0.0, 0.0, text).0;
    let Some(place) = labels.place(at, half, vector![w, h], 3.0 * canvas.scale as f64) else {
        return;
    };
    let [from, to] = leader_line(at, half, place, vector![w, h]);
    canvas.line(from, to, colour);
    canvas.text(place.x, place.y, text, colour);
}

#[cfg(test)]
mod tests {
    use super::*;
    use wingd_measure::detect::RejectReason;

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
            marker: None,
        }
    }

    fn coloured(picture: &RgbImage, colour: Rgb<u8>) -> Vec<(u32, u32)> {
        picture
            .enumerate_pixels()
            .filter(|p| *p.2 == colour)
            .map(|p| (p.0, p.1))
            .collect()
    }

    #[test]
    fn the_outline_is_drawn_at_the_marker() {
        let frame = Raster::new(1200, 800, vec![128; 1200 * 800]).unwrap();
        let found = Detections {
            markers: vec![marker(700.0, 500.0)],
            ..Detections::default()
        };
        let picture = draw_overlay(&frame, &found, &[Some("M07".to_owned())], false);
        let end = vector![700.0 + 60.0 * 0.2_f64.cos(), 500.0 + 60.0 * 0.2_f64.sin()];
        let near = |p: &(u32, u32)| (vector![f64::from(p.0), f64::from(p.1)] - end).norm() < 1.5;
        assert!(coloured(&picture, IDENTIFIED_COLOUR).iter().any(near));
        assert!(coloured(&picture, UNIDENTIFIED_COLOUR).is_empty());
        // sigma 0.1 px enlarged 100 times reaches 10 px to either side.
        let error = coloured(&picture, ERROR_COLOUR);
        let reach = error
            .iter()
            .filter(|p| p.1 > 300)
            .map(|p| p.0)
            .max()
            .unwrap();
        assert_eq!(reach, 710);
    }

    #[test]
    fn rejected_candidates_have_their_own_colour() {
        let frame = Raster::new(1200, 800, vec![128; 1200 * 800]).unwrap();
        let rejected = Rejected {
            centre_px: vector![400.0, 600.0],
            semi_major_px: 30.0,
            semi_minor_px: 10.0,
            angle_rad: 0.0,
            reason: RejectReason::PoorFit,
        };
        let found = Detections {
            rejected: vec![rejected],
            ..Detections::default()
        };
        let drawn = coloured(&draw_overlay(&frame, &found, &[], true), REJECTED_COLOUR);
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
            let found = Detections {
                markers: vec![odd, far, wide],
                ..Detections::default()
            };
            assert_eq!(
                draw_overlay(&frame, &found, &[None], true).dimensions(),
                (w as u32, h as u32)
            );
        }
    }
}
