//! Positions of the markers on a bent and twisted wing: rigid sections on an axis of constant length (docs/adjustment.md), as
//! fine as identification needs.

use nalgebra::{SVector, Vector2, Vector3};

use super::skin::SkinSurface;
use crate::geometry::WingFrame;
use crate::setup::Setup;

/// State of wing and camera: curvature (3 terms, 1/m), twist (2 terms, rad), camera mount (3 small rotations, camera frame,
/// rad).
pub(super) type WingState = SVector<f64, 8>;

const INTERVALS: usize = 32;
/// Length of the axis beyond the outermost marker, m.
const MARGIN_M: f64 = 0.5;

/// A marker's offset from its section of the axis.
#[derive(Clone, Copy, Debug)]
struct Arm {
    /// Arc length of the section from the bending root, m; negative inboard of it, which does not move; minus infinity for
    /// a target that is rigid to the cabin.
    foot_m: f64,
    /// Offset along the axis, normal to it, and chordwise, m.
    arm_m: Vector3<f64>,
}

/// The wing on the ground and its bending axis.
#[derive(Clone, Debug)]
pub(super) struct CoarseBeam {
    /// Wing frame of all coordinates.
    pub(super) frame: WingFrame,
    /// Skin on the ground.
    pub(super) skin: SkinSurface,
    /// Markers on the ground, wing frame, m.
    pub(super) ground_m: Vec<Vector3<f64>>,
    /// Arc length of the axis, m.
    pub(super) length_m: f64,
    chord_axis_m: f64,
    root: Vector2<f64>,
    slopes: [f64; INTERVALS + 1],
    arms: Vec<Arm>,
}

/// A section of the bent axis.
struct BentSection {
    axis: Vector2<f64>,
    slope: f64,
}

impl Arm {
    /// Arm of a target that is rigid to the cabin.
    const NONE: Self = Self {
        foot_m: f64::NEG_INFINITY,
        arm_m: Vector3::new(0.0, 0.0, 0.0),
    };
}

/// Step at which the foot of a point on the axis is found, m: small beside the model's error.
const FOOT_M: f64 = 1e-6;

impl CoarseBeam {
    /// Creates the beam from the survey; `may_shape`: for each marker, whether it may shape the skin.
    pub(super) fn new(setup: &Setup, may_shape: &[bool]) -> Self {
        let frame = setup.wing_frame();
        let ground_m: Vec<_> = setup
            .markers
            .iter()
            .map(|m| frame.wing_point(&m.position_m))
            .collect();
        let points: Vec<_> = setup
            .wing_markers()
            .into_iter()
            .map(|(_, point)| point)
            .collect();
        let shaping = setup
            .wing_markers()
            .into_iter()
            .filter(|(k, _)| may_shape.get(*k).copied().unwrap_or(true));
        let (shaping, on_skin): (Vec<usize>, Vec<_>) = shaping.unzip();
        let sigma_m: Vec<_> = shaping.iter().map(|k| setup.markers[*k].sigma_m).collect();
        let skin = SkinSurface::fit(&on_skin, &sigma_m);
        let count = points.len().max(1) as f64;
        let mean_z = points.iter().map(|p| p.z).sum::<f64>() / count;
        let chord_axis_m = setup.axis_chord_offset_m.unwrap_or(mean_z);
        let root_x = setup.root_offset_m;
        let height = |x: f64| skin.height(x, chord_axis_m) - skin_height_at(setup, x - root_x);
        let tip_x = points.iter().map(|p| p.x).fold(root_x + 1.0, f64::max) + MARGIN_M;
        let (length_m, slopes) = ground_axis(&height, root_x, tip_x);
        let root = Vector2::new(root_x, height(root_x));
        let beam = Self {
            frame,
            skin,
            ground_m,
            length_m,
            chord_axis_m,
            root,
            slopes,
            arms: Vec::new(),
        };
        let points: Vec<_> = beam
            .ground_m
            .iter()
            .zip(&setup.markers)
            .map(|(p, m)| (*p, m.fixed))
            .collect();
        beam.with_points(&points)
    }

