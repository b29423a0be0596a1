//! A search of one picture: hypotheses in the order in which they are measured, then revised by their neighbours.

use crate::detect::accept::{consistency, found::FoundMarkers, verdict::MeasuredMarker};
use crate::detect::attempt::ladder::{Measurer, AttemptOutcome};
use crate::detect::attempt::{measure::Bounds, sharpening, suspects::SharpeningCandidates};
use crate::detect::detection::{RejectReason, Rejected};
use crate::detect::estimate::overshoot::Sharpening;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::propose::gather::{self, BlobCollector};
use crate::detect::propose::{blurred_quadrants, moments};
use crate::detect::revise::neighbours::{
    find_against_one_level, is_unsure, revise_with_edge_prior, revise_with_size,
};
use crate::detect::revise::under_decal::revise_under_decals;
use crate::detect::scope::{self, Scope};
use crate::detect::segment::blob::Blob;
use crate::estimation::robust::median;
use crate::raster::Raster;
use crate::setup::Shape;

/// Whether a part of the markers shows so weakly in the reduced frame, whose blocks have a side of `factor` px, that others may
/// be too faint for the usual levels: haze and stray light take contrast away with distance. So few markers that nothing can be
/// made of them may be all so faint.
pub fn is_faint(found: &FoundMarkers, factor: usize) -> bool {
    /// Share of white or skin by which a marker's darkest block is darker, below which it is faint: two and a half times what
    /// passes the usual levels.
    const MIN_DARKNESS: f64 = 0.3;
    /// Markers of which nothing can be made: an orientation needs four.
    const TOO_FEW: usize = 4;
    /// Of so many one must be faint: a spot or a cap may be, among markers that are not. In haze half of them are.
    const ONE_OF: usize = 4;
    /// Share of the median size from which on a thing may be a marker that tells: dirt is smaller.
    const LARGE: f64 = 0.5;
    // What is thinner than a block takes a part of it only.
    let covered = |m: &MeasuredMarker| (2.0 * m.detection.semi_minor_px / factor as f64).min(1.0);
    let is_weak = |m: &&&MeasuredMarker| !m.through_glare && covered(m) * m.darkness < MIN_DARKNESS;
    let usual = median(found.measured.iter().map(|m| m.detection.semi_major_px).collect()).unwrap_or(0.0);
    let large: Vec<&MeasuredMarker> =
        found.measured.iter().filter(|m| m.detection.semi_major_px > LARGE * usual).collect();
    large.len() < TOO_FEW || large.iter().filter(is_weak).count() * ONE_OF > large.len()
}

/// A rough fit's blur is that of the last one to this factor. Chosen; `tests/detect/fixtures.rs`.
const MARGIN: f64 = 1.25;

/// In what order hypotheses are measured.
#[derive(Clone, Copy, PartialEq)]
enum SearchStage {
    Quadrants,
    Narrow,
    Discs,
}

/// What a search has and knows.
struct MarkerSearch<'a> {
    scope: Scope<'a>,
    /// The picture whose blobs these are.
    seen: &'a Raster,
    blobs: &'a [Blob],
    pairs: Vec<[usize; 2]>,
    ladder: Measurer<'a>,
    /// Of each blob whether it belongs to something that was measured.
    taken: Vec<bool>,
    found: FoundMarkers,
    /// What may be hidden in part, with the place of what was measured so far.
    hidden: Vec<(Option<usize>, Hypothesis)>,
    /// What is too thin to tell blur and thickness apart.
    unsure: Vec<Hypothesis>,
}

impl MarkerSearch<'_> {
    /// The hypotheses of a stage.
    fn hypotheses(&mut self, stage: SearchStage) -> Vec<Hypothesis> {
        let Self { scope, seen, blobs, pairs, ladder, taken, found, .. } = self;
        match stage {
            SearchStage::Quadrants => gather::quadrant_hypotheses(seen, ladder.bounds.noise, blobs, pairs),
            SearchStage::Narrow => {
                let missing = scope.missing_quadrants(&found.measured);
                let wanted = |seen: &Ellipse| {
                    missing.as_ref().is_none_or(|missing| scope::may_show_part_of(seen, missing))
                };
                let (image, noise) = (ladder.image, ladder.bounds.noise);
                let is_disc = |i| ladder.is_sure_disc(i);
                blurred_quadrants::find_narrow_quadrants(image, blobs, pairs, taken, noise, wanted, is_disc)
            }
            SearchStage::Discs => gather::disc_hypotheses(blobs),
        }
    }

    /// Whether a hypothesis need not be measured.
    fn skips(&mut self, stage: SearchStage, hypothesis: &Hypothesis) -> bool {
        !self.scope.wants(hypothesis)
            || hypothesis.blobs.iter().any(|&i| self.taken[i])
            || self.scope.is_beside(hypothesis, &self.found.measured)
            || (stage == SearchStage::Quadrants && self.ladder.are_discs(hypothesis))
    }

    /// Measures a hypothesis, and keeps what is found or why it is not.
    fn measure(&mut self, hypothesis: &Hypothesis) {
        let AttemptOutcome { measured, lacks_size } = self.ladder.climb(hypothesis);
        let holds_discs =
            |m: &MeasuredMarker| m.detection.shape == Shape::Quadrant && self.ladder.hold_discs(&m.detection);
        let measured =
            if measured.as_ref().is_ok_and(holds_discs) { Err(RejectReason::Duplicate) } else { measured };
        let index = measured.is_ok().then_some(self.found.measured.len());
        self.hidden.extend(lacks_size.map(|hidden| (index, hidden)));
        match measured {
            Ok(measured) => {
                hypothesis.blobs.iter().for_each(|&i| self.taken[i] = true);
                self.found.measured.push(measured);
                let bounds = &mut self.ladder.bounds;
                bounds.blur = consistency::blur_limit(&self.found).map_or(bounds.blur, |b| MARGIN * b);
            }
            Err(reason) => {
                self.found.rejected.push(Rejected::of(&hypothesis.ellipse, reason));
                self.unsure.extend(is_unsure(reason, hypothesis).then(|| hypothesis.clone()));
            }
        }
    }
}

