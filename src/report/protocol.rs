//! The adjustment of one image as a protocol to read: what was estimated, how well the model fits,
//! how each observation is controlled, and what was left out and why.

use serde_json::Value;
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use super::grid::Grid;
use super::number::{NONE, fixed, general, rounded};
use crate::record::{ImageRecord, MarkerRecord, Status};

/// Correlations from here on are named as strong.
const STRONG_CORRELATION: f64 = 0.9;
/// Parameters up to which the correlations are printed as a matrix.
const MATRIX_LIMIT: usize = 12;

/// The protocol of one image.
pub fn protocol(record: &ImageRecord) -> String {
    let title = format!("Adjustment protocol: {}", record.image);
    let mut out = format!("{title}\n{}\n\n", "=".repeat(title.chars().count()));
    if record.status == Status::Failed {
        let reason = record.reason.as_deref().unwrap_or("no reason is recorded");
        out.push_str(&format!("Not solved: {reason}\n"));
        section(&mut out, "Markers", &seen(record).text());
        return out;
    }
    out.push_str(&overview(record));
    section(&mut out, "Global test", &global_test(record));
    section(&mut out, "Parameters", &parameters(record).text());
    section(&mut out, "Correlations", &correlations(record));
    section(&mut out, "Variance components", &variance_components(record));
    section(&mut out, "Observations and their reliability", &observations(record));
    section(&mut out, "Positions and lifts", &positions(record).text());
    section(&mut out, "Torsion", &torsion(record));
    section(&mut out, "Markers left out", &left_out(record));
    section(&mut out, "Remarks", &lines(&record.remarks));
    section(&mut out, "Made from", &provenance(record));
    out
}

/// Empty sections are not printed.
fn section(out: &mut String, title: &str, body: &str) {
    if !body.trim().is_empty() {
        out.push_str(&format!("\n{title}\n{}\n{}\n", "-".repeat(title.chars().count()), body.trim_end()));
    }
}

fn lines(texts: &[String]) -> String {
    texts.iter().map(|t| format!("{t}\n")).collect()
}

fn overview(record: &ImageRecord) -> String {
    let method = match (record.method.as_str(), record.flight) {
        ("profile", _) => "profile (a parabola in the vertical plane)",
        (_, true) => "spatial (a beam of rigid sections), all frames of the flight together",
        _ => "spatial (a beam of rigid sections), this frame alone",
    };
    let used = record.markers.iter().filter(|m| m.used).count();
    let kind = match record.sigma_kind.as_deref() {
        Some("posterior") => "a posteriori (scaled by the root of the variance factor)",
        _ => "a priori (from the standard deviations of the observations)",
    };
    let iterations = record.quality.get("iterations").map_or(NONE.into(), Value::to_string);
    format!(
        "Method               {method}\nMarkers used         {used} of {}\nIterations           {iterations}\n\
         Standard deviations  {kind}\n",
        record.markers.len()
    )
}

fn global_test(record: &ImageRecord) -> String {
    let redundancy = record.redundancy.unwrap_or(0);
    let alpha = level(record, "global_alpha");
    let limit = alpha.and_then(|a| {
        let law = ChiSquared::new(redundancy as f64).ok()?;
        Some(law.inverse_cdf(1.0 - a) / redundancy as f64)
    });
    let against = match (limit, alpha) {
        (Some(limit), Some(a)) => format!("; limit {limit:.3} at a level of {} %", general(100.0 * a)),
        _ => String::new(),
    };
    let factor = fixed(record.variance_factor, 3);
    let verdict = match record.global_test.as_deref() {
        Some("passed") => "passed: the residuals are as large as the stated standard deviations let expect",
        Some("rejected") => {
            "rejected: the residuals are larger than the stated standard deviations allow; a wrong survey \
             point, a wrong identity, standard deviations stated too small or a model that does not fit"
        }
        _ => "not possible: there is no redundancy",
    };
    format!("Variance factor {factor} with redundancy {redundancy}{against}.\nVerdict {verdict}.\n")
}

