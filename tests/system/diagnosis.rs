//! Promise: an installation, frame or mark that does not fit is refused or doubtful, and its cause is named, equally by
//! `diagnose`, `orient` and `solve`.

use std::path::Path;

use serde_json::Value;

use crate::program::{fixture, outcome, stdout};

const INSTALLATION: &str = "installation.toml";
const SURVEY: &str = "survey.csv";
const CAMERA: &str = "camera.toml";
const CENTRE: &str = "[35.1985, 18.7004, 4.4095]";

/// The dev installation with one file changed.
fn changed(file: &str, change: impl Fn(&str) -> String) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in [INSTALLATION, SURVEY, CAMERA] {
        std::fs::copy(fixture("dev/installation").join(name), folder.path().join(name)).unwrap();
    }
    let text = std::fs::read_to_string(folder.path().join(file)).unwrap();
    std::fs::write(folder.path().join(file), change(&text)).unwrap();
    folder
}

fn path(folder: &tempfile::TempDir) -> &str {
    folder.path().to_str().unwrap()
}

fn frame(name: &str) -> String {
    fixture("dev/frames").join(name).display().to_string()
}

/// A survey with the place of each marker changed.
fn with_places(text: &str, change: impl Fn(&str, [f64; 3]) -> [f64; 3]) -> String {
    let row = |(k, line): (usize, &str)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if k > 0 {
            let place = change(&cells[0], [3, 4, 5].map(|c: usize| cells[c].parse().unwrap()));
            (3..6).for_each(|c| cells[c] = format!("{:.4}", place[c - 3]));
        }
        cells.join(",") + "\n"
    };
    text.lines().enumerate().map(row).collect()
}

/// A camera with both camera constants scaled.
fn with_lens(text: &str, factor: f64) -> String {
    let line = |line: &str| match line.split_once(" = ") {
        Some((key @ ("fx" | "fy"), value)) => format!("{key} = {}\n", factor * value.parse::<f64>().unwrap()),
        _ => format!("{line}\n"),
    };
    text.lines().map(line).collect()
}

