//! Bending stiffness along the span: `s_m,ei_n_m2,sigma_ei_n_m2`.

use std::path::Path;

use super::{Fault, Reader, rows, tables};
use crate::measure::stress::{Section, USUAL_BENDING_HZ};

const COLUMNS: [&str; 5] = ["s_m", "ei_n_m2", "sigma_ei_n_m2", "ground_n_m", "ultimate_n_m"];
/// Columns that need not be there.
const OPTIONAL: [&str; 2] = ["ground_n_m", "ultimate_n_m"];
/// Lowest bending frequencies that are believed, Hz.
const BENDING_HZ: (f64, f64) = (0.05, 100.0);

/// The wing as a beam.
#[derive(Clone, Debug, PartialEq)]
pub struct Structure {
    /// Where the stiffness is known, from root to tip.
    pub sections: Vec<Section>,
    /// Lowest bending frequency, Hz.
    pub bending_hz: f64,
}

/// Reads `[structure]` of an installation.
pub(super) fn of_installation(
    reader: &mut Reader,
    installation: &Path,
    structure: Option<&tables::Structure>,
) -> Option<Structure> {
    let structure = structure?;
    let bending_hz = structure.bending_hz.unwrap_or(USUAL_BENDING_HZ);
    if !(BENDING_HZ.0..=BENDING_HZ.1).contains(&bending_hz) {
        let mend =
            format!("give the wing's lowest bending frequency, {} to {} Hz", BENDING_HZ.0, BENDING_HZ.1);
        reader.fault(installation, "structure.bending_hz", format!("is {bending_hz}"), mend);
    }
    let mend = "name the file in structure.stiffness of installation.toml";
    let sections = sections(reader, &structure.stiffness, mend)?;
    Some(Structure { sections, bending_hz })
}

/// Reads a table of stiffness that lies anywhere.
pub fn read_stiffness(file: &Path) -> Result<Vec<Section>, Vec<Fault>> {
    let (mut reader, name) = Reader::of_file(file);
    let mend = format!("name a file with the columns {},{},{}", COLUMNS[0], COLUMNS[1], COLUMNS[2]);
    let found = sections(&mut reader, &name, &mend);
    found.filter(|_| reader.faults.is_empty()).ok_or_else(|| super::folded(reader.faults))
}

fn sections(reader: &mut Reader, name: impl AsRef<Path>, mend: &str) -> Option<Vec<Section>> {
    let (file, text) = reader.text(name, mend)?;
    let lines = rows::read(reader, &file, &text, COLUMNS, &OPTIONAL)?;
    if lines.is_empty() {
        reader.fault(&file, "file", "holds no station", "add one line per station along the span");
        return None;
    }
    let before = reader.faults.len();
    let mut sections: Vec<Section> = vec![];
    for (line, cells) in lines {
        let Some(section) = section(reader, &file, line, &cells) else { continue };
        if sections.last().is_some_and(|last| section.s_m <= last.s_m) {
            let place = format!("line {line}, column s_m");
            let mend = "order the stations from the root to the tip, each once";
            reader.fault(
                &file,
                &place,
                format!("{} m is not outboard of the line before", section.s_m),
                mend,
            );
        }
        sections.push(section);
    }
    (reader.faults.len() == before).then_some(sections)
}

fn section(reader: &mut Reader, file: &Path, line: u64, cells: &[String; 5]) -> Option<Section> {
    let mut cell = |k: usize| rows::number(reader, file, line, COLUMNS[k], &cells[k]);
    let (s_m, ei, sigma) = (cell(0), cell(1), cell(2));
    let ground_n_m = if cells[3].is_empty() { Some(0.0) } else { cell(3) };
    let ultimate = if cells[4].is_empty() { Some(None) } else { cell(4).map(Some) };
    let section = Section {
        s_m: s_m?,
        ei_n_m2: ei?,
        sigma_ei_n_m2: sigma?,
        ground_n_m: ground_n_m?,
        ultimate_n_m: ultimate?,
    };
    let ranges = [
        ("s_m", (0.0..=100.0).contains(&section.s_m), "give the distance from the bending root, 0 to 100 m"),
        ("ei_n_m2", section.ei_n_m2 > 0.0, "give the bending stiffness in N m^2, above 0"),
        (
            "sigma_ei_n_m2",
            (0.0..=section.ei_n_m2.max(0.0)).contains(&section.sigma_ei_n_m2),
            "give the standard deviation in N m^2, from 0 to the stiffness",
        ),
        (
            "ultimate_n_m",
            section.ultimate_n_m.is_none_or(|m| m > 0.0),
            "give the moment at failure in N m, above 0, or leave the cell empty",
        ),
    ];
    for (column, _, mend) in ranges.iter().filter(|(_, holds, _)| !holds) {
        let value = COLUMNS.iter().position(|c| c == column).and_then(|k| cells.get(k));
        let problem = format!("is {}", value.map_or("", String::as_str));
        reader.fault(file, &format!("line {line}, column {column}"), problem, *mend);
    }
    Some(section)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn read(text: &str) -> Result<Vec<Section>, Vec<Fault>> {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("structure.csv");
        std::fs::write(&file, text).unwrap();
        read_stiffness(&file)
    }

    #[test]
    fn columns_may_be_left_out_and_cells_empty() {
        let found = read("s_m,ei_n_m2,sigma_ei_n_m2\n0,2e9,1e8\n10,1e9,5e7\n").unwrap();
        assert_eq!((found.len(), found[1].s_m, found[1].ground_n_m), (2, 10.0, 0.0));
        let found = read("s_m,ei_n_m2,sigma_ei_n_m2,ultimate_n_m\n0,2e9,1e8,\n1,2e9,1e8,4e7\n").unwrap();
        assert_eq!((found[0].ultimate_n_m, found[1].ultimate_n_m), (None, Some(4e7)));
    }

    #[test]
    fn every_fault_is_named_with_its_line() {
        let faults =
            read("s_m,ei_n_m2,sigma_ei_n_m2\n5,2e9,1e8\n3,-1,x\n2,1e9,2e9\n-1,1e9,1e7\n").unwrap_err();
        let places: Vec<&str> = faults.iter().map(|f| f.place.as_str()).collect();
        let expected = ["line 3, column sigma_ei_n_m2", "line 4, column sigma_ei_n_m2", "line 4, column s_m"];
        assert_eq!(places[..3], expected, "{faults:?}");
        assert_eq!(places[3..], ["line 5, column s_m", "line 5, column s_m"]);
        assert!(read("s_m,ei_n_m2,sigma_ei_n_m2\n").is_err());
        assert!(read("s_m;ei_n_m2;sigma_ei_n_m2\n0;1;1\n").is_err());
    }
}
