//! Knowledge with which frames are adjusted.

use nalgebra::DVector;

use super::load_twist::LoadTwist;
use super::shape::SharedShape;
use crate::adjust::layout::ParameterLayout;
use crate::adjust::snooping::Suspect;
use crate::estimation::InformationPrior;

/// Knowledge with which frames are adjusted, in addition to survey, ground frame and prior standard deviations.
#[derive(Clone, Copy)]
pub enum Knowledge<'a> {
    /// None: a single frame has a shape of its own, whose prior is weighted with its amplitude.
    Alone,
    /// The frames share the shape of bending, with each other or, by the prior from earlier flights, with those.
    Shared,
    /// State after earlier frames.
    After(&'a EarlierFrames<'a>),
}

impl Knowledge<'_> {
    /// Returns whether a frame is adjusted alone, without any.
    pub fn is_alone(self) -> bool {
        matches!(self, Self::Alone)
    }
}

/// Model shared by all live frames, fixed at the first frame so that the unknowns keep their meaning.
#[derive(Clone, Debug)]
pub struct LiveModel {
    /// Columns of the unknowns.
    pub layout: ParameterLayout,
    /// Text per global parameter for the case that it cannot be determined.
    pub missing: Vec<&'static str>,
    /// Shape of bending that the frames share.
    pub shape: Option<SharedShape>,
    /// Markers with a wrong surveyed position.
    pub wrong: Vec<Suspect>,
}

/// State after earlier frames, as it is used for the next one.
pub struct EarlierFrames<'a> {
    pub model: &'a LiveModel,
    /// Columns of the unknowns, with the row times of the next frame.
    pub layout: ParameterLayout,
    /// Start values of the next frame's local unknowns.
    pub local: &'a DVector<f64>,
    /// Twist in proportion to the bending.
    pub twist: &'a LoadTwist,
    /// Estimate of the parameters that all frames share.
    pub known: &'a InformationPrior,
}
