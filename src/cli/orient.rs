//! `wingd orient` estimates the camera's attitude from ground frames and writes orientation.toml.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use wingd_base::failure::CHECK_WRITE_ACCESS;
use wingd_base::failure::{Completion, Failure};
use wingd_base::output::{print_line, print_notes};
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::default_paths::{load_without_orientation, resolve_installation};
use wingd_evaluation::inputs::manual_points::ManualPoints;
use wingd_evaluation::installation;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::number::format_rounded;
use wingd_evaluation::pipeline::orienting;
use wingd_evaluation::pipeline::orienting::GroundFrame;
use wingd_evaluation::record::Reason;
use wingd_measure::estimation::GlobalTest;
use wingd_measure::identify;
use wingd_measure::identify::OTHER_AIRCRAFT;
use wingd_measure::identify::{IdentifyError, OrientationFit};
use wingd_measure::setup::Setup;

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
    /// Write an orientation that its test refuses, marked with this reason
    #[arg(long, value_name = "REASON")]
    accept: Option<String>,
    /// Print the fit as one JSON object
    #[arg(long)]
    json: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

pub(super) fn run(args: &OrientArgs) -> Result<Completion, Failure> {
    let installation =
        load_without_orientation(&resolve_installation(args.installation.as_deref())?)?;
    let mut frames = read_frames(
        &args.images,
        args.observations.as_deref(),
        args.jobs,
        &installation,
    )?;
    let setup = &installation.setup;
    let mut fit = orienting::orient_frames(setup, &mut frames).map_err(|e| {
        Failure::Failed(format!(
            "no orientation: {}",
            failure_text(setup, &frames, &e)
        ))
    })?;
    let detected = orienting::detected_markers(&frames);
    let mut refusal = fit.refusal(setup);
    let found = match refusal {
        Some(_) => identify::diagnose_ground(setup, &detected),
        None => identify::diagnose_ground_fit(setup, &detected, &fit),
    };
    let is_bent = found
        .as_ref()
        .map_or(fit.is_bent(), |found| found.is_bent_on_ground(setup));
    // The diagnosis allows for the calibration's covariance and `bend_sigma_m`.
    let fits = found
        .as_ref()
        .is_some_and(|found| found.global_test == Some(GlobalTest::Passed));
    let wrong = found.as_ref().and_then(|found| found.wrong_marker());
    let cause = found.and_then(|found| found.text()).filter(|_| !is_bent);
    refusal = refusal.filter(|_| !is_bent && !fits).map(|refusal| {
        let why = cause
            .as_deref()
            .unwrap_or("no single cause explains it; check survey, lens and frame");
        format!("{refusal}: {why}")
    });
    let refusal = axes_refusal(setup, &fit).or(refusal);
    if let (Some(refusal), None) = (&refusal, &args.accept) {
        return Err(Failure::Failed(format!(
            "no orientation: {refusal}; --accept \"REASON\" writes it nevertheless"
        )));
    }
    let images: Vec<(String, String)> = frames
        .iter()
        .map(|f| (f.processed.image.clone(), f.processed.digest.clone()))
        .collect();
    let file = installation.directory.join(installation::ORIENTATION_FILE);
    let accepted = refusal.as_ref().and(args.accept.as_deref());
    let written = installation::write_orientation(&installation, &fit, &images, accepted);
    written.map_err(|error| Failure::from_write_error(&file, &error, CHECK_WRITE_ACCESS))?;
    let cause =
        cause.filter(|cause| !wrong.is_some_and(|marker| fit.explain_unused(marker, cause)));
    let remarks = orientation_remarks(&fit, refusal, cause);
    print_line(&if args.json {
        fit_json(&installation, &fit, &remarks)
    } else {
        fit_text(&installation, &fit, &remarks)
    })?;
    Ok(Completion::All)
}

/// Detects the markers of ground frames and adds manual marks.
pub(super) fn read_frames(
    images: &[PathBuf],
    observations: Option<&Path>,
    jobs: usize,
    installation: &Installation,
) -> Result<Vec<GroundFrame>, Failure> {
    let files = batch::expand_folders(images)?;
    let mut frames = Vec::with_capacity(files.len());
    let mut reasons: Vec<String> = vec![];
    let process = |name: &str, bytes: Result<&[u8], Reason>| {
        bytes
            .and_then(|b| orienting::process_ground_frame(name, b, &installation.setup))
            .map_err(|why| format!("{name}: {why}"))
    };
    batch::for_each_image(&files, jobs, "detecting", process, |ground| {
        match ground {
            Ok(frame) => frames.push(frame),
            Err(reason) => reasons.push(reason),
        }
        Ok(())
    })?;
    if !reasons.is_empty() {
        return Err(Failure::Failed(reasons.join("\nwingd: ")));
    }
    if let Some(file) = observations {
        let manual = ManualPoints::read(file, &files, &installation.setup)?;
        print_notes(&manual.note);
        for frame in &mut frames {
            let of_frame = manual.for_image(&frame.processed.image).cloned().collect();
            frame.set_manual_observations(of_frame);
        }
    }
    Ok(frames)
}

