//! First-order response of a and the distances to the observations.
//!
//! The paper's polar point determination (equation 8) uses the **observed** direction with the adjusted distance, so that
//! torsion remains visible. Its covariance therefore needs their correlation.

use nalgebra::{DMatrix, Matrix4, RowVector4};

use super::conditions::{ARC_LENGTH, PER_MARKER, PIXEL};
use crate::estimation::{Fit, Problem};

/// Scalar function of a, of one marker's distance and of its observations.
#[derive(Clone, Copy, Debug)]
pub struct MarkerFunction {
    marker: usize,
    /// Total derivative by a.
    by_a: f64,
    /// Derivative by the marker's own observations at fixed a.
    by_own: RowVector4<f64>,
}

/// Linear response of one marker.
struct MarkerResponse {
    /// d a / d observations.
    a: RowVector4<f64>,
    /// d distance / d a.
    distance_by_a: f64,
    /// d distance / d observations at fixed a.
    distance: RowVector4<f64>,
    covariance: Matrix4<f64>,
}

/// Linear response of all markers.
pub struct LinearResponse {
    markers: Vec<MarkerResponse>,
    variance_a: f64,
}

impl LinearResponse {
    /// Computes the response from the normal equations at the solution.
    pub fn new(problem: &Problem, fit: &Fit) -> Self {
        let variance_a = fit.covariance[(0, 0)];
        let pairs = problem.groups.iter().zip(&fit.groups);
        let markers = pairs.filter_map(|(group, solved)| {
            let (block, lin) = (group.blocks.first()?, &solved.blocks.first()?.linearised);
            let b = &lin.observations;
            let weight = (b * &block.covariance * b.transpose()).try_inverse()?;
            let from_local =
                &weight * &lin.local * &solved.conditional * lin.local.transpose() * &weight;
            let a = lin.global.transpose() * (&weight - from_local) * b * -variance_a;
            let distance = &solved.conditional * lin.local.transpose() * &weight * b * -1.0;
            Some(MarkerResponse {
                a: pad_row_vector(&a),
                distance_by_a: solved.sensitivity[(0, 0)],
                distance: pad_row_vector(&distance),
                covariance: Matrix4::from_column_slice(block.covariance.as_slice()),
            })
        });
        Self {
            markers: markers.collect(),
            variance_a,
        }
    }

    /// Creates a function of a marker's distance and observations from its derivatives.
    pub fn marker_function(
        &self,
        marker: usize,
        by_distance: f64,
        by_observations: RowVector4<f64>,
    ) -> MarkerFunction {
        let own = &self.markers[marker];
        MarkerFunction {
            marker,
            by_a: by_distance * own.distance_by_a,
            by_own: own.distance * by_distance + by_observations,
        }
    }

    /// Creates a function of the bending alone from its derivative.
    pub fn bending_function(by_a: f64) -> MarkerFunction {
        MarkerFunction {
            marker: 0,
            by_a,
            by_own: RowVector4::zeros(),
        }
    }

    /// Covariance of two functions, a priori.
    pub fn covariance(&self, f: &MarkerFunction, g: &MarkerFunction) -> f64 {
        let common = f.by_a * g.by_a * self.variance_a;
        let crossed =
            f.by_a * self.own_covariance_with_a(g) + g.by_a * self.own_covariance_with_a(f);
        let own = if f.marker == g.marker {
            (f.by_own * self.markers[f.marker].covariance * g.by_own.transpose())[(0, 0)]
        } else {
            0.0
        };
        common + crossed + own
    }

    /// Contributions of the survey and of the images to a function's variance.
    pub fn variance_parts(&self, f: &MarkerFunction) -> [f64; 2] {
        let mut parts = [0.0; 2];
        for (index, marker) in self.markers.iter().enumerate() {
            let own = if index == f.marker {
                f.by_own
            } else {
                RowVector4::zeros()
            };
            let by = marker.a * f.by_a + own;
            for (part, first) in parts.iter_mut().zip([ARC_LENGTH, PIXEL]) {
                let by = by.fixed_columns::<2>(first);
                let covariance = marker.covariance.fixed_view::<2, 2>(first, first);
                *part += (by * covariance * by.transpose())[(0, 0)];
            }
        }
        parts
    }

    /// Covariance of a function with a.
    pub fn covariance_with_a(&self, f: &MarkerFunction) -> f64 {
        f.by_a * self.variance_a + self.own_covariance_with_a(f)
    }

    /// Covariance of `a` with the part of a function that its marker's own observations cause at fixed `a`.
    fn own_covariance_with_a(&self, f: &MarkerFunction) -> f64 {
        let marker = &self.markers[f.marker];
        (marker.a * marker.covariance * f.by_own.transpose())[(0, 0)]
    }
}

fn pad_row_vector(m: &DMatrix<f64>) -> RowVector4<f64> {
    RowVector4::from_fn(|_, k| if k < PER_MARKER { m[(0, k)] } else { 0.0 })
}
