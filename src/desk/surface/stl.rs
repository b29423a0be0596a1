//! STL, binary and text. `stl_io` 0.11 is not used: it drops all solids but the first of a text file without an error,
//! refuses binary files whose header begins with "solid" and text without a name, and its errors name no line.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::path::Path;

use nalgebra::Vector3;

use super::lines::TextLines;
use super::{
    EXPORT_REMEDY, FacetList, NodeIndex, Surface, SurfaceFormat, facet_normal, parse_point,
    unreadable,
};
use crate::installation::{KeyFault, LengthUnit};

/// Length of the header and the count of a binary file, and of each facet, bytes.
const HEADER_BYTES: usize = 84;
/// Bytes of a facet in binary STL: twelve numbers of 4 bytes and 2 bytes of attributes.
const FACET_BYTES: usize = 50;

/// Reads an STL file: binary if its length follows from its number of facets, else text.
pub(super) fn read_stl(file: &Path, unit: LengthUnit) -> Result<Surface, KeyFault> {
    let opened = File::open(file).map_err(|error| unreadable(&error))?;
    let length = opened.metadata().map_err(|error| unreadable(&error))?.len();
    parse_stl(BufReader::new(opened), length, unit)
}

/// Parses STL of a known length, bytes.
fn parse_stl(
    mut reader: impl BufRead + Seek,
    length: u64,
    unit: LengthUnit,
) -> Result<Surface, KeyFault> {
    let mut header = vec![];
    reader
        .by_ref()
        .take(HEADER_BYTES as u64)
        .read_to_end(&mut header)
        .map_err(|error| unreadable(&error))?;
    let count = header
        .get(80..)
        .and_then(|bytes| bytes.try_into().ok())
        .map(u32::from_le_bytes);
    let expected = count.map(|count| HEADER_BYTES as u64 + u64::from(count) * FACET_BYTES as u64);
    let (nodes, facets, format) = if expected == Some(length) {
        let (nodes, facets) = parse_binary(reader)?;
        (nodes, facets, SurfaceFormat::BinaryStl)
    } else if header
        .trim_ascii_start()
        .get(..5)
        .is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
    {
        reader.rewind().map_err(|error| unreadable(&error))?;
        parse_text(TextLines::new(reader))?
    } else {
        let problem = match count.zip(expected) {
            Some((count, bytes)) => {
                format!(
                    "has {length} bytes, but a binary STL of {count} facets, as its header says, has {bytes}"
                )
            }
            None => format!("is not STL: it has {length} bytes and does not begin with solid"),
        };
        return Err(KeyFault::new("", problem, EXPORT_REMEDY));
    };
    if facets.ends.is_empty() {
        return Err(KeyFault::new("", "has no facet", EXPORT_REMEDY));
    }
    let ids = (1..=nodes.len() as u64).collect();
    Ok(Surface {
        points: nodes,
        ids,
        facets,
        unit,
        format,
    })
}

fn parse_binary(mut reader: impl Read) -> Result<(Vec<Vector3<f64>>, FacetList), KeyFault> {
    let (mut nodes, mut facets, mut bytes) =
        (NodeIndex::default(), FacetList::default(), [0; FACET_BYTES]);
    while reader.read_exact(&mut bytes).is_ok() {
        // After the normal, which follows from the corners.
        let mut numbers = bytes[12..48].chunks_exact(4).map(|part| {
            let bits = part
                .iter()
                .rev()
                .fold(0, |bits, byte| bits << 8 | u32::from(*byte));
            f64::from(f32::from_bits(bits))
        });
        let mut corner = || Vector3::from_fn(|_, _| numbers.next().unwrap_or_default());
        let corners = [corner(), corner(), corner()];
        if corners.iter().flatten().any(|v| !v.is_finite()) {
            let place = format!("facet {}", facets.ends.len() + 1);
            return Err(KeyFault::new(
                place,
                "has a coordinate that is not a finite number",
                EXPORT_REMEDY,
            ));
        }
        facets.add(corners.map(|corner| nodes.find_or_add(corner)));
    }
    Ok((nodes.points, facets))
}

