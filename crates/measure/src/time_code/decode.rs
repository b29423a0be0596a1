//! Decoder of the time code: cells in, displayed time out.

use std::collections::BTreeSet;

use super::{BITS, COUNT_BITS, COUNT_MASK, PARITY, TICK_MS, code_word, gray_code};

/// Maximum number of count bits that one exposure may mix: each doubles the candidates.
const MAX_MIXED_FRACTION: u32 = 5;
/// Maximum number of consecutive ticks in one exposure: 16 ticks change five bits.
const MAX_TICKS: u32 = 16;
/// Number of counts after which the code repeats.
const COUNTS: u32 = 1 << COUNT_BITS;
/// Maximum number of ticks in which an image may show new rows above old ones: a screen is updated row by row.
const MAX_TORN_TICKS: u32 = 2;

/// Cells of an image: bits that are one, bits that are mixed; the others are zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CellPattern {
    pub ones: u32,
    pub mixed: u32,
}

/// Time displayed in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplayedTime {
    /// Middle of the ticks visible in the exposure, ms of UTC, modulo the period of the code.
    pub middle_ms: f64,
    /// Length of the interval in which the middle lies, ms: a tick, plus the ambiguity of mixed bits.
    pub width_ms: f64,
    /// Minimum number of ticks visible in the exposure.
    pub ticks: u32,
}

/// Finds the shortest runs of ticks that show these ones and mixed bits; `None` if there are none, or several that are not
/// adjacent.
pub fn decode_time(one: u32, mixed: u32) -> Option<DisplayedTime> {
    let pattern = CellPattern { ones: one, mixed };
    if !has_parity(&pattern) {
        return None;
    }
    let seen = candidate_counts(&pattern)?;
    (1..=MAX_TICKS).find_map(|ticks| {
        let starts = seen
            .iter()
            .flat_map(|&count| (0..ticks).map(move |before| count.wrapping_sub(before) % COUNTS));
        let starts: BTreeSet<u32> = starts
            .filter(|&start| explains_pattern(start, ticks, &pattern))
            .collect();
        (!starts.is_empty()).then(|| time_from_runs(&starts, ticks))
    })?
}

/// Checks the parity of the count's bits if none of them is mixed; otherwise a run of two ticks would explain any wrong
/// bit. An image torn between two ticks is rejected too.
fn has_parity(pattern: &CellPattern) -> bool {
    let shown = COUNT_MASK | PARITY;
    pattern.mixed & shown != 0 || (pattern.ones & shown).count_ones().is_multiple_of(2)
}

/// Returns the counts that agree with all bits that are not mixed.
fn candidate_counts(pattern: &CellPattern) -> Option<Vec<u32>> {
    let (one, mixed) = (gray_code(pattern.ones), gray_code(pattern.mixed));
    if mixed.count_ones() > MAX_MIXED_FRACTION {
        return None;
    }
    // All subsets of the mixed bits.
    let mut all = vec![one];
    for bit in (0..COUNT_BITS).filter(|bit| mixed >> bit & 1 == 1) {
        let with: Vec<u32> = all.iter().map(|gray| gray | 1 << bit).collect();
        all.extend(with);
    }
    Some(all.into_iter().map(count_from_gray_code).collect())
}

fn count_from_gray_code(gray: u32) -> u32 {
    (0..COUNT_BITS).fold(0, |count, shift| count ^ gray >> shift)
}

/// Returns true if a run shows the pattern: every mixed bit changes in it, every other bit has its value in it. In runs
/// longer than those of a torn image no other bit of the count changes.
fn explains_pattern(start: u32, ticks: u32, pattern: &CellPattern) -> bool {
    let words = (0..ticks).map(|k| code_word(start.wrapping_add(k)));
    let (all, any) = words.fold((u32::MAX, 0), |(all, any), word| (all & word, any | word));
    let shown = (1 << BITS) - 1;
    let zero = shown & !pattern.ones & !pattern.mixed;
    let changes = any & !all & shown;
    let there = pattern.ones & !any == 0 && zero & all == 0 && pattern.mixed & !changes == 0;
    there && (ticks <= MAX_TORN_TICKS || changes & COUNT_MASK & !pattern.mixed == 0)
}

