//! Sound tables, and a second reading of a text, after RFC 4180 alone.

use crate::program::fixture;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Survey,
    Ties,
    Stiffness,
    Mountings,
    Observations,
    Corners,
    Aircraft,
    /// Lines of IWG1 without a header.
    Iwg1,
}

pub const KINDS: [Kind; 8] = [
    Kind::Survey,
    Kind::Ties,
    Kind::Stiffness,
    Kind::Mountings,
    Kind::Observations,
    Kind::Corners,
    Kind::Aircraft,
    Kind::Iwg1,
];

/// A cell as read: a number or a text.
#[derive(Clone, Debug, PartialEq)]
pub enum Read {
    Number(f64),
    Text(String),
}

pub type Rows = Vec<Vec<Read>>;

impl Kind {
    /// Columns that are read, numbers marked.
    pub fn columns(self) -> &'static [(&'static str, bool)] {
        match self {
            Self::Survey => &[
                ("id", false),
                ("diameter_m", true),
                ("x_m", true),
                ("y_m", true),
                ("z_m", true),
                ("sigma_m", true),
            ],
            Self::Ties => &[
                ("id", false),
                ("x_m", true),
                ("y_m", true),
                ("z_m", true),
                ("cad_x_m", true),
                ("cad_y_m", true),
                ("cad_z_m", true),
            ],
            Self::Stiffness => &[("s_m", true), ("ei_n_m2", true), ("sigma_ei_n_m2", true)],
            Self::Mountings => &[("image", false), ("mounting", false)],
            Self::Observations => &[
                ("id", false),
                ("u_px", true),
                ("v_px", true),
                ("sigma_px", true),
            ],
            Self::Corners => &[
                ("image", false),
                ("board_x_m", true),
                ("board_y_m", true),
                ("u_px", true),
                ("v_px", true),
            ],
            Self::Aircraft | Self::Iwg1 => {
                &[("utc", true), ("pressure_altitude_m", true), ("mach", true)]
            }
        }
    }

    /// Whether it is a table of aircraft data, in which lines and cells without a value are omitted with a message.
    pub fn is_aircraft(self) -> bool {
        matches!(self, Self::Aircraft | Self::Iwg1)
    }

    /// Header and rows of a sound table.
    pub fn sound_rows(self) -> Vec<Vec<String>> {
        let rows: Vec<String> = match self {
            Self::Survey => {
                let text = std::fs::read_to_string(fixture("dev/installation/survey.csv")).unwrap();
                text.lines()
                    .filter(|l| !l.starts_with('#'))
                    .map(str::to_owned)
                    .collect()
            }
            Self::Ties => (0..5)
                .map(|k| (k, k * k, 1.125 + f64::from(k * k % 4)))
                .map(|(k, s, z)| {
                    format!(
                        "T{k},{k}.5,{s}.25,{z},{}.5,{}.25,{}",
                        7 + k,
                        11 + s,
                        z - 3.0
                    )
                })
                .collect(),
            Self::Stiffness => (0..6)
                .map(|k| format!("{k}.5,{}e8,{}e7", 9 - k, 9 - k))
                .collect(),
            Self::Mountings => (0..6).map(|k| format!("f{k}.jpg,m{}", k / 2)).collect(),
            Self::Observations => (1..9)
                .map(|k| format!("M0{k},{}.5,{}.25,0.2{k}", 1000 + 100 * k, 800 + 50 * k))
                .collect(),
            Self::Corners => (0..8)
                .map(|k| {
                    format!(
                        "a.png,1280,960,0.{k},0.2{k},{}.5,{}.25,0.01,0.02,0.1,yes",
                        100 + 9 * k,
                        200 + 7 * k
                    )
                })
                .collect(),
            Self::Aircraft => (0..8)
                .map(|k| format!("2026-06-01T08:00:0{k}Z,1070{k},0.78{k},note {k}"))
                .collect(),
            Self::Iwg1 => {
                let row = |k| {
                    format!(
                        "IWG1,2026-06-01T08:00:0{k}Z,38.1,-75.2,10700.1,10665.2,3500{k},,230.1,231.2,260,0.78{k},,90.1,90.2"
                    )
                };
                (0..8).map(row).collect()
            }
        };
        let header = match self {
            Self::Survey => "",
            Self::Ties => "id,x_m,y_m,z_m,cad_x_m,cad_y_m,cad_z_m",
            Self::Stiffness => "s_m,ei_n_m2,sigma_ei_n_m2",
            Self::Mountings => "image,mounting",
            Self::Observations => "id,u_px,v_px,sigma_px",
            Self::Corners => {
                "image,width_px,height_px,board_x_m,board_y_m,u_px,v_px,sigma_u_px,sigma_v_px,correlation,used"
            }
            Self::Aircraft => "utc,pressure_altitude_m,mach,remark",
            Self::Iwg1 => "",
        };
        let header = (!header.is_empty()).then(|| header.to_owned());
        header
            .into_iter()
            .chain(rows)
            .map(|line| line.split(',').map(str::to_owned).collect())
            .collect()
    }
}

