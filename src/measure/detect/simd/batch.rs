//! Pixels that are worked on together.

use super::lanes::{LANES, Lanes};

/// Pixels that are worked on together; those after the first `len` are copies without weight.
#[derive(Clone, Copy, Debug)]
pub struct Batch {
    /// Column, counted from the batches' origin.
    pub x: Lanes,
    /// Row, counted from the batches' origin.
    pub y: Lanes,
    /// Grey value.
    pub value: Lanes,
    /// Along the marker over its semi-major axis.
    pub p: Lanes,
    /// Across the marker over its semi-minor axis.
    pub q: Lanes,
    /// Root of how much the pixel counts, 0 to 1.
    pub root: Lanes,
    /// Pixels.
    pub len: usize,
}

impl Batch {
    /// Without pixels.
    pub fn new() -> Self {
        let [x, y, value, p, q, root] = [Lanes::of(0.0); 6];
        Self { x, y, value, p, q, root, len: 0 }
    }

    /// Whether it has no room.
    pub fn is_full(&self) -> bool {
        self.len >= LANES
    }

    /// Takes up a pixel by its column, row and grey value.
    #[inline(always)]
    pub fn push(&mut self, x: f32, y: f32, value: f32) {
        let i = self.len % LANES;
        (self.x[i], self.y[i], self.value[i]) = (x, y, value);
        self.len = i + 1;
    }

    /// Fills what is empty with copies of the first pixel that have no weight.
    pub fn fill(&mut self) {
        for i in self.len..LANES {
            for lanes in [&mut self.x, &mut self.y, &mut self.value, &mut self.p, &mut self.q] {
                lanes[i] = lanes[0];
            }
            self.root[i] = 0.0;
        }
    }
}

/// Takes up the `i`-th pixel of a batch, in the last of some batches or in a new one.
pub fn append(batches: &mut Vec<Batch>, from: &Batch, i: usize) {
    if batches.last().is_none_or(Batch::is_full) {
        batches.push(Batch::new());
    }
    if let Some(to) = batches.last_mut() {
        let n = to.len;
        (to.p[n], to.q[n], to.root[n]) = (from.p[i], from.q[i], from.root[i]);
        to.push(from.x[i], from.y[i], from.value[i]);
    }
}
