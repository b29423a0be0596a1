//! Promise: a mistake in a file of the administrator is named with its file, key or line, value and remedy, and what is not a
//! regular file is refused by name: nothing waits for it and nothing is killed.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::program::{fixture, outcome};

/// Largest time for a command that only has to refuse a file.
const PATIENCE: Duration = Duration::from_secs(60);

/// Output of a command that must end by itself.
fn finished(arguments: &[&str]) -> (Option<i32>, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("{arguments:?} does not end");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let Output {
        status,
        stdout,
        stderr,
    } = child.wait_with_output().unwrap();
    let printed = String::from_utf8_lossy(&[stdout, stderr].concat()).into_owned();
    (status.code(), printed)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn make_pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().unwrap();
    assert!(made.success());
}

/// A folder with a configuration that replays images, and an installation.
struct Place(tempfile::TempDir);

impl Place {
    fn new(images: usize) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        std::fs::create_dir(place.path("frames")).unwrap();
        let frame = std::fs::read(fixture("dev/frames/ground.jpg")).unwrap();
        for k in 0..images {
            // A comment after the first marker makes the images differ.
            let comment = [0xff, 0xfe, 0, 3, k as u8];
            let other = [&frame[..2], &comment, &frame[2..]].concat();
            std::fs::write(place.path(&format!("frames/{k}.jpg")), other).unwrap();
        }
        std::fs::create_dir(place.path("installation")).unwrap();
        for name in ["camera.toml", "survey.csv", "installation.toml"] {
            let from = fixture("dev/installation").join(name);
            std::fs::copy(from, place.path("installation").join(name)).unwrap();
        }
        place.configure("");
        place
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.0.path().join(name)
    }

    fn configure(&self, more: &str) {
        let camera =
            "[camera]\nkind = \"replay\"\nfolder = \"frames\"\n[store]\npath = \"store\"\n";
        std::fs::write(self.path("wingd.toml"), format!("{camera}{more}")).unwrap();
    }

    fn check(&self) -> (Option<i32>, String) {
        finished(&["check", "--config", text(&self.path("wingd.toml"))])
    }

    fn check_installation(&self) -> (Option<i32>, String) {
        finished(&["check", "--installation", text(&self.path("installation"))])
    }
}

#[test]
fn pipes_devices_folders_and_huge_files_are_refused_by_name() {
    let place = Place::new(1);
    let key = place.path("key");
    make_pipe(&key);
    for (more, words) in [
        (
            "[serve]\nlisten = \"0.0.0.0:0\"\ntoken_file = \"/dev/zero\"\n",
            "is a device, not a regular file",
        ),
        (
            "[serve]\nlisten = \"0.0.0.0:0\"\ntoken_file = \"key\"\n",
            "is a pipe, not a regular file",
        ),
        (
            "[serve]\nlisten = \"0.0.0.0:0\"\ntoken_file = \"frames\"\n",
            "is a folder, not a file",
        ),
        (
            "[serve]\nlisten = \"127.0.0.1:0\"\ncertificate = \"key\"\nkey = \"key\"\n",
            "is a pipe, not a regular file",
        ),
    ] {
        place.configure(more);
        let (status, printed) = place.check();
        assert!(
            status == Some(78) && printed.contains(words),
            "{more}: {printed}"
        );
    }
    // Recording matters more than signing.
    place.configure(
        "signing_key = \"key\"\n[series]\nshots = 1\nuntil = \"3s\"\n[status]\nsocket = \"s\"\n",
    );
    let (_, printed) = finished(&["run", "--config", text(&place.path("wingd.toml"))]);
    assert!(
        printed.contains("is a pipe, not a regular file"),
        "{printed}"
    );
    assert!(place.path("store/flights/f0001").exists(), "{printed}");
    for name in ["survey.csv", "camera.toml", "installation.toml"] {
        let place = Place::new(1);
        let file = place.path("installation").join(name);
        std::fs::remove_file(&file).unwrap();
        make_pipe(&file);
        let (status, printed) = place.check_installation();
        assert!(
            status == Some(78) && printed.contains(name) && printed.contains("is a pipe"),
            "{name}: {printed}"
        );
    }
    let huge = std::fs::File::create(place.path("installation/survey.csv")).unwrap();
    huge.set_len(2_000_000_000).unwrap();
    let (status, printed) = place.check_installation();
    assert!(
        status == Some(78) && printed.contains("has more than 16 MB: 2000 MB"),
        "{printed}"
    );
}

