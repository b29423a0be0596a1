//! Rigid and similarity transforms from corresponding points.

use nalgebra::{DMatrix, Rotation3, Vector3};

/// `target = scale * rotation * source + translation`; scale 1 for a rigid transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Scale, target over source.
    pub scale: f64,
    /// target_from_source.
    pub rotation: Rotation3<f64>,
    /// m, target frame.
    pub translation_m: Vector3<f64>,
}

impl Similarity {
    /// A point of the source frame in the target frame, m.
    pub fn apply(&self, source_m: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * source_m * self.scale + self.translation_m
    }
}

/// A fitted transform with its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformFit {
    /// The estimate.
    pub transform: Similarity,
    /// 7 x 7: small rotation (target frame, left perturbation, rad), translation (m), scale;
    /// the scale's row and column are 0 for a rigid transform.
    pub covariance: DMatrix<f64>,
    /// target - transform(source) per point, m.
    pub residuals_m: Vec<Vector3<f64>>,
    /// Conditions less parameters.
    pub redundancy: usize,
    /// Weighted squared residuals over the redundancy; `None` at redundancy 0.
    pub variance_factor: Option<f64>,
}

/// Why no transform was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// Fewer than three points, or all on one line.
    #[error("at least three corresponding points that are not on one line are needed")]
    Degenerate,
}
