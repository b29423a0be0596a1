//! Promise: the joint shape of a flight leaves the program with its covariance, in files that others read, and measured
//! shapes are compared with it.

use std::path::Path;

use netcdf3::FileReader;
use serde_json::Value;

use crate::program::{fixture, run, stdout};

/// A store with the flight of the fixture, solved jointly, with the direction of the flow.
fn solved_store(folder: &Path, jointly: bool) -> String {
    solved_store_with(folder, jointly, "", 1..=3)
}

/// The same with another line of the wing's section, and with other frames.
fn solved_store_with(
    folder: &Path,
    jointly: bool,
    line: &str,
    frames: std::ops::RangeInclusive<usize>,
) -> String {
    let key = line.split(' ').next().unwrap();
    let replaced = |old: &str| {
        if !key.is_empty() && old.starts_with(key) {
            line.to_owned()
        } else {
            old.to_owned()
        }
    };
    solved_store_of(folder, jointly, frames, |installation| {
        let toml = installation.join("installation.toml");
        let text = std::fs::read_to_string(&toml).unwrap();
        std::fs::write(
            &toml,
            text.lines().map(replaced).collect::<Vec<_>>().join("\n"),
        )
        .unwrap();
    })
}

/// The same, solved jointly, with a changed installation.
fn solved_store_changed(folder: &Path, change: impl FnOnce(&Path)) -> String {
    solved_store_of(folder, true, 1..=3, change)
}

fn solved_store_of(
    folder: &Path,
    jointly: bool,
    frames_of: std::ops::RangeInclusive<usize>,
    change: impl FnOnce(&Path),
) -> String {
    let installation = folder.join("installation");
    std::fs::create_dir(&installation).unwrap();
    for entry in std::fs::read_dir(fixture("dev/installation")).unwrap() {
        let from = entry.unwrap().path();
        std::fs::copy(&from, installation.join(from.file_name().unwrap())).unwrap();
    }
    change(&installation);
    let toml = installation.join("installation.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    // The span is (0.390731, 0.920505): right wing, swept by 28 degrees.
    std::fs::write(
        &toml,
        text.replace(
            "[wing]\n",
            "[wing]\nflow_direction = [0.996195, 0.087156]\n",
        ),
    )
    .unwrap();
    let (installation, store) = (installation.to_str().unwrap(), folder.join("store"));
    let (frames, store) = (fixture("dev/frames"), store.to_str().unwrap().to_owned());
    stdout(&[
        "orient",
        "--installation",
        installation,
        frames.join("ground.jpg").to_str().unwrap(),
    ]);
    let flight: Vec<String> = frames_of
        .map(|k| {
            frames
                .join(format!("flight-{k}.jpg"))
                .to_str()
                .unwrap()
                .to_owned()
        })
        .collect();
    let images: Vec<&str> = flight.iter().map(String::as_str).collect();
    stdout(
        &[
            &["import"],
            &images[..],
            &["--store", &store, "--installation", installation],
        ]
        .concat(),
    );
    let together: &[&str] = if jointly { &[] } else { &["--single"] };
    stdout(&[&["solve", &store], together].concat());
    store
}

fn records(store: &str) -> Vec<Value> {
    let lines = stdout(&["export", store, "--format", "jsonl"]);
    lines
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap())
        .collect()
}

