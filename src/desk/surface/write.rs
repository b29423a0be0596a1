//! Output of a moved surface: CSV and VTK of every surface, and the format of the program it came from.

use std::fmt::Write;

use nalgebra::Vector3;

use super::{NodeMotion, Surface, SurfaceFormat};
use crate::report::export::VtkShape;

/// Largest number of a Nastran grid point.
const MAX_GRID_ID: u64 = 99_999_999;

/// File to write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputFile {
    /// Name without a folder.
    pub name: &'static str,
    /// Content.
    pub bytes: Vec<u8>,
}

impl Surface {
    /// Returns the files of the surface in flight. STL of a surface that came as STL; `surface_positions.dat` of markers of
    /// SU2; bulk data of nodes with numbers that Nastran takes.
    pub fn to_files(&self, motions: &[NodeMotion]) -> Vec<OutputFile> {
        let moved = self.moved_points(motions);
        let mut files = vec![
            OutputFile {
                name: "surface.csv",
                bytes: self.to_csv(&moved, motions).into_bytes(),
            },
            OutputFile {
                name: "surface.vtp",
                bytes: self.to_vtp(&moved, motions).into_bytes(),
            },
        ];
        match self.format {
            SurfaceFormat::BinaryStl | SurfaceFormat::TextStl(_) => {
                files.push(OutputFile {
                    name: "surface.stl",
                    bytes: self.to_stl(&moved),
                });
            }
            SurfaceFormat::Su2 => {
                files.push(OutputFile {
                    name: "surface_positions.dat",
                    bytes: self.to_positions(&moved).into_bytes(),
                });
            }
            SurfaceFormat::Nodes if self.ids.iter().all(|id| (1..=MAX_GRID_ID).contains(id)) => {
                files.push(OutputFile {
                    name: "surface.bdf",
                    bytes: self.to_grid_points(&moved).into_bytes(),
                });
            }
            SurfaceFormat::Nodes => {}
        }
        files
    }

    /// Rows of number, position, displacement and its standard deviations in the unit of the file; a node that does not move
    /// has none.
    fn to_csv(&self, moved: &[Vector3<f64>], motions: &[NodeMotion]) -> String {
        let unit = self.unit.name;
        let mut text = String::from("id");
        for name in [
            "x", "y", "z", "dx", "dy", "dz", "sigma_dx", "sigma_dy", "sigma_dz",
        ] {
            let _ = write!(text, ",{name}_{unit}");
        }
        for ((id, point), motion) in self.ids.iter().zip(moved).zip(motions) {
            let d = motion.displacement_m / self.unit.metres;
            let _ = write!(
                text,
                "\n{id},{},{},{},{},{},{}",
                point.x, point.y, point.z, d.x, d.y, d.z
            );
            match motion.sigma_m.map(|sigma| sigma / self.unit.metres) {
                Some(s) => {
                    let _ = write!(text, ",{},{},{}", s.x, s.y, s.z);
                }
                None => text.push_str(",,,"),
            }
        }
        text + "\n"
    }

    fn to_vtp(&self, moved: &[Vector3<f64>], motions: &[NodeMotion]) -> String {
        let mut shape = VtkShape::from_surface(
            moved.iter().map(|p| (*p).into()),
            &self.facets.corners,
            &self.facets.ends,
        );
        shape.add_vector(
            "displacement_m",
            motions.iter().map(|m| m.displacement_m.into()).collect(),
        );
        let sigma = |m: &NodeMotion| m.sigma_m.map_or([f64::NAN; 3], Into::into);
        shape.add_vector("sigma_displacement_m", motions.iter().map(sigma).collect());
        shape.add_scalar("node", self.ids.iter().map(|id| *id as f64).collect());
        shape.to_vtp(None)
    }

    /// Positions as SU2 reads them with `DV_KIND= SURFACE_FILE`: index in the mesh and coordinates, each node once.
    fn to_positions(&self, moved: &[Vector3<f64>]) -> String {
        let mut text = String::new();
        for (id, p) in self.ids.iter().zip(moved) {
            let _ = writeln!(text, "{id} {:e} {:e} {:e}", p.x, p.y, p.z);
        }
        text
    }

    /// Bulk data of Nastran, `GRID` in large fields (16 characters): an include file that replaces those of the model.
    fn to_grid_points(&self, moved: &[Vector3<f64>]) -> String {
        let mut text = format!("$ Wing in flight, unit of the input: {}\n", self.unit.name);
        for (id, p) in self.ids.iter().zip(moved) {
            let [x, y, z] = [p.x, p.y, p.z].map(large_field);
            let _ = writeln!(
                text,
                "{:<8}{id:>16}{:16}{x:>16}{y:>16}*\n{:<8}{z:>16}",
                "GRID*", "", "*"
            );
        }
        text
    }
}

/// Number in at most 16 characters; with nine digits after the point, to 1e-9 of itself.
fn large_field(value: f64) -> String {
    // A third digit of the exponent has no room.
    let value = if value.abs() < 1e-99 { 0.0 } else { value };
    format!("{value:.9E}")
}
