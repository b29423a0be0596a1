//! VTK XML files of shapes: `.vtp` per frame, `.pvd` over time, and the ground shape.
//!
//! Arrays are base64 with a 64-bit length prefix: an unknown number is NaN, which the text form cannot represent.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use wingd_evaluation::record::{ImageRecord, MarkerRecord};
use wingd_evaluation::results::GroundMarker;

/// Points with their data arrays and marker ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VtkShape {
    points_m: Vec<[f64; 3]>,
    /// Data arrays: name, number of components, values.
    arrays: Vec<(&'static str, usize, Vec<f64>)>,
    ids: Vec<String>,
}

impl VtkShape {
    /// Adds a vector of each point.
    pub fn add_vector(&mut self, name: &'static str, values: Vec<[f64; 3]>) {
        self.arrays
            .push((name, 3, values.into_iter().flatten().collect()));
    }

    /// Adds a number of each point.
    pub fn add_scalar(&mut self, name: &'static str, values: Vec<f64>) {
        self.arrays.push((name, 1, values));
    }

    /// Returns the shape as PolyData (`.vtp`); `time_s` is written to its field data.
    pub fn to_vtp(&self, time_s: Option<f64>) -> String {
        let n = self.points_m.len();
        let head = format!(
            "<Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"{n}\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">"
        );
        let cells = format!("<Verts>{}</Verts>", single_points(n));
        self.to_xml(&head, &cells, time_s)
    }

    fn to_xml(&self, piece: &str, cells: &str, time_s: Option<f64>) -> String {
        let kind = "PolyData";
        let mut out = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<{kind}>\n"
        );
        if let Some(time_s) = time_s {
            let time = data_array("Float64", "TimeValue", 1, &time_s.to_le_bytes());
            let time = time.replace("<DataArray", "<DataArray NumberOfTuples=\"1\"");
            let _ = writeln!(out, "<FieldData>{time}</FieldData>");
        }
        let _ = writeln!(out, "{piece}\n<PointData>");
        for (name, components, values) in &self.arrays {
            let _ = writeln!(
                out,
                "{}",
                data_array("Float64", name, *components, &little_endian_bytes(values))
            );
        }
        // A string is the codes of its letters, terminated by zero.
        let letters: Vec<u8> = self
            .ids
            .iter()
            .flat_map(|id| id.bytes().chain([0]))
            .collect();
        let codes: Vec<String> = letters.iter().map(u8::to_string).collect();
        let _ = writeln!(
            out,
            "<Array type=\"String\" Name=\"marker\" NumberOfTuples=\"{}\" format=\"ascii\">{}</Array>",
            self.ids.len(),
            codes.join(" ")
        );
        let flat: Vec<f64> = self.points_m.iter().flatten().copied().collect();
        let points = data_array("Float64", "Points", 3, &little_endian_bytes(&flat));
        let _ = writeln!(
            out,
            "</PointData>\n<Points>{points}</Points>\n{cells}\n</Piece>\n</{kind}>\n</VTKFile>"
        );
        out
    }
}