#[test]
fn the_exported_covariance_is_that_of_the_results() {
    for jointly in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let store = solved_store(folder.path(), jointly);
        let file = folder.path().join("shape.nc");
        stdout(&[
            "export",
            &store,
            "--format",
            "netcdf",
            "--output",
            file.to_str().unwrap(),
        ]);
        let mut reader = FileReader::open(&file).unwrap();
        let mut read = |name: &str| reader.read_var_f64(name).unwrap();
        let (arcs, sigma) = (read("arc_length"), read("sigma_displacement"));
        let (slope, streamwise) = (read("sigma_slope"), read("sigma_streamwise_twist"));
        let (moved, turned) = (read("displacement"), read("streamwise_twist"));
        let records = records(&store);
        assert_eq!(sigma.len(), records.len() * arcs.len() * 3);
        for (k, record) in records.iter().enumerate() {
            let curve = record["record"]["curve"].as_array().unwrap();
            assert_eq!(curve.len() + 1, arcs.len(), "and the tip of the model");
            for (s, point) in curve.iter().enumerate() {
                let at = k * arcs.len() + s;
                let compare = |field: &str, value: f64| {
                    let there = point[field].as_f64().unwrap();
                    // Two ways to one number: rounding, of the covariance's size.
                    assert!(
                        (there - value).abs() < 1e-9 + 1e-7 * there.abs(),
                        "{field} of station {s}: {there}, {value}"
                    );
                };
                compare("arc_length_m", arcs[s]);
                compare("deflection_m", moved[3 * at + 2]);
                compare("sigma_deflection_m", sigma[3 * at + 2]);
                compare("sigma_slope_deg", slope[at].to_degrees());
                compare("streamwise_twist_deg", turned[at].to_degrees());
                compare("sigma_streamwise_twist_deg", streamwise[at].to_degrees());
            }
        }
        if jointly {
            let (shared, own) = (read("displacement_shared"), read("displacement_own"));
            assert!(shared.len() > sigma.len() && own.len() > sigma.len());
            assert!(read("displacement_lasting").iter().all(|v| v.is_finite()));
        }
        // Nothing is left of an export that fails.
        let before = std::fs::read(&file).unwrap();
        let wrong = run(&[
            "export",
            &store,
            "--format",
            "netcdf",
            "--inputs",
            "zzz",
            "-o",
            file.to_str().unwrap(),
        ]);
        assert_eq!(
            (wrong.status.code(), std::fs::read(&file).unwrap() == before),
            (Some(1), true)
        );
    }
}

#[test]
fn an_archive_of_numpy_arrays_describes_itself() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store(folder.path(), true);
    let file = folder.path().join("shape.npz");
    stdout(&[
        "export",
        &store,
        "--format",
        "npz",
        "--eta",
        "0.5,1",
        "--output",
        file.to_str().unwrap(),
    ]);
    let mut archive = zip::ZipArchive::new(std::fs::File::open(&file).unwrap()).unwrap();
    let mut read = |name: &str| {
        let mut bytes = Vec::new();
        std::io::copy(
            &mut archive.by_name(&format!("{name}.npy")).unwrap(),
            &mut bytes,
        )
        .unwrap();
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!(data % 64, 0);
        (
            String::from_utf8(bytes[10..data].to_vec()).unwrap(),
            bytes[data..].to_vec(),
        )
    };
    let (header, values) = read("displacement");
    assert!(
        header.contains("'descr': '<f8', 'fortran_order': False, 'shape': (3, 2, 3, )"),
        "{header}"
    );
    assert_eq!(values.len(), 3 * 2 * 3 * 8);
    let description: Value = serde_json::from_slice(&read("description").1).unwrap();
    assert!(
        description["attributes"]["errors"]
            .as_str()
            .unwrap()
            .contains("lasting u")
    );
    assert_eq!(description["arrays"]["slope"]["unit"], "rad");
}

