//! Promise: a changed table is never silently read with other values.
//!
//! Method: sound tables (survey, tie points, stiffness, mountings, manual observations, board corners, aircraft data) are
//! changed by a seeded kind: a column renamed, moved with or without its header, doubled or added; cells moved, added,
//! removed, quoted; a unit, a decimal comma, a word for a number; a comment, a line moved; single characters. "Another" is decided
//! by a second, strict reading of the changed text, written here after RFC 4180 alone: if it determines a cell,
//! the program must read that value or refuse; if it does not (a column twice, more cells than the header has, an invalid
//! number, a quote in the middle) the program must refuse, or ignore what nobody requested. Changes without a meaning must
//! be read. 3,000 of each table, from the seed `WINGD_SEED` on (0).

mod strict;

use std::path::Path;

use rand::prelude::*;
use rand::rngs::StdRng;
use wingd::aircraft::{AircraftTable, Quantity};
use wingd::installation::{Installation, load, read_mountings, read_observations};
use wingd::measure::adjust::Mounting;
use wingd_evaluation::boards::read_corners;

use self::strict::{KINDS, Kind, Read, Rows, read_strictly};
use crate::mutations::first_seed;
use crate::program::fixture;

/// Number of changes of each table.
const CHANGES: u64 = 3000;

/// Expected reading of a changed table.
#[derive(Clone, Copy, PartialEq)]
enum Meaning {
    /// The reading before the change.
    None,
    /// The strict reading, or a refusal.
    AsWritten,
}

/// A change, and the expected reading.
fn change(rng: &mut StdRng, kind: Kind) -> (String, Meaning) {
    let mut table = kind.sound_rows();
    let (rows, width) = (table.len(), table[0].len());
    let (row, column) = (rng.random_range(1..rows), rng.random_range(0..width));
    let kind_of_change = rng.random_range(0..16);
    match kind_of_change {
        0 => {
            // Columns moved with their header.
            let mut order: Vec<usize> = (0..width).collect();
            order.shuffle(rng);
            let moved = |row: &Vec<String>| order.iter().map(|k| row[*k].clone()).collect();
            table = table.iter().map(moved).collect();
        }
        1 => table.iter_mut().flatten().for_each(|cell| {
            if rng.random() {
                *cell = format!("\"{cell}\"");
            }
        }),
        2 => table
            .iter_mut()
            .flatten()
            .for_each(|cell| *cell = format!(" {cell} ")),
        // If columns have no names, an extra one cannot be detected.
        3 if kind != Kind::Iwg1 => {
            for (k, row) in table.iter_mut().enumerate() {
                row.insert(
                    column,
                    if k == 0 {
                        "other".into()
                    } else {
                        "\"a, \"\"b\"\"\"".into()
                    },
                );
            }
        }
        4 => table[0][column].push('x'),
        5 => table[0][column] = table[0][column].to_uppercase() + "_",
        6 => {
            let other = rng.random_range(0..width);
            table[0].swap(column, other);
        }
        7 => table[0][column] = table[0][(column + 1) % width].clone(),
        8 => drop(table[row].remove(column)),
        9 => table[row].insert(column, ["", "1.5", "x"].choose(rng).unwrap().to_string()),
        10 => {
            table[row][column] = [
                "nan", "inf", "NCD", "", "1,5", "1e400", "-", "\"1\"2", "\"1",
            ]
            .choose(rng)
            .unwrap()
            .to_string()
        }
        11 => {
            let factor = *[1e3, 1e-3, 0.3048, 25.4].choose(rng).unwrap();
            for row in &mut table[1..] {
                if let Ok(value) = row[column].parse::<f64>() {
                    row[column] = format!("{:?}", value * factor);
                }
            }
        }
        12 => table.swap(row, rng.random_range(0..rows)),
        13 => {
            let again = table[row].clone();
            table.insert(row, again);
        }
        _ => {}
    }
    let text: String = table.iter().map(|row| row.join(",") + "\n").collect();
    let text = change_text(rng, kind, kind_of_change, text);
    let meaning = match kind_of_change {
        14 => Meaning::None,
        0..=3 if kind != Kind::Iwg1 => Meaning::None,
        _ => Meaning::AsWritten,
    };
    (text, meaning)
}

/// Changes that do not depend on the cells of a table.
fn change_text(rng: &mut StdRng, kind: Kind, kind_of_change: i32, mut text: String) -> String {
    match kind_of_change {
        14 if !kind.is_aircraft() => {
            let at = text
                .match_indices('\n')
                .map(|(at, _)| at + 1)
                .choose(rng)
                .unwrap();
            text.insert_str(at, "# id,x_m: before the survey was repeated\n\n");
        }
        14 => text = text.replace('\n', "\r\n"),
        15 => {
            let mut all: Vec<char> = text.chars().collect();
            let at = rng.random_range(0..all.len());
            match rng.random_range(0..3) {
                0 => drop(all.remove(at)),
                1 => all.insert(at, *b",\"\n ;.0#-e\t".choose(rng).unwrap() as char),
                _ => all[at] = rng.random_range(' '..='~'),
            }
            text = all.into_iter().collect();
        }
        _ => {}
    }
    text
}

