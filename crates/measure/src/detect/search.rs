//! Search of one image: measures hypotheses in a fixed order, then revises them with their neighbours.

use crate::detect::accept::{consistency, found::FoundMarkers, verdict::MeasuredMarker};
use crate::detect::attempt::strategies::{AttemptOutcome, Measurer};
use crate::detect::attempt::{
    measure::Bounds, sharpening, sharpening_candidates::SharpeningCandidates,
};
use crate::detect::detection::{RejectReason, Rejected};
use crate::detect::estimate::overshoot::Sharpening;
use crate::detect::hypothesis::{Hypothesis, options::NEIGHBOURS};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::MIN_GROUP;
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

/// Returns whether enough markers are weak in the reduced frame, whose blocks have a side of `factor` px, that others may
/// be too faint for the default thresholds: haze and stray light reduce contrast with distance. Too few markers for an
/// orientation count as faint.
pub fn is_faint(found: &FoundMarkers, factor: usize) -> bool {
    /// Darkness of a marker's darkest block, as a fraction of white or skin, below which it is faint: 2.5 times the
    /// smallest that passes the default thresholds.
    const MIN_DARKNESS: f64 = 0.3;
    /// Reciprocal of the fraction of faint markers from which on the frame is faint: a spot or a cap may be faint among
    /// normal markers. In haze half of them are.
    const FAINT_ONE_IN: usize = 4;
    // A marker thinner than a block covers only a part of it.
    let covered = |m: &MeasuredMarker| (2.0 * m.detection.semi_minor_px / factor as f64).min(1.0);
    let is_weak = |m: &&&MeasuredMarker| !m.through_glare && covered(m) * m.darkness < MIN_DARKNESS;
    let median_size = median(
        found
            .measured
            .iter()
            .map(|m| m.detection.semi_major_px)
            .collect(),
    )
    .unwrap_or(0.0);
    let large: Vec<&MeasuredMarker> = found
        .measured
        .iter()
        .filter(|m| m.detection.semi_major_px > NEIGHBOURS.min_relative_size * median_size)
        .collect();
    large.len() < MIN_GROUP || large.iter().filter(is_weak).count() * FAINT_ONE_IN > large.len()
}

/// Order in which hypotheses are measured.
#[derive(Clone, Copy, PartialEq)]
enum SearchStage {
    Quadrants,
    Narrow,
    Discs,
}

/// State of a search.
struct MarkerSearch<'a> {
    scope: Scope<'a>,
    /// Image in which the blobs were segmented.
    seen: &'a Raster,
    blobs: &'a [Blob],
    pairs: Vec<[usize; 2]>,
    measurer: Measurer<'a>,
    /// True for each blob that belongs to a measured marker.
    taken: Vec<bool>,
    found: FoundMarkers,
    /// Hypotheses that may be partly hidden, with the index of their measurement.
    hidden: Vec<(Option<usize>, Hypothesis)>,
    /// Hypotheses too thin to separate blur and thickness.
    unsure: Vec<Hypothesis>,
}

impl MarkerSearch<'_> {
    fn stage_hypotheses(&mut self, stage: SearchStage) -> Vec<Hypothesis> {
        let Self {
            scope,
            seen,
            blobs,
            pairs,
            measurer,
            taken,
            found,
            ..
        } = self;
        match stage {
            SearchStage::Quadrants => {
                gather::quadrant_hypotheses(seen, measurer.bounds.noise, blobs, pairs)
            }
            SearchStage::Narrow => {
                let missing = scope.missing_quadrants(&found.measured);
                let is_included = |seen: &Ellipse| {
                    missing
                        .as_ref()
                        .is_none_or(|missing| scope::may_show_part_of(seen, missing))
                };
                let (image, noise) = (measurer.image, measurer.bounds.noise);
                let is_disc = |i| measurer.is_sure_disc(i);
                blurred_quadrants::find_narrow_quadrants(
                    image,
                    blobs,
                    pairs,
                    taken,
                    noise,
                    is_included,
                    is_disc,
                )
            }
            SearchStage::Discs => gather::disc_hypotheses(blobs),
        }
    }

    /// Returns whether a hypothesis need not be measured.
    fn skips(&self, hypothesis: &Hypothesis) -> bool {
        !self.scope.includes(hypothesis)
            || hypothesis.blobs.iter().any(|&i| self.taken[i])
            || self.scope.is_explained(hypothesis, &self.found.measured)
    }

    /// Measures a hypothesis and stores the marker or the reason for its rejection.
    fn measure(&mut self, hypothesis: &Hypothesis) {
        let AttemptOutcome {
            measured,
            needs_size,
        } = self.measurer.try_strategies(hypothesis);
        let holds_discs = |m: &MeasuredMarker| {
            m.detection.shape == Shape::Quadrant && self.measurer.contain_discs(&m.detection)
        };
        let measured = if measured.as_ref().is_ok_and(holds_discs) {
            Err(RejectReason::Duplicate)
        } else {
            measured
        };
        let index = measured.is_ok().then_some(self.found.measured.len());
        self.hidden.extend(needs_size.map(|hidden| (index, hidden)));
        match measured {
            Ok(measured) => {
                hypothesis.blobs.iter().for_each(|&i| self.taken[i] = true);
                self.found.measured.push(measured);
            }
            Err(reason) => {
                self.found
                    .rejected
                    .push(Rejected::from_ellipse(&hypothesis.ellipse, reason));
                self.unsure
                    .extend(is_unsure(reason, hypothesis).then(|| hypothesis.clone()));
            }
        }
    }
}

