//! `wingd calibrate`: interior orientation from pictures of a board.

use std::path::{Path, PathBuf};

use super::{Done, Failure, frames, print};
use crate::installation::{self, CalibrationReport, PictureCorners};
use crate::measure::calibrate::{self, Board, Calibration, Misfit, Verdict, View};
use crate::pipeline::decode;

/// Interior orientation from pictures of a board.
#[derive(clap::Args)]
pub struct Args {
    /// The board: pattern, columns, rows and sizes
    #[arg(long, value_name = "BOARD.toml")]
    board: PathBuf,
    /// Where the camera is written
    #[arg(long, value_name = "camera.toml")]
    output: PathBuf,
    /// The result as one JSON object
    #[arg(long)]
    json: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Drop distortion terms that do not differ from 0 at 95 %
    #[arg(long)]
    select: bool,
    /// With pictures: writes their corners to this file. Without: reads them from it
    #[arg(long, value_name = "FILE.csv")]
    corners: Option<PathBuf>,
    /// Pictures of the board in different attitudes, up to the corners of the image
    #[arg(required_unless_present = "corners", value_name = "IMAGE")]
    images: Vec<PathBuf>,
}

/// One picture: its size and points, or why there are none.
struct Picture {
    name: String,
    size: Option<(u32, u32)>,
    view: Result<View, String>,
    misfit: Option<Misfit>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let board = installation::load_board(&args.board)?;
    let mut pictures = pictures(args, &board)?;
    let size = common_size(&mut pictures)?;
    let views: Vec<View> = pictures.iter().map(|p| p.view.clone().unwrap_or_default()).collect();
    let misfits: Vec<Option<Misfit>> = pictures.iter().filter(|p| p.view.is_ok()).map(|p| p.misfit).collect();
    let board_reason = calibrate::misdescribed(&board, &misfits);
    let calibration = calibrate::calibrate_with(&views, size.0, size.1, args.select).map_err(|e| {
        let e = board_reason.clone().unwrap_or_else(|| e.to_string());
        let reasons: String = pictures
            .iter()
            .filter_map(|p| p.view.as_ref().err().map(|r| format!("\n  {}: {r}", p.name)))
            .collect();
        Failure::Undone(format!("no calibration: {e}{reasons}"))
    })?;
    let (verdict, reasons) = calibrate::judge(&calibration, board_reason);
    let report = report(&calibration, verdict);
    if verdict != Verdict::Refused {
        installation::write_camera(&args.output, &calibration.lens, Some(&report))
            .map_err(|e| unwritable(&args.output, &e))?;
    }
    for (k, picture) in pictures.iter().enumerate() {
        if let Some(reason) = reason(&calibration, k, picture) {
            eprintln!("{}: left out: {reason}", picture.name);
        }
    }
    print(&if args.json {
        json(&calibration, &report, &reasons, &pictures)
    } else {
        text(args, &calibration, &report)
    })?;
    if verdict == Verdict::Refused {
        let list: String = reasons.iter().map(|r| format!("\n  {r}")).collect();
        return Err(Failure::Undone(format!("refused, {} is not written:{list}", args.output.display())));
    }
    for reason in &reasons {
        eprintln!("{}: {reason}", verdict.name());
    }
    Ok(Done::All)
}

/// From pictures or from a file of corners.
fn pictures(args: &Args, board: &Board) -> Result<Vec<Picture>, Failure> {
    if let (Some(file), true) = (&args.corners, args.images.is_empty()) {
        let from =
            |c: PictureCorners| Picture { name: c.image, size: Some(c.size), view: Ok(c.view), misfit: None };
        return Ok(installation::read_corners(file)?.into_iter().map(from).collect());
    }
    let pictures =
        frames::map(&args.images, args.jobs, "finding boards", |name, bytes| picture(name, bytes, board))?;
    if let Some(file) = &args.corners {
        let corners = |p: &Picture| {
            let (size, view) = (p.size?, p.view.clone().ok()?);
            Some(PictureCorners { image: p.name.clone(), size, view })
        };
        let corners: Vec<PictureCorners> = pictures.iter().filter_map(corners).collect();
        installation::write_corners(file, &corners).map_err(|e| unwritable(file, &e))?;
    }
    Ok(pictures)
}

