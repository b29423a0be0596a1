//! A hypothesis's pixels and the fit.

use nalgebra::{Matrix2, Vector2};

use crate::measure::detect::accept::better::is_better;
use crate::measure::detect::accept::options::VERDICT;
use crate::measure::detect::accept::verdict::{Measured, fits_poorly, judge};
use crate::measure::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, FIRST, GAMMA, LIGHT, N, Parameters, Pattern, SECOND, THIRD, X, Y, contrast,
};
use crate::measure::detect::attempt::options::MEASURE;
use crate::measure::detect::detection::RejectReason;
use crate::measure::detect::estimate::gauss_newton::{Fit, fit, rough};
use crate::measure::detect::estimate::options::PRIOR;
use crate::measure::detect::estimate::options::WEIGHT;
use crate::measure::detect::estimate::prior::{darkness_leaving, few_unknowns, unknowns, without_fine_light};
use crate::measure::detect::estimate::terms::{glare_spline, veiling_glare};
use crate::measure::detect::estimate::{lack_of_fit, outlined_quadrants};
use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::image::ellipse::Ellipse;
use crate::measure::detect::image::histogram::Histogram;
use crate::measure::detect::occlusion::region::{Band, Region};
use crate::measure::detect::occlusion::{glare, paint, seam};
use crate::measure::detect::propose::quadrant_outline::{outlined, with_outline};
use crate::measure::detect::propose::reduced::Reduced;
use crate::measure::detect::sample::pixels::Pixels;
use crate::measure::detect::sample::select::{ALL, EVERY, FEW, Look, Masked, Wanted, pixels};
use crate::measure::detect::segment::blob::Blob;
use crate::measure::raster::Raster;

/// A plane of darkness.
const FINE_DARK: [usize; 2] = [DARK + 1, DARK + 2];

/// What a frame's markers can be like.
#[derive(Clone, Copy)]
pub struct Bounds {
    /// Standard deviation of the grey values' noise, grey levels.
    pub noise: f64,
    /// Greatest blur, px.
    pub blur: f64,
    /// Whether discs are measured through the glare that lies over them.
    pub through_glare: bool,
}

impl Bounds {
    /// Of a frame in which nothing has been measured.
    pub fn of(noise: f64) -> Self {
        Self { noise, blur: VERDICT.softest_px, through_glare: false }
    }
}

/// Fits the model to a hypothesis, and judges the answer.
pub fn measure(
    image: &Raster,
    blobs: &[Blob],
    hypothesis: &Hypothesis,
    bounds: Bounds,
) -> Result<Measured, RejectReason> {
    turn_down_at_once(blobs, hypothesis)?;
    let floor = least_scale(bounds.noise);
    let (near, scale) = first_fit(image, blobs, hypothesis, floor)?;
    // A rough fit leaves at most twice what the last one may.
    if fits_poorly(image, hypothesis, 0.5 * scale, bounds.noise, contrast(&near)) {
        return Err(RejectReason::PoorFit);
    }
    if near[BLUR] > bounds.blur {
        return Err(RejectReason::BlurOutlier);
    }
    let mut place = outlined(image, place(hypothesis, &near), &near);
    if let Some((found, m)) = with_outline(image, &place, &near) {
        let answer = measure_with_outline(image, &found, &m, scale, bounds);
        if matches!(answer, Ok(_) | Err(RejectReason::Pattern)) {
            return answer;
        }
        place = found;
    }
    let last = Last { image, blobs, hypothesis, bounds, near, scale, floor };
    let told = !place.is_in_glare() || place.prior.tells_all_of_size();
    if place.pattern == Pattern::Disc && !place.is_under_decal() && told {
        let scale = scale.max(floor);
        let seams = seam::find(image, &place.ellipse, &near, scale);
        let paint = paint::at_end(image, &place.ellipse, &near, scale);
        let shown: Vec<Region> =
            seams.into_iter().map(Region::Seam).chain(paint.map(Region::Paint)).collect();
        if !shown.is_empty() {
            let mut without = place.clone();
            without.excluded.extend(shown);
            let without = last.measure(&without);
            if without.is_ok() {
                return without;
            }
            // What is left may be too little; with these pixels it is at least found.
        }
    }
    last.measure(&place)
}

