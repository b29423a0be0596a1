//! Tags that are not those of the described AprilGrid: another family, border or numbering, or without the squares between
//! them. Only searched if too few tags of the board are found.

use std::collections::BTreeMap;

use ::aprilgrid::TagFamily;
use ::aprilgrid::detector::{TagDetector, best_tag, bit_code, decode_positions};
use ::aprilgrid::tag_families::{T16H5, T25H7, T25H9, T36H11};
use image::{DynamicImage, GrayImage, Luma};
use imageproc::integral_image::{integral_image, sum_image_pixels};
use imageproc::region_labelling::{Connectivity, connected_components};
use nalgebra::Vector2;

use super::reduced;
use crate::raster::Raster;

/// Kinds of tags: name, code bits along a side, bits of the black border, number of wrong bits that is not accepted, codes.
type TagKind = (&'static str, TagFamily, [u8; 3], &'static [u64]);
const KINDS: [TagKind; 5] = [
    ("of 36h11", TagFamily::T36H11, [6, 2, 3], &T36H11),
    (
        "of 36h11 with a border of one bit",
        TagFamily::T36H11B1,
        [6, 1, 3],
        &T36H11,
    ),
    ("of the family 25h9", TagFamily::T25H9, [5, 2, 2], &T25H9),
    ("of the family 25h7", TagFamily::T25H7, [5, 2, 2], &T25H7),
    ("of the family 16h5", TagFamily::T16H5, [4, 2, 1], &T16H5),
];

/// Describes the tags of an image that shows fewer than `least` of the board's; `None` if there are none either.
pub(super) fn describe_other_tags(raster: &Raster, least: usize) -> Option<String> {
    let (small, _) = reduced::reduce_image(raster);
    let raster = small.as_ref().unwrap_or(raster);
    let gray = GrayImage::from_raw(
        raster.width() as u32,
        raster.height() as u32,
        raster.luma().to_vec(),
    )?;
    let picture = DynamicImage::ImageLuma8(gray.clone());
    let found = |family: &TagFamily| TagDetector::new(family, None).detect(&picture).len();
    // Those of 36h11 are the board's, which were not found.
    if let Some((name, ..)) = KINDS[1..]
        .iter()
        .find(|(_, family, ..)| found(family) >= least)
    {
        return Some(format!(
            "tags {name} found, not those of Kalibr's AprilGrid (36h11 with a border of two bits); print that one"
        ));
    }
    let quads = find_dark_quads(&gray);
    let decoded = |(_, _, bits, codes): &&TagKind, mirrored: bool| {
        let turned = |quad: &[(f32, f32); 4]| {
            if mirrored {
                [quad[3], quad[2], quad[1], quad[0]]
            } else {
                *quad
            }
        };
        quads
            .iter()
            .filter(|quad| is_tag(&gray, &turned(quad), *bits, codes))
            .count()
    };
    let best_of = |mirrored: bool| KINDS.iter().max_by_key(|kind| decoded(kind, mirrored));
    if let Some(kind) = best_of(true).filter(|kind| decoded(kind, true) >= least) {
        return Some(format!(
            "mirrored tags {} found; switch the camera's mirroring off",
            kind.0
        ));
    }
    let best = best_of(false).filter(|kind| decoded(kind, false) >= least)?;
    Some(format!(
        "tags {} without the squares between them found; print Kalibr's AprilGrid, which has a small square at each corner",
        best.0
    ))
}

/// Returns whether the quadrilateral is a tag, in any rotation.
fn is_tag(
    gray: &GrayImage,
    quad: &[(f32, f32); 4],
    [edge, border, wrong]: [u8; 3],
    codes: &[u64],
) -> bool {
    let places = decode_positions(gray.width(), gray.height(), quad, border, edge, 0.5);
    let bits = places.and_then(|places| bit_code(gray, &places, 10, 3));
    bits.is_some_and(|bits| best_tag(bits, wrong, codes, edge).is_some())
}