fn unwritable(file: &Path, error: &std::io::Error) -> Failure {
    Failure::Undone(format!("{} cannot be written ({error}); check rights and space", file.display()))
}

/// Why a picture took no part.
fn reason(calibration: &Calibration, k: usize, picture: &Picture) -> Option<String> {
    match &picture.view {
        Err(reason) => Some(reason.clone()),
        Ok(_) => calibration.dropped[k].map(|d| d.to_string()),
    }
}

fn picture(name: &str, bytes: Result<&[u8], String>, board: &Board) -> Picture {
    let raster = bytes.and_then(|b| decode::decode(b, None).map_err(|e| e.to_string()));
    let size = raster.as_ref().ok().map(|r| (r.width() as u32, r.height() as u32));
    let sighting = raster.and_then(|r| board.find(&r).map_err(|e| e.to_string()));
    let misfit = sighting.as_ref().ok().and_then(|s| s.misfit);
    Picture { name: name.into(), size, view: sighting.map(|s| s.view), misfit }
}

/// The size of most pictures; others are left out with a reason, as they come from another camera
/// or another cropping.
fn common_size(pictures: &mut [Picture]) -> Result<(u32, u32), Failure> {
    let sizes: Vec<(u32, u32)> = pictures.iter().filter(|p| p.view.is_ok()).filter_map(|p| p.size).collect();
    let count = |s: &(u32, u32)| sizes.iter().filter(|o| *o == s).count();
    let size = sizes.iter().copied().max_by_key(|s| (count(s), *s));
    let Some(size) = size else {
        let reasons: String = pictures
            .iter()
            .filter_map(|p| p.view.as_ref().err().map(|r| format!("\n  {}: {r}", p.name)))
            .collect();
        return Err(Failure::Undone(format!("no picture shows the board{reasons}")));
    };
    for picture in pictures.iter_mut().filter(|p| p.view.is_ok()) {
        if let Some(own) = picture.size.filter(|own| *own != size) {
            picture.view =
                Err(format!("its size is {} x {} px, the others' {} x {} px", own.0, own.1, size.0, size.1));
        }
    }
    Ok(size)
}

fn report(calibration: &Calibration, verdict: Verdict) -> CalibrationReport {
    let c = &calibration.covariance;
    let used = calibration.view_rms_px.iter().flatten().count();
    CalibrationReport {
        rms_px: calibration.rms_px,
        images_used: used,
        images_rejected: calibration.view_rms_px.len() - used,
        observations: calibration.observations,
        verdict: verdict.name(),
        projection_sigma_px: calibration.projections.iter().flatten().map(|p| p.sigma_px).collect(),
        board_bow_m: calibration.bow.map(|b| b.value_m),
        board_bow_sigma_m: calibration.bow.map(|b| b.sigma_m),
        sigma: std::array::from_fn(|k| (!calibration.held[k]).then(|| c[(k, k)].max(0.0).sqrt())),
        halves_px: calibration.halves.map(|h| [h.difference_px, h.predicted_px]),
        covariance: c.row_iter().map(|r| r.iter().copied().collect()).collect(),
    }
}

/// Index of k1 among the parameters.
const FIRST_DISTORTION: usize = 4;
/// Some hundred points leave Student's t at 95 % at the normal's.
const SIGNIFICANT: f64 = 1.96;
const NAMES: [&str; 9] = ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2"];

fn values(c: &Calibration) -> [f64; 9] {
    let l = &c.lens;
    [l.fx, l.fy, l.cx, l.cy, l.k1, l.k2, l.k3, l.p1, l.p2]
}

