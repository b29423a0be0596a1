//! Images of a calibration, from image files or from a file of corners.

use std::path::Path;

use super::{CalibrateArgs, Failure};
use crate::cli::{CHECK_WRITE_ACCESS, image_batch, write_failure};
use crate::exchange::{self, ImageCorners};
use crate::measure::calibrate::{Board, BoardMismatch, BoardPoint, BoardView, Calibration, ImageRejection};
use crate::pipeline::decode;
use crate::record::Reason;

/// An image of the board: its size and points, or the reason why it has none.
pub(super) struct BoardImage {
    pub name: String,
    pub size: Option<(u32, u32)>,
    pub view: Result<BoardView, Reason>,
    pub misfit: Option<BoardMismatch>,
}

/// Reads the images, or a file of corners.
pub(super) fn read_images(args: &CalibrateArgs, board: &Board) -> Result<Vec<BoardImage>, Failure> {
    if let (Some(file), true) = (&args.corners, args.images.is_empty()) {
        let from = |c: ImageCorners| BoardImage { name: c.image, size: Some(c.size), view: Ok(c.view), misfit: None };
        return Ok(exchange::read_corners(file)?.into_iter().map(from).collect());
    }
    image_batch::process_images(
        &crate::cli::image_files::expand_folders(&args.images)?,
        args.jobs,
        "finding boards",
        |name, bytes| detect_board(name, bytes, board),
    )
}

/// Writes the corners; after a calibration also which of them it used.
pub(super) fn write_corners(
    file: &Path,
    pictures: &[BoardImage],
    calibration: Option<&Calibration>,
) -> Result<(), Failure> {
    let corners = |(k, p): (usize, &BoardImage)| {
        let (size, view) = (p.size?, p.view.clone().ok()?);
        let used = calibration.map_or(vec![], |c| {
            let took_part = |q: &BoardPoint| c.residuals[k].iter().any(|(at, _)| *at == q.pixel);
            view.iter().map(took_part).collect()
        });
        Some(ImageCorners { image: p.name.clone(), size, view, used })
    };
    let corners: Vec<ImageCorners> = pictures.iter().enumerate().filter_map(corners).collect();
    exchange::write_corners(file, &corners).map_err(write_failure(file, CHECK_WRITE_ACCESS))
}

/// Returns the reason why an image was not used.
pub(super) fn exclusion_reason(calibration: &Calibration, k: usize, picture: &BoardImage) -> Option<String> {
    match &picture.view {
        Err(reason) => Some(reason.to_string()),
        Ok(_) => calibration.rejections[k].map(|d| d.to_string()),
    }
}

pub(super) fn detect_board(name: &str, bytes: Result<&[u8], Reason>, board: &Board) -> BoardImage {
    let raster = bytes.and_then(|b| decode::decode_image(b, None).map_err(Reason::from_error));
    let size = raster.as_ref().ok().map(|r| (r.width() as u32, r.height() as u32));
    let detection = raster.and_then(|r| board.find(&r).map_err(Reason::from_error));
    let misfit = detection.as_ref().ok().and_then(|s| s.mismatch);
    BoardImage { name: name.into(), size, view: detection.map(|s| s.view), misfit }
}

/// Returns the size of most images. Images of another size are excluded: they come from another camera or crop.
pub(super) fn common_size(pictures: &mut [BoardImage]) -> Result<(u32, u32), Reason> {
    let sizes: Vec<(u32, u32)> = pictures.iter().filter(|p| p.view.is_ok()).filter_map(|p| p.size).collect();
    let count = |s: &(u32, u32)| sizes.iter().filter(|o| *o == s).count();
    let size = sizes.iter().copied().max_by_key(|s| (count(s), *s));
    let Some(size) = size else {
        return Err(format!("no image shows the board{}", list_failures(pictures, &[])).into());
    };
    for picture in pictures.iter_mut().filter(|p| p.view.is_ok()) {
        if let Some(own) = picture.size.filter(|own| *own != size) {
            let ((own_w, own_h), (w, h)) = (own, size);
            picture.view = Err(format!("its size is {own_w} x {own_h} px, but the others have {w} x {h} px").into());
        }
    }
    Ok(size)
}

/// Lists the images without points or excluded, a line each.
pub(super) fn list_failures(pictures: &[BoardImage], excluded: &[Option<ImageRejection>]) -> String {
    let reason = |(k, p): (usize, &BoardImage)| match &p.view {
        Err(reason) => Some(format!("\n  {}: {reason}", p.name)),
        Ok(_) => excluded.get(k).copied().flatten().map(|d| format!("\n  {}: {d}", p.name)),
    };
    pictures.iter().enumerate().filter_map(reason).collect()
}