/// Whether a marker that is seen so would tell nothing.
pub fn is_too_small(seen: &Ellipse) -> bool {
    seen.major < 3.5 || seen.minor < 0.7
}

/// What need not be fitted to be turned down.
fn turn_down_at_once(blobs: &[Blob], hypothesis: &Hypothesis) -> Result<(), RejectReason> {
    let ellipse = &hypothesis.ellipse;
    if hypothesis.blobs.iter().any(|&i| blobs.get(i).is_some_and(|b| b.at_edge)) {
        return Err(RejectReason::TouchesEdge);
    }
    if is_too_small(ellipse) {
        return Err(RejectReason::TooSmall);
    }
    if hypothesis.prior.size.is_none() && ellipse.major > MEASURE.surely_flatter * ellipse.minor {
        return Err(RejectReason::NotAnEllipse);
    }
    Ok(())
}

/// The first geometry, with its residuals' scale.
fn first_fit(
    image: &Raster,
    blobs: &[Blob],
    hypothesis: &Hypothesis,
    floor: f64,
) -> Result<(Parameters, f64), RejectReason> {
    let few = if hypothesis.is_under_decal() { EVERY } else { FEW };
    let blur = hypothesis.prior.edge.map(|edge| edge.blur.0).or(hypothesis.prior.blur).unwrap_or(1.0);
    let first = |look: Look| roughly(image, Masked::Blobs(blobs), hypothesis, look, few, floor);
    let look = Look { crossing: hypothesis.ellipse.centre, blur, sag: 0.0 };
    first(look).or_else(|reason| {
        let crossing = crossing_in_small(image, hypothesis, floor).ok_or(reason)?;
        first(Look { crossing, ..look })
    })
}

/// The last fit of a hypothesis, from a first geometry whose residuals had some scale.
struct Last<'a> {
    image: &'a Raster,
    blobs: &'a [Blob],
    hypothesis: &'a Hypothesis,
    bounds: Bounds,
    near: Parameters,
    scale: f64,
    floor: f64,
}

impl Last<'_> {
    /// The answer at a place that the first geometry told.
    fn measure(&self, place: &Hypothesis) -> Result<Measured, RejectReason> {
        let Self { image, blobs, hypothesis, bounds, near, scale, floor } = *self;
        // What is known of a disc from a twin beside it is known beforehand.
        let (mut unknowns, bends) = unknowns(if hypothesis.prior.twin { hypothesis } else { place });
        unknowns.free[GAMMA] &= contrast(&near) > MEASURE.tells_gamma * near[LIGHT];
        let (masked, all) = if hypothesis.is_under_decal() {
            (Masked::Blobs(blobs), EVERY)
        } else {
            let limit = (WEIGHT.cut_scales * floor).max(MEASURE.foreign * contrast(&near));
            (Masked::DarkerThan(near, limit), ALL)
        };
        let sag = if place.edges.is_none() { near[THIRD] } else { 0.0 };
        let look = Look { crossing: Vector2::new(near[X], near[Y]), blur: near[BLUR], sag };
        let pixels = pixels(image, masked, place, look, all).ok_or(RejectReason::NoConvergence)?;
        let mut bent = fit(&pixels, &near, scale, &unknowns, floor);
        if bent.is_none() && place.pattern == Pattern::Disc {
            // Between neighbours too little of the skin is seen to tell how the light changes.
            without_fine_light(&mut unknowns);
            bent = fit(&pixels, &near, scale, &unknowns, floor);
        }
        let bent = bent.ok_or(RejectReason::NoConvergence)?;
        // The straight model knows more, where the bend is not significant.
        let significant = !hypothesis.is_whole()
            || (bends.iter()).any(|&k| {
                bent.parameters[k].abs() > MEASURE.bend_sigmas * bent.covariance[(k, k)].max(0.0).sqrt()
            });
        let result = if significant {
            bent
        } else {
            bends.iter().for_each(|&k| unknowns.free[k] = false);
            bent.without(bends)
        };
        let floor = floor.max(0.02 * contrast(&near));
        let whole = !hypothesis.is_under_decal();
        let result = lack_of_fit::improve(&pixels, result, &unknowns, floor, whole);
        let plain = judge(image, place, &result, bounds.noise);
        if bounds.through_glare && place.pattern == Pattern::Disc && place.is_in_glare() {
            in_glare(image, place, &result, plain, floor, bounds.noise)
        } else {
            plain
        }
    }
}

