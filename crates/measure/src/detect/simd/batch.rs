//! Batches of pixels that are processed together.

use super::lanes::{LANES, Lanes};

/// Pixels that are processed together; those after the first `len` are copies without weight.
#[derive(Clone, Copy, Debug)]
pub struct Batch {
    /// Column, from the batches' origin.
    pub x: Lanes,
    /// Row, from the batches' origin.
    pub y: Lanes,
    pub value: Lanes,
    /// Position along the marker over its semi-major axis.
    pub p: Lanes,
    /// Position across the marker over its semi-minor axis.
    pub q: Lanes,
    /// Square root of the pixel's weight, 0 to 1.
    pub root: Lanes,
    /// Number of pixels.
    pub len: usize,
}

impl Batch {
    /// Creates a batch without pixels.
    pub fn new() -> Self {
        let [x, y, value, p, q, root] = [Lanes::splat(0.0); 6];
        Self {
            x,
            y,
            value,
            p,
            q,
            root,
            len: 0,
        }
    }

    /// Returns whether the batch is full.
    pub fn is_full(&self) -> bool {
        self.len >= LANES
    }

    /// Appends a pixel by its column, row and grey value.
    #[inline(always)]
    pub fn push(&mut self, x: f32, y: f32, value: f32) {
        let i = self.len % LANES;
        (self.x[i], self.y[i], self.value[i]) = (x, y, value);
        self.len = i + 1;
    }

    /// Fills the remaining lanes with copies of the first pixel that have no weight.
    pub fn fill_lanes(&mut self) {
        for i in self.len..LANES {
            for lanes in [
                &mut self.x,
                &mut self.y,
                &mut self.value,
                &mut self.p,
                &mut self.q,
            ] {
                lanes[i] = lanes[0];
            }
            self.root[i] = 0.0;
        }
    }
}

/// Appends the `i`-th pixel of a batch to the last of some batches or to a new one.
pub fn append_pixel(batches: &mut Vec<Batch>, from: &Batch, i: usize) {
    if batches.last().is_none_or(Batch::is_full) {
        batches.push(Batch::new());
    }
    if let Some(to) = batches.last_mut() {
        let n = to.len;
        (to.p[n], to.q[n], to.root[n]) = (from.p[i], from.q[i], from.root[i]);
        to.push(from.x[i], from.y[i], from.value[i]);
    }
}
