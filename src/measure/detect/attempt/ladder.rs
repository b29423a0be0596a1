//! The ladder: what a hypothesis may be, in the order in which that is tried.

use std::cell::{OnceCell, RefCell};

use nalgebra::Vector2;

use crate::detect::accept::verdict::{MeasurementResult, MeasuredMarker};
use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::attempt::measure::{Bounds, SharedCandidates, measure, turn_down_at_once};
use crate::detect::attempt::whole;
use crate::detect::detection::RejectReason;
use crate::detect::hypothesis::{Hypothesis, prior::MarkerPrior};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::{decal, decal::ROW_DIRECTION, glare};
use crate::detect::propose::blurred_quadrants::resegment_against_skin;
use crate::detect::propose::{glare_cut, partial_ellipse, quadrant_outline};
use crate::detect::segment::blob::Blob;
use crate::raster::Raster;

/// When a rung is tried.
#[derive(Clone, Copy)]
enum StrategyCondition {
    /// No rung has answered.
    Unanswered,
    /// No rung has answered surely.
    Unsure,
    /// The blob looks whole.
    Whole,
    /// The blob looks cut, and no rung has answered.
    Cut,
    /// The same, and it ends in no glare.
    CutOutsideGlare,
}

/// Whether the size that the discs about it predict may help to measure it better.
#[derive(Clone, Copy)]
enum SizeNeed {
    /// It shows its size itself.
    Seen,
    /// Where it has answered with a twin's.
    OfTwin,
    /// Whether it has answered or not.
    Lacking,
}

/// One thing that a hypothesis may be.
struct Strategy {
    when: StrategyCondition,
    /// The hypothesis that is measured, if it may be that.
    propose: fn(&StrategyRun) -> Option<Hypothesis>,
    /// Whether its failure is the reason that is reported.
    tells_why: bool,
    size: SizeNeed,
}

impl Strategy {
    /// One that shows its size, and whose failure is not reported.
    const fn of(when: StrategyCondition, propose: fn(&StrategyRun) -> Option<Hypothesis>) -> Self {
        Self { when, propose, tells_why: false, size: SizeNeed::Seen }
    }

    const fn telling_why(self) -> Self {
        Self { tells_why: true, ..self }
    }

    const fn of_size(self, size: SizeNeed) -> Self {
        Self { size, ..self }
    }

    /// What was seen, as it is.
    const fn as_seen(when: StrategyCondition) -> Self {
        Self::of(when, |climb| Some(climb.seen.clone())).telling_why()
    }
}

/// Of quadrants.
const QUADRANTS: [Strategy; 3] = [
    // Black parts that were seen at two levels, seen at one.
    Strategy::of(StrategyCondition::Unanswered, |climb| {
        quadrant_outline::resegment_unequal(climb.ladder.image, climb.seen, climb.ladder.blobs)
    }),
    Strategy::as_seen(StrategyCondition::Unanswered),
    // Blurred ones, by black and white against the skin.
    Strategy::of(StrategyCondition::Unanswered, |climb| {
        resegment_against_skin(climb.ladder.image, climb.seen, climb.ladder.bounds.blur)
    }),
];

/// Of a blob that may be a disc.
const DISC: [Strategy; 5] = [
    Strategy::as_seen(StrategyCondition::Whole),
    // Glare hides an end of it, or crosses it: also where it looks whole and is measured badly.
    Strategy::of(StrategyCondition::Unsure, |climb| climb.in_glare().cloned()).telling_why().of_size(SizeNeed::Lacking),
    // Under a neighbour's decal that lies along rows or columns.
    Strategy::of(StrategyCondition::Cut, |climb| climb.under_decal(|_| ROW_DIRECTION)).telling_why().of_size(SizeNeed::OfTwin),
    // Under one that lies along the line in which the rim ends.
    Strategy::of(StrategyCondition::Cut, |climb| climb.under_slanted_decal()).of_size(SizeNeed::OfTwin),
    // Only its threshold cuts it, which followed a background that something beside it lowers, as a line at its tip does.
    Strategy::of(StrategyCondition::CutOutsideGlare, |climb| {
        climb.blob.and_then(|(i, blob)| whole::at_one_level(climb.ladder.image, blob, i))
    }),
];

/// What is measured, and in which picture.
pub struct Measurer<'a> {
    pub image: &'a Raster,
    pub blobs: &'a [Blob],
    pub bounds: Bounds,
    /// What tells of sharpening, while it is looked for.
    pub notes: SharedCandidates,
    /// What blobs measured as whole discs, each once.
    whole: RefCell<Vec<Option<MeasurementResult>>>,
}

/// What came of a hypothesis.
pub struct AttemptOutcome {
    pub measured: MeasurementResult,
    /// What it may be, where the size that the discs about it predict may help to measure it better.
    pub lacks_size: Option<Hypothesis>,
}

impl<'a> Measurer<'a> {
    /// In a picture in which nothing has been measured.
    pub fn new(image: &'a Raster, blobs: &'a [Blob], bounds: Bounds) -> Self {
        let whole = RefCell::new(vec![None; blobs.len()]);
        Self { image, blobs, bounds, notes: SharedCandidates::default(), whole }
    }

    /// The same with nothing remembered, for discs that are measured through the glare over them.
    pub fn through_glare(&self) -> Self {
        Self::new(self.image, self.blobs, Bounds { through_glare: true, ..self.bounds })
    }

    /// The answer for a hypothesis by the first rung that holds, or the reason why none does.
    pub fn measure(&self, seen: &Hypothesis) -> MeasurementResult {
        self.climb(seen).measured
    }

