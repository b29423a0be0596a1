//! Wing geometry: planform and skin on ground and in flight.
//!
//! Material coordinates: `s` along the bending axis from its root and `z` across it, m, at ground temperature. Sections
//! across the axis are rigid. Points are in the wing frame (docs/conventions.md), origin in the projection centre.

use nalgebra::Vector3;

use super::beam::{CantileverBeam, LoadShape, running_integral};

/// Side of the wing, seen by the pilot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneSide {
    /// Left wing: Z points forward.
    Left,
    /// Right wing: Z points aft.
    Right,
}

impl SceneSide {
    /// Returns +1 if Z points aft, else -1.
    pub fn aft_sign(self) -> f64 {
        match self {
            Self::Left => -1.0,
            Self::Right => 1.0,
        }
    }
}

/// Value that changes linearly from the root to the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearTaper {
    pub root: f64,
    pub tip: f64,
}

impl LinearTaper {
    /// Returns the value at the relative span `eta`.
    pub fn value_at(&self, eta: f64) -> f64 {
        self.root + (self.tip - self.root) * eta
    }
}

/// Wing at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneWing {
    pub side: SceneSide,
    /// X of the bending root, m.
    pub root_x_m: f64,
    /// Y of the bending root, m.
    pub root_y_m: f64,
    /// Z of the bending axis, m.
    pub axis_z_m: f64,
    /// Slope of the axis (dihedral), rad.
    pub slope_rad: LinearTaper,
    /// Edge towards negative Z, from the axis, m.
    pub edge_low_m: LinearTaper,
    /// Edge towards positive Z, from the axis, m.
    pub edge_high_m: LinearTaper,
    /// Skin above the axis, m.
    pub skin_m: LinearTaper,
    /// Drop of the skin from mid-chord to the edges, in chords.
    pub crown: f64,
    /// Waviness of the skin, m.
    pub wave_m: f64,
    /// Beam that bends the axis.
    pub beam: CantileverBeam,
}

impl SceneWing {
    /// Returns the relative span of a station.
    pub fn eta(&self, s: f64) -> f64 {
        s / self.beam.length_m
    }

    /// Returns both edges at a station, m from the axis.
    pub fn edges(&self, s: f64) -> (f64, f64) {
        let eta = self.eta(s);
        (
            self.edge_low_m.value_at(eta),
            self.edge_high_m.value_at(eta),
        )
    }

    /// Returns the height of the skin above the axis, m.
    pub fn skin_height(&self, s: f64, z: f64) -> f64 {
        self.smooth_skin_height(s, z) + self.skin_wave(s, z)
    }

    /// Returns the height of the waves of the skin, m.
    fn skin_wave(&self, s: f64, z: f64) -> f64 {
        self.wave_m * (1.1 * s + 0.7 * z).sin()
    }

    /// Returns the height of the skin without its waves, m.
    fn smooth_skin_height(&self, s: f64, z: f64) -> f64 {
        let (low, high) = self.edges(s);
        let chord = high - low;
        let q = z / chord;
        // The axis lies near mid-chord; the quartic term keeps the crown from being a parabola.
        let drop = self.crown * chord * 4.0 * q * q * (1.0 + 0.3 * q * q);
        self.skin_m.value_at(self.eta(s)) - drop
    }

    /// Deforms the wing by a state.
    pub fn deform(&self, state: &SceneState) -> DeformedWing {
        let step = self.beam.step_m();
        let stations = self.beam.stations();
        let last = (stations - 1) as f64;
        let ground: Vec<f64> = (0..stations)
            .map(|i| self.slope_rad.value_at(i as f64 / last))
            .collect();
        let bent = self.beam.bend(
            &ground,
            &state.load,
            state.tip_deflection_m,
            state.second_mode_m,
        );
        let SceneMotion {
            camera_m,
            root_m,
            root_pitch_rad,
            root_slope_rad,
        } = state.motion;
        let twist = self.beam.twist(state.tip_twist_rad);
        let slope: Vec<f64> = ground
            .iter()
            .zip(&bent.slope_rad)
            .map(|(g, b)| g + b + root_slope_rad)
            .collect();
        // Coordinates are relative to the camera.
        let (cabin_m, wing_m) = (-camera_m, root_m - camera_m);
        let x = running_integral(step, slope.iter().map(|t| t.cos()));
        let y = running_integral(step, slope.iter().map(|t| t.sin()));
        let sections = (0..stations)
            .map(|i| DeformedSection {
                x: self.root_x_m + wing_m.x + state.thermal_scale * x[i],
                y: self.root_y_m + wing_m.y + state.thermal_scale * y[i],
                cos: slope[i].cos(),
                sin: slope[i].sin(),
                twist_cos: (twist[i] + root_pitch_rad).cos(),
                twist_sin: self.side.aft_sign() * (twist[i] + root_pitch_rad).sin(),
            })
            .collect();
        let wing = SceneWing {
            axis_z_m: self.axis_z_m + wing_m.z,
            ..*self
        };
        DeformedWing {
            wing,
            cabin_m,
            scale: state.thermal_scale,
            step_m: step,
            sections,
        }
    }
}

