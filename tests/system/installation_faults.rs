//! Bad input gives a fault that names file, key or line, and the remedy; never a panic.

use std::path::Path;

use proptest::prelude::*;
use wingd::installation::{self, Fault};

const CAMERA: &str =
    "width = 4000\nheight = 3000\nfx = 7800.0\nfy = 7795.0\ncx = 1986.0\ncy = 1513.0\nk1 = -0.05\n";
const SURVEY: &str = "id,shape,diameter_m,x_m,y_m,z_m,sigma_m\n\
    M01,quadrant,0.32,8.0,1.0,-2.0,0.002\nM02,circle,0.36,20.0,1.5,-1.0,0.002\nM03,circle,0.36,30.0,-0.5,-0.5,0.002\n";
const DOCUMENT: &str = "name = \"t\"\n[camera]\ncalibration = \"camera.toml\"\nprojection_centre_m = [0.0, 0.0, 0.0]\n\
    projection_centre_sigma_m = 0.002\n[wing]\nsurvey = \"survey.csv\"\nspan_direction = [1.0, 0.0]\nroot_offset_m = 0.6\n\
    [[torsion]]\nname = \"tip\"\nleading = \"M02\"\ntrailing = \"M03\"\n";

fn faults(document: &str, camera: &str, survey: &[u8]) -> Vec<Fault> {
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(directory.path().join("installation.toml"), document).unwrap();
    std::fs::write(directory.path().join("camera.toml"), camera).unwrap();
    std::fs::write(directory.path().join("survey.csv"), survey).unwrap();
    installation::load(directory.path())
        .err()
        .unwrap_or_default()
}

/// Asserts a single fault that names `file` and contains all `words`.
fn assert_only_fault(found: Vec<Fault>, file: &str, words: &[&str]) {
    assert_eq!(found.len(), 1, "{found:#?}");
    assert!(found[0].file.ends_with(file), "{found:#?}");
    let text = found[0].to_string();
    for word in words {
        assert!(text.contains(word), "\"{word}\" is not in: {text}");
    }
}

#[test]
fn a_sound_installation_is_accepted() {
    assert_eq!(faults(DOCUMENT, CAMERA, SURVEY.as_bytes()), vec![]);
    assert_eq!(
        faults(DOCUMENT, CAMERA, format!("\u{feff}{SURVEY}").as_bytes()),
        vec![],
        "with a byte order mark"
    );
}

#[test]
fn faults_of_a_survey_name_their_line() {
    let survey =
        |from: &str, to: &str| faults(DOCUMENT, CAMERA, SURVEY.replacen(from, to, 1).as_bytes());
    assert_only_fault(
        survey("20.0", "NaN"),
        "survey.csv",
        &["line 3", "x_m", "NaN", "finite"],
    );
    assert_only_fault(survey("20.0", ""), "survey.csv", &["line 3", "x_m"]);
    assert_only_fault(
        survey(",sigma_m", ""),
        "survey.csv",
        &["sigma_m", "missing"],
    );
    assert_only_fault(
        survey("M02,circle", "M02,square"),
        "survey.csv",
        &["line 3", "shape", "square", "quadrant, circle or point"],
    );
    assert_only_fault(
        survey("0.36", "-0.36"),
        "survey.csv",
        &["line 3", "diameter_m", "-0.36"],
    );
    let twice = faults(
        &DOCUMENT.replace("M03", "M01"),
        CAMERA,
        SURVEY.replacen("M03", "M02", 1).as_bytes(),
    );
    assert_only_fault(twice, "survey.csv", &["line 4", "M02", "line 3"]);
    assert_only_fault(
        faults(DOCUMENT, CAMERA, b"\xff\xfe"),
        "survey.csv",
        &["UTF-8"],
    );
    assert!(!faults(DOCUMENT, CAMERA, b"").is_empty());
}

#[test]
fn faults_of_a_survey_from_a_spreadsheet_are_one_cause() {
    let survey = |text: String| faults(DOCUMENT, CAMERA, text.as_bytes());
    let semicolons = SURVEY
        .replace('.', ",")
        .replace(",", ";")
        .replacen("0;32", "0,32", 1);
    assert_only_fault(
        survey(semicolons),
        "survey.csv",
        &["line 1", "semicolons", "commas"],
    );
    assert_only_fault(
        survey(SURVEY.replace(',', "\t")),
        "survey.csv",
        &["line 1", "tabs"],
    );
    // Every line in millimetres is one cause.
    assert_only_fault(
        survey(SURVEY.replace("0.002", "2")),
        "survey.csv",
        &["sigma_m", "2 m", "3 of 3", "M01", "0.002 for 2 mm"],
    );
}

