//! Diagnosis of images that do not fit a setup: frees one cause at a time and compares how well each explains them.
//!
//! | step | file |
//! |---|---|
//! | identities, also if a gross error hides them: the setup is modified until most detections fit | `search.rs` |
//! | sum of squares without and with each cause free, and the test of the difference | `evidence.rs` |
//! | modification of setup and images by a cause, its size in words and its correction | `cause.rs` |
//!
//! A cause is accepted by the likelihood ratio: the decrease of the sum of squares, over the variance factor that is left
//! if it exceeds 1, against chi-square of its parameters at a level that is shared by all causes and by the members of its
//! kind. Accepted causes are ordered by that decrease less `k ln n` for k parameters and `2 ln m` for m members.

mod cause;
mod evidence;
mod flight;
mod search;
mod subject;

use nalgebra::{Matrix2, Rotation3};

use super::{Identities, WingView};
use crate::detect::Detection;
use crate::estimation::quality::{GlobalTest, global_test};
use crate::observation::{Estimate, Observation};
use crate::ordering::sort_by_value;
use crate::setup::{Orientation, Setup, Shape};

pub(super) use cause::span_m;
pub use cause::{Cause, UNITS};
use evidence::{CauseFit, Evidence};
pub use search::{OTHER_AIRCRAFT, diagnose_ground, diagnose_ground_fit};
pub use subject::SizedShape;
use subject::{NamedImage, Subject, size_covariance};

/// Levels of significance of a diagnosis on the ground and in flight, where the result of a frame that is accused is doubtful:
/// probability that a sound setup is accused.
const ALPHAS: (f64, f64) = (0.01, 0.001);
/// Number of kinds of causes among which the level is shared.
const KINDS: f64 = 12.0;
/// Difference of twice the log evidence below which two causes explain the images equally well: odds of 20 to 1.
const ALIKE: f64 = 6.0;
/// Number of single coordinates that are solved after the linear score of all.
const POINTS: usize = 5;
/// Number of images with the largest misclosures whose names are exchanged in pairs.
const EXCHANGED: usize = 5;

/// Variance factor above which axes of the survey are permuted, and which no explanation may leave.
const GROSS: f64 = 1e3;

/// Cause with its size and its test.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// Cause.
    pub cause: Cause,
    /// Its parameters, in the units of [`Cause`].
    pub size: Vec<Estimate>,
    /// Decrease of the sum of squares, over the variance factor that is left if it exceeds 1.
    pub decrease: f64,
    /// Variance factor that is left.
    pub variance_factor: f64,
    /// Cause and correction in one sentence.
    pub text: String,
    camera_from_survey: Rotation3<f64>,
    /// Decrease less the penalty for parameters and alternatives.
    evidence: f64,
    is_significant: bool,
}

/// Result of a diagnosis.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// Variance factor of the images with the setup as given.
    pub variance_factor: f64,
    /// Verdict of its test.
    pub global_test: Option<GlobalTest>,
    /// All causes tried, the best first.
    pub ranking: Vec<Explanation>,
    /// Second error, which the images show with the best cause corrected.
    pub further: Option<Explanation>,
}

impl Explanation {
    fn values(&self) -> Vec<f64> {
        self.size.iter().map(|e| e.value).collect()
    }

    /// Returns the setup with the error corrected; `None` if it is not one of the setup.
    fn corrected_setup(&self, setup: &Setup) -> Option<Setup> {
        let is_of_image = matches!(
            self.cause,
            Cause::Bend | Cause::Turn | Cause::UpsideDown | Cause::Mirrored
        );
        let is_of_marks = matches!(self.cause, Cause::Mark(_) | Cause::MarkAxes(_));
        (!is_of_image && !is_of_marks).then(|| {
            self.cause
                .apply(&Subject::new(setup, vec![]), &self.values())
                .setup
        })
    }
}

impl Diagnosis {
    /// Sets the second error to the best cause of a diagnosis with the first one corrected.
    fn set_further(&mut self, second: Option<Self>) {
        let is_new = |e: &&Explanation| {
            self.causes()
                .first()
                .is_some_and(|best| !best.cause.is_same_place(e.cause))
        };
        self.further = second
            .and_then(|second| second.causes().first().filter(is_new).cloned())
            .or(self.further.take());
    }

    /// Returns the significant causes that explain the images equally well, the best first; empty without an error.
    pub fn causes(&self) -> &[Explanation] {
        let Some(best) = self.ranking.first().filter(|best| best.is_significant) else {
            return &[];
        };
        let alike = |e: &&Explanation| e.is_significant && e.evidence >= best.evidence - ALIKE;
        &self.ranking[..self.ranking.iter().take_while(alike).count()]
    }

