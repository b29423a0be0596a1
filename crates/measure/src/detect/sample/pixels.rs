//! Pixels of a fit, in batches, sorted by the method by which their fraction of black is computed.

use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::simd::batch::Batch;
use crate::detect::simd::lanes::{LANES, each, sum_lanes};

/// Pixels of a fit.
pub struct Pixels {
    /// Pattern of the marker they show.
    pub pattern: MarkerPattern,
    /// Origin of columns and rows, px.
    pub origin: [f64; 2],
    /// True if the outline of quadrants is part of the model.
    pub outlined: bool,
    /// Batches, each of pixels of one kind.
    pub batches: Vec<Batch>,
}

/// Method by which a pixel's fraction of black is computed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum PixelKind {
    /// Closed formula.
    ClosedForm,
    /// Numerical integration.
    Integrated,
    /// No computation: the fraction is 0.
    Outside,
}

/// Sorts pixels into batches by kind.
pub struct Sorter {
    pixels: Pixels,
    open: [Batch; 3],
}

impl Pixels {
    /// Returns the sum of the weights.
    pub fn weight(&self) -> f64 {
        self.batches
            .iter()
            .map(|b| sum_lanes(&each(|i| b.root[i] * b.root[i])))
            .sum()
    }

    /// Returns the number of pixels.
    pub fn count(&self) -> usize {
        self.batches.iter().map(|b| b.len).sum()
    }
}

impl Sorter {
    /// Creates a sorter without pixels.
    pub fn new(pattern: MarkerPattern, origin: [f64; 2]) -> Self {
        let pixels = Pixels {
            pattern,
            origin,
            outlined: false,
            batches: Vec::with_capacity(128),
        };
        Self {
            pixels,
            open: [Batch::new(), Batch::new(), Batch::new()],
        }
    }

    /// Adds the `i`-th pixel of a batch.
    #[inline(always)]
    pub fn push(&mut self, kind: PixelKind, from: &Batch, i: usize) {
        let open = &mut self.open[kind as usize];
        let k = open.len % LANES;
        (open.x[k], open.y[k], open.value[k]) = (from.x[i], from.y[i], from.value[i]);
        (open.p[k], open.q[k], open.root[k]) = (from.p[i], from.q[i], from.root[i]);
        open.len = k + 1;
        if open.is_full() {
            self.pixels
                .batches
                .extend_from_slice(std::slice::from_ref(open));
            open.len = 0;
        }
    }

    /// Completes the last batches and returns all pixels.
    pub fn finish(mut self) -> Pixels {
        for mut open in self.open.into_iter().filter(|open| open.len > 0) {
            open.fill_lanes();
            self.pixels.batches.push(open);
        }
        self.pixels
    }
}
