//! `wingd calibrate` and `convert` through the real binary.

use std::path::Path;

use nalgebra::{Rotation3, Vector3};
use serde_json::Value;
use wingd::measure::geometry::Lens;
use wingd_simulate::render::{RenderedBoard, SeededRandom};

use crate::program::run;

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

const BOARD: &str = "pattern = \"checkerboard\"\ncolumns = 9\nrows = 7\nsquare_m = 0.1\n";

/// Images of a board in front of a camera of 640 x 480, c = 1250 px, over the image and tilted.
fn pictures(directory: &Path, count: usize) {
    std::fs::create_dir_all(directory).unwrap();
    let pinhole = Lens::pinhole(640, 480, 1250.0, 322.0, 236.0);
    let lens = Lens {
        k1: -0.08,
        k2: 0.05,
        ..pinhole
    };
    let mut random = SeededRandom::new(3, 0);
    for k in 0..count {
        let turn =
            Rotation3::from_euler_angles(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), 0.1);
        let middle = Vector3::new(
            (k % 3) as f64 * 0.6 - 0.6,
            (k / 3 % 3) as f64 * 0.4 - 0.4,
            random.uniform(4.2, 5.2),
        );
        let picture = RenderedBoard {
            lens,
            corners: (9, 7),
            square_m: 0.1,
            bow_m: [0.0006, 0.0],
            camera_from_board: turn,
            origin_m: middle - turn * Vector3::new(0.4, 0.3, 0.0),
            blur_px: 0.7,
            noise: 1.0,
            pane: None,
        };
        let raster = picture.render(&mut random).unwrap();
        let grey = image::GrayImage::from_raw(640, 480, raster.luma().to_vec()).unwrap();
        grey.save(directory.join(format!("b{k:02}.png"))).unwrap();
    }
}

fn paths(directory: &Path) -> Vec<String> {
    let mut paths: Vec<String> = std::fs::read_dir(directory)
        .unwrap()
        .map(|e| e.unwrap().path().display().to_string())
        .filter(|p| p.ends_with(".png"))
        .collect();
    paths.sort();
    paths
}

#[test]
fn pictures_become_a_camera_a_report_and_corners_that_give_the_same_camera() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name).display().to_string();
    std::fs::write(at("board.toml"), BOARD).unwrap();
    pictures(&directory.path().join("p"), 16);
    let images = paths(&directory.path().join("p"));
    let (board, camera, corners, page) = (
        at("board.toml"),
        at("camera.toml"),
        at("c.csv"),
        at("r.html"),
    );
    let mut arguments = vec![
        "calibrate",
        "--json",
        "--board",
        &board,
        "--output",
        &camera,
        "--corners",
        &corners,
    ];
    arguments.extend(["--report", &page]);
    arguments.extend(images.iter().map(String::as_str));
    let done = run(&arguments);
    assert!(done.status.success(), "{}", text(&done.stderr));
    let first: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(first["images"].as_array().unwrap().len(), 16);
    assert!(
        (first["parameters"]["fx"].as_f64().unwrap() - 1250.0).abs()
            < 5.0 * first["sigma"]["fx"].as_f64().unwrap()
    );
    assert!(first["halves_px"][0].is_number() && first["board_bow_m"][0].is_number());
    let page = std::fs::read_to_string(&page).unwrap();
    for words in [
        "<svg",
        "Projection uncertainty",
        "Shape of the board",
        "b07.png",
        "correlation",
    ] {
        assert!(
            page.contains(words) || page.contains(&words.replace("&#39;", "'")),
            "{words}"
        );
    }
    assert!(
        !page.contains("http://")
            || page.matches("http://").count() == page.matches("http://www.w3.org").count()
    );
    // From the file of corners alone.
    let again = at("again.toml");
    let done = run(&[
        "calibrate",
        "--json",
        "--board",
        &board,
        "--output",
        &again,
        "--corners",
        &corners,
    ]);
    assert!(done.status.success(), "{}", text(&done.stderr));
    let second: Value = serde_json::from_slice(&done.stdout).unwrap();
    for name in ["fx", "cx", "k1"] {
        let off = first["parameters"][name].as_f64().unwrap()
            - second["parameters"][name].as_f64().unwrap();
        // Corners are written to 1e-5 px.
        assert!(
            off.abs() < 0.05 * first["sigma"][name].as_f64().unwrap(),
            "{name}: {off}"
        );
    }
    assert_eq!(
        std::fs::read_to_string(&corners)
            .unwrap()
            .lines()
            .next()
            .unwrap()
            .split(',')
            .count(),
        10
    );
    // Squares counted instead of inner corners.
    std::fs::write(
        &board,
        BOARD
            .replace("columns = 9", "columns = 10")
            .replace("rows = 7", "rows = 8"),
    )
    .unwrap();
    let done = run(&[
        "calibrate",
        "--json",
        "--board",
        &board,
        "--output",
        &again,
        "--corners",
        &corners,
    ]);
    let third: Value = serde_json::from_slice(&done.stdout).unwrap();
    let printed = text(&done.stderr);
    assert!(
        done.status.success() && third["verdict"] == "poor",
        "{printed}"
    );
    assert!(
        printed.contains("never more than 9 of 10 columns and 7 of 8 rows of corners seen"),
        "{printed}"
    );
}

