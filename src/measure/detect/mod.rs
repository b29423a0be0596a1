//! Markers are found in the grey values of one frame: quadrant targets and flat discs, each with the covariance of its place.
//! Neither camera nor wing is known here. The result is the same for any number of threads, and bit for bit on any processor.
//!
//! The stages, each of which uses only those before it (`tests/layers.rs`); `docs/detection.md` says what they do and why:
//!
//! - `numbers`, `simd`, `image`: how tuned numbers are written, loops in wide registers, geometry and noise of the picture;
//! - `detection`: what is asked and answered; `appearance`: what a blurred marker looks like;
//! - `segment`: dark regions and their blobs; `occlusion`: what may hide a part of a marker;
//! - `hypothesis`: what may be a marker, with what is known beforehand; `sample`: its pixels; `estimate`: the fit to them;
//! - `propose`: from blobs to hypotheses; `accept`: whether a fit is a marker; `attempt`: the ways to measure a hypothesis;
//! - `revise`: measured once more with what neighbours or orientation tell; `scope`, `search`: where, and in which order.
//!
//! ```
//! use wingd_measure::{detect::detect, raster::Raster};
//!
//! // A black disc on skin, seen at a slant; a lens blurs it, so that a pixel takes the mean of what is near.
//! let is_black = |x: f64, y: f64| ((x - 100.3) / 30.0).powi(2) + ((y - 60.2) / 10.0).powi(2) < 1.0;
//! let near = || (0..64).map(|k| [k % 8, k / 8].map(|v| (f64::from(v) - 3.5) / 4.0));
//! let lit = |x: u32, y: u32| near().filter(|[u, v]| !is_black(f64::from(x) + u, f64::from(y) + v)).count();
//! let luma = (0..200 * 120).map(|i| 40 + 2 * lit(i % 200, i / 200) as u8).collect();
//! let frame = Raster::new(200, 120, luma).expect("a value for each pixel");
//!
//! let found = detect(&frame);
//! let disc = &found.markers[0];
//! assert!((disc.centre_px.x - 100.3).abs() < 0.1 && (disc.centre_px.y - 60.2).abs() < 0.1);
//! for (source, own) in disc.covariance_px2.contributions() {
//!     println!("{source:?}: {:.4} px along u", own[(0, 0)].max(0.0).sqrt());
//! }
//! ```

#[macro_use]
mod numbers;

mod accept;
mod appearance;
mod attempt;
mod detection;
mod estimate;
mod hypothesis;
mod image;
mod occlusion;
mod propose;
mod revise;
mod sample;
mod scope;
mod search;
mod segment;
mod simd;

use std::ops::Range;

use crate::detect::accept::{consistency, correlated, dirt, found::Found};
use crate::detect::detection::by_place;
use crate::detect::image::{ellipse, noise};
use crate::detect::revise::neighbours::inflate_unlike;
use crate::detect::scope::Scope;
use crate::detect::search::{Progress, is_faint};
use crate::detect::segment::background;
use crate::estimation::robust::median;
use crate::raster::Raster;

pub use detection::covariance::{Covariance, Source};
pub use detection::{Detection, Detections, Overshoot, Prediction, RejectReason, Rejected};
pub use revise::orientation::{Expected, UNSURE_PX2, look_closer};

/// Most rejected hypotheses that are reported, the largest.
const MAX_REJECTED: usize = 200;

/// Finds the markers of a frame without help. Deterministic at any number of threads.
pub fn detect(image: &Raster) -> Detections {
    detections(image, find(image, Scope::Frame))
}

/// Finds the predicted markers, looking only around them: for each that is there the answer of
/// [`detect`]. Those that are not are missing.
pub fn detect_guided(image: &Raster, predictions: &[Prediction]) -> Detections {
    let mut all = find(image, Scope::Around(predictions));
    scope::keep_predicted(&mut all.found, predictions);
    detections(image, all)
}

/// What a search yields, with the frame's noise, grey levels, and how it was sharpened.
struct All {
    found: Found,
    noise: f64,
    overshoot: Option<Overshoot>,
}

/// What is found, searched for at the usual levels and, where that is faint, at fainter ones.
fn find(image: &Raster, scope: Scope) -> All {
    let noise = noise::estimate(image);
    let smooth = |from: f64| if noise > from { smoothed(image, scope) } else { None };
    let usual = smooth(noise::FRAYING);
    let seen = usual.as_ref().unwrap_or(image);
    let mut progress = Progress::new(image, seen, scope, noise);
    let mut look = |seen: &Raster, faint: bool| {
        if !progress.search(seen, faint) {
            return false;
        }
        consistency::without_blur_outliers(&mut progress.found);
        consistency::without_orientation_outliers(&mut progress.found);
        consistency::without_size_outliers(&mut progress.found);
        let factor = background::factor(image.width(), image.height());
        !faint && !scope.is_done(&progress.found.measured) && is_faint(&progress.found, factor)
    };
    if look(seen, false) {
        let faint = if usual.is_none() { smooth(noise::FRAYING_FAINT) } else { None };
        look(faint.as_ref().unwrap_or(seen), true);
    }
    let Progress { mut found, overshoot, .. } = progress;
    inflate_unlike(&mut found);
    All { found, noise, overshoot }
}

/// A frame without most of its noise, of which only that is seen which is read.
fn smoothed(image: &Raster, scope: Scope) -> Option<Raster> {
    noise::smoothed(image, &scope.columns(image.width(), image.height()))
}

fn detections(image: &Raster, All { mut found, noise, overshoot }: All) -> Detections {
    let inflation = correlated::factor(&found.measured);
    let ellipses: Vec<ellipse::Ellipse> = found.measured.iter().map(|m| m.detection.ellipse()).collect();
    for measured in &mut found.measured {
        correlated::raise(measured, inflation);
        dirt::inflate(image, measured, &ellipses);
    }
    // Markers are larger than dirt.
    found.rejected.sort_by(|a, b| b.semi_major_px.total_cmp(&a.semi_major_px));
    found.rejected.truncate(MAX_REJECTED);
    found.rejected.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    let psf_sigma_px = median(found.measured.iter().map(|m| m.blur).collect());
    let mut markers: Vec<Detection> = found.measured.into_iter().map(|m| m.detection).collect();
    markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    Detections { markers, rejected: found.rejected, psf_sigma_px, noise, inflation, overshoot }
}

/// Of each pixel row of a frame of `width` x `height` px the columns that [`detect_guided`] reads: what lies elsewhere
/// need not be decoded.
pub fn columns_read(predictions: &[Prediction], width: usize, height: usize) -> Vec<Range<usize>> {
    Scope::Around(predictions).columns(width, height)
}

/// Whether all of the predicted markers that the earlier frame showed are there; without any, no answer is complete.
pub fn is_complete(found: &Detections, predictions: &[Prediction]) -> bool {
    let there = scope::matched(&found.markers.iter().collect::<Vec<_>>(), predictions).1;
    predictions.iter().any(|p| p.seen) && predictions.iter().zip(there).all(|(p, there)| there || !p.seen)
}

/// The predicted markers; where one that the earlier frame showed is not found, all that the whole frame shows. A marker
/// that nobody expects is only seen by [`detect`].
pub fn detect_guided_or_full(image: &Raster, predictions: &[Prediction]) -> Detections {
    let found = detect_guided(image, predictions);
    if is_complete(&found, predictions) { found } else { detect(image) }
}
