//! A hypothesis's pixels and the fit.

use std::cell::RefCell;

use nalgebra::{Matrix2, Vector2};

use crate::detect::accept::verdict::{MeasurementResult, MeasuredMarker, fits_poorly, judge_fit};
use crate::detect::accept::{better::is_preferred, consistency::is_out_of_focus, options::VERDICT};
use crate::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, GAMMA, LIGHT, MAJOR, MINOR, N, OVERSHOOT, MarkerParameters, MarkerPattern, SAG, TANGENT, X, Y,
    contrast,
};
use crate::detect::attempt::options::MEASURE;
use crate::detect::attempt::suspects::{SharpeningCandidate, SharpeningCandidates};
use crate::detect::detection::{Overshoot, RejectReason, covariance::CovarianceSource};
use crate::detect::estimate::gauss_newton::{MarkerFit, fit_final, fit_coarse};
use crate::detect::estimate::options::{PRIOR, WEIGHT};
use crate::detect::estimate::overshoot;
use crate::detect::estimate::prior::{darkness_for_grey_ratio, coarse_unknowns, select_unknowns, fix_fine_light};
use crate::detect::estimate::terms::{glare_spline, veiling_glare};
use crate::detect::estimate::{lack_of_fit, outlined_quadrants};
use crate::detect::hypothesis::{EdgePair, Hypothesis, prior::MarkerPrior};
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::occlusion::region::{OcclusionBand, Region};
use crate::detect::occlusion::{glare, paint, seam};
use crate::detect::propose::quadrant_outline::{refine_outline, fit_outline_and_edges};
use crate::detect::propose::reduced::ReducedImage;
use crate::detect::sample::pixels::Pixels;
use crate::detect::sample::select::{COARSE, EdgeAppearance, FINAL, PixelExclusion, PixelBudget, UNLIMITED, select_pixels};
use crate::detect::segment::blob::Blob;
use crate::raster::Raster;
use crate::setup::Shape;

/// What a frame's markers can be like.
#[derive(Clone, Copy)]
pub struct Bounds {
    /// Standard deviation of the grey values' noise, grey levels.
    pub noise: f64,
    /// Greatest blur, px.
    pub blur: f64,
    /// Whether discs are measured through the glare that lies over them.
    pub through_glare: bool,
    /// How the frame was sharpened.
    pub overshoot: Option<Overshoot>,
    /// Whether a place to some tenths of a pixel is enough.
    pub rough: bool,
}

impl Bounds {
    /// Of a frame in which nothing has been measured.
    pub fn of(noise: f64) -> Self {
        Self { noise, blur: VERDICT.softest_px, through_glare: false, overshoot: None, rough: false }
    }
}

/// What tells of sharpening, while it is looked for.
pub type SharedCandidates = RefCell<SharpeningCandidates>;

