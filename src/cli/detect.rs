//! `wingd detect` finds markers in images.

use std::path::{Path, PathBuf};

use nalgebra::Matrix2;
use serde_json::{Map, Value, json};

use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line};
use wingd_evaluation::figures::picture;
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::default_paths::load_installation;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::pipeline::{ProcessedFrame, recording, stages};
use wingd_evaluation::record::Reason;
use wingd_evaluation::results::table;
use wingd_measure::detect::CovarianceSource;
use wingd_measure::detect::{Detection, Rejected};

/// Detect markers in images.
#[derive(clap::Args)]
pub struct DetectArgs {
    /// Images: JPEG, PNG, PNM or TIFF
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Installation: identifies the markers and corrects the perspective bias of circles
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Write each image with outlines, ids and error ellipses to DIR, as SVG
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Print one JSON object per image
    #[arg(long)]
    json: bool,
    /// With --json or --overlay: include the reasons of the rejected candidates
    #[arg(long)]
    rejected: bool,
    /// Show all columns of the tables [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

pub(super) fn run(args: &DetectArgs) -> TaskResult<Completion> {
    let installation = args
        .installation
        .as_deref()
        .map(load_installation)
        .transpose()?;
    if let Some(directory) = &args.overlay {
        let text = |e| {
            format!(
                "{} cannot be created ({e}); name another directory",
                directory.display()
            )
        };
        std::fs::create_dir_all(directory).map_err(|e| Failure::Failed(text(e)))?;
    }
    if installation
        .as_ref()
        .is_some_and(|i| i.orientation.is_none())
    {
        eprintln!(
            "wingd: the installation has no orientation.toml, so markers have no ids; run `wingd orient` first"
        );
    }
    let mut all_well = true;
    let work = |name: &str, bytes: Result<&[u8], Reason>| match bytes {
        // Without overlay and rejected candidates, the guided search is enough.
        Ok(bytes) => match &installation {
            Some(installation) if args.overlay.is_none() && !args.rejected => {
                stages::process_frame(
                    name,
                    bytes,
                    None,
                    &installation.setup,
                    installation.orientation.as_ref(),
                )
            }
            _ => process_image(args, name, bytes, installation.as_ref()),
        },
        Err(reason) => ProcessedFrame::failed(name, reason),
    };
    batch::for_each_image(
        &batch::expand_folders(&args.images)?,
        args.jobs,
        "detecting",
        work,
        |processed| {
            all_well &= processed.failure.is_none();
            match args.json {
                true => print_json(&result_json(
                    &processed,
                    installation.as_ref(),
                    args.rejected,
                )),
                false => print_line(&result_text(&processed, installation.as_ref(), args.wide)),
            }
        },
    )?;
    Ok(Completion::from_success(all_well))
}

fn process_image(
    args: &DetectArgs,
    name: &str,
    bytes: &[u8],
    installation: Option<&Installation>,
) -> ProcessedFrame {
    let (mut processed, raster) = match installation {
        Some(known) => {
            stages::process_full_frame(name, bytes, None, &known.setup, known.orientation.as_ref())
        }
        None => stages::detect_only(name, bytes, None),
    };
    if let (Some(raster), Some(directory)) = (&raster, &args.overlay) {
        let ids = marker_ids(&processed, installation);
        let drawn = picture::overlay_svg(raster, &processed.detections, &ids, args.rejected);
        let written = match drawn {
            Some(drawn) => write_overlay(&drawn, directory, &processed.image),
            None => Err("the image is too large for an overlay; omit --overlay".into()),
        };
        processed.failure = processed.failure.or(written.err());
    }
    processed
}

fn write_overlay(drawn: &str, directory: &Path, image: &str) -> Result<(), Reason> {
    // Names of images from several folders contain their folder.
    let name = image.trim_start_matches('/').replace('/', "_");
    let file = directory.join(Path::new(&name).with_extension("svg"));
    let text = |e: &std::io::Error| {
        format!(
            "{} cannot be written ({e}); free space, or name another DIR",
            file.display()
        )
    };
    std::fs::write(&file, drawn).map_err(|e| Reason::new(text(&e), e))
}

/// Returns the survey id of each detection.
fn marker_ids(
    processed: &ProcessedFrame,
    installation: Option<&Installation>,
) -> Vec<Option<String>> {
    let id = |k: usize| -> Option<String> {
        let marker = *processed.identities.as_ref()?.marker_of.get(k)?;
        Some(installation?.setup.markers.get(marker?)?.id.clone())
    };
    (0..processed.detections.markers.len()).map(id).collect()
}

/// Selects the detections to list: if markers were identified, only those with an id.
fn listed_detections(
    processed: &ProcessedFrame,
    installation: Option<&Installation>,
) -> Vec<(Option<String>, Detection)> {
    let all = marker_ids(processed, installation)
        .into_iter()
        .zip(processed.detections.markers.iter().cloned());
    all.filter(|(id, _)| id.is_some() || processed.identities.is_none())
        .collect()
}

fn result_text(
    processed: &ProcessedFrame,
    installation: Option<&Installation>,
    wide: bool,
) -> String {
    match &processed.failure {
        Some(reason) => format!("{}: failed: {reason}\n", processed.image),
        None => table::detections_text(
            &processed.image,
            &processed.detections,
            &marker_ids(processed, installation),
            wide,
        ),
    }
}

fn result_json(
    processed: &ProcessedFrame,
    installation: Option<&Installation>,
    with_rejected: bool,
) -> Value {
    let mut line = Map::new();
    line.insert("image".into(), processed.image.clone().into());
    line.insert(
        "status".into(),
        if processed.failure.is_none() {
            "ok"
        } else {
            "failed"
        }
        .into(),
    );
    if let Some(reason) = &processed.failure {
        line.insert("reason".into(), reason.text().into());
    }
    line.insert("width".into(), json!(processed.size.map(|s| s.0)));
    line.insert("height".into(), json!(processed.size.map(|s| s.1)));
    let markers = listed_detections(processed, installation);
    line.insert(
        "markers".into(),
        markers
            .iter()
            .map(|(id, d)| marker_json(id.as_deref(), d))
            .collect(),
    );
    if let Some(seen) = processed.detections.overshoot {
        line.insert(
            "overshoot".into(),
            json!({ "amplitude": seen.amplitude, "halo_px": seen.halo_px }),
        );
    }
    let missing = missing_markers_json(processed, installation);
    if !missing.is_empty() {
        line.insert("missing".into(), missing.into());
    }
    if with_rejected {
        line.insert(
            "rejected".into(),
            processed
                .detections
                .rejected
                .iter()
                .map(rejected_candidate_json)
                .collect(),
        );
    }
    line.insert(
        "timing_ms".into(),
        json!(recording::stage_timing(&processed.stages)),
    );
    line.into()
}

fn marker_json(id: Option<&str>, d: &Detection) -> Value {
    json!({
        "shape": d.shape.name(),
        "id": id,
        "u_px": d.centre_px.x,
        "v_px": d.centre_px.y,
        "sigma_u_px": d.covariance_px2[(0, 0)].max(0.0).sqrt(),
        "sigma_v_px": d.covariance_px2[(1, 1)].max(0.0).sqrt(),
        "sigma_contributions": contributions_json(d),
        "semi_major_px": d.semi_major_px,
        "semi_minor_px": d.semi_minor_px,
        "angle_deg": d.angle_rad.to_degrees(),
    })
}

/// Error sources of a centre: standard deviation due to each. Their squares add up to the variance.
fn contributions_json(d: &Detection) -> Value {
    let one = |(source, own): (CovarianceSource, &Matrix2<f64>)| {
        let [sigma_u_px, sigma_v_px] = [0, 1].map(|k| own[(k, k)].max(0.0).sqrt());
        json!({ "source": source, "sigma_u_px": sigma_u_px, "sigma_v_px": sigma_v_px })
    };
    d.covariance_px2.contributions().map(one).collect()
}

fn rejected_candidate_json(r: &Rejected) -> Value {
    json!({
        "u_px": r.centre_px.x,
        "v_px": r.centre_px.y,
        "semi_major_px": r.semi_major_px,
        "semi_minor_px": r.semi_minor_px,
        "angle_deg": r.angle_rad.to_degrees(),
        "reason": r.reason.text(),
    })
}

fn missing_markers_json(
    processed: &ProcessedFrame,
    installation: Option<&Installation>,
) -> Vec<Value> {
    let missing = processed.identities.iter().flat_map(|i| &i.missing);
    let id = |k: usize| {
        installation
            .and_then(|i| i.setup.markers.get(k))
            .map(|m| m.id.clone())
    };
    missing
        .map(|(k, reason)| json!({ "id": id(*k), "reason": reason }))
        .collect()
}