type TextParts = (Vec<Vector3<f64>>, FacetList, SurfaceFormat);

fn parse_text<R: BufRead>(mut lines: TextLines<R>) -> Result<TextParts, KeyFault> {
    let (mut nodes, mut facets, mut solids) = (NodeIndex::default(), FacetList::default(), vec![]);
    let (mut corners, mut is_open) = (vec![], false);
    while lines.advance('\0')? {
        let mut words = lines.text.split_whitespace();
        let word = words.next().unwrap_or_default().to_lowercase();
        match word.as_str() {
            "solid" if !is_open => {
                is_open = true;
                solids.push((
                    lines.text[word.len()..].trim().to_owned(),
                    facets.ends.len(),
                ));
            }
            "facet" | "outer" | "endfacet" if is_open && corners.is_empty() => {}
            "vertex" if is_open && corners.len() < 3 => {
                let fault = || {
                    lines.fault(
                        format!("is not a vertex ({})", lines.excerpt()),
                        EXPORT_REMEDY,
                    )
                };
                corners.push(parse_point(words).ok_or_else(fault)?);
            }
            "endloop" if corners.len() == 3 => {
                facets.add(corners.drain(..).map(|corner| nodes.find_or_add(corner)))
            }
            "vertex" | "endloop" => {
                return Err(lines.fault("has a facet that is no triangle", "triangulate it"));
            }
            "endsolid" if is_open && corners.is_empty() => is_open = false,
            _ => {
                let problem = format!("is not what STL has here ({})", lines.excerpt());
                return Err(lines.fault(problem, EXPORT_REMEDY));
            }
        }
    }
    if is_open {
        return Err(lines.end_fault("the last solid has no end"));
    }
    Ok((nodes.points, facets, SurfaceFormat::TextStl(solids)))
}

impl Surface {
    /// Returns the facets at other positions of the nodes as STL: text with its solids if the file is text, else binary.
    /// Quadrilaterals become two triangles.
    pub(super) fn to_stl(&self, points: &[Vector3<f64>]) -> Vec<u8> {
        let triangles = || {
            let fan = |c: &[usize]| {
                (2..c.len())
                    .map(|k| [c[0], c[k - 1], c[k]].map(|k| points[k]))
                    .collect::<Vec<_>>()
            };
            self.facets.iter().map(fan)
        };
        let normal = |triangle: &[Vector3<f64>; 3]| {
            facet_normal(triangle.iter().copied())
                .try_normalize(0.0)
                .unwrap_or_default()
        };
        let SurfaceFormat::TextStl(solids) = &self.format else {
            let triangles: Vec<_> = triangles().flatten().collect();
            let mut bytes = vec![0; 80];
            bytes.extend((triangles.len() as u32).to_le_bytes());
            for triangle in &triangles {
                let numbers = [normal(triangle)].into_iter().chain(*triangle);
                bytes.extend(
                    numbers
                        .flat_map(|v| [v.x, v.y, v.z])
                        .flat_map(|v| (v as f32).to_le_bytes()),
                );
                bytes.extend([0, 0]);
            }
            return bytes;
        };
        let (mut text, mut all) = (String::new(), triangles());
        for (k, (name, begin)) in solids.iter().enumerate() {
            let end = solids
                .get(k + 1)
                .map_or(self.facets.ends.len(), |(_, next)| *next);
            let _ = writeln!(text, "solid {name}");
            for triangle in all.by_ref().take(end - begin).flatten() {
                let n = normal(&triangle);
                let _ = writeln!(
                    text,
                    "facet normal {:e} {:e} {:e}\nouter loop",
                    n.x, n.y, n.z
                );
                for p in triangle {
                    let _ = writeln!(text, "vertex {:e} {:e} {:e}", p.x, p.y, p.z);
                }
                text.push_str("endloop\nendfacet\n");
            }
            let _ = writeln!(text, "endsolid {name}");
        }
        text.into_bytes()
    }
}
