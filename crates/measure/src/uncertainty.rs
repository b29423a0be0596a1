//! Uncertainty of a setup: widths, motions during the readout, and the covariance of the lens.

use nalgebra::SMatrix;

use super::widths::Width;

/// A vibration that the rows of a frame sample at different times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Amplitude at the tip, m, or of the camera's rotation, rad.
    pub amplitude: f64,
    pub frequency_hz: f64,
    /// Whether the frames of a flight may estimate the amplitude: it is a default, not configured.
    pub scaled_by_frames: bool,
}

/// Number of widths.
const WIDTHS: usize = Width::ROWS.len();

/// Prior standard deviations of quantities that a user can only estimate (reasons in docs/adjustment/installation.md). The
/// index of a width is its [`Width`]; its value is in radians, metres, pixels or seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetupUncertainty {
    /// Values of the widths, in the order of their rows.
    pub widths: [f64; WIDTHS],
    /// Whether the frames of a flight may estimate the motion of the skin: it is a default, not configured.
    pub skin_scaled_by_frames: bool,
    /// Vibration of the wing.
    pub vibration: Vibration,
    /// Vibration of the camera.
    pub shake: Vibration,
    /// Covariance of fx, fy, cx, cy, k1, k2, k3, p1, p2 from the calibration; `None`: fixed.
    pub lens: Option<SMatrix<f64, 9, 9>>,
}

impl SetupUncertainty {
    /// Defaults of an installation, for an airliner.
    pub const DEFAULT: Self = Self {
        widths: {
            let mut widths = [0.0; WIDTHS];
            let mut k = 0;
            while k < WIDTHS {
                widths[k] = Width::ROWS[k].unit.factor * Width::ROWS[k].default;
                k += 1;
            }
            widths
        },
        skin_scaled_by_frames: true,
        // An airliner's first mode in light turbulence.
        vibration: Vibration {
            amplitude: 0.01,
            frequency_hz: 3.0,
            scaled_by_frames: true,
        },
        // A camera on a seat rail, by engines and floor: 0.2 px.
        shake: Vibration {
            amplitude: 3e-5,
            frequency_hz: 15.0,
            scaled_by_frames: true,
        },
        lens: None,
    };

    /// Returns the defaults of a wing of this length, from the root to the outermost marker, m.
    pub fn default_for(reach_m: f64) -> Self {
        let mut defaults = Self::DEFAULT;
        Width::ROWS
            .iter()
            .for_each(|row| defaults[row.width] = row.default_for(reach_m));
        defaults
    }

    /// Returns the priors of drawings that are accurate to some millimetres and a mount that neither shifts nor creeps,
    /// without effects of flight, for rendered scenes.
    pub const fn from_drawings() -> Self {
        let none = Vibration {
            amplitude: 0.0,
            frequency_hz: 0.0,
            scaled_by_frames: false,
        };
        Self {
            widths: [0.0; WIDTHS],
            skin_scaled_by_frames: false,
            vibration: none,
            shake: none,
            lens: None,
        }
        .with_width(Width::SkinHeight, 0.003)
    }

    /// Returns the priors with another value of one width.
    pub const fn with_width(mut self, width: Width, value: f64) -> Self {
        self.widths[width as usize] = value;
        self
    }

    /// Returns the priors with the effects of flight of `other`.
    pub fn with_flight_effects(mut self, other: &Self) -> Self {
        Width::ROWS
            .iter()
            .filter(|row| row.of_flight)
            .for_each(|row| self[row.width] = other[row.width]);
        Self {
            widths: self.widths,
            lens: self.lens,
            ..*other
        }
    }

    /// Returns whether any effect of flight is possible, unlike in a laboratory.
    pub fn has_flight_effects(&self) -> bool {
        Width::ROWS
            .iter()
            .any(|row| row.of_flight && self[row.width] > 0.0)
    }

    /// Returns these priors as fixed ones that the frames of a flight do not scale.
    pub fn without_frame_scaling(mut self) -> Self {
        (
            self.skin_scaled_by_frames,
            self.vibration.scaled_by_frames,
            self.shake.scaled_by_frames,
        ) = (false, false, false);
        self
    }
}

impl std::ops::Index<Width> for SetupUncertainty {
    type Output = f64;

    fn index(&self, width: Width) -> &f64 {
        &self.widths[width as usize]
    }
}

impl std::ops::IndexMut<Width> for SetupUncertainty {
    fn index_mut(&mut self, width: Width) -> &mut f64 {
        &mut self.widths[width as usize]
    }
}
