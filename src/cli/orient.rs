//! `wingd orient` finds the camera's attitude from ground frames and writes orientation.toml.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::manual_observations::ByHand;
use super::{Done, Failure, RIGHTS, frames, print, unwritable};
use crate::installation::{self, Installation};
use crate::measure::identify::{self, IdentifyError, OrientationFit};
use crate::measure::setup::Setup;
use crate::pipeline::orienting::{self, GroundFrame};
use crate::record::Reason;
use crate::report::number::rounded;

/// Find the camera's attitude from ground frames and write orientation.toml.
#[derive(clap::Args)]
pub struct Args {
    /// The installation; orientation.toml is written into it [default: installation/ of this folder]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Frames taken on ground with the mounting of the survey
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Markers marked by hand in the frames, as `wingd mark --ground` keeps them (id,u_px,v_px,sigma_px, of several frames
    /// also image): they stand for what is detected of them
    #[arg(long, value_name = "FILE.csv")]
    observations: Option<PathBuf>,
    /// The fit as one JSON object
    #[arg(long)]
    json: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let installation = installation::load_without_orientation(&super::default_paths::installation(
        args.installation.as_deref(),
    )?)?;
    super::say_doubts(&installation);
    let files = super::pictures::expand(&args.images)?;
    let mut frames = Vec::with_capacity(files.len());
    let mut reasons: Vec<String> = vec![];
    let sight = |name: &str, bytes: Result<&[u8], Reason>| {
        bytes.and_then(|b| orienting::sight(name, b, &installation)).map_err(|why| format!("{name}: {why}"))
    };
    frames::each(&files, args.jobs, "detecting", sight, |ground| {
        match ground {
            Ok(frame) => frames.push(frame),
            Err(reason) => reasons.push(reason),
        }
        Ok(())
    })?;
    if !reasons.is_empty() {
        return Err(Failure::Failed(reasons.join("\nwingd: ")));
    }
    let (setup, names) = (&installation.setup, names(&frames));
    if let Some(file) = &args.observations {
        let manual = ByHand::read(file, &files, setup)?;
        frames
            .iter_mut()
            .zip(&names)
            .for_each(|(frame, name)| frame.set_manual_observations(manual.of(name).cloned().collect()));
    }
    let fit = orienting::orient(setup, &mut frames)
        .map_err(|e| Failure::Failed(format!("no orientation: {}", why(setup, &frames, &e, &names))))?;
    let images: Vec<(String, String)> =
        frames.iter().map(|f| (f.sighting.image.clone(), f.sighting.digest.clone())).collect();
    let file = installation.directory.join(installation::ORIENTATION_FILE);
    let written = installation::write_orientation(&installation, &fit, &images);
    written.map_err(unwritable(&file, RIGHTS))?;
    print(&if args.json { json(&installation, &fit) } else { text(&installation, &fit) })?;
    Ok(Done::All)
}

fn names(frames: &[GroundFrame]) -> Vec<String> {
    frames.iter().map(|f| f.sighting.image.clone()).collect()
}

/// A failure with the name of the frame that it is about, and its cause where something tells.
fn why(setup: &Setup, frames: &[GroundFrame], error: &IdentifyError, names: &[String]) -> String {
    let name = |frame: usize| names.get(frame).map_or("a frame", String::as_str);
    match error {
        IdentifyError::Misfit(misfit) => format!("{}: {misfit}", name(misfit.frame)),
        IdentifyError::TooFew { .. } => error.to_string(),
        _ => identify::explain_ground(setup, &orienting::markers(frames))
            .map_or_else(|| error.to_string(), |(frame, cause)| format!("{}: {cause}", name(frame))),
    }
}

/// What a person is to know of an orientation that was found.
fn remarks(fit: &OrientationFit) -> Vec<String> {
    // The image's v points down.
    let up = fit.orientation.camera_from_survey * Vector3::z();
    let on_its_head = up.y > ON_ITS_HEAD;
    let turned = "the picture stands on its head; if the camera did not, turn the pictures back: camera.toml holds for \
                them as the camera took them";
    on_its_head.then(|| turned.to_owned()).into_iter().chain(bent(fit)).collect()
}

/// What a bend since the survey means, where it is no chance.
fn bent(fit: &OrientationFit) -> Option<String> {
    let bend = fit.bend.filter(|_| fit.is_bent())?;
    let (mm, sigma) = rounded(Some(1e3 * bend.value.abs()), bend.sigma.map(|s| 1e3 * s), 0);
    let way = if bend.value > 0.0 { "higher" } else { "lower" };
    Some(format!(
        "the wing stood {mm} ± {sigma} mm {way} at its tip than surveyed (fuel, jacks, sun?): deflections against the survey are \
         off by as much; survey in the state of the ground frames, or state [survey] bend_sigma_m and take the deflections \
         against the ground frame"
    ))
}

/// Share of the vertical that points down in a picture: within 60 degrees of half a turn.
const ON_ITS_HEAD: f64 = 0.5;

/// Markers that were not used: id and reason.
fn unused(installation: &Installation, fit: &OrientationFit) -> Vec<(String, String)> {
    let id = |k: usize| installation.setup.markers.get(k).map_or_else(String::new, |m| m.id.clone());
    fit.unused(&installation.setup).into_iter().map(|(k, reason)| (id(k), reason)).collect()
}

/// Root mean square of the residuals, px, and their number.
fn rms(fit: &OrientationFit) -> (f64, usize) {
    let n = fit.residuals.len();
    let sum: f64 = fit.residuals.iter().map(|(_, _, r)| r.norm_squared()).sum();
    ((sum / n.max(1) as f64).sqrt(), n)
}

fn sigma_mrad(fit: &OrientationFit) -> Option<[f64; 3]> {
    fit.orientation.covariance_rad2.map(|c| [0, 1, 2].map(|k| 1e3 * c[(k, k)].max(0.0).sqrt()))
}

fn json(installation: &Installation, fit: &OrientationFit) -> String {
    let m = fit.orientation.camera_from_survey.matrix();
    let rows: Vec<Vec<f64>> = m.row_iter().map(|r| r.iter().copied().collect()).collect();
    let (rms_px, markers) = rms(fit);
    serde_json::json!({
        "status": "ok",
        "file": installation.directory.join(installation::ORIENTATION_FILE),
        "camera_from_survey": rows,
        "sigma_mrad": sigma_mrad(fit),
        "variance_factor": fit.variance_factor,
        "redundancy": fit.redundancy,
        "markers": markers,
        "rms_px": rms_px,
        "bend": fit.bend.map(|bend| serde_json::json!({
            "height_m": bend.value,
            "sigma_height_m": bend.sigma,
            "significant": fit.is_bent(),
        })),
        "remarks": remarks(fit),
        "unused": unused(installation, fit).into_iter().map(|(id, reason)| {
            serde_json::json!({ "id": id, "reason": reason })
        }).collect::<Vec<_>>(),
    })
    .to_string()
}

fn text(installation: &Installation, fit: &OrientationFit) -> String {
    let (rms_px, markers) = rms(fit);
    let file = installation.directory.join(installation::ORIENTATION_FILE);
    let sigma = sigma_mrad(fit).map_or(String::new(), |s| {
        format!("\nstandard deviations about camera x, y, z: {:.3}, {:.3}, {:.3} mrad", s[0], s[1], s[2])
    });
    let bend = fit.bend.map_or(String::new(), |bend| {
        let (mm, sigma) = rounded(Some(1e3 * bend.value), bend.sigma.map(|s| 1e3 * s), 0);
        let verdict = if fit.is_bent() { "no chance" } else { "not significant" };
        format!("\nhigher at the tip than surveyed, by bending: {mm} ± {sigma} mm, {verdict}")
    });
    let remarks: String = remarks(fit).iter().map(|remark| format!("\n{remark}")).collect();
    let not_used: String =
        unused(installation, fit).iter().map(|(id, reason)| format!("\nnot used: {id}: {reason}")).collect();
    format!(
        "{}\n{markers} marker images, rms {rms_px:.3} px, variance factor {:.2} at redundancy {}{sigma}{bend}{not_used}{remarks}",
        file.display(),
        fit.variance_factor,
        fit.redundancy
    )
}
