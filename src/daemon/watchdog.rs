//! The watchdog goes by this: every thread that has work must take steps.

/// Steps counted so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Beats {
    /// The recorder's; it always has work, waiting included.
    pub recorder: u64,
    /// The processing's.
    pub processing: u64,
    /// It has frames to solve, or results to store.
    pub processing_busy: bool,
}

/// Compares one look with the next.
#[derive(Default)]
pub(crate) struct Pulse {
    seen: Option<Beats>,
}

impl Pulse {
    /// Whether all that had work has taken a step since the last look that found so. Steps are kept until
    /// then: the two threads need not step between the same two looks.
    pub fn moved(&mut self, now: Beats) -> bool {
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
        Beats { recorder, processing, processing_busy }
    }

    #[test]
    fn a_thread_that_stands_still_with_work_is_noticed() {
        let mut pulse = Pulse::default();
        assert!(pulse.moved(beats(1, 0, false)), "the first look");
        assert!(pulse.moved(beats(2, 0, false)), "nothing to solve");
        assert!(!pulse.moved(beats(2, 5, true)), "the recorder stands");
        assert!(pulse.moved(beats(3, 5, true)), "the step of before counts");
        assert!(!pulse.moved(beats(4, 5, true)), "the processing stands");
        assert!(!pulse.moved(beats(9, 5, true)));
        assert!(pulse.moved(beats(10, 6, true)));
        assert!(pulse.moved(beats(11, 6, false)), "all is solved");
    }
}
