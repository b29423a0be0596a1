//! Ranking of the frames that should be checked first.

use std::cmp::Ordering;

use super::FullRecord;
use crate::record::ImageRecord;
use wingd_measure::estimation::quality::GlobalTest;

/// Counts the markers that were detected but not used.
fn count_rejected_markers(record: &ImageRecord) -> usize {
    record
        .markers
        .iter()
        .filter(|m| !m.used && m.u_px.is_some())
        .count()
}

/// Returns the warning for a frame; `None` if there is none.
pub fn frame_warning(record: &ImageRecord) -> Option<String> {
    if record.global_test == Some(GlobalTest::Rejected) {
        return Some("global test rejected".to_owned());
    }
    match count_rejected_markers(record) {
        0 => None,
        1 => Some("1 marker rejected".to_owned()),
        n => Some(format!("{n} markers rejected")),
    }
}

/// Orders frames: global test rejected first, then the number of rejected markers, then the variance factor; frames without
/// a result come last.
fn ranking_order(a: &FullRecord, b: &FullRecord) -> Ordering {
    let key = |w: &FullRecord| {
        let r = &w.record;
        let factor = r.variance_factor.filter(|f| f.is_finite()).unwrap_or(0.0);
        (
            r.is_solved(),
            r.global_test == Some(GlobalTest::Rejected),
            count_rejected_markers(r),
            factor,
        )
    };
    let ((s, t, n, f), (s2, t2, n2, f2)) = (key(a), key(b));
    (s2, t2, n2).cmp(&(s, t, n)).then(f2.total_cmp(&f))
}

/// List of the frames that rank first, of limited length.
pub struct FrameRanking {
    most: usize,
    /// Frames in ranking order.
    frames: Vec<FullRecord>,
}

impl FrameRanking {
    /// Creates an empty ranking of at most `most` frames.
    pub fn new(most: usize) -> Self {
        Self {
            most,
            frames: Vec::new(),
        }
    }

    /// Inserts a frame at its rank.
    pub fn push(&mut self, frame: FullRecord) {
        let place = self
            .frames
            .partition_point(|known| ranking_order(known, &frame) != Ordering::Greater);
        if place < self.most {
            self.frames.insert(place, frame);
            self.frames.truncate(self.most);
        }
    }

    /// Returns the frames in ranking order.
    pub fn into_frames(self) -> Vec<FullRecord> {
        self.frames
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    #[test]
    fn a_rejected_frame_is_first_and_a_failed_one_last() {
        let mut ranked = FrameRanking::new(3);
        let mut rejected = sample::record("rejected.jpg", 2.0);
        rejected.global_test = Some(GlobalTest::Rejected);
        let mut strained = sample::record("strained.jpg", 2.0);
        strained.variance_factor = Some(1.4);
        let failed = sample::failed("failed.jpg", "dark");
        for record in [failed, sample::record("good.jpg", 2.0), strained, rejected] {
            ranked.push(FullRecord {
                series: "s1".to_owned(),
                record,
            });
        }
        let names: Vec<String> = ranked
            .into_frames()
            .into_iter()
            .map(|w| w.record.image)
            .collect();
        assert_eq!(names, ["rejected.jpg", "strained.jpg", "good.jpg"]);
    }
}
