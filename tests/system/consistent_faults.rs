//! Promise: for a faulty installation or configuration every command comes to the same verdict and names the same,
//! single cause. The recorder continues with a faulty installation, and its log names the cause.

use std::path::{Path, PathBuf};

use crate::program::{fixture, outcome};

/// A column of a survey with every number changed.
fn column(text: &str, column: usize, by: fn(f64) -> f64) -> String {
    let row = |(k, line): (usize, &str)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if k > 0 {
            cells[column] = by(cells[column].parse().unwrap()).to_string();
        }
        cells.join(",") + "\n"
    };
    text.lines().enumerate().map(row).collect()
}

const INSTALLATION: &str = "installation.toml";
const SURVEY: &str = "survey.csv";
const CAMERA: &str = "camera.toml";
const SPAN: &str = "[0.39073113, 0.92050485]";

/// A file, its change, and the expected message.
type Fault = (&'static str, fn(&str) -> String, &'static [&'static str]);

const FAULTS: [Fault; 28] = [
    (
        INSTALLATION,
        |t| t.replace(SPAN, "[-0.39073113, -0.92050485]"),
        &["wing.span_direction", "in the opposite direction"],
    ),
    (
        INSTALLATION,
        |t| t.replace(SPAN, "[0.92050485, -0.39073113]"),
        &["wing.span_direction", "90 degrees off"],
    ),
    (
        INSTALLATION,
        |t| t.replace(SPAN, "[0, 0]"),
        &["wing.span_direction", "[0, 0]"],
    ),
    (
        INSTALLATION,
        |t| t.replace("[35.1985, 18.7004, 4.4095]", "[35198.5, 18700.4, 4409.5]"),
        &["camera.projection_centre_m", "40035 m", "metres"],
    ),
    (
        INSTALLATION,
        |t| t.replace("root_offset_m = 0.55", "root_offset_m = 49"),
        &["wing.root_offset_m", "inboard"],
    ),
    (
        INSTALLATION,
        |t| {
            t.replace(
                "root_offset_m = 0.55",
                "root_offset_m = 0.55\nbreaks = [{ span_m = 99.0 }]",
            )
        },
        &["wing.breaks.span_m", "99", "markers"],
    ),
    (
        INSTALLATION,
        |t| {
            t.replace(
                "root_offset_m = 0.55",
                "root_offset_m = 0.55\nbreaks = [{ span_m = 12.0, sweep_deg = 45.0 }]",
            )
        },
        &["wing.breaks.sweep_deg", "45", "30"],
    ),
    (
        INSTALLATION,
        |t| {
            t.replace(
                "root_offset_m = 0.55",
                "root_offset_m = 9.0\nbreaks = [{ span_m = 8.5, sweep_deg = 4.0 }]",
            )
        },
        &["wing.breaks.span_m", "8.5", "root"],
    ),
    (
        INSTALLATION,
        |t| {
            let sideless = t.split("[[torsion]]").next().unwrap_or_default();
            sideless.replace(
                "root_offset_m = 0.55",
                "root_offset_m = 0.55\nbreaks = [{ span_m = 12.0, sweep_deg = 4.0 }]",
            )
        },
        &["wing.breaks.sweep_deg", "side", "wing.side"],
    ),
    (
        INSTALLATION,
        |t| t.replace("root_offset_m = 0.55", "root_offset_m = 550"),
        &["wing.root_offset_m", "550"],
    ),
    (
        INSTALLATION,
        |t| t.replace("centre_sigma_m = 0.002", "centre_sigma_m = 2"),
        &["camera.projection_centre_sigma_m", "2.0 m"],
    ),
    (
        INSTALLATION,
        |t| t.replace("root_offset_m", "side = \"left\"\nroot_offset_m"),
        &["torsion[0]", "left wing", "wing.side"],
    ),
    (
        INSTALLATION,
        |t| t.replace("root_offset_m", "side = \"port\"\nroot_offset_m"),
        &["line 12", "port"],
    ),
    (
        INSTALLATION,
        |t| format!("{t}[[torsion]]\nname = \"tip\"\nleading = \"M16\"\ntrailing = \"M15\"\n"),
        &["torsion[1].name", "already"],
    ),
    (
        INSTALLATION,
        |t| t.replace("\"M20\"", "\"M77\""),
        &["torsion[0].leading", "M77"],
    ),
    (
        INSTALLATION,
        |t| t.replace("\"survey.csv\"", "\"servey.csv\""),
        &["servey.csv", "cannot be read"],
    ),
    (
        INSTALLATION,
        |t| t.replace("\"camera.toml\"", "\"cam.toml\""),
        &["cam.toml", "cannot be read"],
    ),
    (
        SURVEY,
        |t| {
            [3, 4, 5]
                .iter()
                .fold(t.to_owned(), |t, k| column(&t, *k, |v| 1e3 * v))
        },
        &["survey.csv", "x_m, y_m, z_m", "millimetres"],
    ),
    (
        SURVEY,
        |t| column(t, 2, |v| 1e3 * v),
        &["column diameter_m", "20 similar errors"],
    ),
    (
        SURVEY,
        |t| column(t, 6, |v| 1e3 * v),
        &["sigma_m", "21 of 21", "0.002 for 2 mm"],
    ),
    (SURVEY, |t| t.replace(',', ";"), &["line 1", "semicolons"]),
    (
        SURVEY,
        |t| t.replacen("M05", "#05", 1),
        &["line 6", "#05", "comment or a name"],
    ),
    (
        SURVEY,
        |t| t.replacen("M05", "M04", 1),
        &["line 6", "M04", "already on line 5"],
    ),
    (
        SURVEY,
        |t| {
            format!(
                "{t}{}\n",
                t.lines().nth(3).unwrap().replacen("M03", "M33", 1)
            )
        },
        &["M33", "M03", "overlap"],
    ),
    (
        CAMERA,
        |t| t.replace("width = 4000", "width = 0"),
        &["camera.toml", "width", "0 px"],
    ),
    (
        CAMERA,
        |t| t.replace("k1 =", "k7 ="),
        &["camera.toml", "line 7", "k7"],
    ),
    (
        CAMERA,
        |t| t.replace("fx =", "fx = -"),
        &["camera.toml", "fx"],
    ),
    // A warning, not a fault: it stops no command, and each reports it.
    (
        SURVEY,
        |t| t.replace("26.4142", "24.6142"),
        &["warning: ", "M02", "above the smooth skin"],
    ),
];

/// A recorder configuration that ends by itself.
fn configuration(folder: &Path) -> PathBuf {
    std::fs::create_dir(folder.join("frames")).unwrap();
    std::fs::copy(
        fixture("jpeg/baseline-2x1.jpg"),
        folder.join("frames/one.jpg"),
    )
    .unwrap();
    let text = "installation = \".\"\n[store]\npath = \"store\"\nreserve_mb = 1\n[camera]\nkind = \"replay\"\n\
                folder = \"frames\"\n[series]\ninterval = \"4s\"\nshots = 1\nuntil = \"1s\"\n[status]\n\
                socket = \"s.sock\"\n";
    let file = folder.join("wingd.toml");
    std::fs::write(&file, text).unwrap();
    file
}

/// A sound installation with an orientation, and a recorder configuration.
fn prepare_installation() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in [INSTALLATION, SURVEY, CAMERA] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            folder.path().join(name),
        )
        .unwrap();
    }
    configuration(folder.path());
    folder
}