#[test]
fn shapes_are_compared_with_each_other_and_with_a_computation() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store(folder.path(), true);
    let frame = |k: usize| format!("{store}:f0001/s000001/{k:04}.jpg");
    let compare = |more: &[&str]| -> Value {
        serde_json::from_str(&stdout(&[&["difference", "--json"], more].concat())).unwrap()
    };
    let difference = compare(&[&frame(1), &frame(2), "--eta", "0.5,0.9"]);
    let records = records(&store);
    let tip = |k: usize| {
        records[k]["record"]["tip"]["sigma_deflection_m"]
            .as_f64()
            .unwrap()
    };
    let sigma = difference["stations"][1]["sigma_displacement_z_m"]
        .as_f64()
        .unwrap();
    assert!(
        sigma < 0.5 * tip(0),
        "what the frames share cancels: {sigma} of {}",
        tip(0)
    );
    assert!(
        difference["p"].as_f64().unwrap() < 1e-6,
        "the wing bends differently"
    );
    let point = &records[0]["record"]["curve"][20];
    let table = folder.path().join("computed.csv");
    let write = |factor: f64| {
        let (arc, moved) = (
            point["arc_length_m"].as_f64().unwrap(),
            point["deflection_m"].as_f64().unwrap(),
        );
        std::fs::write(
            &table,
            format!("arc_length_m,displacement_z_m\n{arc},{}\n", factor * moved),
        )
        .unwrap();
        compare(&[&frame(1), "--against", table.to_str().unwrap()])
    };
    let same = write(1.0);
    assert_eq!(same["freedom"], 1);
    assert!(same["p"].as_f64().unwrap() > 0.999, "{same}");
    assert!(write(1.5)["p"].as_f64().unwrap() < 1e-6);
    let mean = stdout(&["mean", &store, "--eta", "0.5,0.9", "--json"]);
    let mean: Value = serde_json::from_str(&mean).unwrap();
    assert_eq!(mean["frames"], 3);
    let of = |name: &str| mean["stations"][1][name].as_f64().unwrap();
    assert!(
        of("sigma_displacement_z_m") > 0.9 * tip(0) * 0.7,
        "a mean of frames with common errors is no better"
    );
    assert!(of("scatter_displacement_z_m") > 0.1, "the frames differ");
    let refused = [
        (vec![frame(1), frame(1)], "have a frame in common"),
        (vec![frame(1), frame(2), "--mirror".into()], "omit --mirror"),
        (
            vec![format!("{store}:f0009"), frame(2)],
            "there is no flight f0009",
        ),
        (vec![frame(1)], "required"),
        (
            vec![frame(1), frame(2), "--where".into(), "match < 1".into()],
            "there is no quantity \"match\"",
        ),
        (
            vec![frame(1), frame(2), "--where".into(), "mach < 1".into()],
            "no frame with this name and these conditions",
        ),
    ];
    for (arguments, text) in refused {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let ended = run(&[&["difference"], &arguments[..]].concat());
        let error = String::from_utf8(ended.stderr).unwrap();
        assert!(
            ended.status.code() != Some(0) && error.contains(text),
            "{error}"
        );
    }
    // Of a mean it must be known which errors do not become smaller.
    let refused_mean = |others: &[&str], text: &str| {
        let ended = run(&[&["mean", &frame(1)], others].concat());
        let error = String::from_utf8(ended.stderr).unwrap();
        assert!(
            ended.status.code() == Some(1) && error.contains(text),
            "{error}"
        );
    };
    refused_mean(&[&frame(2)], "several names are of one flight");
    refused_mean(&[&frame(1)], "a frame is named twice");
    let other = tempfile::tempdir().unwrap();
    let elsewhere = solved_store_with(other.path(), true, "root_offset_m = 0.56", 4..=5);
    refused_mean(&[&elsewhere], "different installations");
    let next = tempfile::tempdir().unwrap();
    let next = solved_store_with(next.path(), true, "", 4..=5);
    let both: Value =
        serde_json::from_str(&stdout(&["mean", &store, &next, "--eta", "0.9", "--json"])).unwrap();
    assert_eq!(both["frames"], 5);
    let alone = tempfile::tempdir().unwrap();
    let singly = solved_store(alone.path(), false);
    let ended = run(&[
        "difference",
        &format!("{singly}:f0001/s000001/0001.jpg"),
        &format!("{singly}:f0001/s000001/0002.jpg"),
    ]);
    assert!(
        String::from_utf8(ended.stderr)
            .unwrap()
            .contains("solve STORE --flight")
    );
}

