//! The adjustment of one image as a protocol to read: what was estimated, how well the model fits,
//! how each observation is controlled, and what was left out and why.

use serde_json::{Map, Value};
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use super::grid::Grid;
use super::number::{NONE, fields, fixed, general, rounded, words};
use super::table;
use crate::record::{
    GlobalTest, ImageRecord, MarkerRecord, Measured, Method, Parameters, Quality, SigmaKind, Status, Term,
    TorsionRecord, VarianceComponent,
};

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
    section(&mut out, "Positions and deflections", &positions(record).text());
    section(&mut out, "Deflection of the tip", &tip(record));
    section(&mut out, "What the variance of the tip's deflection comes from", &budget(record));
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
    let method = match (record.method, record.flight) {
        (Method::Profile, _) => "profile (a parabola in the vertical plane)",
        (_, true) => "spatial (a beam of rigid sections), all frames of the flight together",
        _ => "spatial (a beam of rigid sections), this frame alone",
    };
    let kind = match record.sigma_kind {
        Some(SigmaKind::Posterior) => "a posteriori (scaled by the root of the variance factor)",
        _ => "a priori (from the standard deviations of the observations)",
    };
    let iterations = record.quality.iterations.map_or(NONE.to_owned(), |count| count.to_string());
    format!(
        "Method               {method}\nMarkers used         {} of {}\nIterations           {iterations}\n\
         Standard deviations  {kind}\n",
        record.used(),
        record.markers.len()
    )
}

fn global_test(record: &ImageRecord) -> String {
    let redundancy = record.redundancy.unwrap_or(0);
    let alpha = level(record, |p| p.global_alpha);
    let limit = alpha.and_then(|a| {
        let law = ChiSquared::new(redundancy as f64).ok()?;
        Some(law.inverse_cdf(1.0 - a) / redundancy as f64)
    });
    let against = match (limit, alpha) {
        (Some(limit), Some(a)) => format!("; limit {limit:.3} at a level of {} %", general(100.0 * a)),
        _ => String::new(),
    };
    let factor = fixed(record.variance_factor, 3);
    let verdict = match record.global_test {
        Some(GlobalTest::Passed) => {
            "passed: the residuals do not contradict the model and the stated standard deviations; they cannot show \
             what leaves none, such as a wrong root, axis, lens or window"
        }
        Some(GlobalTest::Rejected) => {
            "rejected: the residuals are larger than the stated standard deviations allow; a wrong survey \
             point, a wrong identity, standard deviations stated too small or a model that does not fit"
        }
        None => "not possible: there is no redundancy",
    };
    format!("Variance factor {factor} with redundancy {redundancy}{against}.\nVerdict {verdict}.\n")
}

/// A level of significance that was asked for.
fn level(record: &ImageRecord, of: fn(&Parameters) -> f64) -> Option<f64> {
    record.provenance.parameters.as_ref().map(of).filter(|a| *a > 0.0 && *a < 1.0)
}

fn parameters(record: &ImageRecord) -> Grid {
    let name = |term: &Term| term.index.map_or(term.name.to_owned(), |k| format!("{}[{k}]", term.name));
    let sigma = |one: &Measured| one.sigma.filter(|s| *s > 0.0);
    let ratio = |term: &Term| term.measured.and_then(|m| Some(m.value.abs() / sigma(&m)?));
    let of = |value: Option<f64>, none: &str| value.map_or(none.to_owned(), general);
    Grid::each(&record.model.terms()).columns(&[
        ("<parameter", &name),
        ("value", &|term| of(term.measured.map(|m| m.value), NONE)),
        ("sigma", &|term| of(term.measured.and_then(|m| m.sigma), "fixed")),
        ("value / sigma", &|term| fixed(ratio(term), 1)),
    ])
}

fn correlations(record: &ImageRecord) -> String {
    let mut out = String::new();
    if let Some(r) = record.quality.pitch_bending_correlation {
        out.push_str(&format!("Mount's pitch with the amplitude of bending: {r:.3}\n"));
    }
    let Some((names, rows)) = matrix(record).filter(|(names, _)| names.len() > 1) else { return out };
    for (i, row) in rows.iter().enumerate() {
        for (j, r) in row.iter().enumerate().take(i).filter(|(_, r)| r.abs() >= STRONG_CORRELATION) {
            out.push_str(&format!("Strong: {} with {}: {r:.3}\n", names[j], names[i]));
        }
    }
    if names.len() <= MATRIX_LIMIT {
        out.push_str(&triangle(names, &rows).text());
    }
    out
}

