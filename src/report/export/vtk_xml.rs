//! Shapes as VTK XML files: `.vtp` per frame, `.pvd` over time, the ground shape, a mean `.vtu` per series.
//!
//! Arrays are base64 with a 64-bit length before them: a number that is not known is NaN, which the text form
//! cannot say.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::super::summary::{Mean, solved};
use super::super::{GroundMarker, SeriesData};
use super::vtk::points;
use crate::record::{ImageRecord, MarkerRecord};

/// Points with their data.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    points_m: Vec<[f64; 3]>,
    /// Name, components, values.
    arrays: Vec<(&'static str, usize, Vec<f64>)>,
    ids: Vec<String>,
}

impl Shape {
    /// No points.
    pub fn is_empty(&self) -> bool {
        self.points_m.is_empty()
    }

    fn vector(&mut self, name: &'static str, values: Vec<[f64; 3]>) {
        self.arrays.push((name, 3, values.into_iter().flatten().collect()));
    }

    fn scalar(&mut self, name: &'static str, values: Vec<f64>) {
        self.arrays.push((name, 1, values));
    }

    /// PolyData (`.vtp`); `time_s` goes into its field data.
    pub fn vtp(&self, time_s: Option<f64>) -> String {
        let n = self.points_m.len();
        let cells = format!("<Verts>{}{}</Verts>", index("connectivity", 0..n), index("offsets", 1..n + 1));
        let head = format!(
            "<Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"{n}\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">"
        );
        self.file("PolyData", &head, &cells, time_s)
    }

    /// Unstructured grid of single points (`.vtu`), for readers that know no PolyData.
    pub fn vtu(&self) -> String {
        let n = self.points_m.len();
        let types = array("UInt8", "types", 1, &vec![1; n]);
        let cells =
            format!("<Cells>{}{}{types}</Cells>", index("connectivity", 0..n), index("offsets", 1..n + 1));
        let head = format!("<Piece NumberOfPoints=\"{n}\" NumberOfCells=\"{n}\">");
        self.file("UnstructuredGrid", &head, &cells, None)
    }

    fn file(&self, kind: &str, piece: &str, cells: &str, time_s: Option<f64>) -> String {
        let mut out = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<{kind}>\n"
        );
        if let Some(time_s) = time_s {
            let time = array("Float64", "TimeValue", 1, &time_s.to_le_bytes());
            let time = time.replace("<DataArray", "<DataArray NumberOfTuples=\"1\"");
            let _ = writeln!(out, "<FieldData>{time}</FieldData>");
        }
        let _ = writeln!(out, "{piece}\n<PointData>");
        for (name, components, values) in &self.arrays {
            let _ = writeln!(out, "{}", array("Float64", name, *components, &bytes(values)));
        }
        // Strings are the codes of their letters with a zero after each.
        let letters: Vec<u8> = self.ids.iter().flat_map(|id| id.bytes().chain([0])).collect();
        let codes: Vec<String> = letters.iter().map(u8::to_string).collect();
        if kind == "PolyData" {
            let _ = writeln!(
                out,
                "<Array type=\"String\" Name=\"marker\" NumberOfTuples=\"{}\" format=\"ascii\">{}</Array>",
                self.ids.len(),
                codes.join(" ")
            );
        }
        let flat: Vec<f64> = self.points_m.iter().flatten().copied().collect();
        let points = array("Float64", "Points", 3, &bytes(&flat));
        let _ = writeln!(
            out,
            "</PointData>\n<Points>{points}</Points>\n{cells}\n</Piece>\n</{kind}>\n</VTKFile>"
        );
        out
    }
}

