//! The pixels of a fit, in batches, sorted by what their share of black takes.

use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::simd::batch::Batch;
use crate::detect::simd::lanes::{LANES, each, total};

/// The pixels of a fit.
pub struct Pixels {
    /// What they show.
    pub pattern: MarkerPattern,
    /// Where columns and rows are counted from, px.
    pub origin: [f64; 2],
    /// Whether quadrants' outline is part of the model.
    pub outlined: bool,
    /// All of them, each kind by itself.
    pub batches: Vec<Batch>,
}

/// What it takes to know a pixel's share of black.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum PixelKind {
    /// A closed form.
    ClosedForm,
    /// A sum.
    Integrated,
    /// Nothing: it is 0.
    Outside,
}

/// Pixels on their way into batches.
pub struct Sorter {
    pixels: Pixels,
    open: [Batch; 3],
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
    pub fn new(pattern: MarkerPattern, origin: [f64; 2]) -> Self {
        let pixels = Pixels { pattern, origin, outlined: false, batches: Vec::with_capacity(128) };
        Self { pixels, open: [Batch::new(), Batch::new(), Batch::new()] }
    }

    /// Takes up the `i`-th pixel of a batch.
    #[inline(always)]
    pub fn push(&mut self, kind: PixelKind, from: &Batch, i: usize) {
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
