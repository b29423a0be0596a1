//! The ladder: what a hypothesis may be, in the order in which that is tried.

use std::cell::{OnceCell, RefCell};

use nalgebra::Vector2;

use crate::measure::detect::accept::verdict::Measured;
use crate::measure::detect::appearance::parameters::Pattern;
use crate::measure::detect::attempt::measure::{Bounds, is_too_small, measure};
use crate::measure::detect::attempt::whole;
use crate::measure::detect::detection::RejectReason;
use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::hypothesis::prior::Prior;
use crate::measure::detect::image::ellipse::Ellipse;
use crate::measure::detect::occlusion::decal::ROWS;
use crate::measure::detect::occlusion::{decal, glare};
use crate::measure::detect::propose::blurred_quadrants::against_skin;
use crate::measure::detect::propose::{glare_cut, partial_ellipse, quadrant_outline};
use crate::measure::detect::segment::blob::Blob;
use crate::measure::raster::Raster;

/// When a rung is tried.
#[derive(Clone, Copy)]
enum When {
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
enum Size {
    /// It tells its size itself.
    Told,
    /// Where it has answered with a twin's.
    OfTwin,
    /// Whether it has answered or not.
    Lacking,
}

/// One thing that a hypothesis may be.
struct Rung {
    when: When,
    /// The hypothesis that is measured, if it may be that.
    propose: fn(&Climb) -> Option<Hypothesis>,
    /// Whether its failure is the reason that is reported.
    tells_why: bool,
    size: Size,
}

/// Of quadrants.
const QUADRANTS: [Rung; 3] = [
    // Black parts that were seen at two levels, seen at one.
    Rung {
        when: When::Unanswered,
        propose: |climb| quadrant_outline::at_one_level(climb.ladder.image, climb.seen, climb.ladder.blobs),
        tells_why: false,
        size: Size::Told,
    },
    AS_SEEN,
    // Blurred ones, by black and white against the skin.
    Rung {
        when: When::Unanswered,
        propose: |climb| against_skin(climb.ladder.image, climb.seen, climb.ladder.bounds.blur),
        tells_why: false,
        size: Size::Told,
    },
];

/// What was seen, as it is.
const AS_SEEN: Rung = Rung {
    when: When::Unanswered,
    propose: |climb| Some(climb.seen.clone()),
    tells_why: true,
    size: Size::Told,
};

/// Of a blob that may be a disc.
const DISC: [Rung; 5] = [
    Rung { when: When::Whole, ..AS_SEEN },
    // Glare hides an end of it, or crosses it: also where it looks whole and is measured badly.
    Rung {
        when: When::Unsure,
        propose: |climb| climb.in_glare().cloned(),
        tells_why: true,
        size: Size::Lacking,
    },
    // Under a neighbour's decal that lies along rows or columns.
    Rung {
        when: When::Cut,
        propose: |climb| climb.under_decal(|_| ROWS),
        tells_why: true,
        size: Size::OfTwin,
    },
    // Under one that lies along the line in which the rim ends.
    Rung {
        when: When::Cut,
        propose: |climb| climb.under_slanted_decal(),
        tells_why: false,
        size: Size::OfTwin,
    },
    // Only its threshold cuts it, which followed a background that something beside it lowers, as a line at its tip does.
    Rung {
        when: When::CutOutsideGlare,
        propose: |climb| climb.blob.and_then(|(i, blob)| whole::at_one_level(climb.ladder.image, blob, i)),
        tells_why: false,
        size: Size::Told,
    },
];

/// What is measured, and in which picture.
pub struct Ladder<'a> {
    pub image: &'a Raster,
    pub blobs: &'a [Blob],
    pub bounds: Bounds,
    /// What blobs measured as whole discs, each once.
    whole: RefCell<Vec<Option<Result<Measured, RejectReason>>>>,
}

/// What came of a hypothesis.
pub struct Outcome {
    pub measured: Result<Measured, RejectReason>,
    /// What it may be, where the size that the discs about it predict may help to measure it better.
    pub lacks_size: Option<Hypothesis>,
}

impl<'a> Ladder<'a> {
    /// In a picture in which nothing has been measured.
    pub fn new(image: &'a Raster, blobs: &'a [Blob], bounds: Bounds) -> Self {
        Self { image, blobs, bounds, whole: RefCell::new(vec![None; blobs.len()]) }
    }

    /// The same with nothing remembered, for discs that are measured through the glare over them.
    pub fn through_glare(&self) -> Self {
        Self::new(self.image, self.blobs, Bounds { through_glare: true, ..self.bounds })
    }

