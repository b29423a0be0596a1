//! Adjustments that return the joint shape of one frame or of a flight.

use nalgebra::DMatrix;

use super::flight;
use super::joint_shape::{
    FrameShape, JointShape, ShapeFunctions, StationChoice, empty_shape, reduce_factors,
};
use super::outcome::FrameOutcome;
use super::{AdjustResult, Observation, Options};
use crate::estimation::symmetric_root;
use crate::setup::{Orientation, Setup};

/// Adjusts one frame and returns its shape; all of its errors are its own.
///
/// # Errors
/// Returns an error if the frame has no solution.
pub fn solve_frame_shape(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
    stations: &StationChoice,
) -> AdjustResult<JointShape> {
    let derive = |outcome: &FrameOutcome| {
        let mut shape = empty_shape(outcome, stations);
        let ShapeFunctions {
            values,
            by_global,
            own,
        } = outcome.shape_functions(&shape);
        let global = by_global * symmetric_root(&outcome.solved.fit.covariance);
        let columns: Vec<_> = global.column_iter().chain(own.column_iter()).collect();
        let own = reduce_factors(vec![DMatrix::from_columns(&columns)]).pop();
        let none = DMatrix::zeros(values.len(), 0);
        shape.frames.push(FrameShape {
            factors: [none.clone(), none.clone(), own.unwrap_or(none)],
            values,
        });
        shape
    };
    let (solution, shape) =
        flight::solve_frame_with(setup, orientation, observations, options, derive)?;
    Ok(JointShape {
        solutions: vec![solution],
        ..shape
    })
}

/// Adjusts the frames of a flight jointly and returns their joint shape.
///
/// # Errors
/// Returns an error if the flight has no solution.
pub fn solve_flight_shape(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
    stations: &StationChoice,
) -> AdjustResult<JointShape> {
    let result = flight::solve_flight_with(setup, orientation, frames, options, |joint| {
        joint.joint_shape(stations)
    })?;
    let (mut solutions, mut left_out) = (vec![], vec![]);
    for (frame, solution) in result.solutions.into_iter().enumerate() {
        match solution.doubt {
            Some(doubt) if !result.joint_frames.contains(&frame) => left_out.push((frame, doubt)),
            _ => solutions.push(solution),
        }
    }
    Ok(JointShape {
        solutions,
        left_out,
        ..result.derived?
    })
}
