//! Adjustments that return the joint shape of one frame or of a flight.

use nalgebra::{DMatrix, DVector};

use super::flight;
use super::joint_shape::{
    FrameShape, JointShape, ShapeFunctions, StationChoice, empty_shape, reduce_factors,
};
use super::outcome::FrameOutcome;
use super::spatial::solve_spatial_with;
use super::{AdjustResult, Observation, Options};
use crate::estimation::symmetric_root;
use crate::setup::{Orientation, Setup};

/// Adjusts one frame and returns its shape; all of its errors are its own.
///
/// # Errors
/// Returns an error if the frame has no solution or a station is not on the wing.
pub fn solve_frame_shape(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
    stations: &StationChoice,
) -> AdjustResult<JointShape> {
    type FrameParts = (JointShape, DVector<f64>, Vec<DMatrix<f64>>);
    let derive = |outcome: &FrameOutcome| -> AdjustResult<FrameParts> {
        let shape = empty_shape(outcome, stations)?;
        let ShapeFunctions {
            values,
            by_global,
            own,
        } = outcome.shape_functions(&shape);
        let global = by_global * symmetric_root(&outcome.solved.fit.covariance);
        let columns: Vec<_> = global.column_iter().chain(own.column_iter()).collect();
        Ok((
            shape,
            values,
            reduce_factors(vec![DMatrix::from_columns(&columns)]),
        ))
    };
    let (solution, derived) =
        solve_spatial_with(setup, orientation, observations, options, &derive)?;
    let (mut shape, values, factors) = derived?;
    let none = DMatrix::zeros(values.len(), 0);
    let own = factors.into_iter().next().unwrap_or_else(|| none.clone());
    shape.frames.push(FrameShape {
        values,
        lasting: none.clone(),
        shared: none,
        own,
        solution,
    });
    Ok(shape)
}

/// Adjusts the frames of a flight jointly and returns their joint shape.
///
/// # Errors
/// Returns an error if the flight has no solution or a station is not on the wing.
pub fn solve_flight_shape(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
    stations: &StationChoice,
) -> AdjustResult<JointShape> {
    let (solutions, derived) =
        flight::solve_flight_with(setup, orientation, frames, options, |joint| {
            joint.joint_shape(stations)
        })?;
    let (mut shape, of_frames) = derived?;
    shape.frames = solutions
        .into_iter()
        .zip(of_frames)
        .map(|(solution, frame)| FrameShape { solution, ..frame })
        .collect();
    Ok(shape)
}
