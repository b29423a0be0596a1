//! Which unknowns the spatial methods have.
//!
//! A new one is one function that returns a [`Term`], in the file of its subject in this folder, and its name in a list
//! here: in [`shared`] where all frames have it in common, in [`of_mounting`] where those of one mounting have. The term
//! says how many columns it has, what is known of them beforehand, which quantity of the model it changes, and how
//! positions, pixels, deflections and twist answer to it. From there follow start and normal equations, the sentence where
//! nothing determines it, its share of every result's covariance, and under its name the prior's share of a variance
//! ([`crate::estimation::Prior::name`]); only one that changes what the model has no quantity for yet adds that to
//! [`super::values::Values`] and to the function of [`super::scene`] that takes it.

mod camera;
mod motion;
mod wing;

pub use camera::{MIN_DRIFT_RAD, repeatability_rad, rotation_of_mounting, stated_drift_rad};
pub use motion::{SHAKE, VIBRATION, common_cause, of_flight, of_frame, of_rows};
pub use wing::{curvature, twist};

use nalgebra::Matrix3;

use self::camera::rotation_since_ground;
use super::input::Input;
use super::term::{Columns, ParameterScope, Placed, Term};

/// What all frames have in common, placed.
pub struct Shared {
    /// All of them.
    pub placed: Vec<Placed>,
    /// Height of the bending axis.
    pub axis_height: ParameterScope,
    /// The root's motion.
    pub root: Vec<Placed>,
}

/// Takes columns for camera, window, temperature and drawings.
pub fn shared(input: &Input, columns: &mut Columns) -> Shared {
    let (setup, scene) = (input.setup, input.scene);
    let centre_sigma_m = setup.projection_centre_sigma_m;
    let before = [
        scene.has_ground_sights().then(camera::ground_rotation),
        (centre_sigma_m > 0.0).then(|| camera::centre(centre_sigma_m)),
        scene.window_covariance_m2().map(camera::pane_shift),
        scene.bow_sigma().filter(|s| *s > 0.0).map(camera::pane_bow),
        wing::thermal_scale(setup.thermal.as_ref()),
    ];
    let mut placed: Vec<_> = before.into_iter().flatten().map(|term| columns.place(term)).collect();
    let height = columns.place(wing::axis_height(&scene.ground));
    let axis_height = height.place;
    placed.push(height);
    let lens = setup.uncertainty.lens.iter().map(camera::interior);
    placed.extend(lens.chain(wing::drawn(&setup.uncertainty)).map(|term| columns.place(term)));
    let width = &setup.uncertainty.in_flight;
    let root: Vec<_> = motion::root(width).map(|term| columns.place(term)).collect();
    placed.extend(root.iter().cloned());
    placed.extend(in_flight(input).into_iter().flatten().map(|term| columns.place(term)));
    Shared { placed, axis_height, root }
}

/// What else flight changes alike in all frames.
fn in_flight(input: &Input) -> [Option<Term>; 4] {
    let width = &input.setup.uncertainty.in_flight;
    let bend_m = if input.scene.has_ground_sights() { width.ground_bend_m } else { 0.0 };
    let unless_held = |sigma: f64, term: fn(f64) -> Term| (sigma > 0.0).then(|| term(sigma));
    [
        motion::ground_bend(input.scene, bend_m),
        unless_held(width.vertical_rad, motion::vertical),
        unless_held(width.scale, camera::flight_scale),
        unless_held(width.principal_point_px, camera::flight_principal_point),
    ]
}

/// Rotation of a mounting; `stayed`: it is that of the ground frames.
pub fn rotation(input: &Input, stayed: bool) -> Term {
    let known = if stayed { rotation_since_ground(input.setup) } else { rotation_of_mounting(input) };
    camera::rotation(known)
}

/// What the frames of one mounting have in common beside that.
pub fn of_mounting(input: &Input, stayed: bool) -> Vec<Term> {
    let sigma_m = input.setup.uncertainty.mount_shift_m;
    (sigma_m > 0.0 && !stayed).then(|| camera::shift(sigma_m)).into_iter().collect()
}

/// A frame's own rotation about its mounting's, with this covariance, camera frame, rad^2.
pub fn own_rotation(covariance_rad2: &Matrix3<f64>) -> Term {
    camera::rotation(camera::rotation_about(covariance_rad2))
}
