//! Refractive index of air and refraction of rays at the cabin window.
//!
//! Ciddor, Refractive index of air: new equations for the visible and near infrared, Appl. Opt. 35 (1996) 1566, with the
//! constants of its Appendix A.

use nalgebra::{Vector2, Vector3};

use crate::geometry::LensError;
use crate::observation::Observation;
use crate::setup::{Air, Orientation, Setup, Window};

/// Incidence assumed if the window's normal is not known: the paper's 30 degrees.
pub const PAPER_INCIDENCE_RAD: f64 = std::f64::consts::FRAC_PI_6;

const GAS_CONSTANT: f64 = 8.314_510;
const WATER_MOLAR_MASS: f64 = 0.018_015;
const KELVIN: f64 = 273.15;

/// Returns the phase refractive index of moist air for a wavelength in vacuum (Ciddor 1996).
pub fn refractive_index(air: &Air, wavelength_nm: f64) -> f64 {
    let wavenumber2 = (1000.0 / wavelength_nm).powi(2);
    let dry_mass = dry_molar_mass(air.co2_ppm);
    let (t, p) = (air.temperature_c, 100.0 * air.pressure_hpa);
    let x = water_fraction(air);
    let moles = molar_density(t, p, x);
    let standard_dry = dry_mass * molar_density(15.0, 101_325.0, 0.0);
    let standard_vapour = WATER_MOLAR_MASS * molar_density(20.0, 1333.0, 1.0);
    let dry =
        dry_mass * (1.0 - x) * moles / standard_dry * dry_refractivity(wavenumber2, air.co2_ppm);
    let vapour = WATER_MOLAR_MASS * x * moles / standard_vapour * vapour_refractivity(wavenumber2);
    1.0 + dry + vapour
}

/// Returns n - 1 of dry air at 15 C, 101325 Pa (equations 1 and 2); wavenumber squared in 1/um^2.
fn dry_refractivity(wavenumber2: f64, co2_ppm: f64) -> f64 {
    let standard = 5_792_105.0 / (238.0185 - wavenumber2) + 167_917.0 / (57.362 - wavenumber2);
    1e-8 * standard * (1.0 + 0.534e-6 * (co2_ppm - 450.0))
}

/// Returns n - 1 of pure water vapour at 20 C, 1333 Pa (equation 3).
fn vapour_refractivity(w2: f64) -> f64 {
    1.022e-8 * (295.235 + w2 * (2.6422 + w2 * (-0.032_380 + w2 * 0.004_028)))
}

/// Returns the molar mass of dry air, kg/mol.
fn dry_molar_mass(co2_ppm: f64) -> f64 {
    1e-3 * (28.9635 + 12.011e-6 * (co2_ppm - 400.0))
}

/// Returns the moles of gas per m^3: p / (Z R T), compressibility Z by Davis (equation 12).
fn molar_density(t: f64, pressure_pa: f64, x: f64) -> f64 {
    let kelvin = t + KELVIN;
    let ratio = pressure_pa / kelvin;
    let first = 1.581_23e-6 - 2.9331e-8 * t
        + 1.1043e-10 * t * t
        + (5.707e-6 - 2.051e-8 * t) * x
        + (1.9898e-4 - 2.376e-6 * t) * x * x;
    let compressibility = 1.0 - ratio * first + ratio * ratio * (1.83e-11 - 0.765e-8 * x * x);
    ratio / (compressibility * GAS_CONSTANT)
}

/// Returns the mole fraction of water vapour, with the enhancement factor of water in air.
fn water_fraction(air: &Air) -> f64 {
    let pressure_pa = 100.0 * air.pressure_hpa;
    let t = air.temperature_c;
    let enhancement = 1.000_62 + 3.14e-8 * pressure_pa + 5.60e-7 * t * t;
    (enhancement * air.humidity * saturation_pressure_pa(t) / pressure_pa).clamp(0.0, 1.0)
}

/// Returns the saturation vapour pressure: over water by Davis (Ciddor, Appendix A), below 0 C over ice by Wagner, Saul and
/// Pruss (1994).
fn saturation_pressure_pa(t: f64) -> f64 {
    let kelvin = t + KELVIN;
    if t >= 0.0 {
        let exponent = 1.237_884_7e-5 * kelvin * kelvin - 1.912_131_6e-2 * kelvin + 33.937_110_47
            - 6.343_164_5e3 / kelvin;
        return exponent.exp();
    }
    let theta = kelvin / 273.16;
    let exponent =
        -13.928_169 * (1.0 - theta.powf(-1.5)) + 34.707_823_8 * (1.0 - theta.powf(-1.25));
    611.657 * exponent.exp()
}

