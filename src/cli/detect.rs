//! `wingd detect` finds markers in images.

use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use nalgebra::Matrix2;
use serde_json::{Map, Value, json};

use super::{Done, Failure, frames, print};
use crate::installation::Installation;
use crate::measure::detect::{Detection, Rejected, Source};
use crate::measure::raster::Raster;
use crate::pipeline::{ProcessedFrame, recording, stages};
use crate::record::Reason;
use crate::report::{overlay, table};

/// Markers in images.
#[derive(clap::Args)]
pub struct Args {
    /// Frames: JPEG, PNG, PNM or TIFF
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Names the markers and removes the circles' perspective bias
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Write each frame with outlines, ids and error ellipses to DIR, as a picture at most 2000 px wide
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// One JSON object per image
    #[arg(long)]
    json: bool,
    /// With --json or --overlay: also the candidates that were turned down, and why
    #[arg(long)]
    rejected: bool,
    /// Every column of the tables, however wide [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let installation = args.installation.as_deref().map(super::load_installation).transpose()?;
    if let Some(directory) = &args.overlay {
        std::fs::create_dir_all(directory).map_err(|e| {
            Failure::Failed(format!("{} cannot be made ({e}); name another", directory.display()))
        })?;
    }
    let overlay = args.overlay.as_deref().map(|directory| Overlay { directory, rejected: args.rejected });
    if installation.as_ref().is_some_and(|i| i.orientation.is_none()) {
        eprintln!(
            "wingd: the installation has no orientation.toml: markers stay without ids; run `wingd orient` first"
        );
    }
    let mut all_well = true;
    let work = |name: &str, bytes: Result<&[u8], Reason>| match bytes {
        // Where only the markers are wanted, only they are sought.
        Ok(bytes) => match &installation {
            Some(installation) if overlay.is_none() && !args.rejected => {
                stages::process_frame(name, bytes, None, installation, installation.orientation.as_ref())
            }
            _ => detect(name, bytes, installation.as_ref(), overlay.as_ref()),
        },
        Err(reason) => ProcessedFrame::failed(name, reason),
    };
    frames::each(&super::pictures::expand(&args.images)?, args.jobs, "detecting", work, |sighting| {
        all_well &= sighting.failure.is_none();
        print(&if args.json {
            json_line(&sighting, installation.as_ref(), args.rejected).to_string()
        } else {
            text(&sighting, installation.as_ref(), args.wide)
        })
    })?;
    Ok(Done::all(all_well))
}

/// Pictures of what was found.
struct Overlay<'a> {
    directory: &'a Path,
    /// With the candidates that were turned down.
    rejected: bool,
}

fn detect(
    name: &str,
    bytes: &[u8],
    installation: Option<&Installation>,
    overlay: Option<&Overlay>,
) -> ProcessedFrame {
    let (mut sighting, raster) = match installation {
        Some(known) => stages::process_full_frame(name, bytes, None, known, known.orientation.as_ref()),
        None => stages::detect_only(name, bytes, None),
    };
    if let (Some(raster), Some(overlay)) = (&raster, overlay) {
        let written = draw(raster, &sighting, installation, overlay);
        sighting.failure = sighting.failure.or(written.err());
    }
    sighting
}

fn draw(
    raster: &Raster,
    sighting: &ProcessedFrame,
    installation: Option<&Installation>,
    Overlay { directory, rejected }: &Overlay,
) -> Result<(), Reason> {
    let picture = overlay::overlay(raster, &sighting.detections, &ids(sighting, installation), *rejected);
    // Several folders' frames have their folder in their names.
    let name = sighting.image.trim_start_matches('/').replace('/', "_");
    let file = directory.join(Path::new(&name).with_extension("png"));
    let mut png = vec![];
    let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive);
    let drawn = picture.write_with_encoder(encoder);
    let written = drawn.and_then(|()| Ok(std::fs::write(&file, png)?));
    let text = |e: &image::ImageError| {
        format!("{} cannot be written ({e}); free space or name another DIR", file.display())
    };
    written.map_err(|e| Reason::new(text(&e), e))
}