    /// Returns the beam with points of the ground (wing frame, m, and whether each is rigid to the cabin) instead of the
    /// markers.
    pub(super) fn with_points(&self, points: &[(Vector3<f64>, bool)]) -> Self {
        let nodes = self.axis_node_positions(&self.slopes, 1.0);
        let arms = points
            .iter()
            .map(|(p, fixed)| {
                if *fixed {
                    Arm::NONE
                } else {
                    self.arm_to(p, &nodes)
                }
            })
            .collect();
        Self {
            ground_m: points.iter().map(|(p, _)| *p).collect(),
            arms,
            ..self.clone()
        }
    }

    /// Returns section and offset of a point on the ground, wing frame, m.
    fn arm_to(&self, p: &Vector3<f64>, nodes: &[Vector2<f64>; INTERVALS + 1]) -> Arm {
        let target = Vector2::new(p.x, p.y);
        let mut foot_m = p.x - self.root.x;
        for _ in 0..6 {
            let section = self.section_at(nodes, &self.slopes, foot_m, 1.0);
            let step_m = (target - section.axis).dot(&unit_tangent(section.slope));
            foot_m += step_m;
            if step_m.abs() < FOOT_M {
                break;
            }
        }
        let section = self.section_at(nodes, &self.slopes, foot_m, 1.0);
        let offset = target - section.axis;
        let tangent = unit_tangent(section.slope);
        let arm_m = Vector3::new(
            offset.dot(&tangent),
            tangent.perp(&offset),
            p.z - self.chord_axis_m,
        );
        Arm { foot_m, arm_m }
    }

    /// Returns the markers in flight, wing frame, m. `scale`: thermal expansion.
    pub(super) fn marker_positions(&self, state: &WingState, scale: f64) -> Vec<Vector3<f64>> {
        let slopes = self.bent_slopes(state);
        let nodes = self.axis_node_positions(&slopes, scale);
        self.arms
            .iter()
            .zip(&self.ground_m)
            .map(|(arm, ground)| {
                if arm.foot_m <= 0.0 {
                    return *ground;
                }
                let section = self.section_at(&nodes, &slopes, arm.foot_m, scale);
                let (sin, cos) = self.twist_at(state, arm.foot_m).sin_cos();
                let (n, z) = (arm.arm_m.y, arm.arm_m.z);
                let tangent = unit_tangent(section.slope);
                let normal = Vector2::new(-tangent.y, tangent.x);
                let p =
                    section.axis + (tangent * arm.arm_m.x + normal * (n * cos + z * sin)) * scale;
                Vector3::new(p.x, p.y, self.chord_axis_m + (z * cos - n * sin) * scale)
            })
            .collect()
    }

    /// Returns the displacement of each marker if the wing bends as a cantilever loaded at its tip, wing frame, m per m at
    /// the tip.
    pub(super) fn bend_displacements(&self) -> Vec<Vector3<f64>> {
        const RISE_M: f64 = 1e-3;
        let mut state = WingState::zeros();
        state[0] = 3.0 * RISE_M / self.length_m.powi(2);
        let (bent, still) = (
            self.marker_positions(&state, 1.0),
            self.marker_positions(&WingState::zeros(), 1.0),
        );
        bent.iter()
            .zip(&still)
            .map(|(bent, still)| (bent - still) / RISE_M)
            .collect()
    }

