//! Distinction of quadrant targets from the squares of a checkerboard.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector2;

use crate::detect::accept::options::PATTERN;
use crate::detect::appearance::parameters::{
    ANGLE, BLUR, LIGHT, MarkerParameters, MarkerPattern, TANGENT, grey_contrast,
};
use crate::detect::image::ellipse::Ellipse;
use crate::raster::Raster;

/// Returns whether the black quadrants end at the outline; the corner of a checkerboard's squares extends beyond it.
pub fn ends_in_arcs(
    image: &Raster,
    pattern: MarkerPattern,
    ellipse: &Ellipse,
    along: f64,
    m: &MarkerParameters,
) -> bool {
    let turn = if pattern == MarkerPattern::WhiteAlong {
        FRAC_PI_2
    } else {
        0.0
    };
    let direction = Vector2::new((along + turn).cos(), (along + turn).sin());
    let radius = ellipse.radius_along(direction);
    let (light, black) = (m[LIGHT], m[LIGHT] - grey_contrast(m));
    let grey = |factor: f64| {
        let at = ellipse.centre + direction * (factor * radius);
        f64::from(image.nearest_value(at.x, at.y))
    };
    let first =
        1.0 + (2.0 * m[BLUR] / radius).clamp(PATTERN.skin_start.start, PATTERN.skin_start.end);
    [-1.0, 1.0].iter().all(|side| {
        let inside = grey(side * PATTERN.black_radius);
        let skin = inside + PATTERN.min_lighter * (light - inside);
        let lighter = PATTERN
            .skin_radii
            .iter()
            .filter(|place| grey(side * (first + **place)) > skin);
        inside < 0.5 * (light + black) && 2 * lighter.count() > PATTERN.skin_radii.len()
    })
}

/// Returns whether both black quadrants have the corner of a square, in the coordinates in which the outline is a circle.
pub fn have_corners(
    image: &Raster,
    pattern: MarkerPattern,
    ellipse: &Ellipse,
    m: &MarkerParameters,
) -> bool {
    if ellipse.minor < PATTERN.min_corner_blurs * m[BLUR] {
        return false;
    }
    let (along, across) = (ellipse.major_direction(), ellipse.minor_direction());
    let turned = |angle: f64| {
        let (s, t) =
            ellipse.local_position(ellipse.centre + Vector2::new(angle.cos(), angle.sin()));
        (t / ellipse.minor).atan2(s / ellipse.major)
    };
    let half = m[TANGENT].atan();
    let first = turned(m[ANGLE] - half);
    let opening = (turned(m[ANGLE] + half) - first).rem_euclid(PI);
    let (bisector, half) = match pattern {
        MarkerPattern::WhiteAlong => (first + 0.5 * (opening + PI), 0.5 * (PI - opening)),
        _ => (first + 0.5 * opening, 0.5 * opening),
    };
    let edge = m[LIGHT] - PATTERN.end_contrast * grey_contrast(m);
    // Distance at which black ends in a direction, radii.
    let end = |angle: f64| {
        let radius = along * (ellipse.major * angle.cos()) + across * (ellipse.minor * angle.sin());
        let light = |factor: &f64| {
            let at = ellipse.centre + radius * *factor;
            f64::from(image.nearest_value(at.x, at.y)) > edge
        };
        let steps = [PATTERN.end_range.start, PATTERN.end_range.end]
            .map(|v| (v / PATTERN.end_step).round() as i32);
        (steps[0]..steps[1])
            .map(|k| PATTERN.end_step * f64::from(k))
            .find(light)
            .unwrap_or(PATTERN.end_range.end)
    };
    [0.0, PI].iter().all(|side| {
        let at = |part: f64| end(bisector + side + part * half);
        at(0.0)
            > PATTERN.min_corner_ratio
                * 0.5
                * (at(-PATTERN.side_position) + at(PATTERN.side_position))
    })
}
