//! Camera terms: position, rotation, interior orientation and panes.

use nalgebra::{DMatrix, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};

use crate::adjust::input::AdjustmentInput;
use crate::adjust::term::{ParameterTerm, TermEffect};
use crate::estimation::Prior;
use crate::geometry::BROWN;
use crate::setup::{Setup, SetupUncertainty};
use crate::widths::{Unknown, Width};

/// Smallest drift of a mounting, rad (0.001 px at 8000 px); a prior needs a positive standard deviation.
const MIN_DRIFT_RAD: f64 = 1e-7;
/// Smallest repeatability of a mounting, px; a prior needs a positive standard deviation.
const MIN_REPEATABILITY_PX: f64 = 1e-3;
/// Smallest standard deviation of the panes' shift, m (0.001 px at 8 m), for a regular prior.
const MIN_WINDOW_SIGMA_M: f64 = 1e-6;
/// Variance of an interior parameter that the calibration kept fixed, in its own unit squared; negligible.
const FIXED_LENS_VARIANCE: f64 = 1e-16;

const PANES_MISSING: &str =
    "the panes' shift or bow cannot be determined; give the standard deviations in [window]";

fn to_vector(x: &[f64]) -> Vector3<f64> {
    Vector3::from_column_slice(x)
}

fn to_matrix(matrix: &Matrix3<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(3, 3, matrix.as_slice())
}

/// Configured drift of a mounting per axis, rad; greater than 0.
pub fn mount_drift_rad(setup: &Setup) -> f64 {
    setup.uncertainty[Width::MountDrift].max(MIN_DRIFT_RAD)
}

/// Repeatability of a mounting's rotation per axis, rad; greater than 0.
pub fn mount_repeatability_rad(setup: &Setup) -> f64 {
    setup.mount_repeatability_px.max(MIN_REPEATABILITY_PX) / setup.lens.focal_px()
}

/// Prior of a mounting's rotation, camera frame, rad.
pub fn mounting_rotation_prior(input: &AdjustmentInput) -> Prior {
    let repeatability = mount_repeatability_rad(input.setup);
    let orientation = input
        .orientation
        .covariance_rad2
        .filter(|_| !input.scene.has_ground_observations());
    let own = Matrix3::identity() * (repeatability * repeatability)
        + orientation.unwrap_or_else(Matrix3::zeros);
    rotation_prior(&own)
}

/// Prior of the rotation of a camera that is stated to have stayed since the ground frames.
pub fn stay_prior(setup: &Setup) -> Prior {
    let turn_rad = mount_drift_rad(setup).hypot(setup.uncertainty[Width::StayTurn]);
    rotation_prior(&(Matrix3::identity() * turn_rad.powi(2)))
}

/// Prior of a frame's rotation about its mounting's, with this covariance.
pub fn rotation_prior(covariance_rad2: &Matrix3<f64>) -> Prior {
    Prior::centred(Unknown::MountingRotation, 0, to_matrix(covariance_rad2))
}

/// Small rotation of the camera in flight relative to that in the ground frame, camera frame, rad: of a mounting, or of a
/// frame about its mounting's.
pub fn rotation_term(known: Prior) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::MountingRotation,
        missing: "the mounting's rotation cannot be determined; give camera.mount_repeatability_px or more markers near the root",
        size: 3,
        priors: vec![known],
        add_values: |x, values| values.pose.mount_rad += to_vector(x),
        effect: TermEffect::Image {
            pixel: |p, k| p.by_mount.column(k).into_owned(),
            on_ground: false,
        },
    }
}

/// Correction of the ground frame's rotation, camera frame, rad.
pub fn ground_rotation() -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::GroundRotation,
        missing: "the rotation on ground cannot be determined; more markers in the ground frame are needed",
        size: 3,
        priors: vec![],
        add_values: |x, values| values.pose.ground_rad += to_vector(x),
        effect: TermEffect::Image {
            pixel: |p, k| p.by_ground_rotation.column(k).into_owned(),
            on_ground: true,
        },
    }
}

