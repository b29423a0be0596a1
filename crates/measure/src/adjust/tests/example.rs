//! A small wing for the tests of the spatial methods.
use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};

use super::values::UnknownValues;
use crate::geometry::Lens;
use crate::observation::Observation;
use crate::setup::{
    Air, Orientation, Pane, Setup, SetupUncertainty, Shape, SkinHeight, SurveyMarker, Thermal,
    Window, WingBreak, WingSide,
};

/// Installation with nine markers on 30 m.
pub fn setup() -> Setup {
    let marker = |k: usize| SurveyMarker {
        id: format!("M{k}"),
        shape: Shape::Circle,
        diameter_m: 0.3,
        position_m: Vector3::new(
            6.0 + 3.0 * k as f64,
            if k.is_multiple_of(2) { 1.5 } else { -1.2 },
            -1.3 + 0.2 * k as f64,
        ),
        sigma_m: 0.002,
        fixed: false,
        flight_motion_m: 0.0,
        part: None,
    };
    Setup {
        name: "t".into(),
        lens: Lens {
            k1: -0.05,
            k2: 0.09,
            p1: -3e-4,
            ..Lens::pinhole(4000, 3000, 7800.0, 1986.0, 1513.0)
        },
        projection_centre_m: Vector3::zeros(),
        projection_centre_sigma_m: 0.002,
        mount_repeatability_px: 10.0,
        span_direction: Vector2::new(1.0, 0.0),
        flow_direction: None,
        configured_side: Some(WingSide::Right),
        root_offset_m: 0.5,
        axis_chord_offset_m: Some(0.1),
        breaks: vec![],
        skin_height: Some(SkinHeight {
            root_m: 0.5,
            tip_m: 0.1,
            tip_span_m: 33.0,
        }),
        uncertainty: SetupUncertainty::from_drawings(),
        thermal: Some(Thermal {
            expansion_per_k: 23e-6,
            expansion_sigma_per_k: Some(1e-6),
            ground_temperature_c: 15.0,
            flight_temperature_c: -55.0,
            flight_temperature_sigma_k: Some(5.0),
        }),
        torsion: vec![],
        markers: (0..9).map(marker).collect(),
        window: None,
    }
}

/// Orientation of a camera that looks along the wing.
pub fn orientation() -> Orientation {
    let camera_from_survey = Rotation3::from_matrix_unchecked(Matrix3::new(
        0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0,
    ));
    let observation = |marker| Observation {
        marker,
        pixel: Vector2::new(1900.0, 1500.0),
        covariance_px2: Matrix2::identity(),
    };
    let ground = (0..9).map(observation).collect();
    Orientation {
        ground,
        ..Orientation::from_rotation(camera_from_survey)
    }
}

/// Window with a bowed pane in flight.
pub fn window() -> Window {
    let air = Air {
        temperature_c: 15.0,
        pressure_hpa: 1013.0,
        humidity: 0.0,
        co2_ppm: 420.0,
    };
    let pane = Pane {
        thickness_m: 0.0145,
        thickness_sigma_m: 1e-3,
        index: 1.49,
        index_sigma: 0.01,
        normal_sigma_rad: 0.02,
        bow_radius_m: Some(3.0),
        bow_sigma: 0.25,
        distance_m: 0.15,
        same_on_ground: false,
    };
    let normal = Some(Vector3::new(1.0, 0.15, 0.1).normalize());
    Window {
        normal,
        cabin: air,
        outside: air,
        wavelength_nm: 550.0,
        pane: Some(pane),
    }
}

/// Values of all unknowns that move a marker: tilted bending plane, rotated root, corrected dimensions.
pub fn tilted_values() -> UnknownValues {
    UnknownValues {
        curvature_per_m: vec![4e-3, 1e-3],
        twist_rad: vec![0.03, -0.02],
        raise_m: [0.02, -0.01, 0.0, 0.0],
        compliances: [0.3, -0.4, 0.5, 0.2, -0.6],
        estimated: [0.1, 0.05, 0.005, 0.01],
        root_rotation_rad: Vector3::new(1e-2, -2e-2, 1e-2),
        plane_rad: Some(0.03),
        ..UnknownValues::nominal(0.999)
    }
}

/// The example's wing whose dihedral breaks by 0.1 at 16.5 m.
pub fn gull_wing(sweep_rad: Option<f64>) -> Setup {
    let mut gull = Setup {
        breaks: vec![WingBreak {
            span_m: 16.5,
            sweep_rad,
        }],
        ..setup()
    };
    gull.markers
        .iter_mut()
        .for_each(|m| m.position_m.z += 0.1 * (m.position_m.x - 16.5).max(0.0));
    gull
}
