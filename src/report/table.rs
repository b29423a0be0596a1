//! Tables for a terminal.

use super::grid::Grid;
use super::number::{NONE, fixed, rounded};
use super::summary::{Mean, SeriesSummary};
use crate::measure::detect::Detections;
use crate::record::{ImageRecord, MarkerRecord, Status, TorsionRecord};

/// One line per image; below it the markers where there is one image only, otherwise the markers
/// that were turned down, then failures and remarks.
pub fn results(records: &[ImageRecord]) -> String {
    let mut out = images(records).text();
    let notes = notes(records);
    match records {
        [one] if !one.markers.is_empty() => {
            out.push_str(&format!("\n{}", markers(one).text()));
        }
        _ => {
            let unused = unused(records);
            if !unused.rows.is_empty() {
                out.push_str(&format!("\nMarkers not used\n{}", unused.text()));
            }
        }
    }
    if !notes.is_empty() {
        out.push_str(&format!("\n{notes}"));
    }
    out
}

/// The markers of one frame as detected; `ids` in their order, or empty where none are known.
pub fn detections(image: &str, found: &Detections, ids: &[Option<String>]) -> String {
    let mut grid = Grid::new(&[
        "<id",
        "<shape",
        "u / px",
        "sigma u / px",
        "v / px",
        "sigma v / px",
        "semi-axes / px",
        "angle / deg",
    ]);
    for (i, m) in found.markers.iter().enumerate() {
        let sigma = |k: usize| m.covariance_px2.get((k, k)).map(|v| v.sqrt());
        let (u, su) = rounded(Some(m.centre_px.x), sigma(0), 2);
        let (v, sv) = rounded(Some(m.centre_px.y), sigma(1), 2);
        let id = ids.get(i).cloned().flatten().unwrap_or_else(|| NONE.to_owned());
        let axes = format!("{:.1} x {:.1}", m.semi_major_px, m.semi_minor_px);
        let angle = fixed(Some(m.angle_rad.to_degrees()), 1);
        grid.push(vec![id, m.shape.name().to_owned(), u, su, v, sv, axes, angle]);
    }
    let psf = found.psf_sigma_px.map(|s| format!(", blur {s:.2} px")).unwrap_or_default();
    format!(
        "{image}: {} markers, {} candidates turned down{psf}, noise {:.1} grey levels\n{}",
        found.markers.len(),
        found.rejected.len(),
        found.noise,
        grid.text()
    )
}

/// One line per series.
pub fn series(summaries: &[SeriesSummary]) -> String {
    series_grid(summaries).text()
}

/// One row per series; the terminal's and the report's.
pub fn series_grid(summaries: &[SeriesSummary]) -> Grid {
    let mut grid = Grid::new(&[
        "<series",
        "<begun (UTC)",
        "frames",
        "solved",
        "tip lift / m",
        "sigma / m",
        "scatter / m",
        "torsion / deg",
        "sigma / deg",
        "twist / deg",
        "sigma / deg",
        "variance factor",
        "test passed",
    ]);
    for s in summaries {
        let (lift, sigma) = mean(s.tip_lift_m.as_ref(), 3);
        let scatter = scatter(s.tip_lift_m.as_ref());
        let pair = s.torsion.first();
        let (angle, sigma_angle) = mean(pair.and_then(|p| p.angle_deg.as_ref()), 2);
        let (twist, sigma_twist) = mean(pair.and_then(|p| p.twist_deg.as_ref()), 2);
        grid.push(vec![
            s.name.clone(),
            s.begun_text(),
            s.shots.to_string(),
            s.solved.to_string(),
            lift,
            sigma,
            scatter,
            angle,
            sigma_angle,
            twist,
            sigma_twist,
            s.variance_text(),
            format!("{}/{}", s.tests_passed, s.tests_made),
        ]);
    }
    grid
}

fn mean(value: Option<&Mean>, fallback: usize) -> (String, String) {
    rounded(value.map(|m| m.value), value.and_then(|m| m.sigma), fallback)
}

fn scatter(value: Option<&Mean>) -> String {
    match value.and_then(|m| m.scatter) {
        Some(s) => fixed(Some(s), super::number::decimals_for(s)),
        None => NONE.to_owned(),
    }
}

/// One row per image; the terminal's and the report's.
pub fn images(records: &[ImageRecord]) -> Grid {
    let mut grid = Grid::new(&[
        "<image",
        "<status",
        "<method",
        "<tip",
        "lift / m",
        "sigma / m",
        "torsion / deg",
        "sigma / deg",
        "twist / deg",
        "sigma / deg",
        "used",
        "variance factor",
        "<global test",
    ]);
    for r in records {
        grid.push(image_row(r, (r.markers.iter().filter(|m| m.used).count(), r.markers.len())));
    }
    grid
}

/// The same of records whose markers were left out, with the counts of used and surveyed ones.
pub fn images_counted(records: &[ImageRecord], used: &[(usize, usize)]) -> Grid {
    let mut grid = images(&[]);
    grid.rows = records.iter().zip(used).map(|(r, used)| image_row(r, *used)).collect();
    grid
}

