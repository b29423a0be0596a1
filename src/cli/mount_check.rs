//! `wingd mount-check` determines whether the camera moved between frames of a static scene.

use std::path::PathBuf;

use nalgebra::Vector3;
use serde_json::json;

use wingd_base::failure::{Completion, TaskResult};
use wingd_base::output::{print_json, print_line};
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::default_paths::resolve_installation;
use wingd_evaluation::inputs::mount_comparison::{MountVerdict, compare_frames, orient_frame};
use wingd_evaluation::installation;
use wingd_evaluation::pipeline::{ProcessedFrame, stages};
use wingd_evaluation::record::Reason;
use wingd_measure::mount::CameraMovement;
use wingd_measure::setup::Setup;
use wingd_measure::setup::Width;

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

pub(super) fn run(args: &MountCheckArgs) -> TaskResult<Completion> {
    let directory = resolve_installation(args.installation.as_deref())?;
    let installation = installation::load_without_orientation(&directory)?;
    let setup = &installation.setup;
    let process = |name: &str, bytes: Result<&[u8], Reason>| {
        let processed = match bytes {
            Ok(bytes) => stages::process_frame(name, bytes, None, setup, None),
            Err(reason) => ProcessedFrame::failed(name, reason),
        };
        orient_frame(setup, &processed)
    };
    let mut found = vec![];
    let files = batch::expand_folders(&args.images)?;
    batch::for_each_image(
        &files,
        args.jobs,
        "detecting",
        process,
        batch::collect_into(&mut found),
    )?;
    let mut found = found.into_iter();
    let Some(first) = found.next().transpose()? else {
        return Ok(Completion::All);
    };
    let mut complete = true;
    for other in found {
        let outcome =
            other.and_then(|other| compare_frames(setup, &first, &other).map(|m| (other.name, m)));
        match outcome {
            Ok((name, movement)) => {
                print_line(&comparison_text(args, setup, &first.name, &name, &movement))?
            }
            Err(reason) => {
                complete = false;
                if args.json {
                    print_json(&json!({ "status": "failed", "reason": reason.text() }))?;
                } else {
                    eprintln!("wingd: {reason}");
                }
            }
        }
    }
    Ok(Completion::from_success(complete))
}

/// Line for a shift of the image that no movement of the camera explains.
const STABILISED: &str = "\nthe image shifted without a rotation of the camera: stabilisation of lens or sensor. Switch it off, or \
    set camera.stabilised_px";

fn comparison_text(
    args: &MountCheckArgs,
    setup: &Setup,
    before: &str,
    after: &str,
    m: &CameraMovement,
) -> String {
    let priors = &setup.uncertainty;
    let (verdict, meaning) = match MountVerdict::new(m, setup) {
        MountVerdict::OneMounting => (
            "one mounting",
            "the camera moved by no more than mount_drift_mrad",
        ),
        MountVerdict::Remounted => (
            "remounted",
            "more than the drift within one mounting (mount_drift_mrad), but within the tolerance between two mountings \
             (mount_repeatability_px, mount_shift_m)",
        ),
        MountVerdict::Moved => (
            "moved",
            "more than the tolerance between two mountings; fasten the camera, or increase mount_repeatability_px and \
             mount_shift_m",
        ),
    };
    if args.json {
        let milli = |v: &Vector3<f64>| [v.x * 1e3, v.y * 1e3, v.z * 1e3];
        return json!({
            "status": "ok", "image": after, "against": before, "verdict": verdict, "markers": m.markers,
            "moved_px": m.moved_px, "mean_px": [m.mean_px.x, m.mean_px.y], "left_px": m.residual_px,
            "stabilised": m.is_image_shift(),
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
    let stabilised = if m.is_image_shift() { STABILISED } else { "" };
    let largest = |v: &Vector3<f64>, s: &Vector3<f64>| v.zip_map(s, f64::hypot).max();
    format!(
        "{after} against {before}: {verdict}: {meaning}\n{} markers moved by {:.3} px rms (mean {:+.3}, {:+.3})\n\
         rotation about camera x, y, z: {} mrad\nshift along camera x, y, z: {} mm\nresiduals: {:.3} px rms{stabilised}\n\
         if this was the same mounting on the ground before and after the flight: stay_turn_mrad = {:.3}, stay_shift_m = {:.5}",
        m.markers,
        m.moved_px,
        m.mean_px.x,
        m.mean_px.y,
        three(&m.rotation_rad, &m.rotation_sigma_rad),
        three(&m.shift_m, &m.shift_sigma_m),
        m.residual_px,
        1e3 * largest(&m.rotation_rad, &m.rotation_sigma_rad),
        largest(&m.shift_m, &m.shift_sigma_m),
    )
}
