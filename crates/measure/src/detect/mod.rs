//! Detection of markers in the grey values of one frame: quadrant targets and flat discs, with the covariance
//! of their positions.
//!
//! Neither camera nor wing is known here. The result does not depend on the number of threads, and is identical
//! bit for bit on any processor.
//!
//! Each stage uses only those before it (`tests/layers.rs`); `docs/detection.md` describes them:
//!
//! - `numbers`, `simd`, `image`: definition of tuned numbers, loops in wide registers, geometry and noise of
//!   the image;
//! - `detection`: input and output; `appearance`: the image of a blurred marker;
//! - `segment`: dark regions and their blobs; `occlusion`: objects that may hide a part of a marker;
//! - `hypothesis`: possible markers with priors; `sample`: their pixels; `estimate`: the fit to them;
//! - `propose`: hypotheses from blobs; `accept`: acceptance of fits; `attempt`: strategies to measure a hypothesis;
//! - `revise`: repeated measurement with priors from neighbours or orientation; `scope`, `search`: area and
//!   order of search.
//!
//! ```
//! use wingd_measure::{detect::detect, raster::Raster};
//!
//! // A black disc on skin, seen obliquely; a lens blurs it, so each pixel is the mean of its surroundings.
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
pub(crate) mod simd;

use crate::detect::accept::{correlated, dirt, found::FoundMarkers, lost_contrast, misfit};
use crate::detect::detection::compare_positions;
use crate::detect::estimate::overshoot::Sharpening;
use crate::detect::image::{ellipse, noise};
use crate::detect::revise::neighbours::inflate_length_outliers;
use crate::detect::scope::Scope;
use crate::detect::search::{SearchOptions, SearchProgress, is_faint};
use crate::detect::segment::windows;
use crate::estimation::robust::median;
use crate::ordering::sort_by_value;
use crate::raster::Raster;
use crate::tiles::Tiles;

pub use detection::covariance::{Covariance, CovarianceSource};
pub use detection::{Detection, Detections, MarkerPrediction, Overshoot, RejectReason, Rejected};
pub use revise::orientation::{ExpectedMarker, UNSURE_PX2, second_pass};

/// Largest number of rejected hypotheses that are reported, largest first.
const MAX_REJECTED: usize = 200;

/// Finds the markers of a frame without predictions. The result does not depend on the number of threads.
pub fn detect(image: &Raster) -> Detections {
    finish_detections(
        image,
        search_frame(
            image,
            GuidedDetector::new(image).search_options_for(Scope::Frame),
        ),
    )
}

/// Finds the predicted markers, searching only around them. A marker that is found has the result of [`detect`]; others are
/// missing.
pub fn detect_guided(image: &Raster, predictions: &[MarkerPrediction]) -> Detections {
    GuidedDetector::new(image).detect(image, predictions)
}

/// Detector for frames in which markers are predicted, for one or several passes. Each pass needs only the part of the
/// image that [`tiles_read`] returns.
pub struct GuidedDetector {
    noise: f64,
    sharpening: Sharpening,
}

impl GuidedDetector {
    /// Creates a guided detector and estimates the frame's noise.
    pub fn new(image: &Raster) -> Self {
        Self {
            noise: noise::estimate_noise(image),
            sharpening: Sharpening::Undetermined,
        }
    }

    /// Finds the predicted markers, as [`detect_guided`] does.
    pub fn detect(&self, image: &Raster, predictions: &[MarkerPrediction]) -> Detections {
        let mut all = search_frame(image, self.search_options_for(Scope::Around(predictions)));
        scope::keep_predicted(&mut all.found, predictions);
        finish_detections(image, all)
    }

    /// Finds the predicted markers that need no second pass, to some 0.1 px.
    pub fn detect_coarse(
        &mut self,
        image: &Raster,
        predictions: &[MarkerPrediction],
    ) -> Vec<Detection> {
        let options = SearchOptions {
            rough: true,
            ..self.search_options_for(Scope::Around(predictions))
        };
        let SearchResult {
            mut found,
            sharpening,
            ..
        } = search_frame(image, options);
        self.sharpening = sharpening;
        scope::keep_predicted(&mut found, predictions);
        found.measured.into_iter().map(|m| m.detection).collect()
    }