/// The correlations of a solution's parameters as a lower triangle; `None` where there are none.
pub(super) fn correlation_grid(record: &ImageRecord) -> Option<Grid> {
    matrix(record).map(|(names, rows)| triangle(names, &rows))
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

/// Names and rows; what is not complete is left alone.
fn matrix(record: &ImageRecord) -> Option<(&[String], Vec<Vec<f64>>)> {
    let found = record.quality.correlation.as_ref()?;
    Some((&found.parameters, found.complete()?))
}

fn variance_components(record: &ImageRecord) -> String {
    if record.quality.variance_components.is_empty() {
        return String::new();
    }
    let root = |one: &VarianceComponent| one.factor.filter(|f| *f >= 0.0).map(f64::sqrt);
    Grid::each(&record.quality.variance_components)
        .columns(&[
            ("<group", &|one| one.group.clone()),
            ("component", &|one| fixed(one.factor, 3)),
            ("its sigma", &|one| fixed(one.sigma_factor, 3)),
            ("sigma scaled by", &|one| fixed(root(one), 3)),
            ("redundancy", &|one| fixed(one.redundancy, 2)),
        ])
        .text()
}

fn used(record: &ImageRecord) -> impl Iterator<Item = &MarkerRecord> {
    record.markers.iter().filter(|m| m.used)
}

fn observations(record: &ImageRecord) -> String {
    let grid = Grid::each(used(record)).columns(&[
        ("<marker", &|m| m.id.clone()),
        ("u / px", &|m| rounded(m.u_px, m.sigma_u_px, 2).0),
        ("v / px", &|m| rounded(m.v_px, m.sigma_v_px, 2).0),
        ("sigma u / px", &|m| rounded(m.u_px, m.sigma_u_px, 2).1),
        ("sigma v / px", &|m| rounded(m.v_px, m.sigma_v_px, 2).1),
        ("residual u / px", &|m| fixed(m.residual_u_px, 3)),
        ("residual v / px", &|m| fixed(m.residual_v_px, 3)),
        ("r u", &|m| fixed(m.redundancy_u, 2)),
        ("r v", &|m| fixed(m.redundancy_v, 2)),
        ("w", &|m| fixed(m.w_test, 2)),
        ("MDB u / px", &|m| fixed(m.mdb_u_px, 2)),
        ("MDB v / px", &|m| fixed(m.mdb_v_px, 2)),
    ]);
    let critical = level(record, |p| p.snooping_alpha).and_then(|alpha| {
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
    let of = |m: &MarkerRecord, axis: usize| {
        rounded(m.position_m.map(|p| p[axis]), m.sigma_position_m.map(|s| s[axis]), 4)
    };
    let distance = |m: &MarkerRecord| rounded(m.distance_m, m.sigma_distance_m, 4);
    let deflection = |m: &MarkerRecord| rounded(m.deflection_m, m.sigma_deflection_m, 4);
    Grid::each(used(record)).columns(&[
        ("<marker", &|m| m.id.clone()),
        ("x / m", &|m| of(m, 0).0),
        ("sigma", &|m| of(m, 0).1),
        ("y / m", &|m| of(m, 1).0),
        ("sigma", &|m| of(m, 1).1),
        ("z / m", &|m| of(m, 2).0),
        ("sigma", &|m| of(m, 2).1),
        ("distance / m", &|m| distance(m).0),
        ("sigma", &|m| distance(m).1),
        ("deflection / m", &|m| deflection(m).0),
        ("sigma", &|m| deflection(m).1),
    ])
}

fn tip(record: &ImageRecord) -> String {
    record.tip.as_ref().map_or(String::new(), |tip| table::tip(tip).text())
}

fn budget(record: &ImageRecord) -> String {
    if record.budget.is_empty() { String::new() } else { table::budget(&record.budget).text() }
}

fn torsion(record: &ImageRecord) -> String {
    if record.torsion.is_empty() {
        return String::new();
    }
    let angle = |t: &TorsionRecord| rounded(t.angle_deg, t.sigma_deg, 2);
    let twist = |t: &TorsionRecord| rounded(t.twist_deg, t.sigma_twist_deg, 2);
    Grid::each(&record.torsion)
        .columns(&[
            ("<pair", &|t| t.name.clone()),
            ("angle / deg", &|t| angle(t).0),
            ("sigma", &|t| angle(t).1),
            ("twist free of bending / deg", &|t| twist(t).0),
            ("sigma", &|t| twist(t).1),
        ])
        .text()
}

fn left_out(record: &ImageRecord) -> String {
    let sentence = |m: &MarkerRecord| {
        let reason = m.reason.as_deref().unwrap_or("no reason is recorded").trim_end_matches('.');
        format!("{}: {reason}.\n", m.id)
    };
    record.markers.iter().filter(|m| !m.used).map(sentence).collect()
}

fn seen(record: &ImageRecord) -> Grid {
    Grid::each(&record.markers).columns(&[
        ("<marker", &|m| m.id.clone()),
        ("u / px", &|m| fixed(m.u_px, 2)),
        ("v / px", &|m| fixed(m.v_px, 2)),
        ("<remark", &|m| m.reason.clone().unwrap_or_default()),
    ])
}

/// Everything that the numbers stand on, one line each.
fn provenance(record: &ImageRecord) -> String {
    let shown = Quality {
        iterations: None,
        pitch_bending_correlation: None,
        correlation: None,
        variance_components: vec![],
        ..record.quality.clone()
    };
    let lines = |fields: Map<String, Value>| -> String {
        fields.iter().map(|(key, value)| format!("{key}: {}\n", words(value))).collect()
    };
    lines(fields(&shown)) + &lines(fields(&record.provenance))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use serde_json::json;

    use super::super::sample;
    use super::*;
    use crate::record::Provenance;

    fn full() -> ImageRecord {
        let mut record = sample::record("f01.jpg", 2.93);
        record.provenance = Provenance {
            program: Some("wingd 1".into()),
            parameters: Some(Parameters { curvature_terms: Some(8), ..Parameters::default() }),
            ..Provenance::default()
        };
        let quality = json!({
            "iterations": 5,
            "pitch_bending_correlation": -0.981,
            "correlation": { "parameters": ["curvature[0]", "pitch"], "matrix": [[1.0, -0.95], [-0.95, 1.0]] },
            "variance_components": [{ "group": "image", "factor": 1.21, "redundancy": 20.5 }],
        });
        record.quality = serde_json::from_value(quality).unwrap();
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
        record.global_test = Some(GlobalTest::Rejected);
        record.variance_factor = Some(14.2);
        record.sigma_kind = Some(SigmaKind::Posterior);
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
        let odd = json!({ "correlation": { "parameters": ["a"], "matrix": [[1.0, null]] } });
        record.quality = serde_json::from_value(odd).unwrap();
        let text = protocol(&record);
        assert!(!text.contains("Correlations") && !text.contains("Variance components"));
    }
}