/// Smallest side of a tag that can be decoded, px, and largest as a fraction of the image's.
const MIN_SIDE_PX: f64 = 12.0;
const MAX_SIDE_FRACTION: f64 = 0.5;
/// Window over which the threshold between black and white is averaged, as a fraction of the image's width.
const THRESHOLD_WINDOW: f64 = 0.1;

/// Finds the corners of dark areas with light around them.
fn find_dark_quads(gray: &GrayImage) -> Vec<[(f32, f32); 4]> {
    let mut areas = BTreeMap::<u32, Vec<Vector2<f64>>>::new();
    for (x, y, label) in
        connected_components(&mark_dark_pixels(gray), Connectivity::Four, Luma([0]))
            .enumerate_pixels()
    {
        areas
            .entry(label[0])
            .or_default()
            .push(Vector2::new(f64::from(x), f64::from(y)));
    }
    areas.remove(&0);
    areas
        .values()
        .filter_map(|area| find_corners(area, gray.width()))
        .collect()
}

/// Marks the pixels that are darker than their surroundings by 1, the others by 0.
fn mark_dark_pixels(gray: &GrayImage) -> GrayImage {
    let (width, height) = gray.dimensions();
    let half = ((0.5 * THRESHOLD_WINDOW * f64::from(width)) as u32).max(1);
    let sums = integral_image::<_, u64>(gray);
    GrayImage::from_fn(width, height, |x, y| {
        let (left, right) = (x.saturating_sub(half), (x + half).min(width - 1));
        let (top, bottom) = (y.saturating_sub(half), (y + half).min(height - 1));
        let [sum] = sum_image_pixels(&sums, left, top, right, bottom);
        let pixels = u64::from((right - left + 1) * (bottom - top + 1));
        Luma([u8::from(
            u64::from(gray.get_pixel(x, y)[0]) * pixels * 10 < 9 * sum,
        )])
    })
}

/// Returns the corners of an area in the order in which the finder takes those of a tag; `None` if it is not of the size of a tag.
fn find_corners(area: &[Vector2<f64>], width: u32) -> Option<[(f32, f32); 4]> {
    let points = || area.iter().copied();
    if (area.len() as f64) < 0.4 * MIN_SIDE_PX * MIN_SIDE_PX {
        return None;
    }
    let farthest = |from: &Vector2<f64>| {
        points().max_by(|a, b| (a - from).norm().total_cmp(&(b - from).norm()))
    };
    let first = farthest(&(points().sum::<Vector2<f64>>() / area.len() as f64))?;
    let opposite = farthest(&first)?;
    let aside = |p: &Vector2<f64>| (opposite - first).perp(&(p - first));
    let second = points().max_by(|a, b| aside(a).total_cmp(&aside(b)))?;
    let fourth = points().min_by(|a, b| aside(a).total_cmp(&aside(b)))?;
    let corners = [first, fourth, opposite, second];
    let sides = (0..4).map(|k| (corners[(k + 1) % 4] - corners[k]).norm());
    let (short, long) = sides.fold((f64::INFINITY, 0.0), |(s, l): (f64, f64), side| {
        (s.min(side), l.max(side))
    });
    let plausible = short >= MIN_SIDE_PX && long <= MAX_SIDE_FRACTION * f64::from(width);
    plausible.then(|| corners.map(|c| (c.x as f32, c.y as f32)))
}

#[cfg(test)]
mod tests {
    use super::super::{Board, BoardError};
    use super::*;

    /// Side of a bit of a tag, px.
    const BIT_PX: f64 = 5.0;

