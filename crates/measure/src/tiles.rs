//! Tiles of 8 x 8 px, aligned with a JPEG's blocks: a mask of requested or decoded parts of an image.

use std::ops::Range;

/// Side of a tile, px.
pub const TILE_SIDE: usize = 8;

/// A mask of the tiles of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tiles {
    /// Width of the image, px.
    width: usize,
    height: usize,
    /// Tiles per row.
    across: usize,
    /// Marks of the tiles, row by row.
    marked: Vec<bool>,
}

impl Tiles {
    /// Creates a mask of an image of `width` x `height` px without marked tiles.
    pub fn none(width: usize, height: usize) -> Self {
        let across = width.div_ceil(TILE_SIDE);
        Self {
            width,
            height,
            across,
            marked: vec![false; across * height.div_ceil(TILE_SIDE)],
        }
    }

    /// Creates a mask of an image of `width` x `height` px with all tiles marked.
    pub fn all(width: usize, height: usize) -> Self {
        let mut tiles = Self::none(width, height);
        tiles.marked.fill(true);
        tiles
    }

    /// Marks the tiles that overlap a box, px, clipped to the image.
    pub fn mark(&mut self, columns: Range<usize>, rows: Range<usize>) {
        let (columns, rows) = (
            columns.start..columns.end.min(self.width),
            rows.start..rows.end.min(self.height),
        );
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        let across = columns.start / TILE_SIDE..columns.end.div_ceil(TILE_SIDE);
        for row in rows.start / TILE_SIDE..rows.end.div_ceil(TILE_SIDE) {
            self.marked[row * self.across..][across.clone()].fill(true);
        }
    }

    /// Returns the marks of a row of tiles; empty outside the image.
    pub fn row(&self, row: usize) -> &[bool] {
        self.marked
            .chunks(self.across.max(1))
            .nth(row)
            .unwrap_or_default()
    }

    /// Returns the columns between the first and the last marked tile of a pixel row, px.
    pub fn columns(&self, y: usize) -> Range<usize> {
        let row = self.row(y / TILE_SIDE);
        match (row.iter().position(|m| *m), row.iter().rposition(|m| *m)) {
            (Some(first), Some(last)) => {
                first * TILE_SIDE..((last + 1) * TILE_SIDE).min(self.width)
            }
            _ => 0..0,
        }
    }

    /// Marks the tiles of another mask of the image, and removes from that mask the tiles that were already marked.
    pub fn merge_new(&mut self, new: &mut Self) {
        for (own, new) in self.marked.iter_mut().zip(&mut new.marked) {
            *new &= !*own;
            *own |= *new;
        }
    }
}

/// Copies a tile's pixels to its position, given in tiles across and down, in an image of some width, px, clipped to it.
#[inline(always)]
pub fn copy_tile(
    pixels: &[u8; TILE_SIDE * TILE_SIDE],
    [column, row]: [usize; 2],
    image: &mut [u8],
    width: usize,
) {
    let x = column * TILE_SIDE;
    let wide = TILE_SIDE.min(width.saturating_sub(x));
    let rows = pixels.as_chunks::<TILE_SIDE>().0.iter().enumerate();
    for (y, from) in rows {
        let start = (row * TILE_SIDE + y) * width + x;
        match image.get_mut(start..start + wide) {
            // A constant width of 8 compiles to a single move.
            Some(to) if wide == TILE_SIDE => to.copy_from_slice(from),
            Some(to) => to.copy_from_slice(&from[..wide]),
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_mark_the_tiles_they_overlap() {
        let mut tiles = Tiles::none(61, 43);
        tiles.mark(7..9, 15..16);
        tiles.mark(40..99, 40..99);
        tiles.mark(70..80, 0..43);
        tiles.mark(5..5, 0..9);
        assert_eq!(
            tiles.row(1),
            [true, true, false, false, false, false, false, false]
        );
        assert_eq!([tiles.row(0), tiles.row(2)], [[false; 8]; 2]);
        assert_eq!(
            [tiles.columns(8), tiles.columns(42), tiles.columns(0)],
            [0..16, 40..61, 0..0]
        );
        assert!(tiles.row(9).is_empty());
        let mut new = Tiles::none(61, 43);
        new.mark(0..24, 8..16);
        tiles.merge_new(&mut new);
        assert_eq!((tiles.columns(8), new.columns(8)), (0..24, 16..24));
        tiles.merge_new(&mut new);
        assert_eq!(new, Tiles::none(61, 43));
    }
}
