//! Small displacements in flight: each unknown displaces the markers in proportion to its value. A first-order model is
//! sufficient because each displacement is at most some centimetres.

use nalgebra::Vector3;

use super::camera::image_shift;
use super::wing::torque_term;
use crate::adjust::beam::{Bending, SectionMotion};
use crate::adjust::input::{AdjustmentInput, FrameObservations};
use crate::adjust::marker_state::MarkerState;
use crate::adjust::prior_scales::PriorScales;
use crate::adjust::scene::WingScene;
use crate::adjust::term::{Displacement, DisplacementEpoch, ParameterTerm, TermEffect};
use crate::estimation::Prior;
use crate::setup::{SetupUncertainty, SurveyMarker, Vibration};
use crate::widths::{Unknown, Width};

type DisplacementField = Vec<Vector3<f64>>;

const MISSING_MOTION: &str =
    "a motion of the wing in flight cannot be determined; give its standard deviation";

fn displacement_term(
    unknown: Unknown,
    instant: DisplacementEpoch,
    fields: Vec<DisplacementField>,
    sigmas: &[f64],
) -> ParameterTerm {
    let prior = |(k, sigma): (usize, &f64)| Prior::scalar(unknown, k, 0.0, *sigma);
    ParameterTerm {
        unknown,
        missing: MISSING_MOTION,
        size: fields.len(),
        priors: sigmas.iter().enumerate().map(prior).collect(),
        add_values: |_, _| (),
        effect: TermEffect::Displacement(Displacement {
            epoch: instant,
            fields,
            of_section: None,
        }),
    }
}

/// Deflection and slope of a cantilever's first mode relative to its tip deflection, at a fraction of the length.
fn first_mode(eta: f64) -> (f64, f64) {
    (eta * eta * (3.0 - eta) / 2.0, 1.5 * eta * (2.0 - eta))
}

/// Marker on the wing.
struct WingPoint {
    marker: usize,
    /// Position as a fraction of the length.
    eta: f64,
    /// Chordwise arm from the axis, m.
    arm_m: f64,
}

fn markers_on_wing(scene: &WingScene) -> impl Iterator<Item = WingPoint> {
    let axis = &scene.ground.axis;
    let stations = scene
        .ground
        .stations
        .iter()
        .enumerate()
        .filter(|(k, _)| !scene.is_fixed(*k));
    stations.map(|(marker, s)| WingPoint {
        marker,
        eta: s.arc_m / axis.length_m,
        arm_m: s.surveyed_m.z - axis.root_m.z - axis.swept_m(s.arc_m),
    })
}

fn zero_displacements(scene: &WingScene) -> DisplacementField {
    vec![Vector3::zeros(); scene.ground.stations.len()]
}

/// Displacements on ground by a small bending or twist.
fn field_on_ground(
    scene: &WingScene,
    derivative: fn(&MarkerState) -> Vector3<f64>,
) -> DisplacementField {
    let flat = scene.grid.bend(&Bending::UNBENT);
    let mut field = zero_displacements(scene);
    for WingPoint { marker, .. } in markers_on_wing(scene) {
        let ground_m = scene.ground.stations[marker].surveyed_m;
        let state = scene.marker_on_beam(marker, &flat[marker], &ground_m, &Bending::UNBENT);
        field[marker] = derivative(&state);
    }
    field
}

/// Twist of the wing between survey and ground frame, nose up positive, at the tip, rad; it grows linearly along the span.
fn ground_twist(scene: &WingScene, sigma_rad: f64) -> Option<ParameterTerm> {
    let field = (sigma_rad > 0.0).then(|| field_on_ground(scene, |state| state.by_twist[0]))?;
    Some(displacement_term(
        Unknown::GroundTwist,
        DisplacementEpoch::OnGround,
        vec![field],
        &[sigma_rad],
    ))
}

/// Bend of the wing between survey and ground frame, tip deflection in m; its shape is that of bending under load.
fn ground_bend(scene: &WingScene, sigma_m: f64) -> Option<ParameterTerm> {
    let mut field = (sigma_m > 0.0).then(|| field_on_ground(scene, |state| state.by_bending[0]))?;
    // Tip deflection: that of the outermost marker, extrapolated with the square of the length.
    let outermost = markers_on_wing(scene).max_by(|a, b| a.eta.total_cmp(&b.eta))?;
    let tip = field[outermost.marker].y / outermost.eta.powi(2).max(f64::EPSILON);
    field.iter_mut().for_each(|by| *by /= tip);
    (tip > 0.0).then(|| {
        displacement_term(
            Unknown::GroundBend,
            DisplacementEpoch::OnGround,
            vec![field],
            &[sigma_m],
        )
    })
}

