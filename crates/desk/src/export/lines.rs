//! Export of shots as JSON objects, each with time, aircraft data and full record.

use std::io::{self, Write};

use serde_json::json;

use super::columns::time_text;
use wingd_base::clock::is_known_time;
use wingd_evaluation::quantities::SCHEMA_VERSION;
use wingd_evaluation::results::SeriesData;

/// Writes the shots of a series, including those without a frame or result (`record` is `null`).
pub fn write_json_lines(
    output: &mut dyn Write,
    series: &SeriesData,
    store_id: Option<&str>,
) -> io::Result<()> {
    for shot in &series.shots {
        let record = series.record_for_shot(shot);
        let stamp = shot.stamp.as_ref();
        let mut exposure = json!(shot.exposure);
        if let (Some(known), Some(time)) = (&shot.exposure, exposure.get_mut("exposure_time")) {
            *time = json!(known_time_text(known.exposure_time));
        }
        let line = json!({
            "schema_version": SCHEMA_VERSION,
            "result_id": format!("{}/{}", series.name, shot.number),
            "recorder_id": store_id,
            "flight": series.flight,
            "series": series.name,
            "shot": shot.number,
            "image": shot.image,
            "image_sha256": shot.sha256,
            "utc": stamp.and_then(|s| known_time_text(s.utc)),
            "utc_synchronised": stamp.map(|s| s.utc_synchronised),
            "boot_id": stamp.map(|s| &s.boot_id),
            "since_boot_s": stamp.map(|s| s.since_boot_s),
            "exposure": exposure,
            "aircraft": shot.aircraft,
            "camera_failures": shot.failures,
            "inputs": record.and(series.inputs.as_ref()),
            "record": record,
        });
        serde_json::to_writer(&mut *output, &line)?;
        output.write_all(b"\n")?;
    }
    Ok(())
}

/// Formats a time; `None` if it is not known.
fn known_time_text(time: jiff::Timestamp) -> Option<String> {
    is_known_time(time).then(|| time_text(time))
}
