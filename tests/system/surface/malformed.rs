//! Malformed surfaces, and random changes of valid ones.

use std::path::Path;

use rand::Rng;
use wingd::desk::surface::Surface;

use super::{failure_text, read_content, sample, unit, wing};
use crate::common::random::rng;

/// Contents with the errors that name them.
const STL: &[(&str, &str)] = &[
    (
        "PK\x03\x04",
        "file: is not STL: it has 4 bytes and does not begin with solid",
    ),
    (
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 x 0\n",
        "line 4: is not a vertex (\"vertex 0 x 0\")",
    ),
    (
        "solid a\nmesh\n",
        "line 2: is not what STL has here (\"mesh\")",
    ),
];

const NODES: &[(&str, &str)] = &[
    ("", "file: is empty; write the header id,x_m,y_m,z_m"),
    (
        "1,2,3,4\n",
        "line 1: is not a header with three coordinates of one unit; write the header",
    ),
    ("id;x_m;y_m;z_m\n", "line 1: is not separated by commas"),
    (
        "id,x_m,y_mm,z_m\n",
        "line 1: is not a header with three coordinates of one unit",
    ),
    (
        "id,x_m,y_m,z_m\n1,2,3\n",
        "line 2: has no three finite coordinates (\"1,2,3\"); give decimal",
    ),
    (
        "# a\nid,x_m,y_m,z_m\n\n1,2,3,nan\n",
        "line 4: has no three finite coordinates",
    ),
    (
        "id,x_m,y_m,z_m\nLE1,2,3,4\n",
        "line 2: has an id that is not a whole number (\"LE1,2,3,4\")",
    ),
    (
        "id,x_m,y_m,z_m\n7,2,3,4\n8,1,1,1\n7,2,3,4\n",
        "line 4: repeats node 7 of line 2",
    ),
    (
        "x_m,y_m,z_m\n",
        "line 2: is the end of the file, but it has no node",
    ),
];

const MESHES: &[(&str, &str)] = &[
    (
        "NDIME= 2\n",
        "line 1: is a mesh of 2 dimensions; give a mesh of three dimensions",
    ),
    (
        "NZONE= 2\n",
        "line 1: is a mesh of several zones; give each zone as a file",
    ),
    (
        "NPOIN= 2\n0 0 0\n",
        "line 3: is the end of the file, but NPOIN announces 2 lines and 1 follow",
    ),
    (
        "NPOIN= 2\n0 0 0\nNMARK= 1\n",
        "line 3: is another key, but NPOIN announces 2 lines and 1 follow",
    ),
    (
        "NPOIN= 1\n0 0 0\n1 1 1\n",
        "line 3: belongs to no section (\"1 1 1\"); correct the count",
    ),
    ("NPOIN= 1\n0 0\n", "line 2: is not a point (\"0 0\")"),
    ("NPOIN= many\n", "line 1: has no count (\"NPOIN= many\")"),
    (
        "NPOIN= 1\n0 0 0\nMARKER_TAG= b\n",
        "file: has no marker a; name some of b: mesh.su2:MARKER",
    ),
    (
        "NPOIN= 1\n0 0 0\nMARKER_TAG= a\nMARKER_ELEMS= 1\n5 0 0 1\n",
        "line 5: names node 1, but the mesh has 1 points",
    ),
    (
        "NPOIN= 1\n0 0 0\nMARKER_TAG= a\nMARKER_ELEMS= 1\n3 0 0\n",
        "line 5: is not a triangle (5) or quadrilateral (9)",
    ),
    (
        "NPOIN= 1\n0 0 0\nMARKER_TAG= a\nMARKER_ELEMS= 0\n",
        "file: has no element of a",
    ),
    (
        "MARKER_TAG= a\n",
        "line 2: is the end of the file, but it has no points (NPOIN)",
    ),
];

const MESHES_WITHOUT_MARKER: &[(&str, &str)] = &[(
    "NPOIN= 1\n0 0 0\nMARKER_TAG= b\n",
    "file: needs the markers of the wing; name some of b",
)];

fn assert_refused(name: &str, content: &[u8], marker: &str, expected: &str) {
    let text = read_content(name, content, marker).expect_err(expected);
    assert!(text.contains(expected), "{expected}\n{text}");
    assert!(text.contains("; "), "a remedy: {text}");
}

