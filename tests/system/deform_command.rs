//! Promise: `wingd deform` moves a surface by the shape of a stored flight: surveyed points to their true positions in
//! flight, in frames of another renderer.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use crate::common::statistics::rms;
use crate::program::{fixture, outcome, run_in_folder};

/// Rows of a table by their number.
fn rows(file: &Path) -> BTreeMap<u64, Vec<f64>> {
    let mut table = csv::Reader::from_path(file).unwrap();
    let cells = |row: csv::StringRecord| {
        row.iter()
            .map(|cell| cell.parse().unwrap_or(f64::NAN))
            .collect::<Vec<f64>>()
    };
    table
        .records()
        .map(|row| cells(row.unwrap()))
        .map(|row| (row[0] as u64, row))
        .collect()
}

/// Surveyed points as nodes; `M07` is node 7.
fn nodes(installation: &Path, unit: &str) -> String {
    let mut survey = csv::Reader::from_path(installation.join("survey.csv")).unwrap();
    let heading = survey.headers().unwrap().clone();
    let column = |name: &str| heading.iter().position(|h| h == name).unwrap();
    let [id, x, y, z] = ["id", "x_m", "y_m", "z_m"].map(column);
    let line =
        |row: csv::StringRecord| format!("{},{},{},{}\n", &row[id][1..], &row[x], &row[y], &row[z]);
    let lines: String = survey.records().map(|row| line(row.unwrap())).collect();
    format!("id,x_{unit},y_{unit},z_{unit}\n{lines}")
}

#[test]
fn surveyed_points_of_another_renderer_are_moved_to_their_true_positions() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let installation = at.join("installation");
    std::fs::create_dir_all(at.join("frames")).unwrap();
    std::fs::create_dir(&installation).unwrap();
    for name in ["camera.toml", "installation.toml", "survey.csv"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            installation.join(name),
        )
        .unwrap();
    }
    for k in 1..=5 {
        let name = format!("flight-{k}.jpg");
        std::fs::copy(
            fixture("dev/frames").join(&name),
            at.join("frames").join(name),
        )
        .unwrap();
    }
    let ground = fixture("dev/frames/ground.jpg");
    run_in_folder(
        at,
        &[
            "orient",
            "--installation",
            "installation",
            ground.to_str().unwrap(),
        ],
    );
    run_in_folder(
        at,
        &[
            "import",
            "frames",
            "--store",
            "store",
            "--installation",
            "installation",
        ],
    );
    run_in_folder(
        at,
        &[
            "solve",
            "store",
            "--together",
            "--installation",
            "installation",
        ],
    );
    std::fs::write(at.join("nodes.csv"), nodes(&installation, "m")).unwrap();
    let deform = [
        "deform",
        "store",
        "--surface",
        "nodes.csv",
        "--output",
        "moved",
    ];
    let printed = run_in_folder(
        at,
        &[
            &deform[..],
            &["--frame", "s000001/0005.jpg", "--draws", "2"],
        ]
        .concat(),
    );
    assert!(
        printed.contains("f0001, s000001/0005.jpg: 21 of 21 nodes moved, by at most 1.3"),
        "{printed}"
    );

    let truth: Value =
        serde_json::from_slice(&std::fs::read(fixture("dev/truth.json")).unwrap()).unwrap();
    let position = |frame: usize, marker: usize, k: usize| {
        truth["frames"][frame]["markers"][marker]["position_m"][k]
            .as_f64()
            .unwrap()
    };
    let moved = rows(&at.join("moved/surface.csv"));
    let (mut errors_mm, mut normalised) = (vec![], vec![]);
    for marker in 0..21 {
        let row = &moved[&(marker as u64 + 1)];
        let error = |k: usize| row[4 + k] - (position(5, marker, k) - position(0, marker, k));
        errors_mm.push(1e3 * (error(0).powi(2) + error(1).powi(2) + error(2).powi(2)).sqrt());
        normalised.push(error(2) / row[9]);
    }
    println!(
        "rms {:.1} mm, {:.2} standard deviations",
        rms(&errors_mm),
        rms(&normalised)
    );
    assert!(rms(&errors_mm) < 8.0 && rms(&normalised) < 1.3);
    // Sampled surfaces differ by their common error, at the tip as much as their standard deviation says.
    let drawn = [1, 2]
        .map(|k| rows(&at.join(format!("moved/draw-00{k}/surface.csv")))[&21][3] - moved[&21][3]);
    assert!(
        drawn.iter().all(|d| d.abs() < 4.0 * moved[&21][9]) && drawn[0] != drawn[1],
        "{drawn:?}"
    );

    run_in_folder(at, &deform);
    let mean = rows(&at.join("moved/surface.csv"))[&21][6];
    let frames = (1..=5).map(|frame| position(frame, 20, 2) - position(0, 20, 2));
    assert!((mean - frames.sum::<f64>() / 5.0).abs() < 0.03, "{mean}");
    std::fs::write(at.join("nodes.csv"), nodes(&installation, "mm")).unwrap();
    let store = at.join("store").display().to_string();
    let file = at.join("nodes.csv").display().to_string();
    let refused = |more: &[&str]| {
        let output = at.join("no").display().to_string();
        let (status, text) = outcome(
            &[
                &["deform", &store, "--surface", &file, "--output", &output],
                more,
            ]
            .concat(),
        );
        assert!(status != Some(0) && !at.join("no").exists());
        text
    };
    assert!(
        refused(&[]).contains("its coordinates are in m, not mm: write x_m,y_m,z_m in its header")
    );
    assert!(refused(&["--cad"]).contains("the installation has no [cad]; give cad.tie_points"));
    assert!(refused(&["--frame", "zz"]).contains("there is no zz; available: s000001/0001.jpg, "));
}
