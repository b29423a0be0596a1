//! A set is written with its installation, its frames and their truth (format: `fixtures/dev`).

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use nalgebra::{Rotation3, Vector2};
use serde_json::{Value, json};

use crate::installation;
use crate::measure::raster::Raster;
use crate::measure::render::{FrameTruth, MarkerTruth, Scene, Shot};
use crate::measure::setup::{InFlight, Setup, Side, TorsionPair, Uncertainty};

/// A frame of a set.
pub struct SetFrame {
    /// File name below `frames/`.
    pub image: String,
    /// What to render.
    pub shot: Shot,
    /// JPEG quality, 1 to 100.
    pub quality: u8,
    /// In a flight in time.
    pub time: Option<Moment>,
}

/// Of a flight in time.
pub struct Moment {
    /// Since the flight's first frame, s.
    pub time_s: f64,
    /// How far each mode swings, at the tip, m.
    pub modes_m: Vec<f64>,
}

/// Writes `installation/`, `frames/` and `truth.json` below `directory`: the installation as it is `stated`, with its widths
/// where that is not just what the scene is. `done` is called after every frame.
pub fn write_set(
    directory: &Path,
    name: &str,
    (scene, stated): (&Scene, &Setup),
    frames: &[SetFrame],
    done: impl Fn(),
) -> Result<()> {
    let widths = (stated != &scene.setup).then_some(&stated.uncertainty);
    write_installation(&directory.join("installation"), stated, widths)?;
    let folder = directory.join("frames");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let mut entries = Vec::new();
    for frame in frames {
        let raster = scene.render(&frame.shot).ok_or_else(|| anyhow!("the lens has no pixels"))?;
        write_jpeg(&folder.join(&frame.image), &raster, frame.quality)?;
        entries.push(frame_json(frame, &scene.truth(&frame.shot)));
        done();
    }
    let truth = json!({ "set": name, "frames": entries });
    write_text(&directory.join("truth.json"), &serde_json::to_string_pretty(&truth)?)
}

