//! Joint shapes of a flight's frames, with their covariance.

use super::flight_priors::PreparedFlight;
use super::guard::{PANIC_REASON, catch_panic};
use super::{
    ProcessedFrame, SolveJob, correct_refraction, single_frame_options, with_frame_conditions,
};
use crate::installation::Installation;
use crate::record::Reason;
use wingd_measure::adjust;
use wingd_measure::adjust::AdjustResult;
use wingd_measure::adjust::{JointShape, StationChoice};
use wingd_measure::setup::Orientation;

/// Shape of frames that were adjusted together: those of a flight, or a single one.
pub struct SolvedShape {
    /// Shape with one entry per frame.
    pub shape: JointShape,
    /// Indices of these frames among the processed ones.
    pub frames: Vec<usize>,
}

/// Adjusts processed frames as [`super::solve_flight`] or [`super::solve_processed_frame`] and returns their shapes: one of
/// all frames if they are adjusted `jointly`, else one per frame. Also returns the frames that have none, with the reason.
pub fn solve_shapes(
    processed_frames: &[ProcessedFrame],
    installation: &Installation,
    orientation: &Orientation,
    job: &SolveJob,
    (jointly, stations): (bool, &StationChoice),
) -> (Vec<SolvedShape>, Vec<(usize, Reason)>) {
    if jointly {
        let PreparedFlight {
            setup,
            corrected,
            frames,
            options,
            ..
        } = PreparedFlight::new(processed_frames, installation, orientation, job);
        let solve = || adjust::solve_flight_shape(&setup, orientation, &frames, &options, stations);
        let (mut used, mut failed) = (vec![], vec![]);
        for (k, outcome) in corrected.into_iter().enumerate() {
            match outcome {
                Ok(_) => used.push(k),
                Err(reason) => failed.push((k, reason)),
            }
        }
        let shapes = match catch_shape(solve) {
            Ok(shape) => {
                let mut frames = used;
                for (at, doubt) in shape.left_out.iter().rev() {
                    failed.push((frames.remove(*at), doubt.clone().into()));
                }
                vec![SolvedShape { shape, frames }]
            }
            Err(reason) => {
                failed.extend(used.into_iter().map(|k| (k, reason.clone())));
                vec![]
            }
        };
        return (shapes, failed);
    }
    let (mut shapes, mut failed) = (vec![], vec![]);
    for (k, processed) in processed_frames.iter().enumerate() {
        let installation = &*with_frame_conditions(processed, installation);
        let (options, _) = single_frame_options(processed, installation, job);
        let solved = correct_refraction(processed, installation, orientation).and_then(
            |(observations, _)| {
                let setup = &installation.setup;
                catch_shape(|| {
                    adjust::solve_frame_shape(setup, orientation, &observations, &options, stations)
                })
            },
        );
        match solved {
            Ok(shape) => shapes.push(SolvedShape {
                shape,
                frames: vec![k],
            }),
            Err(reason) => failed.push((k, reason)),
        }
    }
    (shapes, failed)
}

fn catch_shape(solve: impl FnOnce() -> AdjustResult<JointShape>) -> Result<JointShape, Reason> {
    catch_panic(solve)
        .ok_or_else(|| PANIC_REASON.into())
        .and_then(|shape| shape.map_err(Reason::from_error))
}
