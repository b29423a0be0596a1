//! Columns of a table: read, missing, almost right, and not read ones.

use std::path::Path;

use super::fold::MAX_SIMILAR_FAULTS;
use super::reader::Reader;
use wingd_base::fault::Fault;

/// Returns the index of each column in the header; reports missing, repeated and almost right ones, and names the unread.
pub(super) fn find_columns<const N: usize>(
    reader: &mut Reader,
    file: &Path,
    (line, cells): (u64, &[String]),
    columns: [&'static str; N],
    optional: &[&str],
) -> Option<[Option<usize>; N]> {
    let needed = columns
        .iter()
        .filter(|c| !optional.contains(c))
        .copied()
        .collect::<Vec<_>>();
    let place = format!("line {line}");
    if let Some(separator) = foreign_separator(cells) {
        let problem = format!("is separated by {separator}");
        reader.fault(
            file,
            &place,
            problem,
            "save it with commas between the columns and decimal points in the numbers",
        );
        return None;
    }
    let index = columns.map(|name| cells.iter().position(|h| h == name));
    let before = reader.faults.len();
    for name in columns
        .iter()
        .filter(|name| cells.iter().filter(|h| h == *name).count() > 1)
    {
        reader.fault(
            file,
            &format!("column {name}"),
            "occurs twice",
            "keep the valid one",
        );
    }
    let absent = columns.iter().zip(&index).filter(|(_, k)| k.is_none());
    let absent: Vec<&'static str> = absent.map(|(name, _)| *name).collect();
    let mut missing = absent.clone();
    missing.retain(|name| needed.contains(name));
    let otherwise = |name: &str| cells.iter().any(|h| h.eq_ignore_ascii_case(name));
    let remedy = format!("the header must have {}", needed.join(","));
    if !missing.is_empty() && missing.iter().all(|name| otherwise(name)) {
        let problem = format!("has capital letters in the header {}", cells.join(","));
        reader.fault(
            file,
            &place,
            problem,
            format!("write it in lower case: {}", needed.join(",")),
        );
        return None;
    }
    let mut unread = vec![];
    for name in cells
        .iter()
        .filter(|c| !c.is_empty() && !columns.contains(&c.as_str()))
    {
        let place = format!("column {name}");
        match column_meant(name, &absent) {
            Some(known) => {
                missing.retain(|other| *other != known);
                let remedy = format!("write {known}, with values in its unit");
                reader.fault(file, &place, format!("is not read, but {known} is"), remedy);
            }
            None if name.to_lowercase().starts_with("sigma") => {
                let remedy = format!("write one of {}, or delete it", columns.join(","));
                reader.fault(
                    file,
                    &place,
                    "is a standard deviation that is not read",
                    remedy,
                );
            }
            None => unread.push(name.as_str()),
        }
    }
    if missing.len() > MAX_SIMILAR_FAULTS {
        reader.fault(
            file,
            &place,
            format!("is not a header with {}", missing.join(", ")),
            remedy,
        );
    } else {
        for name in missing {
            reader.fault(
                file,
                &format!("column {name}"),
                "is missing",
                remedy.clone(),
            );
        }
    }
    if !unread.is_empty() {
        let problem = format!("columns that are not read: {}", unread.join(", "));
        let remedy = format!("known are {}", columns.join(","));
        reader.notes.push(Fault::new(file, place, problem, remedy));
    }
    (reader.faults.len() == before).then_some(index)
}

/// Units at the end of columns' names, in lower case.
const UNITS: [&str; 36] = [
    "m", "mm", "cm", "um", "km", "ft", "in", "px", "deg", "rad", "mrad", "s", "ms", "min", "h",
    "kg", "g", "t", "lb", "lbs", "c", "k", "f", "hpa", "pa", "kpa", "psi", "mbar", "n", "kn", "nm",
    "nm2", "kt", "kts", "percent", "hz",
];

/// Returns the known column that a name means: it differs in case, signs or unit only.
fn column_meant<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let base = |name: &str| {
        let lower = name.to_lowercase();
        let words = lower.split(|c: char| !c.is_alphanumeric());
        let mut words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
        while words.len() > 1 && words.last().is_some_and(|last| UNITS.contains(last)) {
            words.pop();
        }
        words.concat()
    };
    let meant = base(name);
    known.iter().find(|known| base(known) == meant).copied()
}

/// Returns the separator other than a comma if the header is one cell for that reason.
fn foreign_separator(header: &[String]) -> Option<&'static str> {
    let [only] = header else { return None };
    [(';', "semicolons"), ('\t', "tabs"), ('|', "bars")]
        .into_iter()
        .find(|(c, _)| only.contains(*c))
        .map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_in_another_case_or_unit_is_meant() {
        let known = [
            "fixed",
            "flight_motion_m",
            "calibrated_airspeed_m_s",
            "weight_kg",
        ];
        for (name, meant) in [
            ("Fixed", Some("fixed")),
            ("fixed?", Some("fixed")),
            ("flight_motion_mm", Some("flight_motion_m")),
            ("flight motion [mm]", Some("flight_motion_m")),
            ("calibrated_airspeed_kt", Some("calibrated_airspeed_m_s")),
            ("weight", Some("weight_kg")),
            ("surface", None),
            ("fix", None),
        ] {
            assert_eq!(column_meant(name, &known), meant, "{name}");
        }
    }
}