#[test]
fn a_name_that_looks_like_a_comment_is_asked_about() {
    let survey = |text: String| faults(DOCUMENT, CAMERA, text.as_bytes());
    let row = "#04,circle,0.36,25.0,0.5,-0.8,0.002\n";
    assert_only_fault(
        survey(format!("{SURVEY}{row}")),
        "survey.csv",
        &["line 5", "#04", "comment or a name"],
    );
    let comments = format!("# of May, \"by hand\n{SURVEY}# {row}#\n");
    assert_eq!(survey(comments), vec![], "comments stay comments");
}

#[test]
fn two_pairs_of_one_name_are_a_fault() {
    let twice =
        format!("{DOCUMENT}[[torsion]]\nname = \"tip\"\nleading = \"M02\"\ntrailing = \"M03\"\n");
    assert_only_fault(
        faults(&twice, CAMERA, SURVEY.as_bytes()),
        "installation.toml",
        &["torsion[1].name", "tip", "already"],
    );
}

#[test]
fn faults_of_a_camera_name_their_key() {
    let camera =
        |from: &str, to: &str| faults(DOCUMENT, &CAMERA.replacen(from, to, 1), SURVEY.as_bytes());
    assert_only_fault(
        camera("width = 4000", "width = 0"),
        "camera.toml",
        &["width", "0 px"],
    );
    assert_only_fault(
        camera("k1 = -0.05", "k1 = inf"),
        "camera.toml",
        &["k1", "inf", "finite"],
    );
    assert_only_fault(
        camera("fx = 7800.0", "fx = nan"),
        "camera.toml",
        &["fx", "NaN"],
    );
    assert_only_fault(
        camera("k1 = -0.05", "s1 = 0.1"),
        "camera.toml",
        &["line 7", "s1"],
    );
    assert_only_fault(
        camera("k1 = -0.05", "k4 = inf"),
        "camera.toml",
        &["k4", "inf", "finite"],
    );
    assert_only_fault(camera("cx = 1986.0\n", ""), "camera.toml", &["cx"]);
    assert_only_fault(
        camera("k1 = -0.05", "k1 = -20.0"),
        "camera.toml",
        &["inverted", "calibrate again"],
    );
}

#[test]
fn faults_of_a_window_name_their_key() {
    let window = |keys: &str| {
        faults(
            &DOCUMENT.replacen("[wing]", &format!("[window]\n{keys}[wing]"), 1),
            CAMERA,
            SURVEY.as_bytes(),
        )
    };
    let pane = "normal = [0.2, 1.0, 0.1]\nthickness_m = 0.0145\n";
    assert_eq!(window(""), vec![]);
    assert_eq!(
        window("normal = [0.0, 1.0, 0.0]\nwavelength_nm = 550.0\n"),
        vec![]
    );
    assert_eq!(window(pane), vec![]);
    assert_eq!(
        window(&format!(
            "{pane}index = 1.5\nbow_radius_m = 12.0\nsame_on_ground = true\n"
        )),
        vec![]
    );
    assert_only_fault(
        window("thickness_m = 0.0145\n"),
        "installation.toml",
        &["window.normal", "missing", "outward"],
    );
    assert_only_fault(
        window("index = 1.5\n"),
        "installation.toml",
        &["window.index", "window.thickness_m"],
    );
    assert_only_fault(
        window("bow_radius_m = 9.0\n"),
        "installation.toml",
        &["window.bow_radius_m", "thickness_m"],
    );
    assert_only_fault(
        window("same_on_ground = true\n"),
        "installation.toml",
        &["window.same_on_ground", "thickness_m"],
    );
    let millimetres = window("normal = [0.0, 1.0, 0.0]\nthickness_m = 14.5\n");
    assert_only_fault(
        millimetres,
        "installation.toml",
        &["window.thickness_m", "14.5 m"],
    );
    let with = |key: &str| window(&format!("{pane}{key}\n"));
    assert_only_fault(
        with("index = 0.67"),
        "installation.toml",
        &["window.index", "0.67"],
    );
    assert_only_fault(
        with("index = nan"),
        "installation.toml",
        &["window.index", "NaN"],
    );
    assert_only_fault(
        with("bow_radius_m = 0.0"),
        "installation.toml",
        &["window.bow_radius_m", "0 m", "plane"],
    );
    assert_only_fault(
        with("normal_sigma_deg = -1.0"),
        "installation.toml",
        &["window.normal_sigma_deg", "-1"],
    );
    assert_only_fault(
        with("thicknes_m = 0.01"),
        "installation.toml",
        &["thicknes_m", "line"],
    );
}