    /// The same with what may be measured better later.
    pub fn climb(&self, seen: &Hypothesis) -> AttemptOutcome {
        let mut climb = StrategyRun::of(self, seen);
        let (mut reason, mut lacks_size) = (RejectReason::NotAnEllipse, None);
        if climb.blob.is_some() && turn_down_at_once(self.blobs, seen) == Err(RejectReason::TooSmall) {
            return AttemptOutcome { measured: Err(RejectReason::TooSmall), lacks_size };
        }
        for rung in climb.rungs() {
            let due = climb.is_due(rung.when);
            let Some(proposed) = due.then(|| (rung.propose)(&climb)).flatten() else { continue };
            let measured = climb.measure(&proposed);
            lacks_size = match (rung.size, &measured) {
                (SizeNeed::Lacking, _) => Some(proposed),
                (SizeNeed::OfTwin, Ok(_)) => Some(proposed).filter(|hidden| hidden.prior.twin),
                (_, Ok(_)) => None,
                (_, Err(_)) => lacks_size,
            };
            match measured {
                Ok(measured) => climb.answer = Some(measured),
                Err(why) if rung.tells_why => reason = why,
                Err(_) => {}
            }
        }
        // What glare makes shorter may look whole and be told surely.
        if climb.blob.is_some() && climb.is_sure() && glare::ends_in_white(self.image, &seen.ellipse) {
            lacks_size = lacks_size.or_else(|| climb.in_glare().cloned());
        }
        AttemptOutcome { measured: climb.answer.ok_or(reason), lacks_size }
    }

    /// What the blob of a disc's hypothesis measures as a whole disc.
    pub fn measure_whole(&self, index: usize, disc: &Hypothesis) -> MeasurementResult {
        if let Some(Some(known)) = self.whole.borrow().get(index) {
            return known.clone();
        }
        let measured = measure(self.image, self.blobs, disc, self.bounds, &self.notes);
        if let Some(slot) = self.whole.borrow_mut().get_mut(index) {
            *slot = Some(measured.clone());
        }
        measured
    }
}

/// A hypothesis on its way up.
struct StrategyRun<'a> {
    ladder: &'a Measurer<'a>,
    seen: &'a Hypothesis,
    /// The blob of the frame that may be a disc of which nothing is known beforehand, with its index.
    blob: Option<(usize, &'a Blob)>,
    /// What it may be if glare hides a part of it.
    in_glare: OnceCell<Option<Hypothesis>>,
    answer: Option<MeasuredMarker>,
}

impl<'a> StrategyRun<'a> {
    fn of(ladder: &'a Measurer, seen: &'a Hypothesis) -> Self {
        let blob = match seen.blobs[..] {
            [index]
                if seen.pattern == MarkerPattern::Disc
                    && seen.prior == MarkerPrior::default()
                    && seen.excluded.is_empty() =>
            {
                ladder.blobs.get(index).map(|blob| (index, blob))
            }
            _ => None,
        };
        let blob = blob.filter(|(_, blob)| !blob.at_edge);
        Self { ladder, seen, blob, in_glare: OnceCell::new(), answer: None }
    }

    /// The rungs that it may take.
    fn rungs(&self) -> &'static [Strategy] {
        match self.seen.pattern {
            MarkerPattern::Disc if self.blob.is_some() => &DISC,
            MarkerPattern::Disc => const { &[Strategy::as_seen(StrategyCondition::Unanswered)] },
            _ => &QUADRANTS,
        }
    }

    fn is_due(&self, when: StrategyCondition) -> bool {
        let is_cut = || self.blob.is_some_and(|(_, blob)| whole::looks_cut(blob));
        match when {
            StrategyCondition::Unanswered => self.answer.is_none(),
            StrategyCondition::Unsure => !self.is_sure(),
            StrategyCondition::Whole => !is_cut(),
            StrategyCondition::Cut => self.answer.is_none() && is_cut(),
            StrategyCondition::CutOutsideGlare => self.is_due(StrategyCondition::Cut) && self.in_glare().is_none(),
        }
    }

    fn is_sure(&self) -> bool {
        self.answer.as_ref().is_some_and(MeasuredMarker::is_sure)
    }

    /// What a rung proposes measures.
    fn measure(&self, proposed: &Hypothesis) -> MeasurementResult {
        match self.blob {
            Some((index, _)) if proposed == self.seen => self.ladder.measure_whole(index, proposed),
            _ => {
                let Measurer { image, blobs, bounds, notes, .. } = self.ladder;
                measure(image, blobs, proposed, *bounds, notes)
            }
        }
    }

    fn in_glare(&self) -> Option<&Hypothesis> {
        let completed =
            |(index, _)| glare_cut::complete_disc(self.ladder.image, self.seen, index, self.ladder.blobs);
        self.in_glare.get_or_init(|| self.blob.and_then(completed)).as_ref()
    }

    /// The disc that neighbours' decals cut, each of which lies in a direction.
    fn under_decal(&self, direction: impl Fn(&Blob) -> Vector2<f64>) -> Option<Hypothesis> {
        partial_ellipse::complete_disc(self.seen, self.blob?.1, self.ladder.blobs, direction)
    }

    fn under_slanted_decal(&self) -> Option<Hypothesis> {
        let blob = self.blob?.1;
        let cut = |other: &Blob| {
            if partial_ellipse::is_ellipse(other) { decal::find_cut_direction(blob, &Ellipse::from_blob(other)) } else { None }
        };
        let hidden = self.under_decal(|other| cut(other).unwrap_or(ROW_DIRECTION))?;
        let is_slanted = hidden.decals().any(|decal| decal.axis != ROW_DIRECTION);
        (hidden.prior.twin && is_slanted).then_some(hidden)
    }
}