/// Returns the change of direction at a flat window for an incidence in the cabin, rad; positive away from the normal
/// outside (thinner air). A plane-parallel pane deflects no ray, so only the air counts.
pub fn deflection_rad(window: &Window, incidence_rad: f64) -> f64 {
    let sine = index_ratio(window) * incidence_rad.sin();
    sine.clamp(-1.0, 1.0).asin() - incidence_rad
}

/// Returns the refraction in pixels at the image centre of a camera that looks straight along the ray.
pub fn refraction_shift_px(window: &Window, incidence_rad: f64, focal_px: f64) -> f64 {
    focal_px * deflection_rad(window, incidence_rad).tan()
}

/// Returns the direction outside of a ray that the camera sees, by Snell's law; `outward_normal` of the window and `ray` of
/// unit length in one frame. `None` beyond total reflection or if the ray does not leave through the window.
pub fn refract_ray(
    ray: &Vector3<f64>,
    outward_normal: &Vector3<f64>,
    index_ratio: f64,
) -> Option<Vector3<f64>> {
    let cosine = ray.dot(outward_normal);
    let squared = 1.0 - index_ratio * index_ratio * (1.0 - cosine * cosine);
    (cosine > 0.0 && squared >= 0.0)
        .then(|| ray * index_ratio + outward_normal * (squared.sqrt() - index_ratio * cosine))
}

/// Returns the index in the cabin over that outside.
fn index_ratio(window: &Window) -> f64 {
    refractive_index(&window.cabin, window.wavelength_nm)
        / refractive_index(&window.outside, window.wavelength_nm)
}

/// Refraction at the window in one frame.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RefractionReport {
    /// True if the pixels were corrected (the window's normal is known).
    pub applied: bool,
    /// Largest shift over the observations, px; if not applied, the shift at the image centre for an incidence of 30
    /// degrees.
    pub max_shift_px: f64,
    /// Index of the air in the cabin.
    pub index_cabin: f64,
    /// Index of the air outside.
    pub index_outside: f64,
    /// Standard deviation of the largest shift, px, if the air was measured; `None` for constants.
    pub sigma_max_shift_px: Option<f64>,
}

/// Removes the window's refraction from pixels, in place. For frames in flight only: on ground cabin and outside air are
/// equal, so the orientation is valid for unrefracted rays. Returns `None` without a configured window. The covariances are
/// unchanged (the shift varies by 1e-4 of itself).
///
/// # Errors
/// Returns an error if the distortion has no inverse at a pixel.
pub fn correct_observations(
    setup: &Setup,
    orientation: &Orientation,
    observations: &mut [Observation],
) -> Result<Option<RefractionReport>, LensError> {
    let Some(window) = &setup.window else {
        return Ok(None);
    };
    let mut report = RefractionReport {
        applied: window.normal.is_some(),
        max_shift_px: refraction_shift_px(window, PAPER_INCIDENCE_RAD, setup.lens.focal_px()),
        index_cabin: refractive_index(&window.cabin, window.wavelength_nm),
        index_outside: refractive_index(&window.outside, window.wavelength_nm),
        sigma_max_shift_px: None,
    };
    if let Some(normal) = window.normal {
        report.max_shift_px = 0.0;
        let normal = orientation.camera_from_survey * normal.normalize();
        for observation in observations {
            let corrected =
                unrefracted_pixel(setup, &normal, index_ratio(window), &observation.pixel)?;
            report.max_shift_px = report
                .max_shift_px
                .max((corrected - observation.pixel).norm());
            observation.pixel = corrected;
        }
    }
    Ok(Some(report))
}

