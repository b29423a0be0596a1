//! Quadrants so narrow that blur leaves too little of their black to recognise them by black alone: by black and white.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2};

use super::quadrant_outline::{grey_values_inside, skin_grey};
use crate::detect::estimate::options::{OUTLINED, PRIOR};
use crate::detect::hypothesis::{Hypothesis, prior::MarkerPrior};
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::propose::{moments, options::BLURRED, quadrant_edges};
use crate::detect::segment::bitmask::LevelSide;
use crate::detect::segment::blob::{self, Blob};
use crate::ordering::sort_by_value;
use crate::raster::Raster;

/// Segments flat quadrants again, of whose black blur has left only the middle, by all parts that differ from the skin,
/// black and white. Returns `None` for quadrants that are too thick for the maximum blur `softest`, px.
pub fn resegment_against_skin(
    image: &Raster,
    hypothesis: &Hypothesis,
    softest: f64,
) -> Option<Hypothesis> {
    let seen = &hypothesis.ellipse;
    if hypothesis.edges.is_none()
        || hypothesis.prior.blur.is_some()
        || seen.minor > BLURRED.max_blurs * softest
        || seen.major < BLURRED.flat * seen.minor
    {
        return None;
    }
    let found = quadrants_from_black_and_white(image, seen, &hypothesis.blobs)?;
    let prior = MarkerPrior {
        edge: hypothesis.prior.edge,
        ..found.prior
    };
    Some(Hypothesis { prior, ..found })
}

/// Finds quadrants whose black shows as two blobs, near each other, or as one, too blurred to be recognised by
/// black alone. Only blobs that are `wanted` and are no discs are used.
pub fn find_narrow_quadrants(
    image: &Raster,
    blobs: &[Blob],
    near: &[[usize; 2]],
    taken: &[bool],
    noise: f64,
    wanted: impl Fn(&Ellipse) -> bool,
    mut is_disc: impl FnMut(usize) -> bool,
) -> Vec<Hypothesis> {
    let mut may_be = |(i, (blob, taken)): (usize, (&Blob, &bool))| {
        let seen = Ellipse::from_blob(blob);
        let free = !taken
            && !blob.at_edge
            && blob.area > BLURRED.min_area_px
            && seen.minor < PRIOR.narrow_px
            && wanted(&seen);
        let contrast = if free {
            white_black_contrast(image, blob, noise)
        } else {
            None
        };
        contrast.filter(|_| !is_disc(i))
    };
    let contrasts: Vec<Option<usize>> = blobs
        .iter()
        .zip(taken)
        .enumerate()
        .map(&mut may_be)
        .collect();
    let pairs = near.iter().copied().map(Vec::from);
    let single = (0..blobs.len()).map(|i| vec![i]);
    let mut out: Vec<Hypothesis> = Vec::new();
    let seeds = pairs.chain(single).filter_map(|seed| {
        let contrast = seed.iter().map(|&i| contrasts[i]).min()??;
        // Noise has less contrast than markers; texture next to the wing is smaller.
        let area: f64 = seed.iter().map(|&i| blobs[i].area).sum();
        Some((
            contrast as f64 * area.sqrt(),
            moments::inertia_ellipse(&seed, blobs)?,
            seed,
        ))
    });
    let mut seeds: Vec<(f64, Ellipse, Vec<usize>)> = seeds.collect();
    sort_by_value(&mut seeds, |(one, ..)| -one);
    seeds.truncate(BLURRED.max_seeds);
    // Pairs of parts of a marker come before single parts.
    sort_by_value(&mut seeds, |(_, one, _)| -one.major);
    for (_, seen, seed) in seeds {
        if out.iter().any(|c| seed.iter().any(|i| c.blobs.contains(i))) {
            continue;
        }
        let Some(mut found) = quadrants_from_black_and_white(image, &seen, &[]) else {
            continue;
        };
        found.blobs = (0..blobs.len())
            .filter(|&i| found.ellipse.contains(blobs[i].centroid))
            .collect();
        out.push(found);
    }
    out
}

/// Returns the difference between the lightest and the darkest grey level around a blob, if something there is lighter than
/// the skin, as white is next to black.
fn white_black_contrast(image: &Raster, blob: &Blob, noise: f64) -> Option<usize> {
    let [x0, y0, x1, y1] = blob.bounds.map(|v| v as f64);
    let margin = Ellipse::from_blob(blob)
        .half_extent()
        .add_scalar(BLURRED.beside_px);
    let low = Vector2::new(x0, y0) - margin;
    let high = Vector2::new(x1, y1).add_scalar(1.0) + margin;
    let counts =
        Histogram::from_values(image.pixels_in_box(low, high, 2).map(|(_, _, value)| value));
    let at = |share: usize| {
        counts
            .value_at_rank(counts.total() * share / 32)
            .unwrap_or(0)
    };
    let (black, skin, white) = (at(0), at(16), at(31));
    // The lightest pixels of a large area of skin exceed its median by twice the noise.
    let contrast = white.saturating_sub(black);
    (white.saturating_sub(skin) as f64 > OUTLINED.whiter * contrast as f64 + 2.0 * noise)
        .then_some(contrast)
}

