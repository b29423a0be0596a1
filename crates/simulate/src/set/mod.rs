//! Sets of rendered images with known truth.

mod boards;
mod files;

use crate::render::SampledAircraft;
use crate::render::SeededRandom;
use crate::render::{Scene, SceneShot};
use wingd_measure::setup::SetupUncertainty;
use wingd_measure::setup::Width;
use wingd_measure::setup::{Setup, Thermal, fixed_target};

pub use boards::write_board_images;
pub use files::write_set;

/// A frame of an image set.
pub struct SetFrame {
    /// File name below `frames/`.
    pub image: String,
    /// Parameters of the rendering.
    pub shot: SceneShot,
    /// JPEG quality, 1 to 100.
    pub quality: u8,
    /// Time in the flight, for a time series.
    pub moment: Option<FlightMoment>,
}

/// Time and bending modes of a frame in a time series.
pub struct FlightMoment {
    /// Time since the first frame of the flight, s.
    pub time_s: f64,
    /// Tip deflection of each bending mode, m.
    pub modes_m: Vec<f64>,
}

/// Returns the setup of a scene without sampled errors, with default priors. The prior of the skin height stays: it is that
/// of the drawings.
pub fn with_default_priors(setup: &Setup) -> Setup {
    let skin_height_m = setup.uncertainty[Width::SkinHeight];
    let uncertainty =
        SetupUncertainty::default_for(setup.reach_m()).with_width(Width::SkinHeight, skin_height_m);
    let default_thermal = |thermal: Thermal| Thermal {
        flight_temperature_sigma_k: None,
        ..thermal
    };
    let mut specified = Setup {
        uncertainty,
        thermal: setup.thermal.map(default_thermal),
        ..setup.clone()
    };
    specified
        .markers
        .iter_mut()
        .filter(|m| m.fixed)
        .for_each(|m| {
            let distance_m = (m.position_m - setup.projection_centre_m).norm();
            m.flight_motion_m = fixed_target::flight_motion_m(distance_m);
        });
    specified
}

/// Samples an aircraft consistent with the installation; returns its frames and the setup as an installation specifies it.
pub fn sample_aircraft(seed: u64, scene: &Scene, frames: Vec<SetFrame>) -> (Setup, Vec<SetFrame>) {
    let mut random = SeededRandom::new(seed, 21);
    let aircraft = SampledAircraft::new(scene, &mut random);
    let specified = SampledAircraft::perturbed_setup(scene, &mut random);
    let shot = |(k, frame): (usize, SetFrame)| {
        let shot = match k {
            0 => aircraft.ground_shot(frame.shot),
            _ => aircraft.flight_shot(frame.shot, &mut random),
        };
        SetFrame { shot, ..frame }
    };
    (
        specified,
        frames.into_iter().enumerate().map(shot).collect(),
    )
}

/// Chooses `count` of the first `of` markers at random.
pub fn choose_hidden(random: &mut SeededRandom, count: usize, of: usize) -> Vec<usize> {
    let mut left: Vec<usize> = (0..of).collect();
    (0..count.min(of))
        .map(|_| left.swap_remove(random.integer(0, left.len() - 1)))
        .collect()
}