fn json(
    calibration: &Calibration,
    report: &CalibrationReport,
    reasons: &[String],
    pictures: &[Picture],
) -> String {
    let by_name = |values: [Option<f64>; 9]| -> serde_json::Map<String, serde_json::Value> {
        NAMES.iter().zip(values).map(|(n, v)| ((*n).to_owned(), v.into())).collect()
    };
    let parameters = values(calibration).map(Some);
    let mut camera = serde_json::Map::new();
    camera.insert("width".into(), calibration.lens.width.into());
    camera.insert("height".into(), calibration.lens.height.into());
    camera.extend(by_name(parameters));
    let image = |(k, p): (usize, &Picture)| {
        serde_json::json!({
            "image": p.name,
            "used": calibration.view_rms_px[k].is_some(),
            "reason": reason(calibration, k, p),
            "corners": p.view.as_ref().map_or(0, Vec::len),
            "corners_used": calibration.view_points[k],
            "rms_px": calibration.view_rms_px[k],
            "tilt_deg": calibration.tilt_deg[k],
        })
    };
    let images: Vec<_> = pictures.iter().enumerate().map(image).collect();
    serde_json::json!({
        "status": if report.verdict == Verdict::Refused.name() { "refused" } else { "ok" },
        "verdict": report.verdict,
        "reasons": reasons,
        "parameters": by_name(parameters),
        "sigma": by_name(report.sigma),
        "t_values": by_name(std::array::from_fn(|k| t_value(calibration, report, k))),
        "correlation": correlation(calibration),
        "halves": calibration.halves.map(|h| serde_json::json!({
            "distance_m": h.distance_m, "difference_px": h.difference_px, "predicted_px": h.predicted_px,
        })),
        "pattern": { "image_px": calibration.pattern.image_px, "board_px": calibration.pattern.board_px },
        "model_sigma_px": calibration.model_sigma_px,
        "board_bow_m": report.board_bow_m,
        "board_bow_sigma_m": report.board_bow_sigma_m,
        "projection_sigma_px": report.projection_sigma_px,
        "camera": camera,
        "calibration": report,
        "images": images,
    })
    .to_string()
}

/// Value over standard deviation of a distortion term.
fn t_value(calibration: &Calibration, report: &CalibrationReport, k: usize) -> Option<f64> {
    report.sigma[k].filter(|s| k >= FIRST_DISTORTION && *s > 0.0).map(|s| values(calibration)[k] / s)
}

fn correlation(calibration: &Calibration) -> Vec<Vec<Option<f64>>> {
    let c = &calibration.covariance;
    let of = |i: usize, j: usize| {
        let product = (c[(i, i)] * c[(j, j)]).sqrt();
        (product > 0.0).then(|| c[(i, j)] / product)
    };
    (0..9).map(|i| (0..9).map(|j| of(i, j)).collect()).collect()
}

fn text(args: &Args, calibration: &Calibration, report: &CalibrationReport) -> String {
    let mut text = format!(
        "{}: {}\n{} of {} pictures, {} points, rms {:.4} px\n",
        args.output.display(),
        report.verdict,
        report.images_used,
        report.images_used + report.images_rejected,
        report.observations,
        report.rms_px
    );
    for (k, ((name, value), sigma)) in NAMES.iter().zip(values(calibration)).zip(report.sigma).enumerate() {
        let digits = if k < FIRST_DISTORTION { 3 } else { 6 };
        let weak = t_value(calibration, report, k).is_some_and(|t| t.abs() < SIGNIFICANT);
        let sigma = sigma.map_or("held".to_owned(), |s| format!("+- {s:.digits$}"));
        let note = if weak { " (not significant)" } else { "" };
        text.push_str(&format!("{name:>3} {value:>12.digits$} {sigma}{note}\n"));
    }
    for (name, bow) in ["along", "across"].iter().zip(calibration.bow) {
        let flat = if bow.significant() { "" } else { " (not significant)" };
        let (value, sigma) = (1e3 * bow.value_m, 1e3 * bow.sigma_m);
        text.push_str(&format!("board's bow {name} {value:.3} +- {sigma:.3} mm{flat}\n"));
    }
    for p in calibration.projections.iter().flatten() {
        let (distance, sigma) = (p.distance_m, p.sigma_px);
        text.push_str(&format!("projection at {distance} m +- {sigma:.3} px (rms over the image)\n"));
    }
    if let Some(h) = calibration.halves {
        let (difference, predicted, at) = (h.difference_px, h.predicted_px, h.distance_m);
        text.push_str(&format!(
            "halves differ by {difference:.3} px at {at} m, predicted {predicted:.3} px\n"
        ));
    }
    text.trim_end().to_owned()
}
