//! Edges of quadrants with a known outline: the directions that best separate dark from light.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;

use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::{ellipse::Ellipse, scanline::EllipseFrame};
use crate::detect::occlusion::region::OcclusionBand;
use crate::detect::propose::{moments, options::EDGES};
use crate::raster::Raster;

/// Number of directions in a quarter.
const QUARTER_TURNS: usize = EDGES.turns / 4;

/// Finds the edges of quadrants in an outline that contains black and white: the pair of conjugate diameters that best
/// separates dark from light. Returns `None` unless both black quadrants are darker than both white ones.
pub fn find_edges(ellipse: Ellipse, image: &Raster, blobs: &[usize]) -> Option<Hypothesis> {
    OutlineSectors::from_outline(ellipse)
        .search_edges(image, &[], [0; 2])
        .build_hypothesis(blobs)
}

/// Places quadrants whose outline is known except for its exact position, outside the bands hidden by glare: at the shift
/// that best separates dark from light.
pub fn place_quadrants(
    ellipse: &Ellipse,
    image: &Raster,
    bands: &[OcclusionBand],
) -> Option<Hypothesis> {
    let turns = OutlineSectors::from_outline(*ellipse);
    let shifts = (-EDGES.steps..=EDGES.steps)
        .flat_map(|u| (-EDGES.steps..=EDGES.steps).map(move |v| [u, v]));
    let searches = shifts
        .map(|shift| turns.search_edges(image, bands, shift.map(|v| EDGES.step_px * v as isize)));
    searches
        .max_by(|one, other| one.best_direction().1.total_cmp(&other.best_direction().1))?
        .build_hypothesis(&[])
}

/// Pixels of an outline, except for the outermost, with their direction in the outline mapped to a circle.
struct OutlineSectors {
    ellipse: Ellipse,
    /// Step between the rows and columns that are used, px.
    step: usize,
    /// Column, row, direction.
    pixels: Vec<(isize, isize, usize)>,
}

impl OutlineSectors {
    fn from_outline(ellipse: Ellipse) -> Self {
        let (frame, reach) = (EllipseFrame::new(&ellipse), ellipse.half_extent());
        let area = PI * ellipse.major * ellipse.minor * EDGES.inner * EDGES.inner;
        let step = (area / EDGES.pixels).sqrt().max(1.0) as usize;
        let side = |k: usize| {
            let (low, high) = (ellipse.centre[k] - reach[k], ellipse.centre[k] + reach[k]);
            (low.floor() as isize..high.floor() as isize).step_by(step)
        };
        let mut pixels = Vec::new();
        for (y, x) in side(1).flat_map(|y| side(0).map(move |x| (y, x))) {
            let (s, t) = frame.to_local(x as f64, y as f64);
            let (p, q) = (s / ellipse.major, t / ellipse.minor);
            if p * p + q * q < EDGES.inner * EDGES.inner {
                let turn =
                    (q.atan2(p).rem_euclid(TAU) / TAU * EDGES.turns as f64) as usize % EDGES.turns;
                pixels.push((x, y, turn));
            }
        }
        Self {
            ellipse,
            step,
            pixels,
        }
    }

    /// Searches the edges in an image within the outline, shifted by whole pixels, outside some bands.
    fn search_edges(
        &self,
        image: &Raster,
        bands: &[OcclusionBand],
        [right, down]: [isize; 2],
    ) -> EdgeSearch {
        let mut sums = [(0.0, 0.0); EDGES.turns];
        let mut squares = 0.0;
        for &(x, y, turn) in &self.pixels {
            let (x, y) = (x + right, y + down);
            let hidden = || {
                bands
                    .iter()
                    .any(|band| band.contains(&Vector2::new(x as f64, y as f64)))
            };
            if !image.contains(x, y) || hidden() {
                continue;
            }
            let value = f64::from(image.clamped_value(x, y));
            sums[turn].0 += value;
            sums[turn].1 += 1.0;
            squares += value * value;
        }
        let centre = self.ellipse.centre + Vector2::new(right as f64, down as f64);
        EdgeSearch::from_sums(
            Ellipse {
                centre,
                ..self.ellipse
            },
            self.step,
            &sums,
            squares,
        )
    }
}

/// Grey values within an outline by their direction in the outline mapped to a circle.
struct EdgeSearch {
    ellipse: Ellipse,
    /// Step between the rows and columns that are used, px.
    step: usize,
    /// Sum of grey values and number of pixels in the quarter that begins in each direction.
    quarters: [(f64, f64); EDGES.turns],
    /// Sum of squares of all grey values relative to their mean.
    squares: f64,
}

