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
}

pub const KINDS: [Kind; 7] = [
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
            Self::Observations => &[("id", false), ("u_px", true), ("v_px", true), ("sigma_px", true)],
            Self::Corners => {
                &[("image", false), ("board_x_m", true), ("board_y_m", true), ("u_px", true), ("v_px", true)]
            }
            Self::Aircraft => &[("UTC", true), ("FL", true), ("MACH", true)],
        }
    }

    /// Header and rows of a sound one.
    pub fn sound(self) -> Vec<Vec<String>> {
        let rows: Vec<String> = match self {
            Self::Survey => {
                let text = std::fs::read_to_string(fixture("dev/installation/survey.csv")).unwrap();
                text.lines().filter(|l| !l.starts_with('#')).map(str::to_owned).collect()
            }
            Self::Ties => (0..5)
                .map(|k| (k, k * k))
                .map(|(k, s)| format!("T{k},{k}.5,{s}.25,1.125,{}.5,{}.25,-1.875", 7 + k, 11 + s))
                .collect(),
            Self::Stiffness => (0..6).map(|k| format!("{k}.5,{}e8,{}e7", 9 - k, 9 - k)).collect(),
            Self::Mountings => (0..6).map(|k| format!("f{k}.jpg,m{}", k / 2)).collect(),
            Self::Observations => {
                (1..9).map(|k| format!("M0{k},{}.5,{}.25,0.2{k}", 1000 + 100 * k, 800 + 50 * k)).collect()
            }
            Self::Corners => (0..8)
                .map(|k| {
                    format!(
                        "a.png,1280,960,0.{k},0.2{k},{}.5,{}.25,0.01,0.02,0.1,yes",
                        100 + 9 * k,
                        200 + 7 * k
                    )
                })
                .collect(),
            Self::Aircraft => {
                (0..8).map(|k| format!("2026-06-01T08:00:0{k}Z,35{k},0.78{k},note {k}")).collect()
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
            Self::Aircraft => "UTC,FL,MACH,REMARK",
        };
        let header = (!header.is_empty()).then(|| header.to_owned());
        header.into_iter().chain(rows).map(|line| line.split(',').map(str::to_owned).collect()).collect()
    }
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
pub fn strict(kind: Kind, text: &str) -> Option<Rows> {
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
    let utc = |civil: jiff::civil::DateTime| civil.to_zoned(jiff::tz::TimeZone::UTC).ok();
    let civil = || cell.parse().ok().and_then(utc).map(|zoned| zoned.timestamp());
    let stamp = || {
        let stamp = cell.parse::<jiff::Timestamp>().ok().or_else(civil);
        stamp.map(|t| t.as_microsecond() as f64 * 1e-6)
    };
    let number = cell.parse::<f64>().ok().filter(|v| v.is_finite());
    let (scale, most) = if header[k] == "FL" { (30.48, 30_000.0) } else { (1.0, 3.0) };
    let value = match header[k].as_str() {
        "UTC" => number.filter(|n| *n > 0.0).or_else(stamp),
        _ => number
            .map(|n| scale * n)
            .filter(|v| (-1000.0..=most).contains(v) && (header[k] == "FL" || *v >= 0.0)),
    };
    value.map_or(Read::Text(String::new()), Read::Number)
}
