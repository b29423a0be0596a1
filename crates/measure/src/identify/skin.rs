//! The skin on the ground: a smooth surface through the surveyed markers.

use nalgebra::{SMatrix, SVector, Vector3};

use crate::estimation::robust;

const TERMS: usize = 8;
/// Standard deviation of a marker from the smooth skin, m: survey noise, stickers, panel steps.
const ROUGHNESS_M: f64 = 0.004;
/// Prior standard deviations of the terms over the half span or a metre of chord, m; they matter only if the markers do not
/// determine a term.
const PRIOR_M: [f64; TERMS] = [100.0, 10.0, 1.0, 0.3, 0.15, 0.1, 0.06, 0.04];

type SkinTerms = SVector<f64, TERMS>;

/// Height over the wing frame's X-Z plane: a cubic along the span, chordwise slope and crown, both linear along the span.
#[derive(Clone, Debug)]
pub(super) struct SkinSurface {
    mid_m: f64,
    half_m: f64,
    coefficients: SkinTerms,
    covariance: SMatrix<f64, TERMS, TERMS>,
}

impl SkinSurface {
    /// Fits the skin to points of the wing frame, m, robustly: an outlier does not turn the normals of its neighbours.
    pub(super) fn fit(points: &[Vector3<f64>], sigma_m: &[f64]) -> Self {
        let weights: Vec<f64> = sigma_m
            .iter()
            .map(|sigma| sigma.hypot(ROUGHNESS_M).powi(-2))
            .collect();
        let off = |skin: &Self| {
            let one =
                |(p, w): (&Vector3<f64>, &f64)| (p.y - skin.height(p.x, p.z)).abs() * w.sqrt();
            points.iter().zip(&weights).map(one).collect()
        };
        robust::fit_robustly(&weights, |weights| Self::fit_weighted(points, weights), off)
    }

    /// Fits the skin to points with weights of their heights, 1/m^2.
    fn fit_weighted(points: &[Vector3<f64>], weights: &[f64]) -> Self {
        let (low, high) = points.iter().fold((f64::MAX, f64::MIN), |(low, high), p| {
            (low.min(p.x), high.max(p.x))
        });
        let (mid_m, half_m) = (0.5 * (low + high), (0.5 * (high - low)).max(1.0));
        let mut normal = SMatrix::<f64, TERMS, TERMS>::from_diagonal(&SkinTerms::from(
            PRIOR_M.map(|sigma| 1.0 / (sigma * sigma)),
        ));
        let mut right = SkinTerms::zeros();
        for (p, &weight) in points.iter().zip(weights) {
            let basis = skin_basis_terms((p.x - mid_m) / half_m, p.z);
            normal += basis * basis.transpose() * weight;
            right += basis * (p.y * weight);
        }
        let covariance = normal.try_inverse().unwrap_or_else(SMatrix::zeros);
        Self {
            mid_m,
            half_m,
            coefficients: covariance * right,
            covariance,
        }
    }

    /// Returns the height at (X, Z), m.
    pub(super) fn height(&self, x_m: f64, z_m: f64) -> f64 {
        skin_basis_terms((x_m - self.mid_m) / self.half_m, z_m).dot(&self.coefficients)
    }

    /// Returns the slopes dY/dX and dY/dZ with their standard deviations.
    pub(super) fn slopes(&self, x_m: f64, z_m: f64) -> [(f64, f64); 2] {
        let x = (x_m - self.mid_m) / self.half_m;
        let along = SkinTerms::from([0.0, 1.0, 2.0 * x, 3.0 * x * x, 0.0, z_m, 0.0, z_m * z_m])
            / self.half_m;
        let across = SkinTerms::from([0.0, 0.0, 0.0, 0.0, 1.0, x, 2.0 * z_m, 2.0 * z_m * x]);
        [along, across].map(|gradient| {
            let variance = gradient.dot(&(self.covariance * gradient));
            (gradient.dot(&self.coefficients), variance.max(0.0).sqrt())
        })
    }

    /// Returns the unit normal at (X, Z), wing frame, upwards.
    pub(super) fn normal(&self, x_m: f64, z_m: f64) -> Vector3<f64> {
        let [(along, _), (across, _)] = self.slopes(x_m, z_m);
        Vector3::new(-along, 1.0, -across).normalize()
    }
}

fn skin_basis_terms(x: f64, z: f64) -> SkinTerms {
    SkinTerms::from([1.0, x, x * x, x * x * x, z, z * x, z * z, z * z * x])
}