/// The program's reading.
fn program(
    kind: Kind,
    directory: &Path,
    text: &str,
    installation: &Installation,
) -> Result<Rows, String> {
    let printed = |faults: Vec<wingd::installation::Fault>| {
        faults
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join("\n")
    };
    let file = directory.join("table.csv");
    std::fs::write(&file, text).unwrap();
    let number = |v: f64| Read::Number(v);
    match kind {
        Kind::Survey | Kind::Ties => {
            let name = if kind == Kind::Survey {
                "survey.csv"
            } else {
                "ties.csv"
            };
            let sound = std::fs::read(fixture("dev/installation/survey.csv")).unwrap();
            std::fs::write(directory.join("survey.csv"), sound).unwrap();
            std::fs::write(directory.join(name), text).unwrap();
            let Installation {
                setup, cad_model, ..
            } = load(directory).map_err(printed)?;
            Ok(if kind == Kind::Survey {
                let marker = |m: &wingd::measure::setup::SurveyMarker| {
                    let p = m.position_m;
                    [m.diameter_m, p.x, p.y, p.z, m.sigma_m]
                        .map(number)
                        .into_iter()
                };
                setup
                    .markers
                    .iter()
                    .map(|m| {
                        [Read::Text(m.id.clone())]
                            .into_iter()
                            .chain(marker(m))
                            .collect()
                    })
                    .collect()
            } else {
                let ties = cad_model.unwrap();
                let tie = |(id, t): (&String, &wingd::measure::geometry::PointPair)| {
                    let all = t
                        .source_m
                        .iter()
                        .chain(t.target_m.iter())
                        .copied()
                        .map(number);
                    [Read::Text(id.clone())].into_iter().chain(all).collect()
                };
                ties.ids.iter().zip(&ties.points).map(tie).collect()
            })
        }
        Kind::Stiffness => {
            let row = |s: &wingd::measure::setup::StiffnessSection| {
                [s.s_m, s.ei_n_m2, s.sigma_ei_n_m2].map(number).to_vec()
            };
            std::fs::write(directory.join("stiffness.csv"), text).unwrap();
            let read = load(directory).map_err(printed)?;
            Ok(read.structure.iter().flatten().map(row).collect())
        }
        Kind::Mountings => Ok(mountings(
            &read_mountings(&file).map_err(printed)?,
            read_strictly(kind, text).unwrap_or_default(),
        )),
        Kind::Observations => {
            let setup = &installation.setup;
            let row = |o: &wingd::installation::ManualObservation| {
                let id = Read::Text(setup.markers[o.marker].id.clone());
                let cell = |value: Option<f64>| value.map_or(Read::Text(String::new()), number);
                let [u, v] = [0, 1].map(|k| o.place.map(|p| p.pixel[k]));
                let sigma = o.place.map(|p| p.covariance_px2[(0, 0)].sqrt());
                vec![id, cell(u), cell(v), cell(sigma)]
            };
            read_observations(&file, setup)
                .map(|all| all.iter().map(row).collect())
                .map_err(printed)
        }
        Kind::Corners => {
            let pictures = read_corners(&file).map_err(printed)?;
            let row = |image: &str, p: &wingd::measure::calibrate::BoardPoint| {
                let values = [p.board_m.x, p.board_m.y, p.pixel.x, p.pixel.y].map(number);
                [Read::Text(image.into())]
                    .into_iter()
                    .chain(values)
                    .collect::<Vec<Read>>()
            };
            Ok(pictures
                .iter()
                .flat_map(|c| c.view.iter().map(|p| row(&c.image, p)))
                .collect())
        }
        Kind::Aircraft | Kind::Iwg1 => aircraft(kind, directory, text),
    }
}

/// The strict reading of a table of mountings, as far as the program's agrees.
fn mountings(found: &wingd::installation::Mountings, rows: Rows) -> Rows {
    let mut numbers: Vec<String> = vec![];
    // The program numbers mountings; their names are those of the strict reading at equal numbers.
    let named = |row: Vec<Read>| {
        let [Read::Text(image), Read::Text(name)] = &row[..] else {
            return row;
        };
        if !numbers.contains(name) && name != "ground" {
            numbers.push(name.clone());
        }
        let expected = numbers
            .iter()
            .position(|n| n == name)
            .map_or(Mounting::Ground, Mounting::Numbered);
        let same = found.find(image) == Some(expected);
        vec![
            Read::Text(image.clone()),
            Read::Text(if same { name.clone() } else { "another".into() }),
        ]
    };
    rows.into_iter().map(named).collect()
}

