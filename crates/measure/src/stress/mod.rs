//! Bending moments from the curve of a bent wing (docs/stress.md).

mod moment;

pub use moment::{BendingCurvature, BendingMoment, DEFAULT_STEPS, MomentFunction};
