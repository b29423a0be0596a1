//! What the discs about a place predict of one there.

use nalgebra::{Cholesky, Matrix3, Vector2, Vector3};

use crate::detect::detection::Detection;
use crate::detect::hypothesis::{options::NEIGHBOURS, prior::PriorValue};
use crate::detect::numbers::TINY;
use crate::estimation::robust::median;
use crate::setup::Shape;

/// The semi-major axis of a disc at a place, px, from the whole ones nearest to it: on a
/// surface that is about plane, the scale of what lies on it changes linearly over the picture.
pub fn predicted_major<'a>(whole: impl Iterator<Item = &'a Detection>, at: Vector2<f64>) -> Option<PriorValue> {
    let discs: Vec<&Detection> = whole.filter(|d| d.shape == Shape::Circle).collect();
    let within = |most: f64| discs.iter().copied().filter(move |d| d.variance() < most);
    let certain = within(NEIGHBOURS.certain_px2).count() >= NEIGHBOURS.enough;
    let whole: Vec<&Detection> =
        within(if certain { NEIGHBOURS.certain_px2 } else { NEIGHBOURS.fairly_px2 }).collect();
    // Letters and dots are discs too, but far smaller.
    let usual = median(whole.iter().map(|d| d.semi_major_px).collect())?;
    let mut near: Vec<&Detection> = Vec::new();
    for d in whole.into_iter().filter(|d| d.semi_major_px > NEIGHBOURS.small * usual) {
        if near.iter().all(|other| (other.centre_px - d.centre_px).norm() > NEIGHBOURS.same_px) {
            near.push(d);
        }
    }
    near.sort_by(|a, b| (a.centre_px - at).norm_squared().total_cmp(&(b.centre_px - at).norm_squared()));
    near.truncate(NEIGHBOURS.nearest);
    // Hundreds of px, so that the terms are of about one size.
    let row =
        |d: &Detection| Vector3::new(1.0, (d.centre_px.x - at.x) / 100.0, (d.centre_px.y - at.y) / 100.0);
    let (mut normal, mut right) = (Matrix3::identity() * TINY, Vector3::zeros());
    for d in &near {
        normal += row(d) * row(d).transpose();
        right += row(d) * d.semi_major_px;
    }
    let factor = Cholesky::new(normal)?;
    let plane = factor.solve(&right);
    // Far from them all the plane itself is less certain.
    let far = 1.0 + factor.solve(&Vector3::x()).x;
    let squares: f64 = near.iter().map(|d| (row(d).dot(&plane) / d.semi_major_px - 1.0).powi(2)).sum();
    // A plane has three unknowns.
    let scatter = (squares / (near.len() as f64 - 3.0)).sqrt();
    let sound =
        near.len() >= NEIGHBOURS.enough && scatter < NEIGHBOURS.unlike && plane.x > NEIGHBOURS.least * usual;
    let sigma = plane.x * scatter.max(NEIGHBOURS.scatter) * far.sqrt();
    sound.then_some(PriorValue { value: plane.x, sigma })
}
