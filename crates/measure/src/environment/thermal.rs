//! Uniform thermal expansion with its uncertainty.

use crate::observation::Estimate;
use crate::setup::Thermal;

/// Returns length in flight over length on ground. The standard deviation follows from those of the coefficient and of the
/// flight temperature; `None` if neither is configured.
pub fn scale_with_sigma(thermal: &Thermal) -> Estimate {
    let difference_k = thermal.flight_temperature_c - thermal.ground_temperature_c;
    let by_coefficient = thermal
        .expansion_sigma_per_k
        .map(|sigma| sigma * difference_k);
    let by_temperature = thermal
        .flight_temperature_sigma_k
        .map(|sigma| sigma * thermal.expansion_per_k);
    let sigma = match (by_coefficient, by_temperature) {
        (None, None) => None,
        (c, t) => Some(c.unwrap_or(0.0).hypot(t.unwrap_or(0.0))),
    };
    Estimate {
        value: thermal.scale(),
        sigma,
    }
}

/// Returns the change of a length measured on ground, m; negative if it shrinks.
pub fn length_change_m(thermal: &Thermal, length_m: f64) -> Estimate {
    let scale = scale_with_sigma(thermal);
    Estimate {
        value: (scale.value - 1.0) * length_m,
        sigma: scale.sigma.map(|s| s * length_m.abs()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn aluminium() -> Thermal {
        Thermal {
            expansion_per_k: 23.1e-6,
            expansion_sigma_per_k: None,
            ground_temperature_c: 15.0,
            flight_temperature_c: -55.0,
            flight_temperature_sigma_k: None,
        }
    }

    #[test]
    fn forty_metres_of_aluminium_shrink_by_65_mm() {
        let change = length_change_m(&aluminium(), 40.0);
        assert!((change.value + 0.06468).abs() < 1e-9, "{}", change.value);
        assert_eq!(change.sigma, None);
    }

    #[test]
    fn both_uncertainties_count() {
        let thermal = Thermal {
            expansion_sigma_per_k: Some(0.3e-6),
            flight_temperature_sigma_k: Some(5.0),
            ..aluminium()
        };
        let sigma_m = length_change_m(&thermal, 40.0).sigma.unwrap_or(f64::NAN);
        let expected = 40.0 * (0.3e-6f64 * 70.0).hypot(23.1e-6 * 5.0);
        assert!((sigma_m - expected).abs() < 1e-12);
    }
}