fn level(record: &ImageRecord, key: &str) -> Option<f64> {
    record.provenance.get("parameters")?.get(key)?.as_f64().filter(|a| *a > 0.0 && *a < 1.0)
}

fn parameters(record: &ImageRecord) -> Grid {
    let mut grid = Grid::new(&["<parameter", "value", "sigma", "value / sigma"]);
    for (name, value) in &record.model {
        match value {
            Value::Array(terms) => {
                for (k, term) in terms.iter().enumerate() {
                    grid.push(parameter_row(&format!("{name}[{k}]"), term));
                }
            }
            single => grid.push(parameter_row(name, single)),
        }
    }
    grid
}

fn parameter_row(name: &str, term: &Value) -> Vec<String> {
    let number = |key: &str| term.get(key).and_then(Value::as_f64);
    let (value, sigma) = (number("value").or(term.as_f64()), number("sigma"));
    let ratio = value.zip(sigma).filter(|(_, s)| *s > 0.0).map(|(v, s)| v.abs() / s);
    let sigma_text = sigma.map_or("fixed".to_owned(), general);
    vec![name.to_owned(), value.map_or(NONE.into(), general), sigma_text, fixed(ratio, 1)]
}

fn correlations(record: &ImageRecord) -> String {
    let mut out = String::new();
    if let Some(r) = record.quality.get("pitch_bending_correlation").and_then(Value::as_f64) {
        out.push_str(&format!("Mount's pitch with the amplitude of bending: {r:.3}\n"));
    }
    let Some((names, rows)) = matrix(record).filter(|(names, _)| names.len() > 1) else { return out };
    for (i, row) in rows.iter().enumerate() {
        for (j, r) in row.iter().enumerate().take(i).filter(|(_, r)| r.abs() >= STRONG_CORRELATION) {
            out.push_str(&format!("Strong: {} with {}: {r:.3}\n", names[j], names[i]));
        }
    }
    if names.len() <= MATRIX_LIMIT {
        out.push_str(&triangle(&names, &rows).text());
    }
    out
}

/// The correlations of a solution's parameters as a lower triangle; `None` where there are none.
pub(super) fn correlation_grid(record: &ImageRecord) -> Option<Grid> {
    matrix(record).map(|(names, rows)| triangle(&names, &rows))
}

fn triangle(names: &[String], rows: &[Vec<f64>]) -> Grid {
    let numbers: Vec<String> = (1..=names.len()).map(|k| k.to_string()).collect();
    let mut titles = vec!["<parameter"];
    titles.extend(numbers.iter().map(String::as_str));
    let mut grid = Grid::new(&titles);
    for (i, (name, row)) in names.iter().zip(rows).enumerate() {
        let mut cells = vec![format!("{} {name}", i + 1)];
        cells.extend(
            row.iter().enumerate().map(|(j, r)| if j <= i { format!("{r:.2}") } else { String::new() }),
        );
        grid.push(cells);
    }
    grid
}

/// Square, with a name for each row; anything else is left alone.
fn matrix(record: &ImageRecord) -> Option<(Vec<String>, Vec<Vec<f64>>)> {
    let found = record.quality.get("correlation")?;
    let names: Vec<String> = serde_json::from_value(found.get("parameters")?.clone()).ok()?;
    let rows: Vec<Vec<f64>> = serde_json::from_value(found.get("matrix")?.clone()).ok()?;
    let square = rows.len() == names.len() && rows.iter().all(|r| r.len() == names.len());
    square.then_some((names, rows))
}

fn variance_components(record: &ImageRecord) -> String {
    let Some(Value::Array(list)) = record.quality.get("variance_components") else { return String::new() };
    let mut grid = Grid::new(&["<group", "component", "its sigma", "sigma scaled by", "redundancy"]);
    for one in list {
        let number = |key: &str| one.get(key).and_then(Value::as_f64);
        let root = number("factor").filter(|f| *f >= 0.0).map(f64::sqrt);
        let group = one.get("group").and_then(Value::as_str).unwrap_or(NONE);
        grid.push(vec![
            group.to_owned(),
            fixed(number("factor"), 3),
            fixed(number("sigma_factor"), 3),
            fixed(root, 3),
            fixed(number("redundancy"), 2),
        ]);
    }
    grid.text()
}

