//! Ranges of the numbers of `installation.toml`, by key.

use std::path::Path;

use toml::{Table, Value};

use super::Reader;
use super::tables::InstallationDocument;
use wingd_measure::setup::Width;

/// Key, smallest and largest value, and unit.
type KeyRange = (&'static str, f64, f64, &'static str);

/// Ranges of all numbers but the widths, whose registry has theirs. A key of an array of tables is one of each table.
const KEY_RANGES: [KeyRange; 37] = [
    ("camera.projection_centre_m", -1e6, 1e6, "m"),
    ("camera.projection_centre_sigma_m", 0.0, 1.0, "m"),
    ("camera.mount_repeatability_px", 0.0, 1000.0, "px"),
    ("camera.optics.focal_length_mm", 0.1, 5000.0, "mm"),
    ("camera.optics.f_number", 0.5, 128.0, ""),
    ("camera.optics.pixel_pitch_um", 0.1, 100.0, "um"),
    ("camera.optics.circle_of_confusion_um", 0.1, 1000.0, "um"),
    ("wing.root_offset_m", -50.0, 50.0, "m"),
    ("wing.axis_chord_offset_m", -20.0, 20.0, "m"),
    ("wing.skin_height_m.root", -5.0, 5.0, "m"),
    ("wing.skin_height_m.tip", -5.0, 5.0, "m"),
    ("wing.skin_height_m.tip_span_m", 0.1, 200.0, "m"),
    ("wing.breaks.span_m", -50.0, 200.0, "m"),
    ("wing.breaks.sweep_deg", -30.0, 30.0, "degrees"),
    ("wing.vibration.frequency_hz", 0.0, 1000.0, "Hz"),
    ("wing.vibration.amplitude_m", 0.0, 5.0, "m"),
    ("thermal.expansion_per_k", -1e-3, 1e-3, "1/K"),
    ("thermal.expansion_sigma_per_k", 0.0, 1e-3, "1/K"),
    ("thermal.ground_temperature_c", -100.0, 100.0, "C"),
    ("thermal.flight_temperature_c", -100.0, 100.0, "C"),
    ("thermal.sigma_k", 0.0, 100.0, "K"),
    ("window.wavelength_nm", 300.0, 1700.0, "nm"),
    ("window.thickness_m", 1e-3, 0.1, "m"),
    ("window.thickness_sigma_m", 0.0, 0.02, "m"),
    ("window.index", 1.2, 2.5, ""),
    ("window.index_sigma", 0.0, 0.2, ""),
    ("window.normal_sigma_deg", 0.0, 20.0, "degrees"),
    ("window.bow_sigma", 0.0, 1.0, ""),
    ("window.distance_m", 0.0, 2.0, "m"),
    ("window.cabin.temperature_c", -100.0, 100.0, "C"),
    ("window.cabin.pressure_hpa", 10.0, 1200.0, "hPa"),
    ("window.cabin.humidity", 0.0, 1.0, ""),
    ("window.cabin.co2_ppm", 0.0, 20_000.0, "ppm"),
    ("window.outside.temperature_c", -100.0, 100.0, "C"),
    ("window.outside.pressure_hpa", 10.0, 1200.0, "hPa"),
    ("window.outside.humidity", 0.0, 1.0, ""),
    ("window.outside.co2_ppm", 0.0, 20_000.0, "ppm"),
];

/// Reports the numbers outside their ranges, except those of the `blank` keys.
pub(super) fn check_ranges(
    reader: &mut Reader,
    file: &Path,
    document: &InstallationDocument,
    blank: &[&str],
) {
    // A document that was read can be written.
    let document = Value::try_from(document).unwrap_or_else(|_| Table::new().into());
    let mut check = |key: &str, low: f64, high: f64, unit: &str| {
        for value in numbers_at(&document, key) {
            if !blank.contains(&key) {
                reader.check_range(file, key, value, low..=high, unit);
            }
        }
    };
    for (key, low, high, unit) in KEY_RANGES {
        check(key, low, high, unit);
    }
    for row in Width::ROWS {
        let key = format!("{}.{}", row.section, row.key);
        check(&key, 0.0, row.max, row.unit.name);
    }
}

/// Returns the numbers at a key, of arrays all.
fn numbers_at(value: &Value, key: &str) -> Vec<f64> {
    let (first, rest) = key.split_once('.').unwrap_or((key, ""));
    match value {
        Value::Array(all) => all.iter().flat_map(|one| numbers_at(one, key)).collect(),
        Value::Table(table) => table.get(first).map_or(vec![], |one| numbers_at(one, rest)),
        Value::Float(number) => vec![*number],
        Value::Integer(number) => vec![*number as f64],
        _ => vec![],
    }
}
