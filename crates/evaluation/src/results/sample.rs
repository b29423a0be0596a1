//! Small synthetic series for the tests of this folder.

use jiff::{SignedDuration, Timestamp};

use super::{SeriesData, ShotData};
use crate::record::{
    CurveRecord, ImageRecord, IncidenceRecord, MarkerRecord, Model, Provenance, RecordStatus, Tip,
    TorsionRecord,
};
use wingd_base::clock::Stamp;
use wingd_measure::adjust::AdjustmentMethod;
use wingd_measure::estimation::quality::{GlobalTest, SigmaKind};
use wingd_measure::observation::Estimate;
use wingd_measure::setup::Shape;

/// Returns the record of a solved image of a wing along +y with four markers, the last one hidden.
pub fn record(image: &str, tip_deflection_m: f64) -> ImageRecord {
    let markers = (1..=4).map(|i| marker(i, tip_deflection_m)).collect();
    let a_per_m = Some(Estimate {
        value: 0.00219,
        sigma: Some(5.9e-6),
    });
    ImageRecord {
        image: image.to_owned(),
        status: RecordStatus::Ok,
        method: Some(AdjustmentMethod::Spatial),
        variance_factor: Some(0.97),
        redundancy: Some(33),
        global_test: Some(GlobalTest::Passed),
        sigma_kind: Some(SigmaKind::Prior),
        model: Model {
            a_per_m,
            ..Model::default()
        },
        tip: Some(Tip {
            marker: "M03".to_owned(),
            deflection_m: tip_deflection_m,
            sigma_deflection_m: Some(0.006),
            ..Tip::default()
        }),
        markers,
        torsion: vec![TorsionRecord {
            name: "tip".to_owned(),
            angle_deg: Some(6.3),
            sigma_deg: Some(0.2),
            twist_deg: Some(2.7),
            sigma_twist_deg: Some(0.2),
            incidence: IncidenceRecord::default(),
        }],
        curve: (0..=12)
            .map(|i| curve_point(f64::from(i) * 3.0, tip_deflection_m))
            .collect(),
        provenance: Provenance {
            program: Some("wingd 0.1.0".into()),
            ..Provenance::default()
        },
        ..ImageRecord::default()
    }
}

fn curve_point(span_m: f64, tip_deflection_m: f64) -> CurveRecord {
    let share = (span_m / 36.0).powi(2);
    CurveRecord {
        arc_length_m: span_m,
        span_m,
        deflection_m: tip_deflection_m * share,
        sigma_deflection_m: Some(0.006 * share),
        twist_deg: Some(2.7 * share),
        sigma_twist_deg: Some(0.2 * share),
        ..CurveRecord::default()
    }
}

fn marker(number: u32, tip_deflection_m: f64) -> MarkerRecord {
    let span_m = f64::from(number) * 12.0;
    let hidden = number == 4;
    let deflection_m = tip_deflection_m * (span_m / 36.0).powi(2);
    let some = |v: f64| (!hidden).then_some(v);
    MarkerRecord {
        id: format!("M0{number}"),
        shape: if number < 2 {
            Shape::Quadrant
        } else {
            Shape::Circle
        },
        u_px: some(2000.0 + span_m),
        v_px: some(1500.0 - 10.0 * deflection_m),
        sigma_u_px: some(0.03),
        sigma_v_px: some(0.02),
        used: !hidden,
        reason: hidden.then(|| "hidden by glare".to_owned()),
        residual_u_px: some(0.01),
        residual_v_px: some(-0.02),
        redundancy_u: some(0.6),
        redundancy_v: some(0.4),
        w_test: some(0.8),
        mdb_u_px: some(0.2),
        mdb_v_px: some(0.2),
        distance_m: some(span_m + 2.0),
        sigma_distance_m: some(0.004),
        position_m: (!hidden).then_some([1.0, span_m, 3.0 + deflection_m]),
        sigma_position_m: (!hidden).then_some([0.002, 0.004, 0.006]),
        deflection_m: some(deflection_m),
        sigma_deflection_m: some(0.006),
        ..MarkerRecord::default()
    }
}

/// Returns the record of an image without a solution.
pub fn failed(image: &str, reason: &str) -> ImageRecord {
    let (method, provenance) = (
        Some(AdjustmentMethod::Spatial),
        record(image, 0.0).provenance,
    );
    ImageRecord {
        method,
        provenance,
        ..ImageRecord::failed(image, reason)
    }
}

/// Returns a series that began `after_s` seconds after the first one, with one shot per deflection.
pub fn series(name: &str, after_s: i64, deflections_m: &[f64]) -> SeriesData {
    let image = |i: usize| format!("{name}-{i:02}.jpg");
    let shot = |i: usize| ShotData {
        image: Some(image(i)),
        number: i as u32 + 1,
        stamp: Some(stamp(after_s + 2 * i as i64)),
        sha256: Some("ab".repeat(32)),
        ..ShotData::default()
    };
    SeriesData {
        flight: "flight-0001".to_owned(),
        name: name.to_owned(),
        begun: Some(stamp(after_s)),
        planned: deflections_m.len(),
        records: deflections_m
            .iter()
            .enumerate()
            .map(|(i, l)| record(&image(i), *l))
            .collect(),
        shots: (0..deflections_m.len()).map(shot).collect(),
        ..SeriesData::default()
    }
}

fn stamp(after_s: i64) -> Stamp {
    Stamp {
        utc: Timestamp::UNIX_EPOCH + SignedDuration::from_secs(1_790_000_000 + after_s),
        utc_synchronised: true,
        boot_id: "boot".to_owned(),
        since_boot_s: 100.0 + after_s as f64,
    }
}
