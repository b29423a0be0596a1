//! Kalibr AprilGrids: `aprilgrid` finds the tags, our own fit measures their corners.
//!
//! The finder's thresholds follow the strongest corner of its input: text or a screen next to the board hides the tags. So
//! an image in which tags are missing is searched once more in parts.

use std::collections::BTreeMap;

use ::aprilgrid::TagFamily;
use ::aprilgrid::detector::TagDetector;
use image::{DynamicImage, GrayImage};
use nalgebra::Vector2;

use super::board::{Board, BoardDetection, BoardError, BoardMismatch};
use super::checkerboard::WINDOW_FRACTION;
use super::corner::{self, CornerHint};
use super::{BoardPoint, BoardView, other_tags, reduced, saddle, start};
use crate::raster::Raster;

/// Tags needed for a view.
const MIN_TAGS: usize = 4;
/// Parts along each side of the image; each overlaps half of the next, so that a tag of a quarter of the image lies
/// completely in one.
const PARTS: usize = 3;

type TagCorners = [Vector2<f64>; 4];

/// Finds the tag corners of an AprilGrid.
///
/// # Errors
/// Returns an error if too few tags are found.
pub(super) fn find_aprilgrid(
    raster: &Raster,
    columns: usize,
    rows: usize,
    tag_m: f64,
    spacing: f64,
) -> Result<BoardDetection, BoardError> {
    let mut tags = detect_tags(raster, columns * rows);
    let mismatch = find_mismatch(&tags, columns, spacing);
    let beyond = tags.split_off(&(columns * rows));
    // A board with longer rows than described also has tags beyond the described ones.
    if beyond.len() >= MIN_TAGS && !matches!(mismatch, Some(BoardMismatch::Columns { .. })) {
        let ids = || tags.keys().chain(beyond.keys());
        let (first, last) = (ids().min().unwrap_or(&0), ids().max().unwrap_or(&0));
        return Err(BoardError::OtherTags(format!(
            "tags {first} to {last} found, not 0 to {}; use a board that is numbered from 0, and check columns and rows",
            columns * rows - 1
        )));
    }
    if tags.len() < MIN_TAGS {
        let other = other_tags::describe_other_tags(raster, MIN_TAGS).map(BoardError::OtherTags);
        return Err(other.unwrap_or(match tags.len() {
            0 => BoardError::NotFound,
            found => BoardError::Partial {
                found: 4 * found,
                expected: 4 * columns * rows,
            },
        }));
    }
    let mut view = BoardView::new();
    for (&id, tag) in &tags {
        for k in 0..4 {
            let Some(found) = tag_corner_hint(raster, tag, k, spacing)
                .and_then(|h| corner::fit_corner(raster, &h))
            else {
                continue;
            };
            let board_m = Board::tag_corner(columns, tag_m, spacing, id, k);
            view.push(BoardPoint {
                board_m,
                pixel: found.pixel,
                covariance_px2: found.covariance_px2,
            });
        }
    }
    Ok(BoardDetection { view, mismatch })
}

/// Finds the tags by id, those beyond the `expected` ones of the board as well. The map also gives them an order: the
/// finder's differs between runs.
fn detect_tags(raster: &Raster, expected: usize) -> BTreeMap<usize, TagCorners> {
    let (small, scale) = reduced::reduce_image(raster);
    let mut tags = BTreeMap::new();
    add_tags(
        small.as_ref().unwrap_or(raster),
        Vector2::zeros(),
        scale,
        &mut tags,
    );
    let (width, height) = (
        2 * raster.width() / (PARTS + 1),
        2 * raster.height() / (PARTS + 1),
    );
    for k in 0..PARTS * PARTS {
        if tags.range(..expected).count() == expected {
            break;
        }
        let (left, top) = (k % PARTS * width / 2, k / PARTS * height / 2);
        if let Some(part) = reduced::crop_image(raster, left, top, width, height) {
            add_tags(&part, Vector2::new(left as f64, top as f64), 1.0, &mut tags);
        }
    }
    tags
}

