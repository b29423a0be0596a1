//! A search of one picture: hypotheses in the order in which they are measured, then revised by their neighbours.

use crate::measure::detect::accept::consistency;
use crate::measure::detect::accept::found::Found;
use crate::measure::detect::accept::verdict::Measured;
use crate::measure::detect::attempt::measure::Bounds;
use crate::measure::detect::attempt::whole::{WholeDiscs, measure_whole_or_hidden};
use crate::measure::detect::detection::RejectReason;
use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::image::ellipse::Ellipse;
use crate::measure::detect::propose::gather::{self, Gathered};
use crate::measure::detect::propose::{blurred_quadrants, moments};
use crate::measure::detect::revise::neighbours::{
    find_against_one_level, is_unsure, revise_with_edge_prior, revise_with_size,
};
use crate::measure::detect::revise::under_decal::revise_under_decals;
use crate::measure::detect::scope::{self, Scope};
use crate::measure::detect::segment::blob::Blob;
use crate::measure::raster::Raster;
use crate::measure::setup::Shape;

/// Whether black is so light in some marker that farther ones may be too faint for the usual levels:
/// haze and stray light take contrast away with distance. Black on white leaves a quarter, at most two
/// fifths, of the grey. So few markers that nothing can be made of them may be all so faint.
pub fn is_faint(found: &Found) -> bool {
    /// Contrast over white or skin below which a marker is faint: black on white leaves 0.6 to 0.8.
    const LEAST: f64 = 0.45;
    /// Markers of which nothing can be made: an orientation needs four.
    const TOO_FEW: usize = 4;
    found.measured.len() < TOO_FEW || found.measured.iter().any(|m| m.darkness < LEAST && !m.through_glare)
}

/// A rough fit's blur is that of the last one to this factor. Chosen; `tests/detect/fixtures.rs`.
const MARGIN: f64 = 1.25;

/// In what order hypotheses are measured.
#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Quadrants,
    Narrow,
    Discs,
}

/// What a search has and knows.
struct Search<'a> {
    scope: Scope<'a>,
    /// The picture whose blobs these are.
    seen: &'a Raster,
    blobs: &'a [Blob],
    /// The first of them that no earlier search has looked at.
    first: usize,
    pairs: Vec<[usize; 2]>,
    discs: WholeDiscs<'a>,
    /// Of each blob whether it belongs to something that was measured.
    taken: Vec<bool>,
    found: Found,
    /// What may be hidden in part, with the place of what was measured so far.
    hidden: Vec<(Option<usize>, Hypothesis)>,
    /// What is too thin to tell blur and thickness apart.
    unsure: Vec<Hypothesis>,
}

impl Search<'_> {
    /// The hypotheses of a stage.
    fn hypotheses(&mut self, stage: Stage) -> Vec<Hypothesis> {
        let Self { scope, seen, blobs, first, pairs, discs, taken, found, .. } = self;
        match stage {
            Stage::Quadrants => gather::quadrants(seen, blobs, pairs, *first),
            Stage::Narrow => {
                let missing = scope.missing_quadrants(&found.measured);
                let wanted = |seen: &Ellipse| {
                    missing.as_ref().is_none_or(|missing| scope::may_show_part_of(seen, missing))
                };
                let (image, noise) = (discs.image, discs.bounds.noise);
                blurred_quadrants::narrow(image, (blobs, pairs), taken, noise, wanted, |i| {
                    discs.is_sure_disc(i)
                })
            }
            Stage::Discs => gather::discs(blobs, *first),
        }
    }

    /// Whether a hypothesis need not be measured.
    fn skips(&mut self, stage: Stage, hypothesis: &Hypothesis) -> bool {
        !self.scope.wants(hypothesis)
            || hypothesis.blobs.iter().any(|&i| self.taken[i])
            || self.scope.is_beside(hypothesis, &self.found.measured)
            || (stage == Stage::Quadrants && self.discs.are_discs(hypothesis))
    }

    /// Measures a hypothesis, and keeps what is found or why it is not.
    fn measure(&mut self, hypothesis: &Hypothesis) {
        let (measured, part) = measure_whole_or_hidden(&mut self.discs, hypothesis);
        let holds_discs =
            |m: &Measured| m.detection.shape == Shape::Quadrant && self.discs.hold_discs(&m.detection);
        let measured =
            if measured.as_ref().is_ok_and(holds_discs) { Err(RejectReason::Duplicate) } else { measured };
        let index = measured.is_ok().then_some(self.found.measured.len());
        self.hidden.extend(part.map(|part| (index, part)));
        match measured {
            Ok(measured) => {
                hypothesis.blobs.iter().for_each(|&i| self.taken[i] = true);
                self.found.measured.push(measured);
                let bounds = &mut self.discs.bounds;
                bounds.blur = consistency::softest(&self.found).map_or(bounds.blur, |b| MARGIN * b);
            }
            Err(reason) => {
                self.found.rejected.push(hypothesis.rejected(reason));
                self.unsure.extend(is_unsure(reason, hypothesis).then(|| hypothesis.clone()));
            }
        }
    }
}

