//! Contamination of the skin next to a disc, such as dirt drawn along it by the air flow. It shifts the disc's edge and
//! leaves no residuals, but it shows next to the disc: if one side is darker than the other, the variance of the disc's
//! position across is increased.

use nalgebra::{Matrix4, Vector2, Vector4};

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::DIRT;
use crate::detect::appearance::parameters::{EDGE_END_BLURS, EDGE_SKIRT_BLURS};
use crate::detect::detection::{Detection, covariance::CovarianceSource};
use crate::detect::estimate::scale::robust_sigma;
use crate::detect::image::ellipse::Ellipse;
use crate::raster::Raster;
use crate::setup::Shape;

struct SkinPixel {
    /// Terms of the light model: 1, position along and across the disc in semi-axes, position along squared.
    terms: Vector4<f64>,
    /// Grey value, grey levels.
    value: f64,
    /// Component of the outline's normal across the disc; negative on one side.
    facing: f64,
    /// True if the pixel is one of the nearest to the outline.
    is_near: bool,
}

/// Adds the variance due to contamination of the skin to a disc that was measured whole and without glare; other markers
/// stay unchanged.
pub fn inflate_for_dirt(image: &Raster, measured: &mut MeasuredMarker, others: &[Ellipse]) {
    let MeasuredMarker {
        detection,
        blur,
        through_glare,
        is_whole,
        ..
    } = measured;
    if detection.shape == Shape::Circle && *is_whole && !*through_glare {
        let variance = variance_across(image, detection, *blur, others);
        detection.covariance_px2.add_along(
            CovarianceSource::Contamination,
            detection.ellipse().minor_direction(),
            variance,
        );
    }
}

/// Returns the variance of a disc's position across its axis due to unequal skin on its two sides, px^2.
fn variance_across(image: &Raster, disc: &Detection, blur: f64, others: &[Ellipse]) -> f64 {
    let pixels = sample_skin(image, &disc.ellipse(), blur, others);
    let Some((light, scale)) = fit_skin_light(&pixels) else {
        return 0.0;
    };
    // A difference of more than half of the contrast is another object.
    let max_difference = 0.5 * disc.contrast;
    let mut sides = [[0.0; 2]; 2];
    for pixel in pixels.iter().filter(|pixel| pixel.is_near) {
        let [sum, weight] = &mut sides[usize::from(pixel.facing < 0.0)];
        let darker = (light.dot(&pixel.terms) - pixel.value).clamp(-max_difference, max_difference);
        *sum += darker * pixel.facing;
        *weight += pixel.facing * pixel.facing;
    }
    let [[one, m], [other, n]] = sides;
    if m.min(n) < DIRT.min_px {
        return 0.0;
    }
    let shift = |darker: f64| 0.5 * DIRT.shift_blurs * blur * darker / disc.contrast;
    let square = shift(one / m + other / n).powi(2);
    let chance = shift(DIRT.correlation * scale * (1.0 / m + 1.0 / n).sqrt()).powi(2);
    // Up to two standard deviations it may be chance.
    (square - 2.0 * 2.0 * chance).max(0.0)
}

/// Samples the skin on both sides of a disc.
fn sample_skin(image: &Raster, ellipse: &Ellipse, blur: f64, others: &[Ellipse]) -> Vec<SkinPixel> {
    let (along, across) = (ellipse.major_direction(), ellipse.minor_direction());
    let (major, minor) = (ellipse.major, ellipse.minor);
    let reach = EDGE_END_BLURS * blur;
    let near = |other: &&Ellipse| {
        let apart = (other.centre - ellipse.centre).norm();
        !ellipse.contains(other.centre)
            && apart
                < other.major + major + 2.0 * reach + EDGE_SKIRT_BLURS * blur + DIRT.reach_px as f64
    };
    let others: Vec<Ellipse> = others
        .iter()
        .filter(near)
        .map(|other| other.enlarged(1.0, reach))
        .collect();
    let last = (DIRT.length * major / DIRT.step_px).max(DIRT.steps) as i32;
    let mut out = Vec::with_capacity((2 * last as usize + 1) * 2 * DIRT.reach_px);
    for side in [1.0, -1.0] {
        for k in -last..=last {
            let p = DIRT.length * f64::from(k) / f64::from(last);
            let q = (1.0 - p * p).sqrt();
            let normal = Vector2::new(p / major, q / minor).normalize();
            for j in 0..DIRT.reach_px {
                let off = normal * (EDGE_SKIRT_BLURS * blur + 0.5 + j as f64);
                let (s, t) = (p * major + off.x, side * (q * minor + off.y));
                let at = ellipse.centre + along * s + across * t;
                if others.iter().any(|other| other.contains(at)) {
                    continue;
                }
                let (p, q) = (s / major, t / minor);
                out.push(SkinPixel {
                    terms: Vector4::new(1.0, p, q, p * p),
                    value: f64::from(image.nearest_value(at.x, at.y)),
                    facing: side * normal.y,
                    is_near: j < DIRT.reach_px / 2,
                });
            }
        }
    }
    out
}

/// Fits the skin's light as a plane with a quadratic term along the disc. Returns it with the scale of its residuals, grey
/// levels; `None` with too few pixels.
fn fit_skin_light(pixels: &[SkinPixel]) -> Option<(Vector4<f64>, f64)> {
    let mut found: Option<(Vector4<f64>, f64)> = None;
    let mut residuals = Vec::with_capacity(pixels.len());
    for _ in 0..DIRT.rounds {
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for pixel in pixels {
            let weight = found.as_ref().map_or(1.0, |(light, scale)| {
                let r = (pixel.value - light.dot(&pixel.terms)) / (DIRT.cut_scales * scale);
                (1.0 - r * r).max(0.0).powi(2)
            });
            let weighted = pixel.terms * weight;
            normal += weighted * pixel.terms.transpose();
            right += weighted * pixel.value;
        }
        let light = normal.cholesky()?.solve(&right);
        residuals.clear();
        residuals.extend(
            pixels
                .iter()
                .map(|pixel| (pixel.value - light.dot(&pixel.terms)).abs() as f32),
        );
        found = Some((light, robust_sigma(&mut residuals) + DIRT.floor));
    }
    found
}
