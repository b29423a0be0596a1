//! Where the camera is, where it looks, and what it looks through.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, Vector2, Vector3};

use crate::adjust::input::Input;
use crate::adjust::term::{Effect, Term};
use crate::estimation::Prior;
use crate::geometry::BROWN;
use crate::setup::Setup;

/// A mounting that is stated not to drift is taken to do so by this, rad: a prior needs a width (0.001 px at 8000 px).
pub const MIN_DRIFT_RAD: f64 = 1e-7;
/// A mounting that is stated to repeat itself exactly, px: the same.
const MIN_REPEATABILITY_PX: f64 = 1e-3;
/// A pane that is stated without error is taken at this, m: a thousandth of a pixel at 8 m, and a regular prior.
const MIN_WINDOW_SIGMA_M: f64 = 1e-6;
/// Variance of an interior parameter that the calibration held, in its own unit squared: none that shows.
const HELD_LENS_VARIANCE: f64 = 1e-16;

const PANES_MISSING: &str =
    "the panes' shift or bow cannot be determined; give the standard deviations in [window]";

fn vector(x: &[f64]) -> Vector3<f64> {
    Vector3::from_column_slice(x)
}

fn matrix(of: &Matrix3<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(3, 3, of.as_slice())
}

/// Three coordinates, each with this standard deviation.
fn alike(name: &'static str, sigma_m: f64) -> Vec<Prior> {
    (0..3).map(|k| Prior::scalar(name, k, 0.0, sigma_m)).collect()
}

/// Drift of one mounting as stated, each axis, rad; not 0.
pub fn stated_drift_rad(setup: &Setup) -> f64 {
    setup.uncertainty.mount_drift_rad.max(MIN_DRIFT_RAD)
}

/// How well a mounting's rotation repeats, each axis, rad; not 0.
pub fn repeatability_rad(setup: &Setup) -> f64 {
    setup.mount_repeatability_px.max(MIN_REPEATABILITY_PX) / setup.lens.focal_px()
}

/// What is known of a mounting's rotation before a frame is seen, camera frame, rad.
pub fn rotation_of_mounting(input: &Input) -> Prior {
    let repeatability = repeatability_rad(input.setup);
    let stated = input.orientation.covariance_rad2.filter(|_| !input.scene.has_ground_sights());
    let own = Matrix3::identity() * (repeatability * repeatability) + stated.unwrap_or_else(Matrix3::zeros);
    let (mean, covariance) = input.options.mount_prior.unwrap_or((Vector3::zeros(), own));
    let mean = DVector::from_column_slice(mean.as_slice());
    Prior { mean, ..rotation_about(&covariance) }
}

/// The same where the camera stayed since the ground frames: it drifts.
pub fn rotation_since_ground(setup: &Setup) -> Prior {
    rotation_about(&(Matrix3::identity() * stated_drift_rad(setup).powi(2)))
}

/// The same of a frame's own rotation about its mounting's.
pub fn rotation_about(covariance_rad2: &Matrix3<f64>) -> Prior {
    Prior::centred("rotation of the mounting", 0, matrix(covariance_rad2))
}

/// Small rotation of the camera in flight against the ground frame's, camera frame, rad: a mounting's, or a frame's own
/// about its mounting's.
pub fn rotation(known: Prior) -> Term {
    Term {
        name: known.name,
        missing: "the mounting's rotation cannot be determined; give camera.mount_repeatability_px or more markers near the root",
        size: 3,
        priors: vec![known],
        enter: |x, values| values.pose.mount_rad += vector(x),
        effect: Effect::Picture { pixel: |p, k| p.by_mount.column(k).into_owned(), on_ground: false },
    }
}

/// Correction of the ground frame's rotation, camera frame, rad.
pub fn ground_rotation() -> Term {
    Term {
        name: "rotation on ground",
        missing: "the rotation on ground cannot be determined; more markers in the ground frame are needed",
        size: 3,
        priors: vec![],
        enter: |x, values| values.pose.ground_rad += vector(x),
        effect: Effect::Picture {
            pixel: |p, k| p.by_ground_rotation.column(k).into_owned(),
            on_ground: true,
        },
    }
}

