//! The frames of a flight, what of them takes part, and their observations as the engine takes them.

use nalgebra::{DMatrix, DVector};

use super::assumed::{Assumed, own_rotation_column};
use super::shape::SharedShape;
use super::usage::Usage;
use crate::measure::adjust::gauss_helmert::{Block, Fit, Group};
use crate::measure::adjust::input::{Input, Sights, by_marker, on_the_wing};
use crate::measure::adjust::layout::Layout;
use crate::measure::adjust::model_error::image_covariance;
use crate::measure::adjust::snooping::Member;
use crate::measure::adjust::{AdjustError, Observation};

/// Fewest markers on the wing in one frame.
pub const FEWEST: usize = 4;

/// A flight.
#[derive(Clone)]
pub struct Flight<'a> {
    /// What it is set up from.
    pub input: Input<'a>,
    /// Observations of each frame.
    pub frames: Vec<Sights<'a>>,
    /// What takes part.
    pub usage: Usage,
    /// What is taken for granted.
    pub assumed: Assumed<'a>,
}

impl<'a> Flight<'a> {
    /// Errors: too few markers in a frame, observations that are not numbers, mountings for another number of frames.
    pub fn new(
        input: Input<'a>,
        observations: &'a [Vec<Observation>],
        assumed: Assumed<'a>,
    ) -> Result<Self, AdjustError> {
        let setup = input.setup;
        let frames = observations.iter().map(|o| by_marker(setup, o)).collect::<Result<Vec<_>, _>>()?;
        for frame in &frames {
            let found = on_the_wing(setup, frame);
            if found < FEWEST {
                return Err(AdjustError::TooFewMarkers { found, needed: FEWEST });
            }
        }
        if !assumed.mountings.suit(frames.len()) {
            return Err(AdjustError::Input("there must be one mounting for every frame".into()));
        }
        let usage = Usage::all(frames.len(), setup.markers.len());
        Ok(Self { input, frames, usage, assumed })
    }

    /// One frame: the images, and last the tie of its curvature to the shared shape.
    pub fn group(&self, frame: usize, layout: &Layout, from: Option<&Fit>) -> (Group, Vec<Member>) {
        let mut members = vec![];
        let mut blocks = vec![];
        for (marker, seen) in self.frames[frame].iter().enumerate() {
            if let Some(seen) = seen.filter(|_| self.usage.frames[frame][marker]) {
                members.push(Member { marker, flight: Some(0), ground: None });
                blocks.push(image_block(seen));
            }
        }
        let departure_per_m = self.assumed.departure * self.assumed.amplitudes_per_m[frame];
        blocks.push(SharedShape::block(layout.curvature_terms, departure_per_m));
        let mut local = DVector::zeros(layout.local);
        if let Some(fit) = from {
            local.copy_from(&fit.groups[frame].local);
            if let Some(first) = own_rotation_column(layout) {
                local.rows_mut(first, 3).copy_from(&self.assumed.own_rotation_rad(frame));
            }
        }
        (Group { local, priors: layout.local_priors(), blocks }, members)
    }

    /// Survey and ground frame.
    pub fn ground_group(&self) -> (Group, Vec<Member>) {
        let mut members = vec![];
        let mut blocks = vec![];
        let scene = self.input.scene;
        for (marker, surveyed) in self.input.setup.markers.iter().enumerate() {
            let sight = scene.ground_sights[marker].as_ref().filter(|_| self.usage.ground[marker]);
            let station = scene.ground.stations[marker].surveyed_m;
            let mut observed = station.as_slice().to_vec();
            observed.extend(sight.iter().flat_map(|s| [s.pixel.x, s.pixel.y]));
            let mut covariance = DMatrix::identity(observed.len(), observed.len()) * surveyed.sigma_m.powi(2);
            if let Some(sight) = sight {
                covariance.fixed_view_mut::<2, 2>(3, 3).copy_from(&image_covariance(&sight.covariance_px2));
            }
            members.push(Member { marker, flight: None, ground: sight.map(|_| 3) });
            blocks.push(Block { observed: DVector::from_vec(observed), covariance });
        }
        (Group { local: DVector::zeros(0), priors: vec![], blocks }, members)
    }
}

fn image_block(seen: &Observation) -> Block {
    Block {
        observed: DVector::from_column_slice(seen.pixel.as_slice()),
        covariance: DMatrix::from_column_slice(2, 2, image_covariance(&seen.covariance_px2).as_slice()),
    }
}
