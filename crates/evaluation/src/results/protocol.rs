//! Protocol of the adjustment of one image as text: estimated parameters, goodness of fit, reliability of each observation,
//! and excluded markers with the reasons.

use serde_json::{Map, Value};
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use super::table;
use crate::grid::ColumnDefinition::{One, Pair};
use crate::grid::Grid;
use crate::number::{NONE, format_fixed, format_general, format_rounded};
use crate::record::{
    ImageRecord, MarkerRecord, Parameters, Quality, RecordStatus, Term, json_fields, json_text,
};
use wingd_measure::adjust::AdjustmentMethod;
use wingd_measure::estimation::VarianceComponent;
use wingd_measure::estimation::quality::{GlobalTest, SigmaKind};
use wingd_measure::observation::Estimate;

/// Correlations of at least this magnitude are listed as strong.
const STRONG_CORRELATION: f64 = 0.9;
/// Maximum number of parameters for which the correlation matrix is printed.
const MAX_MATRIX_PARAMETERS: usize = 12;

/// Returns the adjustment protocol of one image.
pub fn adjustment_protocol(record: &ImageRecord) -> String {
    let title = format!("Adjustment protocol: {}", record.image);
    let mut out = format!("{title}\n{}\n\n", "=".repeat(title.chars().count()));
    if record.status == RecordStatus::Failed {
        let reason = record.reason.as_deref().unwrap_or("no reason is recorded");
        out.push_str(&format!("Not solved: {reason}\n"));
        push_section(&mut out, "Markers", &detection_table(record).text());
        return out;
    }
    if let Some(reason) = &record.reason {
        out.push_str(&format!("Doubtful: {reason}\n"));
    }
    out.push_str(&overview_text(record));
    push_section(&mut out, "Global test", &global_test_text(record));
    push_section(&mut out, "Parameters", &parameter_table(record).text());
    push_section(&mut out, "Correlations", &correlation_text(record));
    push_section(
        &mut out,
        "Variance components",
        &variance_components(record),
    );
    push_section(
        &mut out,
        "Observations and their reliability",
        &observation_text(record),
    );
    push_section(
        &mut out,
        "Positions and deflections",
        &position_table(record).text(),
    );
    push_section(
        &mut out,
        "Deflection of the tip",
        &tip_deflection_text(record),
    );
    push_section(
        &mut out,
        "Uncertainty budget of the tip deflection",
        &variance_budget_text(record),
    );
    push_section(&mut out, "Torsion", &torsion_text(record));
    push_section(&mut out, "Excluded markers", &unused_marker_text(record));
    push_section(&mut out, "Remarks", &record.remarks.join("\n"));
    push_section(&mut out, "Inputs", &provenance_text(record));
    out
}

/// Adds a section with a heading; an empty section is omitted.
fn push_section(out: &mut String, title: &str, body: &str) {
    if !body.trim().is_empty() {
        out.push_str(&format!(
            "\n{title}\n{}\n{}\n",
            "-".repeat(title.chars().count()),
            body.trim_end()
        ));
    }
}

fn overview_text(record: &ImageRecord) -> String {
    let method = match (record.method, record.flight) {
        (Some(AdjustmentMethod::Profile), _) => {
            "profile (the wing bends as a parabola in the vertical plane)"
        }
        (_, true) => "spatial (a beam of rigid sections), joint adjustment of the flight's frames",
        _ => "spatial (a beam of rigid sections), single frame",
    };
    let kind = match record.sigma_kind {
        Some(SigmaKind::Posterior) => {
            "a posteriori (scaled by the square root of the variance factor)"
        }
        _ => "a priori (propagated from observations and priors)",
    };
    let iterations = record
        .quality
        .iterations
        .map_or(NONE.to_owned(), |count| count.to_string());
    format!(
        "Method               {method}\nMarkers used         {} of {}\nIterations           {iterations}\n\
         Standard deviations  {kind}\n",
        record.used_count(),
        record.markers.len()
    )
}