    /// The answer for a hypothesis by the first rung that holds, or the reason why none does.
    pub fn measure(&self, seen: &Hypothesis) -> Result<Measured, RejectReason> {
        self.climb(seen).measured
    }

    /// The same with what may be measured better later.
    pub fn climb(&self, seen: &Hypothesis) -> Outcome {
        let mut climb = Climb::of(self, seen);
        if climb.blob.is_some() && is_too_small(&seen.ellipse) {
            return Outcome { measured: Err(RejectReason::TooSmall), lacks_size: None };
        }
        let (mut reason, mut lacks_size) = (RejectReason::NotAnEllipse, None);
        for rung in climb.rungs() {
            let due = climb.is_due(rung.when);
            let Some(proposed) = due.then(|| (rung.propose)(&climb)).flatten() else { continue };
            let measured = climb.measure(&proposed);
            lacks_size = match (rung.size, &measured) {
                (Size::Lacking, _) => Some(proposed),
                (Size::OfTwin, Ok(_)) => Some(proposed).filter(|hidden| hidden.prior.twin),
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
        Outcome { measured: climb.answer.ok_or(reason), lacks_size }
    }

    /// What the blob of a disc's hypothesis measures as a whole disc.
    pub fn measure_whole(&self, index: usize, disc: &Hypothesis) -> Result<Measured, RejectReason> {
        if let Some(Some(known)) = self.whole.borrow().get(index) {
            return known.clone();
        }
        let measured = measure(self.image, self.blobs, disc, self.bounds);
        if let Some(slot) = self.whole.borrow_mut().get_mut(index) {
            *slot = Some(measured.clone());
        }
        measured
    }
}

/// A hypothesis on its way up.
struct Climb<'a> {
    ladder: &'a Ladder<'a>,
    seen: &'a Hypothesis,
    /// The blob of the frame that may be a disc of which nothing is known beforehand, with its index.
    blob: Option<(usize, &'a Blob)>,
    /// What it may be if glare hides a part of it.
    in_glare: OnceCell<Option<Hypothesis>>,
    answer: Option<Measured>,
}

impl<'a> Climb<'a> {
    fn of(ladder: &'a Ladder, seen: &'a Hypothesis) -> Self {
        let blob = match seen.blobs[..] {
            [index]
                if seen.pattern == Pattern::Disc
                    && seen.prior == Prior::default()
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
    fn rungs(&self) -> &'static [Rung] {
        match self.seen.pattern {
            Pattern::Disc if self.blob.is_some() => &DISC,
            Pattern::Disc => const { &[AS_SEEN] },
            _ => &QUADRANTS,
        }
    }

    fn is_due(&self, when: When) -> bool {
        let is_cut = || self.blob.is_some_and(|(_, blob)| whole::looks_cut(blob));
        match when {
            When::Unanswered => self.answer.is_none(),
            When::Unsure => !self.is_sure(),
            When::Whole => !is_cut(),
            When::Cut => self.answer.is_none() && is_cut(),
            When::CutOutsideGlare => self.is_due(When::Cut) && self.in_glare().is_none(),
        }
    }

    fn is_sure(&self) -> bool {
        self.answer.as_ref().is_some_and(Measured::is_sure)
    }

    /// What a rung proposes measures.
    fn measure(&self, proposed: &Hypothesis) -> Result<Measured, RejectReason> {
        match self.blob {
            Some((index, _)) if proposed == self.seen => self.ladder.measure_whole(index, proposed),
            _ => measure(self.ladder.image, self.ladder.blobs, proposed, self.ladder.bounds),
        }
    }

    fn in_glare(&self) -> Option<&Hypothesis> {
        let completed =
            |(index, _)| glare_cut::completed(self.ladder.image, self.seen, index, self.ladder.blobs);
        self.in_glare.get_or_init(|| self.blob.and_then(completed)).as_ref()
    }

    /// The disc that neighbours' decals cut, each of which lies in a direction.
    fn under_decal(&self, direction: impl Fn(&Blob) -> Vector2<f64>) -> Option<Hypothesis> {
        partial_ellipse::completed(self.seen, self.blob?.1, self.ladder.blobs, direction)
    }

    fn under_slanted_decal(&self) -> Option<Hypothesis> {
        let blob = self.blob?.1;
        let cut = |other: &Blob| {
            if partial_ellipse::is_ellipse(other) { decal::cut(blob, &Ellipse::of(other)) } else { None }
        };
        let hidden = self.under_decal(|other| cut(other).unwrap_or(ROWS))?;
        let is_slanted = hidden.decals().any(|decal| decal.axis != ROWS);
        (hidden.prior.twin && is_slanted).then_some(hidden)
    }
}
