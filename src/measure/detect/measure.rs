//! Stages 4 and 5: a candidate's pixels, the fit, and the decision.

use nalgebra::{Matrix2, Vector2};

use super::super::raster::Raster;
use super::super::setup::Shape;
use super::arc::within;
use super::blob::Blob;
use super::candidate::{Candidate, Outline, half_turn};
use super::fit::{Fit, Unknowns, contrast, fit, rough};
use super::model::{
    ANGLE, BLUR, DARK, EGG, FIRST, GAMMA, LIGHT, N, Parameters, Pattern, Pixel, SECOND, THIRD, X, Y,
};
use super::{Detection, RejectReason};

/// Standard deviations beyond which a bend of axis or edges is believed.
const BEND_TEST: f64 = 3.0;

/// How a sheet lies on a curved skin is not known: stretched or not, it differs along the marker by
/// the sag times the skin's slope, for which one in ten stands.
const LAID: f64 = 0.1;
/// The tone curve of pictures made for the eye, and how far cameras depart from it.
const USUAL_GAMMA: (f64, f64) = (1.0 / 2.2, 0.15);
/// A disc's sag over its semi-major axis, and the change of its thickness, on the skin of a wing. A
/// whole outline tells them better; half an outline needs to know that they are small.
const SAG_SPREAD: f64 = 0.01;
const EGG_SPREAD: f64 = 0.05;
/// How far discs side by side differ: direction, rad, relative length and thickness.
const ALIKE_ANGLE: f64 = 0.02;
const ALIKE_MAJOR: f64 = 0.03;
const ALIKE_MINOR: f64 = 0.1;
/// Pixels of a fit: more would only cost time.
const MAX_PIXELS: usize = 1400;

/// A fitted marker with its blur.
pub struct Measured {
    /// The answer.
    pub detection: Detection,
    /// Blur of its edges, pixel included, px.
    pub blur: f64,
}

/// Fits the model to a candidate.
pub fn measure(
    image: &Raster,
    blobs: &[Blob],
    candidate: &Candidate,
    noise: f64,
) -> Result<Measured, RejectReason> {
    let outline = &candidate.outline;
    if candidate.blobs.iter().any(|&i| blobs.get(i).is_some_and(|b| b.at_edge)) {
        return Err(RejectReason::TouchesEdge);
    }
    let too_small = outline.major < 3.5 || outline.minor < 0.7;
    if too_small {
        return Err(RejectReason::TooSmall);
    }
    if outline.major > 22.0 * outline.minor {
        return Err(RejectReason::NotAnEllipse);
    }
    let (unknowns, bends) = unknowns(candidate);
    let floor = 0.5f64.max(0.8 * noise);
    let first = pixels(image, blobs, candidate, 1.0);
    let start = start(candidate, &first, 1.0).ok_or(RejectReason::LowContrast)?;
    let near =
        rough(candidate.pattern, &first, &start, &unknowns, floor).ok_or(RejectReason::NoConvergence)?;
    let settled = settle(candidate, &near);
    let pixels = pixels(image, blobs, &settled, to_grid(near[BLUR], 4.0).clamp(0.5, 3.5));
    let bent = fit(candidate.pattern, &pixels, &near, &unknowns, floor).ok_or(RejectReason::NoConvergence)?;
    // The straight model knows more, where the bend is not significant.
    let significant = !candidate.hidden.is_empty()
        || (bends.iter())
            .any(|&k| bent.parameters[k].abs() > BEND_TEST * bent.covariance[(k, k)].max(0.0).sqrt());
    let result = if significant { bent } else { bent.without(bends) };
    judge(image, candidate, &result, noise)
}

/// Which parameters a marker of this size can tell, and which of them are bends.
fn unknowns(candidate: &Candidate) -> (Unknowns, &'static [usize]) {
    let outline = &candidate.outline;
    let disc = candidate.pattern == Pattern::Disc;
    let bends: &[usize] = if disc { &[THIRD, EGG] } else { &[SECOND, THIRD] };
    let thick = outline.minor >= 2.5;
    let mut free = [true; N];
    free[DARK + 1] = thick;
    free[DARK + 2] = outline.minor >= 6.0;
    free[GAMMA] = thick;
    free[LIGHT + 3] = thick && outline.major >= 15.0;
    free[EGG] = disc;
    let part = !candidate.hidden.is_empty();
    if part {
        // The outline that is left tells an ellipse, and no more.
        [LIGHT + 3, DARK + 1, DARK + 2, GAMMA].iter().for_each(|&k| free[k] = false);
    }
    if !thick || outline.major < 12.0 {
        bends.iter().for_each(|&k| free[k] = false);
    }
    (Unknowns { free, usual: usual(candidate) }, bends)
}

