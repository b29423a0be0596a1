//! List of the unknowns of the spatial methods.
//!
//! A new unknown is a function that returns a [`ParameterTerm`], in the file of its subject in this folder, and its name in
//! a list here: in [`allocate_shared_terms`] if all frames share it, in [`mounting_terms`] if the frames of one mounting
//! share it. The term defines the number of columns, the priors, the quantity of the model that it changes, and the
//! derivatives of positions, pixels, deflections and twist. Everything else follows: start values and normal equations, the
//! message if nothing determines it, its contribution to the covariance of every result, and its share of the variance
//! budget under its name ([`crate::estimation::Prior::name`]). A term that changes a new quantity of the model also adds
//! that quantity to [`super::values::UnknownValues`] and to the function of [`super::scene`] that uses it.

mod camera;
mod motion;
mod wing;

pub use camera::{mount_drift_rad, mount_repeatability_rad, mounting_rotation_prior};
pub use motion::{common_displacement, flight_terms, frame_terms, row_terms};
pub use wing::{curvature_term, twist_term};

use nalgebra::Matrix3;

use self::camera::stay_prior;
use super::input::AdjustmentInput;
use super::term::{ColumnAllocator, ParameterScope, ParameterTerm, PlacedTerm};
use crate::widths::Width;

/// Terms that all frames share, with their columns.
pub struct SharedTerms {
    pub placed: Vec<PlacedTerm>,
    pub axis_height: ParameterScope,
    /// Motion of the root.
    pub root: Vec<PlacedTerm>,
}

/// Allocates the columns of camera, window, temperature and dimensions from drawings.
pub fn allocate_shared_terms(
    input: &AdjustmentInput,
    columns: &mut ColumnAllocator,
) -> SharedTerms {
    let (setup, scene) = (input.setup, input.scene);
    let centre_sigma_m = setup.projection_centre_sigma_m;
    let before = [
        scene
            .has_ground_observations()
            .then(camera::ground_rotation),
        (centre_sigma_m > 0.0).then(|| camera::projection_centre(centre_sigma_m)),
        scene.window_covariance_m2().map(camera::pane_shift),
        scene.bow_sigma().filter(|s| *s > 0.0).map(camera::pane_bow),
        wing::thermal_scale(setup.thermal.as_ref()),
    ];
    let mut placed = columns.allocate_terms(before.into_iter().flatten());
    let height = columns.allocate_term(wing::axis_height(&scene.ground));
    let axis_height = height.scope;
    placed.push(height);
    let lens = setup
        .uncertainty
        .lens
        .iter()
        .map(camera::interior_orientation);
    placed.extend(columns.allocate_terms(lens.chain(wing::dimension_terms(setup))));
    let root = columns.allocate_terms(wing::root_motion(&setup.uncertainty));
    placed.extend(root.iter().cloned());
    let others = motion::ground_state(input)
        .chain(wing::compliance_terms(
            &setup.uncertainty,
            scene.ground.axis.length_m,
        ))
        .chain(camera::flight_changes(&setup.uncertainty));
    placed.extend(columns.allocate_terms(others));
    SharedTerms {
        placed,
        axis_height,
        root,
    }
}

/// Rotation of a mounting. `stayed`: it is the mounting of the ground frames.
pub fn mounting_rotation(input: &AdjustmentInput, stayed: bool) -> ParameterTerm {
    let known = if stayed {
        stay_prior(input.setup)
    } else {
        mounting_rotation_prior(input)
    };
    camera::rotation_term(known)
}

/// Further terms shared by the frames of one mounting.
pub fn mounting_terms(input: &AdjustmentInput, stayed: bool) -> Vec<ParameterTerm> {
    let shift = if stayed {
        Width::StayShift
    } else {
        Width::MountShift
    };
    let [shift_m, rays_px] = [shift, Width::RayField].map(|width| input.setup.uncertainty[width]);
    let terms = [
        (shift_m > 0.0).then(|| camera::mounting_shift(shift_m)),
        (rays_px > 0.0 && !stayed).then(|| camera::ray_field(rays_px)),
    ];
    terms.into_iter().flatten().collect()
}

/// Rotation of a frame about its mounting's, with this covariance, camera frame, rad^2.
pub fn frame_rotation(covariance_rad2: &Matrix3<f64>) -> ParameterTerm {
    camera::rotation_term(camera::rotation_prior(covariance_rad2))
}
