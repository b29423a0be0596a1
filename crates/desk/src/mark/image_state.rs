//! State of an image, as JSON for the marking page.

use serde_json::{Value, json};

use super::{OpenImage, Workplace};
use wingd_evaluation::installation::ManualObservation;
use wingd_evaluation::pipeline::manual_observations::{covariance_rows, observation_from_mark};
use wingd_evaluation::pipeline::marking::MarkingResult;
use wingd_evaluation::record::{ImageRecord, MarkerRecord};
use wingd_measure::raster::Raster;
use wingd_store::manual_marks::{ManualMark, MarkAction};

/// Returns the state of an image: markers, predicted positions of lost ones, and the solutions with and without manual
/// marks.
pub(super) fn image_state(workplace: &Workplace, open: &OpenImage) -> Value {
    let Workplace {
        installation,
        images,
        storage,
        ..
    } = workplace;
    let image = images.get(open.number).map_or("", |p| p.name.as_str());
    let marks = storage.image_marks(image);
    let manual: Vec<ManualObservation> = marks
        .iter()
        .filter_map(|mark| observation_from_mark(mark, &installation.setup))
        .collect();
    let now = open.session.solve(&manual, installation);
    let raster = open.session.raster();
    let markers = now.record.markers.iter().enumerate();
    let markers: Vec<Value> = markers
        .map(|(k, line)| marker_state_json(k, line, &now, marks.iter().find(|m| m.id == line.id)))
        .collect();
    json!({
        "number": open.number,
        "image": image,
        "width": raster.width(),
        "height": raster.height(),
        "now": result_summary_json(&now.record),
        "bare": result_summary_json(&open.unmarked.record),
        "change_m": deflection_change(&now.record, &open.unmarked.record),
        "marks": marks.len(),
        "markers": markers,
    })
}

fn marker_state_json(
    index: usize,
    line: &MarkerRecord,
    now: &MarkingResult,
    mark: Option<&ManualMark>,
) -> Value {
    let observed = now.observations.iter().find(|o| o.marker == index);
    let state = match mark.map(|mark| &mark.act) {
        Some(MarkAction::Place(_)) => "manual",
        Some(MarkAction::Reject) => "rejected",
        _ if observed.is_some() => "detected",
        _ => "lost",
    };
    let predicted = now.predicted.iter().find(|f| f.marker == index).map(|f| {
        json!({
            "u_px": f.point_px.x, "v_px": f.point_px.y,
            "outline": {
                "u_px": f.prediction.centre_px.x, "v_px": f.prediction.centre_px.y,
                "semi_major_px": f.prediction.semi_major_px, "semi_minor_px": f.prediction.semi_minor_px,
                "angle_rad": f.prediction.angle_rad,
            },
        })
    });
    let covariance = observed.map(|o| covariance_rows(&o.covariance_px2));
    json!({
        "id": line.id,
        "shape": line.shape,
        "state": state,
        "used": line.used,
        "reason": line.reason,
        "u_px": observed.map(|o| o.pixel.x),
        "v_px": observed.map(|o| o.pixel.y),
        "covariance_px2": covariance,
        "residual_u_px": line.residual_u_px,
        "residual_v_px": line.residual_v_px,
        "predicted": predicted,
        "mark": mark,
    })
}

fn result_summary_json(record: &ImageRecord) -> Value {
    let tip = record.tip.as_ref();
    let reference = tip.map(|tip| tip.reference.unwrap_or_default());
    let deflection = tip
        .zip(reference)
        .and_then(|(tip, reference)| tip.deflection(reference));
    json!({
        "status": record.status,
        "reason": record.reason,
        "tip": tip.map(|tip| tip.marker.as_str()),
        "reference": reference.map(|reference| reference.description()),
        "deflection_m": deflection.map(|deflection| deflection.0),
        "sigma_deflection_m": deflection.and_then(|deflection| deflection.1),
        "deflection_survey_m": tip.map(|tip| tip.deflection_m),
        "sigma_deflection_survey_m": tip.and_then(|tip| tip.sigma_deflection_m),
        "used": record.used_count(),
        "variance_factor": record.variance_factor,
        "global_test": record.global_test,
        "remarks": record.remarks,
    })
}

/// Returns the change of the tip deflection due to the manual marks, m, for the same marker and reference.
fn deflection_change(now: &ImageRecord, unmarked: &ImageRecord) -> Option<f64> {
    let tip = now.tip.as_ref()?;
    let deflection = |record: &ImageRecord| {
        let line = record.markers.iter().find(|m| m.id == tip.marker)?;
        line.deflection(tip.reference.unwrap_or_default()).0
    };
    Some(deflection(now)? - deflection(unmarked)?)
}

/// Encodes a grey-level image as PNG.
pub(super) fn encode_png(raster: &Raster) -> Option<Vec<u8>> {
    use image::ImageEncoder;
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let size = (
        u32::try_from(raster.width()).ok()?,
        u32::try_from(raster.height()).ok()?,
    );
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Up);
    encoder
        .write_image(raster.luma(), size.0, size.1, image::ExtendedColorType::L8)
        .ok()?;
    Some(bytes)
}