/// What is known before the fit.
fn usual(candidate: &Candidate) -> [(f64, f64); N] {
    let mut out = [(0.0, f64::INFINITY); N];
    let outline = &candidate.outline;
    out[GAMMA] = USUAL_GAMMA;
    if candidate.pattern == Pattern::Disc {
        out[THIRD] = (0.0, SAG_SPREAD * outline.major);
        out[EGG] = (0.0, EGG_SPREAD);
    }
    if candidate.alike {
        out[ANGLE] = (outline.angle, ALIKE_ANGLE);
        out[FIRST] = (outline.major, ALIKE_MAJOR * outline.major);
        out[SECOND] = (outline.minor, ALIKE_MINOR * outline.minor);
    }
    out
}

/// The candidate with the geometry of a rough fit, on a grid, so that the choice of pixels does
/// not depend on how the fit was reached.
fn settle(candidate: &Candidate, m: &Parameters) -> Candidate {
    let mut out = candidate.clone();
    let outline = &mut out.outline;
    match candidate.edges {
        None => {
            outline.centre = Vector2::new(to_grid(m[X], 4.0), to_grid(m[Y], 4.0));
            outline.major = to_grid(m[FIRST], 4.0).max(1.0);
            outline.minor = to_grid(m[SECOND], 4.0).max(0.5);
            outline.angle = to_grid(m[ANGLE], 128.0);
        }
        Some(_) => {
            outline.centre = outline.centre.map(|v| v.round());
            outline.major = outline.major.round().max(1.0);
            outline.minor = outline.minor.round().max(1.0);
            outline.angle = to_grid(outline.angle, 64.0);
            out.edges = Some((to_grid(m[ANGLE], 128.0), to_grid(m[FIRST], 128.0)));
        }
    }
    out
}

