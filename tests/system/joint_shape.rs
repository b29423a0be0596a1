//! Promise: the joint shape of a flight leaves the program with its covariance, in files that others read.

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
        let full = folder.path().join("full.nc");
        let name = full.to_str().unwrap();
        let format = ["--format", "netcdf", "--full-factors", "-o", name];
        stdout(&[&["export", &store][..], &format].concat());
        let mut full = FileReader::open(name).unwrap();
        let kinds: &[&str] = if jointly {
            &["lasting", "shared", "own"]
        } else {
            &["own"]
        };
        for array in [
            "displacement",
            "rotation",
            "marker_deflection",
            "thermal_scale",
        ] {
            let sigma = reader.read_var_f64(&format!("sigma_{array}")).unwrap();
            let (mut reduced, mut whole) = (vec![0.0; sigma.len()], vec![0.0; sigma.len()]);
            for kind in kinds {
                let all = full.read_var_f64(&format!("{array}_{kind}")).unwrap();
                add_squares(&mut whole, all.iter().copied());
                let few = reader.read_var_f32(&format!("{array}_{kind}")).unwrap();
                // A frame's own errors can need all their sources.
                let is_reduced = few.len() < all.len();
                assert!(is_reduced || *kind == "own", "{array}_{kind} is reduced");
                add_squares(&mut reduced, few.iter().map(|v| f64::from(*v)));
                let rest = reader.read_var_f64(&format!("{array}_{kind}_rest"));
                add_squares(&mut reduced, rest.unwrap().into_iter());
            }
            for (k, sigma) in sigma.iter().enumerate() {
                let near =
                    |square: f64, off: f64| (square.sqrt() - sigma).abs() <= off * sigma + 1e-12;
                assert!(
                    near(whole[k], 1e-9) && near(reduced[k], 1e-5),
                    "{array} {k}"
                );
            }
        }
        let length = |path: &Path| std::fs::metadata(path).unwrap().len();
        assert!(length(&file) < length(Path::new(name)));
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

/// Adds the squares of factors to the variances of values.
fn add_squares(variances: &mut [f64], factors: impl ExactSizeIterator<Item = f64>) {
    let sources = factors.len() / variances.len();
    for (k, factor) in factors.enumerate() {
        variances[k / sources] += factor * factor;
    }
}

/// Texts of a variable.
fn texts(reader: &mut FileReader, name: &str, count: usize) -> Vec<String> {
    let bytes = reader.read_var_u8(name).unwrap();
    let text = |part: &[u8]| String::from_utf8(part.to_vec()).unwrap();
    let parts = bytes.chunks(bytes.len() / count);
    parts
        .map(|part| text(part).trim_end_matches('\0').to_owned())
        .collect()
}

#[test]
fn a_file_of_several_flights_names_the_sources_that_they_share() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store(folder.path(), true);
    let later = fixture("dev/frames/flight-4.jpg");
    let installation = folder.path().join("installation");
    let (later, installation) = (later.to_str().unwrap(), installation.to_str().unwrap());
    let place = ["--store", &store, "--installation", installation];
    stdout(&[&["import", later][..], &place].concat());
    stdout(&["solve", &store]);
    let file = folder.path().join("shape.nc");
    let format = ["--format", "netcdf", "--eta", "0.5,1"];
    let output = ["-o", file.to_str().unwrap()];
    stdout(&[&["export", &store][..], &format, &output].concat());
    let mut reader = FileReader::open(&file).unwrap();
    let mut read = |name: &str| texts(&mut reader, name, 4);
    assert_eq!(read("flight"), ["f0001", "f0001", "f0001", "f0002"]);
    let (lasting, shared, own) = (
        read("lasting_sources"),
        read("shared_sources"),
        read("own_sources"),
    );
    assert!(lasting.iter().all(|digest| *digest == lasting[0]));
    assert!(shared[0] == shared[2] && shared[0] != shared[3]);
    assert!((0..4).all(|k| own.iter().filter(|one| **one == own[k]).count() == 1));
    assert_eq!(read("status"), ["ok"; 4]);
    assert_eq!(reader.read_var_f64("eta").unwrap(), [0.5, 1.0]);
    let axes = texts(&mut reader, "axis", 3);
    assert_eq!(axes, ["x", "y", "z"]);
    // The basis leads from the reduced to the common sources.
    let name = folder.path().join("full.nc");
    let output = ["--full-factors", "-o", name.to_str().unwrap()];
    stdout(&[&["export", &store][..], &format, &output].concat());
    let mut full = FileReader::open(&name).unwrap();
    let wanted = full.read_var_f64("displacement_lasting").unwrap();
    let reduced = reader.read_var_f32("displacement_lasting").unwrap();
    let basis = reader.read_var_f32("lasting_basis").unwrap();
    let sources = wanted.len() / (4 * 2 * 3);
    let few = reduced.len() / (4 * 2 * 3);
    let mut largest = 0.0_f64;
    for row in 0..4 * 2 * 3 {
        let (frame, mut lost) = (row / 6, 0.0);
        let mut all = 0.0;
        for source in 0..sources {
            let first = (frame * sources + source) * few;
            let product: f32 = (0..few)
                .map(|k| reduced[row * few + k] * basis[first + k])
                .sum();
            let there = wanted[row * sources + source];
            lost += (f64::from(product) - there).powi(2);
            all += there * there;
        }
        if all > 0.0 {
            largest = largest.max(lost / all);
        }
    }
    assert!(largest < 0.01, "{largest}");
}

