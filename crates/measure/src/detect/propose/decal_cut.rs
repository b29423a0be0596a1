//! Discs covered by the decal on which another marker is printed: the region the decal may hide, and the fit to the visible
//! part.

use nalgebra::{Matrix2, Vector2};

use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::estimate::options::PRIOR;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::hypothesis::prior::{PriorValue, SizePrior, SlopePrior};
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::numbers::TINY;
use crate::detect::occlusion::decal::{Decal, ROW_DIRECTION, blob_bounds, outline_bounds};
use crate::detect::occlusion::options::DECAL;
use crate::detect::propose::options::DECAL_CUT;
use crate::detect::segment::blob::Blob;
use crate::raster::Raster;

/// Returns an expected disc with the decals of other markers that may hide it, which lie in the direction `axis`: each with
/// a rim around its print, and with the last rows or columns of the disc's black near it, because blur mixes them with the
/// decal. `None` if no decal lies over the disc, or if too little of it is visible.
pub fn occluded_disc(
    image: &Raster,
    expected: &Hypothesis,
    others: &[Ellipse],
    axis: Vector2<f64>,
    blur: f64,
) -> Option<Hypothesis> {
    let disc = &expected.ellipse;
    let near = |other: &&Ellipse| {
        let [x0, y0, x1, y1] = outline_bounds(other, axis);
        let bounds = [
            x0 - DECAL.margin_px,
            y0 - DECAL.margin_px,
            x1 + DECAL.margin_px,
            y1 + DECAL.margin_px,
        ];
        let reach = Decal { axis, bounds };
        disc.outline_fraction(|at| reach.contains(at)) > DECAL_CUT.touches
    };
    let hidden: Vec<Decal> = others
        .iter()
        .filter(near)
        .map(|o| covering_decal(image, disc, o, axis, blur))
        .collect();
    let covered = disc.outline_fraction(|at| hidden.iter().any(|decal| decal.contains(at)));
    let useful = expected.pattern == MarkerPattern::Disc
        && !hidden.is_empty()
        && covered < DECAL_CUT.covered;
    useful.then(|| expected.clone().with_decals(hidden))
}

/// Returns the disc of which a blob shows the part that a neighbour's decal leaves visible. Its shape is that of the
/// neighbour, since both lie on the same skin, and its length is predicted, px. The decal lies in the direction `axis`.
pub fn disc_under_decal(
    image: &Raster,
    blob: &Blob,
    neighbour: &Ellipse,
    axis: Vector2<f64>,
    major: PriorValue,
    blur: f64,
) -> Option<Hypothesis> {
    let minor = neighbour.minor / neighbour.major * major.value;
    let shape = Ellipse {
        centre: blob.centroid,
        major: major.value,
        minor,
        angle: neighbour.angle,
    };
    let decal = Decal::from_target(
        axis,
        outline_bounds(neighbour, axis),
        blob_bounds(blob, axis),
        DECAL_CUT.cut_px,
    );
    let seen: Vec<Vector2<f64>> = blob
        .contour()
        .into_iter()
        .filter(|at| !decal.contains(at))
        .collect();
    let centre = fit_centre(&shape, &seen, neighbour.centre)?;
    let slope = SlopePrior {
        minor: PriorValue::with_relative_sigma(minor, DECAL_CUT.same_minor),
        angle: PriorValue {
            value: neighbour.angle,
            sigma: DECAL_CUT.same_angle_rad,
        },
    };
    let ellipse = Ellipse { centre, ..shape };
    let mut whole = Hypothesis::new(MarkerPattern::Disc, ellipse, Vec::new());
    whole.prior.size = Some(SizePrior {
        major,
        slope: Some(slope),
    });
    let covered = ellipse.outline_fraction(|at| decal.contains(at));
    if covered < PRIOR.max_hidden {
        occluded_disc(image, &whole, &[*neighbour], axis, blur)
    } else {
        None
    }
}

/// Fits the centre of an ellipse of known shape through points of its rim, on the side of its neighbour.
fn fit_centre(
    shape: &Ellipse,
    points: &[Vector2<f64>],
    neighbour: Vector2<f64>,
) -> Option<Vector2<f64>> {
    if points.len() < DECAL_CUT.min_points {
        return None;
    }
    // Mapped to a circle of radius 1.
    let whole = |at: Vector2<f64>| {
        let (s, t) = shape.local_position(at);
        Vector2::new(s / shape.major, t / shape.minor)
    };
    let round: Vec<Vector2<f64>> = points.iter().map(|&at| whole(at)).collect();
    let mean = round.iter().sum::<Vector2<f64>>() / round.len() as f64;
    let mut centre = mean + DECAL_CUT.first_step * (whole(neighbour) - mean).try_normalize(TINY)?;
    let mut square = f64::MAX;
    for _ in 0..DECAL_CUT.iterations {
        let (mut normal, mut right) = (Matrix2::identity() * TINY, Vector2::zeros());
        square = 0.0;
        for point in &round {
            let away = point - centre;
            let (norm, off) = (away.norm().max(TINY), away.norm() - 1.0);
            normal += away * away.transpose() / (norm * norm);
            right += away * (off / norm);
            square += off * off;
        }
        centre += normal.try_inverse()? * right;
    }
    let off = (square / round.len() as f64).sqrt() * shape.minor;
    let back = shape.major_direction() * (centre.x * shape.major)
        + shape.minor_direction() * (centre.y * shape.minor);
    (off < DECAL_CUT.off_px).then(|| shape.centre + back)
}

