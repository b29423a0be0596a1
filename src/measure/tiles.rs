//! Tiles of 8 x 8 px, as a JPEG's blocks lie: which of a picture are wanted, or were read.

use std::ops::Range;

/// Side of a tile, px.
pub const SIDE: usize = 8;

/// Which tiles of a picture are marked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tiles {
    /// Size of the picture, px.
    width: usize,
    height: usize,
    /// Tiles of a row.
    across: usize,
    /// Row by row.
    marked: Vec<bool>,
}

impl Tiles {
    /// None of a picture of `width` x `height` px.
    pub fn none(width: usize, height: usize) -> Self {
        let across = width.div_ceil(SIDE);
        Self { width, height, across, marked: vec![false; across * height.div_ceil(SIDE)] }
    }

    /// All of them.
    pub fn all(width: usize, height: usize) -> Self {
        let mut tiles = Self::none(width, height);
        tiles.marked.fill(true);
        tiles
    }

    /// Marks those that hold some of a box, px; what lies outside the picture is left out.
    pub fn mark(&mut self, columns: Range<usize>, rows: Range<usize>) {
        let (columns, rows) =
            (columns.start..columns.end.min(self.width), rows.start..rows.end.min(self.height));
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        let across = columns.start / SIDE..columns.end.div_ceil(SIDE);
        for row in rows.start / SIDE..rows.end.div_ceil(SIDE) {
            self.marked[row * self.across..][across.clone()].fill(true);
        }
    }

    /// Of a row of tiles which are marked; none beyond the picture.
    pub fn row(&self, row: usize) -> &[bool] {
        self.marked.chunks(self.across.max(1)).nth(row).unwrap_or_default()
    }

    /// The columns between the first and the last of a pixel row's marked tiles, px.
    pub fn columns(&self, y: usize) -> Range<usize> {
        let row = self.row(y / SIDE);
        match (row.iter().position(|m| *m), row.iter().rposition(|m| *m)) {
            (Some(first), Some(last)) => first * SIDE..((last + 1) * SIDE).min(self.width),
            _ => 0..0,
        }
    }

    /// Marks those of another of the same picture, and leaves in that what was not marked here.
    pub fn take_up(&mut self, new: &mut Self) {
        for (own, new) in self.marked.iter_mut().zip(&mut new.marked) {
            *new &= !*own;
            *own |= *new;
        }
    }
}

/// A tile's pixels to its place, told in tiles across and down, in a picture of some width, px, as far as they lie in it.
#[inline(always)]
pub fn put(pixels: &[u8; SIDE * SIDE], [column, row]: [usize; 2], picture: &mut [u8], width: usize) {
    let x = column * SIDE;
    let wide = SIDE.min(width.saturating_sub(x));
    let rows = pixels.as_chunks::<SIDE>().0.iter().enumerate();
    for (y, from) in rows {
        let start = (row * SIDE + y) * width + x;
        match picture.get_mut(start..start + wide) {
            // Known to be eight, it is one step.
            Some(to) if wide == SIDE => to.copy_from_slice(from),
            Some(to) => to.copy_from_slice(&from[..wide]),
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_mark_the_tiles_that_hold_some_of_them() {
        let mut tiles = Tiles::none(61, 43);
        tiles.mark(7..9, 15..16);
        tiles.mark(40..99, 40..99);
        tiles.mark(70..80, 0..43);
        tiles.mark(5..5, 0..9);
        assert_eq!(tiles.row(1), [true, true, false, false, false, false, false, false]);
        assert_eq!([tiles.row(0), tiles.row(2)], [[false; 8]; 2]);
        assert_eq!([tiles.columns(8), tiles.columns(42), tiles.columns(0)], [0..16, 40..61, 0..0]);
        assert!(tiles.row(9).is_empty());
        let mut new = Tiles::none(61, 43);
        new.mark(0..24, 8..16);
        tiles.take_up(&mut new);
        assert_eq!((tiles.columns(8), new.columns(8)), (0..24, 16..24));
        tiles.take_up(&mut new);
        assert_eq!(new, Tiles::none(61, 43));
    }
}
