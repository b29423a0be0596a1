//! Texts and JSON of `wingd calibrate`.

use std::path::Path;

use crate::calibration::{BoardImage, exclusion_reason};
use crate::report::calibration::{
    FIRST_DISTORTION, SIGNIFICANT_RATIO, parameter_correlation, parameter_values,
};
use wingd_evaluation::installation::CalibrationReport;
use wingd_evaluation::number::format_rounded;
use wingd_measure::calibrate::Calibration;
use wingd_measure::calibrate::Verdict;
use wingd_measure::geometry::Lens;

const DENOMINATOR_NAMES: [&str; 3] = ["k4", "k5", "k6"];

pub(super) fn result_json(
    calibration: &Calibration,
    report: &CalibrationReport,
    reasons: &[String],
    pictures: &[BoardImage],
) -> String {
    let by_name = |values: [Option<f64>; 9]| -> serde_json::Map<String, serde_json::Value> {
        Lens::PARAMETERS
            .iter()
            .zip(values)
            .map(|(n, v)| ((*n).to_owned(), v.into()))
            .collect()
    };
    let parameters = parameter_values(calibration).map(Some);
    let mut camera = serde_json::Map::new();
    camera.insert("width".into(), calibration.lens.width.into());
    camera.insert("height".into(), calibration.lens.height.into());
    camera.extend(by_name(parameters));
    let rational = calibration.lens.denominator != [0.0; 3];
    let denominator = |values: [f64; 3]| -> serde_json::Map<String, serde_json::Value> {
        DENOMINATOR_NAMES
            .iter()
            .zip(values)
            .map(|(n, v)| ((*n).to_owned(), v.into()))
            .collect()
    };
    let mut parameters = by_name(parameters);
    let mut sigma = by_name(report.sigma);
    if rational {
        camera.extend(denominator(calibration.lens.denominator));
        parameters.extend(denominator(calibration.lens.denominator));
        sigma.extend(denominator(calibration.denominator_sigma));
    }
    let image = |(k, p): (usize, &BoardImage)| {
        serde_json::json!({
            "image": p.name,
            "used": calibration.view_rms_px[k].is_some(),
            "reason": exclusion_reason(calibration, k, p),
            "corners": p.view.as_ref().map_or(0, Vec::len),
            "corners_used": calibration.view_points[k],
            "rms_px": calibration.view_rms_px[k],
            "tilt_deg": calibration.tilt_deg[k],
        })
    };
    let images: Vec<_> = pictures.iter().enumerate().map(image).collect();
    serde_json::json!({
        "status": if report.verdict == Verdict::Refused.name() && report.accepted.is_none() { "refused" } else { "ok" },
        "verdict": report.verdict,
        "reasons": reasons,
        "parameters": parameters,
        "sigma": sigma,
        "model": if rational { "rational" } else { "brown" },
        "t_values": by_name(std::array::from_fn(|k| t_value(calibration, report, k))),
        "correlation": (0..9).map(|i| (0..9).map(|j| parameter_correlation(calibration, i, j)).collect::<Vec<_>>()).collect::<Vec<_>>(),
        "halves": calibration.halves.map(|h| serde_json::json!({
            "distance_m": h.distance_m, "difference_px": h.difference_px, "predicted_px": h.predicted_px,
        })),
        "pattern": { "image_px": calibration.pattern.image_px, "board_px": calibration.pattern.board_px },
        "model_sigma_px": calibration.model_sigma_px,
        "board_bow_m": report.board_bow_m,
        "board_bow_sigma_m": report.board_bow_sigma_m,
        "board_stretch": calibration.stretch.map(|s| serde_json::json!({
            "value": s.value, "sigma": s.sigma, "projection_px": s.projection_change_px, "stated_sigma": s.prior_sigma,
        })),
        "projection_sigma_px": report.projection_sigma_px,
        "camera": camera,
        "calibration": report,
        "images": images,
    })
    .to_string()
}

/// Returns a distortion term divided by its standard deviation.
fn t_value(calibration: &Calibration, report: &CalibrationReport, k: usize) -> Option<f64> {
    report.sigma[k]
        .filter(|s| k >= FIRST_DISTORTION && *s > 0.0)
        .map(|s| parameter_values(calibration)[k] / s)
}

pub(super) fn result_text(
    output: &Path,
    calibration: &Calibration,
    report: &CalibrationReport,
) -> String {
    let mut text = format!(
        "{}: {}\n{} of {} images, {} points, rms {:.4} px\n",
        output.display(),
        report.verdict,
        report.images_used,
        report.images_used + report.images_rejected,
        report.observations,
        report.rms_px
    );
    for (k, ((name, value), sigma)) in Lens::PARAMETERS
        .iter()
        .zip(parameter_values(calibration))
        .zip(report.sigma)
        .enumerate()
    {
        let digits = if k < FIRST_DISTORTION { 3 } else { 6 };
        let weak = t_value(calibration, report, k).is_some_and(|t| t.abs() < SIGNIFICANT_RATIO);
        let sigma = sigma.map_or("fixed".to_owned(), |s| format!("+- {s:.digits$}"));
        let note = if weak { " (not significant)" } else { "" };
        text.push_str(&format!("{name:>3} {value:>12.digits$} {sigma}{note}\n"));
    }
    if calibration.lens.denominator != [0.0; 3] {
        let of = calibration
            .lens
            .denominator
            .iter()
            .zip(calibration.denominator_sigma);
        for (name, (value, sigma)) in DENOMINATOR_NAMES.iter().zip(of) {
            text.push_str(&format!(
                "{name:>3} {value:>12.6} +- {sigma:.6} (denominator: a rational lens)\n"
            ));
        }
    }
    for (name, bow) in ["along", "across"].iter().zip(calibration.bow) {
        let flat = if bow.is_significant() {
            ""
        } else {
            " (not significant)"
        };
        let (value, sigma) = format_rounded(Some(1e3 * bow.value_m), Some(1e3 * bow.sigma_m), 3);
        text.push_str(&format!("board's bow {name} {value} +- {sigma} mm{flat}\n"));
    }
    if let Some(s) = calibration.stretch.filter(|s| s.prior_sigma.is_some()) {
        let note = if s.is_significant() {
            ""
        } else {
            " (not significant)"
        };
        text.push_str(&format!(
            "board's stretch across over along {:.4} +- {:.4} %{note}\n",
            1e2 * s.value,
            1e2 * s.sigma
        ));
    }
    for p in calibration.projections.iter().flatten() {
        let (distance, sigma) = (p.distance_m, p.sigma_px);
        text.push_str(&format!(
            "projection at {distance} m +- {sigma:.3} px (rms over the image)\n"
        ));
    }
    if let Some(h) = calibration.halves {
        let (difference, predicted, at) = (h.difference_px, h.predicted_px, h.distance_m);
        text.push_str(&format!(
            "halves differ by {difference:.3} px at {at} m, predicted {predicted:.3} px\n"
        ));
    }
    text.trim_end().to_owned()
}
