//! Solution of the normal equations for the free parameters.

use super::normal_equations::{MIN_WEIGHT, NormalMatrix, ParameterVector};
use crate::detect::appearance::parameters::N;

/// Cholesky factor of the normal equations of the free parameters.
pub struct CholeskyFactor {
    list: Vec<usize>,
    /// Lower triangle, row by row, with the diagonal inverted.
    lower: [[f64; N]; N],
}

impl CholeskyFactor {
    /// Factors the rows and columns of the `free` parameters, with each diagonal element raised by the fraction `damping`.
    /// Returns `None` if the normal matrix is not positive definite.
    pub fn new(normal: &NormalMatrix, free: &[bool; N], damping: f64) -> Option<Self> {
        let list = (0..N).filter(|&k| free[k]).collect();
        let mut out = Self {
            list,
            lower: [[0.0; N]; N],
        };
        for (row, &k) in out.list.iter().enumerate() {
            for column in 0..row {
                let (done, rest) = out.lower.split_at(row);
                let known = dot_product(&done[column][..column], &rest[0][..column]);
                out.lower[row][column] =
                    (normal[(k, out.list[column])] - known) * out.lower[column][column];
            }
            let own = &out.lower[row][..row];
            let square = normal[(k, k)] * (1.0 + damping) + MIN_WEIGHT - dot_product(own, own);
            if !(square > 0.0 && square.is_finite()) {
                return None;
            }
            out.lower[row][row] = 1.0 / square.sqrt();
        }
        Some(out)
    }

    /// Returns the solution; 0 for fixed parameters.
    pub fn solve(&self, right: &ParameterVector) -> ParameterVector {
        let mut part = [0.0; N];
        for (value, &k) in part.iter_mut().zip(&self.list) {
            *value = right[k];
        }
        self.solve_part(&mut part, 0);
        let mut out = ParameterVector::zeros();
        for (&value, &k) in part.iter().zip(&self.list) {
            out[k] = value;
        }
        out
    }

    /// Returns the inverse; 0 for fixed parameters.
    pub fn inverse(&self) -> NormalMatrix {
        let mut out = NormalMatrix::zeros();
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

    /// Solves for a right-hand side that is 0 before `first`.
    fn solve_part(&self, part: &mut [f64; N], first: usize) {
        for row in first..self.list.len() {
            let known = dot_product(&self.lower[row][first..row], &part[first..row]);
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

fn dot_product(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normal() -> NormalMatrix {
        // Rows of an arbitrary Jacobian.
        let rows = (0..60).map(|i| {
            ParameterVector::from_fn(|k, _| (0.7 * (i * (k + 1)) as f64 + k as f64).sin())
        });
        rows.fold(NormalMatrix::zeros(), |sum, row| {
            sum + row * row.transpose()
        })
    }

    #[test]
    fn solves_for_free_parameters_only() {
        let normal = normal();
        let free: [bool; N] = std::array::from_fn(|k| k % 3 != 1);
        let factor =
            CholeskyFactor::new(&normal, &free, 0.0).expect("the rows determine all parameters");
        let right = ParameterVector::from_fn(|k, _| 1.0 + k as f64);
        let (solution, inverse) = (factor.solve(&right), factor.inverse());
        let product = normal * solution;
        for k in 0..N {
            if free[k] {
                assert!(
                    (product[k] - right[k]).abs() < 1e-6,
                    "{k}: {} of {}",
                    product[k],
                    right[k]
                );
                let unit = normal * inverse.column(k);
                for l in (0..N).filter(|&l| free[l]) {
                    let want = if k == l { 1.0 } else { 0.0 };
                    assert!((unit[l] - want).abs() < 1e-6, "{k}, {l}: {}", unit[l]);
                }
            } else {
                assert_eq!((solution[k], inverse[(k, k)]), (0.0, 0.0));
            }
        }
    }

    #[test]
    fn singular_system_returns_none() {
        let free = [true; N];
        let mut flat = normal();
        flat[(3, 3)] = f64::NAN;
        assert!(CholeskyFactor::new(&flat, &free, 0.0).is_none());
        assert!(CholeskyFactor::new(&-normal(), &free, 0.0).is_none());
    }
}
