//! A clock that is photographed: its code on a screen, and the instant of exposure read from a picture of it.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | code | count of ticks | bits | this one |
//! | picture | frame, discs found in it | cells: one, zero, mixed | `picture` |
//! | decode | cells | time shown, and what it leaves open | `decode` |
//! | delay | differences of many pictures | mean, scatter, what a delay is known to | `delay` |
//!
//! The screen shows the count of whole ticks of UTC in Gray's code, in which neighbours differ by one bit, with its parity and
//! a check of its slow bits (Hamming 1950). Each bit is two cells side by side, itself and its opposite, so that uneven
//! light, glare and shade cannot turn one.

mod decode;
mod delay;
mod picture;

pub use decode::{DisplayedTime, decode_time, nearest_time};
pub use delay::{DelayEstimate, Screen, estimate_delay};
pub use picture::{TimeCodeError, read_time};

/// A tick, ms. Longer than a frame of a screen at 60 Hz, so that no count is left out; a prime number, so that pictures at a round
/// rate meet it in every phase.
pub const TICK_MS: u32 = 19;
/// Bits of the count: it begins anew every 41.5 minutes.
pub const COUNT_BITS: usize = 17;
/// Bits that are shown: one, parity, check, count, one.
pub const BITS: usize = 24;
/// Bits of the count, fastest first, that the check leaves to parity.
pub const FAST_BITS: usize = 6;
/// Columns of the check, Hamming's (15, 11) code: for each slow bit of Gray's code the bits of the check that it turns.
pub const HAMMING: [u32; 11] = [3, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15];

/// Width and height of the picture on the screen, in units of its own.
pub const SIZE: [f64; 2] = [16.0, 9.0];
/// Centres of the discs, clockwise from the top left.
pub const DISCS: [[f64; 2]; 4] = [[1.0, 1.0], [15.0, 1.0], [15.0, 8.0], [1.0, 8.0]];
/// Their radius: larger than a cell, so that they are the largest discs.
pub const DISC_RADIUS: f64 = 0.75;

/// Cells side by side and above each other.
const CELLS: [usize; 2] = [8, 6];
/// Left, top, right and bottom of them all.
const FIELD: [f64; 4] = [2.2, 0.6, 13.8, 8.4];
/// Share of its place that a cell fills; the rest is white.
const FILLED: f64 = 0.8;

/// The place of a bit's cell, or of its opposite: left, top, width, height.
pub fn cell_rectangle(bit: usize, opposite: bool) -> [f64; 4] {
    let pairs = CELLS[0] / 2;
    let (column, row) = (2 * (bit % pairs) + usize::from(opposite), bit / pairs);
    let [width, height] = [(FIELD[2] - FIELD[0]) / CELLS[0] as f64, (FIELD[3] - FIELD[1]) / CELLS[1] as f64];
    let edge = 0.5 * (1.0 - FILLED);
    [
        FIELD[0] + (column as f64 + edge) * width,
        FIELD[1] + (row as f64 + edge) * height,
        FILLED * width,
        FILLED * height,
    ]
}

/// The bits of a count of ticks, the first one lowest; white cells are one.
pub fn code_word(count: u32) -> u32 {
    let count = count % (1 << COUNT_BITS);
    let gray = count ^ (count >> 1);
    let slow = gray >> FAST_BITS;
    let check =
        HAMMING.iter().enumerate().filter(|(bit, _)| slow >> bit & 1 == 1).fold(0, |sum, (_, c)| sum ^ c);
    // Of the ends, which are one, the picture's attitude is told: upside down they are zero. The fastest bits and parity
    // share a row near the middle: a screen lights a row at a time.
    1 | check << 1 | gray >> LOW_BITS << 5 | (count & 1) << 8 | (gray & LOW) << FASTEST | 1 << (BITS - 1)
}

/// So many bits of Gray's code stand together, the fastest one in the tenth bit of the word; the slowest ones before them.
const LOW_BITS: usize = 14;
/// These bits of a count in Gray's code.
const LOW: u32 = (1 << LOW_BITS) - 1;
/// The bit of the word that is the count's fastest.
pub const FASTEST: usize = 9;
/// The bits of the count in Gray's code.
const COUNT_MASK: u32 = LOW << FASTEST | ((1 << (COUNT_BITS - LOW_BITS)) - 1) << 5;

/// The bit of a word that is the count's parity.
const PARITY: u32 = 1 << 8;

/// Gray's code in the bits of a word.
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
    fn one_turned_bit_is_no_word_nor_are_two_slow_ones() {
        let words: std::collections::BTreeSet<u32> = (0..1 << COUNT_BITS).map(code_word).collect();
        assert_eq!(words.len(), 1 << COUNT_BITS);
        let slow: Vec<usize> = (5..8).chain(FASTEST + FAST_BITS..BITS - 1).collect();
        for count in (0..1 << COUNT_BITS).step_by(97) {
            let word = code_word(count);
            assert!((0..BITS).all(|bit| !words.contains(&(word ^ 1 << bit))), "{count}");
            for a in &slow {
                assert!(slow.iter().all(|b| a == b || !words.contains(&(word ^ 1 << a ^ 1 << b))), "{count}");
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
