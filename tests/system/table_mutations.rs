//! Promise: a table that was changed never gives another value without a word.
//!
//! Method: sound tables (survey, tie points, stiffness, mountings, hand measurements, board corners, aircraft data) are
//! changed by a seeded kind: a column renamed, moved with or without its header, doubled or added; cells moved, added, left
//! out, quoted; a unit, a decimal comma, a word for a number; a comment, a line moved; single characters. "Another" is told
//! by a second, strict reading of the changed text, written here after RFC 4180 alone: where that one says what a cell is,
//! the program must read that or refuse; where it cannot (a column twice, more cells than the header has, a number that is
//! none, a quote in the middle) the program must refuse, or pass over what nobody asked for. Changes without a meaning must
//! be read. The usual run does some hundred of each table; `make test-mutations` 3,000.

use std::path::Path;

use rand::prelude::*;
use rand::rngs::StdRng;
use wingd::aircraft::{Mapping, Quantity, Table};
use wingd::installation::{
    Installation, load, read_corners, read_mountings, read_observations, read_stiffness,
};
use wingd::measure::adjust::Mounting;

use crate::program::fixture;

/// Changes of each table in the usual run, and by `make test-mutations`.
const USUAL: u64 = 250;
const ALL: u64 = 3000;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Survey,
    Ties,
    Stiffness,
    Mountings,
    Observations,
    Corners,
    Aircraft,
}

const KINDS: [Kind; 7] = [
    Kind::Survey,
    Kind::Ties,
    Kind::Stiffness,
    Kind::Mountings,
    Kind::Observations,
    Kind::Corners,
    Kind::Aircraft,
];

/// A cell as it is read: a number or a text.
#[derive(Clone, Debug, PartialEq)]
enum Read {
    Number(f64),
    Text(String),
}

type Rows = Vec<Vec<Read>>;

impl Kind {
    /// Columns that are read, numbers marked.
    fn columns(self) -> &'static [(&'static str, bool)] {
        match self {
            Self::Survey => &[("id", false), ("diameter_m", true), ("x_m", true), ("y_m", true), ("z_m", true), ("sigma_m", true)],
            Self::Ties => &[("id", false), ("x_m", true), ("y_m", true), ("z_m", true), ("cad_x_m", true), ("cad_y_m", true), ("cad_z_m", true)],
            Self::Stiffness => &[("s_m", true), ("ei_n_m2", true), ("sigma_ei_n_m2", true)],
            Self::Mountings => &[("image", false), ("mounting", false)],
            Self::Observations => &[("id", false), ("u_px", true), ("v_px", true), ("sigma_px", true)],
            Self::Corners => &[("image", false), ("board_x_m", true), ("board_y_m", true), ("u_px", true), ("v_px", true)],
            Self::Aircraft => &[("UTC", true), ("FL", true), ("MACH", true)],
        }
    }

    /// Header and rows of a sound one.
    fn sound(self) -> Vec<Vec<String>> {
        let rows: Vec<String> = match self {
            Self::Survey => {
                let text = std::fs::read_to_string(fixture("dev/installation/survey.csv")).unwrap();
                text.lines().filter(|l| !l.starts_with('#')).map(str::to_owned).collect()
            }
            Self::Ties => (0..5).map(|k| format!("T{k},{k}.5,{}.25,1.125,{}.5,{}.25,-{k}.5", k * k, 7 + k, 11 * k)).collect(),
            Self::Stiffness => (0..6).map(|k| format!("{k}.5,{}e8,{}e7", 9 - k, 9 - k)).collect(),
            Self::Mountings => (0..6).map(|k| format!("f{k}.jpg,m{}", k / 2)).collect(),
            Self::Observations => (1..9).map(|k| format!("M0{k},{}.5,{}.25,0.2{k}", 1000 + 100 * k, 800 + 50 * k)).collect(),
            Self::Corners => (0..8).map(|k| format!("a.png,1280,960,0.{k},0.2{k},{}.5,{}.25,0.01,0.02,0.1,yes", 100 + 9 * k, 200 + 7 * k)).collect(),
            Self::Aircraft => (0..8).map(|k| format!("2026-06-01T08:00:0{k}Z,35{k},0.78{k},note {k}")).collect(),
        };
        let header = match self {
            Self::Survey => "",
            Self::Ties => "id,x_m,y_m,z_m,cad_x_m,cad_y_m,cad_z_m",
            Self::Stiffness => "s_m,ei_n_m2,sigma_ei_n_m2",
            Self::Mountings => "image,mounting",
            Self::Observations => "id,u_px,v_px,sigma_px",
            Self::Corners => "image,width_px,height_px,board_x_m,board_y_m,u_px,v_px,sigma_u_px,sigma_v_px,correlation,used",
            Self::Aircraft => "UTC,FL,MACH,REMARK",
        };
        let header = (!header.is_empty()).then(|| header.to_owned());
        header.into_iter().chain(rows).map(|line| line.split(',').map(str::to_owned).collect()).collect()
    }
}

