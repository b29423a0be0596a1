//! `wingd calibrate` estimates the interior orientation from images of a board.

mod output;

use std::path::PathBuf;

use crate::calibration::{
    BoardImage, JudgedCalibration, board_corners, calibrate_and_judge, calibration_report,
    exclusion_reason,
};
use crate::report;
use wingd_base::failure::CHECK_WRITE_ACCESS;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line, write_output};
use wingd_evaluation::boards;
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::installation;
use wingd_evaluation::record::Reason;
use wingd_measure::calibrate::Board;
use wingd_measure::calibrate::Verdict;

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
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Images of the board in different attitudes, up to the corners of the image
    #[arg(required_unless_present = "corners", value_name = "IMAGE")]
    images: Vec<PathBuf>,
}

/// Calibrates a camera from images of a board or their corners, and writes the calibration, its page and corners.
pub(super) fn run(args: &CalibrateArgs) -> TaskResult<Completion> {
    let board = boards::load_board(&args.board)?;
    let mut pictures = read_images(args, &board.board)?;
    if let Some(file) = args.corners.as_ref().filter(|_| !args.images.is_empty()) {
        boards::write_corners(file, &board_corners(&pictures))
            .map_err(|error| Failure::from_write_error(file, &error, CHECK_WRITE_ACCESS))?;
    }
    let judge = || calibrate_and_judge(&mut pictures, &board, args.select);
    let judged = run_long_task("calibrating", judge)?;
    write_and_report(args, &pictures, &judged)
}

/// Reads the images, or a file of corners.
fn read_images(args: &CalibrateArgs, board: &Board) -> TaskResult<Vec<BoardImage>> {
    if let (Some(file), true) = (&args.corners, args.images.is_empty()) {
        return Ok(boards::read_corners(file)?
            .into_iter()
            .map(BoardImage::from)
            .collect());
    }
    let mut pictures = vec![];
    let files = batch::expand_folders(&args.images)?;
    let detect = |name: &str, bytes: Result<&[u8], Reason>| BoardImage::detect(name, bytes, board);
    batch::for_each_image(
        &files,
        args.jobs,
        "finding boards",
        detect,
        batch::collect_into(&mut pictures),
    )?;
    Ok(pictures)
}

fn write_and_report(
    args: &CalibrateArgs,
    pictures: &[BoardImage],
    judged: &JudgedCalibration,
) -> TaskResult<Completion> {
    let JudgedCalibration {
        calibration,
        verdict,
        reasons,
        ..
    } = judged;
    let accepted = acceptance_reason(args, judged)?;
    let written = calibration_report(calibration, *verdict, accepted.clone());
    if *verdict != Verdict::Refused || accepted.is_some() {
        installation::write_camera(&args.output, &calibration.lens, Some(&written))
            .map_err(|error| Failure::from_write_error(&args.output, &error, CHECK_WRITE_ACCESS))?;
    }
    let excluded: Vec<Option<String>> = pictures
        .iter()
        .enumerate()
        .map(|(k, p)| exclusion_reason(calibration, k, p))
        .collect();
    if let Some(file) = &args.report {
        let names: Vec<&str> = pictures.iter().map(|p| p.name.as_str()).collect();
        let page = report::calibration::calibration_page(
            calibration,
            (*verdict, accepted.as_deref()),
            reasons,
            &names,
            &excluded,
        );
        write_output(file, &page, CHECK_WRITE_ACCESS)?;
    }
    for (picture, reason) in pictures.iter().zip(&excluded) {
        if let Some(reason) = reason {
            eprintln!("{}: excluded: {reason}", picture.name);
        }
    }
    if args.json {
        print_json(&output::result_json(
            calibration,
            &written,
            reasons,
            pictures,
        ))?;
    } else {
        print_line(&output::result_text(&args.output, calibration, &written))?;
    }
    if *verdict == Verdict::Refused && accepted.is_none() {
        let list: String = reasons.iter().map(|r| format!("\n  {r}")).collect();
        return Err(Failure::Failed(format!(
            "refused, {} is not written:{list}",
            args.output.display()
        )));
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
fn acceptance_reason(
    args: &CalibrateArgs,
    judged: &JudgedCalibration,
) -> TaskResult<Option<String>> {
    let Some(reason) = args
        .accept
        .as_ref()
        .filter(|_| judged.verdict == Verdict::Refused)
    else {
        return Ok(None);
    };
    let fault = if reason.trim().is_empty() {
        "--accept needs a reason in words".to_owned()
    } else if judged.calibration.projections.is_none() {
        "a lens model without an inverse over the image cannot be accepted: no command could use it"
            .to_owned()
    } else if judged.refusals > 1 {
        format!(
            "--accept works only if a single reason refuses the calibration; here there are {}",
            judged.refusals
        )
    } else {
        return Ok(Some(reason.trim().to_owned()));
    };
    let list: String = judged.reasons.iter().map(|r| format!("\n  {r}")).collect();
    Err(Failure::Failed(format!("{fault}:{list}")))
}