/// Fits the model to a hypothesis, and judges the answer; notes what it shows of sharpening where that is not known.
pub fn measure(
    image: &Raster,
    blobs: &[Blob],
    hypothesis: &Hypothesis,
    bounds: Bounds,
    notes: &SharedCandidates,
) -> MeasurementResult {
    turn_down_at_once(blobs, hypothesis)?;
    let attempt = FitAttempt { image, blobs, hypothesis, bounds, notes, floor: least_scale(bounds.noise) };
    let (near, scale) = attempt.first_fit()?;
    // A rough fit leaves at most twice what the last one may.
    if fits_poorly(image, hypothesis, 0.5 * scale, bounds.noise, (contrast(&near), near[OVERSHOOT])) {
        attempt.note(&place(hypothesis, &near), &near, scale, false);
        return Err(RejectReason::PoorFit);
    }
    if near[BLUR] > bounds.blur && !may_be_out_of_focus(hypothesis, near[BLUR]) {
        return Err(RejectReason::BlurOutlier);
    }
    let mut place = refine_outline(image, place(hypothesis, &near), &near);
    if let Some((found, m)) = fit_outline_and_edges(image, &place, &near) {
        let answer = attempt.with_outline(&found, &m, scale);
        if matches!(answer, Ok(_) | Err(RejectReason::Pattern)) {
            return answer;
        }
        place = found;
    }
    if bounds.rough {
        return judge_fit(image, &place, &MarkerFit::from_coarse(near, scale, MEASURE.rough_px), bounds.noise);
    }
    let tells = !place.is_in_glare() || place.prior.tells_all_of_size();
    if place.pattern == MarkerPattern::Disc && !place.is_under_decal() && tells {
        let least = scale.max(attempt.floor);
        let seams = seam::find_seams(image, &place.ellipse, &near, least).into_iter().map(Region::Seam);
        let paint = paint::find_painted_end(image, &place.ellipse, &near, least).map(Region::Paint);
        let mut without = place.clone();
        without.excluded.extend(seams.chain(paint));
        if without.excluded.len() > place.excluded.len() {
            let without = attempt.last_fit(&without, &near, scale);
            if without.is_ok() {
                return without;
            }
            // What is left may be too little; with these pixels it is at least found.
        }
    }
    attempt.last_fit(&place, &near, scale)
}

/// Whether a blur may be that of a marker out of focus, whatever the frame's others have.
fn may_be_out_of_focus(hypothesis: &Hypothesis, blur: f64) -> bool {
    let shape = if hypothesis.pattern == MarkerPattern::Disc { Shape::Circle } else { Shape::Quadrant };
    is_out_of_focus(shape, hypothesis.ellipse.minor, blur) && blur < VERDICT.softest_px
}

/// What need not be fitted to be turned down.
pub fn turn_down_at_once(blobs: &[Blob], hypothesis: &Hypothesis) -> Result<(), RejectReason> {
    let ellipse = &hypothesis.ellipse;
    if hypothesis.blobs.iter().any(|&i| blobs.get(i).is_some_and(|b| b.at_edge)) {
        return Err(RejectReason::TouchesEdge);
    }
    if ellipse.major < MEASURE.least_px[0] || ellipse.minor < MEASURE.least_px[1] {
        return Err(RejectReason::TooSmall);
    }
    if hypothesis.prior.size.is_none() && ellipse.major > MEASURE.surely_flatter * ellipse.minor {
        return Err(RejectReason::NotAnEllipse);
    }
    Ok(())
}

/// A hypothesis on its way to an answer.
struct FitAttempt<'a> {
    image: &'a Raster,
    blobs: &'a [Blob],
    hypothesis: &'a Hypothesis,
    bounds: Bounds,
    notes: &'a SharedCandidates,
    /// Least scale of residuals, grey levels.
    floor: f64,
}

