//! The pictures of a calibration come from image files or from a file of corners.

use std::path::Path;

use super::{Args, Failure};
use crate::cli::{RIGHTS, frames, unwritable};
use crate::installation::{self, PictureCorners};
use crate::measure::calibrate::{Board, BoardPoint, Calibration, Dropped, Misfit, View};
use crate::pipeline::decode;
use crate::record::Reason;

/// One picture: its size and points, or why there are none.
pub(super) struct Picture {
    pub name: String,
    pub size: Option<(u32, u32)>,
    pub view: Result<View, Reason>,
    pub misfit: Option<Misfit>,
}

/// From pictures or from a file of corners.
pub(super) fn pictures(args: &Args, board: &Board) -> Result<Vec<Picture>, Failure> {
    if let (Some(file), true) = (&args.corners, args.images.is_empty()) {
        let from =
            |c: PictureCorners| Picture { name: c.image, size: Some(c.size), view: Ok(c.view), misfit: None };
        return Ok(installation::read_corners(file)?.into_iter().map(from).collect());
    }
    frames::map(&crate::cli::pictures::expand(&args.images)?, args.jobs, "finding boards", |name, bytes| {
        picture(name, bytes, board)
    })
}

/// The corners' file: before a calibration, and after it with what it used.
pub(super) fn write_corners(
    file: &Path,
    pictures: &[Picture],
    calibration: Option<&Calibration>,
) -> Result<(), Failure> {
    let corners = |(k, p): (usize, &Picture)| {
        let (size, view) = (p.size?, p.view.clone().ok()?);
        let used = calibration.map_or(vec![], |c| {
            let took_part = |q: &BoardPoint| c.residuals[k].iter().any(|(at, _)| *at == q.pixel);
            view.iter().map(took_part).collect()
        });
        Some(PictureCorners { image: p.name.clone(), size, view, used })
    };
    let corners: Vec<PictureCorners> = pictures.iter().enumerate().filter_map(corners).collect();
    installation::write_corners(file, &corners).map_err(unwritable(file, RIGHTS))
}

/// Why a picture took no part.
pub(super) fn reason(calibration: &Calibration, k: usize, picture: &Picture) -> Option<String> {
    match &picture.view {
        Err(reason) => Some(reason.to_string()),
        Ok(_) => calibration.dropped[k].map(|d| d.to_string()),
    }
}

pub(super) fn picture(name: &str, bytes: Result<&[u8], Reason>, board: &Board) -> Picture {
    let raster = bytes.and_then(|b| decode::decode(b, None).map_err(Reason::of));
    let size = raster.as_ref().ok().map(|r| (r.width() as u32, r.height() as u32));
    let sighting = raster.and_then(|r| board.find(&r).map_err(Reason::of));
    let misfit = sighting.as_ref().ok().and_then(|s| s.misfit);
    Picture { name: name.into(), size, view: sighting.map(|s| s.view), misfit }
}

/// The size of most pictures; others are left out with a reason, as they come from another camera
/// or another cropping.
pub(super) fn common_size(pictures: &mut [Picture]) -> Result<(u32, u32), Reason> {
    let sizes: Vec<(u32, u32)> = pictures.iter().filter(|p| p.view.is_ok()).filter_map(|p| p.size).collect();
    let count = |s: &(u32, u32)| sizes.iter().filter(|o| *o == s).count();
    let size = sizes.iter().copied().max_by_key(|s| (count(s), *s));
    let Some(size) = size else {
        return Err(format!("no picture shows the board{}", failures(pictures, &[])).into());
    };
    for picture in pictures.iter_mut().filter(|p| p.view.is_ok()) {
        if let Some(own) = picture.size.filter(|own| *own != size) {
            let ((own_w, own_h), (w, h)) = (own, size);
            picture.view = Err(format!("its size is {own_w} x {own_h} px, the others' {w} x {h} px").into());
        }
    }
    Ok(size)
}

/// Every picture without points or left out, a line each.
pub(super) fn failures(pictures: &[Picture], left_out: &[Option<Dropped>]) -> String {
    let reason = |(k, p): (usize, &Picture)| match &p.view {
        Err(reason) => Some(format!("\n  {}: {reason}", p.name)),
        Ok(_) => left_out.get(k).copied().flatten().map(|d| format!("\n  {}: {d}", p.name)),
    };
    pictures.iter().enumerate().filter_map(reason).collect()
}