    /// Draws 5 x 4 tags of a kind, numbered from a first one, with or without the squares between them, in perspective.
    fn draw_board(
        (_, _, [edge, border, _], codes): &TagKind,
        first: usize,
        squares: bool,
    ) -> Raster {
        let side = f64::from(edge + 2 * border);
        let pitch = 1.3 * side;
        let is_dark = |x: f64, y: f64| {
            let (column, row) = ((x / pitch).floor(), (y / pitch).floor());
            let (x, y) = (x - pitch * column, y - pitch * row);
            let on_board = (0.0..5.0).contains(&column) && (0.0..4.0).contains(&row);
            let gap = |v: f64| v >= side;
            if gap(x) && gap(y) {
                return squares && (-1.0..5.0).contains(&column) && (-1.0..4.0).contains(&row);
            }
            if !on_board || gap(x) || gap(y) {
                return false;
            }
            let place = |v: f64| (v - f64::from(*border)).floor();
            let inside = |v: f64| (0.0..f64::from(*edge)).contains(&v);
            let (bit_x, bit_y) = (place(x), place(y));
            let code = codes[first + (row * 5.0 + column) as usize];
            let bits = f64::from(*edge) * f64::from(*edge);
            !(inside(bit_x) && inside(bit_y))
                || code
                    >> (bits - 1.0 - (f64::from(*edge) - 1.0 - bit_y) * f64::from(*edge) - bit_x)
                        as u32
                    & 1
                    == 0
        };
        let (width, height) = (620, 520);
        let luma = (0..width * height).map(|k| {
            let samples = [0.25, 0.75]
                .map(|du| [0.25, 0.75].map(|dv| (du, dv)))
                .concat();
            let dark = samples.iter().filter(|(du, dv)| {
                let (u, v) = (
                    (k % width) as f64 + du - 60.0,
                    (k / width) as f64 + dv - 60.0,
                );
                let w = BIT_PX * (1.0 - 3e-4 * u + 1e-4 * v);
                // Rows of an AprilGrid run upwards.
                is_dark((u + 0.05 * v) / w, 4.0 * pitch - (v - 0.04 * u) / w)
            });
            230 - 50 * dark.count() as u8
        });
        Raster::new(width, height, luma.collect()).unwrap()
    }

    #[test]
    fn boards_of_other_tags_are_named() {
        let board = Board::AprilGrid {
            columns: 5,
            rows: 4,
            tag_m: 0.1,
            spacing: 0.3,
        };
        let found = |kind: usize, first: usize, squares: bool| {
            board.find(&draw_board(&KINDS[kind], first, squares))
        };
        assert!(
            found(0, 0, true).is_ok_and(|found| found.view.len() > 70 && found.mismatch.is_none())
        );
        for (kind, first, squares, words) in [
            (0, 20, true, "tags 20 to 39 found, not 0 to 19"),
            (0, 8, true, "tags 8 to 27 found, not 0 to 19"),
            (1, 0, true, "tags of 36h11 with a border of one bit found"),
            (2, 0, true, "tags of the family 25h9 found"),
            (
                0,
                0,
                false,
                "tags of 36h11 without the squares between them found",
            ),
            (
                1,
                0,
                false,
                "tags of 36h11 with a border of one bit without the squares",
            ),
        ] {
            let error = found(kind, first, squares).map(|_| ()).unwrap_err();
            assert!(
                matches!(error, BoardError::OtherTags(_)) && error.to_string().contains(words),
                "{words}: {error}"
            );
        }
        let sound = draw_board(&KINDS[0], 0, true);
        let mirrored = sound
            .luma()
            .chunks(sound.width())
            .flat_map(|row| row.iter().rev().copied())
            .collect();
        let mirrored = Raster::new(sound.width(), sound.height(), mirrored).unwrap();
        let error = board.find(&mirrored).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("mirrored tags of 36h11"), "{error}");
        assert_eq!(
            found(0, 1, true).unwrap().mismatch,
            Some(super::super::BoardMismatch::FirstTag)
        );
        let blank = Raster::new(620, 520, vec![200; 620 * 520]).unwrap();
        assert_eq!(board.find(&blank).map(|_| ()), Err(BoardError::NotFound));
    }
}
