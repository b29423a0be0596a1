//! Conversion of a solution into a line of the results (docs/reference/results.md).

use std::collections::HashMap;

use nalgebra::Matrix3;

use super::correlation::correlation_record;
use super::curvature::moment_records;
pub use super::timing::{round_ms, stage_timing};
use super::{ProcessedFrame, SolveJob, provenance};
use crate::installation::{CAD_ALPHA, Installation};
use crate::record::{
    CadFit, CurveRecord, ImageRecord, IncidenceRecord, MarkerRecord, Model, Panes, Provenance,
    Quality, Reason, RecordStatus, Tip, TorsionRecord, json_fields,
};
use wingd_measure::adjust::{
    AdjustmentMethod, CurvePoint, MarkerSolution, PairTorsion, ParameterKind, Solution,
};
use wingd_measure::adjust::{Estimate, Observation};
use wingd_measure::environment::RefractionReport;
use wingd_measure::estimation::quality::{GlobalTest, SigmaKind};
use wingd_measure::geometry::Similarity;
use wingd_measure::identify::plausible_deflections_m;
use wingd_measure::setup::{Setup, SurveyMarker};

/// Builds the record of a processed frame and the outcome of its adjustment.
pub fn build_record(
    frame: &ProcessedFrame,
    installation: &Installation,
    job: &SolveJob,
    outcome: Result<(Solution, Option<RefractionReport>), Reason>,
) -> ImageRecord {
    let frame_sha256 = Some(frame.digest.clone()).filter(|digest| !digest.is_empty());
    let mut record = ImageRecord {
        image: frame.image.clone(),
        method: Some(job.method),
        markers: marker_records(frame, installation),
        provenance: Provenance {
            frame_sha256,
            ..provenance(installation, job)
        },
        timing_ms: stage_timing(&frame.stages),
        ..ImageRecord::default()
    };
    match outcome {
        Err(reason) => record.reason = Some(reason.to_string()),
        Ok((solution, refraction)) => {
            add_solution(&mut record, frame, installation, &solution);
            flag_manual(&mut record.markers, frame);
            let doubt = find_doubt(&record, frame, &installation.setup);
            if let Some(doubt) = doubt.or(solution.doubt.clone()) {
                (record.status, record.reason) = (RecordStatus::Doubtful, Some(doubt));
            }
            record.cause = solution.doubt;
            record.counted = !solution.counted_causes.is_empty();
            record.quality.aircraft = json_fields(&frame.aircraft);
            record.quality.refraction = refraction;
        }
    }
    record
}

/// Largest variance factor of a rejected result that may be used: standard deviations three times too small.
const MAX_VARIANCE_FACTOR: f64 = 10.0;

/// Returns why a rejected result is implausible; `None` if it may be used.
fn find_doubt(record: &ImageRecord, frame: &ProcessedFrame, setup: &Setup) -> Option<String> {
    let factor = record
        .variance_factor
        .filter(|_| record.global_test == Some(GlobalTest::Rejected))?;
    let (used, seen) = (record.used_count(), frame.observations.len());
    let visible = frame
        .identities
        .as_ref()
        .map_or(seen, |identities| identities.visible.max(seen));
    let deflection_m = record.tip.as_ref().map_or(0.0, |tip| tip.deflection_m);
    let [lowest_m, highest_m] = plausible_deflections_m(setup);
    // A parabola fits no real wing closely; its standard deviations are scaled by that.
    let is_rough = record.method == Some(AdjustmentMethod::Profile);
    let why = if factor > MAX_VARIANCE_FACTOR && !is_rough {
        format!("the variance factor is {factor:.0}")
    } else if 2 * used < visible {
        format!("only {used} of {visible} visible markers fit")
    } else if !(lowest_m..=highest_m).contains(&deflection_m) {
        format!("no wing of this span deflects by {deflection_m:.1} m")
    } else {
        return None;
    };
    Some(format!(
        "the result is rejected by its test and implausible: {why}"
    ))
}

/// Remark if no twist is given.
const SIDE_UNKNOWN: &str = "the direction of the nose is unknown, so no twist is given; set wing.side = \"left\" or \
     \"right\" in installation.toml, or name a [[torsion]] pair";

