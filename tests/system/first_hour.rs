//! Promise: from images on a card, a survey and images of a board to a report in four commands; a card is imported once,
//! after any interruption; manual observations are used together with detections.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;
use wingd::store::verify::verify_path;
use wingd::store::{RealDisk, catalogue};

use crate::program::{all_output, fixture, run_in as wingd, run_in_folder as done};

fn lines(text: &str) -> Vec<Value> {
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// An Exif block with `DateTimeOriginal`, `SubSecTimeOriginal` and, if given, `OffsetTimeOriginal`.
fn exif(time: &str, parts: &str, zone: Option<&str>) -> Vec<u8> {
    let entries: u8 = if zone.is_some() { 3 } else { 2 };
    let texts = 26 + 2 + 12 * u32::from(entries) + 4;
    let mut tiff = b"MM\0\x2a\0\0\0\x08".to_vec();
    tiff.extend([0, 1, 0x87, 0x69, 0, 4, 0, 0, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0]);
    tiff.extend([0, entries, 0x90, 0x03, 0, 2, 0, 0, 0, 20]);
    tiff.extend(texts.to_be_bytes());
    if zone.is_some() {
        tiff.extend([0x90, 0x11, 0, 2, 0, 0, 0, 7]);
        tiff.extend((texts + 20).to_be_bytes());
    }
    tiff.extend([0x92, 0x91, 0, 2, 0, 0, 0, 4]);
    tiff.extend(format!("{parts:0<3}\0").bytes().take(4));
    tiff.extend([0; 4]);
    tiff.extend(time.bytes().chain([0]));
    tiff.extend(zone.into_iter().flat_map(|z| z.bytes().chain([0])));
    let length = u16::try_from(tiff.len() + 8).unwrap().to_be_bytes();
    [&[0xFF, 0xE1], &length[..], b"Exif\0\0", &tiff].concat()
}

/// An image with that block after its first marker, and its own bytes after its end.
fn picture(from: &Path, to: &Path, block: &[u8], tail: &[u8]) {
    let bytes = std::fs::read(from).unwrap();
    std::fs::write(to, [&bytes[..2], block, &bytes[2..], tail].concat()).unwrap();
}

fn flight_frame(number: usize) -> PathBuf {
    fixture("dev/frames").join(format!("flight-{number}.jpg"))
}

/// The fixture's installation with its orientation, in `folder`.
fn oriented(folder: &Path) {
    std::fs::create_dir(folder.join("installation")).unwrap();
    for name in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            folder.join("installation").join(name),
        )
        .unwrap();
    }
    done(
        folder,
        &["orient", fixture("dev/frames/ground.jpg").to_str().unwrap()],
    );
}

#[test]
fn four_commands_lead_from_a_card_and_a_board_to_the_report() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    done(here, &["init"]);
    for file in std::fs::read_dir(here.join("installation")).unwrap() {
        std::fs::remove_file(file.unwrap().path()).unwrap();
    }
    std::fs::remove_dir(here.join("installation")).unwrap();
    // The aircraft, the survey and the photographer.
    let deflections = "2.4,2.2,2.0,1.8,1.6,1.4";
    let size = [
        "--size",
        "1600",
        "1200",
        "--focal",
        "1400",
        "--board",
        "board.toml",
    ];
    done(
        here,
        &[
            &[
                "simulate",
                "--output",
                ".",
                "--seed",
                "4",
                "--tip-deflections",
                deflections,
            ],
            &size[..],
        ]
        .concat(),
    );
    std::fs::create_dir(here.join("card")).unwrap();
    for k in 1..=6 {
        let time = format!("2026:03:01 09:0{}:00", k / 4);
        let block = exif(&time, &format!("{k}0"), Some("+02:00"));
        let name = here.join(format!("card/IMG_{k:04}.JPG"));
        picture(
            &here.join(format!("frames/flight-{k}.jpg")),
            &name,
            &block,
            &[],
        );
    }
    done(
        here,
        &[
            "calibrate",
            "--board",
            "board.toml",
            "--output",
            "installation/camera.toml",
            "board",
        ],
    );
    done(here, &["orient", "frames/ground.jpg"]);
    let imported = done(
        here,
        &[
            "import",
            "card",
            "--store",
            "store",
            "--installation",
            "installation",
            "--json",
        ],
    );
    done(here, &["solve", "store", "--report", "report.html"]);
    let series = lines(&imported);
    assert_eq!(series.len(), 2, "{imported}");
    assert_eq!(
        (&series[0]["taken"], &series[1]["taken"]),
        (&3.into(), &3.into()),
        "{imported}"
    );
    assert_eq!(series[0]["began"], "2026-03-01T07:00:00.1Z");
    assert_eq!(series[0]["sources"][0], "IMG_0001.JPG");
    let page = std::fs::read_to_string(here.join("report.html")).unwrap();
    assert!(
        page.contains("IMG_0006.JPG") && page.contains("6 of 6"),
        "every frame is in the report, solved"
    );
    let report = verify_path(&RealDisk, &here.join("store"));
    assert!(
        report.is_sound() && report.frames == 6 && report.results == 6,
        "{report:#?}"
    );
    // An imported flight supports the same commands as a recorded one.
    let table = done(
        here,
        &["export", "store", "--format", "csv", "--table", "shots"],
    );
    assert_eq!(table.lines().count(), 7, "{table}");
    done(here, &["copy", "store", "away"]);
    // Nothing is copied twice.
    let again = done(here, &["import", "card", "--store", "store", "--json"]);
    assert!(
        lines(&again)
            .iter()
            .all(|s| s["taken"] == 0 && s["already"] == 3),
        "{again}"
    );
    // Without a store, from the folder itself.
    done(here, &["solve", "card", "--report", "pictures.html"]);
    assert!(
        std::fs::read_to_string(here.join("pictures.html"))
            .unwrap()
            .contains("6 of 6")
    );
}

