//! `wingd orient` estimates the camera's attitude from ground frames and writes orientation.toml.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::default_paths::{load_without_orientation, resolve_installation};
use super::{Completion, Failure, batch, print_line, print_notes};
use crate::desk::CHECK_WRITE_ACCESS;
use crate::desk::manual_points::ManualPoints;
use crate::installation::{self, Installation};
use crate::measure::identify::{self, IdentifyError, OrientationFit};
use crate::measure::setup::Setup;
use crate::pipeline::orienting::{self, GroundFrame};
use crate::record::Reason;
use crate::report::number::format_rounded;

/// Estimate the camera's attitude from ground frames and write orientation.toml.
#[derive(clap::Args)]
pub struct OrientArgs {
    /// Installation; orientation.toml is written into it [default: installation/ in this directory]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Ground frames, taken with the camera mounted as in the survey
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Manual marks in the frames, as saved by `wingd mark --ground` (id,u_px,v_px,sigma_px; for several frames also
    /// image); they replace the detections of these markers
    #[arg(long, value_name = "FILE.csv")]
    observations: Option<PathBuf>,
    /// Print the fit as one JSON object
    #[arg(long)]
    json: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

pub(super) fn run(args: &OrientArgs) -> Result<Completion, Failure> {
    let installation = load_without_orientation(&resolve_installation(args.installation.as_deref())?)?;
    let files = batch::expand_folders(&args.images)?;
    let mut frames = Vec::with_capacity(files.len());
    let mut reasons: Vec<String> = vec![];
    let process = |name: &str, bytes: Result<&[u8], Reason>| {
        bytes
            .and_then(|b| orienting::process_ground_frame(name, b, &installation.setup))
            .map_err(|why| format!("{name}: {why}"))
    };
    batch::for_each_image(&files, args.jobs, "detecting", process, |ground| {
        match ground {
            Ok(frame) => frames.push(frame),
            Err(reason) => reasons.push(reason),
        }
        Ok(())
    })?;
    if !reasons.is_empty() {
        return Err(Failure::Failed(reasons.join("\nwingd: ")));
    }
    let setup = &installation.setup;
    let names: Vec<String> = frames.iter().map(|f| f.processed.image.clone()).collect();
    if let Some(file) = &args.observations {
        let manual = ManualPoints::read(file, &files, setup)?;
        print_notes(&manual.note);
        frames
            .iter_mut()
            .zip(&names)
            .for_each(|(frame, name)| frame.set_manual_observations(manual.for_image(name).cloned().collect()));
    }
    let fit = orienting::orient_frames(setup, &mut frames)
        .map_err(|e| Failure::Failed(format!("no orientation: {}", failure_text(setup, &frames, &e, &names))))?;
    let images: Vec<(String, String)> =
        frames.iter().map(|f| (f.processed.image.clone(), f.processed.digest.clone())).collect();
    let file = installation.directory.join(installation::ORIENTATION_FILE);
    let written = installation::write_orientation(&installation, &fit, &images);
    written.map_err(|error| Failure::from_write_error(&file, &error, CHECK_WRITE_ACCESS))?;
    print_line(&if args.json { fit_json(&installation, &fit) } else { fit_text(&installation, &fit) })?;
    Ok(Completion::All)
}

/// Describes a failure with the frame concerned, and its cause if it can be diagnosed.
fn failure_text(setup: &Setup, frames: &[GroundFrame], error: &IdentifyError, names: &[String]) -> String {
    let name = |frame: usize| names.get(frame).map_or("a frame", String::as_str);
    match error {
        IdentifyError::Misfit(misfit) => format!("{}: {misfit}", name(misfit.frame)),
        IdentifyError::TooFew { .. } => error.to_string(),
        _ => identify::diagnose_ground_frames(setup, &orienting::detected_markers(frames))
            .map_or_else(|| error.to_string(), |(frame, cause)| format!("{}: {cause}", name(frame))),
    }
}

/// Returns remarks on an image taken upside down and on a wing bent since the survey.
fn orientation_remarks(fit: &OrientationFit) -> Vec<String> {
    // Image axis v points down.
    let up = fit.orientation.camera_from_survey * Vector3::z();
    let on_its_head = up.y > UPSIDE_DOWN_COSINE;
    let turned = "the image is upside down; unless the camera was, rotate the images back: camera.toml is valid only for images as \
                the camera took them";
    on_its_head.then(|| turned.to_owned()).into_iter().chain(bend_remark(fit)).collect()
}

/// Remark on bending between survey and ground frame, if significant.
fn bend_remark(fit: &OrientationFit) -> Option<String> {
    let bend = fit.bend.filter(|_| fit.is_bent())?;
    let (mm, sigma) = format_rounded(Some(1e3 * bend.value.abs()), bend.sigma.map(|s| 1e3 * s), 0);
    let way = if bend.value > 0.0 { "higher" } else { "lower" };
    Some(format!(
        "in the ground frame the wing tip was {mm} ± {sigma} mm {way} than in the survey (fuel, jacks, sun?): deflections relative \
         to the survey are biased by this amount; repeat the survey in the same state, or set [survey] bend_sigma_m and use \
         deflections relative to the ground frame"
    ))
}

/// Minimum downward component of the vertical for an image to be called upside down: within 60 degrees of 180 degrees.
const UPSIDE_DOWN_COSINE: f64 = 0.5;

/// Returns id and reason of each marker that was not used.
fn unused_markers(installation: &Installation, fit: &OrientationFit) -> Vec<(String, String)> {
    let id = |k: usize| installation.setup.markers.get(k).map_or_else(String::new, |m| m.id.clone());
    fit.unused_markers(&installation.setup).into_iter().map(|(k, reason)| (id(k), reason)).collect()
}

/// Returns the root mean square of the residuals, px, and their number.
fn residual_rms(fit: &OrientationFit) -> (f64, usize) {
    let n = fit.residuals.len();
    let sum: f64 = fit.residuals.iter().map(|(_, _, r)| r.norm_squared()).sum();
    ((sum / n.max(1) as f64).sqrt(), n)
}

fn rotation_sigmas_mrad(fit: &OrientationFit) -> Option<[f64; 3]> {
    fit.orientation.covariance_rad2.map(|c| [0, 1, 2].map(|k| 1e3 * c[(k, k)].max(0.0).sqrt()))
}

fn fit_json(installation: &Installation, fit: &OrientationFit) -> String {
    let m = fit.orientation.camera_from_survey.matrix();
    let rows: Vec<Vec<f64>> = m.row_iter().map(|r| r.iter().copied().collect()).collect();
    let (rms_px, markers) = residual_rms(fit);
    serde_json::json!({
        "status": "ok",
        "file": installation.directory.join(installation::ORIENTATION_FILE),
        "camera_from_survey": rows,
        "sigma_mrad": rotation_sigmas_mrad(fit),
        "variance_factor": fit.variance_factor,
        "redundancy": fit.redundancy,
        "markers": markers,
        "rms_px": rms_px,
        "bend": fit.bend.map(|bend| serde_json::json!({
            "height_m": bend.value,
            "sigma_height_m": bend.sigma,
            "significant": fit.is_bent(),
        })),
        "remarks": orientation_remarks(fit),
        "unused": unused_markers(installation, fit).into_iter().map(|(id, reason)| {
            serde_json::json!({ "id": id, "reason": reason })
        }).collect::<Vec<_>>(),
    })
    .to_string()
}

fn fit_text(installation: &Installation, fit: &OrientationFit) -> String {
    let (rms_px, markers) = residual_rms(fit);
    let file = installation.directory.join(installation::ORIENTATION_FILE);
    let sigma = rotation_sigmas_mrad(fit).map_or(String::new(), |s| {
        format!("\nstandard deviations about camera x, y, z: {:.3}, {:.3}, {:.3} mrad", s[0], s[1], s[2])
    });
    let bend = fit.bend.map_or(String::new(), |bend| {
        let (mm, sigma) = format_rounded(Some(1e3 * bend.value), bend.sigma.map(|s| 1e3 * s), 0);
        let verdict = if fit.is_bent() { "significant" } else { "not significant" };
        format!("\nbending since the survey, at the tip: {mm} ± {sigma} mm, {verdict}")
    });
    let remarks: String = orientation_remarks(fit).iter().map(|remark| format!("\n{remark}")).collect();
    let not_used: String =
        unused_markers(installation, fit).iter().map(|(id, reason)| format!("\nnot used: {id}: {reason}")).collect();
    format!(
        "{}\n{markers} marker images, rms {rms_px:.3} px, variance factor {:.2} at redundancy {}{sigma}{bend}{not_used}{remarks}",
        file.display(),
        fit.variance_factor,
        fit.redundancy
    )
}
