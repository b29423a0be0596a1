//! Whether quadrants are a disc's, or a checkerboard's squares.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector2;

use crate::detect::accept::options::PATTERN;
use crate::detect::appearance::parameters::{ANGLE, BLUR, LIGHT, MarkerParameters, MarkerPattern, TANGENT, contrast};
use crate::detect::image::ellipse::Ellipse;
use crate::raster::Raster;

/// Whether the black quadrants end at the outline: the corner of a checkerboard's squares goes on.
pub fn ends_in_arcs(image: &Raster, pattern: MarkerPattern, ellipse: &Ellipse, along: f64, m: &MarkerParameters) -> bool {
    let turn = if pattern == MarkerPattern::WhiteAlong { FRAC_PI_2 } else { 0.0 };
    let direction = Vector2::new((along + turn).cos(), (along + turn).sin());
    let radius = ellipse.radius(direction);
    let (light, black) = (m[LIGHT], m[LIGHT] - contrast(m));
    let grey = |factor: f64| {
        let at = ellipse.centre + direction * (factor * radius);
        f64::from(image.nearest(at.x, at.y))
    };
    let first = 1.0 + (PATTERN.beyond_blurs * m[BLUR] / radius).clamp(PATTERN.beyond.0, PATTERN.beyond.1);
    [-1.0, 1.0].iter().all(|side| {
        let inside = grey(side * PATTERN.inside);
        let skin = inside + PATTERN.lighter * (light - inside);
        let lighter = PATTERN.places.iter().filter(|place| grey(side * (first + **place)) > skin);
        inside < 0.5 * (light + black) && 2 * lighter.count() > PATTERN.places.len()
    })
}

/// Whether both black quadrants have a square's corner, seen where the outline is a circle.
pub fn have_corners(image: &Raster, pattern: MarkerPattern, ellipse: &Ellipse, m: &MarkerParameters) -> bool {
    if ellipse.minor < PATTERN.tells_corner_blurs * m[BLUR] {
        return false;
    }
    let (along, across) = (ellipse.axis(), ellipse.across());
    let turned = |angle: f64| {
        let (s, t) = ellipse.local(ellipse.centre + Vector2::new(angle.cos(), angle.sin()));
        (t / ellipse.minor).atan2(s / ellipse.major)
    };
    let half = m[TANGENT].atan();
    let first = turned(m[ANGLE] - half);
    let opening = (turned(m[ANGLE] + half) - first).rem_euclid(PI);
    let (bisector, half) = match pattern {
        MarkerPattern::WhiteAlong => (first + 0.5 * (opening + PI), 0.5 * (PI - opening)),
        _ => (first + 0.5 * opening, 0.5 * opening),
    };
    let edge = m[LIGHT] - PATTERN.ends * contrast(m);
    // Where black ends in a direction, in radii.
    let end = |angle: f64| {
        let radius = along * (ellipse.major * angle.cos()) + across * (ellipse.minor * angle.sin());
        let light = |factor: &f64| {
            let at = ellipse.centre + radius * *factor;
            f64::from(image.nearest(at.x, at.y)) > edge
        };
        let steps = [PATTERN.reach.0, PATTERN.reach.1].map(|v| (v / PATTERN.step).round() as i32);
        (steps[0]..steps[1]).map(|k| PATTERN.step * f64::from(k)).find(light).unwrap_or(PATTERN.reach.1)
    };
    [0.0, PI].iter().all(|side| {
        let at = |part: f64| end(bisector + side + part * half);
        at(0.0) > PATTERN.corner * 0.5 * (at(-PATTERN.aside) + at(PATTERN.aside))
    })
}
