//! Rendering of images of a calibration board, taken with the camera of the wing.

use std::path::Path;

use super::files;
use crate::render::RenderedBoard;
use crate::render::SeededRandom;
use wingd_base::failure::{Failure, TaskResult};
use wingd_evaluation::boards::load_board;
use wingd_measure::calibrate::Board;
use wingd_measure::geometry::Lens;

/// JPEG quality of board images: as high as a camera's best.
const JPEG_QUALITY: u8 = 95;

/// Writes `count` images of the flat checkerboard in `file` into a folder; `done` is called after each.
///
/// # Errors
/// Returns an error if the board cannot be read, or an image not written.
pub fn write_board_images(
    folder: &Path,
    file: &Path,
    lens: &Lens,
    count: usize,
    seed: u64,
    done: impl Fn(),
) -> TaskResult<()> {
    let described = load_board(file)?;
    let Board::Checkerboard {
        columns,
        rows,
        square_m,
    } = described.board
    else {
        return Err(Failure::from_path_error(
            file,
            "pattern: only checkerboards are rendered",
        ));
    };
    std::fs::create_dir_all(folder).map_err(|e| Failure::from_path_error(folder, e))?;
    let digits = count.to_string().len();
    for k in 0..count {
        let mut random = SeededRandom::new(seed, 1000 + k as u64);
        let picture = RenderedBoard::calibration_image(
            lens,
            (columns, rows),
            square_m,
            [0.0, 0.0],
            k,
            &mut random,
        );
        let path = folder.join(format!("{:0digits$}.jpg", k + 1));
        let written = picture
            .render(&mut random)
            .map(|raster| files::write_jpeg(&path, &raster, JPEG_QUALITY));
        written
            .transpose()
            .map_err(|e| Failure::Failed(format!("{e:#}")))?;
        done();
    }
    Ok(())
}
