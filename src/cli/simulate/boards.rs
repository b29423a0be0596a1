//! This file renders pictures of a calibration board, as the camera of the wing takes them.

use std::path::Path;

use super::{Failure, frames, writer};
use crate::installation::load_board;
use crate::measure::calibrate::Board;
use crate::measure::geometry::Lens;
use crate::measure::render::{BoardPicture, Random};

/// JPEG quality: high, as a camera's at its best.
const QUALITY: u8 = 95;

/// Writes `count` pictures of a flat checkerboard into a folder.
pub fn write(folder: &Path, file: &Path, lens: &Lens, count: usize, seed: u64) -> Result<(), Failure> {
    let described = load_board(file)?;
    let Board::Checkerboard { columns, rows, square_m } = described.board else {
        let what = format!("{}: pattern: only checkerboards are rendered", file.display());
        return Err(Failure::Failed(what));
    };
    std::fs::create_dir_all(folder).map_err(|e| Failure::Failed(format!("{}: {e}", folder.display())))?;
    let bar = frames::progress(count, "rendering the board");
    let digits = count.to_string().len();
    for k in 0..count {
        let mut random = Random::new(seed, 1000 + k as u64);
        let picture = BoardPicture::held(lens, (columns, rows), square_m, [0.0, 0.0], k, &mut random);
        let path = folder.join(format!("{:0digits$}.jpg", k + 1));
        let written = picture.render(&mut random).map(|raster| writer::write_jpeg(&path, &raster, QUALITY));
        written.transpose().map_err(|e| Failure::Failed(format!("{e:#}")))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}