/// Correction of the projection centre, wing frame, m.
pub fn centre(sigma_m: f64) -> Term {
    Term {
        name: "projection centre",
        missing: "the projection centre cannot be determined; give camera.projection_centre_sigma_m",
        size: 3,
        priors: alike("projection centre", sigma_m),
        enter: |x, values| values.pose.centre_m += vector(x),
        effect: Effect::Picture { pixel: |p, k| -p.by_point.column(k), on_ground: true },
    }
}

/// Shift of the projection centre since the ground frame, of one mounting, wing frame, m.
pub fn shift(sigma_m: f64) -> Term {
    Term {
        name: "shift of the mounting",
        missing: "the mounting's shift cannot be determined; give camera.mount_shift_m",
        size: 3,
        priors: alike("shift of the mounting", sigma_m),
        enter: |x, values| values.pose.shift_m += vector(x),
        effect: Effect::Picture { pixel: |p, k| -p.by_point.column(k), on_ground: false },
    }
}

/// What is left of the panes' shift where only the flight is seen through them: a shift of the projection
/// centre that all frames share, wing frame, m. Where ground and flight are seen alike it is a part of the centre's.
/// `covariance_m2`: what the description of the panes leaves unknown of it.
pub fn pane_shift(covariance_m2: Matrix3<f64>) -> Term {
    let least = DMatrix::identity(3, 3) * (MIN_WINDOW_SIGMA_M * MIN_WINDOW_SIGMA_M);
    Term {
        name: "panes' shift",
        missing: PANES_MISSING,
        size: 3,
        priors: vec![Prior::centred("panes' shift", 0, matrix(&covariance_m2) + least)],
        enter: |x, values| values.pose.window_m += vector(x),
        effect: Effect::Picture { pixel: |p, k| -p.by_point.column(k), on_ground: false },
    }
}

/// Correction of the panes' bow in flight, a share of its curvature.
pub fn pane_bow(sigma: f64) -> Term {
    Term {
        name: "panes' bow",
        missing: PANES_MISSING,
        size: 1,
        priors: vec![Prior::scalar("panes' bow", 0, 0.0, sigma)],
        enter: |x, values| values.pose.bow += x[0],
        effect: Effect::Picture { pixel: |p, _| p.by_bow, on_ground: false },
    }
}

/// Correction of the interior orientation as calibrated, in the order of
/// [`crate::geometry::Lens::PARAMETERS`]. A thousand-millionth more of each variance keeps a covariance that
/// rounding left without an inverse regular.
pub fn interior(covariance: &SMatrix<f64, BROWN, BROWN>) -> Term {
    let mut covariance = DMatrix::from_column_slice(BROWN, BROWN, covariance.as_slice());
    for k in 0..BROWN {
        covariance[(k, k)] = (covariance[(k, k)] * (1.0 + 1e-9)).max(HELD_LENS_VARIANCE);
    }
    Term {
        name: "interior orientation",
        missing: "the interior orientation cannot be determined; give its covariance in camera.toml",
        size: BROWN,
        priors: vec![Prior::centred("interior orientation", 0, covariance)],
        enter: |x, values| values.pose.lens.iter_mut().zip(x).for_each(|(lens, x)| *lens += x),
        effect: Effect::Picture { pixel: |p, k| p.by_lens.column(k).into_owned(), on_ground: true },
    }
}

/// Share by which both camera constants are larger in flight than on ground: cold and focus change them, and so does
/// refraction at a window that nobody describes.
pub fn flight_scale(sigma: f64) -> Term {
    let name = "scale of the camera in flight";
    Term {
        name,
        missing: "the camera constant in flight cannot be determined; give camera.flight_scale_sigma",
        size: 1,
        priors: vec![Prior::scalar(name, 0, 0.0, sigma)],
        enter: |x, values| values.pose.flight_scale += x[0],
        effect: Effect::Picture { pixel: |p, _| p.by_scale, on_ground: false },
    }
}

/// Principal point in flight against that on ground, px: cold and a lens that settles in its mount move it.
pub fn flight_principal_point(sigma_px: f64) -> Term {
    let name = "principal point in flight";
    Term {
        name,
        missing: "the principal point in flight cannot be determined; give camera.flight_principal_point_sigma_px",
        size: 2,
        priors: (0..2).map(|k| Prior::scalar(name, k, 0.0, sigma_px)).collect(),
        enter: |x, values| values.pose.flight_principal_px += Vector2::new(x[0], x[1]),
        effect: Effect::Picture { pixel: |_, k| Vector2::ith(k, 1.0), on_ground: false },
    }
}