/// Lines that report a fault or a warning, without the text before the file name.
fn causes(printed: &str, directory: &str) -> Vec<String> {
    let cause = |line: &str| line.find(directory).map(|at| line[at..].to_owned());
    printed
        .lines()
        .filter(|l| l.starts_with("wingd: "))
        .filter_map(cause)
        .collect()
}

#[test]
fn every_command_comes_to_the_same_verdict_and_cause() {
    let frame = fixture("dev/frames/ground.jpg").display().to_string();
    for (k, (file, change, words)) in FAULTS.iter().enumerate() {
        let folder = prepare_installation();
        let directory = folder.path().to_str().unwrap();
        // Made before the fault: its report about the faulty files is no second cause.
        let oriented = outcome(&["orient", "--installation", directory, &frame]);
        assert_eq!(oriented.0, Some(0), "{}", oriented.1);
        let path = folder.path().join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        assert_ne!(change(&text), text, "fault {k} changes nothing");
        std::fs::write(&path, change(&text)).unwrap();
        let is_warning = words[0] == "warning: ";
        let config = folder.path().join("wingd.toml").display().to_string();
        if is_warning {
            // The survey has changed, which is a fault until a new orientation is made.
            assert_eq!(
                outcome(&["orient", "--installation", directory, &frame]).0,
                Some(0)
            );
        }
        let (status, first) = outcome(&["check", "--installation", directory]);
        let cause = causes(&first, directory);
        assert_eq!(cause.len(), 1, "fault {k}: {first}");
        assert!(
            words.iter().all(|word| first.contains(word)),
            "fault {k}: {words:?} in {first}"
        );
        let expected = Some(if is_warning { 0 } else { 78 });
        assert_eq!(status, expected, "fault {k}: {first}");
        let commands: [(&str, &[&str]); 6] = [
            ("plan", &["plan", "--installation", directory]),
            ("orient", &["orient", "--installation", directory, &frame]),
            ("solve", &["solve", "--installation", directory, &frame]),
            ("detect", &["detect", "--installation", directory, &frame]),
            ("check", &["check", "--config", &config]),
            ("run", &["run", "--config", &config]),
        ];
        for (name, arguments) in commands {
            let (status, printed) = outcome(arguments);
            assert!(
                cause.iter().all(|cause| printed.contains(cause)),
                "fault {k}, {name}: {cause:?} in {printed}"
            );
            if name == "run" {
                let held = printed.contains("not solved until this error is fixed");
                assert!(
                    status == Some(0) && held != is_warning,
                    "fault {k}, {name}: {printed}"
                );
            } else {
                assert_eq!(status, expected, "fault {k}, {name}: {printed}");
                let own = causes(&printed, directory);
                assert!(
                    own.iter().all(|c| cause.contains(c)),
                    "fault {k}, {name}: {own:?}, not {cause:?}"
                );
            }
        }
    }
}