    /// Returns normal and chordwise direction of the skin at a marker in flight, wing frame.
    pub(super) fn skin_attitude(
        &self,
        state: &WingState,
        marker: usize,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (arm, ground) = (self.arms.get(marker)?, self.ground_m.get(marker)?);
        if arm.foot_m == f64::NEG_INFINITY {
            return facing_attitude(ground);
        }
        let normal = self.skin.normal(ground.x, ground.z);
        let s = arm.foot_m.clamp(0.0, self.length_m);
        let (about_z, about_x) = (self.added_slope(state, s), -self.twist_at(state, s));
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), about_z)
            * nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), about_x);
        let chord = (Vector3::z() - normal * normal.z).normalize();
        Some((turn * normal, turn * chord))
    }

    /// Returns the slope that bending adds at an arc length, rad.
    fn added_slope(&self, state: &WingState, s_m: f64) -> f64 {
        let x = s_m / self.length_m;
        let x2 = x * x;
        let integrals = [x - 0.5 * x2, 0.5 * x2, 0.5 * x2 - x2 * x / 3.0];
        self.length_m
            * (state[0] * integrals[0] + state[1] * integrals[1] + state[2] * integrals[2])
    }

    /// Returns the twist at an arc length, rad; positive twist raises the side of positive Z.
    fn twist_at(&self, state: &WingState, s_m: f64) -> f64 {
        let x = (s_m / self.length_m).clamp(0.0, 1.0);
        x * (state[3] + x * state[4])
    }

    fn bent_slopes(&self, state: &WingState) -> [f64; INTERVALS + 1] {
        let step = self.length_m / INTERVALS as f64;
        std::array::from_fn(|i| self.slopes[i] + self.added_slope(state, i as f64 * step))
    }

    fn axis_node_positions(
        &self,
        slopes: &[f64; INTERVALS + 1],
        scale: f64,
    ) -> [Vector2<f64>; INTERVALS + 1] {
        let step = scale * self.length_m / INTERVALS as f64;
        let mut nodes = [self.root; INTERVALS + 1];
        for i in 0..INTERVALS {
            nodes[i + 1] = nodes[i] + unit_tangent(0.5 * (slopes[i] + slopes[i + 1])) * step;
        }
        nodes
    }

    /// Returns the section at arc length `s_m` on the ground; beyond both ends the axis is straight.
    fn section_at(
        &self,
        nodes: &[Vector2<f64>; INTERVALS + 1],
        slopes: &[f64; INTERVALS + 1],
        s_m: f64,
        scale: f64,
    ) -> BentSection {
        let at = s_m / self.length_m * INTERVALS as f64;
        let i = (at.max(0.0) as usize).min(INTERVALS - 1);
        let fraction = at - i as f64;
        let inside = fraction.clamp(0.0, 1.0);
        let step = scale * self.length_m / INTERVALS as f64;
        let slope = slopes[i] + (slopes[i + 1] - slopes[i]) * inside;
        let axis = nodes[i]
            + (nodes[i + 1] - nodes[i]) * inside
            + unit_tangent(slope) * ((fraction - inside) * step);
        BentSection { axis, slope }
    }
}

/// Returns the normal of a target that faces the camera, as fixed targets do, and a direction across it.
pub(super) fn facing_attitude(point_m: &Vector3<f64>) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let normal = -point_m.try_normalize(1e-6)?;
    let across = (Vector3::y() - normal * normal.y)
        .try_normalize(1e-6)
        .unwrap_or_else(Vector3::x);
    Some((normal, across))
}

fn unit_tangent(slope: f64) -> Vector2<f64> {
    let (sin, cos) = slope.sin_cos();
    Vector2::new(cos, sin)
}

/// Returns the height of the skin above the bending axis, m.
fn skin_height_at(setup: &Setup, span_m: f64) -> f64 {
    setup.skin_height.map_or(0.0, |h| {
        let fraction = if h.tip_span_m > 0.0 {
            span_m / h.tip_span_m
        } else {
            0.0
        };
        h.root_m + (h.tip_m - h.root_m) * fraction
    })
}

/// Returns length and slopes of the axis between two stations, at equal arc lengths.
fn ground_axis(
    height: &impl Fn(f64) -> f64,
    root_x: f64,
    tip_x: f64,
) -> (f64, [f64; INTERVALS + 1]) {
    let fine = 4 * INTERVALS;
    let dx = (tip_x - root_x) / fine as f64;
    let xs: Vec<f64> = (0..=fine).map(|i| root_x + dx * i as f64).collect();
    let slope = |x: f64| ((height(x + 0.05) - height(x - 0.05)) / 0.1).atan();
    let length_m: f64 = xs
        .windows(2)
        .map(|w| dx.hypot(height(w[1]) - height(w[0])))
        .sum();
    let step = length_m / INTERVALS as f64;
    let mut slopes = [slope(root_x); INTERVALS + 1];
    let mut x = root_x;
    for node in slopes.iter_mut().skip(1) {
        let half = x + 0.5 * step * slope(x).cos();
        x += step * slope(half).cos();
        *node = slope(x);
    }
    (length_m, slopes)
}