#[test]
fn every_malformed_surface_names_place_cause_and_remedy() {
    for (name, marker, cases) in [
        ("a.stl", "", STL),
        ("n.csv", "", NODES),
        ("m.su2", ":a", MESHES),
        ("m.su2", "", MESHES_WITHOUT_MARKER),
    ] {
        cases.iter().for_each(|(content, expected)| {
            assert_refused(name, content.as_bytes(), marker, expected)
        });
    }
    let stl = std::fs::read(sample("vtk-binary.stl")).unwrap();
    let mut infinite = stl.clone();
    infinite[84 + 50 + 12..84 + 50 + 16].copy_from_slice(&f32::INFINITY.to_le_bytes());
    let facet =
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n";
    let of_stl: [(&[u8], &str); 5] = [
        (
            &stl[..900],
            "file: has 900 bytes, but a binary STL of 24 facets, as its header says, has 1284",
        ),
        (&[0; 84], "file: has no facet"),
        (
            &infinite,
            "facet 2: has a coordinate that is not a finite number",
        ),
        (
            &[facet.as_bytes(), b"vertex 0 0 9\n"].concat(),
            "line 7: has a facet that is no triangle; triangulate it",
        ),
        (
            facet.as_bytes(),
            "line 7: is the end of the file, but the last solid has no end; the file is truncated",
        ),
    ];
    of_stl
        .iter()
        .for_each(|(content, expected)| assert_refused("a.stl", content, "", expected));
    assert_refused("n.csv", &[b'1'; 100_000], "", "line 1: is not text");
    assert_refused(
        "w.obj",
        b"v 0 0 0\n",
        "",
        "has no known ending; give wing.stl, nodes.csv or mesh.su2:MARKER",
    );
    let text = failure_text(Surface::read(Path::new("/nowhere/a.stl"), None).unwrap_err());
    assert!(
        text.starts_with("/nowhere/a.stl: file: cannot be read (No such file"),
        "{text}"
    );
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("n.csv"), "x_mm,y_mm,z_mm\n1,2,3\n").unwrap();
    let found = failure_text(Surface::read(&folder.path().join("n.csv"), unit("in")).unwrap_err());
    assert!(
        found.contains("gives coordinates in mm, but --unit says in"),
        "{found}"
    );
}

#[test]
fn random_changes_of_surfaces_end_in_a_surface_or_one_error() {
    let mut rng = rng(51);
    let nodes = "id,x_m,y_m,z_m\n".to_owned()
        + &(1..30)
            .map(|k| format!("{k},1.5,{k},-0.25\n"))
            .collect::<String>();
    let files = [
        (
            "a.stl",
            std::fs::read(sample("vtk-binary.stl")).unwrap(),
            "",
        ),
        ("a.stl", std::fs::read(sample("vtk-text.stl")).unwrap(), ""),
        (
            "a.su2",
            std::fs::read(sample("meshio.su2")).unwrap(),
            ":1,2",
        ),
        ("a.csv", nodes.into_bytes(), ""),
    ];
    let (mut read, mut refused) = (0, 0);
    for (name, original, marker) in &files {
        for _ in 0..400 {
            let mut bytes = original.clone();
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..bytes.len());
                match rng.random_range(0..6) {
                    0 => bytes[at] = rng.random(),
                    1 => bytes[at] = b"0123456789.,-=eE \n"[rng.random_range(0..18)],
                    2 => bytes.truncate(at.max(1)),
                    3 => drop(bytes.remove(at)),
                    4 => bytes.insert(at, b"9-\n="[rng.random_range(0..4)]),
                    _ => {
                        let end = (at + rng.random_range(1..60)).min(bytes.len());
                        bytes.extend_from_within(at..end);
                    }
                }
            }
            match read_content(name, &bytes, marker) {
                Ok(surface) => {
                    read += 1;
                    let motions = surface.move_nodes(&wing(), &[]);
                    assert_eq!(motions.len(), surface.points.len());
                    assert!(
                        surface
                            .facets
                            .corners
                            .iter()
                            .all(|k| *k < surface.points.len())
                    );
                    surface.to_files(&motions);
                }
                Err(text) => {
                    refused += 1;
                    assert!(text.contains("; ") && text.len() < 400, "{text}");
                }
            }
        }
    }
    println!("{read} read, {refused} refused");
    assert!(read > 100 && refused > 300, "{read} {refused}");
}
