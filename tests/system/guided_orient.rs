//! Promise: `wingd orient` uses every marker that its own orientation finds, and excludes no correct survey point.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Vector2};
use serde_json::Value;

use crate::program::{fixture, stdout};

#[test]
fn every_visible_marker_of_the_ground_frame_is_used_and_consistent_with_its_sigma() {
    let directory = tempfile::tempdir().unwrap();
    for name in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            directory.path().join(name),
        )
        .unwrap();
    }
    let path = directory.path().to_str().unwrap();
    let frame = fixture("dev/frames/ground.jpg");
    let printed: Value = serde_json::from_str(&stdout(&[
        "orient",
        "--json",
        "--installation",
        path,
        frame.to_str().unwrap(),
    ]))
    .unwrap();
    assert_eq!(
        printed["unused"].as_array().unwrap().len(),
        0,
        "{}",
        printed["unused"]
    );
    let truth: Value =
        serde_json::from_str(&std::fs::read_to_string(fixture("dev/truth.json")).unwrap()).unwrap();
    let frames = truth["frames"].as_array().unwrap();
    let ground = frames.iter().find(|f| f["image"] == "ground.jpg").unwrap();
    let places: BTreeMap<&str, Vector2<f64>> = ground["markers"]
        .as_array()
        .unwrap()
        .iter()
        .map(|m| {
            (
                m["id"].as_str().unwrap(),
                Vector2::new(m["u"].as_f64().unwrap(), m["v"].as_f64().unwrap()),
            )
        })
        .collect();
    let installation = wingd::installation::load(directory.path()).unwrap();
    let orientation = installation.orientation.as_ref().unwrap();
    assert_eq!(orientation.ground.len(), places.len());
    let mut squares = 0.0;
    for sight in &orientation.ground {
        let off = sight.pixel - places[installation.setup.markers[sight.marker].id.as_str()];
        let weight: Matrix2<f64> = sight.covariance_px2.try_inverse().unwrap();
        squares += off.dot(&(weight * off));
    }
    let normalised = (0.5 * squares / orientation.ground.len() as f64).sqrt();
    println!("normalised {normalised:.3}");
    // 42 coordinates of one frame: the root mean square of independent values is known to 11 %.
    assert!(normalised < 1.0 + 3.0 * 0.11, "{normalised}");
    // Residuals are observed - computed.
    let table: toml::Table = std::fs::read_to_string(directory.path().join("orientation.toml"))
        .unwrap()
        .parse()
        .unwrap();
    for row in table["image"][0]["residuals"].as_array().unwrap() {
        let k = installation
            .setup
            .markers
            .iter()
            .position(|m| Some(m.id.as_str()) == row["id"].as_str())
            .unwrap();
        let marker = &installation.setup.markers[k];
        let point = orientation.camera_from_survey
            * (marker.position_m - installation.setup.projection_centre_m);
        let computed = installation.setup.lens.project(&point).unwrap();
        let seen = orientation.ground.iter().find(|g| g.marker == k).unwrap();
        let residual = Vector2::new(
            row["u_px"].as_float().unwrap(),
            row["v_px"].as_float().unwrap(),
        );
        // The attitude by which a disc's bias was removed differs by the last step of the adjustment.
        assert!(
            (seen.pixel - computed - residual).norm() < 0.05,
            "{}: {residual:?}",
            marker.id
        );
    }
}
