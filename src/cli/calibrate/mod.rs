//! `wingd calibrate` finds the interior orientation from pictures of a board.

mod live;
mod output;
mod pictures;

use std::path::PathBuf;

use self::pictures::{Picture, common_size, reason};
use super::{Done, Failure, RIGHTS, print, unwritable};
use crate::installation::{self, DescribedBoard};
use crate::measure::calibrate::{self, CalibrateError, Calibration, Misfit, Options, Verdict, View};
use crate::record::Reason;
use crate::report;

/// Interior orientation from pictures of a board.
#[derive(clap::Args)]
pub struct Args {
    /// The board: pattern, columns, rows and sizes
    #[arg(long, value_name = "BOARD")]
    board: PathBuf,
    /// Where the camera is written
    #[arg(long, value_name = "CAMERA")]
    output: PathBuf,
    /// The result as one JSON object
    #[arg(long)]
    json: bool,
    /// Drop distortion terms that do not differ from 0 at 95 %
    #[arg(long)]
    select: bool,
    /// With pictures: writes their corners to this file. Without: reads them from it
    #[arg(long, value_name = "FILE.csv")]
    corners: Option<PathBuf>,
    /// Writes figures and tables as one page that opens offline
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Writes a calibration that a single reason refuses, with your reason for taking it; it stays marked
    #[arg(long, value_name = "REASON")]
    accept: Option<String>,
    /// Takes the pictures with the camera of --config until the verdict is good, and says what is missing
    #[arg(long, requires = "config", conflicts_with = "images")]
    live: bool,
    /// Configuration whose [camera] takes the pictures
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
    /// Pictures that --live takes at most
    #[arg(long, default_value_t = 100)]
    shots: usize,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Pictures of the board in different attitudes, up to the corners of the image
    #[arg(required_unless_present_any = ["corners", "live"], value_name = "IMAGE")]
    images: Vec<PathBuf>,
}

/// A calibration with its judgement.
struct Judged {
    calibration: Calibration,
    verdict: Verdict,
    reasons: Vec<String>,
    /// Of the reasons so many, the first ones, refuse it.
    refusals: usize,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let board = installation::load_board(&args.board)?;
    let mut pictures = match &args.config {
        Some(config) if args.live => live::pictures(args, config, &board)?,
        _ => pictures::pictures(args, &board.board)?,
    };
    let writes = args.corners.as_ref().filter(|_| args.live || !args.images.is_empty());
    if let Some(file) = writes {
        pictures::write_corners(file, &pictures, None)?;
    }
    let judged = judged(&mut pictures, &board, args.select)?;
    if let Some(file) = writes {
        pictures::write_corners(file, &pictures, Some(&judged.calibration))?;
    }
    finish(args, &pictures, &judged)
}

/// Calibrates and judges; the reasons of a failure begin with the gravest.
fn judged(pictures: &mut [Picture], described: &DescribedBoard, select: bool) -> Result<Judged, Reason> {
    let size = common_size(pictures)?;
    let views: Vec<View> = pictures.iter().map(|p| p.view.clone().unwrap_or_default()).collect();
    let misfits: Vec<Option<Misfit>> = pictures.iter().filter(|p| p.view.is_ok()).map(|p| p.misfit).collect();
    let board_reason = calibrate::misdescribed(&described.board, &misfits);
    let never_whole = calibrate::never_whole(&described.board, &views);
    let options = Options { select, scale_sigma: described.scale_sigma };
    let calibration = calibrate::calibrate_with(&views, size.0, size.1, &options).map_err(|e| {
        let board = board_reason.clone().or_else(|| never_whole.clone());
        let first = board.unwrap_or_else(|| e.to_string());
        let left_out = if let CalibrateError::TooFewViews { dropped, .. } = &e { &dropped[..] } else { &[] };
        let text = format!("no calibration: {first}{}", pictures::failures(pictures, left_out));
        Reason::new(text, e)
    })?;
    let refusals = calibrate::refusals(&calibration, board_reason.clone());
    let (mut verdict, mut reasons) = calibrate::judge(&calibration, board_reason);
    if let Some(reason) = never_whole {
        verdict = verdict.max(Verdict::Poor);
        reasons.push(reason);
    }
    Ok(Judged { calibration, verdict, reasons, refusals })
}

fn finish(args: &Args, pictures: &[Picture], judged: &Judged) -> Result<Done, Failure> {
    let Judged { calibration, verdict, reasons, .. } = judged;
    let accepted = accepted(args, judged)?;
    let written = output::report(calibration, *verdict, accepted.clone());
    if *verdict != Verdict::Refused || accepted.is_some() {
        installation::write_camera(&args.output, &calibration.lens, Some(&written))
            .map_err(unwritable(&args.output, RIGHTS))?;
    }
    let left_out: Vec<Option<String>> =
        pictures.iter().enumerate().map(|(k, p)| reason(calibration, k, p)).collect();
    if let Some(file) = &args.report {
        let names: Vec<&str> = pictures.iter().map(|p| p.name.as_str()).collect();
        let page = report::calibration::page(
            calibration,
            (*verdict, accepted.as_deref()),
            reasons,
            &names,
            &left_out,
        );
        installation::write_page(file, &page).map_err(unwritable(file, RIGHTS))?;
    }
    for (picture, reason) in pictures.iter().zip(&left_out) {
        if let Some(reason) = reason {
            eprintln!("{}: left out: {reason}", picture.name);
        }
    }
    print(&if args.json {
        output::json(calibration, &written, reasons, pictures)
    } else {
        output::text(&args.output, calibration, &written)
    })?;
    if *verdict == Verdict::Refused && accepted.is_none() {
        let list: String = reasons.iter().map(|r| format!("\n  {r}")).collect();
        return Err(Failure::Failed(format!("refused, {} is not written:{list}", args.output.display())));
    }
    if let Some(reason) = &accepted {
        eprintln!("refused, and written all the same, marked as accepted: {reason}");
    }
    for reason in reasons {
        eprintln!("{}: {reason}", verdict.name());
    }
    Ok(Done::All)
}

/// Why a refused calibration is written all the same; an error where it cannot be.
fn accepted(args: &Args, judged: &Judged) -> Result<Option<String>, Failure> {
    let Some(reason) = args.accept.as_ref().filter(|_| judged.verdict == Verdict::Refused) else {
        return Ok(None);
    };
    let fault = if reason.trim().is_empty() {
        "--accept takes a reason in words".to_owned()
    } else if judged.calibration.projections.is_none() {
        "a lens model without an inverse over the image cannot be accepted: no command could use it"
            .to_owned()
    } else if judged.refusals > 1 {
        format!(
            "--accept takes a calibration that a single reason refuses; here there are {}",
            judged.refusals
        )
    } else {
        return Ok(Some(reason.trim().to_owned()));
    };
    let list: String = judged.reasons.iter().map(|r| format!("\n  {r}")).collect();
    Err(Failure::Failed(format!("{fault}:{list}")))
}
