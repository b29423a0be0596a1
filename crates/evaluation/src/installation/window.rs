//! `[window]` of installation.toml: the air on both sides, and the panes between.

use std::path::Path;

use nalgebra::Vector3;

use super::{Reader, tables};
use wingd_measure::setup::{Air, Pane, Window};

/// Default air: in the cabin as at 8,000 ft, outside as in the standard atmosphere at flight level 370.
const DEFAULT_CABIN: Air = Air {
    temperature_c: 22.0,
    pressure_hpa: 752.6,
    humidity: 0.1,
    co2_ppm: 800.0,
};
const DEFAULT_OUTSIDE: Air = Air {
    temperature_c: -56.5,
    pressure_hpa: 216.6,
    humidity: 0.0,
    co2_ppm: 420.0,
};

pub(super) fn read_window(
    reader: &mut Reader,
    file: &Path,
    table: Option<&tables::WindowTable>,
) -> Option<Window> {
    let table = table?;
    let cabin = read_air(table.cabin.as_ref(), DEFAULT_CABIN);
    let outside = read_air(table.outside.as_ref(), DEFAULT_OUTSIDE);
    let wavelength_nm = table.wavelength_nm.unwrap_or(550.0);
    let normal = table.normal.map(Vector3::from);
    if let Some(n) = normal.filter(|n| !(n.norm() > 1e-6 && n.norm().is_finite())) {
        let problem = format!("is [{}, {}, {}]", n.x, n.y, n.z);
        reader.fault(
            file,
            "window.normal",
            problem,
            "give the outward normal in the survey frame",
        );
    }
    let normal = normal.map(|n| n.normalize());
    let pane = read_pane(reader, file, table);
    Some(Window {
        normal,
        cabin,
        outside,
        wavelength_nm,
        pane,
    })
}

/// Refractive index of the acrylic of cabin windows.
const DEFAULT_INDEX: f64 = 1.49;
/// Default standard deviation of the index: acrylics and their dispersion differ by about 0.005, -70 K adds 0.007.
const DEFAULT_INDEX_SIGMA: f64 = 0.01;
/// Default standard deviation of the window's normal, degrees: two readings of an inclinometer against the window's frame,
/// or a drawing.
const DEFAULT_NORMAL_SIGMA_DEG: f64 = 1.0;
/// Default distance of the camera from the inner pane, m: as close as possible.
const DEFAULT_DISTANCE_M: f64 = 0.15;

/// Default relative standard deviation of a radius that is computed for a plate under pressure, or from a sagitta measured
/// to 25 %.
const DEFAULT_BOW_SIGMA: f64 = 0.25;
/// Relative standard deviation if no radius is given: the default radius may occur in either direction.
const UNKNOWN_BOW_SIGMA: f64 = 1.0;

/// Returns half the tolerance of cast acrylic sheet (ISO 7823-1: 0.4 mm and 10 % of the thickness), m.
fn default_thickness_sigma_m(thickness_m: f64) -> f64 {
    0.5 * (0.4e-3 + 0.1 * thickness_m)
}

/// Reads the panes, with default standard deviations of values that are not given.
fn read_pane(reader: &mut Reader, file: &Path, table: &tables::WindowTable) -> Option<Pane> {
    let Some(thickness_m) = table.thickness_m else {
        for (place, given) in [
            ("window.index", table.index.is_some()),
            ("window.bow_radius_m", table.bow_radius_m.is_some()),
            ("window.same_on_ground", table.same_on_ground.is_some()),
        ] {
            if given {
                let remedy = "give window.thickness_m of all panes together, or delete this key";
                reader.fault(file, place, "is given without the panes' thickness", remedy);
            }
        }
        return None;
    };
    if table.normal.is_none() {
        let remedy =
            "give the outward normal in the survey frame, along which a pane displaces rays";
        reader.fault(file, "window.normal", "is missing", remedy);
    }
    let pane = Pane {
        thickness_m,
        thickness_sigma_m: table
            .thickness_sigma_m
            .unwrap_or(default_thickness_sigma_m(thickness_m)),
        index: table.index.unwrap_or(DEFAULT_INDEX),
        index_sigma: table.index_sigma.unwrap_or(DEFAULT_INDEX_SIGMA),
        normal_sigma_rad: table
            .normal_sigma_deg
            .unwrap_or(DEFAULT_NORMAL_SIGMA_DEG)
            .to_radians(),
        bow_radius_m: table.bow_radius_m,
        bow_sigma: table.bow_sigma.unwrap_or_else(|| {
            table
                .bow_radius_m
                .map_or(UNKNOWN_BOW_SIGMA, |_| DEFAULT_BOW_SIGMA)
        }),
        distance_m: table.distance_m.unwrap_or(DEFAULT_DISTANCE_M),
        same_on_ground: table.same_on_ground.unwrap_or(false),
    };
    if let Some(radius) = pane
        .bow_radius_m
        .filter(|r| !(0.5..=1e6).contains(&r.abs()))
    {
        let remedy =
            "give 0.5 m to 1e6 m, positive if the pane bulges outwards; delete it for a plane pane";
        reader.fault(
            file,
            "window.bow_radius_m",
            format!("is {radius} m"),
            remedy,
        );
    }
    Some(pane)
}

fn read_air(table: Option<&tables::AirTable>, default: Air) -> Air {
    table.map_or(default, |table| Air {
        temperature_c: table.temperature_c,
        pressure_hpa: table.pressure_hpa,
        humidity: table.humidity.unwrap_or(default.humidity),
        co2_ppm: table.co2_ppm.unwrap_or(default.co2_ppm),
    })
}