/// Returns the box (first and last column and row) that the decal of a disc may cover.
pub fn decal_reach(disc: &Ellipse) -> [f64; 4] {
    let ([x0, y0, x1, y1], by) = (
        outline_bounds(disc, ROW_DIRECTION),
        DECAL.margin_px + DECAL_CUT.aside_px,
    );
    [x0 - by, y0 - by, x1 + by, y1 + by]
}

/// Returns true if a blob overlaps a box.
pub fn overlaps_box(blob: &Blob, [x0, y0, x1, y1]: &[f64; 4]) -> bool {
    let [left, top, right, low] = blob.bounds.map(|v| v as f64);
    left < *x1 && right > *x0 && top < *y1 && low > *y0
}

/// Returns the part of an expected disc that the decal of a neighbour, in the direction `axis`, may cover.
fn covering_decal(
    image: &Raster,
    expected: &Ellipse,
    other: &Ellipse,
    axis: Vector2<f64>,
    blur: f64,
) -> Decal {
    let print = outline_bounds(other, axis);
    let reach = expected.half_extent().add_scalar(2.0 * DECAL.margin_px);
    let around = image
        .pixels_in_box(expected.centre - reach, expected.centre + reach, 2)
        .map(|(_, _, value)| value);
    let skin = Histogram::from_values(around).median().unwrap_or(255) as u8;
    let level = image
        .nearest_value(other.centre.x, other.centre.y)
        .midpoint(skin);
    let grown = expected.enlarged(1.0, DECAL_CUT.aside_px);
    // True if a line next to the print, at a distance from its middle, shows black of the disc within bounds.
    let shows = |bounds: &[f64; 4], along_rows: bool, at: f64| {
        let (from, to) = if along_rows {
            (bounds[0], bounds[2])
        } else {
            (bounds[1], bounds[3])
        };
        (from.floor() as i64..=to.ceil() as i64).any(|k| {
            let (s, t) = if along_rows {
                (k as f64, at)
            } else {
                (at, k as f64)
            };
            let place = axis * s + Vector2::new(-axis.y, axis.x) * t;
            grown.contains(place) && image.nearest_value(place.x, place.y) < level
        })
    };
    let (mut bounds, mut white) = (print, print);
    // Above and below the print first: to its sides, black that is visible there is not covered.
    for k in [1, 3, 0, 2] {
        let (along_rows, sign) = (k % 2 == 1, if k < 2 { -1.0 } else { 1.0 });
        let [most, default] = if along_rows {
            [2.0 * DECAL.margin_px, DECAL.margin_px]
        } else {
            [DECAL_CUT.side_px; 2]
        };
        let mut lines = (3..=most as usize).map(|j| print[k].round() + sign * j as f64);
        let black = lines.find(|&at| shows(&white, along_rows, at));
        let hidden = black.map_or(default, |at| {
            sign * (at - print[k]) + DECAL_CUT.edge_blurs * blur - 0.5
        });
        bounds[k] = print[k] + sign * hidden;
        white[k] = black.map_or(bounds[k], |at| at - sign);
    }
    Decal { axis, bounds }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPECTED: Ellipse = Ellipse {
        centre: Vector2::new(100.0, 50.0),
        major: 40.0,
        minor: 6.0,
        angle: 0.0,
    };

    /// Decals found for the expected disc, covered by the decal of a neighbour from a row on.
    fn hidden(other: Ellipse, decal_from: usize) -> Option<Vec<Decal>> {
        let grey = |i: usize| {
            let at = Vector2::new((i % 200) as f64, (i / 200) as f64);
            let black = other.contains(at) || (i / 200 < decal_from && EXPECTED.contains(at));
            if black { 50 } else { 180 }
        };
        let image = Raster::new(200, 120, (0..200 * 120).map(grey).collect())?;
        let expected = Hypothesis::new(MarkerPattern::Disc, EXPECTED, Vec::new());
        occluded_disc(&image, &expected, &[other], ROW_DIRECTION, 1.0)
            .map(|hypothesis| hypothesis.decals().copied().collect())
    }

    #[test]
    fn decal_extends_from_its_print_to_the_last_black_row() {
        let other = |y: f64| Ellipse {
            centre: Vector2::new(95.0, y),
            ..EXPECTED
        };
        let seen = hidden(other(61.0), 51).expect("a decal covers it");
        // The last black row is 50; two blurs before its edge at 50.5 are excluded.
        let want = [
            55.0 - DECAL_CUT.side_px,
            50.5 - DECAL_CUT.edge_blurs,
            135.0 + DECAL_CUT.side_px,
            61.0 + 13.0,
        ];
        assert!(
            seen.len() == 1
                && seen[0]
                    .bounds
                    .iter()
                    .zip(want)
                    .all(|(a, b)| (a - b).abs() < 1e-9),
            "{seen:?}"
        );
        // A distant decal hides nothing; a disc that is almost completely hidden gives no result.
        assert_eq!(hidden(other(75.0), 51), None);
        assert_eq!(hidden(other(56.0), 45), None);
    }
}
