//! All stages on one picture, in the order in which hypotheses are measured.

use crate::measure::detect::accept::found::Found;
use crate::measure::detect::accept::{consistency, verdict};
use crate::measure::detect::attempt::measure;
use crate::measure::detect::attempt::whole::{WholeDiscs, measure_whole_or_hidden};
use crate::measure::detect::detection::{Prediction, RejectReason};
use crate::measure::detect::hypothesis;
use crate::measure::detect::image::ellipse;
use crate::measure::detect::propose::{blurred_quadrants, gather, moments};
use crate::measure::detect::revise::neighbours::{
    find_against_one_level, is_unsure, revise_with_edge_prior, revise_with_size,
};
use crate::measure::detect::revise::under_decal::revise_under_decals;
use crate::measure::detect::scope;
use crate::measure::detect::segment::background::Part;
use crate::measure::detect::segment::{background, blob};
use crate::measure::raster::Raster;
use crate::measure::setup::Shape;

/// Whether black is so light in some marker that farther ones may be too faint for the usual levels:
/// haze and stray light take contrast away with distance. Black on white leaves a quarter, at most two
/// fifths, of the grey. So few markers that nothing can be made of them may be all so faint.
pub fn is_faint(found: &Found) -> bool {
    const LEAST: f64 = 0.45;
    const TOO_FEW: usize = 4;
    found.measured.len() < TOO_FEW || found.measured.iter().any(|m| m.darkness < LEAST && !m.through_glare)
}

/// A rough fit's blur is that of the last one to this factor.
const MARGIN: f64 = 1.25;

/// In what order hypotheses are measured.
#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Quadrants,
    Narrow,
    Discs,
}

/// All stages on one picture, whose blobs are sought in the one that is `seen`. What was measured before stays, and its
/// blobs are not looked at again.
pub fn search(
    image: &Raster,
    seen: &Raster,
    sought: Option<&[Prediction]>,
    noise: f64,
    faint: bool,
    before: Vec<verdict::Measured>,
) -> Found {
    let (width, height) = (image.width(), image.height());
    let part = sought.map_or_else(|| Part::all(width, height), |sought| scope::part(sought, width, height));
    let mut coarse = background::reduce(seen, part);
    let (blobs, uneven) = gather::find_blobs(seen, &mut coarse, faint);
    let pairs = moments::pairs(&blobs);
    let within = |blob: &blob::Blob| before.iter().any(|m| m.detection.ellipse().holds(blob.centroid));
    let mut taken: Vec<bool> = blobs.iter().map(within).collect();
    let mut whole = WholeDiscs::new(image, &blobs, measure::Bounds::of(noise));
    let mut found = Found { measured: before, rejected: Vec::new() };
    let wanted = |seen: &hypothesis::Hypothesis| sought.is_none_or(|sought| scope::is_near(seen, sought));
    let (mut hidden, mut unsure) = (Vec::new(), Vec::new());
    for stage in [Stage::Quadrants, Stage::Narrow, Stage::Discs] {
        let hypotheses = match stage {
            Stage::Quadrants => gather::quadrants(seen, &blobs, &pairs),
            Stage::Narrow => {
                let missing = sought.map(|sought| scope::missing_quadrants(&found.measured, sought));
                let open = |seen: &ellipse::Ellipse| {
                    missing.as_ref().is_none_or(|missing| scope::may_show_part_of(seen, missing))
                };
                blurred_quadrants::narrow(image, (&blobs, &pairs), &taken, noise, open, |i| {
                    whole.is_sure_disc(i)
                })
            }
            Stage::Discs => gather::discs(&blobs),
        };
        for hypothesis in &hypotheses {
            if !wanted(hypothesis) || hypothesis.blobs.iter().any(|&i| taken[i]) {
                continue;
            }
            if sought.is_some_and(|sought| scope::is_beside(hypothesis, sought, &found.measured)) {
                continue;
            }
            if stage == Stage::Quadrants && whole.are_discs(hypothesis) {
                continue;
            }
            let (measured, part) = measure_whole_or_hidden(&mut whole, hypothesis);
            let discs = |m: &verdict::Measured| {
                m.detection.shape == Shape::Quadrant && whole.hold_discs(&m.detection)
            };
            let measured =
                if measured.as_ref().is_ok_and(discs) { Err(RejectReason::Duplicate) } else { measured };
            let index = measured.is_ok().then_some(found.measured.len());
            hidden.extend(part.map(|part| (index, part)));
            match measured {
                Ok(measured) => {
                    hypothesis.blobs.iter().for_each(|&i| taken[i] = true);
                    found.measured.push(measured);
                    whole.bounds.blur =
                        consistency::softest(&found).map_or(whole.bounds.blur, |b| MARGIN * b);
                }
                Err(reason) => {
                    found.rejected.push(hypothesis.rejected(reason));
                    unsure.extend(is_unsure(reason, hypothesis).then(|| hypothesis.clone()));
                }
            }
        }
    }
    revise_with_size(&whole, &mut found, hidden);
    revise_with_edge_prior(&whole, &mut found, unsure);
    revise_under_decals(&whole, &mut found, wanted);
    find_against_one_level(&whole, &mut found, (seen, &coarse, &uneven), wanted);
    consistency::distinct(&mut found);
    found
}
