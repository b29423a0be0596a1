//! Tags of another family or border than those of the described AprilGrid. Only searched if too few tags of the board are
//! found.

use ::aprilgrid::TagFamily;
use ::aprilgrid::detector::TagDetector;
use image::{DynamicImage, GrayImage};

use super::reduced;
use crate::raster::Raster;

/// Kinds of tags that boards of other programs have.
const KINDS: [(&str, TagFamily); 4] = [
    ("of 36h11 with a border of one bit", TagFamily::T36H11B1),
    ("of the family 25h9", TagFamily::T25H9),
    ("of the family 25h7", TagFamily::T25H7),
    ("of the family 16h5", TagFamily::T16H5),
];

/// Describes the tags of an image that shows at least `least` of another kind; `None` if there are none.
pub(super) fn describe_other_tags(raster: &Raster, least: usize) -> Option<String> {
    let (small, _) = reduced::reduce_image(raster);
    let raster = small.as_ref().unwrap_or(raster);
    let (width, height) = (raster.width() as u32, raster.height() as u32);
    let gray = GrayImage::from_raw(width, height, raster.luma().to_vec())?;
    let picture = DynamicImage::ImageLuma8(gray);
    let is_shown =
        |family: &TagFamily| TagDetector::new(family, None).detect(&picture).len() >= least;
    let (name, _) = KINDS.iter().find(|(_, family)| is_shown(family))?;
    Some(format!(
        "tags {name} found, not those of Kalibr's AprilGrid (36h11 with a border of two bits); print that one"
    ))
}

#[cfg(test)]
mod tests {
    use ::aprilgrid::tag_families::{T25H9, T36H11};

    use super::super::{Board, BoardError};
    use super::*;

    /// Kind of tag: code bits along a side, bits of the black border, codes.
    type TagKind = ([u8; 2], &'static [u64]);
    /// Kinds that are drawn: the board's, and two others.
    const DRAWN_KINDS: [TagKind; 3] = [([6, 2], &T36H11), ([6, 1], &T36H11), ([5, 2], &T25H9)];

    /// Side of a bit of a tag, px.
    const BIT_PX: f64 = 5.0;

    /// Draws 5 x 4 tags of a kind, numbered from a first one, in perspective.
    fn draw_board(([edge, border], codes): &TagKind, first: usize) -> Raster {
        let side = f64::from(edge + 2 * border);
        let pitch = 1.3 * side;
        let is_dark = |x: f64, y: f64| {
            let (column, row) = ((x / pitch).floor(), (y / pitch).floor());
            let (x, y) = (x - pitch * column, y - pitch * row);
            let on_board = (0.0..5.0).contains(&column) && (0.0..4.0).contains(&row);
            let gap = |v: f64| v >= side;
            if gap(x) && gap(y) {
                return (-1.0..5.0).contains(&column) && (-1.0..4.0).contains(&row);
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
        let found = |kind: usize, first: usize| board.find(&draw_board(&DRAWN_KINDS[kind], first));
        assert!(found(0, 0).is_ok_and(|found| found.view.len() > 70 && found.mismatch.is_none()));
        for (kind, first, words) in [
            (0, 20, "tags 20 to 39 found, not 0 to 19"),
            (0, 8, "tags 8 to 27 found, not 0 to 19"),
            (1, 0, "tags of 36h11 with a border of one bit found"),
            (2, 0, "tags of the family 25h9 found"),
        ] {
            let error = found(kind, first).map(|_| ()).unwrap_err();
            assert!(
                matches!(error, BoardError::OtherTags(_)) && error.to_string().contains(words),
                "{words}: {error}"
            );
        }
        assert_eq!(
            found(0, 1).unwrap().mismatch,
            Some(super::super::BoardMismatch::FirstTag)
        );
        let blank = Raster::new(620, 520, vec![200; 620 * 520]).unwrap();
        assert_eq!(board.find(&blank).map(|_| ()), Err(BoardError::NotFound));
    }
}
