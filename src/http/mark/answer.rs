//! A picture's state as the page gets it.

use serde_json::{Value, json};

use super::{Open, Workplace};
use crate::installation::ManualObservation;
use crate::measure::raster::Raster;
use crate::pipeline::manual_observations::{observation, rows};
use crate::pipeline::marking::MarkingResult;
use crate::record::{ImageRecord, MarkerRecord};
use crate::store::manual_marks::{ManualMark, MarkAction};

/// Markers with what is known of each, where lost ones should be, what is solved with the marks and without.
pub(super) fn state(workplace: &Workplace, open: &Open) -> Value {
    let Workplace { installation, pictures, kept, .. } = workplace;
    let image = pictures.get(open.number).map_or("", |p| p.name.as_str());
    let marks = kept.of(image);
    let said: Vec<ManualObservation> =
        marks.iter().filter_map(|mark| observation(mark, &installation.setup)).collect();
    let now = open.desk.solve(&said, installation);
    let raster = open.desk.raster();
    let markers = now.record.markers.iter().enumerate();
    let markers: Vec<Value> =
        markers.map(|(k, line)| marker(k, line, &now, marks.iter().find(|m| m.id == line.id))).collect();
    json!({
        "number": open.number,
        "image": image,
        "width": raster.width(),
        "height": raster.height(),
        "now": result(&now.record),
        "bare": result(&open.bare.record),
        "change_m": change(&now.record, &open.bare.record),
        "marks": marks.len(),
        "markers": markers,
    })
}

fn marker(index: usize, line: &MarkerRecord, now: &MarkingResult, mark: Option<&ManualMark>) -> Value {
    let seen = now.observations.iter().find(|o| o.marker == index);
    let state = match mark.map(|mark| &mark.act) {
        Some(MarkAction::Place(_)) => "manual",
        Some(MarkAction::Reject) => "rejected",
        _ if seen.is_some() => "detected",
        _ => "lost",
    };
    let foretold = now.predicted.iter().find(|f| f.marker == index).map(|f| {
        json!({
            "u_px": f.point_px.x, "v_px": f.point_px.y,
            "outline": {
                "u_px": f.prediction.centre_px.x, "v_px": f.prediction.centre_px.y,
                "semi_major_px": f.prediction.semi_major_px, "semi_minor_px": f.prediction.semi_minor_px,
                "angle_rad": f.prediction.angle_rad,
            },
        })
    });
    let covariance = seen.map(|o| rows(&o.covariance_px2));
    json!({
        "id": line.id,
        "shape": line.shape,
        "state": state,
        "used": line.used,
        "reason": line.reason,
        "u_px": seen.map(|o| o.pixel.x),
        "v_px": seen.map(|o| o.pixel.y),
        "covariance_px2": covariance,
        "residual_u_px": line.residual_u_px,
        "residual_v_px": line.residual_v_px,
        "foretold": foretold,
        "mark": mark,
    })
}

fn result(record: &ImageRecord) -> Value {
    let tip = record.tip.as_ref();
    let shown = tip.map(|tip| tip.reference.unwrap_or_default());
    let deflection = tip.zip(shown).and_then(|(tip, shown)| tip.deflection(shown));
    json!({
        "status": record.status,
        "reason": record.reason,
        "tip": tip.map(|tip| tip.marker.as_str()),
        "reference": shown.map(|shown| shown.words()),
        "deflection_m": deflection.map(|deflection| deflection.0),
        "sigma_deflection_m": deflection.and_then(|deflection| deflection.1),
        "deflection_survey_m": tip.map(|tip| tip.deflection_m),
        "sigma_deflection_survey_m": tip.and_then(|tip| tip.sigma_deflection_m),
        "used": record.used(),
        "variance_factor": record.variance_factor,
        "global_test": record.global_test,
        "remarks": record.remarks,
    })
}

/// How much higher the marks put the tip, m: of the same marker, counted from the same place.
fn change(now: &ImageRecord, bare: &ImageRecord) -> Option<f64> {
    let tip = now.tip.as_ref()?;
    let of = |record: &ImageRecord| {
        let line = record.markers.iter().find(|m| m.id == tip.marker)?;
        line.deflection(tip.reference.unwrap_or_default()).0
    };
    Some(of(now)? - of(bare)?)
}

/// A grey picture as PNG.
pub(super) fn png(raster: &Raster) -> Option<Vec<u8>> {
    use image::ImageEncoder;
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let size = (u32::try_from(raster.width()).ok()?, u32::try_from(raster.height()).ok()?);
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Up);
    encoder.write_image(raster.luma(), size.0, size.1, image::ExtendedColorType::L8).ok()?;
    Some(bytes)
}