/// Returns the pixel without refraction; a ray that cannot have come through the window keeps its pixel.
fn unrefracted_pixel(
    setup: &Setup,
    normal_camera: &Vector3<f64>,
    ratio: f64,
    pixel: &Vector2<f64>,
) -> Result<Vector2<f64>, LensError> {
    let ray = setup.lens.ray(pixel)?;
    let outside = refract_ray(&ray, normal_camera, ratio).and_then(|r| setup.lens.project(&r));
    Ok(outside.unwrap_or(*pixel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn air(temperature_c: f64, pressure_hpa: f64, humidity: f64) -> Air {
        Air {
            temperature_c,
            pressure_hpa,
            humidity,
            co2_ppm: 450.0,
        }
    }

    /// ICAO standard atmosphere at flight level 370.
    fn cruise(cabin: Air) -> Window {
        Window {
            normal: None,
            cabin,
            outside: air(-56.5, 216.6, 0.0),
            wavelength_nm: 550.0,
            pane: None,
        }
    }

    #[test]
    fn published_dry_air() {
        // Ciddor 1996, table 1: 633 nm, 450 ppm, dry; 1e8 (n - 1), printed to 0.1.
        let table = [
            (20.0, 800.0, 21_458.0),
            (20.0, 1000.0, 26_824.4),
            (20.0, 1200.0, 32_191.6),
            (10.0, 1000.0, 27_774.7),
            (30.0, 1000.0, 25_937.2),
        ];
        for (t, p, expected) in table {
            let refractivity = 1e8 * (refractive_index(&air(t, p, 0.0), 633.0) - 1.0);
            assert!(
                (refractivity - expected).abs() < 0.051,
                "{t} {p}: {refractivity}"
            );
        }
        let check = refractive_index(&air(20.0, 1013.25, 0.0), 633.0) - 1.0;
        assert!((check - 2.71800e-4).abs() < 0.5e-9, "{check}");
    }

    #[test]
    fn published_moist_and_extreme_air() {
        // NIST's test values (saturation pressure by IAPWS there, hence 2e-9 in moist air).
        let table = [
            (20.0, 600.0, 0.0, 633.0, 1.000_160_924),
            (50.0, 1000.0, 0.0, 633.0, 1.000_243_285),
            (5.0, 1000.0, 0.0, 633.0, 1.000_282_756),
            (-40.0, 1000.0, 0.0, 633.0, 1.000_337_580),
            (20.0, 1013.25, 0.0, 1700.0, 1.000_268_479),
            (-40.0, 1200.0, 0.0, 300.0, 1.000_427_233),
            (20.0, 1000.0, 1.0, 633.0, 1.000_267_394),
            (40.0, 1200.0, 0.75, 633.0, 1.000_299_418),
            (50.0, 1200.0, 1.0, 633.0, 1.000_287_924),
            (40.0, 1100.0, 1.0, 300.0, 1.000_289_000),
        ];
        for (t, p, humidity, wavelength_nm, expected) in table {
            let index = refractive_index(&air(t, p, humidity), wavelength_nm);
            let tolerance = if humidity > 0.0 { 2e-9 } else { 0.6e-9 };
            assert!(
                (index - expected).abs() < tolerance,
                "{t} {p} {humidity}: {index}"
            );
        }
    }

    #[test]
    fn the_figures_of_the_paper_are_reproduced() {
        let window = cruise(air(15.0, 1013.25, 0.0));
        let angle = deflection_rad(&window, PAPER_INCIDENCE_RAD);
        assert!(
            (angle.to_degrees() - 0.00658).abs() < 0.5e-5,
            "{}",
            angle.to_degrees()
        );
        assert!((35.0 * angle.tan() - 4.02e-3).abs() < 0.5e-5);
        let shift = refraction_shift_px(&window, PAPER_INCIDENCE_RAD, 7800.0);
        assert!((shift - 0.895).abs() < 1e-3, "{shift}");
    }

    #[test]
    fn a_cabin_at_8000_feet_reduces_refraction_by_40_percent() {
        let window = cruise(air(20.0, 752.6, 0.0));
        let angle = deflection_rad(&window, PAPER_INCIDENCE_RAD);
        // Manually: 550 nm, ideal gas, (2.782e-4 * 0.7428 * 288.15/293.15 - 0.79e-4) tan 30 deg.
        assert!(
            (angle.to_degrees() - 0.0041).abs() < 0.5e-4,
            "{}",
            angle.to_degrees()
        );
        let shift = refraction_shift_px(&window, PAPER_INCIDENCE_RAD, 7800.0);
        assert!((shift - 0.557).abs() < 2e-3, "{shift}");
    }

    proptest! {
        #[test]
        fn snell_in_space_is_snell_in_the_plane(
            x in -1.0..1.0f64, y in -1.0..1.0f64, tilt in -0.6..0.6f64,
        ) {
            let ray = Vector3::new(x, y, 1.5).normalize();
            let normal = Vector3::new(tilt.sin(), 0.0, tilt.cos());
            let window = cruise(air(22.0, 780.0, 0.1));
            let outside = refract_ray(&ray, &normal, index_ratio(&window)).unwrap();
            prop_assert!((outside.norm() - 1.0).abs() < 1e-12);
            prop_assert!(outside.dot(&ray.cross(&normal)).abs() < 1e-12);
            let incidence = ray.dot(&normal).acos();
            let turned = outside.cross(&ray).norm().asin();
            prop_assert!((turned - deflection_rad(&window, incidence)).abs() < 1e-10);
        }
    }
}
