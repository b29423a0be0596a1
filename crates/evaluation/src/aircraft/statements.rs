//! Units, dates and zones that a table states, compared with its mapping: a contradiction is an error that names both sides.

use jiff::civil::Date;

use super::layout::Layout;
use super::mapping::{MappedColumn, Mapping, StatedOnce};
use super::times::parse_date;
use super::units::{self, UnitMeaning};
use crate::installation::Row;
use wingd_base::clock::written_time::{offset_text, parse_offset};
use wingd_base::fault::KeyFault;

/// Checks the units that the names of the columns and the rows above the header state: a row of units or of long names, or a
/// definition of each column (`OAT, deg C`).
pub(super) fn check_units(
    mapping: &Mapping,
    layout: &Layout,
    (above, header): (&[Row], &Row),
    remarks: &mut Vec<String>,
) -> Result<(), KeyFault> {
    for (named, column) in mapping.column.iter().zip(&layout.column) {
        let name = named.name.as_deref().unwrap_or_default();
        if let Some(unit) =
            units::unit_in_brackets(name).or_else(|| units::unit_suffix(named.quantity, name))
        {
            check_unit(named, unit, header.line, remarks)?;
        }
        for row in above {
            let defined = row
                .cells
                .get(1)
                .filter(|_| row.cells.first().is_some_and(|first| first == name));
            // A row that begins with the name of a column defines that column.
            let defines = row
                .cells
                .first()
                .is_some_and(|first| header.cells.contains(first));
            let aligned = !defines && row.cells.len() + 1 >= header.cells.len();
            let cell = row.cells.get(column.field - 1).filter(|_| aligned);
            let cell = cell.map(|cell| cell.trim_start_matches('#').trim());
            let stated = [
                defined.map(String::as_str),
                cell,
                cell.and_then(units::unit_in_brackets),
            ];
            let is_unit = |text: &&str| {
                !matches!(
                    units::find_unit(named.quantity, text),
                    UnitMeaning::Unknown | UnitMeaning::Absent
                )
            };
            if let Some(unit) = stated.into_iter().flatten().find(is_unit) {
                check_unit(named, unit, row.line, remarks)?;
            }
        }
    }
    Ok(())
}

/// Checks the unit that a table states against the mapping.
pub(super) fn check_unit(
    named: &MappedColumn,
    unit: &str,
    line: u64,
    remarks: &mut Vec<String>,
) -> Result<(), KeyFault> {
    let name = named.name.as_deref().unwrap_or_default();
    let quantity = named.quantity.name();
    match units::find_unit(named.quantity, unit) {
        UnitMeaning::Absent => Ok(()),
        UnitMeaning::Known(scale, offset)
            if units::same_conversion(named.conversion(), (scale, offset)) =>
        {
            Ok(())
        }
        UnitMeaning::Unknown => {
            remarks.push(format!(
                "the unit {unit} of {quantity} is unknown: the mapping's scale is used"
            ));
            Ok(())
        }
        UnitMeaning::Known(scale, offset) => {
            let (own, own_offset) = named.conversion();
            let stated = named
                .unit
                .as_ref()
                .map_or(String::new(), |unit| format!("unit = \"{unit}\": "));
            let problem = format!(
                "is in {unit}, but the mapping converts it to {quantity} by {stated}scale = {own}, offset = {own_offset}"
            );
            let remedy = format!("write scale = {scale}, offset = {offset}, or unit = \"{unit}\"");
            Err(KeyFault::on_line(line, name, problem, remedy))
        }
        UnitMeaning::WrongDimension => {
            let problem = format!("is in {unit}, which is not a unit of {quantity}");
            Err(KeyFault::on_line(
                line,
                name,
                problem,
                "name the column of that quantity",
            ))
        }
    }
}

/// Checks a date that the table states, in a column or in its head, against the mapping's.
pub(super) fn check_date(
    mapping: &Mapping,
    (line, column): (u64, &str),
    stated: Date,
) -> Result<(), KeyFault> {
    match &mapping.date {
        Some(StatedOnce::Value(date)) if *date != stated => {
            let problem =
                format!("states the date {stated}, but the mapping has date = \"{date}\"");
            let remedy = match column {
                "" => format!("write date = \"{stated}\""),
                column => format!("write date = \"{column}\", the name of the column"),
            };
            Err(KeyFault::on_line(line, column, problem, remedy))
        }
        _ => Ok(()),
    }
}

/// Checks a date and a zone in columns of a record that the mapping does not name.
pub(super) fn check_date_and_zone(
    mapping: &Mapping,
    layout: &Layout,
    header: &Row,
    row: &Row,
) -> Result<(), KeyFault> {
    let local = |zone_s| {
        Layout {
            zone_s: Some(zone_s),
            zone_field: None,
            ..layout.clone()
        }
        .sample(&row.cells)
    };
    let (Some(at_utc), Some(at_zone)) = (local(0), local(3600)) else {
        return Ok(());
    };
    let taken = [
        Some(layout.time_field),
        layout.date_field,
        layout.zone_field,
    ];
    for (k, (name, cell)) in header.cells.iter().zip(&row.cells).enumerate() {
        if taken.contains(&Some(k + 1)) || layout.column.iter().any(|column| column.field == k + 1)
        {
            continue;
        }
        if let Some(date) = parse_date(cell).filter(|_| name.to_lowercase().contains("date")) {
            check_date(mapping, (row.line, name), date)?;
        }
        // A time with a zone of its own does not depend on the column.
        let zone =
            parse_offset(cell).filter(|_| cell.starts_with(['+', '-']) && cell.contains(':'));
        let Some(zone) = zone.filter(|_| at_utc.time_s != at_zone.time_s) else {
            continue;
        };
        if layout.zone_field.is_none() && zone.seconds() != layout.zone_s.unwrap_or(0) {
            let used = match &mapping.zone {
                Some(StatedOnce::Value(zone)) => {
                    format!("the mapping has zone = \"{}\"", offset_text(*zone))
                }
                _ => "the mapping takes the times as UTC".to_owned(),
            };
            let problem = format!("states the zone {}, but {used}", offset_text(zone));
            let remedy = format!(
                "write zone = \"{name}\", the name of the column, or delete that column if it is wrong"
            );
            return Err(KeyFault::on_line(row.line, name, problem, remedy));
        }
    }
    Ok(())
}