    /// Returns whether a bend since the survey, smaller than one in flight, explains the images best: deflections relative
    /// to the ground frame are free of it.
    pub fn is_bent_on_ground(&self, setup: &Setup) -> bool {
        let best = self
            .causes()
            .first()
            .filter(|best| best.cause == Cause::Bend);
        best.and_then(|best| best.size.first())
            .is_some_and(|tip| !cause::is_bent(tip.value, setup))
    }

    /// Returns whether a wrong survey, mark or name of markers for which `is_used` is false explains the images best: a result
    /// without them does not depend on it.
    pub fn concerns_unused_markers(&self, is_used: impl Fn(usize) -> bool) -> bool {
        match self.causes().first().map(|best| best.cause) {
            Some(Cause::Point(marker, _) | Cause::Mark(marker)) => !is_used(marker),
            Some(Cause::Exchange(a, b)) => !is_used(a) && !is_used(b),
            _ => false,
        }
    }

    /// Returns the marker whose survey or manual mark is the only cause.
    pub fn wrong_marker(&self) -> Option<usize> {
        match self.causes() {
            [
                Explanation {
                    cause: Cause::Point(marker, _) | Cause::Mark(marker),
                    ..
                },
            ] => Some(*marker),
            _ => None,
        }
    }

    /// Describes the causes in one sentence; `None` without one.
    pub fn text(&self) -> Option<String> {
        let causes = self.causes();
        let first = causes.first()?.text.clone();
        let others: Vec<&str> = causes
            .iter()
            .skip(1)
            .take(2)
            .map(|e| e.text.as_str())
            .collect();
        let named = if others.is_empty() {
            first
        } else {
            format!("{first}; explained equally well: {}", others.join("; or "))
        };
        Some(self.further.as_ref().map_or(named.clone(), |further| {
            format!("{named}; in addition, {}", further.text)
        }))
    }
}

/// Diagnoses observations of known identity: of a frame in flight with an orientation, else of the ground. `outlines`: kind
/// and, if measured, semi-major axis of each outline, px; `None` for manual marks.
pub fn diagnose_observations(
    setup: &Setup,
    orientation: Option<&Orientation>,
    observations: &[Observation],
    outlines: &[Option<SizedShape>],
) -> Option<Diagnosis> {
    rank_causes(
        &Subject::of_observations(setup, observations, outlines),
        orientation,
        None,
    )
}

/// Ranks all causes for named images, and if the best is significant, again those of the images corrected by it.
/// `found`: a gross error with its parameters, with which the images were identified.
fn rank_causes(
    subject: &Subject,
    orientation: Option<&Orientation>,
    found: Option<(Cause, &[f64])>,
) -> Option<Diagnosis> {
    let mut first = rank_single_causes(subject, orientation, found)?;
    if let Some(best) = first.causes().first() {
        let second = rank_single_causes(
            &best.cause.apply(subject, &best.values()),
            orientation,
            None,
        );
        first.set_further(second);
    }
    Some(first)
}

/// Ranks all causes for named images, one at a time.
fn rank_single_causes(
    subject: &Subject,
    orientation: Option<&Orientation>,
    found: Option<(Cause, &[f64])>,
) -> Option<Diagnosis> {
    let linear = found.map_or_else(
        || subject.clone(),
        |(cause, values)| cause.apply(subject, values),
    );
    let pose = evidence::start_pose(&linear, orientation)?;
    let evidence = Evidence::new(subject.clone(), orientation, (&linear, &pose))?;
    let base = evidence.solve(None, &[]);
    let mut tried: Vec<(Cause, CauseFit)> = vec![];
    let mut attempt = |cause: Cause, values: &[f64]| {
        tried.extend(evidence.solve(Some(cause), values).map(|fit| (cause, fit)))
    };
    found
        .iter()
        .for_each(|(cause, values)| attempt(*cause, values));
    Cause::list_continuous(orientation.is_some())
        .into_iter()
        .for_each(|cause| attempt(cause, &[]));
    if let Some(base) = &base {
        evidence
            .score_points(base)
            .iter()
            .take(POINTS)
            .for_each(|(cause, _)| attempt(*cause, &[]));
        exchanged_names(&evidence, base)
            .into_iter()
            .for_each(|cause| attempt(cause, &[]));
    }
    if subject.images.iter().any(|image| image.outline.is_none()) {
        Cause::list_mark_axes().for_each(|cause| attempt(cause, &[]));
        let marks = subject
            .images
            .iter()
            .filter(|image| image.outline.is_none());
        marks.for_each(|image| attempt(Cause::Mark(image.marker), &[]));
    }
    attempt(Cause::Mirrored, &[]);
    let without = base.map_or(f64::MAX.sqrt(), |base| base.sum_of_squares);
    let freedom = evidence.redundancy();
    if orientation.is_none() && without > GROSS * freedom as f64 {
        Cause::list_axes().for_each(|cause| attempt(cause, &[]));
    }
    let mut ranking: Vec<Explanation> = tried
        .into_iter()
        .map(|(cause, fit)| weigh_cause(&evidence, cause, &fit, without))
        .collect();
    sort_by_value(&mut ranking, |one| -one.evidence);
    let mut places: Vec<Cause> = vec![];
    ranking.retain(|e| {
        let is_new = !places.iter().any(|place| place.is_same_place(e.cause));
        places.push(e.cause);
        is_new
    });
    Some(Diagnosis {
        variance_factor: without / freedom.max(1) as f64,
        global_test: global_test(without, freedom, ALPHAS.1),
        ranking,
        further: None,
    })
}