fn observations(record: &ImageRecord) -> String {
    let mut grid = Grid::new(&[
        "<marker",
        "u / px",
        "v / px",
        "sigma u / px",
        "sigma v / px",
        "residual u / px",
        "residual v / px",
        "r u",
        "r v",
        "w",
        "MDB u / px",
        "MDB v / px",
    ]);
    for m in record.markers.iter().filter(|m| m.used) {
        grid.push(observation_row(m));
    }
    let critical = level(record, "snooping_alpha").and_then(|alpha| {
        let law = Normal::new(0.0, 1.0).ok()?;
        Some(format!(
            "\nr: redundancy number; w: test statistic, critical beyond {:.2} (level {} %); MDB: minimal detectable \
             bias, px.\n",
            law.inverse_cdf(1.0 - 0.5 * alpha),
            general(100.0 * alpha)
        ))
    });
    let weak = weakly_controlled(record);
    format!("{}{}{weak}", grid.text(), critical.unwrap_or_default())
}

fn observation_row(m: &MarkerRecord) -> Vec<String> {
    let (u, sigma_u) = rounded(m.u_px, m.sigma_u_px, 2);
    let (v, sigma_v) = rounded(m.v_px, m.sigma_v_px, 2);
    vec![
        m.id.clone(),
        u,
        v,
        sigma_u,
        sigma_v,
        fixed(m.residual_u_px, 3),
        fixed(m.residual_v_px, 3),
        fixed(m.redundancy_u, 2),
        fixed(m.redundancy_v, 2),
        fixed(m.w_test, 2),
        fixed(m.mdb_u_px, 2),
        fixed(m.mdb_v_px, 2),
    ]
}

/// Markers whose image the others hardly check in either coordinate.
fn weakly_controlled(record: &ImageRecord) -> String {
    let weak = |m: &&MarkerRecord| {
        let redundancy = m.redundancy_u.zip(m.redundancy_v);
        m.used && redundancy.is_some_and(|(u, v)| u + v < 0.1)
    };
    let ids: Vec<&str> = record.markers.iter().filter(weak).map(|m| m.id.as_str()).collect();
    if ids.is_empty() {
        String::new()
    } else {
        format!("Hardly controlled by the others: {}.\n", ids.join(", "))
    }
}

fn positions(record: &ImageRecord) -> Grid {
    let mut grid = Grid::new(&[
        "<marker",
        "x / m",
        "sigma",
        "y / m",
        "sigma",
        "z / m",
        "sigma",
        "distance / m",
        "sigma",
        "lift / m",
        "sigma",
    ]);
    for m in record.markers.iter().filter(|m| m.used) {
        let mut cells = vec![m.id.clone()];
        for axis in 0..3 {
            let sigma = m.sigma_position_m.map(|s| s[axis]);
            cells.extend(<[String; 2]>::from(rounded(m.position_m.map(|p| p[axis]), sigma, 4)));
        }
        cells.extend(<[String; 2]>::from(rounded(m.distance_m, m.sigma_distance_m, 4)));
        cells.extend(<[String; 2]>::from(rounded(m.lift_m, m.sigma_lift_m, 4)));
        grid.push(cells);
    }
    grid
}

fn torsion(record: &ImageRecord) -> String {
    if record.torsion.is_empty() {
        return String::new();
    }
    let mut grid = Grid::new(&["<pair", "angle / deg", "sigma", "twist free of bending / deg", "sigma"]);
    for t in &record.torsion {
        let (angle, sigma) = rounded(t.angle_deg, t.sigma_deg, 2);
        let (twist, sigma_twist) = rounded(t.twist_deg, t.sigma_twist_deg, 2);
        grid.push(vec![t.name.clone(), angle, sigma, twist, sigma_twist]);
    }
    grid.text()
}

