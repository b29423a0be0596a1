//! Decal on which a marker is printed and which may cover its neighbour.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use nalgebra::Vector2;

use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::options::DECAL;
use crate::detect::segment::blob::Blob;

/// Direction of the rows of the image, along which decals are assumed to lie at first.
pub const ROW_DIRECTION: Vector2<f64> = Vector2::new(1.0, 0.0);

/// Rectangle of the image that a decal may cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decal {
    /// Unit vector along two of its sides.
    pub axis: Vector2<f64>,
    /// Bounds of the rectangle along the axis and across it, from the origin of the image, px: first and last of each.
    pub bounds: [f64; 4],
}

impl Decal {
    /// Returns true if the point lies in the rectangle.
    pub fn contains(&self, at: &Vector2<f64>) -> bool {
        let [x0, y0, x1, y1] = self.bounds;
        let at = rotate_into(self.axis, at);
        (x0..=x1).contains(&at.x) && (y0..=y1).contains(&at.y)
    }

    /// Returns the rectangle that the decal of a target may cover of a blob, both given by their bounds in the direction
    /// `axis`: the target, and the last `blur_px` of the blob if it ends near the target, because blur mixes them with the
    /// decal.
    pub fn from_target(axis: Vector2<f64>, target: [f64; 4], blob: [f64; 4], blur_px: f64) -> Self {
        let mut bounds = target;
        for k in 0..2 {
            let (before, after) = (target[k] - blob[k + 2], blob[k] - target[k + 2]);
            if (0.0..2.0 * DECAL.margin_px).contains(&before) {
                bounds[k] = bounds[k].min(blob[k + 2] - blur_px);
            }
            if (0.0..2.0 * DECAL.margin_px).contains(&after) {
                bounds[k + 2] = bounds[k + 2].max(blob[k] + blur_px);
            }
        }
        Self { axis, bounds }
    }
}

/// Returns the position along and across a direction, px.
fn rotate_into(axis: Vector2<f64>, at: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(axis.dot(at), axis.perp(at))
}

/// Returns the bounds of an outline in a direction, px.
pub fn outline_bounds(ellipse: &Ellipse, axis: Vector2<f64>) -> [f64; 4] {
    let level = Ellipse {
        angle: ellipse.angle - axis.y.atan2(axis.x),
        ..*ellipse
    };
    let (middle, extent) = (rotate_into(axis, &ellipse.centre), level.half_extent());
    let (low, high) = (middle - extent, middle + extent);
    [low.x, low.y, high.x, high.y]
}

/// Returns the bounds of a blob's pixels in a direction, px.
pub fn blob_bounds(blob: &Blob, axis: Vector2<f64>) -> [f64; 4] {
    if axis == ROW_DIRECTION {
        return blob.bounds.map(|v| v as f64);
    }
    let ends = blob
        .runs
        .iter()
        .flat_map(|&[y, from, to]| [from, to].map(|x| (x, y)));
    let mut out = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    for (x, y) in ends {
        let at = rotate_into(axis, &Vector2::new(f64::from(x), f64::from(y)));
        out = [
            out[0].min(at.x),
            out[1].min(at.y),
            out[2].max(at.x),
            out[3].max(at.y),
        ];
    }
    out
}

