//! Promise: surfaces of other programs are read, moved and written with the same nodes and facets; every malformed one is one
//! error with file, place and remedy; nodes that are not on the wing are named with the cause.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{Rotation3, Vector3};
use wingd::desk::Failure;
use wingd::desk::surface::{
    NodeCounts, NodeMotion, OtherAxes, Surface, SurfaceFormat, check_nodes,
};
use wingd::installation::{LENGTH_UNITS, LengthUnit};
use wingd::measure::deformation::{SectionPose, WingDeformation};
use wingd::measure::geometry::Similarity;

mod malformed;

fn sample(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/surfaces")
        .join(name)
}

fn unit(name: &str) -> Option<LengthUnit> {
    LENGTH_UNITS.into_iter().find(|unit| unit.name == name)
}

/// A wing along y, whose root is at y = 3 m: bent up to 3 m, twisted, shrunk.
fn pose(arc_m: f64) -> SectionPose {
    let ground_m = Vector3::new(1.0, 3.0 + arc_m, 0.0);
    let slope = 0.0066 * arc_m;
    let displacement_m = Vector3::new(
        0.0,
        -0.0016 * arc_m - slope * slope * arc_m / 6.0,
        0.5 * slope * arc_m,
    );
    let rotation =
        Rotation3::new(Vector3::x() * slope) * Rotation3::new(Vector3::y() * 0.0006 * arc_m);
    SectionPose {
        arc_m,
        ground_m,
        displacement_m,
        rotation,
    }
}

fn wing() -> WingDeformation {
    WingDeformation::new(
        &(0..61)
            .map(|k| pose(0.5 * f64::from(k)))
            .collect::<Vec<_>>(),
    )
    .unwrap()
}

fn read(name: &str) -> Surface {
    Surface::read(&sample(name), None).unwrap()
}

fn failure_text(failure: Failure) -> String {
    match failure {
        Failure::Faults(faults) if faults.len() == 1 => faults[0].to_string(),
        Failure::Usage(text) => format!("usage: {text}"),
        other => panic!("{other:?}"),
    }
}

/// Reads a text or bytes as a file with a name.
fn read_content(name: &str, content: impl AsRef<[u8]>, marker: &str) -> Result<Surface, String> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(name), content).unwrap();
    let file = folder.path().join(format!("{name}{marker}"));
    Surface::read(&file, None).map_err(|failure| {
        let text = failure_text(failure);
        assert!(text.contains(name), "{text}");
        text.replace(&format!("{}/", folder.path().display()), "")
    })
}

fn written(surface: &Surface, motions: &[NodeMotion]) -> BTreeMap<&'static str, Vec<u8>> {
    surface
        .to_files(motions)
        .into_iter()
        .map(|file| (file.name, file.bytes))
        .collect()
}

const STILL: NodeMotion = NodeMotion {
    displacement_m: Vector3::new(0.0, 0.0, 0.0),
    sigma_m: None,
};

#[test]
fn surfaces_of_other_programs_have_the_same_nodes_and_facets() {
    let first = read("vtk-binary.stl");
    let stl = [
        "meshio-text.stl",
        "numpy-stl-text.stl",
        "numpy-stl-binary.stl",
        "vtk-text.stl",
        "vtk-binary.stl",
    ];
    for name in stl {
        let surface = read(name);
        assert_eq!(
            (surface.points.len(), surface.facets.iter().len()),
            (24, 24),
            "{name}"
        );
        let off = surface
            .points
            .iter()
            .zip(&first.points)
            .map(|(a, b)| (a - b).norm())
            .fold(0.0, f64::max);
        assert!(off < 1e-6 && surface.facets == first.facets, "{name} {off}");
        assert_eq!(
            surface.format == SurfaceFormat::BinaryStl,
            name.contains("binary"),
            "{name}"
        );
        // At rest the file has the same content.
        let files = written(&surface, &[STILL; 24]);
        let again = read_content("again.stl", &files["surface.stl"], "").unwrap();
        assert_eq!(again, surface, "{name}");
    }
    let both = Surface::read(&sample("meshio.su2:1,2"), None).unwrap();
    assert_eq!((both.points.len(), both.facets.iter().len()), (24, 12));
    let one = Surface::read(&sample("meshio.su2:2"), None).unwrap();
    assert_eq!(
        one.ids,
        (12..24).collect::<Vec<u64>>(),
        "numbers of the mesh, from 0"
    );
    assert_eq!(
        one.facets.iter().next().unwrap(),
        [4, 5, 1, 0],
        "of the nodes that are left"
    );
}

