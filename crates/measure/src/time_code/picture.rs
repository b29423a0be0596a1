//! Reader of the time code in a frame: discs in, cells out.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::decode::{DisplayedTime, decode_time};
use super::{BITS, DISCS, cell_rectangle};
use crate::detect::Detections;
use crate::estimation::robust::median;
use crate::ordering::sort_by_value;
use crate::raster::Raster;
use crate::setup::Shape;

/// Maximum number of discs that are tried, the largest first.
const MAX_DISCS: usize = 8;
/// Minimum difference of white and black cells, grey levels.
const MIN_CONTRAST: f64 = 20.0;
/// Minimum side of a cell, px: below it blur mixes neighbours.
const MIN_SIDE_PX: f64 = 6.0;
/// Fraction of the contrast by which the cells of a bit must differ to be read: with a tone curve of 2.2, 10 % of the light
/// is then of the other value.
const MIN_BIT_CONTRAST: f64 = 0.6;
/// Range of the cells of a mixed bit, fractions of the contrast; outside it, glare or shade hides them.
const MIXED_RANGE: [f64; 2] = [0.1, 0.93];
/// Number of samples along each side of the middle half of a cell.
const SAMPLES: usize = 7;

/// Reason why an image gives no time, as a clause for the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TimeCodeError {
    /// Fewer than four discs.
    #[error(
        "{0} of the clock's four discs found; show the complete page, in focus and not over-exposed"
    )]
    NoDiscs(usize),
    /// No code between any four discs.
    #[error(
        "no time code found between four discs; show the complete page, expose for at most 60 ms, avoid \
         reflections"
    )]
    NoCode,
    /// Cells too small.
    #[error("the cells are less than {MIN_SIDE_PX} px wide; move the camera closer to the screen")]
    TooSmall,
    /// Glare or shade hides a bit.
    #[error("glare or shade hides a bit of the time code; turn the screen")]
    Hidden,
}

/// Reads the time that a frame shows of the clock's page.
///
/// # Errors
/// Returns an error if the time cannot be read unambiguously.
pub fn read_time(image: &Raster, found: &Detections) -> Result<DisplayedTime, TimeCodeError> {
    let mut discs: Vec<_> = found
        .markers
        .iter()
        .filter(|m| m.shape == Shape::Circle)
        .collect();
    sort_by_value(&mut discs, |one| -(one.semi_major_px * one.semi_minor_px));
    discs.truncate(MAX_DISCS);
    let centres: Vec<Vector2<f64>> = discs.iter().map(|d| d.centre_px).collect();
    let mut why = if centres.len() < 4 {
        TimeCodeError::NoDiscs(centres.len())
    } else {
        TimeCodeError::NoCode
    };
    for corners in convex_quadrangles(&centres) {
        for turn in 0..4 {
            let mut turned = corners;
            turned.rotate_left(turn);
            match pixel_from_page(&turned)
                .map_or(Err(TimeCodeError::NoCode), |h| read_cells(image, &h))
            {
                Ok(shown) => return Ok(shown),
                Err(TimeCodeError::NoCode) => {}
                Err(other) => why = other,
            }
        }
    }
    Err(why)
}

/// Returns every four of the points that form a convex quadrangle, clockwise in the image.
fn convex_quadrangles(points: &[Vector2<f64>]) -> Vec<[Vector2<f64>; 4]> {
    let n = points.len();
    let choices = (0u32..1 << n).filter(|set| set.count_ones() == 4);
    let corners = |set: u32| {
        let mut four: Vec<Vector2<f64>> = (0..n)
            .filter(|k| set >> k & 1 == 1)
            .map(|k| points[k])
            .collect();
        let middle = four.iter().sum::<Vector2<f64>>() / 4.0;
        let angle = |p: &Vector2<f64>| (p.y - middle.y).atan2(p.x - middle.x);
        four.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
        <[Vector2<f64>; 4]>::try_from(four).ok().filter(is_convex)
    };
    choices.filter_map(corners).collect()
}

fn is_convex(corners: &[Vector2<f64>; 4]) -> bool {
    let side = |k: usize| corners[(k + 1) % 4] - corners[k % 4];
    (0..4).all(|k| side(k).perp(&side(k + 1)) > 0.0)
}

/// Returns the map from page units to pixels by the images of the discs (Heckbert 1989); `None` if they are collinear.
fn pixel_from_page(corners: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let [a, b, c, d] = corners;
    let (right, down, sum) = (b - c, d - c, a - b + c - d);
    let area = right.perp(&down);
    let (g, h) = (sum.perp(&down) / area, right.perp(&sum) / area);
    let (x, y) = (b - a + b * g, d - a + d * h);
    let pixel_from_unit = Matrix3::new(x.x, y.x, a.x, x.y, y.y, a.y, g, h, 1.0);
    let [[left, top], [end, _], [_, bottom], _] = DISCS;
    let (width, height) = (end - left, bottom - top);
    let unit_from_page = Matrix3::new(
        1.0 / width,
        0.0,
        -left / width,
        0.0,
        1.0 / height,
        -top / height,
        0.0,
        0.0,
        1.0,
    );
    let all = pixel_from_unit * unit_from_page;
    all.iter().all(|v| v.is_finite()).then_some(all)
}