fn to_grid(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

/// Accepts or turns down a fit.
fn judge(image: &Raster, candidate: &Candidate, fit: &Fit, noise: f64) -> Result<Measured, RejectReason> {
    let m = &fit.parameters;
    let contrast = contrast(m);
    let outline = match candidate.pattern {
        Pattern::Disc => {
            let (centre, angle) = (Vector2::new(m[X], m[Y]), m[ANGLE]);
            let (major, minor, angle) = if m[FIRST] >= m[SECOND] {
                (m[FIRST], m[SECOND], angle)
            } else {
                (m[SECOND], m[FIRST], angle + std::f64::consts::FRAC_PI_2)
            };
            Outline { centre, major, minor, angle: half_turn(angle) }
        }
        _ => Outline { centre: Vector2::new(m[X], m[Y]), ..candidate.outline },
    };
    let moved = (outline.centre - candidate.outline.centre).norm();
    if moved > 0.25 * candidate.outline.major + 2.0 {
        return Err(RejectReason::PoorFit);
    }
    let extent = outline.extent();
    let (w, h) = (image.width() as f64, image.height() as f64);
    let c = outline.centre;
    if c.x - extent.x < 0.5 || c.y - extent.y < 0.5 || c.x + extent.x > w - 1.5 || c.y + extent.y > h - 1.5 {
        return Err(RejectReason::TouchesEdge);
    }
    if outline.minor < 0.8 || outline.major < 3.5 {
        return Err(RejectReason::TooSmall);
    }
    let lopsided = candidate.pattern == Pattern::Disc && m[EGG].abs() > 4.0 * EGG_SPREAD;
    if lopsided || outline.major > 20.0 * outline.minor {
        return Err(RejectReason::NotAnEllipse);
    }
    if m[DARK] < 0.15 || contrast < 8.0 || contrast < 4.0 * noise {
        return Err(RejectReason::LowContrast);
    }
    if m[BLUR] > 3.2 || fit.inliers < 0.55 || fit.rms > 1.6 * noise + 0.05 * contrast {
        return Err(RejectReason::PoorFit);
    }
    if candidate.edges.is_some_and(|edges| !ends_in_arcs(image, candidate, edges.0, m)) {
        return Err(RejectReason::Pattern);
    }
    let mut covariance = fit.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    if candidate.pattern == Pattern::Disc {
        let axis = Vector2::new(m[ANGLE].cos(), m[ANGLE].sin());
        covariance += axis * axis.transpose() * (LAID * m[THIRD]).powi(2);
    }
    let spread = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
    // A part of an outline tells the centre less well, and says so.
    let most = if candidate.hidden.is_empty() { 0.6 } else { 2.0 };
    if !(spread > 0.0 && spread < most) {
        return Err(RejectReason::PoorFit);
    }
    Ok(Measured {
        detection: Detection {
            shape: if candidate.pattern == Pattern::Disc { Shape::Circle } else { Shape::Quadrant },
            centre_px: outline.centre,
            covariance_px2: Matrix2::from_fn(|i, j| covariance[(i, j)]),
            semi_major_px: outline.major,
            semi_minor_px: outline.minor,
            angle_rad: outline.angle,
            fit_rms: fit.rms,
            contrast,
        },
        blur: m[BLUR],
    })
}

/// Whether the black quadrants end at the outline: the corner of a checkerboard's squares goes on.
fn ends_in_arcs(image: &Raster, candidate: &Candidate, along: f64, m: &Parameters) -> bool {
    let outline = &candidate.outline;
    let turn = if candidate.pattern == Pattern::WhiteAlong { std::f64::consts::FRAC_PI_2 } else { 0.0 };
    let direction = Vector2::new((along + turn).cos(), (along + turn).sin());
    let (s, t) = outline.local(outline.centre + direction);
    let radius = 1.0 / (s / outline.major).hypot(t / outline.minor);
    let (light, black) = (m[LIGHT], m[LIGHT] - contrast(m));
    let grey = |factor: f64| {
        let at = outline.centre + direction * (factor * radius);
        f64::from(image.clamped(at.x.round() as isize, at.y.round() as isize))
    };
    // Skin may be darker than half way from white to black: it need only be lighter than black.
    [-1.0, 1.0].iter().all(|side| {
        let (inside, outside) = (grey(side * 0.75), grey(side * 1.2));
        inside < 0.5 * (light + black) && outside > inside + 0.4 * (light - black)
    })
}

/// First parameters: geometry of the candidate, grey levels of its pixels.
fn start(candidate: &Candidate, pixels: &[Pixel], blur: f64) -> Option<Parameters> {
    let outline = &candidate.outline;
    let mut m = [0.0; N];
    m[X] = outline.centre.x;
    m[Y] = outline.centre.y;
    match candidate.edges {
        None => {
            m[ANGLE] = outline.angle;
            m[FIRST] = outline.major;
            m[SECOND] = outline.minor;
        }
        Some((angle, half)) => {
            m[ANGLE] = angle;
            m[FIRST] = half.max(0.02);
        }
    }
    m[BLUR] = blur;
    if pixels.len() < 20 {
        return None;
    }
    let mut values: Vec<f64> = pixels.iter().map(|p| p.value).collect();
    values.sort_unstable_by(f64::total_cmp);
    let (low, high) = (values[values.len() / 40], values[values.len() * 8 / 10]);
    m[LIGHT] = high.max(1.0);
    m[GAMMA] = 1.0 / 2.2;
    m[DARK] = 1.0 - (low.max(1.0) / high.max(1.0)).powf(2.2);
    (m[DARK] > 0.08 && high - low > 6.0).then_some(m)
}

/// The pixels that tell where the marker is: along its outline, or along the edges between the
/// quadrants. Those near other dark things are left out.
fn pixels(image: &Raster, blobs: &[Blob], candidate: &Candidate, blur: f64) -> Vec<Pixel> {
    let outline = &candidate.outline;
    // Flat pixels only tell the levels: of a large marker's, one in four will do.
    let flat = if outline.major > 40.0 { 2 } else { 8 };
    let (edge, band) = (2.2 * blur + 0.7, 3.5 * blur + 2.0);
    let reach = outline.extent().add_scalar(band + 1.0);
    let c = outline.centre;
    let x0 = (c.x - reach.x).floor().max(0.0) as usize;
    let y0 = (c.y - reach.y).floor().max(0.0) as usize;
    let x1 = ((c.x + reach.x).ceil().max(0.0) as usize).min(image.width() - 1);
    let y1 = ((c.y + reach.y).ceil().max(0.0) as usize).min(image.height() - 1);
    let taken = foreign(blobs, candidate, [x0, y0, x1, y1]);
    let mut out = Vec::new();
    for y in y0..=y1 {
        let row = image.row(y);
        for (x, &v) in row.iter().enumerate().take(x1 + 1).skip(x0) {
            let (s, t) = outline.local(Vector2::new(x as f64, y as f64));
            let near = |band: f64| match candidate.edges {
                None => near_outline(outline, s, t, band),
                Some(edges) => near_edges(outline, edges, s, t, band, blur),
            };
            let wanted = near(band) && ((x * 5 + y * 3) % 8 < flat || near(edge));
            if wanted
                && !candidate.hidden.iter().any(|h| within(h, &Vector2::new(x as f64, y as f64)))
                && !taken.as_ref().is_some_and(|m| m[(y - y0) * (x1 - x0 + 1) + x - x0])
            {
                let (p, q) = (s / outline.major, t / outline.minor);
                out.push(Pixel { x: x as f64, y: y as f64, value: f64::from(v), p, q });
            }
        }
    }
    let most = if outline.major > 40.0 { MAX_PIXELS } else { 2 * MAX_PIXELS };
    let stride = out.len().div_ceil(most).max(1);
    out.into_iter().step_by(stride).collect()
}

fn near_outline(outline: &Outline, s: f64, t: f64, band: f64) -> bool {
    let within = |a: f64, b: f64| a > 0.0 && b > 0.0 && (s / a).powi(2) + (t / b).powi(2) < 1.0;
    within(outline.major + band, outline.minor + band) && !within(outline.major - band, outline.minor - band)
}

fn near_edges(outline: &Outline, edges: (f64, f64), s: f64, t: f64, band: f64, blur: f64) -> bool {
    let margin = (3.0 * blur).min(0.3 * outline.minor).max(1.0);
    let (a, b) = (outline.major - margin, outline.minor - margin);
    if a <= 0.0 || b <= 0.0 || (s / a).powi(2) + (t / b).powi(2) >= 1.0 {
        return false;
    }
    let (sin, cos) = (edges.0 - outline.angle).sin_cos();
    let (s, t) = (s * cos + t * sin, t * cos - s * sin);
    let norm = edges.1.hypot(1.0);
    ((t - edges.1 * s) / norm).abs() < band || ((t + edges.1 * s) / norm).abs() < band
}

/// Pixels of the window within 3 px of a blob that is not the candidate's; `None` where no such
/// blob is near.
fn foreign(blobs: &[Blob], candidate: &Candidate, window: [usize; 4]) -> Option<Vec<bool>> {
    const MARGIN: usize = 3;
    let outline = &candidate.outline;
    let [x0, y0, x1, y1] = window;
    let width = x1 - x0 + 1;
    let mut mask: Option<Vec<bool>> = None;
    for (i, blob) in blobs.iter().enumerate() {
        let b = blob.bounds;
        let apart = b[0] > x1 + MARGIN || b[2] + MARGIN < x0 || b[1] > y1 + MARGIN || b[3] + MARGIN < y0;
        let (s, t) = outline.local(blob.centroid);
        let own = (s / outline.major).powi(2) + (t / outline.minor).powi(2) < 1.0;
        if apart || own || candidate.blobs.contains(&i) {
            continue;
        }
        let mask = mask.get_or_insert_with(|| vec![false; width * (y1 - y0 + 1)]);
        for run in &blob.runs {
            let [y, from, to] = run.map(|v| v as usize);
            let (from, to) = (from.saturating_sub(MARGIN).max(x0), (to + MARGIN).min(x1));
            for row in y.saturating_sub(MARGIN).max(y0)..=(y + MARGIN).min(y1) {
                if from <= to {
                    mask[(row - y0) * width + from - x0..=(row - y0) * width + to - x0].fill(true);
                }
            }
        }
    }
    mask
}
