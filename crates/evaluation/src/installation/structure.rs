//! Bending stiffness along the span: `s_m,ei_n_m2,sigma_ei_n_m2`.

use std::path::Path;

use super::{Reader, tables};
use crate::installation::{TableLine, read_table};
use wingd_measure::setup::StiffnessSection;

/// Columns. The last two are optional, and read by `wingd-loads` alone.
const COLUMNS: [&str; 5] = [
    "s_m",
    "ei_n_m2",
    "sigma_ei_n_m2",
    "ground_n_m",
    "ultimate_n_m",
];

/// Reads the stiffness at stations from root to tip that `[structure]` of an installation names.
pub(super) fn read_structure(
    reader: &mut Reader,
    structure: Option<&tables::StructureTable>,
) -> Option<Vec<StiffnessSection>> {
    let remedy = "name the file in structure.stiffness of installation.toml";
    read_sections(reader, &structure?.stiffness, remedy)
}

fn read_sections(
    reader: &mut Reader,
    name: impl AsRef<Path>,
    remedy: &str,
) -> Option<Vec<StiffnessSection>> {
    let (file, lines) = read_table(reader, name, remedy, COLUMNS, &COLUMNS[3..])?;
    if lines.is_empty() {
        reader.fault(
            &file,
            "file",
            "has no stations",
            "add one line per station along the span",
        );
        return None;
    }
    let before = reader.faults.len();
    let mut sections: Vec<StiffnessSection> = vec![];
    for line in lines {
        let Some(section) = parse_section(reader, &line) else {
            continue;
        };
        if sections.last().is_some_and(|last| section.s_m <= last.s_m) {
            let remedy = "order the stations from the root to the tip, each once";
            line.cell_fault(
                reader,
                0,
                format!("{} m is not outboard of the previous line", section.s_m),
                remedy,
            );
        }
        sections.push(section);
    }
    (reader.faults.len() == before).then_some(sections)
}

fn parse_section(reader: &mut Reader, line: &TableLine<5>) -> Option<StiffnessSection> {
    let [s_m, ei_n_m2, sigma_ei_n_m2] = line.parse_numbers(reader, 0)?;
    let section = StiffnessSection {
        s_m,
        ei_n_m2,
        sigma_ei_n_m2,
    };
    let sigma_range = 0.0..=section.ei_n_m2.max(0.0);
    let checks = [
        (
            0,
            (0.0..=100.0).contains(&section.s_m),
            "give the distance from the bending root, 0 to 100 m",
        ),
        (
            1,
            section.ei_n_m2 > 0.0,
            "give the bending stiffness in N m^2, above 0",
        ),
        (
            2,
            sigma_range.contains(&section.sigma_ei_n_m2),
            "give the standard deviation in N m^2, from 0 to the stiffness",
        ),
    ];
    for (k, _, remedy) in checks.into_iter().filter(|(_, holds, _)| !holds) {
        line.cell_fault(reader, k, format!("is {}", line.cells[k]), remedy);
    }
    Some(section)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use wingd_base::fault::Fault;

    fn read(text: &str) -> Result<Vec<StiffnessSection>, Vec<Fault>> {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("structure.csv");
        std::fs::write(&file, text).unwrap();
        Reader::read_file(&file, |reader, name| read_sections(reader, name, ""))
    }

    #[test]
    fn columns_may_be_omitted_and_cells_empty() {
        let found = read("s_m,ei_n_m2,sigma_ei_n_m2\n0,2e9,1e8\n10,1e9,5e7\n").unwrap();
        assert_eq!((found.len(), found[1].s_m), (2, 10.0));
        let found = read("s_m,ei_n_m2,sigma_ei_n_m2,ultimate_n_m\n0,2e9,1e8,\n1,2e9,1e8,4e7\n");
        assert_eq!(found.unwrap().len(), 2);
    }

    #[test]
    fn every_error_is_reported_with_its_line() {
        let faults = read("s_m,ei_n_m2,sigma_ei_n_m2\n5,2e9,1e8\n3,-1,x\n2,1e9,2e9\n-1,1e9,1e7\n")
            .unwrap_err();
        let places: Vec<&str> = faults.iter().map(|f| f.place.as_str()).collect();
        let expected = [
            "line 3, column sigma_ei_n_m2",
            "line 4, column sigma_ei_n_m2",
            "line 4, column s_m",
        ];
        assert_eq!(places[..3], expected, "{faults:?}");
        assert_eq!(places[3..], ["line 5, column s_m", "line 5, column s_m"]);
        assert!(read("s_m,ei_n_m2,sigma_ei_n_m2\n").is_err());
        assert!(read("s_m;ei_n_m2;sigma_ei_n_m2\n0;1;1\n").is_err());
    }
}
