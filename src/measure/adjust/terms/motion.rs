//! What flight moves by a little: each unknown displaces every marker in proportion. To first order nothing else is needed,
//! since none of them moves a marker by more than some centimetres.

use nalgebra::Vector3;

use super::wing::torques;
use crate::adjust::beam::Bending;
use crate::adjust::factors::Factors;
use crate::adjust::input::{Input, Sights};
use crate::adjust::scene::Scene;
use crate::adjust::term::{Displacement, DisplacementEpoch, Effect, Term};
use crate::estimation::Prior;
use crate::setup::{FlightEffectPriors, SurveyMarker, Vibration};

type Field = Vec<Vector3<f64>>;

const MISSING: &str = "a motion of the wing in flight cannot be determined; give its standard deviation";

fn moves(name: &'static str, instant: DisplacementEpoch, fields: Vec<Field>, sigmas: &[f64]) -> Term {
    let prior = |(k, sigma): (usize, &f64)| Prior::scalar(name, k, 0.0, *sigma);
    Term {
        name,
        missing: MISSING,
        size: fields.len(),
        priors: sigmas.iter().enumerate().map(prior).collect(),
        enter: |_, _| (),
        effect: Effect::Moves(Displacement { instant, fields }),
    }
}

/// Deflection of a cantilever's first mode over that of its tip, and its slope, by the share of the length.
fn mode(eta: f64) -> (f64, f64) {
    (eta * eta * (3.0 - eta) / 2.0, 1.5 * eta * (2.0 - eta))
}

/// One on the wing.
struct OnWing {
    marker: usize,
    /// Share of the length.
    eta: f64,
    /// Arm along the chord from the axis, m.
    arm_m: f64,
}

fn wing(scene: &Scene) -> impl Iterator<Item = OnWing> {
    let axis = &scene.ground.axis;
    let stations = scene.ground.stations.iter().enumerate().filter(|(k, _)| !scene.is_fixed(*k));
    stations.map(|(marker, s)| OnWing {
        marker,
        eta: s.arc_m / axis.length_m,
        arm_m: s.surveyed_m.z - axis.root_m.z,
    })
}

fn empty(scene: &Scene) -> Field {
    vec![Vector3::zeros(); scene.ground.stations.len()]
}

/// Bend of the wing between survey and ground frame, at the tip, m: the shape in which deflection bends it, scaled.
pub fn ground_bend(scene: &Scene, sigma_m: f64) -> Option<Term> {
    if sigma_m <= 0.0 {
        return None;
    }
    let unbent = Bending { curvature_per_m: &[0.0], ..Bending::NONE };
    let flat = scene.bend(&unbent);
    let mut field = empty(scene);
    for OnWing { marker, .. } in wing(scene) {
        let ground_m = scene.ground.stations[marker].surveyed_m;
        let state = scene.marker(marker, &flat, &ground_m, &unbent, &Default::default());
        field[marker] = state.by_curvature[0];
    }
    // The tip's: the outermost marker's, carried on as the square of the length.
    let outermost = wing(scene).max_by(|a, b| a.eta.total_cmp(&b.eta))?;
    let tip = field[outermost.marker].y / outermost.eta.powi(2).max(f64::EPSILON);
    field.iter_mut().for_each(|by| *by /= tip);
    let name = "bend between survey and ground frame";
    (tip > 0.0).then(|| moves(name, DisplacementEpoch::OnGround, vec![field], &[sigma_m]))
}

/// Bulges of the skin along the wing.
const BULGES: usize = 8;
/// Standard deviation of what neighbouring markers move by together over that of what each moves by itself: bays of a tank
/// under fuel and pressure against a panel between two stringers. An assumption.
const TOGETHER: f64 = 2.5;

