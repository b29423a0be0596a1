//! Prometheus metrics of the status (text exposition format 0.0.4).

use std::fmt::Write as _;

use serde_json::Value;

use super::DaemonStatus;

/// Table of the metrics: name, JSON pointer of the status, factor or words, help.
const METRICS: &str = include_str!("metrics.csv");

/// Returns the metrics of the status as Prometheus text. A metric without a value is omitted.
pub fn prometheus_text(status: &DaemonStatus) -> String {
    let status = serde_json::to_value(status).unwrap_or_default();
    let mut text = String::new();
    for [name, field, scale, help] in metric_rows() {
        let value = status.pointer(field);
        if let Some(value) = value.and_then(|value| metric_value(value, scale)) {
            let is_counter = name.ends_with("_total");
            let kind = if is_counter { "counter" } else { "gauge" };
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "# HELP wingd_{name} {help}\n# TYPE wingd_{name} {kind}\nwingd_{name} {value}"
            );
        }
    }
    text
}

fn metric_rows() -> impl Iterator<Item = [&'static str; 4]> {
    METRICS.lines().skip(1).map(|line| {
        let mut cells = line.splitn(4, ';');
        std::array::from_fn(|_| cells.next().unwrap_or_default())
    })
}

/// Number of a field: a number times the factor, 0 or 1, the length of a list, or the place of a word among `words`, 0 if it
/// is none of them.
fn metric_value(field: &Value, factor_or_words: &str) -> Option<f64> {
    let place = |word: &str| factor_or_words.split('|').position(|other| other == word);
    match field {
        Value::Bool(yes) => Some(f64::from(u8::from(*yes))),
        Value::Array(all) => Some(all.len() as f64),
        Value::Object(all) => Some(all.len() as f64),
        Value::String(word) => Some(place(word).unwrap_or(0) as f64),
        Value::Null => place("null").map(|at| at as f64),
        Value::Number(number) => Some(number.as_f64()? * factor_or_words.parse().unwrap_or(1.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_names_a_field_once_and_has_help() {
        let mut status = DaemonStatus {
            aircraft: Some(Default::default()),
            live: Some(Default::default()),
            ..Default::default()
        };
        let json = serde_json::to_value(&status).unwrap();
        for [name, field, _, help] in metric_rows() {
            assert!(json.pointer(field).is_some() && !help.is_empty(), "{name}");
        }
        let mut names: Vec<_> = metric_rows().map(|[name, ..]| name).collect();
        let rows = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), rows);

        status.counts.frames = 7;
        status.store.reserve_mb = 2;
        let text = prometheus_text(&status);
        assert!(text.contains("# TYPE wingd_frames_total counter\nwingd_frames_total 7\n"));
        for line in ["healthy 1", "health 0", "capturing 0", "live_healthy 1"] {
            assert!(text.contains(&format!("\nwingd_{line}\n")), "{line}");
        }
        assert!(text.contains("\nwingd_store_reserve_bytes 2000000\n"));
        assert!(!text.contains("last_frame_age"), "no frame, no age");
        status.live = None;
        assert!(!prometheus_text(&status).contains("_live_"));
    }
}
