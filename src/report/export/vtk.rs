//! Mean marker positions of a series as legacy VTK PolyData, for example for ParaView.

use super::super::summary::{Mean, solved_records};
use super::super::{SeriesData, distinct_values};
use crate::record::{ImageRecord, MarkerRecord};

/// Means of a marker over the solved frames of a series.
pub(super) struct MarkerMean {
    pub id: String,
    pub position_m: [f64; 3],
    sigma_m: [Option<f64>; 3],
    pub deflection_m: Option<Mean>,
    frames: usize,
}

/// Returns the points with deflection and standard deviation as vectors; `None` if the series has no positions. VTK has no
/// missing value: an unknown standard deviation is `nan`.
pub fn series_vtk(series: &SeriesData) -> Option<String> {
    let points = mean_points(&solved_records(series));
    if points.is_empty() {
        return None;
    }
    let n = points.len();
    let title: String = format!("wingd {}/{}, survey frame, m", series.flight, series.name);
    let title: String = title.chars().filter(|c| !c.is_control()).take(200).collect();
    let block = |head: String, row: &dyn Fn(&MarkerMean) -> String| {
        format!("{head}\n{}", points.iter().map(|p| row(p) + "\n").collect::<String>())
    };
    let head = format!("# vtk DataFile Version 3.0\n{title}\nASCII\nDATASET POLYDATA\nPOINTS {n} double");
    let vertices: String = (0..n).map(|i| format!("1 {i}\n")).collect();
    let deflection = |p: &MarkerMean| p.deflection_m.map_or(f64::NAN, |l| l.value);
    let sigma_deflection = |p: &MarkerMean| p.deflection_m.and_then(|l| l.sigma).unwrap_or(f64::NAN);
    let blocks = [
        block(head, &|p| number_line(&p.position_m)),
        format!("VERTICES {n} {}\n{vertices}", 2 * n),
        block(format!("POINT_DATA {n}\nVECTORS deflection_m double"), &|p| number_line(&[0.0, 0.0, deflection(p)])),
        block("VECTORS sigma_position_m double".to_owned(), &|p| {
            number_line(&p.sigma_m.map(|s| s.unwrap_or(f64::NAN)))
        }),
        block(format!("FIELD FieldData 3\nsigma_deflection_m 1 {n} double"), &|p| number_line(&[sigma_deflection(p)])),
        block(format!("frames 1 {n} int"), &|p| p.frames.to_string()),
        block(format!("marker 1 {n} string"), &|p| encode_string(&p.id)),
    ];
    Some(blocks.concat())
}

fn number_line(numbers: &[f64]) -> String {
    let word = |v: &f64| if v.is_finite() { v.to_string() } else { "nan".to_owned() };
    numbers.iter().map(word).collect::<Vec<_>>().join(" ")
}

/// Encodes a string for VTK, which reads `%` codes and allows no blanks or line ends.
fn encode_string(text: &str) -> String {
    let code = |b: u8| {
        if b.is_ascii_graphic() && b != b'%' && b != b'"' { (b as char).to_string() } else { format!("%{b:02X}") }
    };
    text.bytes().map(code).collect()
}

pub(super) fn mean_points(records: &[&ImageRecord]) -> Vec<MarkerMean> {
    let ids = distinct_values(records.iter().flat_map(|r| &r.markers).map(|m| m.id.as_str()));
    ids.iter().filter_map(|id| mean_point(records, id)).collect()
}

fn mean_point(records: &[&ImageRecord], id: &str) -> Option<MarkerMean> {
    let markers = records.iter().filter_map(|r| r.markers.iter().find(|m| m.id == id));
    let placed: Vec<&MarkerRecord> = markers.filter(|m| m.position_m.is_some()).collect();
    let axis = |k: usize| {
        let value = |m: &&MarkerRecord| Some((m.position_m?[k], m.sigma_position_m.map(|s| s[k])));
        Mean::from_values(&placed.iter().filter_map(value).collect::<Vec<_>>())
    };
    let deflections: Vec<_> = placed.iter().filter_map(|m| Some((m.deflection_m?, m.sigma_deflection_m))).collect();
    let (x, y, z) = (axis(0)?, axis(1)?, axis(2)?);
    Some(MarkerMean {
        id: id.to_owned(),
        position_m: [x.value, y.value, z.value],
        sigma_m: [x.sigma, y.sigma, z.sigma],
        deflection_m: Mean::from_values(&deflections),
        frames: x.count,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::super::sample;
    use super::*;

    /// Reads the numbers after a line that starts with `head`.
    fn block(text: &str, head: &str, lines: usize) -> Vec<Vec<f64>> {
        let after = text.lines().skip_while(|l| !l.starts_with(head)).skip(1);
        after.take(lines).map(|l| l.split(' ').map(|v| v.parse().unwrap()).collect()).collect()
    }

    #[test]
    fn the_file_holds_mean_positions_deflections_and_names() {
        let mut series = sample::series("s000001", 0, &[2.9, 3.1]);
        for record in &mut series.records {
            record.markers[0].id = "M 1%\n".to_owned();
        }
        let text = series_vtk(&series).unwrap();
        assert!(text.starts_with("# vtk DataFile Version 3.0\nwingd flight-0001/s000001"));
        assert!(text.contains("POINTS 3 double\n") && text.contains("VERTICES 3 6\n1 0\n1 1\n1 2\n"));
        assert_eq!(block(&text, "POINTS", 3)[2], [1.0, 36.0, 6.0]);
        let deflection = &block(&text, "VECTORS deflection_m", 3)[2];
        assert!((deflection[2] - 3.0).abs() < 1e-12 && deflection[0] == 0.0);
        let sigma = &block(&text, "VECTORS sigma_position_m", 3)[2];
        assert!(sigma.iter().zip([0.002, 0.004, 0.006]).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(block(&text, "frames", 3), [[2.0], [2.0], [2.0]]);
        assert!(text.contains("marker 1 3 string\nM%201%25%0A\nM02\nM03\n"));
    }

    #[test]
    fn a_series_without_positions_gives_no_file() {
        let mut series = sample::series("s000001", 0, &[]);
        assert_eq!(series_vtk(&series), None);
        series.records.push(sample::failed("x.jpg", "dark"));
        assert_eq!(series_vtk(&series), None);
    }
}