/// Correction of the projection centre, wing frame, m.
pub fn projection_centre(sigma_m: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::ProjectionCentre,
        missing: "the projection centre cannot be determined; give camera.projection_centre_sigma_m",
        size: 3,
        priors: ParameterTerm::equal_priors(Unknown::ProjectionCentre, 3, sigma_m),
        add_values: |x, values| values.pose.centre_m += to_vector(x),
        effect: TermEffect::Image {
            pixel: |p, k| -p.by_point.column(k),
            on_ground: true,
        },
    }
}

/// Shift of the projection centre of a mounting since the ground frame, wing frame, m.
pub fn mounting_shift(sigma_m: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::MountingShift,
        missing: "the mounting's shift cannot be determined; give camera.mount_shift_m",
        size: 3,
        priors: ParameterTerm::equal_priors(Unknown::MountingShift, 3, sigma_m),
        add_values: |x, values| values.pose.shift_m += to_vector(x),
        effect: TermEffect::Image {
            pixel: |p, k| -p.by_point.column(k),
            on_ground: false,
        },
    }
}

/// Residual shift by the panes, if only flight frames are taken through them: a shift of the projection centre that all
/// frames share, wing frame, m. If ground frame and flight frames are taken through the same panes it is part of the
/// projection centre. `covariance_m2`: uncertainty of the shift from the panes' parameters.
pub fn pane_shift(covariance_m2: Matrix3<f64>) -> ParameterTerm {
    let least = DMatrix::identity(3, 3) * (MIN_WINDOW_SIGMA_M * MIN_WINDOW_SIGMA_M);
    ParameterTerm {
        unknown: Unknown::PaneShift,
        missing: PANES_MISSING,
        size: 3,
        priors: vec![Prior::centred(
            Unknown::PaneShift,
            0,
            to_matrix(&covariance_m2) + least,
        )],
        add_values: |x, values| values.pose.window_m += to_vector(x),
        effect: TermEffect::Image {
            pixel: |p, k| -p.by_point.column(k),
            on_ground: false,
        },
    }
}

/// Correction of the bow of the panes in flight, as a fraction of its curvature.
pub fn pane_bow(sigma: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::PaneBow,
        missing: PANES_MISSING,
        size: 1,
        priors: vec![Prior::scalar(Unknown::PaneBow, 0, 0.0, sigma)],
        add_values: |x, values| values.pose.bow += x[0],
        effect: TermEffect::Image {
            pixel: |p, _| p.by_bow,
            on_ground: false,
        },
    }
}

/// Correction of the calibrated interior orientation, in the order of [`crate::geometry::Lens::PARAMETERS`]. Each variance
/// is increased by a factor of 1 + 1e-9, so that a covariance that rounding made singular has an inverse.
pub fn interior_orientation(covariance: &SMatrix<f64, BROWN, BROWN>) -> ParameterTerm {
    let mut covariance = DMatrix::from_column_slice(BROWN, BROWN, covariance.as_slice());
    for k in 0..BROWN {
        covariance[(k, k)] = (covariance[(k, k)] * (1.0 + 1e-9)).max(FIXED_LENS_VARIANCE);
    }
    ParameterTerm {
        unknown: Unknown::InteriorOrientation,
        missing: "the interior orientation cannot be determined; give its covariance in camera.toml",
        size: BROWN,
        priors: vec![Prior::centred(Unknown::InteriorOrientation, 0, covariance)],
        add_values: |x, values| {
            values
                .pose
                .lens
                .iter_mut()
                .zip(x)
                .for_each(|(lens, x)| *lens += x)
        },
        effect: TermEffect::Image {
            pixel: |p, k| p.by_lens.column(k).into_owned(),
            on_ground: true,
        },
    }
}