fn global_test_text(record: &ImageRecord) -> String {
    let redundancy = record.redundancy.unwrap_or(0);
    let alpha = significance_level(record, |p| p.global_alpha);
    let limit = alpha.and_then(|a| {
        let law = ChiSquared::new(redundancy as f64).ok()?;
        Some(law.inverse_cdf(1.0 - a) / redundancy as f64)
    });
    let against = match (limit, alpha) {
        (Some(limit), Some(a)) => {
            format!(
                "; limit {limit:.3} at a significance level of {} %",
                format_general(100.0 * a)
            )
        }
        _ => String::new(),
    };
    let factor = format_fixed(record.variance_factor, 3);
    let verdict = match record.global_test {
        Some(GlobalTest::Passed) => {
            "passed: the residuals are consistent with the model and the specified standard deviations; errors that \
             leave no residuals, such as a wrong root, axis, lens or window, cannot be ruled out"
        }
        Some(GlobalTest::Rejected) => {
            "rejected: the residuals are larger than the specified standard deviations allow; check for a wrong survey \
             point, a wrong identity, standard deviations that are too small, or a model that does not fit"
        }
        None => "not possible: there is no redundancy",
    };
    format!("Variance factor {factor} with redundancy {redundancy}{against}.\nVerdict {verdict}.\n")
}

/// Returns a configured significance level; `None` if it is not between 0 and 1.
fn significance_level(record: &ImageRecord, parameter: fn(&Parameters) -> f64) -> Option<f64> {
    record
        .provenance
        .parameters
        .as_ref()
        .map(parameter)
        .filter(|a| *a > 0.0 && *a < 1.0)
}

fn parameter_table(record: &ImageRecord) -> Grid {
    let name = |term: &Term| {
        term.index
            .map_or(term.name.clone(), |k| format!("{}[{k}]", term.name))
    };
    let sigma = |one: &Estimate| one.sigma.filter(|s| *s > 0.0);
    let ratio = |term: &Term| term.estimate.and_then(|m| Some(m.value.abs() / sigma(&m)?));
    let format_value =
        |value: Option<f64>, none: &str| value.map_or(none.to_owned(), format_general);
    Grid::for_rows(&record.model.terms()).columns(&[
        One("<parameter", &name),
        One("value", &|term| {
            format_value(term.estimate.map(|m| m.value), NONE)
        }),
        One("sigma", &|term| {
            format_value(term.estimate.and_then(|m| m.sigma), "fixed")
        }),
        One("value / sigma", &|term| format_fixed(ratio(term), 1)),
    ])
}

fn correlation_text(record: &ImageRecord) -> String {
    let mut out = String::new();
    if let Some(r) = record.quality.pitch_bending_correlation {
        out.push_str(&format!("Mounting pitch with bending amplitude: {r:.3}\n"));
    }
    let Some((names, rows)) = correlation_matrix(record).filter(|(names, _)| names.len() > 1)
    else {
        return out;
    };
    for (i, row) in rows.iter().enumerate() {
        for (j, r) in row
            .iter()
            .enumerate()
            .take(i)
            .filter(|(_, r)| r.abs() >= STRONG_CORRELATION)
        {
            out.push_str(&format!("Strong: {} with {}: {r:.3}\n", names[j], names[i]));
        }
    }
    if names.len() <= MAX_MATRIX_PARAMETERS {
        out.push_str(&lower_triangle_table(names, &rows).text());
    }
    out
}

fn lower_triangle_table(names: &[String], rows: &[Vec<f64>]) -> Grid {
    let numbers: Vec<String> = (1..=names.len()).map(|k| k.to_string()).collect();
    let mut titles = vec!["<parameter"];
    titles.extend(numbers.iter().map(String::as_str));
    let mut grid = Grid::new(&titles);
    for (i, (name, row)) in names.iter().zip(rows).enumerate() {
        let mut cells = vec![format!("{} {name}", i + 1)];
        cells.extend(row.iter().enumerate().map(|(j, r)| {
            if j <= i {
                format!("{r:.2}")
            } else {
                String::new()
            }
        }));
        grid.push(cells);
    }
    grid
}

/// Returns names and rows of the correlation matrix; `None` if it is incomplete.
fn correlation_matrix(record: &ImageRecord) -> Option<(&[String], Vec<Vec<f64>>)> {
    let found = record.quality.correlation.as_ref()?;
    Some((&found.parameters, found.complete()?))
}

