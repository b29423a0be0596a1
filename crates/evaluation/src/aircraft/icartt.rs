//! Head of an ICARTT file (ICARTT File Format Standards 2.0): date, names, units, scale factors and missing values.

use jiff::civil::Date;

use super::mapping::{Mapping, StatedOnce, TableFormat};
use super::times::TimeFormat;
use wingd_base::fault::KeyFault;

/// Index of the line with the date of the data, counted from 0, as are those below.
pub(super) const DATE_LINE: usize = 6;
/// Index of the line with the independent variable, the time.
const TIME_LINE: usize = 8;
/// Index of the line with the scale factors of the other variables.
const FACTOR_LINE: usize = 10;
/// Index of the line with their numbers for missing values.
const MISSING_LINE: usize = 11;
/// Index of the first line with one of them.
const VARIABLE_LINE: usize = 12;
/// File format index of tables with one independent variable; others are not read.
const TABLE_INDEX: &str = "1001";

/// Head of an ICARTT file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct IcarttHead {
    /// Date from which the seconds of the day count, UTC.
    pub date: Date,
    /// Name of the column with the time.
    time: String,
    /// Names of the other columns, each with its unit, scale factor and number for a missing value.
    variables: Vec<(String, String, f64, f64)>,
}

fn split_cells(line: &str) -> Vec<&str> {
    line.split(',').map(str::trim).collect()
}

impl IcarttHead {
    /// Reads the head; `None` if the text does not begin with one.
    pub fn read(text: &str) -> Option<Self> {
        let lines: Vec<Vec<&str>> = text.lines().take(VARIABLE_LINE).map(split_cells).collect();
        let [length, index, ..] = lines.first()?[..] else {
            return None;
        };
        let length: usize = length.parse().ok().filter(|_| index == TABLE_INDEX)?;
        let [year, month, day, ..] = lines.get(DATE_LINE)?[..] else {
            return None;
        };
        let date = Date::new(year.parse().ok()?, month.parse().ok()?, day.parse().ok()?).ok()?;
        let time = (*lines.get(TIME_LINE)?.first()?).to_owned();
        let numbers = |k: usize| {
            lines
                .get(k)?
                .iter()
                .map(|c| c.parse().ok())
                .collect::<Option<Vec<f64>>>()
        };
        let (factors, missing) = (numbers(FACTOR_LINE)?, numbers(MISSING_LINE)?);
        let defined = text
            .lines()
            .take(length)
            .skip(VARIABLE_LINE)
            .zip(factors.iter().zip(&missing));
        let variable = |(line, (factor, missing)): (&str, (&f64, &f64))| {
            let cells = split_cells(line);
            let unit = cells.get(1).copied().unwrap_or_default();
            Some((
                (*cells.first()?).to_owned(),
                unit.to_owned(),
                *factor,
                *missing,
            ))
        };
        Some(Self {
            date,
            time,
            variables: defined.map(variable).collect::<Option<Vec<_>>>()?,
        })
    }

    /// Returns the numbers that stand for missing values.
    pub fn missing_values(&self) -> Vec<f64> {
        let mut all: Vec<f64> = self
            .variables
            .iter()
            .map(|(.., missing)| *missing)
            .collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    }

    /// Returns the factor by which the cells of a column are multiplied.
    pub fn column_factor(&self, name: &str) -> f64 {
        self.variables
            .iter()
            .find(|(known, ..)| known == name)
            .map_or(1.0, |(_, _, factor, _)| *factor)
    }

    /// Completes a mapping of this format by the time, the date and the units that it does not state.
    pub fn complete_mapping(&self, mapping: &Mapping) -> Mapping {
        let mut all = mapping.clone();
        if mapping.format != TableFormat::Icartt {
            return all;
        }
        if mapping.time.is_none() {
            (all.time, all.time_format) = (Some(self.time.clone()), TimeFormat::SecondsOfDay);
        }
        all.date = mapping.date.clone().or(Some(StatedOnce::Value(self.date)));
        for column in all
            .column
            .iter_mut()
            .filter(|c| c.unit.is_none() && c.scale.is_none() && c.offset.is_none())
        {
            let declared = self
                .variables
                .iter()
                .find(|(name, ..)| Some(name) == column.name.as_ref());
            column.unit = declared
                .map(|(_, unit, ..)| unit.clone())
                .filter(|unit| !unit.is_empty());
        }
        all
    }
}

/// Returns the error of a file that is not one of ICARTT.
pub(super) fn missing_head_fault() -> KeyFault {
    let remedy = "delete format = \"icartt\" from the mapping, or save the file with its head";
    KeyFault::on_line(
        1,
        "",
        "is not the first line of an ICARTT file of format 1001",
        remedy,
    )
}
