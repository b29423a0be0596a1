//! The frames that a person should look at first.

use std::cmp::Ordering;

use super::Whole;
use crate::record::{GlobalTest, ImageRecord};

/// Markers that were seen and yet took no part.
fn turned_down(record: &ImageRecord) -> usize {
    record.markers.iter().filter(|m| !m.used && m.u_px.is_some()).count()
}

/// Why a frame is to be looked at; `None` where nothing speaks against it.
pub fn doubt(record: &ImageRecord) -> Option<String> {
    if record.global_test == Some(GlobalTest::Rejected) {
        return Some("global test rejected".to_owned());
    }
    match turned_down(record) {
        0 => None,
        1 => Some("1 marker turned down".to_owned()),
        n => Some(format!("{n} markers turned down")),
    }
}

/// Frames whose global test rejects the model stand first, then those with markers turned down, then by variance factor;
/// frames without a result stand last.
fn order(a: &Whole, b: &Whole) -> Ordering {
    let key = |w: &Whole| {
        let r = &w.record;
        let factor = r.variance_factor.filter(|f| f.is_finite()).unwrap_or(0.0);
        (r.is_solved(), r.global_test == Some(GlobalTest::Rejected), turned_down(r), factor)
    };
    let ((s, t, n, f), (s2, t2, n2, f2)) = (key(a), key(b));
    (s2, t2, n2).cmp(&(s, t, n)).then(f2.total_cmp(&f))
}

/// Keeps the frames that are to be looked at first.
pub struct Ranked {
    most: usize,
    /// In their order.
    frames: Vec<Whole>,
}

impl Ranked {
    /// At most so many.
    pub fn new(most: usize) -> Self {
        Self { most, frames: Vec::new() }
    }

    /// Another frame.
    pub fn push(&mut self, frame: Whole) {
        let place = self.frames.partition_point(|known| order(known, &frame) != Ordering::Greater);
        if place < self.most {
            self.frames.insert(place, frame);
            self.frames.truncate(self.most);
        }
    }

    /// In their order.
    pub fn end(self) -> Vec<Whole> {
        self.frames
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    #[test]
    fn a_rejected_frame_stands_first_and_a_failed_one_last() {
        let mut ranked = Ranked::new(3);
        let mut rejected = sample::record("rejected.jpg", 2.0);
        rejected.global_test = Some(GlobalTest::Rejected);
        let mut strained = sample::record("strained.jpg", 2.0);
        strained.variance_factor = Some(1.4);
        let failed = sample::failed("failed.jpg", "dark");
        for record in [failed, sample::record("good.jpg", 2.0), strained, rejected] {
            ranked.push(Whole { series: "s1".to_owned(), record });
        }
        let names: Vec<String> = ranked.end().into_iter().map(|w| w.record.image).collect();
        assert_eq!(names, ["rejected.jpg", "strained.jpg", "good.jpg"]);
    }
}