fn time_from_runs(starts: &BTreeSet<u32>, ticks: u32) -> Option<DisplayedTime> {
    // Neighbours, including those across the end of the code.
    let first = *starts
        .iter()
        .find(|start| !starts.contains(&(start.wrapping_sub(1) % COUNTS)))?;
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

/// Returns the time nearest to `about_ms` (ms of UTC) at which the code is displayed.
pub fn nearest_time(shown: &DisplayedTime, about_ms: f64) -> f64 {
    let turn = f64::from(COUNTS) * f64::from(TICK_MS);
    let offset = (shown.middle_ms - about_ms).rem_euclid(turn);
    about_ms
        + if offset > 0.5 * turn {
            offset - turn
        } else {
            offset
        }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown_by(counts: std::ops::Range<u32>) -> Option<DisplayedTime> {
        let (all, any) = counts
            .map(code_word)
            .fold((u32::MAX, 0), |(all, any), word| (all & word, any | word));
        decode_time(all & ((1 << BITS) - 1), any & !all)
    }

    #[test]
    fn every_count_is_read() {
        for count in (0..COUNTS).step_by(61).chain([COUNTS - 1]) {
            let shown = shown_by(count..count + 1).unwrap();
            assert_eq!(
                (shown.middle_ms, shown.width_ms),
                ((f64::from(count) + 0.5) * 19.0, 19.0)
            );
        }
    }

    #[test]
    fn the_middle_of_a_long_exposure_is_within_its_interval() {
        for start in (0..COUNTS).step_by(13) {
            for ticks in 1..10u32 {
                let Some(shown) = shown_by(start..start + ticks) else {
                    continue;
                };
                let middle = (f64::from(start) + 0.5 * f64::from(ticks)) * 19.0;
                let turn = f64::from(COUNTS) * 19.0;
                let off = (shown.middle_ms - middle + 0.5 * turn).rem_euclid(turn) - 0.5 * turn;
                assert!(
                    2.0 * off.abs() <= shown.width_ms - 19.0 + 1e-9,
                    "{start} {ticks} {shown:?}"
                );
            }
        }
    }

    #[test]
    fn torn_images_are_read_and_invalid_words_rejected() {
        // One bit of the check already belongs to the next tick.
        let before = (1 << 12) - 1;
        let turned = (code_word(before) ^ code_word(before + 1)) & 0b11110;
        let lowest = 1 << turned.trailing_zeros();
        assert!(lowest < 0b100000);
        let torn = decode_time(code_word(before) ^ lowest, 0).unwrap();
        assert_eq!(
            (torn.ticks, torn.middle_ms),
            (2, f64::from(before + 1) * 19.0)
        );
        // A slow bit alone.
        assert_eq!(decode_time(code_word(5000) ^ 1 << 20, 0), None);
        assert_eq!(decode_time(code_word(5000) & !(1 << 20), 1 << 20), None);
        // Upside down: the complements in reverse order.
        let upside = |word: u32| {
            (0..BITS)
                .map(|bit| (!word >> (BITS - 1 - bit) & 1) << bit)
                .sum::<u32>()
        };
        assert!((0..COUNTS).all(|count| decode_time(upside(code_word(count)), 0).is_none()));
    }

    #[test]
    fn one_inverted_bit_of_the_count_or_its_parity_is_rejected() {
        for count in (0..COUNTS).step_by(61) {
            for bit in (0..BITS).filter(|bit| (COUNT_MASK | PARITY) >> bit & 1 == 1) {
                assert_eq!(
                    decode_time(code_word(count) ^ 1 << bit, 0),
                    None,
                    "{count} {bit}"
                );
            }
        }
    }

    #[test]
    fn the_moment_is_the_nearest_one() {
        let shown = DisplayedTime {
            middle_ms: 1000.0,
            width_ms: 19.0,
            ticks: 1,
        };
        let turn = f64::from(COUNTS) * 19.0;
        for about in [-3e5, 0.0, 9e5, 7.0 * turn - 5e5] {
            let moment = nearest_time(&shown, about);
            assert!(
                (moment - about).abs() <= 0.5 * turn && (moment - 1000.0).rem_euclid(turn) < 1e-3
            );
        }
    }
}