#[test]
fn an_import_interrupted_by_removing_the_card_is_completed_later() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let count = 40;
    std::fs::create_dir(here.join("card")).unwrap();
    for k in 0..count {
        let block = exif(&format!("2026:03:01 09:00:{k:02}"), "5", None);
        let name = here.join(format!("card/P{k}.jpg"));
        picture(&flight_frame(1 + k % 5), &name, &block, &[]);
    }
    let mut child = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(["import", "card", "--store", "store"])
        .current_dir(here)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begun = here.join("store/incoming/s000001/0003.jpg");
    while !begun.exists() && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let again = wingd(here, &["import", "card", "--store", "store"]);
    assert!(again.status.success(), "{}", all_output(&again));
    let zone = all_output(&again);
    assert!(
        zone.contains("have no time zone: assumed UTC") && zone.contains("--zone"),
        "{zone}"
    );
    let report = verify_path(&RealDisk, &here.join("store"));
    assert!(report.is_sound() && report.frames == count, "{report:#?}");
    let flights = catalogue::list_flights(&RealDisk, &here.join("store")).unwrap();
    assert_eq!(flights.len(), 1, "one flight, though it was broken off");
    let mut names: Vec<String> = Vec::new();
    for series in catalogue::list_series(&RealDisk, &flights[0]).unwrap() {
        let manifest = catalogue::read_series_manifest(&RealDisk, &series).unwrap();
        names.extend(
            manifest
                .frames()
                .map(|f| f.settings["source"].as_str().unwrap().to_owned()),
        );
    }
    let wanted: Vec<String> = (0..count).map(|k| format!("P{k}.jpg")).collect();
    assert_eq!(names, wanted, "each once, in order, under its name");
}

#[test]
fn information_missing_from_images_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::create_dir(here.join("card")).unwrap();
    for (k, name) in ["P10.jpg", "P9.jpg"].into_iter().enumerate() {
        picture(
            &flight_frame(1 + k),
            &here.join("card").join(name),
            &[],
            &[],
        );
    }
    std::fs::write(here.join("card/notes.txt"), "window 14").unwrap();
    std::fs::copy(here.join("card/P9.jpg"), here.join("card/copy of P9.jpg")).unwrap();
    let undated = wingd(
        here,
        &[
            "import",
            "card",
            "card/notes.txt",
            "--store",
            "store",
            "--json",
        ],
    );
    assert_eq!(
        undated.status.code(),
        Some(1),
        "a file could not be taken: {}",
        all_output(&undated)
    );
    let text = all_output(&undated);
    for words in [
        "images have no time",
        "notes.txt: is not a supported image",
        "imported once",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let series: Value = serde_json::from_slice(undated.stdout.trim_ascii_end()).unwrap();
    assert_eq!(
        (&series["taken"], &series["began"]),
        (&2.into(), &Value::Null),
        "{series}"
    );
    assert_eq!(series["sources"], serde_json::json!(["P9.jpg", "P10.jpg"]));
    let table = done(here, &["report", "store", "--output", "undated.html"]);
    let page = std::fs::read_to_string(here.join("undated.html")).unwrap();
    assert!(
        !table.contains("1970-01") && !page.contains("1970-01") && page.contains("times unknown"),
        "{table}"
    );
    let dated = [
        "--start",
        "2026-03-01T08:00:00Z",
        "--every",
        "10s",
        "--flight",
        "TF 103",
        "--json",
    ];
    let dated = done(
        here,
        &[&["import", "card", "--store", "named"], &dated[..]].concat(),
    );
    assert_eq!(lines(&dated)[0]["ended"], "2026-03-01T08:00:10Z", "{dated}");
    let shown = wingd(here, &["report", "named", "--flight", "TF 103"]);
    assert!(
        shown.status.success(),
        "a flight is found by its name: {}",
        all_output(&shown)
    );
    let missing = wingd(
        here,
        &["import", "card", "--store", "named", "--flight", "f0009"],
    );
    assert!(
        missing.status.code() == Some(1)
            && all_output(&missing).contains("there is no flight f0009")
    );
    std::fs::create_dir(here.join("empty")).unwrap();
    let empty = wingd(here, &["import", "empty", "--store", "store"]);
    assert!(
        empty.status.code() == Some(1) && all_output(&empty).contains("contains no images"),
        "{}",
        all_output(&empty)
    );
}

