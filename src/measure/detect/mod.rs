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

use crate::detect::accept::{correlated, dirt, found::FoundMarkers, lost_contrast, misfit};
use crate::detect::detection::by_place;
use crate::detect::estimate::overshoot::Sharpening;
use crate::detect::image::{ellipse, noise};
use crate::detect::revise::neighbours::inflate_unlike;
use crate::detect::scope::Scope;
use crate::detect::search::{SearchProgress, SearchOptions, is_faint};
use crate::detect::segment::windows;
use crate::estimation::robust::median;
use crate::raster::Raster;
use crate::tiles::Tiles;

pub use detection::covariance::{Covariance, CovarianceSource};
pub use detection::{Detection, Detections, Overshoot, MarkerPrediction, RejectReason, Rejected};
pub use revise::orientation::{ExpectedMarker, UNSURE_PX2, second_pass};

/// Most rejected hypotheses that are reported, the largest.
const MAX_REJECTED: usize = 200;

/// Finds the markers of a frame without help. Deterministic at any number of threads.
pub fn detect(image: &Raster) -> Detections {
    detections(image, find(image, GuidedDetector::new(image).look(Scope::Frame)))
}

/// Finds the predicted markers, looking only around them: for each that is there the answer of
/// [`detect`]. Those that are not are missing.
pub fn detect_guided(image: &Raster, predictions: &[MarkerPrediction]) -> Detections {
    GuidedDetector::new(image).detect(image, predictions)
}

/// What is known of a frame that is looked at where markers are predicted, once or several times. Of the picture only what
/// [`tiles_read`] says need be there at each look.
pub struct GuidedDetector {
    noise: f64,
    sharpening: Sharpening,
}

impl GuidedDetector {
    /// At a frame in which nothing has been found.
    pub fn new(image: &Raster) -> Self {
        Self { noise: noise::estimate(image), sharpening: Sharpening::Undetermined }
    }

    /// At one in which something has been found.
    pub fn again(found: &Detections) -> Self {
        let sharpening = found.overshoot.map_or(Sharpening::Absent, Sharpening::Sharpened);
        Self { noise: found.noise, sharpening }
    }

    /// The predicted markers, as [`detect_guided`] finds them.
    pub fn detect(&self, image: &Raster, predictions: &[MarkerPrediction]) -> Detections {
        let mut all = find(image, self.look(Scope::Around(predictions)));
        scope::keep_predicted(&mut all.found, predictions);
        detections(image, all)
    }

    /// Those that show without effort, to some tenths of a pixel.
    pub fn detect_coarse(&mut self, image: &Raster, predictions: &[MarkerPrediction]) -> Vec<Detection> {
        let look = SearchOptions { rough: true, ..self.look(Scope::Around(predictions)) };
        let SearchResult { mut found, sharpening, .. } = find(image, look);
        self.sharpening = sharpening;
        scope::keep_predicted(&mut found, predictions);
        found.measured.into_iter().map(|m| m.detection).collect()
    }

    fn look<'p>(&self, scope: Scope<'p>) -> SearchOptions<'p> {
        SearchOptions { scope, noise: self.noise, sharpening: self.sharpening, rough: false }
    }
}

/// What is found, searched for at the usual levels and, where that is faint, at fainter ones: of what is predicted, what is
/// missing.
fn find(image: &Raster, look: SearchOptions) -> SearchResult {
    let smooth = |scope, from: f64| if look.noise > from { smoothed(image, scope) } else { None };
    let usual = smooth(look.scope, noise::FRAYING);
    let seen = usual.as_ref().unwrap_or(image);
    let mut progress = SearchProgress::new(image, seen, look);
    progress.search(seen, false);
    let missing = look.scope.missing(&progress.found.measured);
    let is_done = look.rough || missing.as_ref().is_some_and(Vec::is_empty);
    if !is_done && is_faint(&progress.found, windows::block_size(image.width(), image.height())) {
        let scope = missing.as_deref().map_or(look.scope, Scope::Around);
        let faint = if usual.is_none() { smooth(scope, noise::FRAYING_FAINT) } else { None };
        let seen = faint.as_ref().unwrap_or(seen);
        if missing.is_some() {
            progress = progress.within(seen, scope);
        }
        progress.search(seen, true);
    }
    let SearchProgress { mut found, look: SearchOptions { noise, sharpening, .. }, .. } = progress;
    inflate_unlike(&mut found);
    SearchResult { found, noise, sharpening }
}

/// A frame without most of its noise, of which only that is seen which is read.
fn smoothed(image: &Raster, scope: Scope) -> Option<Raster> {
    noise::smoothed(image, &scope.tiles(image.width(), image.height()))
}

/// What a search yields, with the frame's noise, grey levels, and how it was sharpened.
struct SearchResult {
    found: FoundMarkers,
    noise: f64,
    sharpening: Sharpening,
}

fn detections(image: &Raster, SearchResult { mut found, noise, sharpening }: SearchResult) -> Detections {
    let inflation = correlated::correlation_factor(&found.measured);
    let ellipses: Vec<ellipse::Ellipse> = found.measured.iter().map(|m| m.detection.ellipse()).collect();
    for measured in &mut found.measured {
        correlated::raise_for_correlation(measured, inflation);
        dirt::inflate_for_dirt(image, measured, &ellipses);
        misfit::inflate_for_misfit(image, measured, noise);
    }
    let lost_contrast_px = lost_contrast::inflate_for_lost_contrast(&mut found.measured);
    // Markers are larger than dirt.
    found.rejected.sort_by(|a, b| b.semi_major_px.total_cmp(&a.semi_major_px));
    found.rejected.truncate(MAX_REJECTED);
    found.rejected.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    let psf_sigma_px = median(found.measured.iter().map(|m| m.blur).collect());
    let mut markers: Vec<Detection> = found.measured.into_iter().map(|m| m.detection).collect();
    markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    let overshoot = sharpening.overshoot();
    Detections {
        markers,
        rejected: found.rejected,
        psf_sigma_px,
        noise,
        inflation,
        lost_contrast_px,
        overshoot,
    }
}

/// What of a frame of `width` x `height` px [`detect_guided`] reads: what lies elsewhere need not be decoded.
pub fn tiles_read(predictions: &[MarkerPrediction], width: usize, height: usize) -> Tiles {
    Scope::Around(predictions).tiles_read(width, height)
}

/// Whether all of the predicted markers that the earlier frame showed are there; without any, no answer is complete.
pub fn is_complete(found: &Detections, predictions: &[MarkerPrediction]) -> bool {
    let there = scope::matched(&found.markers.iter().collect::<Vec<_>>(), predictions).1;
    predictions.iter().any(|p| p.seen) && predictions.iter().zip(there).all(|(p, there)| there || !p.seen)
}

/// The predicted markers; where one that the earlier frame showed is not found, all that the whole frame shows. A marker
/// that nobody expects is only seen by [`detect`].
pub fn detect_guided_or_full(image: &Raster, predictions: &[MarkerPrediction]) -> Detections {
    let found = detect_guided(image, predictions);
    if is_complete(&found, predictions) { found } else { detect(image) }
}
