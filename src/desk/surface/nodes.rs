//! CSV of nodes: `id,x_m,y_m,z_m`; the id may be missing, the unit is in the names of the columns.

use std::collections::HashMap;
use std::io::BufRead;

use super::lines::TextLines;
use super::{FacetList, Surface, SurfaceFormat, parse_point};
use crate::installation::{KeyFault, LENGTH_UNITS, LengthUnit};

/// Remedy for a header without the columns of a node.
const HEADER_REMEDY: &str =
    "write the header id,x_m,y_m,z_m, or x_mm, x_cm, x_in, x_ft by the unit; id may be missing";

/// Columns of a header: unit, coordinates, number of the node.
fn parse_header(
    header: &str,
    given: Option<LengthUnit>,
) -> Result<(LengthUnit, [usize; 3], Option<usize>), String> {
    if header.contains([';', '\t']) {
        return Err("is not separated by commas".into());
    }
    let names: Vec<String> = header
        .split(',')
        .map(|cell| cell.trim_matches(['"', ' ']).to_lowercase())
        .collect();
    let find = |name: &str| names.iter().position(|cell| cell == name);
    let columns = |unit: &LengthUnit| {
        let [x, y, z] = ["x", "y", "z"].map(|axis| find(&format!("{axis}_{}", unit.name)));
        Some((*unit, [x?, y?, z?], find("id")))
    };
    let mut found = LENGTH_UNITS.iter().filter_map(columns);
    let (Some(columns), None) = (found.next(), found.next()) else {
        return Err("is not a header with three coordinates of one unit".into());
    };
    match given {
        Some(unit) if unit != columns.0 => Err(format!(
            "gives coordinates in {}, but --unit says {}",
            columns.0.name, unit.name
        )),
        _ => Ok(columns),
    }
}

/// Reads the nodes of a table; numbers without an id are the positions, from 1.
pub(super) fn read_nodes<R: BufRead>(
    mut lines: TextLines<R>,
    given: Option<LengthUnit>,
) -> Result<Surface, KeyFault> {
    if !lines.advance('#')? {
        return Err(KeyFault::new("", "is empty", HEADER_REMEDY));
    }
    let (unit, axes, id) =
        parse_header(&lines.text, given).map_err(|problem| lines.fault(problem, HEADER_REMEDY))?;
    let (mut points, mut ids, mut known) = (vec![], vec![], HashMap::new());
    while lines.advance('#')? {
        let cells: Vec<&str> = lines
            .text
            .split(',')
            .map(|cell| cell.trim_matches(['"', ' ']))
            .collect();
        let cell = |k: usize| cells.get(k).copied().unwrap_or_default();
        let Some(point) = parse_point(axes.into_iter().map(cell)) else {
            let problem = format!("has no three finite coordinates ({})", lines.excerpt());
            return Err(lines.fault(
                problem,
                "give decimal numbers with a point, one node a line",
            ));
        };
        if let Some(k) = id {
            let Ok(number) = cell(k).parse::<u64>() else {
                let problem = format!("has an id that is not a whole number ({})", lines.excerpt());
                return Err(lines.fault(problem, "number the nodes, or delete the column id"));
            };
            if let Some(line) = known.insert(number, lines.number) {
                return Err(lines.fault(
                    format!("repeats node {number} of line {line}"),
                    "give each node one number",
                ));
            }
            ids.push(number);
        } else {
            ids.push(points.len() as u64 + 1);
        }
        points.push(point);
    }
    if points.is_empty() {
        return Err(lines.end_fault("it has no node"));
    }
    Ok(Surface {
        points,
        ids,
        facets: FacetList::default(),
        unit,
        format: SurfaceFormat::Nodes,
    })
}
