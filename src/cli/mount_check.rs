//! `wingd mount-check` determines whether the camera moved between frames of a static scene.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::{Completion, Failure, image_batch, print_line};
use crate::installation::{self, Installation};
use crate::measure::identify;
use crate::measure::mount::{self, CameraMovement, MarkerShift};
use crate::measure::observation::Observation;
use crate::measure::setup::Width;
use crate::pipeline::{ProcessedFrame, stages};
use crate::record::Reason;

/// Measure how far the camera moved between frames of a static scene, and compare it with the installation's expectations
#[derive(clap::Args)]
pub struct MountCheckArgs {
    /// Installation [default: installation/ in this directory]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Ground frames: the reference, and those to compare with it
    #[arg(required = true, num_args = 2.., value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Print one JSON object per frame
    #[arg(long)]
    json: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

/// Maximum ratio of a movement's component to its standard deviation that is expected.
const MAX_NORMALIZED: f64 = 3.0;

/// A frame's marker images, and the surveyed markers in camera coordinates.
struct MountFrame {
    name: String,
    observations: Vec<Observation>,
    points_m: Vec<Vector3<f64>>,
}

pub(super) fn run(args: &MountCheckArgs) -> Result<Completion, Failure> {
    let installation = installation::load_without_orientation(&super::default_paths::resolve_installation(
        args.installation.as_deref(),
    )?)?;
    let processed_frames = image_batch::process_images(
        &super::image_files::expand_folders(&args.images)?,
        args.jobs,
        "detecting",
        |name, bytes| match bytes {
            Ok(bytes) => stages::process_frame(name, bytes, None, &installation.setup, None),
            Err(reason) => ProcessedFrame::failed(name, reason),
        },
    )?;
    let mut found = processed_frames.iter().map(|s| orient_frame(&installation, s));
    let first = found.next().transpose()?;
    let Some(first) = first else { return Ok(Completion::All) };
    let mut complete = true;
    for other in found {
        let outcome = other.and_then(|other| compare_frames(&installation, &first, &other).map(|m| (other.name, m)));
        match outcome {
            Ok((name, movement)) => print_line(&comparison_text(args, &installation, &first.name, &name, &movement))?,
            Err(reason) => {
                complete = false;
                if args.json {
                    print_line(&serde_json::json!({ "status": "failed", "reason": reason.text() }).to_string())?;
                } else {
                    eprintln!("wingd: {reason}");
                }
            }
        }
    }
    Ok(Completion::from_success(complete))
}

fn orient_frame(installation: &Installation, processed: &ProcessedFrame) -> Result<MountFrame, Reason> {
    if let Some(reason) = &processed.failure {
        return Err(reason.clone().with_context(&processed.image));
    }
    let setup = &installation.setup;
    let detections = vec![processed.detections.markers.clone()];
    let fit = identify::estimate_orientation(setup, &detections)
        .map_err(|e| Reason::from_error(e).with_context(&processed.image))?;
    let into_camera = |k: usize| {
        let from_centre = setup.markers[k].position_m - setup.projection_centre_m;
        fit.orientation.camera_from_survey * from_centre
    };
    Ok(MountFrame {
        name: processed.image.clone(),
        observations: fit.ground_observations(setup, &detections),
        points_m: (0..setup.markers.len()).map(into_camera).collect(),
    })
}

fn compare_frames(
    installation: &Installation,
    first: &MountFrame,
    other: &MountFrame,
) -> Result<CameraMovement, Reason> {
    let pair = |before: &Observation| {
        let after = other.observations.iter().find(|s| s.marker == before.marker)?;
        Some(MarkerShift {
            point_m: first.points_m[before.marker],
            moved_px: after.pixel - before.pixel,
            covariance_px2: before.covariance_px2 + after.covariance_px2,
        })
    };
    let pairs: Vec<MarkerShift> = first.observations.iter().filter_map(pair).collect();
    // The prior is so wide that the frames alone determine any real shift.
    mount::estimate_movement(&installation.setup.lens, &pairs, SHIFT_PRIOR_SIGMA_M).ok_or_else(|| {
        let (first, other) = (&first.name, &other.name);
        format!("{first} and {other} have {} markers in common, but 3 are needed", pairs.len()).into()
    })
}

/// Prior standard deviation of the shift between two frames, m: wider than any real one.
const SHIFT_PRIOR_SIGMA_M: f64 = 0.1;

/// Returns whether a movement is consistent with its standard deviation and the expected one.
fn is_within(value: &Vector3<f64>, sigma: &Vector3<f64>, expected: f64) -> bool {
    value.iter().zip(sigma.iter()).all(|(v, s)| v.abs() <= MAX_NORMALIZED * s.hypot(expected))
}

fn comparison_text(
    args: &MountCheckArgs,
    installation: &Installation,
    before: &str,
    after: &str,
    m: &CameraMovement,
) -> String {
    let setup = &installation.setup;
    let priors = &setup.uncertainty;
    let turned = setup.mount_repeatability_px / setup.lens.focal_px();
    let kept = is_within(&m.rotation_rad, &m.rotation_sigma_rad, priors[Width::MountDrift])
        && is_within(&m.shift_m, &m.shift_sigma_m, 0.0);
    let again = is_within(&m.rotation_rad, &m.rotation_sigma_rad, turned)
        && is_within(&m.shift_m, &m.shift_sigma_m, priors[Width::MountShift]);
    let verdict = match (kept, again) {
        (true, _) => "one mounting",
        (false, true) => "remounted",
        _ => "moved",
    };
    if args.json {
        let milli = |v: &Vector3<f64>| [v.x * 1e3, v.y * 1e3, v.z * 1e3];
        return serde_json::json!({
            "status": "ok", "image": after, "against": before, "verdict": verdict, "markers": m.markers,
            "moved_px": m.moved_px, "mean_px": [m.mean_px.x, m.mean_px.y], "left_px": m.residual_px,
            "rotation_mrad": milli(&m.rotation_rad), "sigma_rotation_mrad": milli(&m.rotation_sigma_rad),
            "shift_mm": milli(&m.shift_m), "sigma_shift_mm": milli(&m.shift_sigma_m),
            "expected": {
                "mount_drift_mrad": 1e3 * priors[Width::MountDrift],
                "mount_repeatability_px": setup.mount_repeatability_px,
                "mount_shift_mm": 1e3 * priors[Width::MountShift],
            },
        })
        .to_string();
    }
    let three = |v: &Vector3<f64>, s: &Vector3<f64>| {
        let one = |k: usize| format!("{:+.3} +- {:.3}", 1e3 * v[k], 1e3 * s[k]);
        format!("{}, {}, {}", one(0), one(1), one(2))
    };
    let meaning = match verdict {
        "one mounting" => "the camera moved by no more than mount_drift_mrad",
        "remounted" => {
            "more than the drift within one mounting (mount_drift_mrad), but within the tolerance between two mountings \
             (mount_repeatability_px, mount_shift_m)"
        }
        _ => {
            "more than the tolerance between two mountings; fasten the camera, or increase mount_repeatability_px and \
              mount_shift_m"
        }
    };
    format!(
        "{after} against {before}: {verdict}: {meaning}\n{} markers moved by {:.3} px rms (mean {:+.3}, {:+.3})\n\
         rotation about camera x, y, z: {} mrad\nshift along camera x, y, z: {} mm\nresiduals: {:.3} px rms",
        m.markers,
        m.moved_px,
        m.mean_px.x,
        m.mean_px.y,
        three(&m.rotation_rad, &m.rotation_sigma_rad),
        three(&m.shift_m, &m.shift_sigma_m),
        m.residual_px
    )
}