/// Number of skin bulges along the wing.
const BULGE_COUNT: usize = 8;
/// Standard deviation of the common motion of neighbouring markers, relative to that of each single marker: tank bays under
/// fuel and pressure compared with a panel between two stringers. An assumption.
const BULGE_RATIO: f64 = 2.5;

/// Bulges of the skin along its normal over the length of several panels, m. `sigma_m`: prior standard deviation of a
/// single marker's motion.
fn skin_bulges(scene: &WingScene, sigma_m: f64) -> Option<ParameterTerm> {
    if sigma_m <= 0.0 {
        return None;
    }
    let mut fields = vec![zero_displacements(scene); BULGE_COUNT];
    let bulge = |k: usize, eta: f64| (-(eta * BULGE_COUNT as f64 - k as f64 - 0.5).powi(2)).exp();
    for WingPoint { marker, eta, .. } in markers_on_wing(scene) {
        let normal = scene.ground.stations[marker].skin_normal;
        let of_all: [f64; BULGE_COUNT] = std::array::from_fn(|k| bulge(k, eta.clamp(0.0, 1.0)));
        // Equal standard deviation at all positions.
        let rms = of_all.iter().map(|b| b * b).sum::<f64>().sqrt();
        for (field, share) in fields.iter_mut().zip(of_all) {
            field[marker] = normal * (share / rms);
        }
    }
    Some(displacement_term(
        Unknown::SkinBulges,
        DisplacementEpoch::InFlight,
        fields,
        &[BULGE_RATIO * sigma_m; BULGE_COUNT],
    ))
}

/// Prior standard deviations of the shapes of in-plane bending at the tip, relative to the first: the first mode, a part that is
/// larger outboard, and turns at [`IN_PLANE_TURNS`]. Twist inboard of a break that the survey does not show turns what lies
/// outboard of it: 1 degree of twist and 4 degrees of break 25 mm at a tip 20 m away.
const IN_PLANE_RATIOS: [f64; 2 + IN_PLANE_TURNS.len()] = [1.0, 0.4, 0.3, 0.3, 0.3, 0.3];
/// Places at which the axis may turn in the wing's plane, as fractions of the length: joints, engines, breaks of the planform.
const IN_PLANE_TURNS: [f64; 4] = [0.25, 0.35, 0.5, 0.7];

/// Motion of the section at a fraction of the length by in-plane bending with a displacement of 1 m at the tip.
fn in_plane_motion(k: usize, eta: f64, length_m: f64) -> SectionMotion {
    let (deflection, slope) = match k.checked_sub(2).and_then(|turn| IN_PLANE_TURNS.get(turn)) {
        Some(at) => (
            (eta - at).max(0.0) / (1.0 - at),
            if eta > *at { 1.0 / (1.0 - at) } else { 0.0 },
        ),
        None if k == 0 => first_mode(eta),
        None => (eta.powi(4), 4.0 * eta.powi(3)),
    };
    let rotation_rad = Vector3::y() * (-slope / length_m);
    SectionMotion {
        displacement_m: Vector3::z() * deflection,
        rotation_rad,
        twist_rad: 0.0,
    }
}

/// Bending in the wing's plane, at the tip, aft on a right wing, m. Sections rotate with it.
fn in_plane(scene: &WingScene, sigma_m: f64) -> Option<ParameterTerm> {
    if sigma_m <= 0.0 {
        return None;
    }
    let mut fields = vec![zero_displacements(scene); IN_PLANE_RATIOS.len()];
    for WingPoint { marker, eta, arm_m } in markers_on_wing(scene) {
        for (k, field) in fields.iter_mut().enumerate() {
            let motion = in_plane_motion(k, eta, scene.ground.axis.length_m);
            field[marker] =
                motion.displacement_m + motion.rotation_rad.cross(&(Vector3::z() * arm_m));
        }
    }
    let sigmas = IN_PLANE_RATIOS.map(|ratio| ratio * sigma_m);
    let mut term = displacement_term(
        Unknown::InPlane,
        DisplacementEpoch::InFlight,
        fields,
        &sigmas,
    );
    if let TermEffect::Displacement(displacement) = &mut term.effect {
        displacement.of_section = Some(in_plane_motion);
    }
    Some(term)
}

/// Prior standard deviations of a moving part's deflection, rad, of its hinge's height, m, and along the chord, m: a part
/// deflects by some ten degrees about a hinge that is not surveyed.
const PART_SIGMAS: [f64; 3] = [0.2, 0.1, 0.02];

