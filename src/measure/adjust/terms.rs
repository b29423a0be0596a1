//! Which unknowns the spatial methods have.
//!
//! A new one is one `impl` of [`Term`], in the file of its subject in this folder, and one line in a list here: in
//! [`shared`] where all frames have it in common, in [`of_mounting`] where those of one mounting have. The `impl` says
//! how many columns it has, what is known of them beforehand, which quantity of the model it changes, and how positions,
//! pixels, lifts and twist answer to it. From there follow start and normal equations, the sentence where nothing
//! determines it, its share of every result's covariance, and under its name the prior's share of a variance
//! ([`super::gauss_helmert::Prior::name`]); only one that changes what the model has no quantity for yet adds that to
//! [`super::values::Values`] and to the function of [`super::scene`] that takes it.

mod camera;
mod wing;

pub use camera::{Rotation, repeatability_rad, stated_drift_rad};
pub use wing::{Curvature, Twist};

use std::sync::Arc;

use self::camera::{Centre, GroundRotation, Interior, PaneBow, PaneShift, Shift};
use self::wing::{AxisHeight, Drawn, ThermalScale};
use super::input::Input;
use super::term::{Columns, Place, Placed, Term};

fn held_or(term: Option<impl Term + 'static>) -> Option<Arc<dyn Term>> {
    term.map(|term| Arc::new(term) as Arc<dyn Term>)
}

/// What all frames have in common, placed.
pub struct Shared {
    /// All of them.
    pub placed: Vec<Placed>,
    /// Height of the bending axis.
    pub axis_height: Place,
}

/// Takes columns for camera, window, temperature and drawings.
pub fn shared(input: &Input, columns: &mut Columns) -> Shared {
    let (setup, scene) = (input.setup, input.scene);
    let centre_sigma_m = setup.projection_centre_sigma_m;
    let camera = [
        held_or(scene.has_ground_sights().then_some(GroundRotation)),
        held_or((centre_sigma_m > 0.0).then_some(Centre { sigma_m: centre_sigma_m })),
        held_or(scene.window_covariance_m2().map(|covariance_m2| PaneShift { covariance_m2 })),
        held_or(scene.bow_sigma().filter(|s| *s > 0.0).map(|sigma| PaneBow { sigma })),
        held_or(ThermalScale::of(setup.thermal.as_ref())),
    ];
    let mut placed: Vec<_> = camera.into_iter().flatten().map(|term| columns.place(term)).collect();
    let height = columns.place(Arc::new(AxisHeight::of(&scene.ground)));
    let axis_height = height.place;
    placed.push(height);
    let lens = held_or(setup.uncertainty.lens.map(|covariance| Interior { covariance }));
    let drawn = Drawn::all(input).into_iter().map(|term| Arc::new(term) as Arc<dyn Term>);
    placed.extend(lens.into_iter().chain(drawn).map(|term| columns.place(term)));
    Shared { placed, axis_height }
}

/// What the frames of one mounting have in common beside its rotation; `stayed`: it is that of the ground frames.
pub fn of_mounting(input: &Input, stayed: bool) -> Vec<Arc<dyn Term>> {
    let sigma_m = input.setup.uncertainty.mount_shift_m;
    held_or((sigma_m > 0.0 && !stayed).then_some(Shift { sigma_m })).into_iter().collect()
}

/// A mounting's rotation.
pub fn rotation(input: &Input, stayed: bool) -> Arc<dyn Term> {
    Arc::new(if stayed { Rotation::stayed(input.setup) } else { Rotation::of_mounting(input) })
}
