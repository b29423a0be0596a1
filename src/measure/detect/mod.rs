//! Image -> markers.

mod arc;
mod arcs;
mod batch;
mod beside;
mod blob;
mod blocks;
mod bordered;
mod candidate;
mod chords;
mod closer;
mod clumped;
mod coarse;
mod counts;
mod disc;
mod distinct;
mod factor;
mod field;
mod fit;
mod gathered;
mod glare;
mod guided;
mod judge;
mod lanes;
mod linear;
mod marks;
mod mask;
mod measure;
mod mirrored;
mod model;
mod narrow;
mod noise;
mod normal;
mod outline;
mod outlined;
mod oval;
mod parted;
mod reduced;
mod rim;
mod runs;
mod seam;
mod select;
mod sheet;
mod sheets;
mod sought;
mod under;
mod uneven;
mod veil;
mod wedge;
mod weigh;
mod whole;
mod wide;

use std::ops::Range;

use nalgebra::{Matrix2, Vector2};

pub use closer::{Expected, UNSURE_PX2, look_closer};
use coarse::Part;
use under::again_under_sheets;
use whole::{
    Whole, again_with_like, again_with_size, doubt_unlike, is_unsure, measure_whole_or_hidden, with_uneven,
};

use super::raster::Raster;
use super::setup::Shape;

/// A marker found in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Quadrant or circle.
    pub shape: Shape,
    /// Quadrant: the saddle. Circle: the ellipse's own centre, perspective bias **not** removed. px.
    pub centre_px: Vector2<f64>,
    /// Covariance of `centre_px` from the fit's residuals and Jacobian, and from what lies beside it, px^2.
    pub covariance_px2: Matrix2<f64>,
    /// What of that, across the axis, is for things that lie on the skin beside a disc, px^2.
    pub beside_px2: f64,
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

impl Detection {
    fn outline(&self) -> outline::Outline {
        let (major, minor) = (self.semi_major_px, self.semi_minor_px);
        outline::Outline { centre: self.centre_px, major, minor, angle: self.angle_rad }
    }

    /// Sum of the place's variances, px^2, without what is for things beside it.
    fn variance(&self) -> f64 {
        self.covariance_px2.trace() - self.beside_px2
    }
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
    /// Flatter than 1:40 (a disc) or 1:26 (quadrants), or not an ellipse at all.
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
    /// A marker, but its place is told too badly.
    Uncertain,
    /// Glare leaves too little of it.
    Drowned,
    /// Its edge is far softer than those of the frame's markers.
    Soft,
    /// Far smaller than all the frame's markers, which are of about one size at like distances.
    Speck,
    /// A thin disc that lies across the frame's other markers.
    Askew,
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
            Self::Uncertain => "place too uncertain",
            Self::Drowned => "glare leaves too little of it",
            Self::Soft => "edge softer than the other markers'",
            Self::Speck => "far smaller than the other markers",
            Self::Askew => "lies across the other markers",
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
    /// By how much the markers' variances were raised because residuals hang together, as JPEG leaves them; at least 1.
    pub clumping: f64,
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
    /// Whether the earlier frame showed it; what is hidden for long need not be there.
    pub seen: bool,
}

/// Most rejected candidates that are reported.
const MAX_REJECTED: usize = 200;

/// Finds the markers of a frame without help. Deterministic at any number of threads.
pub fn detect(image: &Raster) -> Detections {
    let (found, noise) = find(image, None);
    detections(image, found, noise)
}

/// Finds the predicted markers, looking only around them: for each that is there the answer of
/// [`detect`]. Those that are not are missing.
pub fn detect_guided(image: &Raster, predictions: &[Prediction]) -> Detections {
    let (mut found, noise) = find(image, Some(predictions));
    guided::keep_predicted(&mut found, predictions);
    detections(image, found, noise)
}

/// What is found in the whole frame, or around predictions; and the noise.
fn find(image: &Raster, sought: Option<&[Prediction]>) -> (Found, f64) {
    let noise = noise::estimate(image);
    let smoothed = if noise > noise::FRAYING { smoothed(image, sought) } else { None };
    let seen = smoothed.as_ref().unwrap_or(image);
    let sound = |faint: bool, known: Vec<judge::Measured>| {
        let mut found = search(image, seen, sought, noise, faint, known);
        distinct::without_soft(&mut found);
        distinct::without_askew(&mut found);
        distinct::without_specks(&mut found);
        found
    };
    let mut found = sound(false, Vec::new());
    let all_found = sought.is_some_and(|sought| guided::missing(&found.measured, sought).is_empty());
    if !all_found && is_faint(&found) {
        found = sound(true, found.measured);
    }
    doubt_unlike(&mut found);
    (found, noise)
}

/// A frame without most of its noise, of which only that is seen which is read about predictions.
fn smoothed(image: &Raster, sought: Option<&[Prediction]>) -> Option<Raster> {
    let (width, height) = (image.width(), image.height());
    let columns = match sought {
        None => vec![0..width; height],
        Some(sought) => columns_read(sought, width, height),
    };
    noise::smoothed(image, &columns)
}

fn detections(image: &Raster, mut found: Found, noise: f64) -> Detections {
    let clumping = clumped::factor(&found.measured);
    let outlines: Vec<outline::Outline> = found.measured.iter().map(|m| m.detection.outline()).collect();
    for measured in &mut found.measured {
        clumped::raise(measured, clumping);
        beside::doubt(image, measured, &outlines);
    }
    found.rejected.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    found.rejected.truncate(MAX_REJECTED);
    let psf_sigma_px = middle(found.measured.iter().map(|m| m.blur).collect());
    let mut markers: Vec<Detection> = found.measured.into_iter().map(|m| m.detection).collect();
    markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    Detections { markers, rejected: found.rejected, psf_sigma_px, noise, clumping }
}