/// A file, its change, and words of the cause.
type Case = (&'static str, fn(&str) -> String, &'static [&'static str]);

const CASES: [Case; 9] = [
    (CAMERA, |t| with_lens(t, 1.02), &["the focal length is off by -", "camera.toml (fx, fy)"]),
    (CAMERA, |t| with_lens(t, 0.8), &["focal length", "camera.toml (fx, fy)"]),
    (
        INSTALLATION,
        |t| t.replace(CENTRE, "[35.1985, 19.0004, 4.4095]"),
        &["camera.projection_centre_m", "the lens is off by"],
    ),
    (
        INSTALLATION,
        |t| t.replace(CENTRE, "[35.1985, 18.7004, 4.4395]"),
        &["camera.projection_centre_m", "off by -0.0", "in z"],
    ),
    (SURVEY, |t| with_places(t, |_, [x, y, z]| [x, -y, z]), &["the sign of y_m in the survey"]),
    (SURVEY, |t| with_places(t, |_, [x, y, z]| [-x, y, z]), &["the sign of x_m in the survey"]),
    (SURVEY, |t| with_places(t, |_, p| p.map(|v| v / 0.3048)), &["feet"]),
    (SURVEY, |t| with_places(t, |_, [x, y, z]| [x, z, y]), &["z_m", "y_m seems to be the height"]),
    (SURVEY, |t| t.replace("0.32,", "12.6,").replace("0.36,", "14.17,"), &["inches"]),
];

#[test]
fn errors_of_an_installation_are_refused_with_their_cause() {
    for (k, (file, change, words)) in CASES.iter().enumerate() {
        let folder = changed(file, change);
        for command in ["orient", "diagnose"] {
            let (status, printed) = outcome(&[command, "--installation", path(&folder), &frame("ground.jpg")]);
            assert!(matches!(status, Some(1 | 78)), "case {k}, {command}: {printed}");
            assert!(words.iter().all(|word| printed.contains(word)), "case {k}, {command}: {words:?} in {printed}");
        }
        assert!(!folder.path().join("orientation.toml").exists(), "case {k}");
    }
}

#[test]
fn axes_with_z_down_are_refused_and_an_accepted_orientation_is_marked() {
    let folder = changed(SURVEY, |t| with_places(t, |_, [x, y, z]| [x, -y, -z]));
    let file = folder.path().join(INSTALLATION);
    let text = std::fs::read_to_string(&file).unwrap();
    let text = text.replace(CENTRE, "[35.1985, -18.7004, -4.4095]").replace("0.92050485]", "-0.92050485]");
    let without = &text[..text.find("[[torsion]]").unwrap()];
    std::fs::write(&file, without).unwrap();
    let ground = frame("ground.jpg");
    let (status, printed) = outcome(&["orient", "--installation", path(&folder), &ground]);
    assert!(status == Some(1) && printed.contains("points down"), "{printed}");
    let accept = ["orient", "--json", "--installation", path(&folder), "--accept", "a test", &ground];
    let fit: Value = serde_json::from_str(&stdout(&accept)).unwrap();
    assert!(fit["remarks"].to_string().contains("accepted although"), "{fit}");
    let (status, printed) = outcome(&["check", "--installation", path(&folder)]);
    assert!(status == Some(0) && printed.contains("accepted: a test"), "{printed}");
    // With the pair of a right wing the axes contradict it.
    std::fs::write(&file, text.replace("root_offset_m", "side = \"right\"\nroot_offset_m")).unwrap();
    let (status, printed) = outcome(&["check", "--installation", path(&folder)]);
    assert!(status == Some(78) && printed.contains("points down"), "{printed}");
}

#[test]
fn a_sound_installation_is_not_accused() {
    for set in ["dev", "demo"] {
        let installation = fixture(set).join("installation").display().to_string();
        let ground = fixture(set).join("frames/ground.jpg").display().to_string();
        let found: Value =
            serde_json::from_str(&stdout(&["diagnose", "--json", "--installation", &installation, &ground])).unwrap();
        assert_eq!((&found["status"], found["causes"].as_array().unwrap().len()), (&"sound".into(), 0), "{found}");
    }
}

/// Manual marks of the ground frame: the detected centres, with changes.
fn marks(change: impl Fn(&str, [f64; 2]) -> Option<[f64; 2]>) -> String {
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(fixture("dev/truth.json")).unwrap()).unwrap();
    let frames = truth["frames"].as_array().unwrap();
    let ground = frames.iter().find(|f| f["image"] == "ground.jpg").unwrap();
    let row = |m: &Value| {
        let (id, u, v) = (m["id"].as_str().unwrap(), m["u"].as_f64().unwrap(), m["v"].as_f64().unwrap());
        change(id, [u, v]).map(|[u, v]| format!("{id},{u},{v},0.5\n"))
    };
    let rows: String = ground["markers"].as_array().unwrap().iter().filter_map(row).collect();
    format!("id,u_px,v_px,sigma_px\n{rows}")
}

#[test]
fn manual_marks_that_disagree_are_named() {
    let folder = changed(SURVEY, str::to_owned);
    let file = folder.path().join("marks.csv");
    let orient = |text: String| {
        std::fs::write(&file, text).unwrap();
        let ground = frame("ground.jpg");
        outcome(&["orient", "--installation", path(&folder), "--observations", file.to_str().unwrap(), &ground])
    };
    let (status, printed) = orient(marks(|id, [u, v]| (id == "M13").then_some([u + 30.0, v])));
    assert!(status == Some(0) && printed.contains("not used: M13: the manual mark of M13 is off by 3"), "{printed}");
    let places = marks(|_, p| Some(p));
    let exchanged = places.replace("M13,", "X,").replace("M14,", "M13,").replace("X,", "M14,");
    let (status, printed) = orient(exchanged);
    assert!(status == Some(0) && printed.contains("have each other's names"), "{printed}");
    let (status, printed) = orient(marks(|_, [u, v]| Some([u, 2999.0 - v])));
    assert!(status == Some(1) && printed.contains("v is counted from below"), "{printed}");
    let (status, printed) = orient(marks(|_, [u, v]| Some([0.5 * u, 0.5 * v])));
    assert!(status == Some(1) && printed.contains("half the size"), "{printed}");
}

/// Writes a frame scaled about the middle of the image.
fn scaled(of: &str, factor: f64, file: &Path) {
    let bytes = std::fs::read(fixture("dev/frames").join(of)).unwrap();
    let raster = wingd::pipeline::decode::decode_image(&bytes, None).unwrap();
    let (w, h) = (raster.width(), raster.height());
    let mut out = format!("P5\n{w} {h}\n255\n").into_bytes();
    let at = |k: usize, size: usize| {
        let middle = 0.5 * (size as f64 - 1.0);
        (middle + (k as f64 - middle) / factor).clamp(0.0, size as f64 - 1.001)
    };
    for v in 0..h {
        let y = at(v, h);
        let (low, high) = (raster.row(y as usize), raster.row(y as usize + 1));
        for u in 0..w {
            let x = at(u, w);
            let mix = |row: &[u8]| {
                f64::from(row[x as usize]) * (1.0 - x.fract()) + f64::from(row[x as usize + 1]) * x.fract()
            };
            out.push((mix(low) * (1.0 - y.fract()) + mix(high) * y.fract()).round() as u8);
        }
    }
    std::fs::write(file, out).unwrap();
}

#[test]
fn a_result_that_may_not_be_used_is_doubtful_with_its_cause() {
    let folder = changed(SURVEY, str::to_owned);
    assert_eq!(outcome(&["orient", "--installation", path(&folder), &frame("ground.jpg")]).0, Some(0));
    let marks = folder.path().join("marks.csv");
    let seen = stdout(&["solve", "--json", "--installation", path(&folder), &frame("flight-1.jpg")]);
    let seen: Value = serde_json::from_str(&seen).unwrap();
    let row = |m: &Value| {
        Some(format!("{},{},{},0.5\n", m["id"].as_str()?, m["u_px"].as_f64()?, 2999.0 - m["v_px"].as_f64()?))
    };
    let rows: String = seen["markers"].as_array().unwrap().iter().filter_map(row).collect();
    std::fs::write(&marks, format!("id,u_px,v_px,sigma_px\n{rows}")).unwrap();
    let arguments = ["solve", "--json", "--installation", path(&folder), "--observations", marks.to_str().unwrap()];
    let (status, printed) = outcome(&arguments);
    let result: Value = serde_json::from_str(printed.lines().next().unwrap()).unwrap();
    let reason = result["reason"].as_str().unwrap();
    assert_eq!((status, &result["status"]), (Some(1), &"doubtful".into()), "{printed}");
    assert!(reason.contains("rejected") && reason.contains("v is counted from below"), "{reason}");
    let picture = folder.path().join("zoomed.pgm");
    for factor in [0.98, 1.05] {
        scaled("flight-1.jpg", factor, &picture);
        let (_, printed) = outcome(&["solve", "--json", "--installation", path(&folder), picture.to_str().unwrap()]);
        assert!(printed.contains("larger than that of the ground frames"), "{factor}: {printed}");
    }
}

#[test]
fn a_span_off_the_line_of_the_markers_is_warned_of() {
    let turned = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let [x, y] = [0.39073113, 0.92050485];
        let span = format!("[{}, {}]", x * cos - y * sin, x * sin + y * cos);
        let folder = changed(INSTALLATION, |t| t.replace("[0.39073113, 0.92050485]", &span));
        outcome(&["check", "--installation", path(&folder)])
    };
    for degrees in [0.0, 2.0, -2.0] {
        let (status, printed) = turned(degrees);
        assert!(status == Some(0) && !printed.contains("span_direction"), "{degrees}: {printed}");
    }
    for degrees in [7.0, -7.0, 28.0] {
        let (status, printed) = turned(degrees);
        assert!(
            status == Some(0) && printed.contains("warning") && printed.contains("span_direction"),
            "{degrees}: {printed}"
        );
    }
}