impl FitAttempt<'_> {
    /// The first geometry, with its residuals' scale.
    fn first_fit(&self) -> Result<(MarkerParameters, f64), RejectReason> {
        let Self { image, blobs, hypothesis, bounds, floor, .. } = *self;
        let few = if hypothesis.is_under_decal() { UNLIMITED } else { COARSE };
        let known = hypothesis.prior.edge.map(|edge| edge.blur.value).or(hypothesis.prior.blur);
        let blur = known.unwrap_or(MEASURE.blur_px);
        let first = |look: EdgeAppearance| {
            roughly(image, PixelExclusion::Blobs(blobs), hypothesis, (look, bounds.overshoot), few, floor)
        };
        let look = EdgeAppearance { crossing: hypothesis.ellipse.centre, blur, sag: 0.0 };
        first(look).or_else(|reason| {
            let crossing = crossing_in_small(image, hypothesis, floor).ok_or(reason)?;
            let soft = EdgeAppearance { crossing, blur: MEASURE.soft_px, ..look };
            first(EdgeAppearance { crossing, ..look }).or_else(|_| first(soft))
        })
    }

    /// The answer at a place that the first geometry told, whose residuals had some scale.
    fn last_fit(&self, place: &Hypothesis, near: &MarkerParameters, scale: f64) -> MeasurementResult {
        let Self { image, blobs, hypothesis, bounds, floor, .. } = *self;
        // What is known of a disc from a twin beside it is known beforehand.
        let (mut unknowns, bends) = select_unknowns(if hypothesis.prior.twin { hypothesis } else { place });
        unknowns.free[GAMMA] &= contrast(near) > MEASURE.tells_gamma * near[LIGHT];
        bounds.overshoot.iter().for_each(|known| overshoot::add_overshoot_prior(known, &mut unknowns));
        let whole = !hypothesis.is_under_decal();
        let (masked, all) =
            if whole { (darker_than(near, floor), FINAL) } else { (PixelExclusion::Blobs(blobs), UNLIMITED) };
        let sag = if place.edges.is_none() { near[SAG] } else { 0.0 };
        let look = EdgeAppearance { crossing: Vector2::new(near[X], near[Y]), blur: near[BLUR], sag };
        let pixels = select_pixels(image, masked, place, look, all).ok_or(RejectReason::NoConvergence)?;
        let mut bent = fit_final(&pixels, near, scale, &unknowns, floor);
        if bent.is_none() && place.pattern == MarkerPattern::Disc {
            // Between neighbours too little of the skin is seen to tell how the light changes.
            fix_fine_light(&mut unknowns);
            bent = fit_final(&pixels, near, scale, &unknowns, floor);
        }
        let bent = bent.ok_or(RejectReason::NoConvergence)?;
        // The straight model knows more, where the bend is not significant.
        let sigma = |k: usize| bent.covariance[(k, k)].max(0.0).sqrt();
        let is_bent = |&k: &usize| bent.parameters[k].abs() > MEASURE.bend_sigmas * sigma(k);
        let result = if !hypothesis.is_whole() || bends.iter().any(is_bent) {
            bent
        } else {
            bends.iter().for_each(|&k| unknowns.free[k] = false);
            bent.with_zero(bends)
        };
        let (plain, rms) = (result.parameters, result.rms);
        let floor = floor.max(WEIGHT.floor * contrast(near));
        // A field of light knows no overshoot.
        let bears_field = whole && bounds.overshoot.is_none();
        let result = lack_of_fit::improve_fit(&pixels, result, &unknowns, floor, bears_field);
        let answer = judge_fit(image, place, &result, bounds.noise);
        if matches!(answer, Ok(_) | Err(RejectReason::PoorFit)) {
            self.note(place, &plain, rms, answer.is_ok());
        }
        if bounds.through_glare && place.pattern == MarkerPattern::Disc && place.is_in_glare() {
            self.in_glare(place, &result, answer, floor)
        } else {
            answer
        }
    }

    /// Notes what may tell how the frame was sharpened, while that is not known: parameters that leave residuals of some scale.
    fn note(&self, place: &Hypothesis, plain: &MarkerParameters, scale: f64, is_marker: bool) {
        if self.bounds.overshoot.is_none() && self.hypothesis.prior == MarkerPrior::default() {
            let suspect = SharpeningCandidate { place: place.clone(), plain: *plain, scale, is_marker };
            self.notes.borrow_mut().note(suspect, self.bounds.noise);
        }
    }

    /// The answer of a disc with glare over it, from the fit to what glare leaves and what that was judged: through the glare
    /// where both its ends show; else, if all of its size is predicted, through the glare's fringe.
    fn in_glare(&self, place: &Hypothesis, fit: &MarkerFit, plain: MeasurementResult, floor: f64) -> MeasurementResult {
        if !matches!(plain, Ok(_) | Err(RejectReason::Uncertain | RejectReason::GlareOccluded)) {
            return plain;
        }
        let through = |bands: Vec<OcclusionBand>| self.through_glare(place, fit, bands, floor);
        let all = through(Vec::new());
        if let Some((all, true)) = all {
            return Ok(all);
        }
        // Of an end that is saturated the edges beside it tell less than the discs about: it stays left out.
        let known = place.prior.tells_all_of_size();
        let fringe = || through(glare::find_glare_bands(self.image, &place.ellipse, MEASURE.fringe, 0.0));
        let fringe = if known { fringe().map(|(fringe, _)| fringe) } else { None };
        match (plain, fringe) {
            (Ok(plain), Some(fringe)) if !is_preferred(&fringe.detection, &plain.detection) => Ok(plain),
            (_, Some(fringe)) => Ok(fringe),
            (Err(reason), None) => {
                let (mut all, _) = all.ok_or(reason)?;
                if !known {
                    let axis = all.detection.ellipse().axis();
                    let variance = MEASURE.one_end_px.powi(2);
                    all.detection.covariance_px2.add_along(CovarianceSource::SaturatedEnd, axis, variance);
                }
                Ok(all)
            }
            (plain, None) => plain,
        }
    }

    /// A disc with glare over it, with what shows through the glare outside some bands, from the fit to what glare leaves; and
    /// whether both its ends show.
    fn through_glare(
        &self,
        seen: &Hypothesis,
        fit: &MarkerFit,
        bands: Vec<OcclusionBand>,
        floor: f64,
    ) -> Option<(MeasuredMarker, bool)> {
        let m = &fit.parameters;
        let mut place = place(seen, m).with_glare(bands);
        for _ in 0..2 {
            let look = EdgeAppearance { crossing: place.ellipse.centre, blur: m[BLUR], sag: 0.0 };
            let pixels = select_pixels(self.image, darker_than(m, floor), &place, look, UNLIMITED)?;
            let (mut unknowns, _) = select_unknowns(&place);
            // Glare changes the contrast along the disc far more than its own darkness does.
            unknowns.free[DARK + 1..=DARK + 2].fill(false);
            let lit = veiling_glare::fit_with_glare(&pixels, &place.ellipse, fit, &unknowns, floor)?;
            let found = judge_fit(self.image, &place, &lit, self.bounds.noise).ok()?;
            let mut found = MeasuredMarker { through_glare: true, is_whole: false, ..found };
            let doubt = Matrix2::identity() * MEASURE.glare_px.powi(2);
            found.detection.covariance_px2.add(CovarianceSource::ThroughGlare, doubt);
            let moved = (found.detection.centre_px - place.ellipse.centre).norm();
            if moved < MEASURE.settled_px {
                return Some((found, glare_spline::shows_ends(&pixels)));
            }
            place.ellipse = found.detection.ellipse();
        }
        None
    }

    /// Narrow quadrants by edges and outline together, from parameters of a first fit whose residuals had about this scale.
    fn with_outline(&self, found: &Hypothesis, m: &MarkerParameters, scale: f64) -> MeasurementResult {
        let result = outlined_quadrants::fit_quadrants(self.image, found, m, scale, self.floor);
        let (pixels, result, unknowns) = result.ok_or(RejectReason::NoConvergence)?;
        // There is too little of them to tell a field of light.
        let floor = self.floor.max(WEIGHT.floor * contrast(m));
        let result = lack_of_fit::improve_fit(&pixels, result, &unknowns, floor, false);
        if !outlined_quadrants::has_white(&result.parameters) {
            return Err(RejectReason::Pattern);
        }
        judge_fit(self.image, found, &result, self.bounds.noise)
    }
}

