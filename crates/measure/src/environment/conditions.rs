//! Air and wing measured in flight, in place of an installation's constants.

use super::refraction::refractive_index;
use crate::observation::Estimate;
use crate::setup::{Setup, Window};

/// Measured conditions of a flight; `None`: the installation's constant is used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlightConditions {
    pub cabin_pressure_hpa: Option<Estimate>,
    pub outside_pressure_hpa: Option<Estimate>,
    /// Temperature of the air outside, degrees Celsius.
    pub outside_temperature_c: Option<Estimate>,
    /// Temperature of the wing, degrees Celsius.
    pub wing_temperature_c: Option<Estimate>,
}

impl FlightConditions {
    /// Replaces the installation's constants by the measured values.
    pub fn apply(&self, setup: &mut Setup) {
        if let Some(window) = &mut setup.window {
            self.apply_to_window(window);
        }
        if let (Some(thermal), Some(wing)) = (&mut setup.thermal, self.wing_temperature_c) {
            thermal.flight_temperature_c = wing.value;
            thermal.flight_temperature_sigma_k = wing.sigma;
        }
    }

    fn apply_to_window(&self, window: &mut Window) {
        let set = |place: &mut f64, known: Option<Estimate>| {
            if let Some(known) = known {
                *place = known.value;
            }
        };
        set(&mut window.cabin.pressure_hpa, self.cabin_pressure_hpa);
        set(&mut window.outside.pressure_hpa, self.outside_pressure_hpa);
        set(
            &mut window.outside.temperature_c,
            self.outside_temperature_c,
        );
    }

    /// Returns the relative standard deviation of the refraction from those of the measured air. A shift is proportional to
    /// the deviation of the indices' ratio from 1.
    pub fn relative_refraction_sigma(&self, window: &Window) -> f64 {
        let excess = |window: &Window| {
            refractive_index(&window.cabin, window.wavelength_nm)
                / refractive_index(&window.outside, window.wavelength_nm)
                - 1.0
        };
        let mut nominal = window.clone();
        self.apply_to_window(&mut nominal);
        let moved = |change: fn(&mut Window, f64), known: Option<Estimate>| {
            let mut other = nominal.clone();
            change(&mut other, known.and_then(|k| k.sigma).unwrap_or(0.0));
            excess(&other) - excess(&nominal)
        };
        let by_cabin = moved(|w, by| w.cabin.pressure_hpa += by, self.cabin_pressure_hpa);
        let by_pressure = moved(
            |w, by| w.outside.pressure_hpa += by,
            self.outside_pressure_hpa,
        );
        let by_temperature = moved(
            |w, by| w.outside.temperature_c += by,
            self.outside_temperature_c,
        );
        (by_cabin.hypot(by_pressure).hypot(by_temperature) / excess(&nominal)).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::Air;

    #[test]
    fn measured_air_replaces_the_constants_with_its_sigma() {
        let air = |temperature_c, pressure_hpa| Air {
            temperature_c,
            pressure_hpa,
            humidity: 0.0,
            co2_ppm: 450.0,
        };
        let window = Window {
            normal: None,
            cabin: air(22.0, 752.6),
            outside: air(-56.5, 216.6),
            wavelength_nm: 550.0,
            pane: None,
        };
        let known = |value, sigma| {
            Some(Estimate {
                value,
                sigma: Some(sigma),
            })
        };
        let measured = FlightConditions {
            cabin_pressure_hpa: known(800.0, 8.0),
            ..FlightConditions::default()
        };
        let mut set = window.clone();
        measured.apply_to_window(&mut set);
        assert_eq!(
            (set.cabin.pressure_hpa, set.outside),
            (800.0, window.outside)
        );
        // n - 1 is proportional to the pressure: 1 % of the cabin's 211e-6 over the difference to the
        // outside's 79e-6.
        let share = measured.relative_refraction_sigma(&window);
        assert!((share - 0.01 * 2.1 / (2.1 - 0.79)).abs() < 1e-3, "{share}");
        assert_eq!(
            FlightConditions::default().relative_refraction_sigma(&window),
            0.0
        );
    }
}
