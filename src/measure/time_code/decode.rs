//! Cells -> the time shown.

use std::collections::BTreeSet;

use super::{BITS, COUNT_BITS, COUNT_MASK, PARITY, TICK_MS, gray_code, code_word};

/// Most bits of a count that one exposure may mix: each doubles what is tried.
const MAX_MIXED_FRACTION: u32 = 5;
/// Most ticks in a row that one exposure may mix: so many change five bits.
const MAX_TICKS: u32 = 16;
/// Counts before the code begins anew.
const COUNTS: u32 = 1 << COUNT_BITS;
/// Up to so many ticks a picture may show new rows above old ones: a screen is written row by row.
const TORN: u32 = 2;

/// What a picture shows: bits that are one, bits that are mixed, the others zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CellPattern {
    pub one: u32,
    pub mixed: u32,
}

/// The time that a picture shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplayedTime {
    /// Middle of the ticks that the exposure saw, ms of UTC, whole turns of the code left out.
    pub middle_ms: f64,
    /// The middle may lie anywhere in this width, ms: a tick, and what mixed bits leave open.
    pub width_ms: f64,
    /// Ticks that the exposure saw, at least.
    pub ticks: u32,
}

/// The shortest runs of ticks that show bits that are one, bits that are mixed, and the others zero; `None` where there are
/// none, or several that are no neighbours.
pub fn decode_time(one: u32, mixed: u32) -> Option<DisplayedTime> {
    let pattern = CellPattern { one, mixed };
    if !has_parity(&pattern) {
        return None;
    }
    let seen = candidate_counts(&pattern)?;
    (1..=MAX_TICKS).find_map(|ticks| {
        let starts =
            seen.iter().flat_map(|&count| (0..ticks).map(move |before| count.wrapping_sub(before) % COUNTS));
        let starts: BTreeSet<u32> = starts.filter(|&start| explains_pattern(start, ticks, &pattern)).collect();
        (!starts.is_empty()).then(|| time_from_runs(&starts, ticks))
    })?
}

/// Whether the bits of the count have the parity that is shown, where none of them is mixed: a run of two ticks would explain
/// any one that is turned. A picture that is torn between the two is turned down too.
fn has_parity(pattern: &CellPattern) -> bool {
    let shown = COUNT_MASK | PARITY;
    pattern.mixed & shown != 0 || (pattern.one & shown).count_ones().is_multiple_of(2)
}

/// Counts that agree with all bits that are not mixed.
fn candidate_counts(pattern: &CellPattern) -> Option<Vec<u32>> {
    let (one, mixed) = (gray_code(pattern.one), gray_code(pattern.mixed));
    if mixed.count_ones() > MAX_MIXED_FRACTION {
        return None;
    }
    // All subsets of the mixed bits.
    let mut all = vec![one];
    for bit in (0..COUNT_BITS).filter(|bit| mixed >> bit & 1 == 1) {
        let with: Vec<u32> = all.iter().map(|gray| gray | 1 << bit).collect();
        all.extend(with);
    }
    Some(all.into_iter().map(count_from_gray).collect())
}

fn count_from_gray(gray: u32) -> u32 {
    (0..COUNT_BITS).fold(0, |count, shift| count ^ gray >> shift)
}

/// Whether a run shows the pattern: a mixed bit changes in it, another one has its value in it. In longer runs than those of
/// a torn picture no other bit of the count changes.
fn explains_pattern(start: u32, ticks: u32, pattern: &CellPattern) -> bool {
    let words = (0..ticks).map(|k| code_word(start.wrapping_add(k)));
    let (all, any) = words.fold((u32::MAX, 0), |(all, any), word| (all & word, any | word));
    let shown = (1 << BITS) - 1;
    let zero = shown & !pattern.one & !pattern.mixed;
    let changes = any & !all & shown;
    let there = pattern.one & !any == 0 && zero & all == 0 && pattern.mixed & !changes == 0;
    there && (ticks <= TORN || changes & COUNT_MASK & !pattern.mixed == 0)
}