fn left_out(record: &ImageRecord) -> String {
    let sentence = |m: &MarkerRecord| {
        let reason = m.reason.as_deref().unwrap_or("no reason is recorded").trim_end_matches('.');
        format!("{}: {reason}.\n", m.id)
    };
    record.markers.iter().filter(|m| !m.used).map(sentence).collect()
}

fn seen(record: &ImageRecord) -> Grid {
    let mut grid = Grid::new(&["<marker", "u / px", "v / px", "<remark"]);
    for m in &record.markers {
        grid.push(vec![
            m.id.clone(),
            fixed(m.u_px, 2),
            fixed(m.v_px, 2),
            m.reason.clone().unwrap_or_default(),
        ]);
    }
    grid
}

/// Everything that the numbers stand on, one line each.
fn provenance(record: &ImageRecord) -> String {
    let plain = |v: &Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    let printed = ["iterations", "correlation", "pitch_bending_correlation", "variance_components"];
    let extra = record.quality.iter().filter(|(key, _)| !printed.contains(&key.as_str()));
    extra.chain(&record.provenance).map(|(key, value)| format!("{key}: {}\n", plain(value))).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::sample;
    use super::*;

    fn full() -> ImageRecord {
        let mut record = sample::record("f01.jpg", 2.93);
        let provenance =
            json!({ "program": "wingd 1", "parameters": { "global_alpha": 0.01, "snooping_alpha": 0.001 } });
        record.provenance = provenance.as_object().unwrap().clone();
        let quality = json!({
            "iterations": 5,
            "pitch_bending_correlation": -0.981,
            "correlation": { "parameters": ["curvature[0]", "pitch"], "matrix": [[1.0, -0.95], [-0.95, 1.0]] },
            "variance_components": [{ "group": "image", "factor": 1.21, "redundancy": 20.5 }],
        });
        record.quality = quality.as_object().unwrap().clone();
        record.remarks = vec!["three terms of the curvature were chosen by test".into()];
        record
    }

    #[test]
    fn everything_a_reader_asks_for_is_there() {
        let text = protocol(&full());
        for expected in [
            "Variance factor 0.970 with redundancy 33; limit 1.66",
            "Verdict passed",
            "a_per_m",
            "Strong: curvature[0] with pitch: -0.950",
            "Mount's pitch with the amplitude of bending: -0.981",
            "image",
            "1.100",
            "critical beyond 3.29 (level 0.1000 %)",
            "M04: hidden by glare.",
            "three terms of the curvature",
            "program: wingd 1",
            "6.30",
        ] {
            assert!(text.contains(expected), "{expected} is missing in\n{text}");
        }
        assert!(!text.contains("NaN") && !text.contains("null"));
    }

    #[test]
    fn a_rejected_model_is_called_so() {
        let mut record = full();
        record.global_test = Some("rejected".into());
        record.variance_factor = Some(14.2);
        record.sigma_kind = Some("posterior".into());
        let text = protocol(&record);
        assert!(text.contains("Verdict rejected") && text.contains("a posteriori"), "{text}");
    }

    #[test]
    fn an_uncontrolled_marker_is_named() {
        let mut record = full();
        record.markers[1].redundancy_u = Some(0.02);
        record.markers[1].redundancy_v = Some(0.01);
        assert!(protocol(&record).contains("Hardly controlled by the others: M02."));
    }

    #[test]
    fn a_failed_image_says_what_to_do_and_nothing_else() {
        let text = protocol(&sample::failed("f02.jpg", "the file is cut short; copy it again"));
        assert!(text.contains("Not solved: the file is cut short; copy it again"));
        assert!(!text.contains("Verdict"));
    }

    #[test]
    fn damaged_quality_is_left_out() {
        let mut record = full();
        let odd = json!({ "correlation": { "parameters": ["a"], "matrix": [[1.0, 2.0]] }, "variance_components": 3 });
        record.quality = odd.as_object().unwrap().clone();
        let text = protocol(&record);
        assert!(!text.contains("Correlations") && !text.contains("Variance components"));
    }
}