/// The skin over lengths of many panels, along its normal, m; `sigma_m`: of what each marker moves by itself.
fn bulges(scene: &Scene, sigma_m: f64) -> Option<Term> {
    if sigma_m <= 0.0 {
        return None;
    }
    let mut fields = vec![empty(scene); BULGES];
    let bulge = |k: usize, eta: f64| (-(eta * BULGES as f64 - k as f64 - 0.5).powi(2)).exp();
    for OnWing { marker, eta, .. } in wing(scene) {
        let normal = scene.ground.axis.normal(scene.ground.stations[marker].arc_m);
        let of_all: [f64; BULGES] = std::array::from_fn(|k| bulge(k, eta.clamp(0.0, 1.0)));
        // As wide everywhere.
        let rms = of_all.iter().map(|b| b * b).sum::<f64>().sqrt();
        for (field, share) in fields.iter_mut().zip(of_all) {
            field[marker] = normal * (share / rms);
        }
    }
    Some(moves("bulges of the skin", DisplacementEpoch::InFlight, fields, &[TOGETHER * sigma_m; BULGES]))
}

/// Second unknown of the bending in the wing's plane over the first.
const SECOND_IN_PLANE: f64 = 0.4;

/// Bending in the wing's plane at the tip, aft on a right wing, m: as the first mode, and a part that grows farther
/// outboard; sections turn with it.
fn in_plane(scene: &Scene, sigma_m: f64) -> Option<Term> {
    if sigma_m <= 0.0 {
        return None;
    }
    let mut fields = vec![empty(scene); 2];
    let length_m = scene.ground.axis.length_m;
    for OnWing { marker, eta, arm_m } in wing(scene) {
        let shapes = [mode(eta), (eta.powi(4), 4.0 * eta.powi(3))];
        for (field, (deflection, slope)) in fields.iter_mut().zip(shapes) {
            field[marker] = Vector3::new(-arm_m * slope / length_m, 0.0, deflection);
        }
    }
    let sigmas = [sigma_m, SECOND_IN_PLANE * sigma_m];
    Some(moves("bending in the wing's plane", DisplacementEpoch::InFlight, fields, &sigmas))
}

/// Standard deviations of a part's deflection, rad, of its hinge's height, m, and along the chord, m: a part turns by some
/// ten degrees about a hinge that nobody surveys.
const PART: [f64; 3] = [0.2, 0.1, 0.02];

/// One moving part with these markers.
fn part(scene: &Scene, of: &[usize]) -> Term {
    let place = |marker: usize| scene.ground.stations[marker].surveyed_m.z;
    let mean_m = of.iter().map(|k| place(*k)).sum::<f64>() / of.len().max(1) as f64;
    let mut fields = vec![empty(scene); PART.len()];
    for &marker in of {
        fields[0][marker] = Vector3::y() * (place(marker) - mean_m);
        fields[1][marker] = Vector3::y();
        fields[2][marker] = Vector3::z();
    }
    moves("moving part", DisplacementEpoch::InFlight, fields, &PART)
}

/// All moving parts that markers sit on.
fn parts(scene: &Scene, markers: &[SurveyMarker]) -> Vec<Term> {
    let mut names: Vec<&str> = markers.iter().filter_map(|m| m.part.as_deref()).collect();
    names.sort_unstable();
    names.dedup();
    let of = |name: &str| -> Vec<usize> {
        (0..markers.len()).filter(|k| markers[*k].part.as_deref() == Some(name)).collect()
    };
    names.into_iter().map(|name| part(scene, &of(name))).collect()
}

/// How far markers may be displaced that have a cause in common, m: as much as a part turns or a survey jumps.
const COMMON_CAUSE_M: f64 = 0.1;

/// Markers that are displaced together by so much.
pub fn common_cause(field: Vec<Vector3<f64>>) -> Term {
    moves("common cause", DisplacementEpoch::InFlight, vec![field], &[COMMON_CAUSE_M])
}