    fn search_options_for<'p>(&self, scope: Scope<'p>) -> SearchOptions<'p> {
        SearchOptions {
            scope,
            noise: self.noise,
            sharpening: self.sharpening,
            rough: false,
        }
    }
}

/// Searches a frame at the default thresholds and, if it is faint, at lower ones; with predictions, only for the missing
/// markers.
fn search_frame(image: &Raster, options: SearchOptions) -> SearchResult {
    let smoothed = if options.noise > noise::FRAYING_NOISE {
        let tiles = options.scope.tiles(image.width(), image.height());
        noise::smooth_image(image, &tiles)
    } else {
        None
    };
    let seen = smoothed.as_ref().unwrap_or(image);
    let mut progress = SearchProgress::new(image, seen, options);
    progress.search(seen, false);
    let missing = options.scope.missing(&progress.found.measured);
    let is_done = options.rough || missing.as_ref().is_some_and(Vec::is_empty);
    if !is_done
        && is_faint(
            &progress.found,
            windows::block_size(image.width(), image.height()),
        )
    {
        if let Some(missing) = missing.as_deref() {
            progress = progress.with_scope(seen, Scope::Around(missing));
        }
        progress.search(seen, true);
    }
    let SearchProgress {
        mut found,
        options: SearchOptions {
            noise, sharpening, ..
        },
        ..
    } = progress;
    inflate_length_outliers(&mut found);
    SearchResult {
        found,
        noise,
        sharpening,
    }
}

/// Result of a search, with the frame's noise, grey levels, and its sharpening.
struct SearchResult {
    found: FoundMarkers,
    noise: f64,
    sharpening: Sharpening,
}

/// Inflates covariances for correlated noise, dirt, misfit and lost contrast, and sorts markers and rejected ones.
fn finish_detections(
    image: &Raster,
    SearchResult {
        mut found,
        noise,
        sharpening,
    }: SearchResult,
) -> Detections {
    let inflation = correlated::correlation_factor(&found.measured);
    let ellipses: Vec<ellipse::Ellipse> = found
        .measured
        .iter()
        .map(|m| m.detection.ellipse())
        .collect();
    for measured in &mut found.measured {
        correlated::raise_for_correlation(measured, inflation);
        dirt::inflate_for_dirt(image, measured, &ellipses);
        misfit::inflate_for_misfit(image, measured, noise);
    }
    let lost_contrast_px = lost_contrast::inflate_for_lost_contrast(&mut found.measured);
    // The largest are kept, because markers are larger than dirt.
    sort_by_value(&mut found.rejected, |one| -one.semi_major_px);
    found.rejected.truncate(MAX_REJECTED);
    found
        .rejected
        .sort_by(|a, b| compare_positions(&a.centre_px, &b.centre_px));
    let psf_sigma_px = median(found.measured.iter().map(|m| m.blur).collect());
    let mut markers: Vec<Detection> = found.measured.into_iter().map(|m| m.detection).collect();
    markers.sort_by(|a, b| compare_positions(&a.centre_px, &b.centre_px));
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

/// Returns the tiles of a frame of `width` x `height` px that [`detect_guided`] reads; others need not be decoded.
pub fn tiles_read(predictions: &[MarkerPrediction], width: usize, height: usize) -> Tiles {
    Scope::Around(predictions).tiles_read(width, height)
}

/// Returns whether all predicted markers that the earlier frame showed were found; false without such markers.
pub fn is_complete(found: &Detections, predictions: &[MarkerPrediction]) -> bool {
    let there = scope::match_predictions(&found.markers.iter().collect::<Vec<_>>(), predictions).1;
    predictions.iter().any(|p| p.seen)
        && predictions
            .iter()
            .zip(there)
            .all(|(p, there)| there || !p.seen)
}
