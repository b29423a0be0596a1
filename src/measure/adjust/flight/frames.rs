//! The frames of a flight, what of them takes part, and their observations as the engine takes them.

use nalgebra::DVector;

use super::hyperparameters::{FlightHyperparameters, own_rotation_column};
use super::shape::SharedShape;
use super::usage::Usage;
use crate::adjust::blocks::{image_block, survey_block};
use crate::adjust::common_displacement::{CommonDisplacement, causes};
use crate::adjust::factors::Factors;
use crate::adjust::input::{Input, Sights, by_marker, on_the_wing};
use crate::adjust::layout::{Layout, Member};
use crate::adjust::snooping::ResidualSum;
use crate::adjust::{AdjustError, Observation};
use crate::estimation::{Fit, Group};

/// Fewest markers on the wing in one frame.
pub const MIN_MARKERS: usize = 4;

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
    pub assumed: FlightHyperparameters<'a>,
    /// What the global test judges, where much was removed.
    pub judged: Option<ResidualSum>,
    /// By how much more or less than stated things are taken to move.
    pub factors: Factors,
    /// What many markers have in common in all frames.
    pub cause: Option<CommonDisplacement>,
}

impl<'a> Flight<'a> {
    /// Errors: too few markers in a frame, observations that are not numbers, mountings for another number of frames.
    pub fn new(
        input: Input<'a>,
        observations: &'a [Vec<Observation>],
        assumed: FlightHyperparameters<'a>,
    ) -> Result<Self, AdjustError> {
        let setup = input.setup;
        let frames = observations.iter().map(|o| by_marker(setup, o)).collect::<Result<Vec<_>, _>>()?;
        for frame in &frames {
            let found = on_the_wing(setup, frame);
            if found < MIN_MARKERS {
                return Err(AdjustError::TooFewMarkers { found, needed: MIN_MARKERS });
            }
        }
        if !assumed.mountings.suit(frames.len()) {
            return Err(AdjustError::Input("there must be one mounting for every frame".into()));
        }
        let usage = Usage::all(frames.len(), setup.markers.len());
        Ok(Self { input, frames, usage, assumed, judged: None, factors: Factors::default(), cause: None })
    }

    /// What many markers may have in common, as all frames together show them.
    pub fn causes(&self) -> Vec<CommonDisplacement> {
        let seen = |marker: usize| self.frames.iter().find_map(|frame| frame[marker]);
        let sights: Sights = (0..self.input.setup.markers.len()).map(seen).collect();
        causes(&self.input, &sights)
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
        blocks.push(SharedShape::block(layout.curvature_terms, &self.assumed, frame));
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
        let one = |marker: usize| {
            let sight = self.input.scene.ground_sights[marker].as_ref().filter(|_| self.usage.ground[marker]);
            let member = Member { marker, flight: None, ground: sight.map(|_| 3) };
            (survey_block(&self.input, marker, sight.into_iter()), member)
        };
        let (blocks, members) = (0..self.input.setup.markers.len()).map(one).unzip();
        (Group { local: DVector::zeros(0), priors: vec![], blocks }, members)
    }
}
