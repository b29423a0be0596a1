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
fn solved_store_with(folder: &Path, jointly: bool, line: &str, frames_of: std::ops::RangeInclusive<usize>) -> String {
    let installation = folder.join("installation");
    std::fs::create_dir(&installation).unwrap();
    for entry in std::fs::read_dir(fixture("dev/installation")).unwrap() {
        let from = entry.unwrap().path();
        std::fs::copy(&from, installation.join(from.file_name().unwrap())).unwrap();
    }
    let toml = installation.join("installation.toml");
    let key = line.split(' ').next().unwrap();
    let text = std::fs::read_to_string(&toml).unwrap();
    let replaced = |old: &str| if !key.is_empty() && old.starts_with(key) { line.to_owned() } else { old.to_owned() };
    let text = text.lines().map(replaced).collect::<Vec<_>>().join("\n");
    // The span is (0.390731, 0.920505): right wing, swept by 28 degrees.
    std::fs::write(&toml, text.replace("[wing]\n", "[wing]\nflow_direction = [0.996195, 0.087156]\n")).unwrap();
    let (installation, store) = (installation.to_str().unwrap(), folder.join("store"));
    let (frames, store) = (fixture("dev/frames"), store.to_str().unwrap().to_owned());
    stdout(&["orient", "--installation", installation, frames.join("ground.jpg").to_str().unwrap()]);
    let flight: Vec<String> =
        frames_of.map(|k| frames.join(format!("flight-{k}.jpg")).to_str().unwrap().to_owned()).collect();
    let images: Vec<&str> = flight.iter().map(String::as_str).collect();
    stdout(&[&["import"], &images[..], &["--store", &store, "--installation", installation]].concat());
    let together: &[&str] = if jointly { &["--flight"] } else { &[] };
    stdout(&[&["solve", &store], together].concat());
    store
}

fn records(store: &str) -> Vec<Value> {
    let lines = stdout(&["export", store, "--format", "jsonl"]);
    lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()).collect()
}

#[test]
fn the_exported_covariance_is_that_of_the_results() {
    for jointly in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let store = solved_store(folder.path(), jointly);
        let file = folder.path().join("shape.nc");
        stdout(&["export", &store, "--format", "netcdf", "--output", file.to_str().unwrap()]);
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
                    assert!((there - value).abs() < 1e-9, "{field} of station {s}: {there}, {value}");
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
        let wrong = run(&["export", &store, "--format", "netcdf", "--inputs", "zzz", "-o", file.to_str().unwrap()]);
        assert_eq!((wrong.status.code(), std::fs::read(&file).unwrap() == before), (Some(1), true));
    }
}

#[test]
fn an_archive_of_numpy_arrays_describes_itself() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store(folder.path(), true);
    let file = folder.path().join("shape.npz");
    stdout(&["export", &store, "--format", "npz", "--eta", "0.5,1", "--output", file.to_str().unwrap()]);
    let mut archive = zip::ZipArchive::new(std::fs::File::open(&file).unwrap()).unwrap();
    let mut read = |name: &str| {
        let mut bytes = Vec::new();
        std::io::copy(&mut archive.by_name(&format!("{name}.npy")).unwrap(), &mut bytes).unwrap();
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!(data % 64, 0);
        (String::from_utf8(bytes[10..data].to_vec()).unwrap(), bytes[data..].to_vec())
    };
    let (header, values) = read("displacement");
    assert!(header.contains("'descr': '<f8', 'fortran_order': False, 'shape': (3, 2, 3, )"), "{header}");
    assert_eq!(values.len(), 3 * 2 * 3 * 8);
    let description: Value = serde_json::from_slice(&read("description").1).unwrap();
    assert!(description["attributes"]["errors"].as_str().unwrap().contains("lasting u"));
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
    let tip = |k: usize| records[k]["record"]["tip"]["sigma_deflection_m"].as_f64().unwrap();
    let sigma = difference["stations"][1]["sigma_displacement_z_m"].as_f64().unwrap();
    assert!(sigma < 0.5 * tip(0), "what the frames share cancels: {sigma} of {}", tip(0));
    assert!(difference["p"].as_f64().unwrap() < 1e-6, "the wing bends differently");
    let point = &records[0]["record"]["curve"][20];
    let table = folder.path().join("computed.csv");
    let write = |factor: f64| {
        let (arc, moved) = (point["arc_length_m"].as_f64().unwrap(), point["deflection_m"].as_f64().unwrap());
        std::fs::write(&table, format!("arc_length_m,displacement_z_m\n{arc},{}\n", factor * moved)).unwrap();
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
    assert!(of("sigma_displacement_z_m") > 0.9 * tip(0) * 0.7, "a mean of frames with common errors is no better");
    assert!(of("scatter_displacement_z_m") > 0.1, "the frames differ");
    let refused = [
        (vec![frame(1), frame(1)], "have a frame in common"),
        (vec![frame(1), frame(2), "--mirror".into()], "omit --mirror"),
        (vec![format!("{store}:f0009"), frame(2)], "there is no flight f0009"),
        (vec![frame(1)], "required"),
        (vec![frame(1), frame(2), "--where".into(), "match < 1".into()], "there is no quantity \"match\""),
        (vec![frame(1), frame(2), "--where".into(), "mach < 1".into()], "no frame with this name and these conditions"),
    ];
    for (arguments, text) in refused {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let ended = run(&[&["difference"], &arguments[..]].concat());
        let error = String::from_utf8(ended.stderr).unwrap();
        assert!(ended.status.code() != Some(0) && error.contains(text), "{error}");
    }
    // Of a mean it must be known which errors do not become smaller.
    let refused_mean = |others: &[&str], text: &str| {
        let ended = run(&[&["mean", &frame(1)], others].concat());
        let error = String::from_utf8(ended.stderr).unwrap();
        assert!(ended.status.code() == Some(1) && error.contains(text), "{error}");
    };
    refused_mean(&[&frame(2)], "several names are of one flight");
    refused_mean(&[&frame(1)], "a frame is named twice");
    let other = tempfile::tempdir().unwrap();
    let elsewhere = solved_store_with(other.path(), true, "root_offset_m = 0.56", 4..=5);
    refused_mean(&[&elsewhere], "different installations");
    let next = tempfile::tempdir().unwrap();
    let next = solved_store_with(next.path(), true, "", 4..=5);
    let both: Value = serde_json::from_str(&stdout(&["mean", &store, &next, "--eta", "0.9", "--json"])).unwrap();
    assert_eq!(both["frames"], 5);
    let alone = tempfile::tempdir().unwrap();
    let singly = solved_store(alone.path(), false);
    let ended =
        run(&["difference", &format!("{singly}:f0001/s000001/0001.jpg"), &format!("{singly}:f0001/s000001/0002.jpg")]);
    assert!(String::from_utf8(ended.stderr).unwrap().contains("solve STORE --flight"));
}