/// Motion of one moving part that carries these markers.
fn moving_part(scene: &WingScene, markers: &[usize]) -> ParameterTerm {
    let chord_m = |marker: usize| scene.ground.stations[marker].surveyed_m.z;
    let mean_m = markers.iter().map(|k| chord_m(*k)).sum::<f64>() / markers.len().max(1) as f64;
    let mut fields = vec![zero_displacements(scene); PART_SIGMAS.len()];
    for &marker in markers {
        fields[0][marker] = Vector3::y() * (chord_m(marker) - mean_m);
        fields[1][marker] = Vector3::y();
        fields[2][marker] = Vector3::z();
    }
    displacement_term(
        Unknown::MovingPart,
        DisplacementEpoch::InFlight,
        fields,
        &PART_SIGMAS,
    )
}

/// Motions of all parts that carry markers.
fn moving_parts(scene: &WingScene, markers: &[SurveyMarker]) -> Vec<ParameterTerm> {
    let mut names: Vec<&str> = markers.iter().filter_map(|m| m.part.as_deref()).collect();
    names.sort_unstable();
    names.dedup();
    let markers_of = |name: &str| -> Vec<usize> {
        (0..markers.len())
            .filter(|k| markers[*k].part.as_deref() == Some(name))
            .collect()
    };
    names
        .into_iter()
        .map(|name| moving_part(scene, &markers_of(name)))
        .collect()
}

/// Prior standard deviation of a common displacement, m: as large as that of a moving part or an offset between two
/// surveys.
const COMMON_DISPLACEMENT_SIGMA_M: f64 = 0.1;

/// Common displacement of several markers.
pub fn common_displacement(field: Vec<Vector3<f64>>) -> ParameterTerm {
    displacement_term(
        Unknown::CommonDisplacement,
        DisplacementEpoch::InFlight,
        vec![field],
        &[COMMON_DISPLACEMENT_SIGMA_M],
    )
}

/// Root mean square of a sinusoid's velocity and of half its acceleration, per s and per s^2.
fn rms_rates(vibration: Vibration) -> [f64; 2] {
    let circular = std::f64::consts::TAU * vibration.frequency_hz;
    let rms = vibration.amplitude / 2f64.sqrt();
    [rms * circular, 0.5 * rms * circular * circular]
}

/// Times of the markers' image rows relative to the middle row, s; 0 for a marker without an observation.
fn row_times_s(
    scene: &WingScene,
    frame_observations: &FrameObservations,
    height_px: f64,
    readout_s: f64,
) -> Vec<f64> {
    let time_s = |v: f64| (v / height_px - 0.5) * readout_s;
    let time_of = |k: usize| {
        frame_observations
            .get(k)
            .copied()
            .flatten()
            .map_or(0.0, |seen| time_s(seen.pixel.y))
    };
    (0..scene.ground.stations.len()).map(time_of).collect()
}

/// Vibration of the wing in its first mode during readout: velocity of the tip at the middle row, m/s.
fn wing_vibration(
    scene: &WingScene,
    times_s: &[f64],
    vibration: Vibration,
) -> Option<ParameterTerm> {
    let mut field = zero_displacements(scene);
    for WingPoint { marker, eta, .. } in markers_on_wing(scene) {
        field[marker] = Vector3::y() * (first_mode(eta).0 * times_s[marker]);
    }
    let [velocity, _] = rms_rates(vibration);
    let term = || {
        displacement_term(
            Unknown::WingVibration,
            DisplacementEpoch::AtMarkerRow,
            vec![field],
            &[velocity],
        )
    };
    (velocity > 0.0).then(term)
}

/// Shake of the camera about its two transverse axes during readout, rad/s and rad/s^2. A rotation of the camera is
/// modelled as the opposite rotation of all points about it.
fn camera_shake(scene: &WingScene, times_s: &[f64], vibration: Vibration) -> Option<ParameterTerm> {
    let mut fields = vec![];
    for (axis, power) in [
        (Vector3::x(), 1),
        (Vector3::x(), 2),
        (Vector3::y(), 1),
        (Vector3::y(), 2),
    ] {
        let about = scene.camera_from_wing.transpose() * axis;
        let stations = scene.ground.stations.iter().zip(times_s);
        fields.push(
            stations
                .map(|(s, t)| s.surveyed_m.cross(&about) * t.powi(power))
                .collect(),
        );
    }
    let [velocity, acceleration] = rms_rates(vibration);
    let sigmas = [velocity, acceleration, velocity, acceleration];
    (velocity > 0.0).then(|| {
        displacement_term(
            Unknown::CameraShake,
            DisplacementEpoch::AtMarkerRow,
            fields,
            &sigmas,
        )
    })
}

/// Components of in-plane bending and control-surface torque, as fractions of the prior standard deviation: shared by all
/// frames of a flight, and independent per frame. Within a flight they differ only by gusts, flaps and turns.
const FLIGHT_AND_FRAME_SIGMA: [f64; 2] = [0.9, 0.436];
/// The same for a frame alone.
const ALONE_SIGMA: [f64; 2] = [1.0, 0.0];

