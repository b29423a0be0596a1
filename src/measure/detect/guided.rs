//! Detection in windows around predicted markers.

use nalgebra::Vector2;

use super::super::raster::Raster;
use super::candidate::Outline;
use super::{Detections, Prediction, Rejected, by_place, search};

/// Windows start at multiples of this, so that their blocks and the choice of their pixels are those
/// of the whole frame.
const GRID: usize = 8;
/// Skin around a marker that the background needs, px.
const SKIRT: f64 = 48.0;

/// A part of the frame: first and last column and row, the last excluded.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Window {
    x0: usize,
    y0: usize,
    x1: usize,
    y1: usize,
}

/// Markers in the windows of the predictions, each once.
pub fn detect(image: &Raster, predictions: &[Prediction], factor: usize, noise: f64) -> Detections {
    let mut out = Detections { noise, ..Detections::default() };
    let mut blurs = Vec::new();
    for prediction in predictions {
        let Some((window, part)) = cut(image, prediction) else { continue };
        let shift = Vector2::new(window.x0 as f64, window.y0 as f64);
        let found = search(&part, factor, noise);
        for measured in found.measured {
            let mut marker = measured.detection;
            marker.centre_px += shift;
            let expected = marker.shape == prediction.shape
                && (marker.centre_px - prediction.centre_px).norm() <= prediction.search_px;
            let known = out.markers.iter().any(|m| (m.centre_px - marker.centre_px).norm() < 1.0);
            if expected && !known {
                blurs.push(measured.blur);
                out.markers.push(marker);
            }
        }
        let near = |r: &Rejected| (r.centre_px - prediction.centre_px).norm() <= prediction.search_px;
        let shifted = found.rejected.into_iter().map(|r| Rejected { centre_px: r.centre_px + shift, ..r });
        out.rejected.extend(shifted.filter(near));
    }
    out.markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    out.rejected.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    out.rejected.dedup();
    out.psf_sigma_px = super::middle(blurs);
    out
}

/// The window of a prediction and its pixels; `None` where it lies outside.
fn cut(image: &Raster, prediction: &Prediction) -> Option<(Window, Raster)> {
    let outline = Outline {
        centre: prediction.centre_px,
        major: prediction.semi_major_px.clamp(1.0, 2000.0),
        minor: prediction.semi_minor_px.clamp(1.0, 2000.0),
        angle: prediction.angle_rad,
    };
    let reach = outline.extent().add_scalar(prediction.search_px.clamp(0.0, 500.0) + SKIRT);
    let (low, high) = (outline.centre - reach, outline.centre + reach);
    if !low.iter().chain(high.iter()).all(|v| v.is_finite()) {
        return None;
    }
    let window = Window {
        x0: low.x.max(0.0) as usize / GRID * GRID,
        y0: low.y.max(0.0) as usize / GRID * GRID,
        x1: (high.x.max(0.0) as usize).div_ceil(GRID).saturating_mul(GRID).min(image.width()),
        y1: (high.y.max(0.0) as usize).div_ceil(GRID).saturating_mul(GRID).min(image.height()),
    };
    if window.x0 >= window.x1 || window.y0 >= window.y1 {
        return None;
    }
    let rows = (window.y0..window.y1).filter_map(|y| image.row(y).get(window.x0..window.x1));
    let luma: Vec<u8> = rows.flatten().copied().collect();
    Some((window, Raster::new(window.x1 - window.x0, window.y1 - window.y0, luma)?))
}