fn bytes(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn index(name: &str, range: std::ops::Range<usize>) -> String {
    let values: Vec<u8> = range.flat_map(|i| (i as i64).to_le_bytes()).collect();
    array("Int64", name, 1, &values)
}

fn array(kind: &str, name: &str, components: usize, bytes: &[u8]) -> String {
    let whole = [&(bytes.len() as u64).to_le_bytes()[..], bytes].concat();
    // Said for one component too, some readers make a table of a list.
    let shape = if components == 1 { String::new() } else { format!(" NumberOfComponents=\"{components}\"") };
    let text = STANDARD.encode(whole);
    format!("<DataArray type=\"{kind}\" Name=\"{name}\"{shape} format=\"binary\">{text}</DataArray>")
}

const UNKNOWN: [f64; 3] = [f64::NAN; 3];

/// From where a marker was on ground, where that is known.
fn displacement(ground: &[GroundMarker], id: &str, at_m: [f64; 3]) -> [f64; 3] {
    let from = ground.iter().find(|g| g.id == id).map(|g| g.position_m);
    from.map_or(UNKNOWN, |from| std::array::from_fn(|k| at_m[k] - from[k]))
}

/// One frame's markers in flight, with their whole displacement against the survey.
pub fn frame_shape(record: &ImageRecord, ground: &[GroundMarker]) -> Shape {
    let placed: Vec<(&MarkerRecord, [f64; 3])> =
        record.markers.iter().filter_map(|m| Some((m, m.position_m?))).collect();
    let one = |f: fn(&MarkerRecord) -> Option<f64>| {
        placed.iter().map(|(m, _)| f(m).unwrap_or(f64::NAN)).collect::<Vec<f64>>()
    };
    let mut shape = Shape {
        points_m: placed.iter().map(|(_, p)| *p).collect(),
        ids: placed.iter().map(|(m, _)| m.id.clone()).collect(),
        ..Shape::default()
    };
    shape.vector("displacement_m", placed.iter().map(|(m, p)| displacement(ground, &m.id, *p)).collect());
    shape.vector(
        "sigma_position_m",
        placed.iter().map(|(m, _)| m.sigma_position_m.unwrap_or(UNKNOWN)).collect(),
    );
    shape.scalar("deflection_m", one(|m| m.deflection_m));
    shape.scalar("sigma_deflection_m", one(|m| m.sigma_deflection_m));
    shape.scalar("used", placed.iter().map(|(m, _)| f64::from(u8::from(m.used))).collect());
    shape
}

/// The survey.
pub fn ground_shape(ground: &[GroundMarker]) -> Shape {
    Shape {
        points_m: ground.iter().map(|g| g.position_m).collect(),
        ids: ground.iter().map(|g| g.id.clone()).collect(),
        ..Shape::default()
    }
}

/// Means over a series' solved frames.
pub fn series_shape(series: &SeriesData, ground: &[GroundMarker]) -> Shape {
    let points = points(&solved(series));
    let mut shape = Shape {
        points_m: points.iter().map(|p| p.position_m).collect(),
        ids: points.iter().map(|p| p.id.clone()).collect(),
        ..Shape::default()
    };
    let deflection = |of: fn(Mean) -> Option<f64>| {
        points.iter().map(|p| p.deflection_m.and_then(of).unwrap_or(f64::NAN)).collect::<Vec<f64>>()
    };
    shape
        .vector("displacement_m", points.iter().map(|p| displacement(ground, &p.id, p.position_m)).collect());
    shape.scalar("deflection_m", deflection(|m| Some(m.value)));
    shape.scalar("sigma_deflection_m", deflection(|m| m.sigma));
    shape
}

/// A `.pvd`: files with their times, s.
pub fn collection(files: &[(f64, String)]) -> String {
    let mut out = String::from(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>\n",
    );
    for (time_s, file) in files {
        let _ = writeln!(out, "<DataSet timestep=\"{time_s}\" group=\"\" part=\"0\" file=\"{file}\"/>");
    }
    out.push_str("</Collection>\n</VTKFile>\n");
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::super::sample;
    use super::*;

    fn numbers(text: &str, name: &str) -> Vec<f64> {
        let after = text.split(&format!("Name=\"{name}\"")).nth(1).unwrap();
        let body = after.split('>').nth(1).unwrap().split('<').next().unwrap();
        let bytes = STANDARD.decode(body).unwrap();
        let length = u64::from_le_bytes(bytes[..8].try_into().unwrap());
        assert_eq!(length as usize, bytes.len() - 8);
        bytes[8..].chunks_exact(8).map(|c| f64::from_le_bytes(c.try_into().unwrap())).collect()
    }

    #[test]
    fn displacement_is_the_whole_way_from_the_ground() {
        let series = sample::series("s000001", 0, &[2.9]);
        let record = &series.records[0];
        let at = record.markers[2].position_m.unwrap();
        let ground = [GroundMarker { id: "M03".into(), position_m: [at[0] - 0.1, at[1] + 0.2, at[2] - 2.8] }];
        let text = frame_shape(record, &ground).vtp(Some(7.5));
        assert!(text.contains("NumberOfPoints=\"3\""), "the hidden marker has no place");
        assert_eq!(numbers(&text, "TimeValue"), [7.5]);
        assert_eq!(numbers(&text, "Points")[6..], at);
        let way = numbers(&text, "displacement_m");
        assert!(way[0].is_nan(), "a marker without ground has none");
        assert!([0.1, -0.2, 2.8].iter().zip(&way[6..]).all(|(a, b)| (a - b).abs() < 1e-12), "{way:?}");
        let mean = series_shape(&series, &ground).vtu();
        assert_eq!(numbers(&mean, "deflection_m")[2], 2.9);
        assert!(collection(&[(0.0, "a.vtp".into())]).contains("timestep=\"0\""));
    }
}