fn variance_components(record: &ImageRecord) -> String {
    if record.quality.variance_components.is_empty() {
        return String::new();
    }
    let root = |one: &VarianceComponent| one.factor.filter(|f| *f >= 0.0).map(f64::sqrt);
    Grid::for_rows(&record.quality.variance_components)
        .columns(&[
            One("<group", &|one| one.group.to_string()),
            One("component", &|one| format_fixed(one.factor, 3)),
            One("sigma", &|one| format_fixed(one.sigma_factor, 3)),
            One("sigma scaled by", &|one| format_fixed(root(one), 3)),
            One("redundancy", &|one| format_fixed(Some(one.redundancy), 2)),
        ])
        .text()
}

fn used_markers(record: &ImageRecord) -> impl Iterator<Item = &MarkerRecord> {
    record.markers.iter().filter(|m| m.used)
}

fn observation_text(record: &ImageRecord) -> String {
    let grid = Grid::for_rows(used_markers(record)).columns(&[
        One("<marker", &|m| m.id.clone()),
        One("u / px", &|m| format_rounded(m.u_px, m.sigma_u_px, 2).0),
        One("v / px", &|m| format_rounded(m.v_px, m.sigma_v_px, 2).0),
        One("sigma u / px", &|m| {
            format_rounded(m.u_px, m.sigma_u_px, 2).1
        }),
        One("sigma v / px", &|m| {
            format_rounded(m.v_px, m.sigma_v_px, 2).1
        }),
        One("residual u / px", &|m| format_fixed(m.residual_u_px, 3)),
        One("residual v / px", &|m| format_fixed(m.residual_v_px, 3)),
        One("r u", &|m| format_fixed(m.redundancy_u, 2)),
        One("r v", &|m| format_fixed(m.redundancy_v, 2)),
        One("w", &|m| format_fixed(m.w_test, 2)),
        One("MDB u / px", &|m| format_fixed(m.mdb_u_px, 2)),
        One("MDB v / px", &|m| format_fixed(m.mdb_v_px, 2)),
    ]);
    let critical = significance_level(record, |p| p.snooping_alpha).and_then(|alpha| {
        let law = Normal::new(0.0, 1.0).ok()?;
        Some(format!(
            "\nr: redundancy number; w: test statistic, critical above {:.2} (level {} %); MDB: minimal detectable \
             bias, px.\n",
            law.inverse_cdf(1.0 - 0.5 * alpha),
            format_general(100.0 * alpha)
        ))
    });
    let weak = weakly_controlled(record);
    format!("{}{}{weak}", grid.text(), critical.unwrap_or_default())
}

/// Lists the markers whose image position is hardly checked by the other markers.
fn weakly_controlled(record: &ImageRecord) -> String {
    let weak = |m: &&MarkerRecord| {
        let redundancy = m.redundancy_u.zip(m.redundancy_v);
        m.used && redundancy.is_some_and(|(u, v)| u + v < 0.1)
    };
    let ids: Vec<&str> = record
        .markers
        .iter()
        .filter(weak)
        .map(|m| m.id.as_str())
        .collect();
    if ids.is_empty() {
        String::new()
    } else {
        format!("Hardly checked by other markers: {}.\n", ids.join(", "))
    }
}

fn position_table(record: &ImageRecord) -> Grid {
    let coordinate = |m: &MarkerRecord, axis: usize| {
        format_rounded(
            m.position_m.map(|p| p[axis]),
            m.sigma_position_m.map(|s| s[axis]),
            4,
        )
    };
    Grid::for_rows(used_markers(record)).columns(&[
        One("<marker", &|m| m.id.clone()),
        Pair("x / m", "sigma", &|m| coordinate(m, 0)),
        Pair("y / m", "sigma", &|m| coordinate(m, 1)),
        Pair("z / m", "sigma", &|m| coordinate(m, 2)),
        Pair("distance / m", "sigma", &|m| {
            format_rounded(m.distance_m, m.sigma_distance_m, 4)
        }),
        Pair("deflection / m", "sigma", &|m| {
            format_rounded(m.deflection_m, m.sigma_deflection_m, 4)
        }),
    ])
}

