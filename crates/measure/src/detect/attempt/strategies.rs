//! Fallback strategies: interpretations of a hypothesis, in the order in which they are tried.

use std::cell::{OnceCell, RefCell};

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

/// Condition under which a strategy is tried.
#[derive(Clone, Copy)]
enum StrategyCondition {
    /// No strategy has yielded a marker.
    Unanswered,
    /// No strategy has yielded a marker with a precise position.
    Unsure,
    /// The blob looks whole.
    Whole,
    /// The blob looks cut outside glare, and no strategy has yielded a marker.
    CutOutsideGlare,
}

/// Interpretation of a hypothesis.
struct Strategy {
    condition: StrategyCondition,
    /// Proposes the hypothesis to measure, if the interpretation is possible.
    propose: fn(&StrategyRun) -> Option<Hypothesis>,
    /// True if its failure is the reason that is reported.
    reports_failure: bool,
    /// True if the size is needed that the neighbouring discs predict, whether the marker was measured or not.
    needs_size: bool,
}

impl Strategy {
    /// Creates a strategy for a marker that shows its size; its failure is not reported.
    const fn new(
        condition: StrategyCondition,
        propose: fn(&StrategyRun) -> Option<Hypothesis>,
    ) -> Self {
        Self {
            condition,
            propose,
            reports_failure: false,
            needs_size: false,
        }
    }

    const fn with_reported_failure(self) -> Self {
        Self {
            reports_failure: true,
            ..self
        }
    }

    const fn with_size_need(self) -> Self {
        Self {
            needs_size: true,
            ..self
        }
    }

    /// Creates the strategy that measures the hypothesis as it was proposed.
    const fn as_proposed(condition: StrategyCondition) -> Self {
        Self::new(condition, |run| Some(run.seen.clone())).with_reported_failure()
    }
}

/// Strategies for quadrants.
const QUADRANT_STRATEGIES: [Strategy; 2] = [
    Strategy::as_proposed(StrategyCondition::Unanswered),
    // Blurred quadrants, segmented by black and white against the skin.
    Strategy::new(StrategyCondition::Unanswered, |run| {
        resegment_against_skin(run.measurer.image, run.seen, run.measurer.bounds.blur)
    }),
];

/// Strategies for a blob that may be a disc.
const DISC_STRATEGIES: [Strategy; 3] = [
    Strategy::as_proposed(StrategyCondition::Whole),
    // Glare hides an end of the disc or crosses it; also tried if it looks whole but its position is imprecise.
    Strategy::new(StrategyCondition::Unsure, |run| {
        run.find_disc_in_glare().cloned()
    })
    .with_reported_failure()
    .with_size_need(),
    // Disc cut only by its local threshold, which followed a lower background, for example due to a line at its
    // tip.
    Strategy::new(StrategyCondition::CutOutsideGlare, |run| {
        run.blob
            .and_then(|(i, blob)| whole::resegment_at_one_level(run.measurer.image, blob, i))
    }),
];

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

    /// Measures a hypothesis by the first strategy that succeeds.
    ///
    /// # Errors
    /// Returns an error if none succeeds, with the reason.
    pub fn measure(&self, seen: &Hypothesis) -> MeasurementResult {
        self.try_strategies(seen).measured
    }

    /// Measures a hypothesis by the first strategy that succeeds, and returns whether it needs a predicted size.
    pub fn try_strategies(&self, seen: &Hypothesis) -> AttemptOutcome {
        let mut run = StrategyRun::new(self, seen);
        let (mut reason, mut needs_size) = (RejectReason::NotAnEllipse, None);
        if run.blob.is_some() && reject_without_fit(self.blobs, seen) == Err(RejectReason::TooSmall)
        {
            return AttemptOutcome {
                measured: Err(RejectReason::TooSmall),
                needs_size,
            };
        }
        for strategy in run.strategies() {
            let due = run.meets_condition(strategy.condition);
            let Some(proposed) = due.then(|| (strategy.propose)(&run)).flatten() else {
                continue;
            };
            let measured = run.measure_proposed(&proposed);
            if strategy.needs_size {
                needs_size = Some(proposed);
            } else if measured.is_ok() {
                needs_size = None;
            }
            match measured {
                Ok(measured) => run.answer = Some(measured),
                Err(why) if strategy.reports_failure => reason = why,
                Err(_) => {}
            }
        }
        AttemptOutcome {
            measured: run.answer.ok_or(reason),
            needs_size,
        }
    }

    /// Measures a blob as a whole disc, once; later calls return the stored result.
    pub fn measure_whole(&self, index: usize, disc: &Hypothesis) -> MeasurementResult {
        if let Some(Some(known)) = self.whole.borrow().get(index) {
            return known.clone();
        }
        let measured =
            measure_hypothesis(self.image, self.blobs, disc, self.bounds, &self.candidates);
        if let Some(slot) = self.whole.borrow_mut().get_mut(index) {
            *slot = Some(measured.clone());
        }
        measured
    }
}