impl EdgeSearch {
    /// Computes the search from sum and number of grey values in each direction, and the sum of their squares.
    fn from_sums(
        ellipse: Ellipse,
        step: usize,
        sums: &[(f64, f64); EDGES.turns],
        squares: f64,
    ) -> Self {
        let add = |(v, n): (f64, f64), (sum, count): (f64, f64)| (v + sum, n + count);
        let quarters = std::array::from_fn(|from| {
            (0..QUARTER_TURNS)
                .map(|k| sums[(from + k) % EDGES.turns])
                .fold((0.0, 0.0), add)
        });
        let (sum, count) = sums.iter().copied().fold((0.0, 0.0), add);
        let squares = squares - sum * sum / f64::max(count, 1.0);
        Self {
            ellipse,
            step,
            quarters,
            squares: squares.max(1.0),
        }
    }

    fn opposite_quarter_sums(&self, turn: usize) -> [(f64, f64); 2] {
        [turn, turn + 2 * QUARTER_TURNS].map(|turn| self.quarters[turn % EDGES.turns])
    }

    /// Returns the direction in which two opposite quarters are darkest relative to the other two, and the fraction of the
    /// squares that this explains.
    fn best_direction(&self) -> (usize, f64) {
        let both = |turn: usize| {
            let [(one, m), (other, n)] = self.opposite_quarter_sums(turn);
            (one + other, f64::max(m + n, 1.0))
        };
        let lighter = |turn: usize| {
            let ((black, m), (white, n)) = (both(turn), both(turn + QUARTER_TURNS));
            let lighter = white / n - black / m;
            (
                turn,
                lighter * lighter.abs() * m * n / (m + n) / self.squares,
            )
        };
        let better =
            |best: (usize, f64), other: (usize, f64)| if other.1 > best.1 { other } else { best };
        (0..2 * QUARTER_TURNS)
            .map(lighter)
            .fold((0, f64::MIN), better)
    }

    fn build_hypothesis(&self, blobs: &[usize]) -> Option<Hypothesis> {
        let (ellipse, (darkest, _)) = (self.ellipse, self.best_direction());
        // A quadrant less than half visible may belong to another marker.
        let least = 0.5 * EDGES.inner * EDGES.inner * PI / 4.0 * ellipse.major * ellipse.minor
            / (self.step * self.step) as f64;
        let seen = |turn: usize| {
            let seen = self
                .opposite_quarter_sums(turn)
                .into_iter()
                .filter(|(_, count)| *count > least);
            seen.map(|(sum, count)| sum / count)
        };
        if seen(darkest + QUARTER_TURNS).fold(f64::MAX, f64::min)
            <= seen(darkest).fold(0.0, f64::max)
        {
            return None;
        }
        let (half, across) = (
            ellipse.major_direction() * ellipse.major,
            ellipse.minor_direction() * ellipse.minor,
        );
        let edge = |turn: usize| {
            let (q, p) = (TAU * turn as f64 / EDGES.turns as f64).sin_cos();
            half * p + across * q
        };
        Some(moments::quadrants_from_edges(
            edge(darkest),
            edge(darkest + QUARTER_TURNS),
            ellipse,
            blobs,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadrants_with_an_end_in_glare_are_placed_by_their_edges() {
        let truth = Ellipse {
            centre: Vector2::new(150.0, 100.0),
            major: 80.0,
            minor: 20.0,
            angle: 0.1,
        };
        let frame = EllipseFrame::new(&truth);
        // Edges at 40 and 130 degrees of the outline mapped to a circle; glare from column 165 on.
        let value = |i: usize| {
            let (x, y) = (i % 300, i / 300);
            let (s, t) = frame.to_local(x as f64, y as f64);
            let (p, q) = (s / truth.major, t / truth.minor);
            let turn = q.atan2(p).to_degrees().rem_euclid(180.0);
            match (x >= 165, p * p + q * q < 1.0) {
                (true, _) => 255,
                (_, false) => 140,
                _ if (40.0..130.0).contains(&turn) => 50,
                _ => 200,
            }
        };
        let image =
            Raster::new(300, 200, (0..300 * 200).map(value).collect()).expect("the sizes agree");
        let bands = [OcclusionBand {
            axis: Vector2::x(),
            from: 163.0,
            to: f64::INFINITY,
        }];
        for off in [
            Vector2::new(3.0, -1.5),
            Vector2::new(-4.0, 2.0),
            Vector2::zeros(),
        ] {
            let inner = Ellipse {
                centre: truth.centre + off,
                major: 60.0,
                minor: 15.0,
                ..truth
            };
            let placed = place_quadrants(&inner, &image, &bands).expect("is placed");
            let apart = placed.ellipse.centre - truth.centre;
            let (along, across) = (
                apart.dot(&truth.major_direction()),
                apart.dot(&truth.minor_direction()),
            );
            assert!(
                along.abs() < 3.0 && across.abs() < 1.6,
                "{off:?}: {along:.1} along, {across:.1} across"
            );
        }
    }
}