#[test]
fn a_surface_is_moved_as_its_deformation_says_in_its_own_unit_and_axes() {
    let (surface, wing) = (read("vtk-binary.stl"), wing());
    let motions = surface.move_nodes(&wing, &[]);
    for (point, motion) in surface.points.iter().zip(&motions) {
        assert_eq!(motion.displacement_m, wing.move_point(point) - point);
        assert!(point.y > 3.0 || *motion == STILL);
    }
    let tip = motions
        .iter()
        .map(|m| m.displacement_m.z)
        .fold(0.0, f64::max);
    assert!((2.3..2.6).contains(&tip), "{tip}");
    assert_eq!(surface.count_folded_facets(&motions), 0);
    let folded = motions.iter().enumerate().map(|(k, m)| {
        let away = Vector3::y() * if k == 0 { 90.0 } else { 0.0 };
        NodeMotion {
            displacement_m: m.displacement_m + away,
            ..*m
        }
    });
    assert!(surface.count_folded_facets(&folded.collect::<Vec<_>>()) > 0);

    // In millimetres and the axes of a CAD model the same surface moves alike.
    let cad = Similarity {
        scale: 1.0,
        rotation: Rotation3::from_euler_angles(0.3, -2.0, 1.1),
        translation_m: Vector3::new(17.0, -4.0, 2.0),
    };
    let poses: Vec<SectionPose> = (0..61)
        .map(|k| pose(0.5 * f64::from(k)).transformed(&cad))
        .collect();
    let in_cad = WingDeformation::new(&poses).unwrap();
    let points = surface
        .points
        .iter()
        .map(|p| cad.apply(p) * 1000.0)
        .collect();
    let other = Surface {
        points,
        unit: unit("mm").unwrap(),
        ..surface.clone()
    };
    for (a, b) in motions.iter().zip(other.move_nodes(&in_cad, &[])) {
        assert!((cad.rotation * a.displacement_m - b.displacement_m).norm() < 1e-9);
    }
    let samples: Vec<WingDeformation> = (0..50)
        .map(|k| {
            let raise = |pose: SectionPose| SectionPose {
                displacement_m: pose.displacement_m
                    + Vector3::z() * (0.001 * f64::from(k) * pose.arc_m / 30.0),
                ..pose
            };
            WingDeformation::new(
                &(0..61)
                    .map(|k| raise(pose(0.5 * f64::from(k))))
                    .collect::<Vec<_>>(),
            )
            .unwrap()
        })
        .collect();
    let with_sigma = surface.move_nodes(&wing, &samples);
    let files = written(&surface, &with_sigma);
    let rows: Vec<String> = String::from_utf8(files["surface.csv"].clone())
        .unwrap()
        .lines()
        .map(Into::into)
        .collect();
    assert_eq!(
        rows[0],
        "id,x_m,y_m,z_m,dx_m,dy_m,dz_m,sigma_dx_m,sigma_dy_m,sigma_dz_m"
    );
    let cells = |k: usize| {
        rows[k]
            .split(',')
            .map(|cell| cell.parse::<f64>().unwrap_or(f64::NAN))
            .collect::<Vec<_>>()
    };
    let fast = with_sigma
        .iter()
        .position(|m| m.sigma_m.is_some_and(|s| s.z > 0.01))
        .unwrap();
    assert_eq!(
        (cells(fast + 1)[0], cells(fast + 1)[6]),
        (fast as f64 + 1.0, with_sigma[fast].displacement_m.z)
    );
    assert_eq!(cells(fast + 1)[9], with_sigma[fast].sigma_m.unwrap().z);
    assert!(
        rows[1].ends_with(",0,0,0,,,"),
        "inboard of the root nothing moves, without sigma: {}",
        rows[1]
    );
}

#[test]
fn outputs_belong_to_the_program_that_the_surface_came_from() {
    let names = |surface: &Surface| {
        written(surface, &surface.move_nodes(&wing(), &[]))
            .into_keys()
            .collect::<Vec<_>>()
    };
    assert_eq!(
        names(&read("meshio-text.stl")),
        ["surface.csv", "surface.stl", "surface.vtp"]
    );
    let mesh = Surface::read(&sample("meshio.su2:2"), None).unwrap();
    let files = written(&mesh, &[STILL; 12]);
    assert_eq!(
        files.keys().copied().collect::<Vec<_>>(),
        ["surface.csv", "surface.vtp", "surface_positions.dat"]
    );
    let positions = String::from_utf8(files["surface_positions.dat"].clone()).unwrap();
    let rows: Vec<Vec<f64>> = positions
        .lines()
        .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect())
        .collect();
    assert_eq!(
        (rows.len(), &rows[5][..]),
        (12, &[17.0, 1.0, 15.0, -0.35][..]),
        "index and place, each node once"
    );
    let nodes = read_content(
        "nodes.csv",
        "id,x_mm,y_mm,z_mm\n70,1000,20000,-12.5\n7,1,2,3\n",
        "",
    )
    .unwrap();
    assert_eq!(
        (nodes.unit.name, &nodes.ids[..], nodes.points[0].z),
        ("mm", &[70, 7][..], -12.5)
    );
    let files = written(&nodes, &[STILL; 2]);
    let cards = String::from_utf8(files["surface.bdf"].clone()).unwrap();
    let cards: Vec<&str> = cards.lines().skip(1).collect();
    assert_eq!(
        cards[0],
        format!(
            "GRID*   {:>16}{:16}{:>16}{:>16}*",
            70, "", "1.000000000E3", "2.000000000E4"
        )
    );
    assert_eq!(cards[1], format!("*       {:>16}", "-1.250000000E1"));
    // Number 0 is none for Nastran.
    let zero = read_content("nodes.csv", "z_ft,y_ft,id,x_ft,note\n1,2,0,3,a\n", "").unwrap();
    assert_eq!(
        (zero.points[0], names(&zero)),
        (
            Vector3::new(3.0, 2.0, 1.0),
            vec!["surface.csv", "surface.vtp"]
        )
    );
}