#[test]
fn faults_of_an_installation_file_name_their_key() {
    let document =
        |from: &str, to: &str| faults(&DOCUMENT.replacen(from, to, 1), CAMERA, SURVEY.as_bytes());
    assert_only_fault(
        document("root_offset_m", "root_ofset_m"),
        "installation.toml",
        &["root_ofset_m", "line"],
    );
    assert_only_fault(
        document("[1.0, 0.0]", "[0.0, 0.0]"),
        "installation.toml",
        &["span_direction", "horizontal"],
    );
    assert_only_fault(
        document("\"M03\"", "\"M99\""),
        "installation.toml",
        &["torsion[0].trailing", "M99", "survey.csv"],
    );
    assert_only_fault(
        document("\"camera.toml\"", "\"cam.toml\""),
        "cam.toml",
        &["cannot be read", "calibrate"],
    );
    assert_only_fault(
        document("0.002", "inf"),
        "installation.toml",
        &["projection_centre_sigma_m", "inf"],
    );
}

#[test]
fn all_faults_are_reported_at_once() {
    let survey = SURVEY
        .replace("20.0", "NaN")
        .replace("M01,quadrant", "M01,star");
    let found = faults(DOCUMENT, &CAMERA.replace("4000", "0"), survey.as_bytes());
    assert_eq!(found.len(), 3, "{found:#?}");
}

#[test]
fn an_orientation_must_be_a_rotation() {
    let directory = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(directory.path().join(name), text).unwrap();
    write("installation.toml", DOCUMENT);
    write("camera.toml", CAMERA);
    write("survey.csv", SURVEY);
    write(
        "orientation.toml",
        "camera_from_survey = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]\n",
    );
    assert!(
        installation::load(directory.path())
            .unwrap()
            .orientation
            .is_some()
    );
    write(
        "orientation.toml",
        "camera_from_survey = [[0, -1, 0], [0, 0, 1], [1, 0, 0]]\n",
    );
    assert_only_fault(
        installation::load(directory.path()).err().unwrap(),
        "orientation.toml",
        &["not a rotation"],
    );
}

#[test]
fn an_orientation_is_valid_only_with_its_camera_and_survey() {
    let directory = tempfile::tempdir().unwrap();
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev");
    for name in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(
            fixture.join("installation").join(name),
            directory.path().join(name),
        )
        .unwrap();
    }
    let wingd = |command: &str, frame: &str| {
        let mut wingd = std::process::Command::new(env!("CARGO_BIN_EXE_wingd"));
        let wingd = wingd
            .args([command, "--installation"])
            .arg(directory.path());
        wingd
            .arg(fixture.join("frames").join(frame))
            .output()
            .unwrap()
    };
    assert_eq!(wingd("orient", "ground.jpg").status.code(), Some(0));
    assert_eq!(wingd("solve", "flight-1.jpg").status.code(), Some(0));
    let camera = directory.path().join("camera.toml");
    let text = std::fs::read_to_string(&camera).unwrap();
    std::fs::write(&camera, format!("{text}# another lens\n")).unwrap();
    let refused = wingd("solve", "flight-1.jpg");
    let printed = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(78), "{printed}");
    assert!(
        printed.contains("orientation.toml") && printed.contains("camera.toml has changed"),
        "{printed}"
    );
    assert_eq!(wingd("orient", "ground.jpg").status.code(), Some(0));
    assert_eq!(wingd("solve", "flight-1.jpg").status.code(), Some(0));
}

#[test]
fn markers_at_one_place_are_no_panic() {
    let lines: Vec<&str> = SURVEY.lines().take(2).collect();
    let directory = tempfile::tempdir().unwrap();
    let survey = lines.join("\n");
    for (name, text) in [
        ("installation.toml", DOCUMENT),
        ("camera.toml", CAMERA),
        ("survey.csv", survey.as_str()),
    ] {
        std::fs::write(directory.path().join(name), text).unwrap();
    }
    let faults = installation::load(directory.path()).unwrap_err();
    assert!(!faults.is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn damaged_files_never_panic(which in 0usize..3, at in 0usize..400, value: u8) {
        let mut files = [DOCUMENT.as_bytes().to_vec(), CAMERA.as_bytes().to_vec(), SURVEY.as_bytes().to_vec()];
        let n = files[which].len();
        files[which][at % n] = value;
        let directory = tempfile::tempdir().unwrap();
        for (name, bytes) in ["installation.toml", "camera.toml", "survey.csv"].iter().zip(&files) {
            std::fs::write(directory.path().join(name), bytes).unwrap();
        }
        let _ = installation::load(Path::new(directory.path()));
    }
}