/// Tests a cause against the sum of squares without it.
fn weigh_cause(evidence: &Evidence, cause: Cause, fit: &CauseFit, without: f64) -> Explanation {
    let (parameters, markers) = (cause.parameters(), evidence.subject.setup.markers.len());
    let left = fit.sum_of_squares / evidence.redundancy().saturating_sub(parameters).max(1) as f64;
    let decrease = (without - fit.sum_of_squares) / left.max(1.0);
    let rows = (evidence.redundancy() as f64).max(1.0);
    let alpha = match evidence.orientation {
        Some(_) => ALPHAS.1,
        None => ALPHAS.0,
    };
    let penalty = parameters as f64 * rows.ln() + 2.0 * (cause.alternatives(markers) as f64).ln();
    Explanation {
        cause,
        size: fit.size.clone(),
        decrease,
        variance_factor: left,
        text: cause.describe(
            &fit.size,
            &evidence.subject.setup,
            evidence.orientation.is_some(),
        ),
        camera_from_survey: fit.pose.rotation(),
        evidence: decrease - penalty,
        is_significant: decrease > evidence.limit(cause, alpha / KINDS),
    }
}

/// Lists exchanges of names among the images that fit worst.
fn exchanged_names(evidence: &Evidence, base: &CauseFit) -> Vec<Cause> {
    let worst = evidence.worst_images(base, EXCHANGED);
    let mut pairs = vec![];
    for (k, a) in worst.iter().enumerate() {
        pairs.extend(
            worst[..k]
                .iter()
                .filter(|b| *b != a)
                .map(|b| Cause::Exchange(*b, *a)),
        );
    }
    pairs
}

impl WingView<'_> {
    /// Returns the logarithm of the ratio of the identified outlines' sizes to those predicted from survey and distance.
    pub fn log_size_ratio(
        &self,
        detections: &[Detection],
        identities: &Identities,
    ) -> Option<Estimate> {
        let outlines = self.marker_outlines(&self.fit_state(detections, identities)?.state);
        let mut sizes: Vec<(f64, (Shape, f64), Matrix2<f64>)> = vec![];
        let (mut sum, mut weights) = (0.0, 0.0);
        for (i, j) in identities.pairs() {
            let (Some(d), Some(Some(outline))) = (
                detections.get(i).filter(|d| d.shape != Shape::Point),
                outlines.get(j),
            ) else {
                continue;
            };
            let size = (d.shape, d.semi_major_px);
            let weight = size_covariance(size, size, Some(&d.covariance_px2)).recip();
            sizes.push((weight, size, *d.covariance_px2));
            sum += weight * (d.semi_major_px / outline.semi_major_px).ln();
            weights += weight;
        }
        let all = || sizes.iter().enumerate();
        let pairs =
            all().flat_map(|(i, a)| all().map(move |(k, b)| (a, b, (i == k).then_some(&a.2))));
        let variance: f64 = pairs
            .map(|(a, b, own)| a.0 * b.0 * size_covariance(a.1, b.1, own))
            .sum();
        (weights > 0.0).then_some(Estimate {
            value: sum / weights,
            sigma: Some(variance.sqrt() / weights),
        })
    }
}

/// Returns a detection as the image of a marker.
fn named_image(d: &Detection, marker: usize) -> NamedImage {
    // A manual mark has no contrast.
    let outline = (d.contrast > 0.0).then_some((d.shape, Some(d.semi_major_px)));
    NamedImage {
        marker,
        pixel: d.centre_px,
        covariance_px2: *d.covariance_px2,
        outline,
    }
}
