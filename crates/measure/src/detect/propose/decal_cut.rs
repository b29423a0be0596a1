//! Discs partly covered by another object, as the decal on which another marker is printed: the pixels that show it, and
//! the first outline from the visible part.

use std::rc::Rc;

use nalgebra::{Matrix2, Vector2};

use crate::detect::appearance::parameters::{EDGE_SKIRT_BLURS, MarkerPattern};
use crate::detect::estimate::options::PRIOR;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::hypothesis::prior::{PriorValue, SizePrior, SlopePrior};
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::numbers::TINY;
use crate::detect::occlusion::{mask::PixelMask, region::Region};
use crate::detect::propose::options::COVER;
use crate::detect::propose::quadrant_outline::{grey_values_inside, skin_grey};
use crate::detect::segment::blob::Blob;
use crate::raster::Raster;

/// Returns an expected disc without the pixels that show something else: those within its outline that are nearer to the
/// skin than to its black, and those outside that are nearer to black, each with a margin for the blur. `None` if nothing
/// hides a part of it, or more than the fraction `most` of its outline.
pub fn covered_disc(
    image: &Raster,
    expected: &Hypothesis,
    blur: f64,
    most: f64,
) -> Option<Hypothesis> {
    let disc = &expected.ellipse;
    let reach = disc.half_extent().add_scalar(COVER.reach_px);
    let (low, high) = (disc.centre - reach, disc.centre + reach);
    let own = Histogram::from_values(grey_values_inside(image, disc));
    // A tenth of the disc is black even if little of it is visible.
    let black = own.value_at_rank(own.total() / 10)?;
    let half = black.midpoint(skin_grey(image, low, high)?);
    let last = [image.width() - 1, image.height() - 1];
    let limit = |v: f64, k: usize| (v.max(0.0) as usize).min(last[k]);
    let area = [
        limit(low.x, 0),
        limit(low.y, 1),
        limit(high.x, 0),
        limit(high.y, 1),
    ];
    let inner = disc.enlarged(1.0, -blur.min(0.5 * disc.minor));
    let outer = disc.enlarged(1.0, COVER.aside_px + blur);
    let mut mask = PixelMask::new(area, (EDGE_SKIRT_BLURS * blur).ceil() as usize);
    for (x, y, value) in image.pixels_in_box(low, high, 1) {
        let at = Vector2::new(x as f64, y as f64);
        let is_foreign = if usize::from(value) > half {
            inner.contains(at)
        } else {
            !outer.contains(at)
        };
        if is_foreign {
            mask.mark_run(y, x, x);
        }
    }
    let hidden = disc.outline_fraction(|at| mask.contains(at));
    let useful = expected.pattern == MarkerPattern::Disc && (COVER.touches..most).contains(&hidden);
    useful.then(|| {
        let mut out = expected.clone();
        out.excluded.push(Region::Cover(Rc::new(mask)));
        out
    })
}

/// Returns the disc of which a blob shows the part that the decal of a neighbour leaves visible. Its shape is that of the
/// neighbour, since both lie on the same skin, and its length is predicted, px.
pub fn disc_under_decal(
    image: &Raster,
    blob: &Blob,
    neighbour: &Ellipse,
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
    let centre = fit_centre(&shape, &blob.contour(), neighbour.centre)?;
    let slope = SlopePrior {
        minor: PriorValue::with_relative_sigma(minor, COVER.same_minor),
        angle: PriorValue {
            value: neighbour.angle,
            sigma: COVER.same_angle_rad,
        },
    };
    let ellipse = Ellipse { centre, ..shape };
    let mut whole = Hypothesis::new(MarkerPattern::Disc, ellipse, Vec::new());
    whole.prior.size = Some(SizePrior {
        major,
        slope: Some(slope),
    });
    covered_disc(image, &whole, blur, PRIOR.max_hidden)
}

/// Fits the centre of an ellipse of known shape, on the side of its neighbour, through the points of a contour that face
/// away from it: the others may lie on the edge of the decal.
fn fit_centre(
    shape: &Ellipse,
    contour: &[Vector2<f64>],
    neighbour: Vector2<f64>,
) -> Option<Vector2<f64>> {
    // Mapped to a circle of radius 1, from the middle of the visible part.
    let whole = |at: Vector2<f64>| {
        let (s, t) = shape.local_position(at);
        Vector2::new(s / shape.major, t / shape.minor)
    };
    let towards = whole(neighbour).try_normalize(TINY)?;
    let round: Vec<Vector2<f64>> = contour
        .iter()
        .map(|&at| whole(at))
        .filter(|at| at.dot(&towards) < 0.0)
        .collect();
    if round.len() < COVER.min_points {
        return None;
    }
    let mut centre = COVER.first_step * towards;
    let mut square = f64::MAX;
    for _ in 0..COVER.iterations {
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
    (off < COVER.off_px).then(|| shape.centre + back)
}

/// Returns the box (first and last column and row) that the decal of a disc may cover.
pub fn decal_reach(disc: &Ellipse) -> [f64; 4] {
    let reach = disc.half_extent().add_scalar(COVER.margin_px);
    let (low, high) = (disc.centre - reach, disc.centre + reach);
    [low.x, low.y, high.x, high.y]
}

/// Returns true if a blob overlaps a box.
pub fn overlaps_box(blob: &Blob, [x0, y0, x1, y1]: &[f64; 4]) -> bool {
    let [left, top, right, low] = blob.bounds.map(|v| v as f64);
    left < *x1 && right > *x0 && top < *y1 && low > *y0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::segment::blob::dark_parts;

    const DISC: Ellipse = Ellipse {
        centre: Vector2::new(100.0, 50.0),
        major: 40.0,
        minor: 8.0,
        angle: 0.1,
    };

    /// A disc on skin that is covered from a row on, with a slope.
    fn cut_from(row: f64, slope: f64) -> Raster {
        let grey = |i: usize| {
            let at = Vector2::new((i % 200) as f64, (i / 200) as f64);
            let black = DISC.contains(at) && at.y < row + slope * (at.x - 100.0);
            if black { 50 } else { 180 }
        };
        Raster::new(200, 100, (0..200 * 100).map(grey).collect()).expect("the sizes agree")
    }

    #[test]
    fn pixels_over_a_disc_are_excluded() {
        let expected = Hypothesis::new(MarkerPattern::Disc, DISC, Vec::new());
        let hidden = |row| covered_disc(&cut_from(row, 0.0), &expected, 1.0, 0.85);
        let half = hidden(50.0).expect("half of it is visible");
        let excludes = |x, y| half.excludes(&Vector2::new(x, y));
        assert!(half.is_covered() && excludes(100.0, 54.0) && !excludes(100.0, 44.0));
        assert_eq!(hidden(100.0), None, "nothing lies over it");
        assert_eq!(hidden(44.0), None, "too little is visible");
    }

    #[test]
    fn the_visible_rim_gives_the_first_outline() {
        let neighbour = Ellipse {
            centre: Vector2::new(104.0, 68.0),
            ..DISC
        };
        let major = PriorValue::with_relative_sigma(DISC.major, 0.01);
        for slope in [-0.15, 0.0, 0.15] {
            let image = cut_from(51.0, slope);
            let parts = dark_parts(&image, &DISC, 6.0, 120);
            let found = disc_under_decal(&image, &parts[0], &neighbour, major, 1.0);
            let off = found.expect("it is visible").ellipse.centre - DISC.centre;
            assert!(off.norm() < 1.5, "{slope}: {off}");
        }
    }
}