/// Returns the direction in which the decal of a neighbour cuts a blob: that of the line on which most of the blob's rim
/// towards the neighbour lies, within 45 degrees of the rows. `None` if there is no such line or it lies along rows or
/// columns.
pub fn find_cut_direction(blob: &Blob, neighbour: &Ellipse) -> Option<Vector2<f64>> {
    let outwards =
        |[one, other]: [Vector2<f64>; 2]| (neighbour.centre - one).dot(&(one - other)) > 0.0;
    let points: Vec<Vector2<f64>> = blob
        .contour()
        .as_chunks::<2>()
        .0
        .iter()
        .flat_map(|&[one, other]| [[one, other], [other, one]])
        .filter(|&pair| outwards(pair))
        .map(|[one, _]| one)
        .collect();
    let points: Vec<Vector2<f64>> = points
        .iter()
        .step_by(points.len().div_ceil(DECAL.line_points).max(1))
        .copied()
        .collect();
    let on = |at: Vector2<f64>, axis: Vector2<f64>| {
        points
            .iter()
            .filter(move |&point| axis.perp(&(point - at)).abs() < DECAL.line_off_px)
    };
    let (mut line, mut most) = ((Vector2::zeros(), ROW_DIRECTION), 0);
    for (i, one) in points.iter().enumerate() {
        for other in &points[i + 1..] {
            let Some(axis) = (other - one).try_normalize(DECAL.line_reach_px) else {
                continue;
            };
            let count = on(*one, axis).count();
            if count > most {
                (line, most) = ((*one, axis), count);
            }
        }
    }
    if most < DECAL.line_support {
        return None;
    }
    let middle = on(line.0, line.1).sum::<Vector2<f64>>() / most as f64;
    let moments = on(line.0, line.1)
        .map(|at| (at - middle) * (at - middle).transpose())
        .sum();
    let angle = Ellipse::from_moments(middle, moments, 1.0).angle;
    let angle = if angle.abs() > FRAC_PI_4 {
        angle - FRAC_PI_2.copysign(angle)
    } else {
        angle
    };
    (angle.abs() > DECAL.level_rad).then(|| Vector2::new(angle.cos(), angle.sin()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::segment::blob::dark_parts;
    use crate::raster::Raster;

    /// Direction found for an ellipse that is cut at its lower side along a line with a slope.
    fn cut_angle(slope: f64) -> Option<f64> {
        let disc = Ellipse {
            centre: Vector2::new(100.0, 50.0),
            major: 40.0,
            minor: 6.0,
            angle: -0.05,
        };
        let neighbour = Ellipse {
            centre: Vector2::new(104.0, 64.0),
            ..disc
        };
        let grey = |i: usize| {
            let at = Vector2::new((i % 200) as f64, (i / 200) as f64);
            let black = disc.contains(at) && at.y < 51.3 + slope * (at.x - 100.0);
            if black { 50 } else { 180 }
        };
        let image = Raster::new(200, 120, (0..200 * 120).map(grey).collect())?;
        let blobs = dark_parts(&image, &disc, 6.0, 120);
        find_cut_direction(blobs.first()?, &neighbour).map(|axis| axis.y.atan2(axis.x))
    }

    #[test]
    fn cut_line_gives_the_direction_of_the_decal() {
        for slope in [-0.2, -0.1, -0.05, 0.05, 0.1, 0.2f64] {
            let angle = cut_angle(slope).expect("a slanting line");
            assert!((angle - slope.atan()).abs() < 0.012, "{slope}: {angle}");
        }
        assert_eq!(cut_angle(0.0), None, "rows are the default direction");
    }

    #[test]
    fn bounds_rotate_with_their_direction() {
        let ellipse = Ellipse {
            centre: Vector2::new(30.0, 20.0),
            major: 10.0,
            minor: 2.0,
            angle: 0.3,
        };
        let axis = ellipse.major_direction();
        let [x0, y0, x1, y1] = outline_bounds(&ellipse, axis);
        assert!((x1 - x0 - 20.0).abs() < 1e-9 && (y1 - y0 - 4.0).abs() < 1e-9);
        let decal = Decal::from_target(axis, [x0, y0, x1, y1], [x0, y1 + 5.0, x1, y1 + 9.0], 2.5);
        // The blob begins 5 px beyond the print; one blur more than that is hidden.
        let across = Vector2::new(-axis.y, axis.x);
        assert!(
            decal.contains(&(ellipse.centre + across * 9.4))
                && !decal.contains(&(ellipse.centre + across * 9.6))
        );
        assert!(
            decal.contains(&(ellipse.centre + axis * 9.9))
                && !decal.contains(&(ellipse.centre + axis * 10.1))
        );
        assert_eq!(
            outline_bounds(&ellipse, ROW_DIRECTION)[0],
            ellipse.centre.x - ellipse.half_extent().x
        );
    }
}
