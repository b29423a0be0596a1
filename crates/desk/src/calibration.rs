//! Calibration from images of a board, with a verdict.

use wingd_evaluation::boards::{DescribedBoard, ImageCorners};
use wingd_evaluation::installation::CalibrationReport;
use wingd_evaluation::pipeline::decode;
use wingd_evaluation::record::Reason;
use wingd_measure::calibrate;
use wingd_measure::calibrate::ImageRejection;
use wingd_measure::calibrate::Verdict;
use wingd_measure::calibrate::{Board, BoardMismatch};
use wingd_measure::calibrate::{BoardView, CalibrateError, Calibration, CalibrationOptions};

/// An image of the board: its size and points, or the reason why it has none.
pub struct BoardImage {
    pub name: String,
    pub size: Option<(u32, u32)>,
    pub view: Result<BoardView, Reason>,
    pub misfit: Option<BoardMismatch>,
}

impl BoardImage {
    /// Finds the board in an image.
    pub fn detect(name: &str, bytes: Result<&[u8], Reason>, board: &Board) -> Self {
        let raster = bytes.and_then(|b| decode::decode_image(b, None).map_err(Reason::from_error));
        let size = raster
            .as_ref()
            .ok()
            .map(|r| (r.width() as u32, r.height() as u32));
        let detection = raster.and_then(|r| board.find(&r).map_err(Reason::from_error));
        let misfit = detection.as_ref().ok().and_then(|s| s.mismatch);
        Self {
            name: name.into(),
            size,
            view: detection.map(|s| s.view),
            misfit,
        }
    }
}

impl From<ImageCorners> for BoardImage {
    fn from(corners: ImageCorners) -> Self {
        Self {
            name: corners.image,
            size: Some(corners.size),
            view: Ok(corners.view),
            misfit: None,
        }
    }
}

/// Returns the corners of all images that show the board.
pub fn board_corners(pictures: &[BoardImage]) -> Vec<ImageCorners> {
    let corners = |p: &BoardImage| {
        Some(ImageCorners {
            image: p.name.clone(),
            size: p.size?,
            view: p.view.clone().ok()?,
        })
    };
    pictures.iter().filter_map(corners).collect()
}

/// Returns the reason why an image was not used.
pub fn exclusion_reason(
    calibration: &Calibration,
    k: usize,
    picture: &BoardImage,
) -> Option<String> {
    match &picture.view {
        Err(reason) => Some(reason.to_string()),
        Ok(_) => calibration.rejections[k].map(|d| d.to_string()),
    }
}

/// Returns the size of most images. Images of another size are excluded: they come from another camera or crop.
fn common_size(pictures: &mut [BoardImage]) -> Result<(u32, u32), Reason> {
    let sizes: Vec<(u32, u32)> = pictures
        .iter()
        .filter(|p| p.view.is_ok())
        .filter_map(|p| p.size)
        .collect();
    let count = |s: &(u32, u32)| sizes.iter().filter(|o| *o == s).count();
    let size = sizes.iter().copied().max_by_key(|s| (count(s), *s));
    let Some(size) = size else {
        return Err(format!("no image shows the board{}", list_failures(pictures, &[])).into());
    };
    for picture in pictures.iter_mut().filter(|p| p.view.is_ok()) {
        if let Some(own) = picture.size.filter(|own| *own != size) {
            let ((own_w, own_h), (w, h)) = (own, size);
            picture.view = Err(format!(
                "its size is {own_w} x {own_h} px, but the others have {w} x {h} px"
            )
            .into());
        }
    }
    Ok(size)
}

/// Lists the images without points or excluded, a line each.
fn list_failures(pictures: &[BoardImage], excluded: &[Option<ImageRejection>]) -> String {
    let reason = |(k, p): (usize, &BoardImage)| match &p.view {
        Err(reason) => Some(format!("\n  {}: {reason}", p.name)),
        Ok(_) => excluded
            .get(k)
            .copied()
            .flatten()
            .map(|d| format!("\n  {}: {d}", p.name)),
    };
    pictures.iter().enumerate().filter_map(reason).collect()
}

/// A calibration with its verdict.
pub struct JudgedCalibration {
    pub calibration: Calibration,
    pub verdict: Verdict,
    pub reasons: Vec<String>,
    /// Number of leading reasons that refuse the calibration.
    pub refusals: usize,
}

/// Calibrates and judges the result.
///
/// # Errors
/// Returns the reasons of a failure, the most serious first, with the images that do not take part.
pub fn calibrate_and_judge(
    pictures: &mut [BoardImage],
    described: &DescribedBoard,
    select: bool,
) -> Result<JudgedCalibration, Reason> {
    let size = common_size(pictures)?;
    let views: Vec<BoardView> = pictures
        .iter()
        .map(|p| p.view.clone().unwrap_or_default())
        .collect();
    let misfits: Vec<Option<BoardMismatch>> = pictures
        .iter()
        .filter(|p| p.view.is_ok())
        .map(|p| p.misfit)
        .collect();
    let board_reason = calibrate::description_mismatch(&described.board, &misfits);
    let never_whole = calibrate::missing_corner_lines(&described.board, &views);
    let options = CalibrationOptions {
        select,
        scale_sigma: described.scale_sigma,
    };
    let calibration =
        calibrate::calibrate_with_options(&views, size.0, size.1, &options).map_err(|e| {
            let board = board_reason.clone().or_else(|| never_whole.clone());
            let first = board.unwrap_or_else(|| e.to_string());
            let excluded = if let CalibrateError::TooFewViews {
                rejections: dropped,
                ..
            } = &e
            {
                &dropped[..]
            } else {
                &[]
            };
            let text = format!(
                "no calibration: {first}{}",
                list_failures(pictures, excluded)
            );
            Reason::new(text, e)
        })?;
    let refusals = calibrate::count_refusals(&calibration, board_reason.clone());
    let (mut verdict, mut reasons) = calibrate::judge_calibration(&calibration, board_reason);
    if let Some(reason) = never_whole {
        verdict = verdict.max(Verdict::Poor);
        reasons.push(reason);
    }
    Ok(JudgedCalibration {
        calibration,
        verdict,
        reasons,
        refusals,
    })
}

/// Summarises a calibration for camera.toml.
pub fn calibration_report(
    calibration: &Calibration,
    verdict: Verdict,
    accepted: Option<String>,
) -> CalibrationReport {
    let c = &calibration.covariance;
    let used = calibration.view_rms_px.iter().flatten().count();
    let stretch = calibration.stretch.filter(|s| s.prior_sigma.is_some());
    CalibrationReport {
        rms_px: calibration.rms_px,
        images_used: used,
        images_rejected: calibration.view_rms_px.len() - used,
        observations: calibration.observations,
        verdict: verdict.name(),
        accepted,
        projection_sigma_px: calibration
            .projections
            .iter()
            .flatten()
            .map(|p| p.sigma_px)
            .collect(),
        board_bow_m: calibration.bow.map(|b| b.value_m),
        board_bow_sigma_m: calibration.bow.map(|b| b.sigma_m),
        board_stretch: stretch.map(|s| s.value),
        board_stretch_sigma: stretch.map(|s| s.sigma),
        sigma: std::array::from_fn(|k| (!calibration.fixed[k]).then(|| c[(k, k)].max(0.0).sqrt())),
        halves_px: calibration
            .halves
            .map(|h| [h.difference_px, h.predicted_px]),
        covariance: c.row_iter().map(|r| r.iter().copied().collect()).collect(),
    }
}
