//! Normal equations solved for those parameters that are sought.

use super::linear::{Column, Square};
use super::model::N;

/// Cholesky's factor of the normal equations of some of the parameters.
pub struct Factor {
    list: Vec<usize>,
    /// Row by row, the diagonal inverted.
    lower: [[f64; N]; N],
}

impl Factor {
    /// Of the parameters that are `free`, each diagonal element raised by a share of it; `None` where they cannot be told.
    pub fn new(normal: &Square, free: &[bool; N], damping: f64) -> Option<Self> {
        let list = (0..N).filter(|&k| free[k]).collect();
        let mut out = Self { list, lower: [[0.0; N]; N] };
        for (row, &k) in out.list.iter().enumerate() {
            for column in 0..row {
                let (done, rest) = out.lower.split_at(row);
                let known = dot(&done[column][..column], &rest[0][..column]);
                out.lower[row][column] = (normal[(k, out.list[column])] - known) * out.lower[column][column];
            }
            let own = &out.lower[row][..row];
            let square = normal[(k, k)] * (1.0 + damping) + 1e-12 - dot(own, own);
            if !(square > 0.0 && square.is_finite()) {
                return None;
            }
            out.lower[row][row] = 1.0 / square.sqrt();
        }
        Some(out)
    }

    /// The solution; 0 for parameters that are not sought.
    pub fn solve(&self, right: &Column) -> Column {
        let mut part = [0.0; N];
        for (value, &k) in part.iter_mut().zip(&self.list) {
            *value = right[k];
        }
        self.solve_part(&mut part, 0);
        let mut out = Column::zeros();
        for (&value, &k) in part.iter().zip(&self.list) {
            out[k] = value;
        }
        out
    }

    /// The inverse; 0 for parameters that are not sought.
    pub fn inverse(&self) -> Square {
        let mut out = Square::zeros();
        for (i, &k) in self.list.iter().enumerate() {
            let mut part = [0.0; N];
            part[i] = 1.0;
            self.solve_part(&mut part, i);
            for (&value, &l) in part.iter().zip(&self.list) {
                out[(l, k)] = value;
            }
        }
        out
    }

    /// Solves for a right side that is 0 before `first`.
    fn solve_part(&self, part: &mut [f64; N], first: usize) {
        for row in first..self.list.len() {
            let known = dot(&self.lower[row][first..row], &part[first..row]);
            part[row] = (part[row] - known) * self.lower[row][row];
        }
        for row in (0..self.list.len()).rev() {
            part[row] *= self.lower[row][row];
            let value = part[row];
            for (part, lower) in part[..row].iter_mut().zip(&self.lower[row]) {
                *part -= lower * value;
            }
        }
    }
}

fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(x, y)| x * y).sum()
}
