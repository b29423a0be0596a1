//! Surface of a CAD, CFD or FEM model: read, moved by the measured deformation of the wing, written in the formats of its
//! program. Every node is kept once, and nodes, facets and their order are those of the file.

mod check;
mod lines;
mod nodes;
mod stl;
mod su2;
mod write;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use rayon::prelude::*;

use self::lines::open_lines;
use super::{Failure, TaskResult};
use crate::installation::{Fault, KeyFault, LENGTH_UNITS, LengthUnit};
use crate::measure::deformation::{WingDeformation, sample_sigma_m};

pub use check::{NodeCounts, OtherAxes, check_nodes};
pub use write::OutputFile;

/// Remedy for a file that its program wrote wrongly or that was cut.
const EXPORT_REMEDY: &str = "export or copy the file again";

/// Facets by the indices of their corners, in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FacetList {
    /// Corners of all facets, one facet after the other.
    pub corners: Vec<usize>,
    /// End of each facet in `corners`.
    pub ends: Vec<usize>,
}

impl FacetList {
    fn add(&mut self, corners: impl IntoIterator<Item = usize>) {
        self.corners.extend(corners);
        self.ends.push(self.corners.len());
    }

    /// Iterates over the corners of each facet.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[usize]> {
        self.ends.iter().enumerate().map(|(k, end)| {
            let begin = if k == 0 { 0 } else { self.ends[k - 1] };
            &self.corners[begin..*end]
        })
    }
}

/// Format of a surface's file, with the parts of it that the facets do not have.
#[derive(Clone, Debug, PartialEq)]
pub enum SurfaceFormat {
    /// Binary STL.
    BinaryStl,
    /// STL text: name of each solid and the number of facets before it.
    TextStl(Vec<(String, usize)>),
    /// CSV of nodes.
    Nodes,
    /// Markers of an SU2 mesh.
    Su2,
}

/// Surface as in its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Nodes, in the unit and the axes of the file.
    pub points: Vec<Vector3<f64>>,
    /// Number of each node: of the file (CSV, SU2), else its position from 1.
    pub ids: Vec<u64>,
    /// Facets; none in a list of nodes.
    pub facets: FacetList,
    /// Unit of the coordinates.
    pub unit: LengthUnit,
    /// Format of the file.
    pub format: SurfaceFormat,
}

/// Motion of a node between ground and flight, in the axes of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeMotion {
    /// Displacement, m.
    pub displacement_m: Vector3<f64>,
    /// Standard deviations of the displacement, m; `None` without samples, or inboard of the root.
    pub sigma_m: Option<Vector3<f64>>,
}

impl Surface {
    /// Reads a surface: `wing.stl`, `nodes.csv`, or `mesh.su2:MARKER,MARKER`. `unit` is that of STL and SU2 files; a list of
    /// nodes states its own.
    ///
    /// # Errors
    /// Returns the first error of the file, with line and remedy, or an error of usage if the name has no known ending.
    pub fn read(name: &Path, unit: Option<LengthUnit>) -> TaskResult<Self> {
        let text = name.to_string_lossy();
        let (file, markers) = match text.rsplit_once(':') {
            Some((file, markers)) if file.to_lowercase().ends_with(".su2") => {
                (PathBuf::from(file), markers)
            }
            _ => (name.to_owned(), ""),
        };
        let ending = file
            .extension()
            .unwrap_or_default()
            .to_string_lossy()
            .to_lowercase();
        let metre = LENGTH_UNITS[0];
        let surface = match ending.as_str() {
            "stl" => stl::read_stl(&file, unit.unwrap_or(metre)),
            "csv" => open_lines(&file).and_then(|lines| nodes::read_nodes(lines, unit)),
            "su2" => open_lines(&file).and_then(|lines| {
                let tags: Vec<&str> = markers
                    .split(',')
                    .map(str::trim)
                    .filter(|tag| !tag.is_empty())
                    .collect();
                su2::read_su2(lines, &tags, unit.unwrap_or(metre))
            }),
            _ => {
                let problem = format!("--surface: {text} has no known ending");
                return Err(Failure::Usage(format!(
                    "{problem}; give wing.stl, nodes.csv or mesh.su2:MARKER"
                )));
            }
        };
        surface.map_err(|fault| Failure::from(fault.into_fault(&file)))
    }

    /// Moves all nodes; standard deviations follow from the samples.
    pub fn move_nodes(
        &self,
        wing: &WingDeformation,
        samples: &[WingDeformation],
    ) -> Vec<NodeMotion> {
        let points = self.points.par_iter().map(|point| point * self.unit.metres);
        let motion = |p: Vector3<f64>| NodeMotion {
            displacement_m: wing.move_point(&p) - p,
            sigma_m: sample_sigma_m(samples, &p),
        };
        points.map(motion).collect()
    }

    /// Position of each node in flight, in the unit and the axes of the file.
    fn moved_points(&self, motions: &[NodeMotion]) -> Vec<Vector3<f64>> {
        let moved = |(point, motion): (&Vector3<f64>, &NodeMotion)| {
            point + motion.displacement_m / self.unit.metres
        };
        self.points.iter().zip(motions).map(moved).collect()
    }

    /// Counts the facets that are turned over by the motion: a surface that folds cannot be used.
    pub fn count_folded_facets(&self, motions: &[NodeMotion]) -> usize {
        let moved = self.moved_points(motions);
        let normal =
            |points: &[Vector3<f64>], c: &[usize]| facet_normal(c.iter().map(|k| points[*k]));
        self.facets
            .iter()
            .filter(|c| normal(&self.points, c).dot(&normal(&moved, c)) < 0.0)
            .count()
    }
}

/// Normal of a facet, of any length: the sum of the cross products of its fan of triangles.
fn facet_normal(mut corners: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let (Some(first), Some(mut last)) = (corners.next(), corners.next()) else {
        return Vector3::zeros();
    };
    corners.fold(Vector3::zeros(), |sum, next| {
        let area = (last - first).cross(&(next - first));
        last = next;
        sum + area
    })
}

/// Nodes that are found again by their coordinates: files of facets list each node once per facet.
#[derive(Default)]
struct NodeIndex {
    points: Vec<Vector3<f64>>,
    known: HashMap<[u64; 3], usize>,
}

impl NodeIndex {
    /// Returns the index of a node, which may be new.
    fn find_or_add(&mut self, point: Vector3<f64>) -> usize {
        // 0 and -0 are one place.
        let key = [point.x, point.y, point.z].map(|v| (v + 0.0).to_bits());
        *self.known.entry(key).or_insert_with(|| {
            self.points.push(point);
            self.points.len() - 1
        })
    }
}

/// Reads finite coordinates; `None` if there are fewer or others.
fn parse_point<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Vector3<f64>> {
    let mut next = || {
        words
            .next()?
            .trim()
            .parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
    };
    Some(Vector3::new(next()?, next()?, next()?))
}

/// Creates the error of a file that cannot be read.
fn unreadable(error: &std::io::Error) -> KeyFault {
    KeyFault::new(
        "",
        format!("cannot be read ({error})"),
        "name a file that exists and can be read",
    )
}

/// Error of the surface as a whole, for the checks of its nodes.
fn surface_fault(file: &Path, problem: String, remedy: impl Into<String>) -> Failure {
    Fault::new(file, "nodes", problem, remedy).into()
}
