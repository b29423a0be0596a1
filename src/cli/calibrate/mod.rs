//! `wingd calibrate` estimates the interior orientation from images of a board.

mod board_images;
mod live;
mod output;

use std::path::PathBuf;

use self::board_images::{BoardImage, common_size, exclusion_reason};
use super::{CHECK_WRITE_ACCESS, Completion, Failure, print_line, write_failure};
use crate::exchange::{self, DescribedBoard};
use crate::installation;
use crate::measure::calibrate::{
    self, BoardMismatch, BoardView, CalibrateError, Calibration, CalibrationOptions, Verdict,
};
use crate::record::Reason;
use crate::report;

/// Estimate the interior orientation from images of a board.
#[derive(clap::Args)]
pub struct CalibrateArgs {
    /// Board: pattern, columns, rows and sizes
    #[arg(long, value_name = "BOARD")]
    board: PathBuf,
    /// File for the camera
    #[arg(long, value_name = "CAMERA")]
    output: PathBuf,
    /// Print the result as one JSON object
    #[arg(long)]
    json: bool,
    /// Drop distortion terms that do not differ from 0 at 95 %
    #[arg(long)]
    select: bool,
    /// File of board corners: written if images are given, otherwise read
    #[arg(long, value_name = "FILE.csv")]
    corners: Option<PathBuf>,
    /// Write figures and tables as one HTML page that opens offline
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Write a calibration that is refused for a single reason, and record your reason for accepting it
    #[arg(long, value_name = "REASON")]
    accept: Option<String>,
    /// Take images with the camera of --config until the verdict is good, and show what is missing
    #[arg(long, requires = "config", conflicts_with = "images")]
    live: bool,
    /// Configuration whose [camera] takes the images
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
    /// Maximum number of images taken by --live
    #[arg(long, default_value_t = 100)]
    shots: usize,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Images of the board in different attitudes, up to the corners of the image
    #[arg(required_unless_present_any = ["corners", "live"], value_name = "IMAGE")]
    images: Vec<PathBuf>,
}

/// A calibration with its verdict.
struct JudgedCalibration {
    calibration: Calibration,
    verdict: Verdict,
    reasons: Vec<String>,
    /// Number of leading reasons that refuse the calibration.
    refusals: usize,
}

pub(super) fn run(args: &CalibrateArgs) -> Result<Completion, Failure> {
    let board = exchange::load_board(&args.board)?;
    let mut pictures = match &args.config {
        Some(config) if args.live => live::take_images(args, config, &board)?,
        _ => board_images::read_images(args, &board.board)?,
    };
    let writes = args.corners.as_ref().filter(|_| args.live || !args.images.is_empty());
    if let Some(file) = writes {
        board_images::write_corners(file, &pictures, None)?;
    }
    let judged = calibrate_and_judge(&mut pictures, &board, args.select)?;
    if let Some(file) = writes {
        board_images::write_corners(file, &pictures, Some(&judged.calibration))?;
    }
    write_and_report(args, &pictures, &judged)
}

/// Calibrates and judges the result; the reasons of a failure begin with the most serious.
fn calibrate_and_judge(
    pictures: &mut [BoardImage],
    described: &DescribedBoard,
    select: bool,
) -> Result<JudgedCalibration, Reason> {
    let size = common_size(pictures)?;
    let views: Vec<BoardView> = pictures.iter().map(|p| p.view.clone().unwrap_or_default()).collect();
    let misfits: Vec<Option<BoardMismatch>> = pictures.iter().filter(|p| p.view.is_ok()).map(|p| p.misfit).collect();
    let board_reason = calibrate::description_mismatch(&described.board, &misfits);
    let never_whole = calibrate::missing_corner_lines(&described.board, &views);
    let options = CalibrationOptions { select, scale_sigma: described.scale_sigma };
    let calibration = calibrate::calibrate_with_options(&views, size.0, size.1, &options).map_err(|e| {
        let board = board_reason.clone().or_else(|| never_whole.clone());
        let first = board.unwrap_or_else(|| e.to_string());
        let excluded =
            if let CalibrateError::TooFewViews { rejections: dropped, .. } = &e { &dropped[..] } else { &[] };
        let text = format!("no calibration: {first}{}", board_images::list_failures(pictures, excluded));
        Reason::new(text, e)
    })?;
    let refusals = calibrate::count_refusals(&calibration, board_reason.clone());
    let (mut verdict, mut reasons) = calibrate::judge_calibration(&calibration, board_reason);
    if let Some(reason) = never_whole {
        verdict = verdict.max(Verdict::Poor);
        reasons.push(reason);
    }
    Ok(JudgedCalibration { calibration, verdict, reasons, refusals })
}

fn write_and_report(
    args: &CalibrateArgs,
    pictures: &[BoardImage],
    judged: &JudgedCalibration,
) -> Result<Completion, Failure> {
    let JudgedCalibration { calibration, verdict, reasons, .. } = judged;
    let accepted = acceptance_reason(args, judged)?;
    let written = output::calibration_report(calibration, *verdict, accepted.clone());
    if *verdict != Verdict::Refused || accepted.is_some() {
        installation::write_camera(&args.output, &calibration.lens, Some(&written))
            .map_err(write_failure(&args.output, CHECK_WRITE_ACCESS))?;
    }
    let excluded: Vec<Option<String>> =
        pictures.iter().enumerate().map(|(k, p)| exclusion_reason(calibration, k, p)).collect();
    if let Some(file) = &args.report {
        let names: Vec<&str> = pictures.iter().map(|p| p.name.as_str()).collect();
        let page = report::calibration::calibration_page(
            calibration,
            (*verdict, accepted.as_deref()),
            reasons,
            &names,
            &excluded,
        );
        installation::write_atomically(file, &page).map_err(write_failure(file, CHECK_WRITE_ACCESS))?;
    }
    for (picture, reason) in pictures.iter().zip(&excluded) {
        if let Some(reason) = reason {
            eprintln!("{}: excluded: {reason}", picture.name);
        }
    }
    print_line(&if args.json {
        output::result_json(calibration, &written, reasons, pictures)
    } else {
        output::result_text(&args.output, calibration, &written)
    })?;
    if *verdict == Verdict::Refused && accepted.is_none() {
        let list: String = reasons.iter().map(|r| format!("\n  {r}")).collect();
        return Err(Failure::Failed(format!("refused, {} is not written:{list}", args.output.display())));
    }
    if let Some(reason) = &accepted {
        eprintln!("refused, but written and marked as accepted: {reason}");
    }
    for reason in reasons {
        eprintln!("{}: {reason}", verdict.name());
    }
    Ok(Completion::All)
}

/// Returns the reason for writing a refused calibration, or an error if it cannot be accepted.
fn acceptance_reason(args: &CalibrateArgs, judged: &JudgedCalibration) -> Result<Option<String>, Failure> {
    let Some(reason) = args.accept.as_ref().filter(|_| judged.verdict == Verdict::Refused) else {
        return Ok(None);
    };
    let fault = if reason.trim().is_empty() {
        "--accept needs a reason in words".to_owned()
    } else if judged.calibration.projections.is_none() {
        "a lens model without an inverse over the image cannot be accepted: no command could use it".to_owned()
    } else if judged.refusals > 1 {
        format!("--accept works only if a single reason refuses the calibration; here there are {}", judged.refusals)
    } else {
        return Ok(Some(reason.trim().to_owned()));
    };
    let list: String = judged.reasons.iter().map(|r| format!("\n  {r}")).collect();
    Err(Failure::Failed(format!("{fault}:{list}")))
}
