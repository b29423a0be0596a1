//! Measurement of a hypothesis, and of what else it may be if that fails.

use std::cell::RefCell;

use crate::detect::accept::verdict::{MeasuredMarker, MeasurementResult};
use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::attempt::measure::{
    Bounds, SharedCandidates, measure_hypothesis, reject_without_fit,
};
use crate::detect::attempt::whole;
use crate::detect::detection::RejectReason;
use crate::detect::hypothesis::{Hypothesis, prior::MarkerPrior};
use crate::detect::propose::blurred_quadrants::resegment_against_skin;
use crate::detect::propose::glare_cut;
use crate::detect::segment::blob::Blob;
use crate::raster::Raster;

/// Measures the hypotheses of one image.
pub struct Measurer<'a> {
    pub image: &'a Raster,
    pub blobs: &'a [Blob],
    pub bounds: Bounds,
    pub candidates: SharedCandidates,
    /// Results of blobs measured as whole discs, by blob.
    whole: RefCell<Vec<Option<MeasurementResult>>>,
}

/// Result of the measurement of a hypothesis.
pub struct AttemptOutcome {
    pub measured: MeasurementResult,
    /// Hypothesis to measure again if the neighbouring discs predict its size.
    pub needs_size: Option<Hypothesis>,
}

impl From<MeasurementResult> for AttemptOutcome {
    fn from(measured: MeasurementResult) -> Self {
        Self {
            measured,
            needs_size: None,
        }
    }
}

impl<'a> Measurer<'a> {
    /// Creates a measurer for an image in which nothing has been measured.
    pub fn new(image: &'a Raster, blobs: &'a [Blob], bounds: Bounds) -> Self {
        let whole = RefCell::new(vec![None; blobs.len()]);
        Self {
            image,
            blobs,
            bounds,
            candidates: SharedCandidates::default(),
            whole,
        }
    }

    /// Returns a measurer without stored results that measures discs through the glare over them.
    pub fn through_glare(&self) -> Self {
        Self::new(
            self.image,
            self.blobs,
            Bounds {
                through_glare: true,
                ..self.bounds
            },
        )
    }

    /// Measures a hypothesis by the first interpretation that succeeds.
    ///
    /// # Errors
    /// Returns an error if none succeeds, with the reason.
    pub fn measure(&self, seen: &Hypothesis) -> MeasurementResult {
        self.try_strategies(seen).measured
    }

    /// Measures a hypothesis by the first interpretation that succeeds, and returns whether it needs a predicted size.
    pub fn try_strategies(&self, seen: &Hypothesis) -> AttemptOutcome {
        let is_own_blob = seen.pattern == MarkerPattern::Disc
            && seen.prior == MarkerPrior::default()
            && seen.excluded.is_empty();
        match seen.blobs[..] {
            [index] if is_own_blob => self.blobs.get(index).map(|blob| (index, blob)),
            _ => None,
        }
        .filter(|(_, blob)| !blob.at_edge)
        .map_or_else(
            || AttemptOutcome::from(self.measure_or_resegment(seen)),
            |(index, blob)| self.measure_blob(index, blob, seen),
        )
    }

    fn fit(&self, hypothesis: &Hypothesis) -> MeasurementResult {
        measure_hypothesis(
            self.image,
            self.blobs,
            hypothesis,
            self.bounds,
            &self.candidates,
        )
    }

    /// Measures a hypothesis as it was proposed, or quadrants segmented by black and white against the skin: blur may leave
    /// too little of their black.
    fn measure_or_resegment(&self, seen: &Hypothesis) -> MeasurementResult {
        self.fit(seen).or_else(|reason| {
            let again = resegment_against_skin(self.image, seen, self.bounds.blur);
            self.fit(&again.ok_or(reason)?).map_err(|_| reason)
        })
    }

    /// Measures a disc from one blob of the frame.
    fn measure_blob(&self, index: usize, blob: &Blob, seen: &Hypothesis) -> AttemptOutcome {
        if reject_without_fit(self.blobs, seen) == Err(RejectReason::TooSmall) {
            return AttemptOutcome::from(Err(RejectReason::TooSmall));
        }
        let is_cut = whole::looks_cut(blob);
        let measured = if is_cut {
            Err(RejectReason::NotAnEllipse)
        } else {
            self.measure_whole(index, seen)
        };
        if measured.as_ref().is_ok_and(MeasuredMarker::is_sure) {
            return AttemptOutcome::from(measured);
        }
        // Glare may hide an end of the disc or cross it.
        let needs_size = glare_cut::complete_disc(self.image, seen, blob);
        let again = match &needs_size {
            Some(completed) => Some(self.fit(completed)),
            // The local threshold may have followed a lower background, for example due to a line at its tip.
            None if is_cut => whole::resegment_at_one_level(self.image, blob, index)
                .map(|disc| self.fit(&disc).map_err(|_| RejectReason::NotAnEllipse)),
            None => None,
        };
        let measured = match again {
            Some(again) if again.is_ok() || measured.is_err() => again,
            _ => measured,
        };
        AttemptOutcome {
            measured,
            needs_size,
        }
    }

    /// Measures a blob as a whole disc, once; later calls return the stored result.
    pub fn measure_whole(&self, index: usize, disc: &Hypothesis) -> MeasurementResult {
        if let Some(Some(known)) = self.whole.borrow().get(index) {
            return known.clone();
        }
        let measured = self.fit(disc);
        if let Some(slot) = self.whole.borrow_mut().get_mut(index) {
            *slot = Some(measured.clone());
        }
        measured
    }
}