fn add_solution(
    record: &mut ImageRecord,
    frame: &ProcessedFrame,
    installation: &Installation,
    s: &Solution,
) {
    record.status = RecordStatus::Ok;
    record.variance_factor = s.variance_factor.filter(|v| v.is_finite());
    record.redundancy = Some(s.redundancy);
    record.global_test = s.global_test;
    record.sigma_kind = Some(if s.posterior {
        SigmaKind::Posterior
    } else {
        SigmaKind::Prior
    });
    record.model = model_record(s);
    let seen: HashMap<usize, &Observation> =
        frame.observations.iter().map(|o| (o.marker, o)).collect();
    let mut missing = missing_marker_reasons(frame);
    for m in &s.markers {
        if let (Some(line), Some(marker)) = (
            record.markers.get_mut(m.marker),
            installation.setup.markers.get(m.marker),
        ) {
            *line = solved_marker_record(
                marker,
                m,
                seen.get(&m.marker).copied(),
                missing.remove(&m.marker),
            );
            add_cad_position(line, m, installation);
            add_ground_reason(line, m.marker, installation);
        }
    }
    record.tip = tip_record(installation, s);
    let budget = s.budget.as_ref();
    record.budget = budget.map_or(vec![], |budget| budget.shares.clone());
    record.torsion = s.torsion.iter().map(torsion_record).collect();
    record.curve = s.curve.iter().map(curve_record).collect();
    record.moments = moment_records(installation, s);
    let turned = turned_mount(installation, s);
    let is_new = |text: &&String| turned.is_none() || !text.starts_with("camera.mount_repeat");
    record.remarks = s.remarks.iter().filter(is_new).cloned().collect();
    if installation.setup.side().is_none() && !s.curve.is_empty() {
        record.remarks.push(SIDE_UNKNOWN.into());
    }
    record.remarks.extend(turned);
    let accepted = [
        (&installation.accepted, "camera's calibration"),
        (&installation.accepted_orientation, "orientation"),
    ];
    for (reason, name) in accepted {
        let remark =
            |reason: &String| format!("the {name} was refused, but accepted by the user: {reason}");
        record.remarks.extend(reason.as_ref().map(remark));
    }
    record.quality = quality_record(installation, s);
}

/// Significant rotation of the camera, in standard deviations of the mounting: probability 1 in 3000.
const MAX_MOUNT_SIGMAS: f64 = 4.0;

/// Returns a remark if the camera is turned by more than the mounting's repeatability since the ground frames.
fn turned_mount(installation: &Installation, s: &Solution) -> Option<String> {
    let about = &s
        .parameters
        .iter()
        .find(|p| p.kind == ParameterKind::MountRotation)?
        .values;
    let turn = about.first()?.value.hypot(about.get(1)?.value);
    let setup = &installation.setup;
    let (shift_px, expected_px) = (turn * setup.lens.focal_px(), setup.mount_repeatability_px);
    (shift_px > MAX_MOUNT_SIGMAS * expected_px && expected_px > 0.0).then(|| {
        format!(
            "the camera is turned by {shift_px:.0} px relative to the ground frames, but mount_repeatability_px is \
             {expected_px}; take a ground frame with this mounting (`wingd orient`)"
        )
    })
}

/// Converts the model parameters; radians become degrees.
fn model_record(s: &Solution) -> Model {
    let of = |kind: ParameterKind, factor: f64| {
        let scaled = |e: &Estimate| Estimate {
            value: e.value * factor,
            sigma: e.sigma.map(|s| s * factor).filter(|s| s.is_finite()),
        };
        let found = s.parameters.iter().find(|p| p.kind == kind)?;
        Some(found.values.iter().map(scaled).collect::<Vec<_>>())
    };
    let one = |kind, factor| of(kind, factor)?.into_iter().next();
    let degrees = 180.0 / std::f64::consts::PI;
    Model {
        curvature_per_m: of(ParameterKind::Curvature, 1.0).unwrap_or_default(),
        twist_deg: of(ParameterKind::Twist, degrees),
        mount_rotation_deg: of(ParameterKind::MountRotation, degrees).unwrap_or_default(),
        a_per_m: one(ParameterKind::Parabola, 1.0),
        axis_raise_m: one(ParameterKind::AxisRaise, 1.0),
        shape_departure: one(ParameterKind::ShapeDeparture, 1.0),
        mount_drift_deg: one(ParameterKind::MountDrift, degrees),
    }
}

/// Appends the reason why a marker was not used in the ground frames.
fn add_ground_reason(line: &mut MarkerRecord, marker: usize, installation: &Installation) {
    let mut unused = installation.unused_on_ground.iter();
    let ground = unused.find(|(k, _)| *k == marker && !line.used);
    if let (Some((_, ground)), Some(reason)) = (ground, &mut line.reason) {
        *reason += &format!("; not used on the ground either: {ground}");
    }
}

fn missing_marker_reasons(frame: &ProcessedFrame) -> HashMap<usize, String> {
    let seen = frame.identities.iter().flat_map(|i| i.missing.clone());
    let manual = frame.manual.iter();
    let rejected = manual.filter_map(|(marker, rejection)| Some((*marker, rejection.clone()?)));
    seen.chain(rejected).collect()
}

/// Reason of a marker without a measurement.
const NOT_MEASURED: &str = "not measured in this frame";

