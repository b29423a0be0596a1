//! A scan's coded bytes are cut at its restart markers, so that no code of a missing stretch is taken for picture.

use std::ops::Range;

use super::JpegFault;
use crate::tiles;

/// Side of a block, px.
pub const BLOCK: usize = tiles::SIDE;
/// Markers: the picture's end, and the first of the eight that follow intervals in turn.
pub const END: u8 = 0xd9;
const FIRST_RESTART: u8 = 0xd0;

/// The intervals between restart markers of a scan.
pub struct RestartIntervals<'a> {
    rest: &'a [u8],
    /// Units of the scan, and of an interval.
    units: usize,
    length: usize,
    /// The next interval's first unit, and its number.
    start: usize,
    number: usize,
    /// The marker after the last, where it is known.
    end: Option<u8>,
    coded: &'a [u8],
}

impl<'a> RestartIntervals<'a> {
    /// `interval`: units between restart markers, 0 without any. The marker after the last interval is `end`; any but
    /// a restart marker where `None`.
    pub fn new(scan: &'a [u8], units: usize, interval: usize, end: Option<u8>) -> Self {
        let length = if interval == 0 { units } else { interval };
        Self { rest: scan, units, length, start: 0, number: 0, end, coded: &[] }
    }

    /// The next interval's units; its data are then [`Intervals::coded`].
    ///
    /// # Errors
    /// Where it does not end with the marker that must follow it.
    pub fn next_interval(&mut self) -> Result<Option<Range<usize>>, JpegFault> {
        if self.start >= self.units {
            return Ok(None);
        }
        let units = self.start..(self.start + self.length).min(self.units);
        let (size, marker, next) = split_at_marker(self.rest).ok_or_else(|| damaged_error("its end is missing"))?;
        let right = if units.end < self.units {
            marker == FIRST_RESTART + (self.number % 8) as u8
        } else {
            self.end.map_or(!(FIRST_RESTART..FIRST_RESTART + 8).contains(&marker), |end| marker == end)
        };
        if !right {
            return Err(damaged_error("data are missing or in the wrong place"));
        }
        self.coded = &self.rest[..size];
        (self.rest, self.start, self.number) = (next, units.end, self.number + 1);
        Ok(Some(units))
    }

    /// An interval's coded bytes.
    pub fn coded(&self) -> &'a [u8] {
        self.coded
    }
}

/// Bytes until the next marker, its code, and what follows it.
fn split_at_marker(data: &[u8]) -> Option<(usize, u8, &[u8])> {
    let mut at = 0;
    loop {
        at += memchr::memchr(0xff, &data[at..])?;
        // Any number of fill bytes may stand before a marker.
        let fill = data[at..].iter().take_while(|&&b| b == 0xff).count();
        match *data.get(at + fill)? {
            0 => at += fill + 1,
            code => return Some((at, code, &data[at + fill + 1..])),
        }
    }
}

/// An error of damaged data, in words.
pub(super) fn damaged_error(what: &str) -> JpegFault {
    JpegFault::Damaged(what.into())
}