#[test]
fn displacements_are_given_in_cad_axes_with_the_errors_of_the_fit() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store_changed(folder.path(), |installation| {
        // CAD: x aft is the survey's -y, y is its x; moved.
        let mut ties = "id,x_m,y_m,z_m,cad_x_m,cad_y_m,cad_z_m\n".to_owned();
        for (k, p) in [
            [0.0, 0.0, 0.0],
            [12.0, 1.0, 0.5],
            [3.0, 20.0, 1.0],
            [5.0, 9.0, 4.0],
            [14.0, 17.0, 2.0],
        ]
        .iter()
        .enumerate()
        {
            let [x, y, z] = p;
            ties += &format!("T{k},{x},{y},{z},{},{},{}\n", 5.0 - y, x + 1.0, z - 2.0);
        }
        std::fs::write(installation.join("ties.csv"), ties).unwrap();
        let toml = installation.join("installation.toml");
        let text = std::fs::read_to_string(&toml).unwrap();
        std::fs::write(
            &toml,
            format!("{text}\n[cad]\ntie_points = \"ties.csv\"\nsigma_m = 0.01\n"),
        )
        .unwrap();
    });
    let file = folder.path().join("shape.nc");
    stdout(&[
        "export",
        &store,
        "--format",
        "netcdf",
        "--eta",
        "0.5,1",
        "-o",
        file.to_str().unwrap(),
    ]);
    let mut reader = FileReader::open(&file).unwrap();
    let mut read = |name: &str| reader.read_var_f64(name).unwrap();
    for name in ["displacement", "marker_displacement"] {
        let (survey, cad) = (read(name), read(&format!("{name}_cad")));
        for (there, here) in survey.chunks(3).zip(cad.chunks(3)) {
            let wanted = [-there[1], there[0], there[2]];
            assert!(
                here.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6),
                "{here:?} {wanted:?}"
            );
        }
        let (sigma, of_fit) = (
            read(&format!("sigma_{name}_cad")),
            read(&format!("{name}_cad_fit")),
        );
        assert_eq!(of_fit.len(), 4 * cad.len());
        let mut variance = |at: usize| -> f64 {
            let parts = ["lasting", "shared", "own"].map(|part| format!("{name}_cad_{part}"));
            let square = |values: Vec<f64>| -> f64 {
                let sources = values.len() / cad.len();
                values[sources * at..sources * (at + 1)]
                    .iter()
                    .map(|v| v * v)
                    .sum()
            };
            parts.iter().map(|part| square(read(part))).sum::<f64>() + square(of_fit.clone())
        };
        for at in [0, cad.len() - 1] {
            assert!((variance(at).sqrt() - sigma[at]).abs() < 1e-12);
        }
        // A turn by 1 cm over 10 m moves the horizontal part of a displacement of metres by millimetres.
        assert!(
            of_fit.iter().any(|v| v.abs() > 1e-4),
            "the fit is uncertain"
        );
    }
}

#[test]
fn loads_are_made_equal_and_computations_have_errors() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store(folder.path(), true);
    let frame = |k: usize| format!("{store}:f0001/s000001/{k:04}.jpg");
    let compare = |more: &[&str]| -> Value {
        serde_json::from_str(&stdout(
            &[&["difference", "--json", "--eta", "0.5,0.9"], more].concat(),
        ))
        .unwrap()
    };
    let plain = compare(&[&frame(1), &frame(2)]);
    let moved =
        |result: &Value, k: usize| result["stations"][k]["displacement_z_m"].as_f64().unwrap();
    let table = folder.path().join("slope.csv");
    let mut text = "arc_length_m,displacement_z_m,sigma_displacement_z_m\n".to_owned();
    for k in 0..2 {
        let arc = plain["stations"][k]["arc_length_m"].as_f64().unwrap();
        text += &format!("{arc},{},{}\n", 0.5 * moved(&plain, k), 0.001);
    }
    std::fs::write(&table, &text).unwrap();
    let slope = |condition: &str| format!("{}:{condition}", table.display());
    let equal = compare(&[&frame(1), &frame(2), "--slope", &slope("2,0.1")]);
    assert!((0..2).all(|k| moved(&equal, k).abs() < 1e-9), "{equal}");
    let sigma = |result: &Value| {
        result["stations"][1]["sigma_displacement_z_m"]
            .as_f64()
            .unwrap()
    };
    let wanted = sigma(&plain)
        .hypot(0.1 * 0.5 * moved(&plain, 1))
        .hypot(2.0 * 0.001);
    assert!(
        (sigma(&equal) - wanted).abs() < 1e-9,
        "{} {wanted}",
        sigma(&equal)
    );
    assert!(
        equal["p"].as_f64().unwrap() > 0.9 && equal["stations"][0].get("slope_deg").is_none(),
        "{equal}"
    );
    for (condition, text) in [
        (
            "load_factor",
            "a frame has no load_factor; import aircraft data",
        ),
        ("fule_kg", "there is no quantity \"fule_kg\""),
        ("1", "there is no quantity"),
        ("1,-2", "the standard deviation is negative"),
        ("nan,0", "\"nan\" is not a number; write FILE:QUANTITY"),
        ("1,inf", "\"inf\" is not a number"),
        ("load_factor,", "\"load_factor\" is not a number"),
    ] {
        let ended = run(&[
            "difference",
            &frame(1),
            &frame(2),
            "--slope",
            &slope(condition),
            "--eta",
            "0.5,0.9",
        ]);
        let error = String::from_utf8(ended.stderr).unwrap();
        assert!(
            ended.status.code() != Some(0) && error.contains(text),
            "{error}"
        );
    }
    let beyond = run(&[
        "difference",
        &frame(1),
        &frame(2),
        "--slope",
        &slope("1,0"),
        "--eta",
        "1",
    ]);
    assert!(
        String::from_utf8(beyond.stderr)
            .unwrap()
            .contains("has no stations around")
    );
    // A computation with errors of its own is not rejected by them.
    let records = records(&store);
    let point = &records[0]["record"]["curve"][20];
    let of = |name: &str| point[name].as_f64().unwrap();
    let predicted = |sigma: f64| {
        let line = format!(
            "{},{},{sigma}",
            of("arc_length_m"),
            of("deflection_m") + 0.5
        );
        std::fs::write(
            &table,
            format!("arc_length_m,displacement_z_m,sigma_displacement_z_m\n{line}\n"),
        )
        .unwrap();
        let result = stdout(&[
            "difference",
            &frame(1),
            "--against",
            table.to_str().unwrap(),
            "--json",
        ]);
        serde_json::from_str::<Value>(&result).unwrap()["p"]
            .as_f64()
            .unwrap()
    };
    assert!(predicted(0.0) < 1e-6 && predicted(0.5) > 0.1);
    let page = folder.path().join("report.html");
    let report = [
        "report",
        &store,
        "--against",
        table.to_str().unwrap(),
        "-o",
        page.to_str().unwrap(),
    ];
    stdout(&[&report[..], &["--against-frames", "s000001/0001.jpg"]].concat());
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(
        html.contains("Comparison with a computation")
            && html.contains("no significant difference"),
        "the verdict"
    );
    assert!(html.contains("Streamwise twist along the span"));
}