/// Options of a search.
#[derive(Clone, Copy)]
pub struct SearchOptions<'a> {
    pub scope: Scope<'a>,
    /// Standard deviation of the noise, grey levels.
    pub noise: f64,
    /// Sharpening of the image, as far as its markers have shown it.
    pub sharpening: Sharpening,
    /// True if positions to some 0.1 px, of markers that need no second pass, are sufficient.
    pub rough: bool,
}

/// State of an image at the thresholds that were searched so far.
pub struct SearchProgress<'a> {
    image: &'a Raster,
    gathered: BlobCollector,
    pub options: SearchOptions<'a>,
    pub found: FoundMarkers,
}

impl<'a> SearchProgress<'a> {
    /// Creates a search of `image` without results; `seen` is the image in which blobs are segmented.
    pub fn new(image: &'a Raster, seen: &Raster, options: SearchOptions<'a>) -> Self {
        let part = options.scope.search_area(seen.width(), seen.height());
        let gathered = BlobCollector::new(seen, part, options.scope.longest_px());
        Self {
            image,
            gathered,
            options,
            found: FoundMarkers::default(),
        }
    }

    /// Returns the search with its results for another part of the segmented image.
    pub fn with_scope(self, seen: &Raster, scope: Scope<'a>) -> Self {
        let options = SearchOptions {
            scope,
            ..self.options
        };
        Self {
            found: self.found,
            ..Self::new(self.image, seen, options)
        }
    }

    /// Runs all stages, at the default thresholds or also at lower ones. Only regions not covered by an earlier call are
    /// segmented; measured markers stay, and rejected hypotheses are measured again, because more of their neighbours are
    /// known. Returns whether there was anything new.
    pub fn search(&mut self, seen: &Raster, faint: bool) -> bool {
        if !self.gathered.search_levels(seen, faint) {
            return false;
        }
        let first = std::mem::take(&mut self.found.measured);
        let (found, candidates) = self.run_stages(seen, first);
        self.found = found;
        if self.options.sharpening == Sharpening::Undetermined {
            self.options.sharpening =
                sharpening::estimate_sharpening(candidates, self.image, self.options.noise);
            if let Sharpening::Sharpened(_) = self.options.sharpening {
                // The search is repeated with the estimated sharpening.
                self.found = self.run_stages(seen, Vec::new()).0;
            }
        }
        consistency::reject_blur_outliers(&mut self.found);
        consistency::reject_orientation_outliers(&mut self.found);
        consistency::reject_size_outliers(&mut self.found);
        true
    }

    /// Runs the stages at the thresholds searched so far, in addition to previous measurements. Also returns the candidates
    /// for the estimation of sharpening.
    fn run_stages(
        &self,
        seen: &Raster,
        before: Vec<MeasuredMarker>,
    ) -> (FoundMarkers, SharpeningCandidates) {
        let SearchOptions {
            scope,
            noise,
            sharpening,
            rough,
        } = self.options;
        let bounds = Bounds {
            overshoot: sharpening.overshoot(),
            rough,
            ..Bounds::from_noise(noise)
        };
        let blobs = self.gathered.blobs();
        let found = FoundMarkers {
            measured: before,
            rejected: Vec::new(),
        };
        let within = |blob: &Blob| found.contains(blob.centroid);
        let mut search = MarkerSearch {
            scope,
            seen,
            blobs,
            pairs: moments::find_pairs(blobs),
            measurer: Measurer::new(self.image, blobs, bounds),
            taken: blobs.iter().map(within).collect(),
            found,
            hidden: Vec::new(),
            unsure: Vec::new(),
        };
        for stage in [
            SearchStage::Quadrants,
            SearchStage::Narrow,
            SearchStage::Discs,
        ] {
            for hypothesis in &search.stage_hypotheses(stage) {
                if !search.skips(hypothesis) {
                    search.measure(hypothesis);
                }
            }
        }
        let MarkerSearch {
            measurer,
            mut found,
            hidden,
            unsure,
            ..
        } = search;
        if !rough {
            let is_included = |hypothesis: &Hypothesis| scope.includes(hypothesis);
            revise_with_size(&measurer, &mut found, hidden);
            revise_with_edge_prior(&measurer, &mut found, unsure);
            revise_under_decals(&measurer, &mut found, is_included);
            find_against_one_level(&measurer, &mut found, seen, &self.gathered, is_included);
        }
        consistency::reject_duplicates(&mut found);
        (found, measurer.candidates.take())
    }
}