/// Describes a failure with the frame concerned, and its cause if it can be diagnosed.
fn failure_text(setup: &Setup, frames: &[GroundFrame], error: &IdentifyError) -> String {
    let name = |frame: usize| {
        frames
            .get(frame)
            .map_or("a frame", |f| f.processed.image.as_str())
    };
    match error {
        IdentifyError::Misfit(misfit) => format!("{}: {misfit}", name(misfit.frame)),
        error if error.names_cause() => error.to_string(),
        _ => {
            let found = identify::diagnose_ground(setup, &orienting::detected_markers(frames));
            let unexplained = || match error {
                IdentifyError::NoConsensus { .. } => format!("{error}: {OTHER_AIRCRAFT}"),
                _ => error.to_string(),
            };
            let text = found
                .and_then(|found| found.text())
                .unwrap_or_else(unexplained);
            let names: Vec<&str> = frames
                .iter()
                .map(|frame| frame.processed.image.as_str())
                .collect();
            format!("{}: {text}", names.join(", "))
        }
    }
}

/// Returns why a camera upside down below the wing is refused.
fn axes_refusal(setup: &Setup, fit: &OrientationFit) -> Option<String> {
    (is_upside_down(fit) && setup.is_lens_below_wing()).then(|| {
        "the camera is upside down and below the wing: z of survey.csv and camera.projection_centre_m points down (body \
         axes; give y and z the opposite sign), or the image of a high wing was rotated by 180 degrees"
            .into()
    })
}

fn is_upside_down(fit: &OrientationFit) -> bool {
    // Image axis v points down.
    (fit.orientation.camera_from_survey * Vector3::z()).y > UPSIDE_DOWN_COSINE
}

/// Returns remarks on an accepted refusal, an image taken upside down, and the diagnosis or a bend since the survey.
fn orientation_remarks(
    fit: &OrientationFit,
    refusal: Option<String>,
    cause: Option<String>,
) -> Vec<String> {
    let turned = "the image is upside down; unless the camera was, rotate the images back: camera.toml is valid only for images as \
                the camera took them";
    let accepted = refusal.map(|refusal| format!("accepted although {refusal}"));
    let found = if accepted.is_some() {
        None
    } else {
        cause.or_else(|| bend_remark(fit))
    };
    accepted
        .into_iter()
        .chain(is_upside_down(fit).then(|| turned.to_owned()))
        .chain(found)
        .collect()
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
    let id = |k: usize| {
        installation
            .setup
            .markers
            .get(k)
            .map_or_else(String::new, |m| m.id.clone())
    };
    fit.unused_markers(&installation.setup)
        .into_iter()
        .map(|(k, reason)| (id(k), reason))
        .collect()
}

/// Returns the root mean square of the residuals, px, and their number.
fn residual_rms(fit: &OrientationFit) -> (f64, usize) {
    let n = fit.residuals.len();
    let sum: f64 = fit.residuals.iter().map(|(_, _, r)| r.norm_squared()).sum();
    ((sum / n.max(1) as f64).sqrt(), n)
}

fn rotation_sigmas_mrad(fit: &OrientationFit) -> Option<[f64; 3]> {
    fit.orientation
        .covariance_rad2
        .map(|c| [0, 1, 2].map(|k| 1e3 * c[(k, k)].max(0.0).sqrt()))
}

fn fit_json(installation: &Installation, fit: &OrientationFit, remarks: &[String]) -> String {
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
        "remarks": remarks,
        "unused": unused_markers(installation, fit).into_iter().map(|(id, reason)| {
            serde_json::json!({ "id": id, "reason": reason })
        }).collect::<Vec<_>>(),
    })
    .to_string()
}

fn fit_text(installation: &Installation, fit: &OrientationFit, remarks: &[String]) -> String {
    let (rms_px, markers) = residual_rms(fit);
    let file = installation.directory.join(installation::ORIENTATION_FILE);
    let sigma = rotation_sigmas_mrad(fit).map_or(String::new(), |s| {
        format!(
            "\nstandard deviations about camera x, y, z: {:.3}, {:.3}, {:.3} mrad",
            s[0], s[1], s[2]
        )
    });
    let bend = fit.bend.map_or(String::new(), |bend| {
        let (mm, sigma) = format_rounded(Some(1e3 * bend.value), bend.sigma.map(|s| 1e3 * s), 0);
        let verdict = if fit.is_bent() {
            "significant"
        } else {
            "not significant"
        };
        format!("\nbending since the survey, at the tip: {mm} ± {sigma} mm, {verdict}")
    });
    let remarks: String = remarks.iter().map(|remark| format!("\n{remark}")).collect();
    let not_used: String = unused_markers(installation, fit)
        .iter()
        .map(|(id, reason)| format!("\nnot used: {id}: {reason}"))
        .collect();
    format!(
        "{}\n{markers} marker images, rms {rms_px:.3} px, variance factor {:.2} at redundancy {}{sigma}{bend}{not_used}{remarks}",
        file.display(),
        fit.variance_factor,
        fit.redundancy
    )
}