/// The answer of a disc with glare over it, from the fit to what glare leaves and what that was judged: through the glare
/// where both its ends show; else, if all of its size is predicted, through the glare's fringe.
fn in_glare(
    image: &Raster,
    hypothesis: &Hypothesis,
    fit: &Fit,
    plain: Result<Measured, RejectReason>,
    floor: f64,
    noise: f64,
) -> Result<Measured, RejectReason> {
    if !matches!(plain, Ok(_) | Err(RejectReason::Uncertain | RejectReason::GlareOccluded)) {
        return plain;
    }
    let through = |bands: Vec<Band>| through_glare(image, hypothesis, fit, bands, floor, noise);
    let all = through(Vec::new());
    if let Some((all, true)) = all {
        return Ok(all);
    }
    // Of an end that is saturated the edges beside it tell less than the discs about: it stays left out.
    let known = hypothesis.prior.tells_all_of_size();
    let fringe =
        || through(glare::lit(image, &hypothesis.ellipse, MEASURE.fringe, 0.0)).map(|(fringe, _)| fringe);
    let fringe = if known { fringe() } else { None };
    match (plain, fringe) {
        (Ok(plain), Some(fringe)) if !is_better(&fringe.detection, &plain.detection) => Ok(plain),
        (_, Some(fringe)) => Ok(fringe),
        (Err(reason), None) => {
            let (mut all, _) = all.ok_or(reason)?;
            if !known {
                let axis = all.detection.ellipse().axis();
                all.detection.covariance_px2 += axis * axis.transpose() * MEASURE.one_end_px.powi(2);
            }
            Ok(all)
        }
        (plain, None) => plain,
    }
}

/// A disc with glare over it, with what shows through the glare outside some bands, from the fit to what glare leaves; and
/// whether both its ends show.
fn through_glare(
    image: &Raster,
    hypothesis: &Hypothesis,
    fit: &Fit,
    bands: Vec<Band>,
    floor: f64,
    noise: f64,
) -> Option<(Measured, bool)> {
    let m = &fit.parameters;
    let mut place = place(hypothesis, m).with_glare(bands);
    for _ in 0..2 {
        let look = Look { crossing: place.ellipse.centre, blur: m[BLUR], sag: 0.0 };
        let masked = Masked::DarkerThan(*m, (WEIGHT.cut_scales * floor).max(MEASURE.foreign * contrast(m)));
        let pixels = pixels(image, masked, &place, look, EVERY)?;
        let (mut unknowns, _) = unknowns(&place);
        // Glare changes the contrast along the disc far more than its own darkness does.
        FINE_DARK.iter().for_each(|&k| unknowns.free[k] = false);
        let fit_with_glare = veiling_glare::fit_with_glare(&pixels, &place.ellipse, fit, &unknowns, floor)?;
        let found = judge(image, &place, &fit_with_glare, noise).ok()?;
        let mut found = Measured { through_glare: true, is_whole: false, ..found };
        found.detection.covariance_px2 += Matrix2::identity() * MEASURE.glare_px.powi(2);
        let moved = (found.detection.centre_px - place.ellipse.centre).norm();
        if moved < 1.0 {
            return Some((found, glare_spline::shows_ends(&pixels)));
        }
        place.ellipse = found.detection.ellipse();
    }
    None
}

