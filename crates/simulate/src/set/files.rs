//! Writer of an image set: installation, frames and truth (format: `fixtures/dev`).

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use nalgebra::{Matrix2, Rotation3, Vector2};
use serde_json::{Value, json};

use super::SetFrame;
use crate::render::Scene;
use crate::render::SeededRandom;
use crate::render::{FrameTruth, MarkerTruth};
use wingd_evaluation::installation;
use wingd_evaluation::installation::{ManualObservation, ManualPosition, POINT_SIGMA_PX};
use wingd_measure::raster::Raster;
use wingd_measure::setup::{Setup, Shape};

/// Writes `installation/`, `frames/` and `truth.json` below `directory`, with the installation as in `specified`, and
/// returns the number of frames. After each frame `go_on` says whether another one follows.
pub fn write_set(
    directory: &Path,
    name: &str,
    (scene, specified): (&Scene, &Setup),
    frames: &[SetFrame],
    go_on: impl Fn() -> bool,
) -> Result<usize> {
    installation::write_installation(&directory.join("installation"), specified, None, [""; 2])
        .map_err(|(file, error)| anyhow!("cannot write {}: {error}", file.display()))?;
    let folder = directory.join("frames");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let mut entries = Vec::new();
    for frame in frames {
        let raster = scene
            .render(&frame.shot)
            .ok_or_else(|| anyhow!("the lens has no pixels"))?;
        write_jpeg(&folder.join(&frame.image), &raster, frame.quality)?;
        entries.push(frame_truth_json(frame, &scene.truth(&frame.shot)));
        if !go_on() {
            break;
        }
    }
    if let Some(ground) = frames.first() {
        write_point_marks(&folder, specified, ground, &scene.truth(&ground.shot))?;
    }
    let count = entries.len();
    let truth = json!({ "set": name, "frames": entries });
    let file = directory.join("truth.json");
    fs::write(&file, serde_json::to_string_pretty(&truth)?)
        .with_context(|| format!("cannot write {}", file.display()))?;
    Ok(count)
}

/// Writes `marks.csv`: the places of the points in the ground frame, with the error of a person who marks them; nothing
/// if there are none.
fn write_point_marks(
    folder: &Path,
    setup: &Setup,
    frame: &SetFrame,
    truth: &FrameTruth,
) -> Result<()> {
    let mut random = SeededRandom::new(frame.shot.seed, 31);
    let mark = |(marker, truth): (usize, &MarkerTruth)| {
        let error = Vector2::from_fn(|_, _| POINT_SIGMA_PX * random.normal());
        let pixel = truth
            .pixel
            .filter(|_| truth.shape == Shape::Point && truth.visible)?
            + error;
        let covariance_px2 = Matrix2::identity() * POINT_SIGMA_PX.powi(2);
        let place = Some(ManualPosition {
            pixel,
            covariance_px2,
        });
        Some(ManualObservation {
            image: None,
            marker,
            place,
            note: Default::default(),
        })
    };
    let marks: Vec<ManualObservation> = truth.markers.iter().enumerate().filter_map(mark).collect();
    if marks.is_empty() {
        return Ok(());
    }
    let file = folder.join("marks.csv");
    let text = installation::observations_text(&marks, setup)?;
    fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))
}

/// Writes a raster as a grey JPEG.
pub fn write_jpeg(path: &Path, raster: &Raster, quality: u8) -> Result<()> {
    let (width, height) = (
        u16::try_from(raster.width())?,
        u16::try_from(raster.height())?,
    );
    // Into memory, as elsewhere: the encoder is compiled for each kind of writer.
    let mut jpeg = vec![];
    let mut encoder = jpeg_encoder::Encoder::new(&mut jpeg, quality);
    // A third less than with the usual tables, and the same picture.
    encoder.set_optimized_huffman_tables(true);
    encoder
        .encode(raster.luma(), width, height, jpeg_encoder::ColorType::Luma)
        .map_err(anyhow::Error::from)
        .and_then(|()| Ok(fs::write(path, &jpeg)?))
        .with_context(|| format!("cannot write {}", path.display()))
}

fn frame_truth_json(frame: &SetFrame, truth: &FrameTruth) -> Value {
    let mut value = json!({
        "image": frame.image,
        "light": frame.shot.light.name(),
        "tip_deflection_m": truth.tip_deflection_m,
        "markers": truth.markers.iter().map(marker_truth_json).collect::<Vec<_>>(),
        "camera_from_survey": matrix_rows(&truth.camera_from_survey),
        "torsion_deg": truth.torsion_rad.map(f64::to_degrees),
    });
    if let (Some(time), Some(map)) = (&frame.moment, value.as_object_mut()) {
        map.insert("time_s".into(), time.time_s.into());
        if !time.modes_m.is_empty() {
            map.insert("modes_m".into(), time.modes_m.clone().into());
        }
    }
    value
}

fn marker_truth_json(marker: &MarkerTruth) -> Value {
    let pixel = |axis: fn(&Vector2<f64>) -> f64| marker.pixel.as_ref().map(axis);
    json!({
        "id": marker.id,
        "shape": marker.shape.name(),
        "u": pixel(|p| p.x),
        "v": pixel(|p| p.y),
        "width": marker.size_px.x,
        "height": marker.size_px.y,
        "visible": marker.visible,
        "position_m": marker.position_m.as_slice(),
        "deflection_m": marker.deflection_m,
    })
}

fn matrix_rows(rotation: &Rotation3<f64>) -> Vec<Vec<f64>> {
    rotation
        .matrix()
        .row_iter()
        .map(|row| row.iter().copied().collect())
        .collect()
}
