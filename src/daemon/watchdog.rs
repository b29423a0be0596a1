//! Progress of the threads, on which the watchdog depends: every thread that has work must take steps.

/// Counts of the steps taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Beats {
    /// Steps of the recorder, which always has work (waiting included).
    pub recorder: u64,
    /// Steps of the processing.
    pub processing: u64,
    /// True if the processing has frames to solve or results to store.
    pub processing_busy: bool,
}

/// Compares the counts of one check with those of the next.
#[derive(Default)]
pub(crate) struct ProgressCheck {
    seen: Option<Beats>,
}

impl ProgressCheck {
    /// Returns whether every thread that has work has taken a step since the last check that returned true. Steps add up
    /// until then: the two threads need not both step between two consecutive checks.
    pub fn has_progressed(&mut self, now: Beats) -> bool {
        let moved = self.seen.is_none_or(|seen| {
            let processing = !now.processing_busy || now.processing != seen.processing;
            now.recorder != seen.recorder && processing
        });
        if moved {
            self.seen = Some(now);
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beats(recorder: u64, processing: u64, processing_busy: bool) -> Beats {
        Beats {
            recorder,
            processing,
            processing_busy,
        }
    }

    #[test]
    fn a_stalled_thread_with_work_is_noticed() {
        let mut pulse = ProgressCheck::default();
        assert!(pulse.has_progressed(beats(1, 0, false)), "first check");
        assert!(pulse.has_progressed(beats(2, 0, false)), "nothing to solve");
        assert!(
            !pulse.has_progressed(beats(2, 5, true)),
            "the recorder does not step"
        );
        assert!(
            pulse.has_progressed(beats(3, 5, true)),
            "the earlier step counts"
        );
        assert!(
            !pulse.has_progressed(beats(4, 5, true)),
            "the processing does not step"
        );
        assert!(!pulse.has_progressed(beats(9, 5, true)));
        assert!(pulse.has_progressed(beats(10, 6, true)));
        assert!(pulse.has_progressed(beats(11, 6, false)), "all is solved");
    }
}
