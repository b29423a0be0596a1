//! A search of one picture: hypotheses in the order in which they are measured, then revised by their neighbours.

use crate::measure::detect::accept::consistency;
use crate::measure::detect::accept::found::Found;
use crate::measure::detect::accept::verdict::Measured;
use crate::measure::detect::attempt::measure::Bounds;
use crate::measure::detect::attempt::whole::{WholeDiscs, measure_whole_or_hidden};
use crate::measure::detect::detection::RejectReason;
use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::image::ellipse::Ellipse;
use crate::measure::detect::propose::{blurred_quadrants, gather, moments};
use crate::measure::detect::revise::neighbours::{
    find_against_one_level, is_unsure, revise_with_edge_prior, revise_with_size,
};
use crate::measure::detect::revise::under_decal::revise_under_decals;
use crate::measure::detect::scope::{self, Scope};
use crate::measure::detect::segment::background;
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
        let Self { scope, seen, blobs, pairs, discs, taken, found, .. } = self;
        match stage {
            Stage::Quadrants => gather::quadrants(seen, blobs, pairs),
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
            Stage::Discs => gather::discs(blobs),
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

/// All stages on a picture, whose blobs are sought in the one that is seen. What was measured before stays, and its blobs are
/// not looked at again.
pub fn search(
    (image, seen): (&Raster, &Raster),
    scope: Scope,
    noise: f64,
    faint: bool,
    before: Vec<Measured>,
) -> Found {
    let mut coarse = background::reduce(seen, scope.part(image.width(), image.height()));
    let (blobs, uneven) = gather::find_blobs(seen, &mut coarse, faint);
    let within = |blob: &Blob| before.iter().any(|m| m.detection.ellipse().holds(blob.centroid));
    let mut search = Search {
        scope,
        seen,
        blobs: &blobs,
        pairs: moments::pairs(&blobs),
        discs: WholeDiscs::new(image, &blobs, Bounds::of(noise)),
        taken: blobs.iter().map(within).collect(),
        found: Found { measured: before, rejected: Vec::new() },
        hidden: Vec::new(),
        unsure: Vec::new(),
    };
    for stage in [Stage::Quadrants, Stage::Narrow, Stage::Discs] {
        for hypothesis in &search.hypotheses(stage) {
            if !search.skips(stage, hypothesis) {
                search.measure(hypothesis);
            }
        }
    }
    let Search { discs, mut found, hidden, unsure, .. } = search;
    let wanted = |hypothesis: &Hypothesis| scope.wants(hypothesis);
    revise_with_size(&discs, &mut found, hidden);
    revise_with_edge_prior(&discs, &mut found, unsure);
    revise_under_decals(&discs, &mut found, wanted);
    find_against_one_level(&discs, &mut found, (seen, &coarse, &uneven), wanted);
    consistency::distinct(&mut found);
    found
}