/// Strict RFC 4180, except for blanks around cells; `None` for invalid text.
fn cells(text: &str, comments: bool) -> Option<Vec<Vec<String>>> {
    let text = text.replace("\r\n", "\n");
    let kept = text
        .lines()
        .filter(|line| !(comments && line.trim_start().starts_with('#')));
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
            // No quoting by a quote inside a cell.
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

/// Cells of the columns that are read; `None` if they are undetermined.
pub fn read_strictly(kind: Kind, text: &str) -> Option<Rows> {
    if kind == Kind::Iwg1 {
        return Some(iwg1(text));
    }
    let rows = cells(text, !kind.is_aircraft())?;
    let (header, rows) = rows.split_first()?;
    let place = |name: &str| {
        let mut found = header
            .iter()
            .enumerate()
            .filter(|(_, cell)| *cell == name)
            .map(|(k, _)| k);
        found.next().filter(|_| found.next().is_none())
    };
    let places: Option<Vec<(usize, bool)>> = kind
        .columns()
        .iter()
        .map(|(name, number)| Some((place(name)?, *number)))
        .collect();
    let places = places?;
    let one = |row: &Vec<String>| {
        let many =
            row.iter().skip(header.len()).any(|cell| !cell.is_empty()) || row.len() < header.len();
        let read = |(k, number): &(usize, bool)| {
            let cell = row.get(*k)?;
            match (number, kind) {
                (false, _) => Some(Read::Text(cell.clone())),
                (true, _) if kind.is_aircraft() => Some(aircraft_cell(&header[*k], cell)),
                (true, _) => cell
                    .parse::<f64>()
                    .ok()
                    .filter(|v| v.is_finite())
                    .map(Read::Number),
            }
        };
        if many {
            None
        } else {
            places.iter().map(read).collect::<Option<Vec<Read>>>()
        }
    };
    // Truncated lines of aircraft data are omitted.
    rows.iter()
        .filter(|row| !kind.is_aircraft() || row.len() >= header.len())
        .map(one)
        .collect()
}

/// Lines of IWG1 by the positions of its fields; tables of lines with another number of fields are refused.
fn iwg1(text: &str) -> Rows {
    let width = Kind::Iwg1.sound_rows()[0].len();
    let quoted = |cell: &'_ str| {
        cell.strip_prefix('"')
            .and_then(|c| c.strip_suffix('"'))
            .map(str::to_owned)
    };
    let row = |line: &str| {
        let cells: Vec<String> = line
            .split(',')
            .map(|c| {
                quoted(c.trim())
                    .unwrap_or_else(|| c.into())
                    .trim()
                    .to_owned()
            })
            .collect();
        let sound = cells.len() == width && cells[0] == "IWG1";
        let read = |(k, name): (usize, &str)| aircraft_cell(name, &cells[k]);
        sound.then(|| [(1, "utc"), (6, "ft"), (11, "mach")].map(read).to_vec())
    };
    text.lines().filter_map(row).collect()
}

/// A cell of the aircraft table: a time, or a value; an invalid one is a text.
fn aircraft_cell(name: &str, cell: &str) -> Read {
    let utc = |civil: jiff::civil::DateTime| civil.to_zoned(jiff::tz::TimeZone::UTC).ok();
    let civil = || {
        cell.parse()
            .ok()
            .and_then(utc)
            .map(|zoned| zoned.timestamp())
    };
    let stamp = || {
        let stamp = cell.parse::<jiff::Timestamp>().ok().or_else(civil);
        stamp.map(|t| t.as_microsecond() as f64 * 1e-6)
    };
    let number = cell.parse::<f64>().ok().filter(|v| v.is_finite());
    let (scale, range) = match name {
        "pressure_altitude_m" => (1.0, -1000.0..=30_000.0),
        "ft" => (0.3048, -1000.0..=30_000.0),
        _ => (1.0, 0.0..=3.0),
    };
    let value = match name {
        "utc" => number.filter(|n| *n > 0.0).or_else(stamp),
        _ => number.map(|n| scale * n).filter(|v| range.contains(v)),
    };
    value.map_or(Read::Text(String::new()), Read::Number)
}