fn little_endian_bytes(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Cells of one point each.
fn single_points(count: usize) -> String {
    index_arrays(0..count, 1..count + 1)
}

/// Points of all cells, and the end of each cell in them.
fn index_arrays(points: impl Iterator<Item = usize>, ends: impl Iterator<Item = usize>) -> String {
    let array = |name: &str, values: Vec<u8>| data_array("Int64", name, 1, &values);
    array(
        "connectivity",
        points.flat_map(|i| (i as i64).to_le_bytes()).collect(),
    ) + &array(
        "offsets",
        ends.flat_map(|i| (i as i64).to_le_bytes()).collect(),
    )
}

fn data_array(kind: &str, name: &str, components: usize, bytes: &[u8]) -> String {
    let data = [&(bytes.len() as u64).to_le_bytes()[..], bytes].concat();
    // If a single component were declared, some readers would create a 2-D array.
    let shape = if components == 1 {
        String::new()
    } else {
        format!(" NumberOfComponents=\"{components}\"")
    };
    let text = STANDARD.encode(data);
    format!(
        "<DataArray type=\"{kind}\" Name=\"{name}\"{shape} format=\"binary\">{text}</DataArray>"
    )
}

const UNKNOWN_VECTOR: [f64; 3] = [f64::NAN; 3];

/// Returns the displacement of a marker from its position on ground, m; NaN if that is unknown.
fn displacement_from_ground(ground: &[GroundMarker], id: &str, at_m: [f64; 3]) -> [f64; 3] {
    let from = ground.iter().find(|g| g.id == id).map(|g| g.position_m);
    from.map_or(UNKNOWN_VECTOR, |from| {
        std::array::from_fn(|k| at_m[k] - from[k])
    })
}

/// Returns the markers of one frame in flight, with their displacement relative to the survey.
pub fn frame_shape(record: &ImageRecord, ground: &[GroundMarker]) -> VtkShape {
    let placed: Vec<(&MarkerRecord, [f64; 3])> = record
        .markers
        .iter()
        .filter_map(|m| Some((m, m.position_m?)))
        .collect();
    let one = |f: fn(&MarkerRecord) -> Option<f64>| {
        placed
            .iter()
            .map(|(m, _)| f(m).unwrap_or(f64::NAN))
            .collect::<Vec<f64>>()
    };
    let mut shape = VtkShape {
        points_m: placed.iter().map(|(_, p)| *p).collect(),
        ids: placed.iter().map(|(m, _)| m.id.clone()).collect(),
        ..VtkShape::default()
    };
    shape.add_vector(
        "displacement_m",
        placed
            .iter()
            .map(|(m, p)| displacement_from_ground(ground, &m.id, *p))
            .collect(),
    );
    shape.add_vector(
        "sigma_position_m",
        placed
            .iter()
            .map(|(m, _)| m.sigma_position_m.unwrap_or(UNKNOWN_VECTOR))
            .collect(),
    );
    shape.add_scalar("deflection_m", one(|m| m.deflection_m));
    shape.add_scalar("sigma_deflection_m", one(|m| m.sigma_deflection_m));
    shape.add_scalar(
        "used",
        placed
            .iter()
            .map(|(m, _)| f64::from(u8::from(m.used)))
            .collect(),
    );
    shape
}

/// Returns the surveyed markers.
pub fn ground_shape(ground: &[GroundMarker]) -> VtkShape {
    VtkShape {
        points_m: ground.iter().map(|g| g.position_m).collect(),
        ids: ground.iter().map(|g| g.id.clone()).collect(),
        ..VtkShape::default()
    }
}

/// Returns a `.pvd` file of frames with their times, s.
pub fn time_collection(files: &[(f64, String)]) -> String {
    let mut out = String::from(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>\n",
    );
    for (time_s, file) in files {
        let _ = writeln!(
            out,
            "<DataSet timestep=\"{time_s}\" group=\"\" part=\"0\" file=\"{file}\"/>"
        );
    }
    out.push_str("</Collection>\n</VTKFile>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use wingd_evaluation::results::sample;

    fn numbers(text: &str, name: &str) -> Vec<f64> {
        let after = text.split(&format!("Name=\"{name}\"")).nth(1).unwrap();
        let body = after.split('>').nth(1).unwrap().split('<').next().unwrap();
        let bytes = STANDARD.decode(body).unwrap();
        let length = u64::from_le_bytes(bytes[..8].try_into().unwrap());
        assert_eq!(length as usize, bytes.len() - 8);
        bytes[8..]
            .chunks_exact(8)
            .map(|c| f64::from_le_bytes(c.try_into().unwrap()))
            .collect()
    }

    #[test]
    fn displacement_is_relative_to_the_ground() {
        let series = sample::series("s000001", 0, &[2.9]);
        let record = &series.records[0];
        let at = record.markers[2].position_m.unwrap();
        let ground = [GroundMarker {
            id: "M03".into(),
            position_m: [at[0] - 0.1, at[1] + 0.2, at[2] - 2.8],
        }];
        let text = frame_shape(record, &ground).to_vtp(Some(7.5));
        assert!(
            text.contains("NumberOfPoints=\"3\""),
            "the hidden marker has no position"
        );
        assert_eq!(numbers(&text, "TimeValue"), [7.5]);
        assert_eq!(numbers(&text, "Points")[6..], at);
        let way = numbers(&text, "displacement_m");
        assert!(way[0].is_nan(), "a marker without ground has none");
        assert!(
            [0.1, -0.2, 2.8]
                .iter()
                .zip(&way[6..])
                .all(|(a, b)| (a - b).abs() < 1e-12),
            "{way:?}"
        );
        assert!(time_collection(&[(0.0, "a.vtp".into())]).contains("timestep=\"0\""));
    }
}