/// Determines outline and edges of quadrants from all parts around the visible one that differ from the skin.
fn quadrants_from_black_and_white(
    image: &Raster,
    seen: &Ellipse,
    blobs: &[usize],
) -> Option<Hypothesis> {
    if seen.major > BLURRED.max_major_px {
        return None;
    }
    let found = quadrant_edges::find_edges(contrasting_outline(image, seen)?, image, blobs)?;
    let prior = MarkerPrior {
        blur: Some(BLURRED.blur_px),
        ..found.prior
    };
    Some(Hypothesis { prior, ..found })
}

/// Returns the outline of all parts around the visible part of quadrants that differ from the skin.
fn contrasting_outline(image: &Raster, seen: &Ellipse) -> Option<Ellipse> {
    let mut seen = *seen;
    for _ in 0..BLURRED.max_rounds {
        let (major, minor) = (
            (BLURRED.hidden * seen.major + BLURRED.skin_px).max(BLURRED.half_px),
            BLURRED.hidden * seen.minor + BLURRED.skin_px,
        );
        let longest = Ellipse {
            major,
            minor,
            ..seen
        };
        let reach = longest.half_extent();
        let (low, high) = (seen.centre - reach, seen.centre + reach);
        let skin = skin_grey(image, low, high)?;
        let black = usize::from(grey_values_inside(image, &seen).min()?);
        let grown = Ellipse {
            major: seen.major + BLURRED.skin_px,
            minor: seen.minor + 0.5 * BLURRED.skin_px,
            ..seen
        };
        let white = usize::from(grey_values_inside(image, &grown).max()?);
        let (dark, light) = (
            skin.midpoint(black.min(skin)) as u8,
            skin.midpoint(white.max(skin)) as u8,
        );
        let mut parts = blob::blobs_in_box(image, low, high, LevelSide::Darker(dark));
        parts.extend(blob::blobs_in_box(
            image,
            low,
            high,
            LevelSide::Lighter(light),
        ));
        let least = BLURRED.part * seen.major * seen.minor;
        let parts: Vec<&Blob> = parts
            .iter()
            .filter(|b| b.area > least && longest.contains(b.centroid))
            .collect();
        let found =
            convex_hull_ellipse(&parts).filter(|ellipse| ellipse.minor >= BLURRED.min_minor_px)?;
        if found.major < BLURRED.longer * seen.major {
            return Some(found);
        }
        seen = found;
    }
    None
}

/// Returns the ellipse of inertia of the convex hull of some blobs; `None` if they differ too much from an ellipse. Gaps
/// between the blobs, as between black and white, do not matter.
fn convex_hull_ellipse(parts: &[&Blob]) -> Option<Ellipse> {
    let ends =
        |&[y, from, to]: &[u32; 3]| [from, to].map(|x| Vector2::new(f64::from(x), f64::from(y)));
    let mut points: Vec<Vector2<f64>> = parts
        .iter()
        .flat_map(|b| b.runs.iter().flat_map(ends))
        .collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    // Lower and upper chain from left to right (Andrew's monotone chain).
    let chain = |points: &mut dyn Iterator<Item = &Vector2<f64>>| {
        let mut out: Vec<Vector2<f64>> = Vec::new();
        for p in points {
            while let [.., a, b] = out[..]
                && (b - a).perp(&(p - a)) <= 0.0
            {
                out.pop();
            }
            out.push(*p);
        }
        out.pop();
        out
    };
    let mut corners = chain(&mut points.iter());
    corners.extend(chain(&mut points.iter().rev()));
    // Moments of the triangles from the first corner, counted from there.
    let first = *corners.first()?;
    let (mut area, mut sum, mut square) = (0.0, Vector2::zeros(), Matrix2::zeros());
    for pair in corners.windows(2) {
        let (a, b) = (pair[0] - first, pair[1] - first);
        let part = 0.5 * a.perp(&b);
        area += part;
        sum += (a + b) * (part / 3.0);
        square +=
            ((a + b) * (a + b).transpose() + a * a.transpose() + b * b.transpose()) * (part / 12.0);
    }
    let area = Some(area).filter(|area| *area > 1.0)?;
    let centre = sum / area;
    let ellipse = Ellipse::from_moments(
        first + centre,
        square / area - centre * centre.transpose(),
        2.0,
    );
    let own: f64 = parts.iter().map(|b| b.area).sum();
    (own > BLURRED.min_filled * area
        && area > BLURRED.min_fill * PI * ellipse.major * ellipse.minor)
        .then_some(ellipse)
}