fn aircraft(kind: Kind, directory: &Path, text: &str) -> Result<Rows, String> {
    let file = directory.join("aircraft.csv");
    std::fs::write(&file, text).unwrap();
    let table = AircraftTable::read(&file).map_err(|faults| format!("{faults:?}"))?;
    // A column that is not read is named.
    if kind == Kind::Aircraft && table.layout.column.len() < 2 {
        return Err("a quantity is missing".to_owned());
    }
    let places = [Quantity::PressureAltitudeM, Quantity::Mach]
        .map(|q| Quantity::ALL.iter().position(|a| *a == q).unwrap());
    let row = |line: &str| {
        let sample = table.layout.read(line);
        let cell = |value: Option<f64>| value.map_or(Read::Text(String::new()), Read::Number);
        let values = places.map(|k| cell(sample.and_then(|s| s.values[k])));
        [cell(sample.map(|s| s.time_s))]
            .into_iter()
            .chain(values)
            .collect()
    };
    Ok(table.lines.iter().map(|(_, line)| row(line)).collect())
}

/// Whether a line without a time, or a cell without a value, corresponds to one that the program omits with a message.
fn agrees(kind: Kind, read: &Rows, strict: &Rows) -> bool {
    if kind == Kind::Corners {
        // Images are grouped.
        let sorted = |rows: &Rows| {
            let mut rows: Vec<String> = rows.iter().map(|row| format!("{row:?}")).collect();
            rows.sort();
            rows
        };
        return sorted(read) == sorted(strict);
    }
    if !kind.is_aircraft() {
        return read == strict;
    }
    // Lines without a time contain nothing: they are reported.
    let timed = |rows: &Rows| {
        rows.iter()
            .filter(|row| matches!(row[0], Read::Number(_)))
            .cloned()
            .collect::<Rows>()
    };
    timed(read) == timed(strict)
}

/// Tables that the installation names, so that they are sound while another table is changed.
const NAMED: [(Kind, &str); 2] = [(Kind::Ties, "ties.csv"), (Kind::Stiffness, "stiffness.csv")];

fn sound(kind: Kind) -> String {
    let rows = kind.sound_rows().into_iter();
    rows.map(|row| row.join(",") + "\n").collect()
}

fn installation(directory: &Path) -> Installation {
    for name in ["camera.toml", "survey.csv", "installation.toml"] {
        std::fs::copy(fixture("dev/installation").join(name), directory.join(name)).unwrap();
    }
    let main = directory.join("installation.toml");
    let text = std::fs::read_to_string(&main).unwrap();
    assert!(!text.contains("[cad]"));
    let tables = "[cad]\ntie_points = \"ties.csv\"\n[structure]\nstiffness = \"stiffness.csv\"\n";
    std::fs::write(&main, format!("{text}\n{tables}")).unwrap();
    for (kind, name) in NAMED {
        std::fs::write(directory.join(name), sound(kind)).unwrap();
    }
    load(directory).unwrap()
}

#[test]
fn a_changed_table_never_silently_gives_another_value() {
    let directory = tempfile::tempdir().unwrap();
    let installation = installation(directory.path());
    let mut failures = vec![];
    for kind in KINDS {
        let (mut refused, mut same_as_before) = (0, 0);
        let before = read_strictly(kind, &sound(kind)).unwrap();
        for seed in first_seed()..first_seed() + CHANGES {
            let mut rng = StdRng::seed_from_u64(seed);
            let (text, meaning) = change(&mut rng, kind);
            let read = program(kind, directory.path(), &text, &installation);
            let (read, expected) = (&read, read_strictly(kind, &text));
            refused += usize::from(read.is_err());
            same_as_before +=
                usize::from(read.as_ref().is_ok_and(|rows| agrees(kind, rows, &before)));
            let wrong = match (read, &expected, meaning) {
                (Err(_), ..) => meaning == Meaning::None,
                (Ok(rows), _, Meaning::None) => !agrees(kind, rows, &before),
                (Ok(rows), Some(expected), _) => !agrees(kind, rows, expected),
                // If the strict reading is undetermined, the program may only read the original values.
                (Ok(rows), None, _) => !agrees(kind, rows, &before),
            };
            if wrong {
                eprintln!("{kind:?}, seed {seed}:\n{text}\n{read:?}\n{expected:?}\n");
                failures.push((kind, seed));
            }
        }
        for (_, name) in NAMED.into_iter().filter(|named| named.0 == kind) {
            std::fs::write(directory.path().join(name), sound(kind)).unwrap();
        }
        eprintln!(
            "{kind:?}: {CHANGES} changes, {refused} refused, {same_as_before} read as before"
        );
    }
    assert!(failures.is_empty(), "{failures:?}");
}