#[test]
fn check_and_run_agree_about_a_configuration() {
    let changes: [(&str, &str, &[&str]); 8] = [
        ("shots = 1", "shots = 0", &["series.shots"]),
        ("shots = 1", "shoots = 1", &["line 10", "shoots"]),
        ("until = \"1s\"", "until = \"soon\"", &["line 11", "until"]),
        ("kind = \"replay\"", "kind = \"polaroid\"", &["polaroid"]),
        (
            "path = \"store\"",
            "path = \"~/store\"",
            &["store.path", "full path"],
        ),
        ("path = \"store\"\n", "", &["path"]),
        (
            "[series]",
            "[solve]\ncurvature_terms = 11\n[series]",
            &["solve.curvature_terms", "11"],
        ),
        (
            "[series]",
            "[solve]\ndeadline = \"1ms\"\n[series]",
            &["solve.deadline"],
        ),
    ];
    for (from, to, words) in changes {
        let folder = prepare_installation();
        let file = folder.path().join("wingd.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.contains(from), "{from}");
        std::fs::write(&file, text.replace(from, to)).unwrap();
        let [checked, run] =
            ["check", "run"].map(|c| outcome(&[c, "--config", file.to_str().unwrap()]));
        assert_eq!(
            (checked.0, run.0),
            (Some(78), Some(78)),
            "{to}: {} {}",
            checked.1,
            run.1
        );
        assert!(
            words.iter().all(|w| checked.1.contains(w)),
            "{words:?}: {}",
            checked.1
        );
        assert_eq!(checked.1, run.1);
        assert!(!folder.path().join("store").exists());
        let wide: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        std::fs::write(&file, [&[0xff, 0xfe], &wide[..]].concat()).unwrap();
        let (status, printed) = outcome(&["check", "--config", file.to_str().unwrap()]);
        assert!(
            status == Some(78)
                && printed.contains("UTF-16")
                && printed.contains("save it as UTF-8"),
            "{printed}"
        );
    }
}