/// Changes between ground and flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneState {
    /// Rise of the axis at its tip by bending, m.
    pub tip_deflection_m: f64,
    /// Amplitude of the second bending mode at the tip, m, in addition to `tip_deflection_m`.
    pub second_mode_m: f64,
    /// Shape of the load.
    pub load: LoadShape,
    /// Nose up positive, rad.
    pub tip_twist_rad: f64,
    /// Length over length on ground.
    pub thermal_scale: f64,
    /// Motion since the ground frame.
    pub motion: SceneMotion,
}

/// Motion of wing and camera relative to the cabin since the ground frame; wing frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SceneMotion {
    /// Translation of the projection centre, m.
    pub camera_m: Vector3<f64>,
    /// Translation of the wing's root, m.
    pub root_m: Vector3<f64>,
    /// Rotation of the root about the span, nose up positive, rad.
    pub root_pitch_rad: f64,
    /// Rotation of the root in the plane of bending, up positive, rad.
    pub root_slope_rad: f64,
}

impl SceneState {
    /// Returns the wing at rest, at the temperature of the survey.
    pub fn ground(load: LoadShape) -> Self {
        let moved = SceneMotion::default();
        Self {
            tip_deflection_m: 0.0,
            second_mode_m: 0.0,
            load,
            tip_twist_rad: 0.0,
            thermal_scale: 1.0,
            motion: moved,
        }
    }
}

/// Section of the deformed wing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeformedSection {
    /// X of the axis, m.
    pub x: f64,
    /// Y of the axis, m.
    pub y: f64,
    /// Cosine of the slope.
    pub cos: f64,
    /// Sine of the slope.
    pub sin: f64,
    /// Cosine of the twist.
    pub twist_cos: f64,
    /// Sine of the twist, positive from Y towards Z: nose up on a right wing, nose down on a left one.
    pub twist_sin: f64,
}

/// Deformed wing.
#[derive(Clone, Debug, PartialEq)]
pub struct DeformedWing {
    /// Wing at rest, at the present position of its root.
    pub wing: SceneWing,
    /// Apparent translation of points rigid to the cabin, m.
    pub cabin_m: Vector3<f64>,
    /// Length over length on ground.
    pub scale: f64,
    step_m: f64,
    sections: Vec<DeformedSection>,
}

impl DeformedWing {
    /// Returns the section at `s`, linear between stations; extrapolated beyond the ends.
    pub fn section_at(&self, s: f64) -> DeformedSection {
        let last = self.sections.len() - 2;
        let position = s / self.step_m;
        let i = (position.max(0.0) as usize).min(last);
        let f = position - i as f64;
        let (a, b) = (&self.sections[i], &self.sections[i + 1]);
        let mix = |p: f64, q: f64| p + f * (q - p);
        DeformedSection {
            x: mix(a.x, b.x),
            y: mix(a.y, b.y),
            cos: mix(a.cos, b.cos),
            sin: mix(a.sin, b.sin),
            twist_cos: mix(a.twist_cos, b.twist_cos),
            twist_sin: mix(a.twist_sin, b.twist_sin),
        }
    }

    /// Returns the skin at material coordinates, wing frame, m.
    pub fn skin_point(&self, s: f64, z: f64) -> Vector3<f64> {
        let section = self.section_at(s);
        let n = self.wing.skin_height(s, z);
        let (cos, sin) = (section.twist_cos, section.twist_sin);
        let up = self.scale * (n * cos - z * sin);
        let across = self.scale * (z * cos + n * sin);
        Vector3::new(
            section.x - section.sin * up,
            section.y + section.cos * up,
            self.wing.axis_z_m + across,
        )
    }