/// Root mean square of a sinusoid's velocity and of half its acceleration, its unit per s and per s^2.
fn rates(vibration: Vibration) -> [f64; 2] {
    let circular = std::f64::consts::TAU * vibration.frequency_hz;
    let rms = vibration.amplitude / 2f64.sqrt();
    [rms * circular, 0.5 * rms * circular * circular]
}

/// Instants of the markers' rows against the middle row's, s; 0 where a marker is not seen.
fn row_times_s(scene: &Scene, sights: &Sights, height_px: f64, readout_s: f64) -> Vec<f64> {
    let time_s = |v: f64| (v / height_px - 0.5) * readout_s;
    let of = |k: usize| sights.get(k).copied().flatten().map_or(0.0, |seen| time_s(seen.pixel.y));
    (0..scene.ground.stations.len()).map(of).collect()
}

/// The wing's vibration, by name.
pub const VIBRATION: &str = "vibration of the wing";
/// The camera's.
pub const SHAKE: &str = "shake of the camera";

/// The wing in its first mode while the rows are read: its tip's velocity at the middle row, m/s.
fn vibration(scene: &Scene, times_s: &[f64], of: Vibration) -> Option<Term> {
    let mut field = empty(scene);
    for OnWing { marker, eta, .. } in wing(scene) {
        field[marker] = Vector3::y() * (mode(eta).0 * times_s[marker]);
    }
    let [velocity, _] = rates(of);
    (velocity > 0.0).then(|| moves(VIBRATION, DisplacementEpoch::AtItsRow, vec![field], &[velocity]))
}

/// The camera about its two transverse axes while the rows are read, rad/s and rad/s^2. A camera that turns sees what
/// points that turn the other way about it show.
fn shake(scene: &Scene, times_s: &[f64], of: Vibration) -> Option<Term> {
    let mut fields = vec![];
    for (axis, power) in [(Vector3::x(), 1), (Vector3::x(), 2), (Vector3::y(), 1), (Vector3::y(), 2)] {
        let about = scene.camera_from_wing.transpose() * axis;
        let stations = scene.ground.stations.iter().zip(times_s);
        fields.push(stations.map(|(s, t)| s.surveyed_m.cross(&about) * t.powi(power)).collect());
    }
    let [velocity, acceleration] = rates(of);
    let sigmas = [velocity, acceleration, velocity, acceleration];
    (velocity > 0.0).then(|| moves(SHAKE, DisplacementEpoch::AtItsRow, fields, &sigmas))
}

/// Of drag, and of the torque that trims an aircraft: the part of the standard deviation that a flight's frames have in
/// common, and the part that each has for itself. A wing bends and twists alike in one flight but for gusts, flaps and turns.
const OF_FLIGHT: (f64, f64) = (0.9, 0.436);

fn in_plane_and_torque(input: &Input, share: f64) -> Vec<Term> {
    let width = &input.setup.uncertainty.in_flight;
    in_plane(input.scene, share * width.in_plane_m)
        .into_iter()
        .chain(torques(share * width.torque_rad))
        .collect()
}

/// What all frames have in common, with this share of what else each has for itself.
fn in_common(input: &Input, share: f64) -> Vec<Term> {
    let skin = bulges(input.scene, input.setup.uncertainty.in_flight.skin_motion_m);
    in_plane_and_torque(input, share).into_iter().chain(skin).collect()
}

/// What a flight's frames have in common of what each has for itself, and the skin.
pub fn of_flight(input: &Input) -> Vec<Term> {
    in_common(input, OF_FLIGHT.0)
}

/// What each frame has for itself beside bending, twist and rotation; `in_flight`: beside [`of_flight`].
pub fn of_frame(input: &Input, sights: &Sights, factors: &Factors, in_flight: bool) -> Vec<Term> {
    let mut terms = if in_flight { in_plane_and_torque(input, OF_FLIGHT.1) } else { in_common(input, 1.0) };
    terms.extend(parts(input.scene, &input.setup.markers));
    terms.extend(of_rows(input, sights, factors));
    terms
}