#[test]
fn a_time_that_is_not_known_is_missing_in_every_export() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store(folder.path(), true);
    let file = folder.path().join("shape.nc");
    let output = file.to_str().unwrap();
    stdout(&["export", &store, "--format", "netcdf", "-o", output]);
    let mut reader = FileReader::open(&file).unwrap();
    let times = reader.read_var_f64("time").unwrap();
    assert!(times.iter().all(|time| time.is_nan()), "{times:?}");
    for table in ["shots", "summary", "series", "markers"] {
        let text = stdout(&["export", &store, "--format", "csv", "--table", table]);
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let heads = reader.headers().unwrap().clone();
        let utc = heads.iter().position(|head| head == "utc").unwrap();
        for row in reader.records() {
            assert_eq!(&row.unwrap()[utc], "", "{table}");
        }
    }
    for record in records(&store) {
        assert!(record["utc"].is_null(), "{record}");
        let exposed = &record["exposure"]["exposure_time"];
        assert!(exposed.is_null(), "{record}");
    }
}

#[test]
fn with_a_stiffness_results_tables_and_shapes_have_bending_moments() {
    let folder = tempfile::tempdir().unwrap();
    let store = solved_store_changed(folder.path(), |installation| {
        let sections = "s_m,ei_n_m2,sigma_ei_n_m2\n2,4.0e8,1.2e7\n10,1.6e8,4.8e6\n";
        std::fs::write(installation.join("structure.csv"), sections).unwrap();
        let toml = installation.join("installation.toml");
        let text = std::fs::read_to_string(&toml).unwrap();
        let structure = "\n[structure]\nstiffness = \"structure.csv\"\n";
        std::fs::write(&toml, format!("{text}{structure}")).unwrap();
    });
    let records = records(&store);
    let text = stdout(&["export", &store, "--format", "csv", "--table", "moments"]);
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    type Row = std::collections::BTreeMap<String, String>;
    let rows: Vec<Row> = reader.deserialize().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 2 * records.len());
    let file = folder.path().join("shape.nc");
    let output = file.to_str().unwrap();
    stdout(&["export", &store, "--format", "netcdf", "-o", output]);
    let mut reader = FileReader::open(&file).unwrap();
    let mut read = |name: &str| reader.read_var_f64(name).unwrap();
    assert_eq!(read("section"), [2.0, 10.0]);
    let (moments, sigmas) = (read("bending_moment"), read("sigma_bending_moment"));
    for (k, record) in records.iter().enumerate() {
        for s in 0..2 {
            let of = |name: &str| record["record"]["moments"][s][name].as_f64().unwrap();
            let (moment, sigma) = (of("bending_moment_nm"), of("sigma_bending_moment_nm"));
            assert!(moment > 0.0 && sigma > 0.03 * moment, "{moment} {sigma}");
            let row = |name: &str| rows[2 * k + s][name].parse::<f64>().unwrap();
            assert_eq!(row("bending_moment_nm"), moment);
            assert_eq!(row("sigma_bending_moment_nm"), sigma);
            let (there, its_sigma) = (moments[2 * k + s], sigmas[2 * k + s]);
            assert!((there - moment).abs() < 1e-9 * moment, "{there} {moment}");
            assert!(
                (its_sigma - sigma).abs() < 1e-6 * sigma,
                "{its_sigma} {sigma}"
            );
        }
    }
}

