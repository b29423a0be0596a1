//! The pixels of a fit, in batches, sorted by what their share of black takes.

use super::lanes::{LANES, Lanes, each, total};
use super::model::Pattern;

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

/// The pixels of a fit.
pub struct Pixels {
    /// What they show.
    pub pattern: Pattern,
    /// Where columns and rows are counted from, px.
    pub origin: [f64; 2],
    /// Whether quadrants' outline is part of the model.
    pub rim: bool,
    /// All of them, each kind by itself.
    pub batches: Vec<Batch>,
}

/// What it takes to know a pixel's share of black.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A closed form.
    Cheap,
    /// A sum.
    Dear,
    /// Nothing: it is 0.
    Beyond,
}

/// Pixels on their way into batches.
pub struct Sorter {
    pixels: Pixels,
    open: [Batch; 3],
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

impl Pixels {
    /// Sum of the weights.
    pub fn weight(&self) -> f64 {
        self.batches.iter().map(|b| total(&each(|i| b.root[i] * b.root[i]))).sum()
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.batches.iter().map(|b| b.len).sum()
    }
}

impl Sorter {
    /// Without pixels.
    pub fn new(pattern: Pattern, origin: [f64; 2]) -> Self {
        let pixels = Pixels { pattern, origin, rim: false, batches: Vec::with_capacity(128) };
        Self { pixels, open: [Batch::new(), Batch::new(), Batch::new()] }
    }

    /// Takes up the `i`-th pixel of a batch.
    #[inline(always)]
    pub fn push(&mut self, kind: Kind, from: &Batch, i: usize) {
        let open = &mut self.open[kind as usize];
        let k = open.len % LANES;
        (open.x[k], open.y[k], open.value[k]) = (from.x[i], from.y[i], from.value[i]);
        (open.p[k], open.q[k], open.root[k]) = (from.p[i], from.q[i], from.root[i]);
        open.len = k + 1;
        if open.is_full() {
            self.pixels.batches.extend_from_slice(std::slice::from_ref(open));
            open.len = 0;
        }
    }

    /// All that was taken up.
    pub fn finish(mut self) -> Pixels {
        for mut open in self.open.into_iter().filter(|open| open.len > 0) {
            open.fill();
            self.pixels.batches.push(open);
        }
        self.pixels
    }
}