#[test]
fn manual_observations_are_used_with_detections() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    oriented(here);
    let frame = flight_frame(1).to_str().unwrap().to_owned();
    let other = flight_frame(2).to_str().unwrap().to_owned();
    let plain = &lines(&done(here, &["solve", "--json", &frame]))[0];
    let marker = |record: &Value, id: &str| {
        record["markers"]
            .as_array()
            .unwrap()
            .iter()
            .find(|m| m["id"] == id)
            .unwrap()
            .clone()
    };
    let m05 = marker(plain, "M05");
    let [u, v] = ["u_px", "v_px"].map(|key| m05[key].as_f64().unwrap());
    let file = here.join("hand.csv");
    std::fs::write(
        &file,
        format!("id,u_px,v_px,sigma_px\nM05,{},{},2\n", u + 0.5, v),
    )
    .unwrap();
    let beside = &lines(&done(
        here,
        &["solve", "--json", "--observations", "hand.csv", &frame],
    ))[0];
    let moved = marker(beside, "M05");
    assert!(
        (moved["u_px"].as_f64().unwrap() - u - 0.5).abs() < 1e-6,
        "the manual observation is used: {moved}"
    );
    assert_eq!(moved["sigma_u_px"], 2.0);
    assert_eq!(
        marker(beside, "M06")["u_px"],
        marker(plain, "M06")["u_px"],
        "the others are the detector's"
    );
    // Manual observations only.
    let all: String = plain["markers"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|m| m["used"] == true)
        .map(|m| {
            format!(
                "{},{},{},0.1,flight-1.jpg\n",
                m["id"].as_str().unwrap(),
                m["u_px"],
                m["v_px"]
            )
        })
        .collect();
    std::fs::write(&file, format!("id,u_px,v_px,sigma_px,image\n{all}")).unwrap();
    let only = [
        "solve",
        "--json",
        "--observations",
        "hand.csv",
        "--observations-only",
        &frame,
    ];
    let only = &lines(&done(here, &only))[0];
    assert_eq!(marker(only, "M06")["sigma_u_px"], 0.1, "{only}");
    let deflection = |record: &Value| record["tip"]["deflection_m"].as_f64().unwrap();
    assert!(
        (deflection(only) - deflection(plain)).abs() < 0.05,
        "{} {}",
        deflection(only),
        deflection(plain)
    );
    // With several images each point names its image.
    let both = lines(&done(
        here,
        &[
            "solve",
            "--json",
            "--observations",
            "hand.csv",
            &frame,
            &other,
        ],
    ));
    assert!(both.len() == 2 && marker(&both[1], "M06")["sigma_u_px"] != 0.1);
    std::fs::write(&file, "id,u_px,v_px,sigma_px\nM05,100,100,2\n").unwrap();
    let unnamed = wingd(
        here,
        &["solve", "--observations", "hand.csv", &frame, &other],
    );
    assert!(
        unnamed.status.code() == Some(78) && all_output(&unnamed).contains("column image"),
        "{}",
        all_output(&unnamed)
    );
}

#[test]
fn everything_missing_from_a_new_installation_is_reported_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let none = wingd(here, &["check"]);
    assert!(
        none.status.code() == Some(2) && all_output(&none).contains("wingd init"),
        "{}",
        all_output(&none)
    );
    done(here, &["init"]);
    assert!(here.join("installation.svg").exists());
    let fresh = wingd(here, &["check", "--json"]);
    assert_eq!(fresh.status.code(), Some(78), "{}", all_output(&fresh));
    let found: Value = serde_json::from_slice(&fresh.stdout).unwrap();
    let places: Vec<&str> = found["faults"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["place"].as_str().unwrap())
        .collect();
    let blanks = [
        "name",
        "camera.projection_centre_m",
        "wing.span_direction",
        "wing.side",
        "wing.root_offset_m",
    ];
    for place in blanks.iter().chain(&["camera"]) {
        assert!(places.contains(place), "{place}: {places:?}");
    }
    let files: Vec<&str> = found["faults"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["file"].as_str().unwrap())
        .collect();
    for name in ["camera.toml", "survey.csv"] {
        assert!(
            files.iter().any(|file| file.ends_with(name)),
            "{name}: {files:?}"
        );
    }
}