#[test]
fn several_solids_keep_their_names_and_facets() {
    let facet = |z: f64| {
        format!(
            "facet normal 0 0 1\nouter loop\nvertex 0 0 {z}\nvertex 1 0 {z}\nvertex 0 1 {z}\nendloop\nendfacet\n"
        )
    };
    let text = format!(
        "solid upper skin\n{}{}endsolid upper skin\nsolid lower\nendsolid\nSOLID tip\n{}endsolid tip\n",
        facet(0.0),
        facet(1.0),
        facet(2.0).to_uppercase()
    );
    let surface = read_content("wing.stl", text, "").unwrap();
    assert_eq!((surface.points.len(), surface.facets.iter().len()), (9, 3));
    let names = vec![
        ("upper skin".to_owned(), 0),
        ("lower".to_owned(), 2),
        ("tip".to_owned(), 2),
    ];
    assert_eq!(surface.format, SurfaceFormat::TextStl(names));
    let again = written(&surface, &[STILL; 9])
        .remove("surface.stl")
        .unwrap();
    assert_eq!(read_content("again.stl", again, "").unwrap(), surface);
}

#[test]
fn nodes_that_are_not_on_the_wing_are_named_with_the_cause() {
    let (surface, wing) = (read("vtk-binary.stl"), wing());
    let file = Path::new("wing.stl");
    let counts = check_nodes(file, &surface, &wing, 26.0, None).unwrap();
    assert_eq!(
        counts,
        NodeCounts {
            all: 24,
            inboard: 8,
            beyond_marker: 8,
            far: 0
        }
    );
    let warnings = counts.warnings();
    assert_eq!(warnings.len(), 1);
    assert!(
        warnings[0].starts_with("8 of 24 nodes are beyond the outermost marker"),
        "{warnings:?}"
    );
    // A tail far behind the wing.
    let mut with_tail = surface.clone();
    with_tail.points[20].x += 25.0;
    let counts = check_nodes(file, &with_tail, &wing, 30.0, None).unwrap();
    assert!(counts.far == 1 && counts.warnings()[0].contains("give the wing without other parts"));
    let scaled = |factor: f64| Surface {
        points: surface.points.iter().map(|p| p * factor).collect(),
        ..surface.clone()
    };
    let refuse = |surface: &Surface, other| {
        failure_text(check_nodes(file, surface, &wing, 26.0, other).unwrap_err())
    };
    for (factor, unit) in [
        (1000.0, "mm"),
        (1.0 / 0.0254, "in"),
        (1.0 / 0.3048, "ft"),
        (100.0, "cm"),
    ] {
        let text = refuse(&scaled(factor), None);
        assert!(
            text.contains(&format!(
                "its coordinates are in {unit}, not m: add --unit {unit}"
            )),
            "{text}"
        );
    }
    let cad = Similarity {
        scale: 1.0,
        rotation: Rotation3::from_euler_angles(0.0, 0.0, 3.0),
        translation_m: Vector3::new(20.0, 5.0, 0.0),
    };
    let poses: Vec<SectionPose> = (0..61)
        .map(|k| pose(0.5 * f64::from(k)).transformed(&cad))
        .collect();
    let in_cad = WingDeformation::new(&poses).unwrap();
    let other = || {
        Some(OtherAxes {
            wing: &in_cad,
            remedy: "add --cad",
        })
    };
    let moved = |factor: f64| {
        let points = surface
            .points
            .iter()
            .map(|p| cad.apply(p) * factor)
            .collect();
        Surface {
            points,
            ..surface.clone()
        }
    };
    assert!(
        refuse(&moved(1.0), other()).ends_with("; add --cad"),
        "{}",
        refuse(&moved(1.0), other())
    );
    assert!(refuse(&moved(1000.0), other()).ends_with("in mm, not m: add --unit mm; add --cad"));
    assert!(
        refuse(&moved(1.0), None)
            .contains("in the axes of the survey, or of the CAD model with --cad")
    );
}
