//! Air outside the window and in the cabin, and the wing's temperature, derived from the aircraft data.

use super::Quantity;
use super::join::{AircraftState, JoinedValue};
use wingd_measure::adjust::Estimate;
use wingd_measure::environment::FlightConditions;

const KELVIN: f64 = 273.15;
/// Half of the ratio of specific heats minus 1, for air.
const HALF_GAMMA_LESS_ONE: f64 = 0.2;
/// Recovery factor of a turbulent boundary layer (fraction of the dynamic heating that reaches the skin): cube root of the
/// Prandtl number, 0.71.
const RECOVERY_FACTOR: f64 = 0.89;
/// Standard deviation of the structure's temperature from that of the stagnant air, K: fuel and lag (an assumption; half of
/// the default without measurements).
const STRUCTURE_SIGMA_K: f64 = 7.0;

/// Computes the pressure of the standard atmosphere (ISO 2533) up to 20 km at a pressure altitude in m: hPa, and its
/// derivative.
fn pressure_hpa(altitude_m: f64) -> (f64, f64) {
    if altitude_m < 11_000.0 {
        let base = 1.0 - 2.255_77e-5 * altitude_m;
        let pressure = 1013.25 * base.powf(5.255_88);
        return (pressure, -5.255_88 * 2.255_77e-5 * pressure / base);
    }
    let pressure = 226.321 * ((11_000.0 - altitude_m) / 6341.62).exp();
    (pressure, -pressure / 6341.62)
}

/// Derives the flight conditions from the aircraft data; a value that they do not have is `None`.
pub fn flight_conditions(state: &AircraftState) -> FlightConditions {
    let of = |q: Quantity| {
        state
            .get(&q)
            .map(|JoinedValue { value, sigma, .. }| (*value, *sigma))
    };
    let by_altitude = || {
        let (altitude, sigma) = of(Quantity::PressureAltitudeM)?;
        let (pressure, slope) = pressure_hpa(altitude);
        Some((pressure, slope.abs() * sigma))
    };
    let mach = of(Quantity::Mach);
    let static_c = of(Quantity::StaticTemperatureC).or_else(|| {
        let ((total, sigma), (mach, mach_sigma)) = (of(Quantity::TotalTemperatureC)?, mach?);
        let heating = 1.0 + HALF_GAMMA_LESS_ONE * mach * mach;
        let kelvin = (total + KELVIN) / heating;
        let by_mach = kelvin / heating * 2.0 * HALF_GAMMA_LESS_ONE * mach * mach_sigma;
        Some((kelvin - KELVIN, (sigma / heating).hypot(by_mach)))
    });
    let wing_c = static_c
        .zip(mach)
        .map(|((static_c, sigma), (mach, mach_sigma))| {
            let heating = 1.0 + RECOVERY_FACTOR * HALF_GAMMA_LESS_ONE * mach * mach;
            let kelvin = static_c + KELVIN;
            let by_mach = kelvin * 2.0 * RECOVERY_FACTOR * HALF_GAMMA_LESS_ONE * mach * mach_sigma;
            (
                kelvin * heating - KELVIN,
                (sigma * heating).hypot(by_mach).hypot(STRUCTURE_SIGMA_K),
            )
        });
    let estimate = |pair: Option<(f64, f64)>| {
        pair.map(|(value, sigma)| Estimate {
            value,
            sigma: Some(sigma),
        })
    };
    FlightConditions {
        cabin_pressure_hpa: estimate(of(Quantity::CabinPressureHpa)),
        outside_pressure_hpa: estimate(of(Quantity::StaticPressureHpa).or_else(by_altitude)),
        outside_temperature_c: estimate(static_c),
        wing_temperature_c: estimate(wing_c),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(values: &[(Quantity, f64, f64)]) -> AircraftState {
        values
            .iter()
            .map(|(q, value, sigma)| {
                (
                    *q,
                    JoinedValue {
                        value: *value,
                        sigma: *sigma,
                        apart_s: 0.1,
                        source: 1,
                    },
                )
            })
            .collect()
    }

    #[test]
    fn altitude_and_total_temperature_are_substitutes() {
        let found = flight_conditions(&state(&[
            (Quantity::PressureAltitudeM, 11_277.6, 30.0),
            (Quantity::TotalTemperatureC, -30.1, 0.5),
            (Quantity::Mach, 0.78, 0.005),
        ]));
        // ICAO standard atmosphere at flight level 370: 216.6 hPa; 216.65 K.
        let pressure = found.outside_pressure_hpa.unwrap();
        assert!(
            (pressure.value - 216.6).abs() < 0.1 && (pressure.sigma.unwrap() - 1.02).abs() < 0.02
        );
        let outside = found.outside_temperature_c.unwrap();
        assert!((outside.value + 56.5).abs() < 0.1 && (0.4..0.8).contains(&outside.sigma.unwrap()));
        let wing = found.wing_temperature_c.unwrap();
        assert!(
            (wing.value + 33.0).abs() < 0.3 && (7.0..7.1).contains(&wing.sigma.unwrap()),
            "{wing:?}"
        );
        assert_eq!(found.cabin_pressure_hpa, None);
    }

    #[test]
    fn pressure_matches_the_standard_atmosphere() {
        for (altitude, pressure) in [
            (0.0, 1013.25),
            (5000.0, 540.2),
            (11_000.0, 226.32),
            (15_000.0, 120.45),
        ] {
            let (found, slope) = pressure_hpa(altitude);
            assert!((found - pressure).abs() < 0.1, "{altitude}: {found}");
            let numeric = (pressure_hpa(altitude + 1.0).0 - found) / 1.0;
            assert!((slope - numeric).abs() < 1e-3 * slope.abs());
        }
        assert_eq!(
            flight_conditions(&AircraftState::new()),
            FlightConditions::default()
        );
    }
}