    /// Returns the derivatives of the skin's point along s and z, and the outward unit normal.
    pub fn tangents(&self, s: f64, z: f64) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        // The difference spans one station, so that the table's kinks have no effect.
        let h = self.step_m;
        let ds = (self.skin_point(s + h, z) - self.skin_point(s - h, z)) / (2.0 * h);
        let dz = (self.skin_point(s, z + 1e-4) - self.skin_point(s, z - 1e-4)) / 2e-4;
        (ds, dz, dz.cross(&ds).normalize())
    }

    /// Returns height above the skin (m, ground scale) and z at the crossing of the ray `direction * t` from the origin
    /// with the section plane at `s`.
    pub fn skin_gap(&self, s: f64, direction: &Vector3<f64>) -> (f64, f64) {
        let (gap, z) = self.smooth_gap(s, direction);
        (gap - self.wing.skin_wave(s, z), z)
    }

    /// Returns a gap of the right sign: without the waves where it exceeds them.
    pub fn signed_gap(&self, s: f64, direction: &Vector3<f64>) -> f64 {
        let (gap, z) = self.smooth_gap(s, direction);
        if gap.abs() > self.wing.wave_m {
            gap
        } else {
            gap - self.wing.skin_wave(s, z)
        }
    }

    fn smooth_gap(&self, s: f64, direction: &Vector3<f64>) -> (f64, f64) {
        let section = self.section_at(s);
        let towards = direction.x * section.cos + direction.y * section.sin;
        let t = (section.x * section.cos + section.y * section.sin) / towards;
        let (px, py) = (t * direction.x - section.x, t * direction.y - section.y);
        let up = (py * section.cos - px * section.sin) / self.scale;
        let across = (t * direction.z - self.wing.axis_z_m) / self.scale;
        let (cos, sin) = (section.twist_cos, section.twist_sin);
        let z = across * cos - up * sin;
        (
            up * cos + across * sin - self.wing.smooth_skin_height(s, z),
            z,
        )
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn wing() -> SceneWing {
        SceneWing {
            side: SceneSide::Right,
            root_x_m: 0.5,
            root_y_m: -2.2,
            axis_z_m: 0.1,
            slope_rad: LinearTaper {
                root: 0.08,
                tip: 0.09,
            },
            edge_low_m: LinearTaper {
                root: -3.6,
                tip: -1.2,
            },
            edge_high_m: LinearTaper {
                root: 3.6,
                tip: 1.2,
            },
            skin_m: LinearTaper {
                root: 0.5,
                tip: 0.14,
            },
            crown: 0.05,
            wave_m: 0.0005,
            beam: CantileverBeam {
                length_m: 33.0,
                taper: 0.3,
                stiffness_power: 3.5,
            },
        }
    }

    const LOAD: LoadShape = LoadShape {
        triangular: 0.3,
        relief: 0.2,
    };

    #[test]
    fn the_axis_keeps_its_length_but_for_temperature() {
        let state = SceneState {
            tip_deflection_m: 3.0,
            thermal_scale: 0.9984,
            ..SceneState::ground(LOAD)
        };
        let pose = wing().deform(&state);
        let length: f64 = pose
            .sections
            .windows(2)
            .map(|p| (p[1].x - p[0].x).hypot(p[1].y - p[0].y))
            .sum();
        assert!((length - 33.0 * 0.9984).abs() < 1e-6, "{length}");
    }

    #[test]
    fn twist_raises_the_leading_edge_on_both_sides() {
        for side in [SceneSide::Left, SceneSide::Right] {
            let wing = SceneWing { side, ..wing() };
            let state = SceneState {
                tip_twist_rad: 0.05,
                ..SceneState::ground(LOAD)
            };
            let (ground, flight) = (wing.deform(&SceneState::ground(LOAD)), wing.deform(&state));
            let leading = -side.aft_sign();
            let deflection =
                flight.skin_point(32.0, leading).y - ground.skin_point(32.0, leading).y;
            assert!(deflection > 0.03, "{side:?} {deflection}");
        }
    }

    #[test]
    fn the_gap_is_zero_on_the_skin() {
        let state = SceneState {
            tip_deflection_m: 2.0,
            tip_twist_rad: 0.03,
            thermal_scale: 0.9984,
            ..SceneState::ground(LOAD)
        };
        let pose = wing().deform(&state);
        for (s, z) in [(6.0, 1.0), (20.03, -1.3), (32.5, 0.4)] {
            let point = pose.skin_point(s, z);
            let (gap, across) = pose.skin_gap(s, &point.normalize());
            assert!(
                gap.abs() < 1e-7 && (across - z).abs() < 1e-7,
                "{gap} {across}"
            );
        }
    }
}
