//! Markers of an SU2 mesh: the nodes of the boundary elements with these tags, numbered as in the mesh from 0.

use std::collections::BTreeMap;
use std::io::BufRead;

use nalgebra::Vector3;

use super::lines::TextLines;
use super::{EXPORT_REMEDY, FacetList, Surface, SurfaceFormat, parse_point};
use crate::installation::{KeyFault, LengthUnit};

/// VTK type and number of corners of the elements of a surface: triangle, quadrilateral.
const SURFACE_ELEMENTS: [(&str, usize); 2] = [("5", 3), ("9", 4)];
/// Number of tags that a message names.
const MAX_NAMED: usize = 20;

/// Mesh as far as it has been read.
#[derive(Default)]
struct Mesh {
    points: Option<Vec<Vector3<f64>>>,
    facets: FacetList,
    tags: Vec<String>,
    /// Largest index of a corner, with its line.
    last_corner: (usize, u64),
}

/// Reads the nodes of the wanted markers; a node that several share is listed once.
pub(super) fn read_su2<R: BufRead>(
    mut lines: TextLines<R>,
    wanted: &[&str],
    unit: LengthUnit,
) -> Result<Surface, KeyFault> {
    let mut mesh = Mesh::default();
    // Lines after keys of other sections, such as boxes of free-form deformation, are skipped.
    let mut skips = false;
    while lines.advance('%')? {
        let Some((key, value)) = lines.text.split_once('=') else {
            if skips {
                continue;
            }
            let problem = format!("belongs to no section ({})", lines.excerpt());
            return Err(lines.fault(problem, "correct the count of the section before it"));
        };
        let (key, value) = (key.trim().to_owned(), value.trim().to_owned());
        skips = read_section(&mut mesh, &mut lines, (&key, &value), wanted)?;
    }
    mesh.into_surface(&lines, wanted, unit)
}

/// Reads the section of a key; returns true if the key has another section, whose lines follow.
fn read_section<R: BufRead>(
    mesh: &mut Mesh,
    lines: &mut TextLines<R>,
    (key, value): (&str, &str),
    wanted: &[&str],
) -> Result<bool, KeyFault> {
    match key {
        "NDIME" if value != "3" => {
            let problem = format!("is a mesh of {value} dimensions");
            Err(lines.fault(
                problem,
                "give a mesh of three dimensions: a wing's surface has no other",
            ))
        }
        "NZONE" if value != "1" => {
            Err(lines.fault("is a mesh of several zones", "give each zone as a file"))
        }
        "NELEM" => {
            let count = parse_count(lines, value)?;
            for_each_line(lines, key, count, |_| Ok(()))?;
            Ok(false)
        }
        "NPOIN" if mesh.points.is_some() => Err(lines.fault("repeats the points", EXPORT_REMEDY)),
        "NPOIN" => {
            let (count, mut points) = (parse_count(lines, value)?, vec![]);
            for_each_line(lines, key, count, |lines| {
                let fault = || {
                    lines.fault(
                        format!("is not a point ({})", lines.excerpt()),
                        EXPORT_REMEDY,
                    )
                };
                points.push(parse_point(lines.text.split_whitespace()).ok_or_else(fault)?);
                Ok(())
            })?;
            mesh.points = Some(points);
            Ok(false)
        }
        "MARKER_TAG" => {
            if wanted.contains(&value) && mesh.tags.iter().any(|tag| tag == value) {
                return Err(lines.fault(
                    format!("repeats the marker {value}"),
                    "give each marker one tag",
                ));
            }
            mesh.tags.push(value.to_owned());
            Ok(false)
        }
        "MARKER_ELEMS" => {
            let count = parse_count(lines, value)?;
            let is_wanted = mesh
                .tags
                .last()
                .is_some_and(|tag| wanted.contains(&tag.as_str()));
            for_each_line(lines, key, count, |lines| {
                if is_wanted {
                    add_element(mesh, lines)
                } else {
                    Ok(())
                }
            })?;
            Ok(false)
        }
        "NDIME" | "NZONE" | "NMARK" => Ok(false),
        _ => Ok(true),
    }
}