/// Per detection: the survey's id.
fn ids(sighting: &ProcessedFrame, installation: Option<&Installation>) -> Vec<Option<String>> {
    let id = |k: usize| -> Option<String> {
        let marker = *sighting.identities.as_ref()?.marker_of.get(k)?;
        Some(installation?.setup.markers.get(marker?)?.id.clone())
    };
    (0..sighting.detections.markers.len()).map(id).collect()
}

/// The detections to list: with identities only those that are known, false ones cost nothing.
fn named(sighting: &ProcessedFrame, installation: Option<&Installation>) -> Vec<(Option<String>, Detection)> {
    let all = ids(sighting, installation).into_iter().zip(sighting.detections.markers.iter().cloned());
    all.filter(|(id, _)| id.is_some() || sighting.identities.is_none()).collect()
}

fn text(sighting: &ProcessedFrame, installation: Option<&Installation>, wide: bool) -> String {
    match &sighting.failure {
        Some(reason) => format!("{}: failed: {reason}\n", sighting.image),
        None => table::detections(&sighting.image, &sighting.detections, &ids(sighting, installation), wide),
    }
}

fn json_line(sighting: &ProcessedFrame, installation: Option<&Installation>, with_rejected: bool) -> Value {
    let mut line = Map::new();
    line.insert("image".into(), sighting.image.clone().into());
    line.insert("status".into(), if sighting.failure.is_none() { "ok" } else { "failed" }.into());
    if let Some(reason) = &sighting.failure {
        line.insert("reason".into(), reason.text().into());
    }
    line.insert("width".into(), json!(sighting.size.map(|s| s.0)));
    line.insert("height".into(), json!(sighting.size.map(|s| s.1)));
    let markers = named(sighting, installation);
    line.insert("markers".into(), markers.iter().map(|(id, d)| marker(id.as_deref(), d)).collect());
    if let Some(seen) = sighting.detections.overshoot {
        line.insert("overshoot".into(), json!({ "amplitude": seen.amplitude, "halo_px": seen.halo_px }));
    }
    let missing = missing(sighting, installation);
    if !missing.is_empty() {
        line.insert("missing".into(), missing.into());
    }
    if with_rejected {
        line.insert("rejected".into(), sighting.detections.rejected.iter().map(rejected).collect());
    }
    line.insert("timing_ms".into(), json!(recording::timing(&sighting.stages)));
    line.into()
}

fn marker(id: Option<&str>, d: &Detection) -> Value {
    json!({
        "shape": d.shape.name(),
        "id": id,
        "u_px": d.centre_px.x,
        "v_px": d.centre_px.y,
        "sigma_u_px": d.covariance_px2[(0, 0)].max(0.0).sqrt(),
        "sigma_v_px": d.covariance_px2[(1, 1)].max(0.0).sqrt(),
        "sigma_contributions": contributions(d),
        "semi_major_px": d.semi_major_px,
        "semi_minor_px": d.semi_minor_px,
        "angle_deg": d.angle_rad.to_degrees(),
    })
}

/// Why the standard deviations are as large as they are: the roots of the variances that they are the roots of the sums of.
fn contributions(d: &Detection) -> Value {
    let one = |(source, own): (Source, &Matrix2<f64>)| {
        let [sigma_u_px, sigma_v_px] = [0, 1].map(|k| own[(k, k)].max(0.0).sqrt());
        json!({ "source": source, "sigma_u_px": sigma_u_px, "sigma_v_px": sigma_v_px })
    };
    d.covariance_px2.contributions().map(one).collect()
}

fn rejected(r: &Rejected) -> Value {
    json!({
        "u_px": r.centre_px.x,
        "v_px": r.centre_px.y,
        "semi_major_px": r.semi_major_px,
        "semi_minor_px": r.semi_minor_px,
        "angle_deg": r.angle_rad.to_degrees(),
        "reason": r.reason.text(),
    })
}

fn missing(sighting: &ProcessedFrame, installation: Option<&Installation>) -> Vec<Value> {
    let missing = sighting.identities.iter().flat_map(|i| &i.missing);
    let id = |k: usize| installation.and_then(|i| i.setup.markers.get(k)).map(|m| m.id.clone());
    missing.map(|(k, reason)| json!({ "id": id(*k), "reason": reason })).collect()
}