#[test]
fn a_value_of_the_wrong_type_is_named_by_its_line_in_every_section() {
    let place = Place::new(1);
    for (config, words) in [
        (
            "[camera]\nkind = \"gphoto\"\n[camera.settings]\niso = \"100\"\naperture = 8\n[store]\npath = \"store\"\n",
            "line 5 (`aperture = 8`): is 8, but a text in quotes is expected; write `aperture = \"8\"`",
        ),
        (
            "[camera]\nkind = \"v4l\"\ncard = \"x\"\nformat = \"GREY\"\nwidth = \"4000\"\nheight = 3000\n[store]\npath = \"store\"\n",
            "line 5 (`width = \"4000\"`): is \"4000\", but a whole number is expected; write `width = 4000`",
        ),
        (
            "[camera]\nkind = \"release\"\n[camera.full_press]\nname = 17\n[camera.frames]\nkind = \"folder\"\npath = \"card\"\n[store]\npath = \"store\"\n",
            "line 4 (`name = 17`): is 17, but a text in quotes is expected; write `name = \"17\"`",
        ),
        (
            "[camera]\nkind = \"release\"\n[camera.full_press]\nname = \"GPIO17\"\n[camera.frames]\nkind = \"folder\"\npath = 3\n[store]\npath = \"store\"\n",
            "line 7 (`path = 3`): is 3, but a text in quotes is expected; write `path = \"3\"`",
        ),
        (
            "[camera]\nkind = \"replay\"\nfolder = \"frames\"\n[series]\ninterval = 60\n[store]\npath = \"store\"\n",
            "line 5 (`interval = 60`): is 60, but a duration in quotes is expected; write `interval = \"60s\"`",
        ),
        (
            "[camera]\nkind = \"replay\"\nfolder = \"frames\"\n[series]\nshots = -1\n[store]\npath = \"store\"\n",
            "line 5 (`shots = -1`): is -1, but a whole number is expected; write it as in `shots = 10`",
        ),
        (
            "[camera]\nkind = \"replay\"\nfolder = \"frames\"\nloop = \"yes\"\n[store]\npath = \"store\"\n",
            "line 4 (`loop = \"yes\"`): is \"yes\", but true or false is expected; write it as in `loop = true`",
        ),
        (
            "[camera]\nkind = \"replay\"\nfolders = \"frames\"\n[store]\npath = \"store\"\n",
            "line 3 (`folders = \"frames\"`): unknown field `folders`",
        ),
        (
            "[camera]\nkind = \"webcam\"\n[store]\npath = \"store\"\n",
            "line 2 (`kind = \"webcam\"`): unknown variant `webcam`",
        ),
        (
            "[camera]\nfolder = \"frames\"\n[store]\npath = \"store\"\n",
            "line 1 (`[camera]`): needs a text as `kind`",
        ),
    ] {
        std::fs::write(place.path("wingd.toml"), config).unwrap();
        let (status, printed) = place.check();
        assert!(
            status == Some(78) && printed.contains(words),
            "{words}\n{printed}"
        );
    }
}

#[test]
fn a_socket_that_cannot_be_bound_fails_in_check_and_run() {
    let place = Place::new(1);
    let long = format!("/run/{}.sock", "y".repeat(100));
    for section in ["status", "live"] {
        place.configure(&format!("[{section}]\nsocket = \"{long}\"\n"));
        let words = format!(
            "{section}.socket: {long} has 110 bytes, but the path of a socket can have 107"
        );
        for command in ["check", "run"] {
            let config = place.path("wingd.toml");
            let (status, printed) = finished(&[command, "--config", text(&config)]);
            assert!(
                status == Some(78) && printed.contains(&words),
                "{command}: {printed}"
            );
        }
    }
}

#[test]
fn a_short_replay_loops_without_stale_frames() {
    let place = Place::new(3);
    place.configure("[series]\nshots = 8\ngap = \"0s\"\ninterval = \"1h\"\nuntil = \"8s\"\nretries = 0\n[status]\nsocket = \"s\"\n");
    let (_, printed) = finished(&["run", "--config", text(&place.path("wingd.toml"))]);
    assert!(!printed.contains("repeats an old frame"), "{printed}");
    let folder = place.path("store/flights/f0001");
    let series = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let manifest = series
        .map(|path| path.join("series.json"))
        .find(|file| file.exists());
    let manifest: Value =
        serde_json::from_slice(&std::fs::read(manifest.unwrap()).unwrap()).unwrap();
    let frames = manifest["shots"].as_array().unwrap().iter();
    assert_eq!(
        frames.filter(|shot| shot["frame"].is_object()).count(),
        8,
        "{manifest}"
    );
}

