//! Image -> markers.

mod arc;
mod blob;
mod candidate;
mod coarse;
mod fit;
mod guided;
mod measure;
mod model;
mod noise;
mod normal;

use nalgebra::{Matrix2, Vector2};

use super::raster::Raster;
use super::setup::Shape;

/// A marker found in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Quadrant or circle.
    pub shape: Shape,
    /// Quadrant: the saddle. Circle: the ellipse's own centre, perspective bias **not** removed. px.
    pub centre_px: Vector2<f64>,
    /// Covariance of `centre_px` from the fit's residuals and Jacobian, px^2.
    pub covariance_px2: Matrix2<f64>,
    /// Outline's semi-major axis, px.
    pub semi_major_px: f64,
    /// Outline's semi-minor axis, px.
    pub semi_minor_px: f64,
    /// Direction of the major axis, from u towards v, rad, in (-pi/2, pi/2].
    pub angle_rad: f64,
    /// Root mean square of the fit's residuals, grey levels.
    pub fit_rms: f64,
    /// Grey levels between white (or skin) and black.
    pub contrast: f64,
}

/// A candidate that was looked at and turned down.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejected {
    /// Where, px.
    pub centre_px: Vector2<f64>,
    /// Rough size, px.
    pub semi_major_px: f64,
    /// Rough size, px.
    pub semi_minor_px: f64,
    /// Rough direction, rad.
    pub angle_rad: f64,
    /// Why.
    pub reason: RejectReason,
}

/// Why a candidate is not a marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RejectReason {
    /// The outline touches the frame's edge.
    TouchesEdge,
    /// Too small to be measured.
    TooSmall,
    /// Flatter than 1:15 with a margin, or not an ellipse at all.
    NotAnEllipse,
    /// Too little contrast against the noise.
    LowContrast,
    /// The inside is not uniformly dark (circle) nor four quadrants.
    Pattern,
    /// The model's fit leaves residuals that are too large.
    PoorFit,
    /// The fit did not converge.
    NoConvergence,
    /// Another detection already explains it.
    Duplicate,
}

impl RejectReason {
    /// A few words for a person.
    pub fn text(self) -> &'static str {
        match self {
            Self::TouchesEdge => "touches the frame's edge",
            Self::TooSmall => "too small to measure",
            Self::NotAnEllipse => "outline is not an ellipse",
            Self::LowContrast => "too little contrast",
            Self::Pattern => "inside is neither uniform nor four quadrants",
            Self::PoorFit => "image model does not fit",
            Self::NoConvergence => "fit did not converge",
            Self::Duplicate => "another detection explains it",
        }
    }
}

/// All that one frame yields.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Detections {
    /// In stable order: by v, then u.
    pub markers: Vec<Detection>,
    /// In stable order: by v, then u.
    pub rejected: Vec<Rejected>,
    /// Standard deviation of the frame's point spread function, px; `None` without markers.
    pub psf_sigma_px: Option<f64>,
    /// Standard deviation of the grey values' noise, grey levels.
    pub noise: f64,
}

/// Where a marker is expected: the outline predicted from an earlier frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// Kind of target.
    pub shape: Shape,
    /// Expected centre, px.
    pub centre_px: Vector2<f64>,
    /// Expected semi-major axis, px.
    pub semi_major_px: f64,
    /// Expected semi-minor axis, px.
    pub semi_minor_px: f64,
    /// Expected direction, rad.
    pub angle_rad: f64,
    /// How far the centre may be off, px.
    pub search_px: f64,
}

/// Most regions that are taken up at full resolution, and most rejected that are reported.
const MAX_REGIONS: usize = 400;
const MAX_REJECTED: usize = 200;

/// Most blobs, pairs of blobs and candidates of a kind: far above what a wing shows, so that clutter
/// cannot take for ever. The largest are kept.
const MAX_BLOBS: usize = 500;
const MAX_PAIRS: usize = 1500;
const MAX_CANDIDATES: usize = 100;

/// Finds the markers of a frame without help. Deterministic at any number of threads.
pub fn detect(image: &Raster) -> Detections {
    let noise = noise::estimate(image);
    let mut found = search(image, coarse::factor(image), noise);
    found.rejected.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    found.rejected.truncate(MAX_REJECTED);
    let psf_sigma_px = middle(found.measured.iter().map(|m| m.blur).collect());
    let mut markers: Vec<Detection> = found.measured.into_iter().map(|m| m.detection).collect();
    markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    Detections { markers, rejected: found.rejected, psf_sigma_px, noise }
}

/// Finds the predicted markers, looking only at windows around them. Those that are not there are
/// missing from the answer; the caller then turns to [`detect`].
pub fn detect_guided(image: &Raster, predictions: &[Prediction]) -> Detections {
    guided::detect(image, predictions, coarse::factor(image), noise::estimate(image))
}

/// What a search yields, in order of discovery.
struct Found {
    measured: Vec<measure::Measured>,
    rejected: Vec<Rejected>,
}

/// All stages on one picture or window.
fn search(image: &Raster, factor: usize, noise: f64) -> Found {
    let blobs = find_blobs(image, &mut coarse::reduce(image, factor));
    let mut taken = vec![false; blobs.len()];
    let mut found = Found { measured: Vec::new(), rejected: Vec::new() };
    for candidates in [quadrants(&blobs), discs(&blobs)] {
        for candidate in &candidates {
            if candidate.blobs.iter().any(|&i| taken[i]) {
                continue;
            }
            if candidate.pattern != model::Pattern::Disc && are_discs(image, &blobs, candidate, noise) {
                continue;
            }
            match measure_whole_or_hidden(image, &blobs, candidate, noise) {
                Ok(measured) => {
                    candidate.blobs.iter().for_each(|&i| taken[i] = true);
                    found.measured.push(measured);
                }
                Err(reason) => found.rejected.push(candidate.rejected(reason)),
            }
        }
    }
    found
}

