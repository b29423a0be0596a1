//! `wingd mount-check` says whether the camera moved between frames of a scene that did not.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::{Done, Failure, frames, print};
use crate::installation::{self, Installation};
use crate::measure::identify;
use crate::measure::mount::{self, Movement, Pair};
use crate::measure::setup::GroundObservation;
use crate::pipeline::{ProcessedFrame, stages};
use crate::record::Reason;

/// How far the camera moved between frames of a scene at rest, against what the installation expects
#[derive(clap::Args)]
pub struct Args {
    /// The installation [default: installation/ of this folder]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Frames taken on ground: the first, and those that are compared with it
    #[arg(required = true, num_args = 2.., value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// One JSON object a frame
    #[arg(long)]
    json: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

/// A movement is expected where no part of it is beyond this many standard deviations.
const EXPECTED: f64 = 3.0;

/// A frame's markers, and where the survey puts them in the camera.
struct Frame {
    name: String,
    sights: Vec<GroundObservation>,
    points_m: Vec<Vector3<f64>>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let installation = installation::load_without_orientation(&super::default_paths::installation(
        args.installation.as_deref(),
    )?)?;
    let sightings = frames::map(
        &super::pictures::expand(&args.images)?,
        args.jobs,
        "detecting",
        |name, bytes| match bytes {
            Ok(bytes) => stages::process_frame(name, bytes, None, &installation, None),
            Err(reason) => ProcessedFrame::failed(name, reason),
        },
    )?;
    let mut found = sightings.iter().map(|s| frame(&installation, s));
    let first = found.next().transpose()?;
    let Some(first) = first else { return Ok(Done::All) };
    let mut whole = true;
    for other in found {
        let outcome =
            other.and_then(|other| compared(&installation, &first, &other).map(|m| (other.name, m)));
        match outcome {
            Ok((name, movement)) => print(&line(args, &installation, &first.name, &name, &movement))?,
            Err(reason) => {
                whole = false;
                if args.json {
                    print(&serde_json::json!({ "status": "failed", "reason": reason.text() }).to_string())?;
                } else {
                    eprintln!("wingd: {reason}");
                }
            }
        }
    }
    Ok(Done::all(whole))
}

fn frame(installation: &Installation, sighting: &ProcessedFrame) -> Result<Frame, Reason> {
    if let Some(reason) = &sighting.failure {
        return Err(reason.clone().about(&sighting.image));
    }
    let setup = &installation.setup;
    let detections = vec![sighting.detections.markers.clone()];
    let fit = identify::orient(setup, &detections).map_err(|e| Reason::of(e).about(&sighting.image))?;
    let into_camera = |k: usize| {
        let from_centre = setup.markers[k].position_m - setup.projection_centre_m;
        fit.orientation.camera_from_survey * from_centre
    };
    Ok(Frame {
        name: sighting.image.clone(),
        sights: stages::ground_sights(setup, &detections, &fit),
        points_m: (0..setup.markers.len()).map(into_camera).collect(),
    })
}

fn compared(installation: &Installation, first: &Frame, other: &Frame) -> Result<Movement, Reason> {
    let pair = |before: &GroundObservation| {
        let after = other.sights.iter().find(|s| s.marker == before.marker)?;
        Some(Pair {
            point_m: first.points_m[before.marker],
            moved_px: after.pixel - before.pixel,
            covariance_px2: before.covariance_px2 + after.covariance_px2,
        })
    };
    let pairs: Vec<Pair> = first.sights.iter().filter_map(pair).collect();
    // A shift of a decimetre is no shift of a mounting: the frames alone decide below it.
    mount::movement(&installation.setup.lens, &pairs, WIDE_SHIFT_M).ok_or_else(|| {
        let (first, other) = (&first.name, &other.name);
        format!("{first} and {other} have {} markers in common, three are needed", pairs.len()).into()
    })
}

/// Beforehand any shift of a mounting is this likely, m.
const WIDE_SHIFT_M: f64 = 0.1;

/// Whether a movement is one of the kind that a standard deviation describes.
fn within(value: &Vector3<f64>, sigma: &Vector3<f64>, expected: f64) -> bool {
    value.iter().zip(sigma.iter()).all(|(v, s)| v.abs() <= EXPECTED * s.hypot(expected))
}

fn line(args: &Args, installation: &Installation, before: &str, after: &str, m: &Movement) -> String {
    let setup = &installation.setup;
    let stated = &setup.uncertainty;
    let turned = setup.mount_repeatability_px / setup.lens.focal_px();
    let kept = within(&m.rotation_rad, &m.rotation_sigma_rad, stated.mount_drift_rad)
        && within(&m.shift_m, &m.shift_sigma_m, 0.0);
    let again = within(&m.rotation_rad, &m.rotation_sigma_rad, turned)
        && within(&m.shift_m, &m.shift_sigma_m, stated.mount_shift_m);
    let verdict = match (kept, again) {
        (true, _) => "one mounting",
        (false, true) => "mounted anew",
        _ => "moved",
    };
    if args.json {
        let milli = |v: &Vector3<f64>| [v.x * 1e3, v.y * 1e3, v.z * 1e3];
        return serde_json::json!({
            "status": "ok", "image": after, "against": before, "verdict": verdict, "markers": m.markers,
            "moved_px": m.moved_px, "mean_px": [m.mean_px.x, m.mean_px.y], "left_px": m.left_px,
            "rotation_mrad": milli(&m.rotation_rad), "sigma_rotation_mrad": milli(&m.rotation_sigma_rad),
            "shift_mm": milli(&m.shift_m), "sigma_shift_mm": milli(&m.shift_sigma_m),
            "expected": {
                "mount_drift_mrad": 1e3 * stated.mount_drift_rad,
                "mount_repeatability_px": setup.mount_repeatability_px,
                "mount_shift_mm": 1e3 * stated.mount_shift_m,
            },
        })
        .to_string();
    }
    let three = |v: &Vector3<f64>, s: &Vector3<f64>| {
        let one = |k: usize| format!("{:+.3} +- {:.3}", 1e3 * v[k], 1e3 * s[k]);
        format!("{}, {}, {}", one(0), one(1), one(2))
    };
    let meaning = match verdict {
        "one mounting" => "the camera kept its place within mount_drift_mrad",
        "mounted anew" => {
            "more than the drift of one mounting, less than mount_repeatability_px and mount_shift_m allow between two"
        }
        _ => "more than the installation expects between two mountings; fasten it, or state what it does",
    };
    format!(
        "{after} against {before}: {verdict}: {meaning}\n{} markers moved by {:.3} px rms ({:+.3}, {:+.3} in the mean)\n\
         rotation about camera x, y, z: {} mrad\nshift along camera x, y, z: {} mm\nleft over: {:.3} px rms",
        m.markers,
        m.moved_px,
        m.mean_px.x,
        m.mean_px.y,
        three(&m.rotation_rad, &m.rotation_sigma_rad),
        three(&m.shift_m, &m.shift_sigma_m),
        m.left_px
    )
}
