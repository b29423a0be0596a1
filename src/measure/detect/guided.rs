//! Detection around predicted markers: no search, but the same fit on the same pixels.

use nalgebra::Vector2;

use super::super::raster::Raster;
use super::super::setup::Shape;
use super::blob::{self, Blob};
use super::candidate::{self, Candidate, Outline};
use super::counts::Counts;
use super::measure::{Bounds, Measured, measure};
use super::whole::cut_by;
use super::{Detection, Detections, Prediction, by_place, keep_largest};

/// How much a marker may differ from its prediction: axes, as a ratio, and beside that the minor, px.
const ALIKE: f64 = 1.3;
const ALIKE_PX: f64 = 1.0;
/// Skin around a marker that tells its grey level, px.
const SKIRT: f64 = 12.0;
/// Pixels that tell the grey levels.
const SAMPLES: usize = 4096;
/// Most blobs of a window that are looked at.
const MAX_BLOBS: usize = 40;

/// The predicted markers that are there, each once.
pub fn detect(image: &Raster, predictions: &[Prediction], noise: f64) -> Detections {
    let mut found: Vec<Measured> = Vec::new();
    for prediction in predictions {
        let Some(measured) = find(image, prediction, noise) else { continue };
        let centre = measured.detection.centre_px;
        let near = (centre - prediction.centre_px).norm() <= prediction.search_px;
        if near && !found.iter().any(|m| (m.detection.centre_px - centre).norm() < 1.0) {
            found.push(measured);
        }
    }
    super::clumped::raise(&mut found);
    let psf_sigma_px = super::middle(found.iter().map(|m| m.blur).collect());
    let mut markers: Vec<Detection> = found.into_iter().map(|m| m.detection).collect();
    markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    Detections { markers, psf_sigma_px, noise, ..Detections::default() }
}

/// The marker of one prediction.
fn find(image: &Raster, prediction: &Prediction, noise: f64) -> Option<Measured> {
    let outline = Outline {
        centre: prediction.centre_px,
        major: prediction.semi_major_px,
        minor: prediction.semi_minor_px,
        angle: prediction.angle_rad,
    };
    let numbers = [outline.centre.x, outline.centre.y, outline.angle, prediction.search_px];
    let sound = numbers.iter().all(|v| v.is_finite())
        && (1.0..2000.0).contains(&outline.major)
        && (0.5..2000.0).contains(&outline.minor);
    if !sound {
        return None;
    }
    let reach = outline.extent() * 1.1;
    let reach = reach.add_scalar(prediction.search_px.clamp(0.0, 500.0) + SKIRT);
    let (low, high) = (outline.centre - reach, outline.centre + reach);
    let mut blobs = blob::darker_than(image, low, high, level(image, low, high, &outline)?);
    // A quadrant is a quarter of its marker.
    let whole = std::f64::consts::PI * outline.major * outline.minor;
    blobs.retain(|b| (0.1 * whole..1.7 * whole + 20.0).contains(&b.area));
    keep_largest(&mut blobs, MAX_BLOBS, |b| b.area);
    let candidates = match prediction.shape {
        Shape::Circle => discs(&blobs),
        Shape::Quadrant => super::quadrants(&blobs),
    };
    let off = |c: &Candidate| (c.outline.centre - outline.centre).norm();
    let alike =
        candidates.into_iter().filter(|c| is_alike(&c.outline, &outline) && off(c) <= prediction.search_px);
    let best = alike.min_by(|a, b| off(a).total_cmp(&off(b)))?;
    measure(image, &blobs, &best, Bounds::of(noise)).ok()
}

/// Discs of which clearly nothing is hidden: what may be in doubt is for the full search.
fn discs(blobs: &[Blob]) -> Vec<Candidate> {
    let clear = |(i, b): (usize, &Blob)| candidate::disc(i, b).filter(|_| !b.at_edge && cut_by(b) < 0.8);
    blobs.iter().enumerate().filter_map(clear).collect()
}

fn is_alike(one: &Outline, other: &Outline) -> bool {
    let within = |a: f64, b: f64, px: f64| a < b * ALIKE + px && b < a * ALIKE + px;
    within(one.major, other.major, ALIKE_PX) && within(one.minor, other.minor, ALIKE_PX)
}

/// Half way between the grey levels of the marker and of what surrounds it.
fn level(image: &Raster, low: Vector2<f64>, high: Vector2<f64>, outline: &Outline) -> Option<u8> {
    let (x0, y0) = (low.x.max(0.0) as usize, low.y.max(0.0) as usize);
    let x1 = (high.x.max(0.0) as usize).min(image.width());
    let y1 = (high.y.max(0.0) as usize).min(image.height());
    if x0 >= x1 || y0 >= y1 {
        return None;
    }
    let step = ((x1 - x0) * (y1 - y0)).div_ceil(SAMPLES);
    // A step along rows that is no divisor of theirs would leave out columns.
    let (across, down) = if step < 4 { (1, step) } else { (2, step.div_ceil(2)) };
    let row = |y: usize| image.row(y)[x0..x1].iter().step_by(across).copied();
    let counts = Counts::of((y0..y1).step_by(down).flat_map(row));
    // A quarter of a quadrants' half.
    let dark = 0.125 * std::f64::consts::PI * outline.major * outline.minor / (across * down) as f64;
    let (black, skin) = (counts.at(dark as usize)?, counts.middle()?);
    (skin > black + 10).then(|| (black + skin).div_ceil(2) as u8)
}