/// Of each pixel row of a frame of `width` x `height` px the columns that [`detect_guided`] reads: what lies elsewhere
/// need not be decoded.
pub fn columns_read(predictions: &[Prediction], width: usize, height: usize) -> Vec<Range<usize>> {
    guided::columns(predictions, width, height)
}

/// Whether all of the predicted markers that the earlier frame showed are there; without any, no answer is complete.
pub fn is_complete(found: &Detections, predictions: &[Prediction]) -> bool {
    let there = guided::matched(&found.markers.iter().collect::<Vec<_>>(), predictions).1;
    predictions.iter().any(|p| p.seen) && predictions.iter().zip(there).all(|(p, there)| there || !p.seen)
}

/// The predicted markers; where one that the earlier frame showed is not found, all that the whole frame shows. A marker
/// that nobody expects is only seen by [`detect`].
pub fn detect_guided_or_full(image: &Raster, predictions: &[Prediction]) -> Detections {
    let found = detect_guided(image, predictions);
    if is_complete(&found, predictions) { found } else { detect(image) }
}

/// What a search yields, in order of discovery.
struct Found {
    measured: Vec<judge::Measured>,
    rejected: Vec<Rejected>,
}

/// Whether black is so light in some marker that farther ones may be too faint for the usual levels:
/// haze and stray light take contrast away with distance. Black on white leaves a quarter, at most two
/// fifths, of the grey. So few markers that nothing can be made of them may be all so faint.
fn is_faint(found: &Found) -> bool {
    const LEAST: f64 = 0.45;
    const TOO_FEW: usize = 4;
    found.measured.len() < TOO_FEW || found.measured.iter().any(|m| m.darkness < LEAST && !m.through_glare)
}

/// A rough fit's blur is that of the last one to this factor.
const MARGIN: f64 = 1.25;

/// In what order candidates are measured.
#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Quadrants,
    Narrow,
    Discs,
}

/// All stages on one picture, whose blobs are sought in the one that is `seen`. What was measured before stays, and its
/// blobs are not looked at again.
fn search(
    image: &Raster,
    seen: &Raster,
    sought: Option<&[Prediction]>,
    noise: f64,
    faint: bool,
    before: Vec<judge::Measured>,
) -> Found {
    let (width, height) = (image.width(), image.height());
    let part = sought.map_or_else(|| Part::all(width, height), |sought| guided::part(sought, width, height));
    let mut coarse = coarse::reduce(seen, part);
    let (blobs, uneven) = gathered::find_blobs(seen, &mut coarse, faint);
    let pairs = candidate::pairs(&blobs);
    let within = |blob: &blob::Blob| before.iter().any(|m| m.detection.outline().holds(blob.centroid));
    let mut taken: Vec<bool> = blobs.iter().map(within).collect();
    let mut whole = Whole::new(image, &blobs, measure::Bounds::of(noise));
    let mut found = Found { measured: before, rejected: Vec::new() };
    let wanted = |seen: &candidate::Candidate| sought.is_none_or(|sought| guided::is_near(seen, sought));
    let (mut hidden, mut unsure) = (Vec::new(), Vec::new());
    for stage in [Stage::Quadrants, Stage::Narrow, Stage::Discs] {
        let candidates = match stage {
            Stage::Quadrants => gathered::quadrants(seen, &blobs, &pairs),
            Stage::Narrow => {
                let missing = sought.map(|sought| guided::missing_quadrants(&found.measured, sought));
                let open = |seen: &outline::Outline| {
                    missing.as_ref().is_none_or(|missing| guided::may_show_part_of(seen, missing))
                };
                narrow::narrow(image, (&blobs, &pairs), &taken, noise, open, |i| whole.is_sure_disc(i))
            }
            Stage::Discs => gathered::discs(&blobs),
        };
        for candidate in &candidates {
            if !wanted(candidate) || candidate.blobs.iter().any(|&i| taken[i]) {
                continue;
            }
            if sought.is_some_and(|sought| guided::is_beside(candidate, sought, &found.measured)) {
                continue;
            }
            if stage == Stage::Quadrants && whole.are_discs(candidate) {
                continue;
            }
            let (measured, part) = measure_whole_or_hidden(&mut whole, candidate);
            let discs =
                |m: &judge::Measured| m.detection.shape == Shape::Quadrant && whole.hold_discs(&m.detection);
            let measured =
                if measured.as_ref().is_ok_and(discs) { Err(RejectReason::Duplicate) } else { measured };
            let index = measured.is_ok().then_some(found.measured.len());
            hidden.extend(part.map(|part| (index, part)));
            match measured {
                Ok(measured) => {
                    candidate.blobs.iter().for_each(|&i| taken[i] = true);
                    found.measured.push(measured);
                    whole.bounds.blur = distinct::softest(&found).map_or(whole.bounds.blur, |b| MARGIN * b);
                }
                Err(reason) => {
                    found.rejected.push(candidate.rejected(reason));
                    unsure.extend(is_unsure(reason, candidate).then(|| candidate.clone()));
                }
            }
        }
    }
    again_with_size(&whole, &mut found, hidden);
    again_with_like(&whole, &mut found, unsure);
    again_under_sheets(&whole, &mut found, wanted);
    with_uneven(&whole, &mut found, (seen, &coarse, &uneven), wanted);
    distinct::distinct(&mut found);
    found
}

/// The median.
fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn by_place(a: &Vector2<f64>, b: &Vector2<f64>) -> std::cmp::Ordering {
    a.y.total_cmp(&b.y).then(a.x.total_cmp(&b.x))
}
