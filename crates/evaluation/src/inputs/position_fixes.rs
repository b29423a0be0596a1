//! Position fixes in the metadata of images that cannot be the times of their images.

use std::collections::BTreeMap;

use jiff::{SignedDuration, Timestamp};

/// Largest time for which images of one burst can share a position fix.
const FIX_STEP: SignedDuration = SignedDuration::from_secs(2);
/// Period after which receivers count their weeks from 0 again, 1,024 weeks, s.
const WEEK_ROLLOVER_S: f64 = 1024.0 * 7.0 * 86_400.0;
/// Largest offset of a clock from its fix beside whole periods: any zone and an old fix, s.
const MAX_REST_S: f64 = 15.0 * 3600.0;

/// Reason why a position fix is not the time of its image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WrongFix {
    /// The camera repeats its last fix without reception.
    Repeated,
    /// The receiver missed a rollover of its weeks.
    Rollover,
}

impl WrongFix {
    /// Returns the predicate of a sentence about images.
    pub fn text(self) -> &'static str {
        match self {
            Self::Repeated => "repeat the position fix of another image",
            Self::Rollover => {
                "have a position fix that is off by whole periods of 1,024 weeks: the receiver missed a week rollover"
            }
        }
    }
}

/// Returns for each image, given by its fix and the time of its camera's clock, why the fix is not its time.
pub(super) fn find_wrong_fixes(
    images: &[(Option<Timestamp>, Option<Timestamp>)],
) -> Vec<Option<WrongFix>> {
    let mut sharing: BTreeMap<Timestamp, Vec<Option<Timestamp>>> = BTreeMap::new();
    for (fix, clock) in images {
        fix.iter()
            .for_each(|fix| sharing.entry(*fix).or_default().push(*clock));
    }
    let is_frozen = |clocks: &Vec<Option<Timestamp>>| {
        let known = clocks.iter().copied().collect::<Option<Vec<_>>>();
        let span = known.and_then(|k| Some((*k.iter().min()?, *k.iter().max()?)));
        clocks.len() > 1 && span.is_none_or(|(first, last)| last.duration_since(first) > FIX_STEP)
    };
    sharing.retain(|_, clocks| is_frozen(clocks));
    let missed_rollover = |fix: Timestamp, clock: Timestamp| {
        let ahead_s = clock.duration_since(fix).as_secs_f64();
        let periods = (ahead_s / WEEK_ROLLOVER_S).round();
        periods != 0.0 && (ahead_s - periods * WEEK_ROLLOVER_S).abs() < MAX_REST_S
    };
    let wrong = |(fix, clock): &(Option<Timestamp>, Option<Timestamp>)| {
        let fix = (*fix)?;
        match clock {
            _ if sharing.contains_key(&fix) => Some(WrongFix::Repeated),
            Some(clock) if missed_rollover(fix, *clock) => Some(WrongFix::Rollover),
            _ => None,
        }
    };
    images.iter().map(wrong).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Images every minute from 8 o'clock by their clocks, with these fixes.
    fn images(fix: impl Fn(i64) -> i64) -> Vec<(Option<Timestamp>, Option<Timestamp>)> {
        let second = |s: i64| Some(Timestamp::from_second(s).unwrap());
        let at = |k: i64| 1_780_300_800 + 60 * k;
        (0..4)
            .map(|k| (second(fix(at(k))), second(at(k))))
            .collect()
    }

    #[test]
    fn fixes_that_repeat_or_missed_a_rollover_are_wrong() {
        let repeated = images(|_| 1_780_300_500);
        assert_eq!(find_wrong_fixes(&repeated), [Some(WrongFix::Repeated); 4]);
        let without_clock: Vec<_> = repeated.iter().map(|(fix, _)| (*fix, None)).collect();
        assert_eq!(
            find_wrong_fixes(&without_clock),
            [Some(WrongFix::Repeated); 4]
        );
        let early = images(|clock| clock - 1024 * 7 * 86_400 - 3600);
        assert_eq!(find_wrong_fixes(&early), [Some(WrongFix::Rollover); 4]);
        // Of a clock that is wrong, and of a burst within a second.
        assert_eq!(find_wrong_fixes(&images(|clock| clock + 3600)), [None; 4]);
        let burst: Vec<_> = repeated
            .iter()
            .map(|(fix, _)| (*fix, repeated[0].1))
            .collect();
        assert_eq!(find_wrong_fixes(&burst), [None; 4]);
    }
}