/// Reads the time in the cells between four discs.
///
/// # Errors
/// Returns an error if they contain no code, or one that is too small or hidden.
fn read_cells(
    image: &Raster,
    pixel_from_page: &Matrix3<f64>,
) -> Result<DisplayedTime, TimeCodeError> {
    let pairs: Vec<[f64; 2]> = (0..BITS)
        .map(|bit| {
            [false, true]
                .map(|opposite| cell_level(image, pixel_from_page, cell_rectangle(bit, opposite)))
        })
        .collect();
    let median_level = |values: Vec<f64>| median(values).ok_or(TimeCodeError::NoCode);
    let white = median_level(pairs.iter().map(|[a, b]| a.max(*b)).collect())?;
    let black = median_level(pairs.iter().map(|[a, b]| a.min(*b)).collect())?;
    let contrast = white - black;
    if contrast < MIN_CONTRAST {
        return Err(TimeCodeError::NoCode);
    }
    let (mut one, mut mixed, mut hidden) = (0, 0, false);
    for (bit, pair) in pairs.iter().enumerate() {
        let [share, opposite] = pair.map(|level| (level - black) / contrast);
        if share - opposite > MIN_BIT_CONTRAST {
            one |= 1 << bit;
        } else if opposite - share <= MIN_BIT_CONTRAST {
            mixed |= 1 << bit;
            hidden |= [share, opposite]
                .iter()
                .any(|s| !(MIXED_RANGE[0]..=MIXED_RANGE[1]).contains(s))
                && (share - opposite).abs() < 0.5 * MIN_BIT_CONTRAST;
        }
    }
    // The ends show that this is a time code.
    let ends = 1 | 1 << (BITS - 1);
    if one & ends != ends {
        return Err(TimeCodeError::NoCode);
    }
    let shown = decode_time(one, mixed).ok_or(TimeCodeError::NoCode)?;
    if hidden {
        return Err(TimeCodeError::Hidden);
    }
    if min_cell_side(pixel_from_page) < MIN_SIDE_PX {
        return Err(TimeCodeError::TooSmall);
    }
    Ok(shown)
}

/// Returns the mean grey level of the middle half of a cell.
fn cell_level(
    image: &Raster,
    pixel_from_page: &Matrix3<f64>,
    [x, y, width, height]: [f64; 4],
) -> f64 {
    let step = |k: usize| 0.25 + 0.5 * (k as f64 + 0.5) / SAMPLES as f64;
    let places = (0..SAMPLES * SAMPLES).map(|k| {
        (
            x + width * step(k % SAMPLES),
            y + height * step(k / SAMPLES),
        )
    });
    let sum: f64 = places
        .map(|(x, y)| {
            let p = project_point(pixel_from_page, x, y);
            f64::from(image.nearest_value(p.x, p.y))
        })
        .sum();
    sum / (SAMPLES * SAMPLES) as f64
}

fn project_point(pixel_from_page: &Matrix3<f64>, x: f64, y: f64) -> Vector2<f64> {
    let p = pixel_from_page * Vector3::new(x, y, 1.0);
    p.xy() / p.z
}

/// Returns the shortest side of any cell, px.
fn min_cell_side(pixel_from_page: &Matrix3<f64>) -> f64 {
    let sides = (0..BITS).flat_map(|bit| {
        let [x, y, width, height] = cell_rectangle(bit, false);
        let corner = project_point(pixel_from_page, x, y);
        let across = project_point(pixel_from_page, x + width, y) - corner;
        let down = project_point(pixel_from_page, x, y + height) - corner;
        [across.norm(), down.norm()]
    });
    sides.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_homography_maps_the_discs_to_their_images() {
        let corners = [
            (100.0, 80.0),
            (900.0, 120.0),
            (860.0, 600.0),
            (140.0, 500.0),
        ]
        .map(|(x, y)| Vector2::new(x, y));
        let h = pixel_from_page(&corners).unwrap();
        for (corner, [x, y]) in corners.iter().zip(DISCS) {
            assert!((project_point(&h, x, y) - corner).norm() < 1e-9);
        }
        let all = [corners.as_slice(), &[Vector2::new(500.0, 300.0)]].concat();
        // Quadrangles with the inner point are not convex.
        assert_eq!(
            convex_quadrangles(&all)
                .iter()
                .filter(|four| corners.iter().all(|c| four.contains(c)))
                .count(),
            1
        );
        assert!(convex_quadrangles(&[Vector2::zeros(); 4]).is_empty());
    }
}
