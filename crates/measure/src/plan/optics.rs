//! Depth of field and diffraction.

use serde::{Deserialize, Serialize};

/// Nominal data of lens and sensor, as in `[camera.optics]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    pub focal_length_mm: f64,
    pub f_number: f64,
    /// Distance of two pixel centres, um.
    pub pixel_pitch_um: f64,
    /// Largest blur disc that counts as sharp, um; two pixels if not given.
    pub circle_of_confusion_um: Option<f64>,
}

/// Wavelength for the Airy disc, um.
const GREEN_UM: f64 = 0.55;

/// Depth of field and diffraction for a range of distances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OpticsPlan {
    /// Data of lens and sensor.
    pub optics: Optics,
    /// Largest blur disc that counts as sharp, um.
    pub circle_of_confusion_um: f64,
    /// Focus at which everything from half of this distance to infinity is sharp, m.
    pub hyperfocal_m: f64,
    /// Distance of the nearest marker, m.
    pub nearest_m: f64,
    /// Distance of the farthest marker, m.
    pub farthest_m: f64,
    /// Focus with equal blur of the nearest and the farthest marker, m.
    pub best_focus_m: f64,
    /// Nearest sharp distance when focused at `best_focus_m`, m.
    pub near_limit_m: f64,
    /// Farthest sharp distance when focused at `best_focus_m`, m; `None`: infinity.
    pub far_limit_m: Option<f64>,
    /// Diameter of the blur disc at the nearest and farthest marker, um.
    pub blur_um: f64,
    /// Whether the blur is within the circle of confusion.
    pub sharp: bool,
    /// Diameter of the Airy disc at 550 nm, um.
    pub airy_um: f64,
    /// Diameter of the Airy disc at 550 nm, px.
    pub airy_px: f64,
}

impl OpticsPlan {
    /// Computes the optics for markers between two distances, m.
    pub fn new(optics: &Optics, nearest_m: f64, farthest_m: f64) -> Self {
        let confusion_um = optics
            .circle_of_confusion_um
            .unwrap_or(2.0 * optics.pixel_pitch_um);
        let focal_m = 1e-3 * optics.focal_length_mm;
        let power = focal_m * focal_m / optics.f_number;
        let hyperfocal_m = power / (1e-6 * confusion_um) + focal_m;
        let best = 2.0 * nearest_m * farthest_m / (nearest_m + farthest_m);
        let reach = hyperfocal_m - focal_m;
        let far_limit_m = (best < reach).then(|| reach * best / (reach - best));
        let blur_um = 1e6 * power * (farthest_m - nearest_m) / (2.0 * nearest_m * farthest_m);
        let airy_um = 2.44 * GREEN_UM * optics.f_number;
        Self {
            optics: *optics,
            circle_of_confusion_um: confusion_um,
            hyperfocal_m,
            nearest_m,
            farthest_m,
            best_focus_m: best,
            near_limit_m: reach * best / (reach + best),
            far_limit_m,
            blur_um,
            // The last digit of a stated circle of confusion is rounded.
            sharp: blur_um <= 1.001 * confusion_um,
            airy_um,
            airy_px: airy_um / optics.pixel_pitch_um,
        }
    }

    /// Returns the diameter of the blur disc at a distance, m, when focused at `best_focus_m`, px.
    pub fn blur_px(&self, distance_m: f64) -> f64 {
        let Optics {
            focal_length_mm,
            f_number,
            pixel_pitch_um,
            ..
        } = self.optics;
        let power = 1e-6 * focal_length_mm * focal_length_mm / f_number;
        1e6 * power * (1.0 / distance_m - 1.0 / self.best_focus_m).abs() / pixel_pitch_um
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_lens_covers_5_to_40_metres() {
        let optics = Optics {
            focal_length_mm: 12.0,
            f_number: 4.0,
            pixel_pitch_um: 1.54,
            circle_of_confusion_um: Some(3.15),
        };
        let plan = OpticsPlan::new(&optics, 5.0, 40.0);
        assert!(plan.sharp && (plan.blur_um - 3.15).abs() < 1e-9, "{plan:?}");
        assert!((plan.near_limit_m - 5.0).abs() < 1e-6);
        assert!((plan.far_limit_m.unwrap_or(f64::NAN) - 40.0).abs() < 1e-6);
        assert!((plan.hyperfocal_m - 11.44).abs() < 0.005);
        // Diffraction: 5.4 um, 3.5 px, not the paper's two pixels of 2.2 um.
        assert!((plan.airy_um - 5.4).abs() < 0.05 && (plan.airy_px - 3.5).abs() < 0.05);
        // At both ends alike, and more towards the camera.
        assert!(
            [5.0, 40.0]
                .iter()
                .all(|d| (plan.blur_px(*d) - 3.15 / 1.54).abs() < 1e-9)
        );
        assert!(
            (plan.blur_px(3.0) - 1e6 * 36e-6 * (1.0 / 3.0 - 1.0 / plan.best_focus_m) / 1.54).abs()
                < 1e-9
        );
        let open = OpticsPlan::new(
            &Optics {
                f_number: 2.0,
                ..optics
            },
            5.0,
            40.0,
        );
        assert!(!open.sharp && (open.blur_um - 6.3).abs() < 1e-9);
    }
}