/// Narrow quadrants by edges and outline together, from parameters of a first fit whose residuals had about this scale.
fn measure_with_outline(
    image: &Raster,
    hypothesis: &Hypothesis,
    m: &Parameters,
    scale: f64,
    bounds: Bounds,
) -> Result<Measured, RejectReason> {
    let floor = least_scale(bounds.noise);
    let found = outlined_quadrants::measured(image, hypothesis, m, scale, floor);
    let (pixels, result, unknowns) = found.ok_or(RejectReason::NoConvergence)?;
    // There is too little of them to tell a field of light.
    let result = lack_of_fit::improve(&pixels, result, &unknowns, floor.max(0.02 * contrast(m)), false);
    if !outlined_quadrants::has_white(&result.parameters) {
        return Err(RejectReason::Pattern);
    }
    judge(image, hypothesis, &result, bounds.noise)
}

/// Least scale of residuals, grey levels.
fn least_scale(noise: f64) -> f64 {
    0.5f64.max(0.8 * noise)
}

/// The hypothesis with the geometry of a rough fit.
fn place(hypothesis: &Hypothesis, m: &Parameters) -> Hypothesis {
    let mut out = hypothesis.clone();
    match hypothesis.edges {
        None => {
            let (major, minor) = (m[FIRST].max(1.0), m[SECOND].max(0.5));
            out.ellipse = Ellipse { centre: Vector2::new(m[X], m[Y]), major, minor, angle: m[ANGLE] };
        }
        Some(_) => out.edges = Some((m[ANGLE], m[FIRST])),
    }
    out
}

/// A rough fit, with its residuals' scale.
fn roughly(
    image: &Raster,
    masked: Masked,
    hypothesis: &Hypothesis,
    look: Look,
    few: Wanted,
    floor: f64,
) -> Result<(Parameters, f64), RejectReason> {
    let pixels = pixels(image, masked, hypothesis, look, few).ok_or(RejectReason::LowContrast)?;
    let start = start(hypothesis, &pixels, look, floor).ok_or(RejectReason::LowContrast)?;
    rough(&pixels, &start, &few_unknowns(hypothesis), floor).ok_or(RejectReason::NoConvergence)
}

/// Where the edges of large quadrants cross in a smaller picture of them.
fn crossing_in_small(image: &Raster, hypothesis: &Hypothesis, floor: f64) -> Option<Vector2<f64>> {
    let small = Reduced::of(image, hypothesis)?;
    let look = Look { crossing: small.hypothesis.ellipse.centre, blur: 1.0, sag: 0.0 };
    let (m, _) = roughly(&small.image, Masked::Blobs(&[]), &small.hypothesis, look, FEW, floor).ok()?;
    Some(small.back(Vector2::new(m[X], m[Y])))
}

/// First parameters: geometry of the hypothesis, grey levels of its pixels.
fn start(hypothesis: &Hypothesis, pixels: &Pixels, look: Look, floor: f64) -> Option<Parameters> {
    let ellipse = &hypothesis.ellipse;
    let mut m = [0.0; N];
    m[X] = look.crossing.x;
    m[Y] = look.crossing.y;
    match hypothesis.edges {
        None => {
            m[ANGLE] = ellipse.angle;
            m[FIRST] = ellipse.major;
            m[SECOND] = ellipse.minor;
        }
        Some((angle, half)) => {
            m[ANGLE] = angle;
            m[FIRST] = half.max(0.02);
        }
    }
    m[BLUR] = look.blur;
    let greys = pixels.batches.iter().flat_map(|b| b.value.iter().take(b.len).map(|&v| v as u8));
    let count = Histogram::of(greys);
    let total = count.total();
    if total < 20 {
        return None;
    }
    let at = |rank: usize| count.at(rank).map(|grey| grey as f64);
    let (low, high) = (at(total / 40)?, at(total * 8 / 10)?);
    m[LIGHT] = high.max(1.0);
    m[GAMMA] = PRIOR.gamma.0;
    m[DARK] = darkness_leaving(low.max(1.0) / high.max(1.0));
    (m[DARK] > MEASURE.least_dark && high - low > MEASURE.least_step + MEASURE.spread_by_noise * floor)
        .then_some(m)
}
