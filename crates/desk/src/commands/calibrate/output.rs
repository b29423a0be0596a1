//! Texts and JSON of `wingd calibrate`.

use std::path::Path;

use serde_json::{Map, Value, json};

use crate::calibration::{BoardImage, exclusion_reason};
use crate::report::calibration::{FIRST_DISTORTION, SIGNIFICANT_RATIO, parameter_values};
use wingd_evaluation::installation::CalibrationReport;
use wingd_evaluation::number::format_rounded;
use wingd_evaluation::record::json_fields;
use wingd_measure::calibrate::Calibration;
use wingd_measure::calibrate::Verdict;
use wingd_measure::geometry::Lens;

const DENOMINATOR_NAMES: [&str; 3] = ["k4", "k5", "k6"];

/// Returns the verdict, the parameters with their standard deviations, the images and the quality as JSON.
pub(super) fn result_json(
    calibration: &Calibration,
    report: &CalibrationReport,
    reasons: &[String],
    pictures: &[BoardImage],
) -> Map<String, Value> {
    let values = parameter_values(calibration).map(Value::from);
    let names = Lens::PARAMETERS.map(str::to_owned);
    let mut parameters: Map<String, Value> = names.into_iter().zip(values).collect();
    let sigmas = report.sigma.map(Value::from);
    let mut sigma: Map<String, Value> = parameters.keys().cloned().zip(sigmas).collect();
    let rational = calibration.lens.denominator != [0.0; 3];
    if rational {
        for (k, name) in DENOMINATOR_NAMES.iter().enumerate() {
            parameters.insert((*name).into(), calibration.lens.denominator[k].into());
            sigma.insert((*name).into(), calibration.denominator_sigma[k].into());
        }
    }
    let image = |(k, p): (usize, &BoardImage)| {
        json!({
            "image": p.name,
            "used": calibration.view_rms_px[k].is_some(),
            "reason": exclusion_reason(calibration, k, p),
            "corners": p.view.as_ref().map_or(0, Vec::len),
            "corners_used": calibration.view_points[k],
            "rms_px": calibration.view_rms_px[k],
            "tilt_deg": calibration.tilt_deg[k],
        })
    };
    let is_refused = report.verdict == Verdict::Refused.name() && report.accepted.is_none();
    let mut all = json_fields(&json!({ "status": if is_refused { "refused" } else { "ok" } }));
    all.extend(json_fields(report));
    all.extend(json_fields(&json!({
        "reasons": reasons,
        "model": if rational { "rational" } else { "brown" },
        "parameters": parameters,
        "sigma": sigma,
        "images": pictures.iter().enumerate().map(image).collect::<Vec<_>>(),
    })));
    all
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