#[test]
fn the_transform_to_cad_axes_is_given_with_its_errors() {
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
    let matrix = read("cad_from_survey");
    let wanted = [
        [0.0, -1.0, 0.0, 5.0],
        [1.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 1.0, -2.0],
    ];
    for (found, wanted) in matrix.iter().zip(wanted.iter().flatten()) {
        assert!((found - wanted).abs() < 1e-6, "{matrix:?}");
    }
    // Five points with errors of 1 cm, some 7 m from their centre, leave a turn of a milliradian about each axis.
    let fit = read("cad_fit");
    assert_eq!(fit.len(), 16);
    for (k, of_parameter) in fit.chunks(4).take(3).enumerate() {
        let sigma = of_parameter.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!((1e-4..3e-3).contains(&sigma), "{k}: {sigma}");
    }
    assert_eq!(fit[12..], [0.0; 4], "the scale is not estimated");
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
    let file = folder.path().join("shape.nc");
    let output = ["--eta", "0.5,1", "-o", file.to_str().unwrap()];
    stdout(&[&["export", &store, "--format", "netcdf"][..], &output].concat());
    let mut reader = FileReader::open(&file).unwrap();
    let of_frames = reader.read_var_f64("displacement").unwrap();
    for (station, row) in series.iter().enumerate() {
        let z = [0, 1, 2].map(|frame| of_frames[6 * frame + 3 * station + 2]);
        let mean = z.iter().sum::<f64>() / 3.0;
        let squares: f64 = z.iter().map(|one| (one - mean).powi(2)).sum();
        let of = |name: &str| row[name].parse::<f64>().unwrap();
        assert!((of("displacement_z_m") - mean).abs() < 1e-12);
        assert!((of("scatter_displacement_z_m") - (squares / 2.0).sqrt()).abs() < 1e-9);
    }
    let tip_sigma = records[0]["record"]["tip"]["sigma_deflection_m"]
        .as_f64()
        .unwrap();
    let of = |name: &str| series[1][name].parse::<f64>().unwrap();
    assert!(
        of("sigma_displacement_z_m") > 0.6 * tip_sigma && of("scatter_displacement_z_m") > 0.1,
        "a mean of frames with common errors is no better"
    );
    // A frame that is not ok is left out.
    let results = Path::new(&store).join("flights/f0001/s000001/results.jsonl");
    let text = std::fs::read_to_string(&results).unwrap();
    let doubtful = text.replacen("\"status\":\"ok\"", "\"status\":\"doubtful\"", 1);
    assert_ne!(text, doubtful);
    std::fs::write(&results, doubtful).unwrap();
    let others = table(&["--table", "series", "--eta", "0.5,1"]);
    let z = [1, 2].map(|frame| of_frames[6 * frame + 5]);
    let mean = others[1]["displacement_z_m"].parse::<f64>().unwrap();
    assert_eq!(others[1]["frames"], "2");
    assert!((mean - 0.5 * (z[0] + z[1])).abs() < 1e-12, "{mean} {z:?}");
    assert_eq!(
        Value::from(others[1]["recorder_id"].as_str()),
        records[0]["recorder_id"]
    );
    std::fs::write(&results, text).unwrap();
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
            "--table series needs --format csv or parquet",
        ),
        (
            ["--format", "csv", "--table", "shape"],
            "--table shape needs --format netcdf",
        ),
    ] {
        let ended = run(&[&["export", &store][..], &arguments].concat());
        assert!(
            ended.status.code() == Some(2)
                && String::from_utf8(ended.stderr).unwrap().contains(text)
        );
    }
}