/// State of the strategies for one hypothesis.
struct StrategyRun<'a> {
    measurer: &'a Measurer<'a>,
    seen: &'a Hypothesis,
    /// Blob with its index, if the hypothesis is a disc from one blob of the frame without prior.
    blob: Option<(usize, &'a Blob)>,
    /// Disc completed under glare, if glare may hide a part of it.
    in_glare: OnceCell<Option<Hypothesis>>,
    answer: Option<MeasuredMarker>,
}

impl<'a> StrategyRun<'a> {
    fn new(measurer: &'a Measurer, seen: &'a Hypothesis) -> Self {
        let blob = match seen.blobs[..] {
            [index]
                if seen.pattern == MarkerPattern::Disc
                    && seen.prior == MarkerPrior::default()
                    && seen.excluded.is_empty() =>
            {
                measurer.blobs.get(index).map(|blob| (index, blob))
            }
            _ => None,
        };
        let blob = blob.filter(|(_, blob)| !blob.at_edge);
        Self {
            measurer,
            seen,
            blob,
            in_glare: OnceCell::new(),
            answer: None,
        }
    }

    /// Returns the strategies for the hypothesis.
    fn strategies(&self) -> &'static [Strategy] {
        match self.seen.pattern {
            MarkerPattern::Disc if self.blob.is_some() => &DISC_STRATEGIES,
            MarkerPattern::Disc => {
                const { &[Strategy::as_proposed(StrategyCondition::Unanswered)] }
            }
            _ => &QUADRANT_STRATEGIES,
        }
    }

    fn meets_condition(&self, condition: StrategyCondition) -> bool {
        let is_cut = || self.blob.is_some_and(|(_, blob)| whole::looks_cut(blob));
        match condition {
            StrategyCondition::Unanswered => self.answer.is_none(),
            StrategyCondition::Unsure => !self.has_sure_answer(),
            StrategyCondition::Whole => !is_cut(),
            StrategyCondition::CutOutsideGlare => {
                self.answer.is_none() && is_cut() && self.find_disc_in_glare().is_none()
            }
        }
    }

    fn has_sure_answer(&self) -> bool {
        self.answer.as_ref().is_some_and(MeasuredMarker::is_sure)
    }

    fn measure_proposed(&self, proposed: &Hypothesis) -> MeasurementResult {
        match self.blob {
            Some((index, _)) if proposed == self.seen => {
                self.measurer.measure_whole(index, proposed)
            }
            _ => {
                let Measurer {
                    image,
                    blobs,
                    bounds,
                    candidates: notes,
                    ..
                } = self.measurer;
                measure_hypothesis(image, blobs, proposed, *bounds, notes)
            }
        }
    }

    fn find_disc_in_glare(&self) -> Option<&Hypothesis> {
        let completed = |(_, blob)| glare_cut::complete_disc(self.measurer.image, self.seen, blob);
        self.in_glare
            .get_or_init(|| self.blob.and_then(completed))
            .as_ref()
    }
}
