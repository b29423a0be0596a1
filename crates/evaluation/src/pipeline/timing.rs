//! Durations of the stages of a frame, as the record has them.

use super::StageTime;
use crate::record::Timing;
use wingd_measure::view::Work;

/// Rounds milliseconds to 0.001.
pub fn round_ms(ms: f64) -> f64 {
    (ms * 1e3).round() / 1e3
}

/// Sums the durations of each stage.
pub fn stage_timing(stages: &[StageTime]) -> Timing {
    // A frame may have been searched more than once.
    let of = |work| {
        let own = || stages.iter().filter(|s| s.work == work).map(|s| s.ms);
        own().next().map(|_| round_ms(own().sum()))
    };
    Timing {
        decode: of(Work::Decode),
        detect: of(Work::Detect),
        identify: of(Work::Identify),
        solve: of(Work::Solve),
    }
}
