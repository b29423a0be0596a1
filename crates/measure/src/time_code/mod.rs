//! Time code on a screen, which is photographed to measure the instant of exposure.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | code | count of ticks | bits | this one |
//! | picture | frame, discs found in it | cells: one, zero, mixed | `picture` |
//! | decode | cells | time displayed, with its ambiguity | `decode` |
//! | delay | differences of many images | mean, scatter, standard deviation | `delay` |
//!
//! The screen shows the count of whole ticks of UTC in Gray code, in which neighbours differ by one bit, with its parity
//! and a check of its slow bits (Hamming 1950). Each bit is two adjacent cells, itself and its complement, so that uneven
//! light, glare and shade cannot invert one.

mod decode;
mod delay;
mod picture;

pub use decode::{DisplayedTime, decode_time, nearest_time};
pub use delay::{DelayEstimate, ExposureTest, Screen, estimate_delay};
pub use picture::{TimeCodeError, read_time};

/// Tick of the code, ms. Longer than a frame of a screen at 60 Hz, so that no count is skipped; a prime number, so that
/// images at a round rate meet it in every phase.
pub const TICK_MS: u32 = 19;
/// Number of bits of the count, which repeats every 41.5 minutes.
pub const COUNT_BITS: usize = 17;
/// Number of bits displayed: one, parity, check, count, one.
pub const BITS: usize = 24;
/// Number of the count's fastest bits, which parity covers instead of the check.
pub const FAST_BITS: usize = 6;
/// Columns of the check, Hamming's (15, 11) code: for each slow bit of the Gray code the check bits that it inverts.
pub const HAMMING: [u32; 11] = [3, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15];

/// Width and height of the page on the screen, in its own units.
pub const SIZE: [f64; 2] = [16.0, 9.0];
/// Centres of the discs, clockwise from the top left.
pub const DISCS: [[f64; 2]; 4] = [[1.0, 1.0], [15.0, 1.0], [15.0, 8.0], [1.0, 8.0]];
/// Radius of the discs: larger than a cell, so that they are the largest discs.
pub const DISC_RADIUS: f64 = 0.75;

/// Number of cells across and down.
const CELLS: [usize; 2] = [8, 6];
/// Left, top, right and bottom of the field of cells.
const FIELD: [f64; 4] = [2.2, 0.6, 13.8, 8.4];
/// Fraction of its field that a cell fills; the rest is white.
const FILLED: f64 = 0.8;

/// Returns the rectangle of a bit's cell, or of its complement's: left, top, width, height.
pub fn cell_rectangle(bit: usize, opposite: bool) -> [f64; 4] {
    let pairs = CELLS[0] / 2;
    let (column, row) = (2 * (bit % pairs) + usize::from(opposite), bit / pairs);
    let [width, height] = [
        (FIELD[2] - FIELD[0]) / CELLS[0] as f64,
        (FIELD[3] - FIELD[1]) / CELLS[1] as f64,
    ];
    let edge = 0.5 * (1.0 - FILLED);
    [
        FIELD[0] + (column as f64 + edge) * width,
        FIELD[1] + (row as f64 + edge) * height,
        FILLED * width,
        FILLED * height,
    ]
}

/// Returns the bits displayed for a count of ticks, the first one lowest; white cells are one.
pub fn code_word(count: u32) -> u32 {
    let count = count % (1 << COUNT_BITS);
    let gray = count ^ (count >> 1);
    let slow = gray >> FAST_BITS;
    let check = HAMMING
        .iter()
        .enumerate()
        .filter(|(bit, _)| slow >> bit & 1 == 1)
        .fold(0, |sum, (_, c)| sum ^ c);
    // The ends are one, and zero if the image is upside down. The fastest bits and parity share a row near
    // the middle, as a screen is updated row by row.
    1 | check << 1
        | gray >> LOW_BITS << 5
        | (count & 1) << 8
        | (gray & LOW) << FASTEST
        | 1 << (BITS - 1)
}

/// Number of adjacent bits of the Gray code in the word, from the fastest one at the tenth bit; the slowest ones are before
/// them.
const LOW_BITS: usize = 14;
/// Mask of these bits in a Gray code.
const LOW: u32 = (1 << LOW_BITS) - 1;
/// Index in the word of the count's fastest bit.
pub const FASTEST: usize = 9;
/// Mask of the Gray code's bits in the word.
const COUNT_MASK: u32 = LOW << FASTEST | ((1 << (COUNT_BITS - LOW_BITS)) - 1) << 5;

/// Mask of the parity bit in the word.
const PARITY: u32 = 1 << 8;

/// Extracts the Gray code from a word.
fn gray_code(word: u32) -> u32 {
    word >> FASTEST & LOW | (word & COUNT_MASK & 0xff) >> 5 << LOW_BITS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_differ_in_one_bit_of_the_count_and_in_parity() {
        for count in 0..1u32 << COUNT_BITS {
            let turned = code_word(count) ^ code_word(count + 1);
            assert_eq!((turned & COUNT_MASK).count_ones(), 1, "{count}");
            assert_eq!(turned >> 8 & 1, 1, "{count}");
            assert_eq!(gray_code(code_word(count)), count ^ count >> 1);
        }
    }

    #[test]
    fn words_with_one_inverted_bit_or_two_slow_ones_are_invalid() {
        let words: std::collections::BTreeSet<u32> = (0..1 << COUNT_BITS).map(code_word).collect();
        assert_eq!(words.len(), 1 << COUNT_BITS);
        let slow: Vec<usize> = (5..8).chain(FASTEST + FAST_BITS..BITS - 1).collect();
        for count in (0..1 << COUNT_BITS).step_by(97) {
            let word = code_word(count);
            assert!(
                (0..BITS).all(|bit| !words.contains(&(word ^ 1 << bit))),
                "{count}"
            );
            for a in &slow {
                assert!(
                    slow.iter()
                        .all(|b| a == b || !words.contains(&(word ^ 1 << a ^ 1 << b))),
                    "{count}"
                );
            }
        }
    }

    #[test]
    fn the_cells_lie_between_the_discs() {
        for (bit, opposite) in (0..BITS).flat_map(|bit| [(bit, false), (bit, true)]) {
            let [x, y, width, height] = cell_rectangle(bit, opposite);
            assert!(x > DISCS[0][0] + DISC_RADIUS && x + width < DISCS[1][0] - DISC_RADIUS);
            assert!(y > 0.0 && y + height < SIZE[1]);
            assert!(width.max(height) < 2.0 * DISC_RADIUS);
        }
    }
}
