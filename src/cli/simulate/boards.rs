//! Rendering of images of a calibration board, taken with the camera of the wing.

use std::path::Path;

use super::{Failure, image_batch, writer};
use crate::exchange::load_board;
use crate::measure::calibrate::Board;
use crate::measure::geometry::Lens;
use crate::measure::render::{RenderedBoard, SeededRandom};

/// JPEG quality of board images: as high as a camera's best.
const JPEG_QUALITY: u8 = 95;

/// Writes `count` images of a flat checkerboard into a folder.
pub fn write_board_images(folder: &Path, file: &Path, lens: &Lens, count: usize, seed: u64) -> Result<(), Failure> {
    let described = load_board(file)?;
    let Board::Checkerboard { columns, rows, square_m } = described.board else {
        let what = format!("{}: pattern: only checkerboards are rendered", file.display());
        return Err(Failure::Failed(what));
    };
    std::fs::create_dir_all(folder).map_err(|e| Failure::Failed(format!("{}: {e}", folder.display())))?;
    let bar = image_batch::progress_bar(count, "rendering the board");
    let digits = count.to_string().len();
    for k in 0..count {
        let mut random = SeededRandom::new(seed, 1000 + k as u64);
        let picture = RenderedBoard::calibration_image(lens, (columns, rows), square_m, [0.0, 0.0], k, &mut random);
        let path = folder.join(format!("{:0digits$}.jpg", k + 1));
        let written = picture.render(&mut random).map(|raster| writer::write_jpeg(&path, &raster, JPEG_QUALITY));
        written.transpose().map_err(|e| Failure::Failed(format!("{e:#}")))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}