/// Terms of the changes of the interior orientation in flight, without those that are fixed.
pub fn flight_changes(uncertainty: &SetupUncertainty) -> impl Iterator<Item = ParameterTerm> {
    let scale = uncertainty[Width::FlightScale];
    let sigmas = [
        scale,
        ASPECT_SHARE * scale,
        uncertainty[Width::PrincipalPoint],
    ];
    let terms: [fn(f64) -> ParameterTerm; 3] =
        [flight_scale, flight_aspect, flight_principal_point];
    let uncertain = sigmas.into_iter().zip(terms).filter(|one| one.0 > 0.0);
    uncertain.map(|(sigma, term)| term(sigma))
}

/// Standard deviation of the ratio of height to width over that of the scale. Cold and focus do not change the ratio;
/// refraction at a pane that is inclined by 30 degrees changes it by a quarter of the change of scale, sin^2 of the angle.
const ASPECT_SHARE: f64 = 0.25;

/// Relative change of the ratio of height to width in flight, due to an inclined window, or to resizing.
fn flight_aspect(sigma: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::Aspect,
        priors: vec![Prior::scalar(Unknown::Aspect, 0, 0.0, sigma)],
        add_values: |x, values| values.pose.flight_aspect += x[0],
        effect: TermEffect::Image {
            pixel: |p, _| p.by_aspect,
            on_ground: false,
        },
        ..flight_scale(sigma)
    }
}

/// Relative change of both focal lengths in flight, due to cold, focus, or refraction at an undescribed window.
fn flight_scale(sigma: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::FlightScale,
        missing: "the focal length in flight cannot be determined; give camera.flight_scale_sigma",
        size: 1,
        priors: vec![Prior::scalar(Unknown::FlightScale, 0, 0.0, sigma)],
        add_values: |x, values| values.pose.flight_scale += x[0],
        effect: TermEffect::Image {
            pixel: |p, _| p.by_scale,
            on_ground: false,
        },
    }
}

/// Smooth field of image shifts along the wing since the ground frame, whose root mean square is `sigma_px`, by equal parts of
/// its modes, px.
pub fn ray_field(sigma_px: f64) -> ParameterTerm {
    let prior = |k: usize| {
        let of_mode = (2.0 * (k / 2 + 2) as f64 + 1.0) / 3.0;
        Prior::scalar(Unknown::RayField, k, 0.0, sigma_px * of_mode.sqrt())
    };
    ParameterTerm {
        unknown: Unknown::RayField,
        missing: "the field of rays cannot be determined; give camera.ray_field_px",
        size: 6,
        priors: (0..6).map(prior).collect(),
        add_values: |x, values| values.pose.ray_field_px += Matrix2x3::from_column_slice(x),
        effect: TermEffect::Image {
            pixel: |p, k| Vector2::ith(k % 2, p.by_ray_field[k / 2]),
            on_ground: false,
        },
    }
}

/// Shift of the image in one frame by stabilisation of lens or sensor, px; `None` without stabilisation.
pub fn image_shift(sigma_px: f64) -> Option<ParameterTerm> {
    let priors = ParameterTerm::equal_priors(Unknown::ImageShift, 2, sigma_px);
    (sigma_px > 0.0).then(|| ParameterTerm {
        unknown: Unknown::ImageShift,
        priors,
        ..flight_principal_point(sigma_px)
    })
}

/// Change of the principal point in flight, px, due to cold or a lens that settles in its mount.
fn flight_principal_point(sigma_px: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::FlightPrincipalPoint,
        missing: "the principal point in flight cannot be determined; give camera.flight_principal_point_sigma_px",
        size: 2,
        priors: ParameterTerm::equal_priors(Unknown::FlightPrincipalPoint, 2, sigma_px),
        add_values: |x, values| values.pose.flight_principal_px += Vector2::new(x[0], x[1]),
        effect: TermEffect::Image {
            pixel: |_, k| Vector2::ith(k, 1.0),
            on_ground: false,
        },
    }
}