/// Adds tags that are not in the map yet.
fn add_tags(
    raster: &Raster,
    origin: Vector2<f64>,
    scale: f64,
    tags: &mut BTreeMap<usize, TagCorners>,
) {
    let (width, height) = (raster.width() as u32, raster.height() as u32);
    let Some(gray) = GrayImage::from_raw(width, height, raster.luma().to_vec()) else {
        return;
    };
    for (id, corners) in
        TagDetector::new(&TagFamily::T36H11, None).detect(&DynamicImage::ImageLuma8(gray))
    {
        let place = |(x, y): (f32, f32)| {
            Vector2::new(f64::from(x), f64::from(y)) * scale
                + Vector2::repeat(0.5 * (scale - 1.0))
                + origin
        };
        tags.entry(id as usize)
            .or_insert_with(|| corners.map(place));
    }
}

/// Returns start values for tag corner `k`, at which the small square touches the tag.
fn tag_corner_hint(
    raster: &Raster,
    tag: &TagCorners,
    k: usize,
    spacing: f64,
) -> Option<CornerHint> {
    let edges = [tag[(k + 1) % 4] - tag[k], tag[(k + 3) % 4] - tag[k]];
    let sine = edges[0].normalize().perp(&edges[1].normalize()).abs();
    let square = edges[0].norm().min(edges[1].norm()) * spacing.min(1.0);
    let centre = saddle::refine_saddle(raster, &tag[k], saddle::half_window_for(1.5 * square))?;
    let radius_px = (WINDOW_FRACTION * square * sine).min(corner::MAX_REFINEMENT_PX);
    Some(CornerHint {
        centre,
        edges,
        curvature_per_px: [0.0; 2],
        radius_px,
    })
}

/// Compares the tags' positions with the description: each tag predicts the next one's, in tag sides.
fn find_mismatch(
    tags: &BTreeMap<usize, TagCorners>,
    columns: usize,
    spacing: f64,
) -> Option<BoardMismatch> {
    let mut gaps = vec![];
    let mut ups: BTreeMap<usize, usize> = BTreeMap::new();
    let mut wrapped = 0;
    for (&id, tag) in tags {
        let Some(tag_from_pixel) = start::tag_from_pixel(tag) else {
            continue;
        };
        for (&other, place) in tags.range(id + 1..) {
            let middle = place.iter().map(&tag_from_pixel).sum::<Vector2<f64>>() / 4.0
                - Vector2::repeat(0.5);
            // The neighbour on the right or above is one to two tag sides away.
            let next = |far: f64, aside: f64| (1.0..2.0).contains(&far) && aside.abs() < 0.3;
            if next(middle.x, middle.y) && other == id + 1 {
                gaps.push(middle.x - 1.0);
                wrapped += usize::from(other.is_multiple_of(columns));
            } else if next(middle.y, middle.x) {
                *ups.entry(other - id).or_default() += 1;
            }
        }
    }
    let seen = ups
        .into_iter()
        .max_by_key(|(_, votes)| *votes)
        .map(|(step, _)| step);
    if let Some(seen) = seen.filter(|s| *s != columns) {
        return Some(BoardMismatch::Columns { seen });
    }
    // The last tag of a row has no neighbour on its right.
    if 2 * wrapped > gaps.len().div_ceil(columns) {
        return Some(BoardMismatch::FirstTag);
    }
    gaps.sort_by(f64::total_cmp);
    let gap = *gaps.get(gaps.len() / 2)?;
    let spread = gaps.get(3 * gaps.len() / 4)? - gaps.get(gaps.len() / 4)?;
    // The quartiles of a normal distribution are 1.35 standard deviations apart; the standard deviation of
    // the median is 1.25 / root n times that of a value.
    let sigma = spread / 1.35 * 1.25 / (gaps.len() as f64).sqrt();
    let off = (gap - spacing).abs();
    (off > 3.0 * sigma && off > GAP_TOLERANCE).then_some(BoardMismatch::Gap { seen: gap })
}

/// Accuracy of a gap measured with a ruler, as a fraction of a tag's side (1 mm on 100 mm).
const GAP_TOLERANCE: f64 = 0.01;
