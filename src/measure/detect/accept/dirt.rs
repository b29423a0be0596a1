//! What lies on the skin right beside a disc, as dirt that the air draws along it does, shifts its edge and leaves no
//! trace in the residuals. Beside the disc it shows: where one side is darker than the other, the disc's place is doubted.

use nalgebra::{Matrix4, Vector2, Vector4};

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::DIRT;
use crate::detect::detection::{Detection, covariance::CovarianceSource};
use crate::detect::estimate::scale::robust_sigma;
use crate::detect::image::ellipse::Ellipse;
use crate::raster::Raster;
use crate::setup::Shape;

/// A pixel of the skin.
struct SkinPixel {
    /// What the light's terms are there: 1, along and across the disc in semi-axes, along squared.
    terms: Vector4<f64>,
    /// Grey levels.
    value: f64,
    /// How much an edge beside it faces across the disc; negative on the one side.
    faces: f64,
    /// Whether it is one of the nearest.
    is_near: bool,
}

/// Adds to the covariance of what was measured as a whole disc, without glare, what lies on the skin beside it makes doubtful;
/// other markers are not looked at.
pub fn inflate_for_dirt(image: &Raster, measured: &mut MeasuredMarker, others: &[Ellipse]) {
    let MeasuredMarker { detection, blur, through_glare, is_whole, .. } = measured;
    if detection.shape == Shape::Circle && *is_whole && !*through_glare {
        let variance = variance_across(image, detection, *blur, others);
        detection.covariance_px2.add_along(CovarianceSource::Beside, detection.ellipse().across(), variance);
    }
}

/// By how much the place of a disc across its axis is doubted, px^2.
fn variance_across(image: &Raster, disc: &Detection, blur: f64, others: &[Ellipse]) -> f64 {
    let spots = sample_skin(image, &disc.ellipse(), blur, others);
    let Some((light, scale)) = fit_skin_light(&spots) else { return 0.0 };
    let most = DIRT.most * disc.contrast;
    let mut sides = [[0.0; 2]; 2];
    for spot in spots.iter().filter(|spot| spot.is_near) {
        let [sum, weight] = &mut sides[usize::from(spot.faces < 0.0)];
        let darker = (light.dot(&spot.terms) - spot.value).clamp(-most, most);
        *sum += darker * spot.faces;
        *weight += spot.faces * spot.faces;
    }
    let [[one, m], [other, n]] = sides;
    if m.min(n) < DIRT.least_px {
        return 0.0;
    }
    let shift = |darker: f64| 0.5 * DIRT.shift_blurs * blur * darker / disc.contrast;
    let square = shift(one / m + other / n).powi(2);
    let chance = shift(DIRT.together * scale * (1.0 / m + 1.0 / n).sqrt()).powi(2);
    (square - DIRT.chance * DIRT.chance * chance).max(0.0)
}

/// The skin on both sides of a disc.
fn sample_skin(image: &Raster, ellipse: &Ellipse, blur: f64, others: &[Ellipse]) -> Vec<SkinPixel> {
    let (along, across) = (ellipse.axis(), ellipse.across());
    let (major, minor) = (ellipse.major, ellipse.minor);
    let skirt = DIRT.skirt_blurs * blur;
    let near = |other: &&Ellipse| {
        let apart = (other.centre - ellipse.centre).norm();
        !ellipse.contains(other.centre)
            && apart < other.major + major + 2.0 * skirt + DIRT.clear_blurs * blur + DIRT.reach_px as f64
    };
    let others: Vec<Ellipse> = others.iter().filter(near).map(|other| other.larger(1.0, skirt)).collect();
    let last = (DIRT.length * major / DIRT.step_px).max(DIRT.steps) as i32;
    let mut out = Vec::with_capacity((2 * last as usize + 1) * 2 * DIRT.reach_px);
    for side in [1.0, -1.0] {
        for k in -last..=last {
            let p = DIRT.length * f64::from(k) / f64::from(last);
            let q = (1.0 - p * p).sqrt();
            let normal = Vector2::new(p / major, q / minor).normalize();
            for j in 0..DIRT.reach_px {
                let off = normal * (DIRT.clear_blurs * blur + 0.5 + j as f64);
                let (s, t) = (p * major + off.x, side * (q * minor + off.y));
                let at = ellipse.centre + along * s + across * t;
                if others.iter().any(|other| other.contains(at)) {
                    continue;
                }
                let (p, q) = (s / major, t / minor);
                out.push(SkinPixel {
                    terms: Vector4::new(1.0, p, q, p * p),
                    value: f64::from(image.nearest(at.x, at.y)),
                    faces: side * normal.y,
                    is_near: j < DIRT.nearest_px,
                });
            }
        }
    }
    out
}

/// The skin's light, as a plane with a square term along the disc, with the scale of what it leaves; `None` of too few pixels.
fn fit_skin_light(spots: &[SkinPixel]) -> Option<(Vector4<f64>, f64)> {
    let mut found: Option<(Vector4<f64>, f64)> = None;
    let mut residuals = Vec::with_capacity(spots.len());
    for _ in 0..DIRT.rounds {
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for spot in spots {
            let weight = found.as_ref().map_or(1.0, |(light, scale)| {
                let r = (spot.value - light.dot(&spot.terms)) / (DIRT.cut_scales * scale);
                (1.0 - r * r).max(0.0).powi(2)
            });
            let weighted = spot.terms * weight;
            normal += weighted * spot.terms.transpose();
            right += weighted * spot.value;
        }
        let light = normal.cholesky()?.solve(&right);
        residuals.clear();
        residuals.extend(spots.iter().map(|spot| (spot.value - light.dot(&spot.terms)).abs() as f32));
        found = Some((light, robust_sigma(&mut residuals) + DIRT.floor));
    }
    found
}