/// Least scale of residuals, grey levels.
pub fn least_scale(noise: f64) -> f64 {
    MEASURE.scale.1.max(MEASURE.scale.0 * noise)
}

/// What is darker than a fit's light by more than its residuals, whose least scale that is, and a part of the contrast.
pub fn darker_than<'a>(m: &MarkerParameters, floor: f64) -> PixelExclusion<'a> {
    PixelExclusion::DarkerThan(*m, (WEIGHT.cut_scales * floor).max(MEASURE.foreign * contrast(m)))
}

/// The hypothesis with the geometry of a rough fit.
fn place(hypothesis: &Hypothesis, m: &MarkerParameters) -> Hypothesis {
    let mut out = hypothesis.clone();
    match hypothesis.edges {
        None => {
            let [major, minor] = [m[MAJOR].max(MEASURE.last_px[0]), m[MINOR].max(MEASURE.last_px[1])];
            out.ellipse = Ellipse { centre: Vector2::new(m[X], m[Y]), major, minor, angle: m[ANGLE] };
        }
        Some(_) => out.edges = Some(EdgePair { along_rad: m[ANGLE], tangent: m[TANGENT] }),
    }
    out
}

/// A rough fit, with its residuals' scale.
fn roughly(
    image: &Raster,
    masked: PixelExclusion,
    hypothesis: &Hypothesis,
    (look, sharpened): (EdgeAppearance, Option<Overshoot>),
    few: PixelBudget,
    floor: f64,
) -> Result<(MarkerParameters, f64), RejectReason> {
    let pixels = select_pixels(image, masked, hypothesis, look, few).ok_or(RejectReason::LowContrast)?;
    let mut start = start(hypothesis, &pixels, look, floor).ok_or(RejectReason::LowContrast)?;
    sharpened.iter().for_each(|known| overshoot::set_overshoot_start(known, &mut start));
    fit_coarse(&pixels, &start, &coarse_unknowns(hypothesis), floor).ok_or(RejectReason::NoConvergence)
}

