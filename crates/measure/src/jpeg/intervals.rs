//! Split of a scan's coded bytes at its restart markers, so that missing data are not decoded as image.

use std::ops::Range;

use super::JpegFault;
use crate::tiles;

/// Side of a block, px.
pub const BLOCK: usize = tiles::TILE_SIDE;
/// Markers: end of image, and the first of the eight restart markers used in turn.
pub const END: u8 = 0xd9;
const FIRST_RESTART: u8 = 0xd0;

/// Iterator over the intervals between a scan's restart markers.
pub struct RestartIntervals<'a> {
    rest: &'a [u8],
    /// Units of the scan, and of an interval.
    units: usize,
    length: usize,
    /// First unit and number of the next interval.
    start: usize,
    number: usize,
    /// Marker after the last interval, if known.
    end: Option<u8>,
    coded: &'a [u8],
}

impl<'a> RestartIntervals<'a> {
    /// Creates the iterator for `interval` units between restart markers, 0 for none. The last interval must end with the
    /// marker `end` or, if that is `None`, with any but a restart marker.
    pub fn new(scan: &'a [u8], units: usize, interval: usize, end: Option<u8>) -> Self {
        let length = if interval == 0 { units } else { interval };
        Self {
            rest: scan,
            units,
            length,
            start: 0,
            number: 0,
            end,
            coded: &[],
        }
    }

    /// Returns the units of the next interval; its data are then [`RestartIntervals::coded`].
    ///
    /// # Errors
    /// Returns an error if the interval does not end with the marker that must follow it.
    pub fn next_interval(&mut self) -> Result<Option<Range<usize>>, JpegFault> {
        if self.start >= self.units {
            return Ok(None);
        }
        let units = self.start..(self.start + self.length).min(self.units);
        let (size, marker, next) = split_at_marker(self.rest)
            .ok_or_else(|| damaged_error("the end of the data is missing"))?;
        let right = if units.end < self.units {
            marker == FIRST_RESTART + (self.number % 8) as u8
        } else {
            self.end.map_or(
                !(FIRST_RESTART..FIRST_RESTART + 8).contains(&marker),
                |end| marker == end,
            )
        };
        if !right {
            return Err(damaged_error("data are missing or misplaced"));
        }
        self.coded = &self.rest[..size];
        (self.rest, self.start, self.number) = (next, units.end, self.number + 1);
        Ok(Some(units))
    }

    /// Returns the coded bytes of the current interval.
    pub fn coded(&self) -> &'a [u8] {
        self.coded
    }
}

/// Returns the number of bytes before the next marker, its code, and the bytes after it.
fn split_at_marker(data: &[u8]) -> Option<(usize, u8, &[u8])> {
    let mut at = 0;
    loop {
        at += memchr::memchr(0xff, &data[at..])?;
        // Any number of fill bytes may precede a marker.
        let fill = data[at..].iter().take_while(|&&b| b == 0xff).count();
        match *data.get(at + fill)? {
            0 => at += fill + 1,
            code => return Some((at, code, &data[at + fill + 1..])),
        }
    }
}

/// Builds the error for damaged data.
pub(super) fn damaged_error(problem: &str) -> JpegFault {
    JpegFault::Damaged(problem.into())
}