/// What has come of a picture at the levels that were searched so far.
pub struct Progress {
    gathered: Gathered,
    /// Blobs whose hypotheses were measured.
    looked_at: usize,
    /// Beside what was measured, what neighbours that are found later may still tell.
    hidden: Vec<Hypothesis>,
    unsure: Vec<Hypothesis>,
    pub found: Found,
}

impl Progress {
    /// Nothing yet of a picture whose blobs are sought in the one that is seen.
    pub fn new(seen: &Raster, scope: Scope) -> Self {
        Self {
            gathered: Gathered::new(seen, scope.part(seen.width(), seen.height())),
            looked_at: 0,
            hidden: Vec::new(),
            unsure: Vec::new(),
            found: Found { measured: Vec::new(), rejected: Vec::new() },
        }
    }

    /// All stages, at the usual levels or at fainter ones too. What was looked at before is not measured again; what was measured
    /// stays.
    pub fn search(&mut self, (image, seen): (&Raster, &Raster), scope: Scope, noise: f64, faint: bool) {
        self.gathered.look(seen, faint);
        let blobs = self.gathered.blobs();
        let found = std::mem::replace(&mut self.found, Found { measured: Vec::new(), rejected: Vec::new() });
        let within = |blob: &Blob| found.holds(blob.centroid);
        let mut search = Search {
            scope,
            seen,
            blobs,
            first: self.looked_at,
            pairs: moments::pairs(blobs),
            discs: WholeDiscs::new(image, blobs, Bounds::of(noise)),
            taken: blobs.iter().map(within).collect(),
            found,
            hidden: self.hidden.drain(..).map(|hypothesis| (None, hypothesis)).collect(),
            unsure: std::mem::take(&mut self.unsure),
        };
        for stage in [Stage::Quadrants, Stage::Narrow, Stage::Discs] {
            for hypothesis in &search.hypotheses(stage) {
                if !search.skips(stage, hypothesis) {
                    search.measure(hypothesis);
                }
            }
        }
        self.looked_at = blobs.len();
        let Search { discs, mut found, hidden, unsure, .. } = search;
        self.hidden =
            hidden.iter().filter(|(at, _)| at.is_none()).map(|(_, hypothesis)| hypothesis.clone()).collect();
        self.unsure.clone_from(&unsure);
        let wanted = |hypothesis: &Hypothesis| scope.wants(hypothesis);
        revise_with_size(&discs, &mut found, hidden);
        revise_with_edge_prior(&discs, &mut found, unsure);
        revise_under_decals(&discs, &mut found, wanted);
        find_against_one_level(
            &discs,
            &mut found,
            (seen, self.gathered.coarse(), &self.gathered.uneven),
            wanted,
        );
        consistency::distinct(&mut found);
        self.found = found;
    }
}