/// What of it follows from the rows in which this frame shows its markers.
pub fn of_rows(input: &Input, sights: &Sights, factors: &Factors) -> Vec<Term> {
    let FlightEffectPriors { readout_s, vibration: of_wing, shake: of_camera, .. } =
        input.setup.uncertainty.in_flight;
    if readout_s <= 0.0 {
        return vec![];
    }
    let times_s = row_times_s(input.scene, sights, f64::from(input.setup.lens.height), readout_s);
    let times = |of: Vibration, factor| Vibration { amplitude: factor * of.amplitude, ..of };
    let terms = [
        vibration(input.scene, &times_s, times(of_wing, factors.vibration)),
        shake(input.scene, &times_s, times(of_camera, factors.shake)),
    ];
    terms.into_iter().flatten().collect()
}

/// Three unknowns, each known to be 0 as well as this.
fn three(name: &'static str, sigma: f64) -> Vec<Prior> {
    (0..3).map(|k| Prior::scalar(name, k, 0.0, sigma)).collect()
}

/// Rotation of the root against the cabin since the ground frame, about the wing frame's axes, rad. Marks that are fixed to
/// the cabin stay.
fn root_turn(sigma_rad: f64) -> Term {
    let name = "rotation of the root";
    Term {
        name,
        missing: "the root's rotation cannot be determined; give wing.root_rotation_sigma_mrad",
        size: 3,
        priors: three(name, sigma_rad),
        enter: |x, values| values.root_rotation_rad += Vector3::from_column_slice(x),
        effect: Effect::Wing {
            position: |state, k| {
                state.from_root_m.map_or_else(Vector3::zeros, |from| Vector3::ith(k, 1.0).cross(&from))
            },
            deflections: |curve, k| {
                let deflection = |from_root_m: Vector3<f64>| Vector3::ith(k, 1.0).cross(&from_root_m).y;
                curve.bent.iter().map(|section| deflection(section.axis_m - curve.root_m)).collect()
            },
            twist: |_, _| 0.0,
        },
    }
}

/// Its shift, m.
fn root_shift(sigma_m: f64) -> Term {
    let name = "shift of the root";
    Term {
        name,
        missing: "the root's shift cannot be determined; give wing.root_translation_sigma_m",
        size: 3,
        priors: three(name, sigma_m),
        enter: |x, values| values.root_translation_m += Vector3::from_column_slice(x),
        effect: Effect::Wing {
            position: |state, k| state.from_root_m.map_or_else(Vector3::zeros, |_| Vector3::ith(k, 1.0)),
            deflections: |curve, k| vec![f64::from(u8::from(k == 1)); curve.bent.len()],
            twist: |_, _| 0.0,
        },
    }
}

/// The root's motion against the cabin, as far as it is not held.
pub fn root(width: &FlightEffectPriors) -> impl Iterator<Item = Term> {
    let turn = (width.root_rotation_rad > 0.0).then(|| root_turn(width.root_rotation_rad));
    turn.into_iter().chain((width.root_translation_m > 0.0).then(|| root_shift(width.root_translation_m)))
}

/// The survey's vertical about the wing frame's X and Z, rad: deflections are counted along it, and the wing bends in the plane that
/// is upright by it.
pub fn vertical(sigma_rad: f64) -> Term {
    let name = "vertical of the survey";
    Term {
        name,
        missing: "the survey's vertical cannot be determined",
        size: 2,
        priors: (0..2).map(|k| Prior::scalar(name, k, 0.0, sigma_rad)).collect(),
        enter: |x, values| values.plane_rad = Some(x[0]),
        effect: Effect::Vertical {
            deflection: |displaced_m, k| if k == 0 { displaced_m.z } else { -displaced_m.x },
            position: |state, k| if k == 0 { state.by_plane } else { Vector3::zeros() },
        },
    }
}
