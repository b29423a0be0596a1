//! Normal equations over parameters that all pixels share, and over knots of which those of a cell know a few.

use nalgebra::{DMatrix, DVector};

use super::normal_equations::Products;

/// Lower triangle and right side: the shared parameters, then the knots.
pub struct Bordered {
    pub normal: DMatrix<f64>,
    pub right: DVector<f64>,
    shared: usize,
}

impl Bordered {
    /// Zero.
    pub fn new(shared: usize, knots: usize) -> Self {
        let all = shared + knots;
        Self { normal: DMatrix::zeros(all, all), right: DVector::zeros(all), shared }
    }

    /// Adds what a cell's pixels say of the knots about them, which are the first columns of the products and are then forgotten.
    #[inline(always)]
    pub fn take<const ABOUT: usize>(&mut self, sums: &mut Products, knots: [usize; ABOUT]) {
        let mut totals = sums.totals();
        let knots = knots.map(|k| self.shared + k);
        for (i, &a) in knots.iter().enumerate() {
            for &b in &knots[i..] {
                self.normal[(a.max(b), a.min(b))] += totals.next().unwrap_or(0.0);
            }
            for k in 0..self.shared {
                self.normal[(a, k)] += totals.next().unwrap_or(0.0);
            }
            self.right[a] += totals.next().unwrap_or(0.0);
        }
        drop(totals);
        sums.forget(ABOUT);
    }

    /// Sets what all pixels say of the shared parameters, which are the products' columns after so many of knots.
    #[inline(always)]
    pub fn finish(&mut self, sums: &Products, about: usize) {
        let n = self.shared;
        let mut totals = sums.totals().skip((0..about).map(|i| about + n + 1 - i).sum());
        for i in 0..n {
            for j in i..n {
                self.normal[(j, i)] = totals.next().unwrap_or(0.0);
            }
            self.right[i] = totals.next().unwrap_or(0.0);
        }
    }
}