/// Flags the markers whose positions were marked manually.
fn flag_manual(markers: &mut [MarkerRecord], frame: &ProcessedFrame) {
    for (marker, rejection) in &frame.manual {
        if let (None, Some(line)) = (rejection, markers.get_mut(*marker)) {
            line.manual = true;
        }
    }
}

/// Builds the records of all survey markers as not used, with their observations.
pub(super) fn marker_records(
    frame: &ProcessedFrame,
    installation: &Installation,
) -> Vec<MarkerRecord> {
    let mut markers = markers_of_unsolved_frame(frame, installation);
    flag_manual(&mut markers, frame);
    markers
}

/// Returns a record of every surveyed marker of a frame without a solution: its pixel if measured, and why it was not used.
fn markers_of_unsolved_frame(
    frame: &ProcessedFrame,
    installation: &Installation,
) -> Vec<MarkerRecord> {
    let missing = missing_marker_reasons(frame);
    let seen: HashMap<usize, &Observation> =
        frame.observations.iter().map(|o| (o.marker, o)).collect();
    let line = |(k, marker): (usize, &SurveyMarker)| {
        let reason = missing.get(&k).map_or(NOT_MEASURED, String::as_str);
        unsolved_marker_record(marker, seen.get(&k).copied(), Some(reason.into()))
    };
    installation
        .setup
        .markers
        .iter()
        .enumerate()
        .map(line)
        .collect()
}

fn unsolved_marker_record(
    marker: &SurveyMarker,
    seen: Option<&Observation>,
    reason: Option<String>,
) -> MarkerRecord {
    MarkerRecord {
        id: marker.id.clone(),
        shape: marker.shape,
        u_px: seen.map(|o| o.pixel.x),
        v_px: seen.map(|o| o.pixel.y),
        sigma_u_px: seen.map(|o| o.covariance_px2[(0, 0)].sqrt()),
        sigma_v_px: seen.map(|o| o.covariance_px2[(1, 1)].sqrt()),
        reason,
        ..MarkerRecord::default()
    }
}

fn solved_marker_record(
    marker: &SurveyMarker,
    m: &MarkerSolution,
    seen: Option<&Observation>,
    missing: Option<String>,
) -> MarkerRecord {
    let known = missing.or(m.reason.clone()).filter(|_| !m.used);
    let reason = known.or_else(|| (!m.used).then(|| NOT_MEASURED.into()));
    let residual = m.residual_px;
    let bias_px = m.minimal_detectable_bias_px;
    let detectable = |k: usize| bias_px.map(|b| b[k]).filter(|b| b.is_finite());
    MarkerRecord {
        used: m.used,
        predicted: !m.used && m.deflection_m.is_some(),
        residual_u_px: residual.map(|r| r.x),
        residual_v_px: residual.map(|r| r.y),
        redundancy_u: m.redundancy.map(|r| r.x),
        redundancy_v: m.redundancy.map(|r| r.y),
        w_test: m.w_test,
        mdb_u_px: detectable(0),
        mdb_v_px: detectable(1),
        distance_m: get_value(m.distance_m),
        sigma_distance_m: get_sigma(m.distance_m),
        position_m: m.position_m.map(Into::into),
        sigma_position_m: m.covariance_m2.as_ref().map(diagonal_sigmas),
        deflection_m: get_value(m.deflection_m),
        sigma_deflection_m: get_sigma(m.deflection_m),
        deflection_ground_m: get_value(m.deflection_ground_m),
        sigma_deflection_ground_m: get_sigma(m.deflection_ground_m),
        deflection_root_m: get_value(m.deflection_root_m),
        sigma_deflection_root_m: get_sigma(m.deflection_root_m),
        ..unsolved_marker_record(marker, seen, reason)
    }
}

/// Adds position and standard deviations in the CAD frame, if there is one.
fn add_cad_position(line: &mut MarkerRecord, m: &MarkerSolution, installation: &Installation) {
    let (Some(fit), Some(position), Some(covariance)) =
        (&installation.cad, m.position_m, m.covariance_m2)
    else {
        return;
    };
    let (position, covariance) = fit.apply_with_covariance(&position, &covariance);
    line.position_cad_m = Some(position.into());
    line.sigma_position_cad_m = Some(diagonal_sigmas(&covariance));
}

/// Returns the panes that the result allows for.
fn window_panes(installation: &Installation) -> Option<Panes> {
    let pane = installation.setup.window.as_ref()?.pane?;
    Some(Panes {
        thickness_m: pane.thickness_m,
        sigma_thickness_m: pane.thickness_sigma_m,
        index: pane.index,
        bow_radius_m: pane.bow_radius_m,
        same_on_ground: pane.same_on_ground,
    })
}

