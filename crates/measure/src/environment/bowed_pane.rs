//! Pane bowed by cabin pressure: two concentric spheres instead of two planes.
//!
//! Rule of thumb: a slanting ray leaves the pane displaced by t tan i / n, at a point at which the outer face is rotated
//! against the inner one; the pane deflects it by (n - 1) t tan i / (n r). That is a change of scale: 5e-4 for 14.5 mm
//! bowed to a radius of 10 m (0.8 mm over a window of 25 cm), 1 px at 15 degrees.
//!
//! Formula: the ray is traced through both faces with Snell's law. A face with its apex at the origin, outward normal m and
//! curvature c is `m.p + c p.p / 2 = 0`, which is valid for planes too and loses no digits at large radii; its normal at p
//! is `m + c p`. The apex is at the intersection of the pane with the normal through the projection centre. Source: Born
//! and Wolf, Principles of Optics, 4.4. The error of the curvature is an unknown of the adjustment, relative to the
//! curvature.
//!
//! Validated against rays traced face by face with spheres about their centres (tests/adjust/window.rs).

use nalgebra::Vector3;

use super::refraction::refract_ray;
use crate::setup::Pane;

/// Traces a ray from the projection centre through the pane: returns a point on the outside ray and its direction; `None`
/// if it misses a face. `normal` is the pane's, outward. The radius is the inner face's, positive if the pane bulges
/// outwards.
pub(super) fn trace_bowed_pane(
    pane: &Pane,
    normal: &Vector3<f64>,
    radius_m: f64,
    ray: &Vector3<f64>,
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let inner = (normal * pane.distance_m, 1.0 / radius_m);
    let outer = (
        normal * (pane.distance_m + pane.thickness_m),
        1.0 / (radius_m + pane.thickness_m),
    );
    let (enters, facing) = intersect_face(&Vector3::zeros(), ray, normal, inner)?;
    let inside = refract_ray(ray, &facing, 1.0 / pane.index)?;
    let (leaves, facing) = intersect_face(&enters, &inside, normal, outer)?;
    let outside = refract_ray(&inside, &facing, pane.index)?;
    Some((leaves - outside * leaves.dot(&outside), outside))
}

/// Returns the intersection of a ray with a face (apex, curvature), and the face's normal there.
fn intersect_face(
    from: &Vector3<f64>,
    ray: &Vector3<f64>,
    normal: &Vector3<f64>,
    (apex, curvature): (Vector3<f64>, f64),
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let start = from - apex;
    let b = ray.dot(normal) + curvature * ray.dot(&start);
    let c = start.dot(normal) + 0.5 * curvature * start.norm_squared();
    let root = b * b - 2.0 * curvature * c;
    (root >= 0.0 && b > 0.0).then(|| {
        let p = from - ray * (2.0 * c / (b + root.sqrt()));
        (p, normal + (p - apex) * curvature)
    })
}
