//! Prediction of a disc's size from the neighbouring discs.

use nalgebra::{Cholesky, Matrix3, Vector2, Vector3};

use crate::detect::detection::Detection;
use crate::detect::hypothesis::{options::NEIGHBOURS, prior::PriorValue};
use crate::detect::numbers::{MIN_TYPICAL, TINY};
use crate::estimation::robust::median;
use crate::ordering::sort_by_value;
use crate::setup::Shape;

/// Predicts the semi-major axis of a disc at a position, px, from the nearest whole discs: on a nearly plane surface, the
/// scale changes linearly over the image. `None` with too few discs or if they do not lie on a plane.
pub fn predict_major<'a>(
    whole: impl Iterator<Item = &'a Detection>,
    at: Vector2<f64>,
) -> Option<PriorValue> {
    let discs: Vec<&Detection> = whole.filter(|d| d.shape == Shape::Circle).collect();
    let within = |most: f64| discs.iter().copied().filter(move |d| d.variance() < most);
    let certain = within(NEIGHBOURS.certain_px2).count() >= MIN_TYPICAL;
    let whole: Vec<&Detection> = within(if certain {
        NEIGHBOURS.certain_px2
    } else {
        NEIGHBOURS.fallback_px2
    })
    .collect();
    // Letters and dots are detected as discs too, but are far smaller.
    let median_size = median(whole.iter().map(|d| d.semi_major_px).collect())?;
    let mut near: Vec<&Detection> = Vec::new();
    for d in whole
        .into_iter()
        .filter(|d| d.semi_major_px > NEIGHBOURS.min_relative_size * median_size)
    {
        if near
            .iter()
            .all(|other| (other.centre_px - d.centre_px).norm() > NEIGHBOURS.same_px)
        {
            near.push(d);
        }
    }
    sort_by_value(&mut near, |one| (one.centre_px - at).norm_squared());
    near.truncate(NEIGHBOURS.max_discs);
    // In 100 px, so that the terms have similar magnitudes.
    let row = |d: &Detection| {
        Vector3::new(
            1.0,
            (d.centre_px.x - at.x) / 100.0,
            (d.centre_px.y - at.y) / 100.0,
        )
    };
    let (mut normal, mut right) = (Matrix3::identity() * TINY, Vector3::zeros());
    for d in &near {
        normal += row(d) * row(d).transpose();
        right += row(d) * d.semi_major_px;
    }
    let factor = Cholesky::new(normal)?;
    let plane = factor.solve(&right);
    // Far from all discs the plane itself is less precise.
    let far = 1.0 + factor.solve(&Vector3::x()).x;
    let squares: f64 = near
        .iter()
        .map(|d| (row(d).dot(&plane) / d.semi_major_px - 1.0).powi(2))
        .sum();
    // A plane has three unknowns.
    let scatter = (squares / (near.len() as f64 - 3.0)).sqrt();
    let sound = near.len() >= MIN_TYPICAL
        && scatter < NEIGHBOURS.max_scatter
        && plane.x > NEIGHBOURS.min_relative_prediction * median_size;
    let sigma = plane.x * scatter.max(NEIGHBOURS.min_scatter) * far.sqrt();
    sound.then_some(PriorValue {
        value: plane.x,
        sigma,
    })
}