/// A change, and whether it has no meaning.
fn change(rng: &mut StdRng, kind: Kind) -> (String, bool) {
    let mut table = kind.sound();
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
        2 => table.iter_mut().flatten().for_each(|cell| *cell = format!(" {cell} ")),
        3 => {
            for (k, row) in table.iter_mut().enumerate() {
                row.insert(column, if k == 0 { "other".into() } else { "\"a, \"\"b\"\"\"".into() });
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
        10 => table[row][column] = ["nan", "inf", "NCD", "", "1,5", "1e400", "-", "\"1\"2", "\"1"].choose(rng).unwrap().to_string(),
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
    let mut text: String = table.iter().map(|row| row.join(",") + "\n").collect();
    match kind_of_change {
        14 if kind != Kind::Aircraft => {
            let at = text.match_indices('\n').map(|(at, _)| at + 1).choose(rng).unwrap();
            text.insert_str(at, "# id,x_m: before the survey was made anew\n\n");
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
    (text, matches!(kind_of_change, 0..=3 | 14))
}

/// RFC 4180 to the letter, blanks about cells but for; `None` where a text is none.
fn cells(text: &str, comments: bool) -> Option<Vec<Vec<String>>> {
    let text = text.replace("\r\n", "\n");
    let kept = text.lines().filter(|line| !(comments && line.trim_start().starts_with('#')));
    let text: String = kept.map(|line| format!("{line}\n")).collect();
    let (mut rows, mut row, mut cell) = (vec![], vec![], String::new());
    let (mut quoted, mut ended) = (false, false);
    for c in text.chars() {
        match (c, quoted) {
            ('"', true) => (quoted, ended) = (false, true),
            ('"', false) if ended => {
                cell.push('"');
                (quoted, ended) = (true, false);
            }
            ('"', false) if cell.is_empty() => quoted = true,
            // Nothing is quoted by a quote within.
            ('"', false) => cell.push(c),
            (',' | '\n', false) => {
                row.push(std::mem::take(&mut cell).trim().to_owned());
                ended = false;
                if c == '\n' {
                    rows.push(std::mem::take(&mut row));
                }
            }
            (_, false) if ended => return None,
            _ => cell.push(c),
        }
    }
    rows.retain(|row: &Vec<String>| row.iter().any(|cell| !cell.is_empty()));
    (!quoted && row.is_empty()).then_some(rows)
}

/// What the text says of the columns that are read; `None` where it cannot be said.
fn strict(kind: Kind, text: &str) -> Option<Rows> {
    let rows = cells(text, kind != Kind::Aircraft)?;
    let (header, rows) = rows.split_first()?;
    let place = |name: &str| {
        let mut found = header.iter().enumerate().filter(|(_, cell)| *cell == name).map(|(k, _)| k);
        found.next().filter(|_| found.next().is_none())
    };
    let places: Option<Vec<(usize, bool)>> =
        kind.columns().iter().map(|(name, number)| Some((place(name)?, *number))).collect();
    let places = places?;
    let one = |row: &Vec<String>| {
        let many = row.iter().skip(header.len()).any(|cell| !cell.is_empty()) || row.len() < header.len();
        let read = |(k, number): &(usize, bool)| {
            let cell = row.get(*k)?;
            match (number, kind) {
                (false, _) => Some(Read::Text(cell.clone())),
                (true, Kind::Aircraft) => Some(aircraft_cell(header, *k, cell)),
                (true, _) => cell.parse::<f64>().ok().filter(|v| v.is_finite()).map(Read::Number),
            }
        };
        if many { None } else { places.iter().map(read).collect::<Option<Vec<Read>>>() }
    };
    // Lines that are cut short are left out of aircraft data.
    rows.iter().filter(|row| kind != Kind::Aircraft || row.len() >= header.len()).map(one).collect()
}

/// A cell of the aircraft's table: a moment, or a value; one that is none is a text.
fn aircraft_cell(header: &[String], k: usize, cell: &str) -> Read {
    let stamp = || cell.parse::<jiff::Timestamp>().ok().map(|t| t.as_microsecond() as f64 * 1e-6);
    let number = cell.parse::<f64>().ok().filter(|v| v.is_finite());
    let (scale, most) = if header[k] == "FL" { (30.48, 30_000.0) } else { (1.0, 3.0) };
    let value = match header[k].as_str() {
        "UTC" => number.filter(|n| *n > 0.0).or_else(stamp),
        _ => number.map(|n| scale * n).filter(|v| (-1000.0..=most).contains(v) && (header[k] == "FL" || *v >= 0.0)),
    };
    value.map_or(Read::Text(String::new()), Read::Number)
}

/// The program's reading.
fn program(kind: Kind, directory: &Path, text: &str, installation: &Installation) -> Result<Rows, String> {
    let said = |faults: Vec<wingd::installation::Fault>| faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    let file = directory.join("table.csv");
    std::fs::write(&file, text).unwrap();
    let number = |v: f64| Read::Number(v);
    match kind {
        Kind::Survey | Kind::Ties => {
            let name = if kind == Kind::Survey { "survey.csv" } else { "ties.csv" };
            let sound = std::fs::read(fixture("dev/installation/survey.csv")).unwrap();
            std::fs::write(directory.join("survey.csv"), sound).unwrap();
            std::fs::write(directory.join(name), text).unwrap();
            let setup = load(directory).map_err(said)?.setup;
            Ok(if kind == Kind::Survey {
                let marker = |m: &wingd::measure::setup::SurveyMarker| {
                    let p = m.position_m;
                    [m.diameter_m, p.x, p.y, p.z, m.sigma_m].map(number).into_iter()
                };
                setup.markers.iter().map(|m| [Read::Text(m.id.clone())].into_iter().chain(marker(m)).collect()).collect()
            } else {
                let tie = |t: &wingd::measure::setup::TiePoint| {
                    let all = t.survey_m.iter().chain(t.cad_m.iter()).copied().map(number);
                    [Read::Text(t.id.clone())].into_iter().chain(all).collect()
                };
                setup.tie_points.iter().map(tie).collect()
            })
        }
        Kind::Stiffness => {
            let row = |s: &wingd::measure::stress::Section| [s.s_m, s.ei_n_m2, s.sigma_ei_n_m2].map(number).to_vec();
            read_stiffness(&file).map(|all| all.iter().map(row).collect()).map_err(said)
        }
        Kind::Mountings => {
            let found = read_mountings(&file).map_err(said)?;
            let rows = strict(kind, text).unwrap_or_default();
            let mut numbers: Vec<String> = vec![];
            // The program numbers mountings; their names are those of the strict reading at equal numbers.
            let named = |row: Vec<Read>| {
                let [Read::Text(image), Read::Text(name)] = &row[..] else { return row };
                if !numbers.contains(name) && name != "ground" {
                    numbers.push(name.clone());
                }
                let expected = numbers.iter().position(|n| n == name).map_or(Mounting::OfTheGround, Mounting::Numbered);
                let same = found.of(image) == Some(expected);
                vec![Read::Text(image.clone()), Read::Text(if same { name.clone() } else { "another".into() })]
            };
            Ok(rows.into_iter().map(named).collect())
        }
        Kind::Observations => {
            let setup = &installation.setup;
            let row = |o: &wingd::installation::HandObservation| {
                let id = Read::Text(setup.markers[o.marker].id.clone());
                vec![id, number(o.pixel.x), number(o.pixel.y), number(o.sigma_px)]
            };
            read_observations(&file, setup).map(|all| all.iter().map(row).collect()).map_err(said)
        }
        Kind::Corners => {
            let pictures = read_corners(&file).map_err(said)?;
            let row = |image: &str, p: &wingd::measure::calibrate::BoardPoint| {
                let values = [p.board_m.x, p.board_m.y, p.pixel.x, p.pixel.y].map(number);
                [Read::Text(image.into())].into_iter().chain(values).collect::<Vec<Read>>()
            };
            Ok(pictures.iter().flat_map(|c| c.view.iter().map(|p| row(&c.image, p))).collect())
        }
        Kind::Aircraft => aircraft(text),
    }
}

fn aircraft(text: &str) -> Result<Rows, String> {
    let mapping: Mapping = toml::from_str(
        "time = 'UTC'\nseparator = ','\n[[column]]\nname = 'FL'\nquantity = 'pressure_altitude_m'\nscale = 30.48\n\
         [[column]]\nname = 'MACH'\nquantity = 'mach'\n",
    )
    .unwrap();
    let table = Table::find(&mapping, &text.replace("\r\n", "\n")).map_err(|e| e.to_string())?;
    if let Some(word) = table.remarks.iter().find(|remark| remark.contains("before the header")) {
        return Err(word.clone());
    }
    let places = [Quantity::PressureAltitudeM, Quantity::Mach].map(|q| Quantity::ALL.iter().position(|a| *a == q).unwrap());
    let row = |line: &str| {
        let sample = table.layout.read(line);
        let cell = |value: Option<f64>| value.map_or(Read::Text(String::new()), Read::Number);
        let values = places.map(|k| cell(sample.and_then(|s| s.values[k])));
        [cell(sample.map(|s| s.time_s))].into_iter().chain(values).collect()
    };
    Ok(table.lines.iter().map(|(_, line)| row(line)).collect())
}

/// Whether a line without a moment, or a cell without a value, stands for what the program leaves out with a word.
fn same(kind: Kind, read: &Rows, strict: &Rows) -> bool {
    if kind != Kind::Aircraft {
        return read == strict;
    }
    // Lines without a moment say nothing, and a row of units is left out: both are told.
    let timed = |rows: &Rows| rows.iter().filter(|row| matches!(row[0], Read::Number(_))).cloned().collect::<Rows>();
    timed(read) == timed(strict)
}

fn installation(directory: &Path) -> Installation {
    for name in ["camera.toml", "survey.csv", "installation.toml"] {
        std::fs::copy(fixture("dev/installation").join(name), directory.join(name)).unwrap();
    }
    let main = directory.join("installation.toml");
    let text = std::fs::read_to_string(&main).unwrap();
    assert!(!text.contains("[cad]"));
    std::fs::write(&main, format!("{text}\n[cad]\ntie_points = \"ties.csv\"\n")).unwrap();
    let ties: String = Kind::Ties.sound().iter().map(|row| row.join(",") + "\n").collect();
    std::fs::write(directory.join("ties.csv"), ties).unwrap();
    load(directory).unwrap()
}

fn try_all(count: u64) {
    let directory = tempfile::tempdir().unwrap();
    let installation = installation(directory.path());
    let mut failures = vec![];
    for kind in KINDS {
        let (mut refused, mut same_as_before) = (0, 0);
        let sound: String = kind.sound().iter().map(|row| row.join(",") + "\n").collect();
        let before = strict(kind, &sound).unwrap();
        for seed in 0..count {
            let mut rng = StdRng::seed_from_u64(seed);
            let (text, meaningless) = change(&mut rng, kind);
            let read = program(kind, directory.path(), &text, &installation);
            let (read, expected) = (&read, strict(kind, &text));
            refused += usize::from(read.is_err());
            same_as_before += usize::from(read.as_ref().is_ok_and(|rows| same(kind, rows, &before)));
            let wrong = match (read, &expected) {
                (Err(_), _) => meaningless,
                (Ok(rows), _) if meaningless => !same(kind, rows, &before),
                (Ok(rows), Some(expected)) => !same(kind, rows, expected),
                // What the strict reading cannot say the program may only read as it was.
                (Ok(rows), None) => !same(kind, rows, &before),
            };
            if wrong {
                eprintln!("{kind:?}, seed {seed}:\n{text}\n{read:?}\n{expected:?}\n");
                failures.push((kind, seed));
            }
        }
        let undo: String = kind.sound().iter().map(|row| row.join(",") + "\n").collect();
        if kind == Kind::Ties {
            std::fs::write(directory.path().join("ties.csv"), undo).unwrap();
        }
        eprintln!("{kind:?}: {count} changes, {refused} refused, {same_as_before} read as before");
    }
    assert!(failures.is_empty(), "{failures:?}");
}

#[test]
fn a_changed_table_gives_no_other_value_in_silence() {
    try_all(USUAL);
}

#[test]
#[ignore = "thousands: make test-mutations"]
fn mutations_of_tables() {
    try_all(ALL);
}