#[test]
fn means_of_series_and_the_summary_are_tables() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store(folder.path(), true);
    let table = |more: &[&str]| -> Vec<std::collections::BTreeMap<String, String>> {
        let text = stdout(&[&["export", &store, "--format", "csv"], more].concat());
        csv::Reader::from_reader(text.as_bytes())
            .deserialize()
            .map(Result::unwrap)
            .collect()
    };
    let summary = table(&[]);
    assert_eq!(summary.len(), 3, "a row per shot");
    let records = records(&store);
    let tip = records[0]["record"]["tip"]["deflection_m"]
        .as_f64()
        .unwrap();
    assert_eq!(summary[0]["tip_deflection_m"].parse::<f64>().unwrap(), tip);
    assert!(
        summary[0].contains_key("angle_of_attack_deg")
            && summary[0].contains_key("torsion_tip_streamwise_twist_deg")
    );
    assert!(summary[0].len() < 70, "{}", summary[0].len());
    let series = table(&["--table", "series", "--eta", "0.5,1"]);
    assert_eq!((series.len(), series[0]["frames"].as_str()), (2, "3"));
    let mean: Value =
        serde_json::from_str(&stdout(&["mean", &store, "--eta", "0.5,1", "--json"])).unwrap();
    for (row, station) in series.iter().zip(mean["stations"].as_array().unwrap()) {
        for name in [
            "displacement_z_m",
            "sigma_displacement_z_m",
            "scatter_displacement_z_m",
            "sigma_twist_deg",
        ] {
            let (there, here) = (
                station[name].as_f64().unwrap(),
                row[name].parse::<f64>().unwrap(),
            );
            assert!((there - here).abs() < 1e-12, "{name}: {there} {here}");
        }
    }
    let file = folder.path().join("table.csv");
    stdout(&[
        "export",
        &store,
        "--format",
        "csv",
        "-o",
        file.to_str().unwrap(),
    ]);
    let before = std::fs::read(&file).unwrap();
    let wrong = run(&[
        "export",
        &store,
        "--format",
        "csv",
        "--inputs",
        "zzz",
        "-o",
        file.to_str().unwrap(),
    ]);
    let kept = std::fs::read(&file).unwrap() == before;
    assert!(
        kept,
        "an export that fails leaves the old file: {:?}",
        wrong.status
    );
    for (arguments, text) in [
        (
            ["--format", "jsonl", "--table", "series"],
            "--table series needs one of these, csv or parquet",
        ),
        (
            ["--format", "csv", "--table", "shape"],
            "--table shape needs --format netcdf or npz",
        ),
    ] {
        let ended = run(&[&["export", &store][..], &arguments].concat());
        assert!(
            ended.status.code() == Some(2)
                && String::from_utf8(ended.stderr).unwrap().contains(text)
        );
    }
}