fn add_element<R: BufRead>(mesh: &mut Mesh, lines: &TextLines<R>) -> Result<(), KeyFault> {
    let fault = || {
        let problem = format!(
            "is not a triangle (5) or quadrilateral (9) with its nodes ({})",
            lines.excerpt()
        );
        lines.fault(problem, EXPORT_REMEDY)
    };
    let mut words = lines.text.split_whitespace();
    let kind = words.next().unwrap_or_default();
    let (_, count) = SURFACE_ELEMENTS
        .into_iter()
        .find(|(name, _)| *name == kind)
        .ok_or_else(fault)?;
    let corners: Vec<usize> = words
        .take(count)
        .map_while(|word| word.parse().ok())
        .collect();
    if corners.len() < count {
        return Err(fault());
    }
    let largest = corners.iter().copied().max().unwrap_or_default();
    if largest > mesh.last_corner.0 {
        mesh.last_corner = (largest, lines.number);
    }
    mesh.facets.add(corners);
    Ok(())
}

impl Mesh {
    /// Keeps the nodes of the facets.
    fn into_surface<R: BufRead>(
        self,
        lines: &TextLines<R>,
        wanted: &[&str],
        unit: LengthUnit,
    ) -> Result<Surface, KeyFault> {
        let Self {
            points,
            facets,
            tags,
            last_corner,
        } = self;
        let points = points.ok_or_else(|| lines.end_fault("it has no points (NPOIN)"))?;
        let missing = wanted
            .iter()
            .find(|tag| !tags.iter().any(|there| there == *tag));
        if let Some(problem) = match missing {
            Some(tag) => Some(format!("has no marker {tag}")),
            None => wanted
                .is_empty()
                .then(|| "needs the markers of the wing".into()),
        } {
            let known: Vec<&str> = tags.iter().take(MAX_NAMED).map(String::as_str).collect();
            let remedy = format!("name some of {}: mesh.su2:MARKER,MARKER", known.join(", "));
            return Err(KeyFault::new("", problem, remedy));
        }
        let (largest, line) = last_corner;
        if largest >= points.len() && !facets.ends.is_empty() {
            let problem = format!(
                "names node {largest}, but the mesh has {} points, from 0",
                points.len()
            );
            return Err(KeyFault::on_line(line, "", problem, EXPORT_REMEDY));
        }
        if facets.ends.is_empty() {
            return Err(KeyFault::new(
                "",
                format!("has no element of {}", wanted.join(", ")),
                "name another marker",
            ));
        }
        let used: BTreeMap<usize, ()> = facets.corners.iter().map(|k| (*k, ())).collect();
        let ids: Vec<usize> = used.into_keys().collect();
        // Every corner is among them.
        let place = |corner: &usize| ids.partition_point(|id| id < corner);
        let corners = facets.corners.iter().map(place).collect();
        Ok(Surface {
            points: ids.iter().map(|k| points[*k]).collect(),
            ids: ids.iter().map(|k| *k as u64).collect(),
            facets: FacetList {
                corners,
                ends: facets.ends,
            },
            unit,
            format: SurfaceFormat::Su2,
        })
    }
}

/// Reads a number of lines; the first word of a count is the count.
fn parse_count<R: BufRead>(lines: &TextLines<R>, value: &str) -> Result<u64, KeyFault> {
    let count = value
        .split_whitespace()
        .next()
        .and_then(|word| word.parse().ok());
    count.ok_or_else(|| lines.fault(format!("has no count ({})", lines.excerpt()), EXPORT_REMEDY))
}

/// Visits the lines of a section.
fn for_each_line<R: BufRead>(
    lines: &mut TextLines<R>,
    key: &str,
    count: u64,
    mut visit: impl FnMut(&TextLines<R>) -> Result<(), KeyFault>,
) -> Result<(), KeyFault> {
    for k in 0..count {
        if !lines.advance('%')? {
            return Err(lines.end_fault(&format!("{key} announces {count} lines and {k} follow")));
        }
        if lines.text.contains('=') {
            let problem =
                format!("is another key, but {key} announces {count} lines and {k} follow");
            return Err(lines.fault(problem, EXPORT_REMEDY));
        }
        visit(lines)?;
    }
    Ok(())
}