/// How a picture is looked at.
#[derive(Clone, Copy)]
pub struct SearchOptions<'a> {
    /// What of it.
    pub scope: Scope<'a>,
    /// Noise of its grey values, grey levels.
    pub noise: f64,
    /// How it was sharpened, as far as its markers show it.
    pub sharpening: Sharpening,
    /// Whether places to some tenths of a pixel are enough, of what needs no second look.
    pub rough: bool,
}

/// What has come of a picture at the levels that were searched so far.
pub struct SearchProgress<'a> {
    image: &'a Raster,
    gathered: BlobCollector,
    pub look: SearchOptions<'a>,
    pub found: FoundMarkers,
}

impl<'a> SearchProgress<'a> {
    /// Nothing yet of a picture whose blobs are sought in the one that is seen.
    pub fn new(image: &'a Raster, seen: &Raster, look: SearchOptions<'a>) -> Self {
        let part = look.scope.part(seen.width(), seen.height());
        let gathered = BlobCollector::new(seen, part, look.scope.longest_px());
        Self { image, gathered, look, found: FoundMarkers::default() }
    }

    /// The same with other blobs: those of another part of the picture that is seen.
    pub fn within(self, seen: &Raster, scope: Scope<'a>) -> Self {
        let look = SearchOptions { scope, ..self.look };
        Self { found: self.found, ..Self::new(self.image, seen, look) }
    }

    /// All stages, at the usual levels or at fainter ones too. Blobs are sought where no earlier call has; what was measured
    /// stays, and what was turned down is measured once more, since more of its neighbours are known.
    /// Whether there was anything new to look at.
    pub fn search(&mut self, seen: &Raster, faint: bool) -> bool {
        if !self.gathered.search_levels(seen, faint) {
            return false;
        }
        let first = std::mem::take(&mut self.found.measured);
        let (found, suspects) = self.measured(seen, first);
        self.found = found;
        if self.look.sharpening == Sharpening::Undetermined {
            self.look.sharpening = sharpening::estimate_sharpening(suspects, self.image, self.look.noise);
            if let Sharpening::Sharpened(_) = self.look.sharpening {
                // All over again, with what is known now.
                self.found = self.measured(seen, Vec::new()).0;
            }
        }
        consistency::reject_blur_outliers(&mut self.found);
        consistency::reject_orientation_outliers(&mut self.found);
        consistency::reject_size_outliers(&mut self.found);
        true
    }

    /// What is found at the levels that were looked at, beside what was measured before; and what tells of sharpening.
    fn measured(&self, seen: &Raster, before: Vec<MeasuredMarker>) -> (FoundMarkers, SharpeningCandidates) {
        let SearchOptions { scope, noise, sharpening, rough } = self.look;
        let bounds = Bounds { overshoot: sharpening.overshoot(), rough, ..Bounds::of(noise) };
        let blobs = self.gathered.blobs();
        let found = FoundMarkers { measured: before, rejected: Vec::new() };
        let within = |blob: &Blob| found.contains(blob.centroid);
        let mut search = MarkerSearch {
            scope,
            seen,
            blobs,
            pairs: moments::find_pairs(blobs),
            ladder: Measurer::new(self.image, blobs, bounds),
            taken: blobs.iter().map(within).collect(),
            found,
            hidden: Vec::new(),
            unsure: Vec::new(),
        };
        for stage in [SearchStage::Quadrants, SearchStage::Narrow, SearchStage::Discs] {
            for hypothesis in &search.hypotheses(stage) {
                if !search.skips(stage, hypothesis) {
                    search.measure(hypothesis);
                }
            }
        }
        let MarkerSearch { ladder, mut found, hidden, unsure, .. } = search;
        if !rough {
            let wanted = |hypothesis: &Hypothesis| scope.wants(hypothesis);
            revise_with_size(&ladder, &mut found, hidden);
            revise_with_edge_prior(&ladder, &mut found, unsure);
            revise_under_decals(&ladder, &mut found, wanted);
            find_against_one_level(&ladder, &mut found, seen, &self.gathered, wanted);
        }
        consistency::reject_duplicates(&mut found);
        (found, ladder.notes.take())
    }
}