/// Writes a raster as a grey JPEG.
pub fn write_jpeg(path: &Path, raster: &Raster, quality: u8) -> Result<()> {
    let (width, height) = (u16::try_from(raster.width())?, u16::try_from(raster.height())?);
    // Into memory, as elsewhere: the encoder is compiled for each kind of writer.
    let mut jpeg = vec![];
    jpeg_encoder::Encoder::new(&mut jpeg, quality)
        .encode(raster.luma(), width, height, jpeg_encoder::ColorType::Luma)
        .map_err(anyhow::Error::from)
        .and_then(|()| Ok(fs::write(path, &jpeg)?))
        .with_context(|| format!("cannot write {}", path.display()))
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

fn write_installation(directory: &Path, setup: &Setup, widths: Option<&Uncertainty>) -> Result<()> {
    fs::create_dir_all(directory).with_context(|| format!("cannot make {}", directory.display()))?;
    write_text(&directory.join("installation.toml"), &installation_toml(setup, widths))?;
    let camera = directory.join("camera.toml");
    installation::write_camera(&camera, &setup.lens, None)
        .with_context(|| format!("cannot write {}", camera.display()))?;
    write_text(&directory.join("survey.csv"), &survey_csv(setup))
}

fn installation_toml(setup: &Setup, widths: Option<&Uncertainty>) -> String {
    let c = setup.projection_centre_m;
    let mut text = format!(
        "name = {:?}\n{}\n[camera]\ncalibration = \"camera.toml\"\nprojection_centre_m = [{}, {}, {}]\n\
         projection_centre_sigma_m = {}\nmount_repeatability_px = {:?}\n{}\n[wing]\nsurvey = \"survey.csv\"\n\
         span_direction = [{}, {}]\nroot_offset_m = {}\n{}",
        setup.name,
        widths.map_or(String::new(), survey_widths),
        c.x,
        c.y,
        c.z,
        setup.projection_centre_sigma_m,
        setup.mount_repeatability_px,
        widths.map_or(String::new(), camera_widths),
        setup.span_direction.x,
        setup.span_direction.y,
        setup.root_offset_m,
        widths.map_or(String::new(), wing_widths),
    );
    if let Some(side) = setup.stated_side {
        let _ = writeln!(text, "side = {:?}", if side == Side::Left { "left" } else { "right" });
    }
    if let Some(z) = setup.axis_chord_offset_m {
        let _ = writeln!(text, "axis_chord_offset_m = {z:?}");
    }
    if let Some(skin) = setup.skin_height {
        let _ = writeln!(
            text,
            "skin_height_m = {{ root = {:?}, tip = {:?}, tip_span_m = {:?} }}",
            skin.root_m, skin.tip_m, skin.tip_span_m
        );
        let _ = writeln!(text, "skin_height_sigma_m = {:?}", setup.uncertainty.skin_height_sigma_m);
    }
    if let Some(thermal) = setup.thermal {
        let _ = writeln!(
            text,
            "\n[thermal]\nexpansion_per_k = {:e}\nground_temperature_c = {:?}\nflight_temperature_c = {:?}",
            thermal.expansion_per_k, thermal.ground_temperature_c, thermal.flight_temperature_c
        );
        if let Some(sigma) = thermal.flight_temperature_sigma_k.filter(|_| widths.is_some()) {
            let _ = writeln!(text, "sigma_k = {sigma:?}");
        }
    }
    text.push_str(&torsion_toml(setup));
    text
}

/// Keys of `installation.toml`, each with its value.
fn keys(all: &[(&str, f64)]) -> String {
    all.iter().map(|(key, value)| format!("{key} = {value:?}\n")).collect()
}

fn survey_widths(of: &Uncertainty) -> String {
    let InFlight { ground_bend_m, vertical_rad, .. } = of.in_flight;
    let all = [("bend_sigma_m", ground_bend_m), ("vertical_sigma_deg", vertical_rad.to_degrees())];
    format!("\n[survey]\n{}", keys(&all))
}

fn camera_widths(of: &Uncertainty) -> String {
    keys(&[
        ("mount_shift_m", of.mount_shift_m),
        ("mount_drift_mrad", 1e3 * of.mount_drift_rad),
        ("flight_scale_sigma", of.in_flight.scale),
        ("flight_principal_point_sigma_px", of.in_flight.principal_point_px),
        ("readout_s", of.in_flight.readout_s),
    ])
}

fn wing_widths(of: &Uncertainty) -> String {
    keys(&[
        ("root_offset_sigma_m", of.root_offset_m),
        ("axis_chord_offset_sigma_m", of.axis_chord_offset_m),
        ("span_direction_sigma_deg", of.span_direction_rad.to_degrees()),
        ("skin_motion_m", of.in_flight.skin_motion_m),
        ("root_turn_sigma_mrad", 1e3 * of.in_flight.root_turn_rad),
        ("root_heave_sigma_m", of.in_flight.root_shift_m),
        ("in_plane_sigma_m", of.in_flight.in_plane_m),
        ("torque_sigma_deg", of.in_flight.torque_rad.to_degrees()),
    ])
}

/// The torsion pairs as `installation.toml` has them.
pub fn torsion_toml(setup: &Setup) -> String {
    let id = |i: usize| setup.markers.get(i).map_or("", |marker| marker.id.as_str());
    let pair = |pair: &TorsionPair| {
        format!(
            "\n[[torsion]]\nname = {:?}\nleading = {:?}\ntrailing = {:?}\n",
            pair.name,
            id(pair.leading),
            id(pair.trailing)
        )
    };
    setup.torsion.iter().map(pair).collect()
}

pub fn survey_csv(setup: &Setup) -> String {
    let any_fixed = setup.markers.iter().any(|m| m.fixed);
    let mut text = String::from("id,shape,diameter_m,x_m,y_m,z_m,sigma_m");
    text.push_str(if any_fixed { ",fixed\n" } else { "\n" });
    for marker in &setup.markers {
        let p = marker.position_m;
        let _ = writeln!(
            text,
            "{},{},{},{:.4},{:.4},{:.4},{}{}",
            marker.id,
            marker.shape.name(),
            marker.diameter_m,
            p.x,
            p.y,
            p.z,
            marker.sigma_m,
            if !any_fixed {
                ""
            } else if marker.fixed {
                ",yes"
            } else {
                ",no"
            }
        );
    }
    text
}

fn frame_json(frame: &SetFrame, truth: &FrameTruth) -> Value {
    let mut value = json!({
        "image": frame.image,
        "light": frame.shot.light.name(),
        "tip_lift_m": truth.tip_lift_m,
        "markers": truth.markers.iter().map(marker_json).collect::<Vec<_>>(),
        "camera_from_survey": rows(&truth.camera_from_survey),
        "torsion_deg": truth.torsion_rad.map(f64::to_degrees),
    });
    if let (Some(time), Some(map)) = (&frame.time, value.as_object_mut()) {
        map.insert("time_s".into(), time.time_s.into());
        if !time.modes_m.is_empty() {
            map.insert("modes_m".into(), time.modes_m.clone().into());
        }
    }
    value
}

fn marker_json(marker: &MarkerTruth) -> Value {
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
        "lift_m": marker.lift_m,
    })
}

fn rows(rotation: &Rotation3<f64>) -> Vec<Vec<f64>> {
    rotation.matrix().row_iter().map(|row| row.iter().copied().collect()).collect()
}