/// Where the edges of large quadrants cross in a smaller picture of them.
fn crossing_in_small(image: &Raster, hypothesis: &Hypothesis, floor: f64) -> Option<Vector2<f64>> {
    let small = ReducedImage::from_large_quadrants(image, hypothesis)?;
    let look = EdgeAppearance { crossing: small.hypothesis.ellipse.centre, blur: MEASURE.blur_px, sag: 0.0 };
    // What is left of an overshoot in the smaller picture hardly shifts a crossing.
    let (m, _) =
        roughly(&small.image, PixelExclusion::Blobs(&[]), &small.hypothesis, (look, None), COARSE, floor).ok()?;
    Some(small.to_original(Vector2::new(m[X], m[Y])))
}

/// First parameters: geometry of the hypothesis, grey levels of its pixels.
fn start(hypothesis: &Hypothesis, pixels: &Pixels, look: EdgeAppearance, floor: f64) -> Option<MarkerParameters> {
    let ellipse = &hypothesis.ellipse;
    let mut m = [0.0; N];
    m[X] = look.crossing.x;
    m[Y] = look.crossing.y;
    match hypothesis.edges {
        None => {
            m[ANGLE] = ellipse.angle;
            m[MAJOR] = ellipse.major;
            m[MINOR] = ellipse.minor;
        }
        Some(EdgePair { along_rad, tangent }) => {
            m[ANGLE] = along_rad;
            m[TANGENT] = tangent.max(MEASURE.tangent);
        }
    }
    m[BLUR] = look.blur;
    let greys = pixels.batches.iter().flat_map(|b| b.value.iter().take(b.len).map(|&v| v as u8));
    let count = Histogram::of(greys);
    let total = count.total();
    if total < MEASURE.least {
        return None;
    }
    let at = |rank: usize| count.at(rank).map(|grey| grey as f64);
    let (low, high) = (at(total / 40)?, at(total * 8 / 10)?);
    m[LIGHT] = high.max(1.0);
    m[GAMMA] = PRIOR.gamma.value;
    m[DARK] = darkness_for_grey_ratio(low.max(1.0) / high.max(1.0));
    (m[DARK] > MEASURE.least_dark && high - low > MEASURE.least_step + MEASURE.spread_by_noise * floor)
        .then_some(m)
}