#[test]
fn a_calibration_that_one_reason_refuses_can_be_accepted_and_stays_marked() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name).display().to_string();
    std::fs::write(at("board.toml"), BOARD).unwrap();
    pictures(&directory.path().join("p"), 12);
    let (board, camera, corners, aside_file, page) = (
        at("board.toml"),
        at("camera.toml"),
        at("corners.csv"),
        at("aside.csv"),
        at("page.html"),
    );
    let all = paths(&directory.path().join("p"));
    let given = [
        "calibrate",
        "--board",
        &board,
        "--output",
        &camera,
        "--corners",
        &corners,
    ];
    run(&[
        &given[..],
        &all.iter().map(String::as_str).collect::<Vec<_>>(),
    ]
    .concat());
    let _ = std::fs::remove_file(&camera);
    // Corner errors of nearly a pixel are the only reason for the refusal.
    let mut random = SeededRandom::new(5, 0);
    let aside = |line: &str| -> String {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        for cell in &mut cells[5..7] {
            let by = if random.uniform(-1.0, 1.0) < 0.0 {
                -0.8
            } else {
                0.8
            };
            *cell = format!("{:.5}", cell.parse::<f64>().unwrap() + by);
        }
        cells.join(",")
    };
    let lines = std::fs::read_to_string(&corners).unwrap();
    let (head, rows) = lines.split_once('\n').unwrap();
    let rows: Vec<String> = rows.lines().map(aside).collect();
    std::fs::write(&aside_file, format!("{head}\n{}\n", rows.join("\n"))).unwrap();
    let ask = [
        "calibrate",
        "--json",
        "--board",
        &board,
        "--output",
        &camera,
        "--corners",
        &aside_file,
    ];
    let plain = run(&ask);
    assert!(
        text(&plain.stderr).contains("refused, "),
        "{}",
        text(&plain.stderr)
    );
    assert!(
        !std::path::Path::new(&camera).exists(),
        "nothing is written unasked"
    );
    let done = run(&[
        &ask[..],
        &["--accept", "only a rehearsal \"of\" it", "--report", &page],
    ]
    .concat());
    assert!(done.status.success(), "{}", text(&done.stderr));
    crate::json_schemas::assert_valid("calibrate", &done.stdout);
    let found: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(
        (&found["verdict"], &found["status"]),
        (&"refused".into(), &"ok".into())
    );
    let written = std::fs::read_to_string(&camera).unwrap();
    assert!(
        written.contains("verdict = \"refused\"") && written.contains("accepted = "),
        "{written}"
    );
    assert!(
        wingd::installation::load_camera(std::path::Path::new(&camera)).is_ok(),
        "{written}"
    );
    assert!(
        std::fs::read_to_string(&page)
            .unwrap()
            .contains("only a rehearsal &quot;of&quot; it")
    );
    let empty = run(&[&ask[..], &["--accept", " "]].concat());
    assert!(
        text(&empty.stderr).contains("needs a reason in words"),
        "{}",
        text(&empty.stderr)
    );
}

#[test]
fn millimetres_for_metres_are_named() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name).display().to_string();
    std::fs::write(at("board.toml"), BOARD.replace("0.1", "25")).unwrap();
    let done = run(&[
        "calibrate",
        "--board",
        &at("board.toml"),
        "--output",
        &at("camera.toml"),
        "x.png",
    ]);
    let printed = text(&done.stderr);
    assert!(
        done.status.code() == Some(78)
            && printed.contains("squares of 25 m")
            && printed.contains("0.025"),
        "{printed}"
    );
}

#[test]
fn an_invalid_tolerance_is_named_with_its_remedy() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name).display().to_string();
    for sigma in ["0.0", "0.5", "nan"] {
        std::fs::write(at("board.toml"), format!("{BOARD}scale_sigma = {sigma}\n")).unwrap();
        let done = run(&[
            "calibrate",
            "--board",
            &at("board.toml"),
            "--output",
            &at("camera.toml"),
            "x.png",
        ]);
        assert_eq!(done.status.code(), Some(78), "{sigma}");
        assert!(
            text(&done.stderr).contains("scale_sigma"),
            "{}",
            text(&done.stderr)
        );
    }
}