fn tip_deflection_text(record: &ImageRecord) -> String {
    record
        .tip
        .as_ref()
        .map_or(String::new(), |tip| table::tip_table(tip).text())
}

fn variance_budget_text(record: &ImageRecord) -> String {
    if record.budget.is_empty() {
        String::new()
    } else {
        table::budget_table(&record.budget).text()
    }
}

fn torsion_text(record: &ImageRecord) -> String {
    if record.torsion.is_empty() {
        return String::new();
    }
    Grid::for_rows(&record.torsion)
        .columns(&[
            One("<pair", &|t| t.name.clone()),
            Pair("angle / deg", "sigma", &|t| {
                format_rounded(t.angle_deg, t.sigma_deg, 2)
            }),
            Pair("twist free of bending / deg", "sigma", &|t| {
                format_rounded(t.twist_deg, t.sigma_twist_deg, 2)
            }),
        ])
        .text()
}

fn unused_marker_text(record: &ImageRecord) -> String {
    let sentence = |m: &MarkerRecord| {
        let reason = m
            .reason
            .as_deref()
            .unwrap_or("no reason is recorded")
            .trim_end_matches('.');
        format!("{}: {reason}.\n", m.id)
    };
    record
        .markers
        .iter()
        .filter(|m| !m.used)
        .map(sentence)
        .collect()
}

fn detection_table(record: &ImageRecord) -> Grid {
    Grid::for_rows(&record.markers).columns(&[
        One("<marker", &|m| m.id.clone()),
        One("u / px", &|m| format_fixed(m.u_px, 2)),
        One("v / px", &|m| format_fixed(m.v_px, 2)),
        One("<remark", &|m| m.reason.clone().unwrap_or_default()),
    ])
}

/// Lists the inputs of the result, one line each.
fn provenance_text(record: &ImageRecord) -> String {
    let quality = Quality {
        iterations: None,
        pitch_bending_correlation: None,
        correlation: None,
        variance_components: vec![],
        ..record.quality.clone()
    };
    let lines = |fields: Map<String, Value>| -> String {
        fields
            .iter()
            .map(|(key, value)| format!("{key}: {}\n", json_text(value)))
            .collect()
    };
    lines(json_fields(&quality)) + &lines(json_fields(&record.provenance))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::sample;
    use super::*;
    use crate::record::Provenance;

    fn full() -> ImageRecord {
        let mut record = sample::record("f01.jpg", 2.93);
        record.provenance = Provenance {
            program: Some("wingd 1".into()),
            parameters: Some(Parameters {
                curvature_terms: Some(8),
                ..Parameters::default()
            }),
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
    fn the_protocol_contains_every_required_statement() {
        let text = adjustment_protocol(&full());
        for expected in [
            "Variance factor 0.970 with redundancy 33; limit 1.66",
            "Verdict passed",
            "a_per_m",
            "Strong: curvature[0] with pitch: -0.950",
            "Mounting pitch with bending amplitude: -0.981",
            "image",
            "1.100",
            "critical above 3.29 (level 0.1000 %)",
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
        let text = adjustment_protocol(&record);
        assert!(
            text.contains("Verdict rejected") && text.contains("a posteriori"),
            "{text}"
        );
    }

    #[test]
    fn an_uncontrolled_marker_is_named() {
        let mut record = full();
        record.markers[1].redundancy_u = Some(0.02);
        record.markers[1].redundancy_v = Some(0.01);
        assert!(adjustment_protocol(&record).contains("Hardly checked by other markers: M02."));
    }

    #[test]
    fn a_failed_image_has_a_remedy_and_nothing_else() {
        let text = adjustment_protocol(&sample::failed(
            "f02.jpg",
            "the file is cut short; copy it again",
        ));
        assert!(text.contains("Not solved: the file is cut short; copy it again"));
        assert!(!text.contains("Verdict"));
    }

    #[test]
    fn damaged_quality_is_omitted() {
        let mut record = full();
        let odd = json!({ "correlation": { "parameters": ["a"], "matrix": [[1.0, null]] } });
        record.quality = serde_json::from_value(odd).unwrap();
        let text = adjustment_protocol(&record);
        assert!(!text.contains("Correlations") && !text.contains("Variance components"));
    }
}