fn image_row(r: &ImageRecord, (used, of): (usize, usize)) -> Vec<String> {
    let tip = r.tip.as_ref();
    let pair = r.torsion.first();
    let (lift, sigma) = rounded(tip.map(|t| t.lift_m), tip.and_then(|t| t.sigma_lift_m), 3);
    let (angle, sigma_angle) = angle(pair);
    let (twist, sigma_twist) = twist(pair);
    let status = if r.status == Status::Ok { "ok" } else { "failed" };
    vec![
        r.image.clone(),
        status.to_owned(),
        if r.flight { "flight".to_owned() } else { r.method.clone() },
        tip.map_or(NONE.to_owned(), |t| t.marker.clone()),
        lift,
        sigma,
        angle,
        sigma_angle,
        twist,
        sigma_twist,
        format!("{used}/{of}"),
        fixed(r.variance_factor, 2),
        r.global_test.clone().unwrap_or_else(|| NONE.to_owned()),
    ]
}

fn angle(pair: Option<&TorsionRecord>) -> (String, String) {
    rounded(pair.and_then(|p| p.angle_deg), pair.and_then(|p| p.sigma_deg), 2)
}

fn twist(pair: Option<&TorsionRecord>) -> (String, String) {
    rounded(pair.and_then(|p| p.twist_deg), pair.and_then(|p| p.sigma_twist_deg), 2)
}

/// Every marker of one image; the terminal's and the report's.
pub fn markers(record: &ImageRecord) -> Grid {
    let mut grid = Grid::new(&[
        "<marker",
        "<shape",
        "u / px",
        "v / px",
        "sigma u / px",
        "sigma v / px",
        "residual u / px",
        "residual v / px",
        "distance / m",
        "sigma / m",
        "lift / m",
        "sigma / m",
        "w",
        "<remark",
    ]);
    for m in &record.markers {
        grid.push(marker_row(m));
    }
    grid
}

fn marker_row(m: &MarkerRecord) -> Vec<String> {
    let (u, sigma_u) = rounded(m.u_px, m.sigma_u_px, 2);
    let (v, sigma_v) = rounded(m.v_px, m.sigma_v_px, 2);
    let (distance, sigma_distance) = rounded(m.distance_m, m.sigma_distance_m, 3);
    let (lift, sigma_lift) = rounded(m.lift_m, m.sigma_lift_m, 3);
    vec![
        m.id.clone(),
        m.shape.clone(),
        u,
        v,
        sigma_u,
        sigma_v,
        fixed(m.residual_u_px, 3),
        fixed(m.residual_v_px, 3),
        distance,
        sigma_distance,
        lift,
        sigma_lift,
        fixed(m.w_test, 1),
        remark(m),
    ]
}

fn remark(m: &MarkerRecord) -> String {
    match (&m.reason, m.used) {
        (Some(reason), _) => reason.clone(),
        (None, true) => String::new(),
        (None, false) => "not used".to_owned(),
    }
}

/// Markers that took no part, with the reason; the same marker and reason once, with its frames counted.
pub fn unused(records: &[ImageRecord]) -> Grid {
    unused_of(records.iter().map(|r| (String::new(), r)))
}

/// The same of several series, each record with what goes before its name.
pub fn unused_of<'a>(records: impl Iterator<Item = (String, &'a ImageRecord)>) -> Grid {
    let mut grid = Grid::new(&["<marker", "<reason", "frames", "<first in"]);
    let mut seen: Vec<(String, String, usize, String)> = Vec::new();
    for (prefix, r) in records.filter(|(_, r)| r.status == Status::Ok) {
        for m in r.markers.iter().filter(|m| !m.used) {
            let reason = remark(m);
            match seen.iter_mut().find(|s| s.0 == m.id && s.1 == reason) {
                Some(s) => s.2 += 1,
                None => seen.push((m.id.clone(), reason, 1, format!("{prefix}{}", r.image))),
            }
        }
    }
    seen.sort_by(|a, b| a.0.cmp(&b.0));
    for (id, reason, count, image) in seen {
        grid.push(vec![id, reason, count.to_string(), image]);
    }
    grid
}

fn notes(records: &[ImageRecord]) -> String {
    let mut out = String::new();
    for r in records {
        for text in r.reason.iter().chain(&r.remarks) {
            out.push_str(&format!("{}: {text}\n", r.image));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    #[test]
    fn a_solved_image_shows_lift_torsion_and_its_markers() {
        let text = results(&[sample::record("f01.jpg", 2.93)]);
        for word in ["f01.jpg", "2.9300", "0.0060", "6.30", "0.20", "2.70", "passed", "M01", "hidden"] {
            assert!(text.contains(word), "{word} is missing in\n{text}");
        }
    }

    #[test]
    fn a_failed_image_shows_its_reason_and_no_number() {
        let text = results(&[sample::failed("f02.jpg", "the file is cut short; copy it again")]);
        assert!(text.contains("f02.jpg: the file is cut short; copy it again"));
        assert!(!text.contains("NaN") && text.contains("failed"));
    }

    #[test]
    fn several_images_list_the_markers_left_out_once() {
        let text = results(&[sample::record("a.jpg", 2.9), sample::record("b.jpg", 2.8)]);
        let lines: Vec<&str> = text.lines().filter(|l| l.contains("hidden")).collect();
        assert_eq!(lines.len(), 1, "{text}");
        assert!(lines[0].contains('2') && lines[0].contains("a.jpg"));
    }

    #[test]
    fn no_images_give_headings_only() {
        assert_eq!(results(&[]).lines().count(), 2);
    }
}