fn component_sigmas(is_alone: bool) -> [f64; 2] {
    if is_alone {
        ALONE_SIGMA
    } else {
        FLIGHT_AND_FRAME_SIGMA
    }
}

fn in_plane_and_torque_terms(input: &AdjustmentInput, share: f64) -> Vec<ParameterTerm> {
    let priors = &input.setup.uncertainty;
    in_plane(input.scene, share * priors[Width::InPlane])
        .into_iter()
        .chain(torque_term(share * priors[Width::Torque]))
        .collect()
}

/// Terms that the frames of a flight share: skin bulges and the common component of in-plane bending and torque.
pub fn flight_terms(input: &AdjustmentInput, is_alone: bool) -> Vec<ParameterTerm> {
    let mut terms = in_plane_and_torque_terms(input, component_sigmas(is_alone)[0]);
    terms.extend(skin_bulges(
        input.scene,
        input.setup.uncertainty[Width::SkinMotion],
    ));
    terms
}

/// Terms of a frame in addition to bending, twist and rotation.
pub fn frame_terms(
    input: &AdjustmentInput,
    frame_observations: &FrameObservations,
    scales: &PriorScales,
    is_alone: bool,
) -> Vec<ParameterTerm> {
    let mut terms = in_plane_and_torque_terms(input, component_sigmas(is_alone)[1]);
    terms.extend(moving_parts(input.scene, &input.setup.markers));
    terms.extend(row_terms(input, frame_observations, scales));
    terms.extend(image_shift(
        input.setup.uncertainty[Width::Stabilisation].max(scales.stabilised_px),
    ));
    terms
}

/// Terms that depend on the image rows of the markers in this frame.
pub fn row_terms(
    input: &AdjustmentInput,
    frame_observations: &FrameObservations,
    scales: &PriorScales,
) -> Vec<ParameterTerm> {
    let SetupUncertainty {
        vibration: of_wing,
        shake: of_camera,
        ..
    } = input.setup.uncertainty;
    let readout_s = input.setup.uncertainty[Width::Readout];
    if readout_s <= 0.0 {
        return vec![];
    }
    let times_s = row_times_s(
        input.scene,
        frame_observations,
        f64::from(input.setup.lens.height),
        readout_s,
    );
    let scaled = |vibration: Vibration, factor| Vibration {
        amplitude: factor * vibration.amplitude,
        ..vibration
    };
    let terms = [
        wing_vibration(input.scene, &times_s, scaled(of_wing, scales.vibration)),
        camera_shake(input.scene, &times_s, scaled(of_camera, scales.shake)),
    ];
    terms.into_iter().flatten().collect()
}

/// Terms of the state of the wing at the survey and the ground frame, without those that are fixed.
pub fn ground_state(input: &AdjustmentInput) -> impl Iterator<Item = ParameterTerm> {
    let uncertainty = &input.setup.uncertainty;
    let of_frame = |width: Width| {
        if input.scene.has_ground_observations() {
            uncertainty[width]
        } else {
            0.0
        }
    };
    let twist = ground_twist(input.scene, of_frame(Width::GroundTwist));
    let vertical = Some(uncertainty[Width::Vertical])
        .filter(|sigma| *sigma > 0.0)
        .map(survey_vertical);
    ground_bend(input.scene, of_frame(Width::GroundBend))
        .into_iter()
        .chain(twist)
        .chain(vertical)
}

/// Error of the survey's vertical about the wing frame's X and Z, rad. Deflections are counted along the vertical, and the
/// bending plane contains it.
fn survey_vertical(sigma_rad: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::Vertical,
        missing: "the survey's vertical cannot be determined; give survey.vertical_sigma_deg",
        size: 2,
        priors: ParameterTerm::equal_priors(Unknown::Vertical, 2, sigma_rad),
        add_values: |x, values| values.plane_rad = Some(x[0]),
        effect: TermEffect::Vertical {
            deflection: |displaced_m, k| {
                if k == 0 {
                    displaced_m.z
                } else {
                    -displaced_m.x
                }
            },
            position: |state, k| {
                if k == 0 {
                    state.by_plane
                } else {
                    Vector3::zeros()
                }
            },
            sections: |curve, k| {
                let about_span = |v: &Vector3<f64>| {
                    if k == 0 {
                        Vector3::x().cross(v)
                    } else {
                        Vector3::zeros()
                    }
                };
                let tilt = |motion: &SectionMotion| SectionMotion {
                    displacement_m: about_span(&motion.displacement_m),
                    rotation_rad: about_span(&motion.rotation_rad),
                    twist_rad: 0.0,
                };
                curve.motions.iter().map(tilt).collect()
            },
        },
    }
}