/// The survey of the installation, with its header and a line replaced.
fn with_survey(place: &Place, change: impl Fn(String) -> String) -> (Option<i32>, String) {
    let file = place.path("installation/survey.csv");
    let survey = std::fs::read_to_string(fixture("dev/installation/survey.csv")).unwrap();
    std::fs::write(file, change(survey)).unwrap();
    place.check_installation()
}

#[test]
fn columns_of_the_survey_that_are_not_read_are_named_or_refused() {
    let place = Place::new(1);
    let with_column = |name: &str, cell: &str| {
        with_survey(&place, |survey| {
            let header = survey
                .lines()
                .find(|line| line.starts_with("id,"))
                .unwrap()
                .to_owned();
            let lines = survey
                .lines()
                .filter(|line| !line.starts_with('#'))
                .map(|line| {
                    let more = if line == header { name } else { cell };
                    format!("{line},{more}\n")
                });
            lines.collect()
        })
    };
    for (name, words) in [
        ("Part", "column Part: is not read, but part is; write part"),
        (
            "flight_motion_mm",
            "column flight_motion_mm: is not read, but flight_motion_m is",
        ),
        (
            "sigma_z_m",
            "column sigma_z_m: is a standard deviation that is not read",
        ),
    ] {
        let (status, printed) = with_column(name, "");
        assert!(
            status == Some(78) && printed.contains(words),
            "{words}: {printed}"
        );
    }
    let (status, printed) = with_column("surface", "upper");
    assert!(
        status == Some(0) && printed.contains("columns that are not read: surface"),
        "{printed}"
    );
}

#[test]
fn one_slip_in_the_survey_names_its_point() {
    let place = Place::new(1);
    let slip = |column: usize, factor: f64| {
        with_survey(&place, |survey| {
            let line = |line: &str| {
                let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
                if cells[0] == "M05" {
                    cells[column] = format!("{}", factor + cells[column].parse::<f64>().unwrap());
                }
                cells.join(",") + "\n"
            };
            survey.lines().map(line).collect()
        })
    };
    // Columns 3 to 5 are x_m, y_m, z_m.
    for (column, shift_m) in [(5, 40.0), (3, 400.0), (4, -400.0)] {
        let (status, printed) = slip(column, shift_m);
        assert!(
            status == Some(78)
                && printed.contains("marker \"M05\": is at [")
                && !printed.contains("metres, not millimetres")
                && !printed.contains("seems to be the height"),
            "{column}: {printed}"
        );
    }
    let sideways = [3, 4].map(|column| slip(column, 30.0).1);
    assert!(
        sideways
            .iter()
            .any(|printed| printed.contains("marker \"M05\": is")
                && printed.contains("off the line of the other markers, as seen from above")),
        "{sideways:?}"
    );
    // A slip of all is one of units.
    let (_, printed) = with_survey(&place, |survey| {
        let line = |line: &str| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            for cell in cells.iter_mut().skip(3).take(3) {
                if let Ok(value) = cell.parse::<f64>() {
                    *cell = format!("{}", 1000.0 * value);
                }
            }
            cells.join(",") + "\n"
        };
        survey.lines().map(line).collect()
    });
    assert!(
        printed.contains("give metres, not millimetres"),
        "{printed}"
    );
}

#[test]
fn times_given_for_images_reach_the_report_and_unknown_ones_are_not_1970() {
    let place = Place::new(2);
    let (store, report) = (place.path("given"), place.path("report.html"));
    let frames = place.path("frames");
    let start = ["--start", "2026-06-01T08:00:00Z", "--every", "2s"];
    let take = [
        &["import", text(&frames), "--store", text(&store)][..],
        &start,
    ]
    .concat();
    assert_eq!(outcome(&take).0, Some(0));
    let made = outcome(&["report", text(&store), "--output", text(&report)]);
    assert_eq!(made.0, Some(0), "{}", made.1);
    let html = std::fs::read_to_string(&report).unwrap();
    assert!(
        html.contains("2026-06-01 08:00") && !html.contains("1970-01-01"),
        "no start time"
    );
}
