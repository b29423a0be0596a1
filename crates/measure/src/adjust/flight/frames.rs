//! Frames of a flight, the observations in use, and their blocks for the estimation engine.

use nalgebra::DVector;

use super::hyperparameters::{FlightHyperparameters, frame_rotation_column};
use super::knowledge::Knowledge;
use super::shape::SharedShape;
use super::usage::{FlightUsage, RemovedObservation};
use crate::adjust::blocks::{image_block, survey_block};
use crate::adjust::causes::WidenedPriors;
use crate::adjust::common_displacement::{CommonDisplacement, candidate_displacements};
use crate::adjust::input::{
    AdjustmentInput, FrameObservations, count_wing_markers, order_by_marker,
};
use crate::adjust::layout::{BlockMember, GroundPositions, ParameterLayout};
use crate::adjust::prior_scales::PriorScales;
use crate::adjust::snooping::ResidualSum;
use crate::adjust::{AdjustError, AdjustResult, Observation};
use crate::estimation::{Block, Fit, Group};

/// Minimum number of wing markers in a frame that shares its shape with others.
const MIN_MARKERS: usize = 4;
/// Minimum number of wing markers in a frame alone.
const MIN_MARKERS_ALONE: usize = 6;

/// Frames of a flight with the state of their adjustment.
#[derive(Clone)]
pub struct Flight<'a> {
    pub input: AdjustmentInput<'a>,
    pub knowledge: Knowledge<'a>,
    /// Observations of each frame.
    pub frames: Vec<FrameObservations<'a>>,
    /// Observations in use.
    pub usage: FlightUsage,
    /// Parameters that are assumed first and then estimated from the frames.
    pub hyperparameters: FlightHyperparameters<'a>,
    /// Sum of squares for the global test, if many observations were removed.
    pub tested_sum: Option<ResidualSum>,
    /// Factors of the prior standard deviations of in-flight motion.
    pub prior_scales: PriorScales,
    /// Stated widths that the frames refute.
    pub widened: WidenedPriors,
    /// Common displacement of several markers in all frames.
    pub common_displacement: Option<CommonDisplacement>,
}

impl<'a> Flight<'a> {
    /// Prepares the frames.
    ///
    /// # Errors
    /// Returns an error if a frame has too few markers, an observation is not a number, or the number of mountings differs
    /// from the number of frames.
    pub fn new(
        input: AdjustmentInput<'a>,
        observations: &'a [Vec<Observation>],
        hyperparameters: FlightHyperparameters<'a>,
        knowledge: Knowledge<'a>,
    ) -> AdjustResult<Self> {
        let setup = input.setup;
        let needed = if knowledge.is_alone() {
            MIN_MARKERS_ALONE
        } else {
            MIN_MARKERS
        };
        let frames = observations
            .iter()
            .map(|o| order_by_marker(setup, o))
            .collect::<Result<Vec<_>, _>>()?;
        for frame in &frames {
            let found = count_wing_markers(setup, frame);
            if found < needed {
                return Err(AdjustError::TooFewMarkers { found, needed });
            }
        }
        if !hyperparameters.mountings.match_frame_count(frames.len()) {
            return Err(AdjustError::Input(
                "the number of mountings differs from the number of frames; specify one mounting per frame".into(),
            ));
        }
        let usage = FlightUsage::all_used(frames.len(), setup.markers.len());
        Ok(Self {
            input,
            knowledge,
            frames,
            usage,
            hyperparameters,
            tested_sum: None,
            prior_scales: PriorScales::default(),
            widened: WidenedPriors::default(),
            common_displacement: None,
        })
    }

    /// Candidates for a common displacement, from the markers of all frames.
    pub fn common_displacements(&self) -> Vec<CommonDisplacement> {
        let seen = |marker: usize| self.frames.iter().find_map(|frame| frame[marker]);
        let frame_observations: FrameObservations =
            (0..self.input.setup.markers.len()).map(seen).collect();
        candidate_displacements(&self.input, &frame_observations)
    }

    /// Returns whether a frame without an observation has enough markers left, one more than the least if it shares its
    /// shape: a suspect needs others that contradict it.
    pub fn is_sufficient_without(&self, removed: &RemovedObservation) -> bool {
        let Some(frame) = self.frames.get(removed.group) else {
            return true;
        };
        let needed = if self.knowledge.is_alone() {
            MIN_MARKERS_ALONE
        } else {
            MIN_MARKERS + 1
        };
        let mut usage = self.usage.clone();
        usage.remove(removed);
        let left: Vec<_> = frame
            .iter()
            .zip(&usage.frames[removed.group])
            .map(|(seen, used)| seen.filter(|_| *used))
            .collect();
        count_wing_markers(self.input.setup, &left) >= needed
    }

    /// Builds the group of one frame: its images, with the survey and ground frame if these are observations of the frame,
    /// and last, the condition that ties its curvature to the shared shape if there is one.
    pub fn frame_group(
        &self,
        frame: usize,
        layout: &ParameterLayout,
        from: Option<&Fit>,
    ) -> (Group, Vec<BlockMember>) {
        let mut members = vec![];
        let mut blocks = vec![];
        for (marker, seen) in self.frames[frame].iter().enumerate() {
            let seen = seen.filter(|_| self.usage.frames[frame][marker]);
            if layout.ground_positions == GroundPositions::Observed {
                let (block, member) = self.survey_block(marker, seen);
                members.push(member);
                blocks.push(block);
            } else if let Some(seen) = seen {
                members.push(BlockMember {
                    marker,
                    flight: Some(0),
                    ground: None,
                });
                blocks.push(image_block(seen));
            }
        }
        if !self.knowledge.is_alone() {
            blocks.push(SharedShape::departure_block(
                layout.curvature_terms,
                &self.hyperparameters,
                frame,
            ));
        }
        let mut local = DVector::zeros(layout.local);
        if self.knowledge.is_alone() {
            local[0] = self.hyperparameters.amplitudes_per_m[frame];
        }
        if let Some(fit) = from {
            local.copy_from(&fit.groups[frame].local);
            if let Some(first) = frame_rotation_column(layout) {
                local
                    .rows_mut(first, 3)
                    .copy_from(&self.hyperparameters.frame_rotation_rad(frame));
            }
        }
        (
            Group {
                local,
                priors: layout.local_priors(),
                blocks,
            },
            members,
        )
    }

    /// Builds a marker's block of survey, image in flight if it belongs to the block, and image in the ground frame.
    fn survey_block(&self, marker: usize, seen: Option<&Observation>) -> (Block, BlockMember) {
        let ground = self.input.scene.ground_observations[marker]
            .as_ref()
            .filter(|_| self.usage.ground[marker]);
        let member = BlockMember {
            marker,
            flight: seen.map(|_| 3),
            ground: ground.map(|_| if seen.is_some() { 5 } else { 3 }),
        };
        (
            survey_block(&self.input, marker, seen.into_iter().chain(ground)),
            member,
        )
    }

    /// Builds the group of survey and ground frame.
    pub fn ground_group(&self) -> (Group, Vec<BlockMember>) {
        let one = |marker| self.survey_block(marker, None);
        let (blocks, members) = (0..self.input.setup.markers.len()).map(one).unzip();
        (
            Group {
                local: DVector::zeros(0),
                priors: vec![],
                blocks,
            },
            members,
        )
    }
}