/// Whether the two blobs of a pair are whole discs side by side: the image model tells.
fn are_discs(image: &Raster, blobs: &[blob::Blob], candidate: &candidate::Candidate, noise: f64) -> bool {
    let disc = |&i: &usize| {
        let round = blobs.get(i).filter(|b| !looks_cut(b)).and_then(|b| candidate::disc(i, b));
        round.is_some_and(|c| measure::measure(image, blobs, &c, noise).is_ok())
    };
    candidate.blobs.len() == 2 && candidate.blobs.iter().all(disc)
}

/// Whether a blob is too square for a whole disc of its size.
fn looks_cut(blob: &blob::Blob) -> bool {
    let minor = candidate::Outline::from_moments(blob.centroid, blob.covariance, 2.0).minor.max(0.5);
    candidate::squareness(blob) > 0.13 + 1.3 / (minor * minor)
}

/// A disc whose outline is not an ellipse's may have a part hidden by its neighbour.
fn measure_whole_or_hidden(
    image: &Raster,
    blobs: &[blob::Blob],
    candidate: &candidate::Candidate,
    noise: f64,
) -> Result<measure::Measured, RejectReason> {
    let blob = match candidate.blobs[..] {
        [index] if candidate.pattern == model::Pattern::Disc => blobs.get(index),
        _ => None,
    };
    match blob {
        Some(blob) if !blob.at_edge && looks_cut(blob) => {
            let whole = arc::completed(candidate, blob, blobs).ok_or(RejectReason::NotAnEllipse)?;
            measure::measure(image, blobs, &whole, noise)
        }
        _ => measure::measure(image, blobs, candidate, noise),
    }
}

/// The median.
fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn by_place(a: &Vector2<f64>, b: &Vector2<f64>) -> std::cmp::Ordering {
    a.y.total_cmp(&b.y).then(a.x.total_cmp(&b.x))
}

/// Blobs of all levels, each once, from windows that together hold no more than the frame; against the near background, then thick ones against the far.
fn find_blobs(image: &Raster, coarse: &mut coarse::Coarse) -> Vec<blob::Blob> {
    let mut out: Vec<blob::Blob> = Vec::new();
    let mut done: Vec<coarse::Region> = Vec::new();
    let mut budget = coarse.width * coarse.height;
    let largest = (coarse.width * coarse.height / 8).max(64);
    for (far, level) in [false, true].into_iter().flat_map(|far| coarse::LEVELS.map(|level| (far, level))) {
        if far && level == coarse::LEVELS[0] {
            coarse.look_far();
            done.clear();
        }
        let mut regions = coarse.regions(level);
        let least = if far { coarse::THICK } else { 0 };
        regions.retain(|r| r.width() * r.height() <= largest && r.width().min(r.height()) >= least);
        regions.sort_by_key(|r| std::cmp::Reverse(r.area));
        regions.truncate(MAX_REGIONS);
        for region in regions {
            if done.iter().any(|d| d.stands_for(&region)) {
                continue;
            }
            let Some(left) = budget.checked_sub(region.width() * region.height()) else { continue };
            budget = left;
            let (blobs, cut) = blob::blobs(image, coarse, &region);
            blobs.into_iter().for_each(|blob| add_once(&mut out, blob));
            if !cut {
                done.push(region);
            }
        }
    }
    keep_largest(&mut out, MAX_BLOBS, |blob| blob.area);
    out
}

/// The `most` largest; the order changes only where there are more.
fn keep_largest<T>(items: &mut Vec<T>, most: usize, size: impl Fn(&T) -> f64) {
    if items.len() > most {
        items.sort_by(|a, b| size(b).total_cmp(&size(a)));
        items.truncate(most);
    }
}

fn add_once(out: &mut Vec<blob::Blob>, blob: blob::Blob) {
    let same = |b: &blob::Blob| {
        (b.centroid - blob.centroid).norm() < 2.0 && (0.75..1.33).contains(&(b.area / blob.area))
    };
    // Comparing all with all must not take for ever.
    if out.len() < 4 * MAX_BLOBS && !out.iter().any(same) {
        out.push(blob);
    }
}

/// Blobs and pairs of blobs that may be two black quadrants.
fn quadrants(blobs: &[blob::Blob]) -> Vec<candidate::Candidate> {
    let single = (0..blobs.len()).map(|i| vec![i]);
    let mut pairs = candidate::pairs(blobs);
    keep_largest(&mut pairs, MAX_PAIRS, |p| p.iter().filter_map(|&i| blobs.get(i)).map(|b| b.area).sum());
    let double = pairs.into_iter().map(|p| p.to_vec());
    let mut out = single.chain(double).filter_map(|i| candidate::quadrants(&i, blobs)).collect();
    keep_largest(&mut out, MAX_CANDIDATES, candidate::Candidate::size);
    out
}

/// Blobs that may be discs.
fn discs(blobs: &[blob::Blob]) -> Vec<candidate::Candidate> {
    let mut out = blobs.iter().enumerate().filter_map(|(i, blob)| candidate::disc(i, blob)).collect();
    keep_largest(&mut out, MAX_CANDIDATES, candidate::Candidate::size);
    out
}