#[test]
fn tie_points_of_another_unit_or_with_an_error_are_named() {
    let check = |change: fn(usize, [f64; 3]) -> [f64; 3], flat: bool| {
        let folder = changed(INSTALLATION, |t| format!("{t}[cad]\ntie_points = \"ties.csv\"\n"));
        let mut text = String::from("id,x_m,y_m,z_m,cad_x_m,cad_y_m,cad_z_m\n");
        for (k, [x, y, z]) in [[0.0, 0.0, 0.0], [10.0, 0.0, 1.0], [0.0, 8.0, 2.0], [10.0, 8.0, 5.0], [5.0, 3.0, 1.0]]
            .into_iter()
            .enumerate()
        {
            let z = if flat { 0.0 } else { z };
            let [a, b, c] = change(k, [x + 3.0, y - 2.0, z + 1.0]);
            text.push_str(&format!("T{k},{x},{y},{z},{a},{b},{c}\n"));
        }
        std::fs::write(folder.path().join("ties.csv"), text).unwrap();
        outcome(&["check", "--installation", path(&folder)])
    };
    let (status, printed) = check(|_, p| p, false);
    assert!(status == Some(0) && !printed.contains("tie_points"), "{printed}");
    let (status, printed) = check(|_, p| p.map(|v| 1000.0 * v), false);
    assert!(status == Some(78) && printed.contains("cad.tie_points") && printed.contains("millimetres"), "{printed}");
    let (status, printed) = check(|k, [x, y, z]| [x + if k == 3 { 0.25 } else { 0.0 }, y, z], false);
    assert!(status == Some(0) && printed.contains("T3 is") && printed.contains("contradict each other"), "{printed}");
    let (status, printed) = check(|_, [x, y, z]| [x, -y, z], true);
    assert!(status == Some(0) && printed.contains("in one plane") && printed.contains("-z"), "{printed}");
}