/// Returns the CAD transform with its quality, as written in every result.
pub fn cad_record(installation: &Installation) -> Option<CadFit> {
    let (fit, model) = (installation.cad.as_ref()?, installation.cad_model.as_ref()?);
    let verdict = |passed| {
        if passed {
            GlobalTest::Passed
        } else {
            GlobalTest::Rejected
        }
    };
    let Similarity {
        scale,
        rotation,
        translation_m: t,
    } = fit.transform;
    let matrix = nalgebra::Similarity::from_parts(t.into(), rotation, scale).to_homogeneous();
    Some(CadFit {
        variance_factor: fit.variance_factor,
        redundancy: fit.redundancy,
        global_test: fit.passes_test(CAD_ALPHA).map(verdict),
        scale,
        transform: matrix.transpose().into(),
        covariance: fit
            .covariance
            .row_iter()
            .map(|row| row.iter().copied().collect())
            .collect(),
        aft: installation.aft_direction().map(Into::into),
        tie_points: model.ids.clone(),
        residuals_m: fit.residuals_m.iter().map(|&r| r.into()).collect(),
    })
}

/// Returns the square roots of a covariance's diagonal.
pub fn diagonal_sigmas(c: &Matrix3<f64>) -> [f64; 3] {
    [0, 1, 2].map(|k| c[(k, k)].max(0.0).sqrt())
}

/// Returns the deflection of the marker that is farthest along the span, measured or predicted.
fn tip_record(installation: &Installation, s: &Solution) -> Option<Tip> {
    let budget = s.budget.as_ref()?;
    let outermost = s.markers.get(budget.marker)?;
    let deflection = outermost.deflection_m?;
    let (ground, root) = (outermost.deflection_ground_m, outermost.deflection_root_m);
    Some(Tip {
        marker: installation.setup.markers.get(budget.marker)?.id.clone(),
        predicted: !outermost.used,
        deflection_m: deflection.value,
        sigma_deflection_m: deflection.sigma,
        deflection_ground_m: get_value(ground),
        sigma_deflection_ground_m: get_sigma(ground),
        deflection_root_m: get_value(root),
        sigma_deflection_root_m: get_sigma(root),
        reference: Some(budget.reference),
    })
}

fn get_value(estimate: Option<Estimate>) -> Option<f64> {
    estimate.map(|e| e.value)
}

fn get_sigma(estimate: Option<Estimate>) -> Option<f64> {
    estimate.and_then(|e| e.sigma)
}

fn torsion_record(t: &PairTorsion) -> TorsionRecord {
    let degrees = |e: Option<Estimate>| e.map(|e| e.value.to_degrees());
    let sigma = |e: Option<Estimate>| e.and_then(|e| e.sigma).map(f64::to_degrees);
    TorsionRecord {
        name: t.name.clone(),
        angle_deg: degrees(t.angle_rad),
        sigma_deg: sigma(t.angle_rad),
        twist_deg: degrees(t.twist_rad),
        sigma_twist_deg: sigma(t.twist_rad),
        incidence: incidence_record(t.slope_rad, t.streamwise_twist_rad),
    }
}

fn incidence_record(
    slope_rad: Option<Estimate>,
    streamwise_twist_rad: Option<Estimate>,
) -> IncidenceRecord {
    let [slope, streamwise] = [slope_rad, streamwise_twist_rad].map(|e| {
        e.map(|e| Estimate {
            value: e.value.to_degrees(),
            sigma: e.sigma.map(f64::to_degrees),
        })
    });
    IncidenceRecord {
        slope_deg: get_value(slope),
        sigma_slope_deg: get_sigma(slope),
        streamwise_twist_deg: get_value(streamwise),
        sigma_streamwise_twist_deg: get_sigma(streamwise),
    }
}

fn curve_record(p: &CurvePoint) -> CurveRecord {
    let [ground, root] = p.other_deflections_m.unwrap_or([None; 2]);
    CurveRecord {
        arc_length_m: p.arc_length_m,
        span_m: p.span_m,
        deflection_m: p.deflection_m.value,
        sigma_deflection_m: p.deflection_m.sigma,
        deflection_ground_m: get_value(ground),
        sigma_deflection_ground_m: get_sigma(ground),
        deflection_root_m: get_value(root),
        sigma_deflection_root_m: get_sigma(root),
        twist_deg: p.twist_rad.map(|t| t.value.to_degrees()),
        sigma_twist_deg: p.twist_rad.and_then(|t| t.sigma).map(f64::to_degrees),
        incidence: incidence_record(p.slope_rad, p.streamwise_twist_rad),
    }
}

fn quality_record(installation: &Installation, s: &Solution) -> Quality {
    Quality {
        iterations: Some(s.iterations),
        pitch_bending_correlation: s.pitch_bending_correlation,
        correlation: correlation_record(s),
        variance_components: s.variance_components.clone(),
        window: window_panes(installation),
        cad: cad_record(installation),
        ..Quality::default()
    }
}