fn time_from_runs(starts: &BTreeSet<u32>, ticks: u32) -> Option<DisplayedTime> {
    // Neighbours, also about the end of the code.
    let first = *starts.iter().find(|start| !starts.contains(&(start.wrapping_sub(1) % COUNTS)))?;
    let more = starts.len() as u32 - 1;
    if !(0..=more).all(|k| starts.contains(&((first + k) % COUNTS))) {
        return None;
    }
    let tick = f64::from(TICK_MS);
    Some(DisplayedTime {
        middle_ms: (f64::from(first) + 0.5 * f64::from(more + ticks)) * tick,
        width_ms: f64::from(1 + more) * tick,
        ticks,
    })
}

/// The moment nearest to `about_ms` (ms of UTC) at which the code shows this.
pub fn nearest_time(shown: &DisplayedTime, about_ms: f64) -> f64 {
    let turn = f64::from(COUNTS) * f64::from(TICK_MS);
    let apart = (shown.middle_ms - about_ms).rem_euclid(turn);
    about_ms + if apart > 0.5 * turn { apart - turn } else { apart }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn shown_by(counts: std::ops::Range<u32>) -> Option<DisplayedTime> {
        let (all, any) = counts.map(code_word).fold((u32::MAX, 0), |(all, any), word| (all & word, any | word));
        decode_time(all & ((1 << BITS) - 1), any & !all)
    }

    #[test]
    fn every_count_is_read() {
        for count in (0..COUNTS).step_by(61).chain([COUNTS - 1]) {
            let shown = shown_by(count..count + 1).unwrap();
            assert_eq!((shown.middle_ms, shown.width_ms), ((f64::from(count) + 0.5) * 19.0, 19.0));
        }
    }

    #[test]
    fn an_exposure_over_several_ticks_has_its_middle_within_what_is_stated() {
        for start in (0..COUNTS).step_by(13) {
            for ticks in 1..10u32 {
                let Some(shown) = shown_by(start..start + ticks) else { continue };
                let middle = (f64::from(start) + 0.5 * f64::from(ticks)) * 19.0;
                let turn = f64::from(COUNTS) * 19.0;
                let off = (shown.middle_ms - middle + 0.5 * turn).rem_euclid(turn) - 0.5 * turn;
                assert!(2.0 * off.abs() <= shown.width_ms - 19.0 + 1e-9, "{start} {ticks} {shown:?}");
            }
        }
    }

    #[test]
    fn a_torn_picture_is_read_and_what_is_no_word_is_not() {
        // One bit of the check is the next tick's already.
        let before = (1 << 12) - 1;
        let turned = (code_word(before) ^ code_word(before + 1)) & 0b11110;
        let lowest = 1 << turned.trailing_zeros();
        assert!(lowest < 0b100000);
        let torn = decode_time(code_word(before) ^ lowest, 0).unwrap();
        assert_eq!((torn.ticks, torn.middle_ms), (2, f64::from(before + 1) * 19.0));
        // A slow bit alone.
        assert_eq!(decode_time(code_word(5000) ^ 1 << 20, 0), None);
        assert_eq!(decode_time(code_word(5000) & !(1 << 20), 1 << 20), None);
        // Upside down: the opposites in the opposite order.
        let upside = |word: u32| (0..BITS).map(|bit| (!word >> (BITS - 1 - bit) & 1) << bit).sum::<u32>();
        assert!((0..COUNTS).all(|count| decode_time(upside(code_word(count)), 0).is_none()));
    }

    #[test]
    fn one_turned_bit_of_the_count_or_its_parity_is_turned_down() {
        for count in (0..COUNTS).step_by(61) {
            for bit in (0..BITS).filter(|bit| (COUNT_MASK | PARITY) >> bit & 1 == 1) {
                assert_eq!(decode_time(code_word(count) ^ 1 << bit, 0), None, "{count} {bit}");
            }
        }
    }

    #[test]
    fn the_moment_is_the_nearest_one() {
        let shown = DisplayedTime { middle_ms: 1000.0, width_ms: 19.0, ticks: 1 };
        let turn = f64::from(COUNTS) * 19.0;
        for about in [-3e5, 0.0, 9e5, 7.0 * turn - 5e5] {
            let moment = nearest_time(&shown, about);
            assert!((moment - about).abs() <= 0.5 * turn && (moment - 1000.0).rem_euclid(turn) < 1e-3);
        }
    }
}
