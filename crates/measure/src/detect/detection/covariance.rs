//! Covariance of a detection's position: named contributions, which are summed only here.
//!
//! Every effect that shifts a position and leaves no trace in the residuals is a [`CovarianceSource`]. A new one needs a
//! name here and a place in the code that calls [`Covariance::add`]; its contribution then appears in `wingd detect --json`
//! automatically.

use std::ops::Deref;

use nalgebra::{Cholesky, Matrix2, SymmetricEigen, Vector2};
use serde::Serialize;

/// Source of uncertainty of a position. Its name in results is that of the variant in snake case, such as `curved_skin`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CovarianceSource {
    /// Residuals of the fit as if they were independent, and its Jacobian.
    Fit,
    /// Correlated residuals of this marker: uneven light, contamination, JPEG blocks.
    LackOfFit,
    /// Correlated residuals of all of the frame's markers, as JPEG leaves them.
    FrameCorrelation,
    /// Unknown way in which a decal lies on a curved skin.
    CurvedSkin,
    /// Fringe of glare next to the visible part of a disc.
    GlareFringe,
    /// Glare that lies over a disc and changes across it.
    ThroughGlare,
    /// End of a disc that glare saturates.
    SaturatedEnd,
    /// Contamination of the skin next to an edge or across it, such as dirt that the air draws along a disc, a streak,
    /// uneven light.
    Contamination,
    /// Loss of contrast of quadrants, as from frost, drops and dirt on the pane: light on another path.
    LostContrast,
    /// Residuals larger than noise: errors of the image formula may be a bias of edges.
    Misfit,
    /// Length of a thin disc that differs from that predicted by its neighbours.
    NeighbourLength,
    /// Thickness of a disc below that of a neighbour whose decal may hide a part of it.
    NeighbourThickness,
    /// Size of a disc that differs from that predicted by the survey's diameter at its distance.
    SurveyedSize,
    /// Uncertainty of the perspective bias of a disc's centre, which is removed.
    Perspective,
    /// Covariance given with the detection, without further detail.
    Given,
}

/// Covariance of a position, px^2, with its contributions. It dereferences to the matrix, and increases only by named
/// contributions.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    sum: Matrix2<f64>,
    contributions: Vec<(CovarianceSource, Matrix2<f64>)>,
}

impl Covariance {
    /// Creates the covariance of a fit, px^2: `deserved` by its residuals, and `white` as if they were independent.
    pub fn from_fit(deserved: Matrix2<f64>, white: Matrix2<f64>) -> Self {
        let mut out = Self {
            sum: deserved,
            contributions: Vec::new(),
        };
        out.record_contribution(CovarianceSource::Fit, white);
        out.record_contribution(CovarianceSource::LackOfFit, deserved - white);
        out
    }

    /// Adds the contribution of a source, px^2.
    pub fn add(&mut self, source: CovarianceSource, contribution: Matrix2<f64>) {
        self.sum += contribution;
        self.record_contribution(source, contribution);
    }

    /// Adds the variance of a source along a unit vector, px^2.
    pub fn add_along(&mut self, source: CovarianceSource, axis: Vector2<f64>, variance_px2: f64) {
        self.add(source, axis * axis.transpose() * variance_px2);
    }

    /// Raises the covariance to that of a source, px^2, in the directions in which that is larger. It stays unchanged if it
    /// is not positive definite.
    pub fn raise(&mut self, source: CovarianceSource, shown: &Matrix2<f64>) {
        if let Some((raised, _)) = raise_covariance(shown, &self.sum, 1.0) {
            self.record_contribution(source, raised - self.sum);
            self.sum = raised;
        }
    }

    /// Returns the contributions in the order in which they were added, px^2.
    pub fn contributions(&self) -> impl Iterator<Item = (CovarianceSource, &Matrix2<f64>)> {
        self.contributions
            .iter()
            .map(|(source, own)| (*source, own))
    }

    /// Returns the contribution of a source, px^2; zero if there is none.
    pub fn contribution(&self, source: CovarianceSource) -> Matrix2<f64> {
        self.contributions
            .iter()
            .find(|(own, _)| *own == source)
            .map_or_else(Matrix2::zeros, |(_, own)| *own)
    }

    fn record_contribution(&mut self, source: CovarianceSource, own: Matrix2<f64>) {
        /// Relative rounding error of a covariance that is not raised.
        const ROUNDING: f64 = 1e-12;
        match self
            .contributions
            .iter_mut()
            .find(|(known, _)| *known == source)
        {
            Some((_, known)) => *known += own,
            None if own.norm() <= ROUNDING * self.sum.norm() => {}
            None => self.contributions.push((source, own)),
        }
    }
}

impl Deref for Covariance {
    type Target = Matrix2<f64>;

    fn deref(&self) -> &Self::Target {
        &self.sum
    }
}

impl From<Matrix2<f64>> for Covariance {
    fn from(given: Matrix2<f64>) -> Self {
        Self {
            sum: given,
            contributions: vec![(CovarianceSource::Given, given)],
        }
    }
}

/// Returns the squared Mahalanobis distance of two positions from their difference, px, and its covariance, px^2; infinite
/// if that is singular.
pub fn squared_mahalanobis(apart: &Vector2<f64>, covariance: &Matrix2<f64>) -> f64 {
    covariance
        .try_inverse()
        .map_or(f64::INFINITY, |inverse| apart.dot(&(inverse * apart)))
}

/// Raises the covariance `base` to `shown` in the directions in which `shown` is larger by more than a factor. Also
/// returns the largest ratio; `None` if `base` is not positive definite.
pub fn raise_covariance(
    base: &Matrix2<f64>,
    shown: &Matrix2<f64>,
    factor: f64,
) -> Option<(Matrix2<f64>, f64)> {
    let root = Cholesky::new(*base)?.l();
    let inverse = root.try_inverse()?;
    let eigen = SymmetricEigen::new(inverse * shown * inverse.transpose());
    let raised =
        Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| if v > factor { v } else { 1.0 }));
    let back = root * eigen.eigenvectors;
    Some((back * raised * back.transpose(), eigen.eigenvalues.max()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contributions_add_up_to_the_covariance() {
        let mut all = Covariance::from_fit(
            Matrix2::new(0.04, 0.01, 0.01, 0.02),
            Matrix2::identity() * 0.01,
        );
        all.add_along(
            CovarianceSource::Contamination,
            Vector2::new(0.6, 0.8),
            0.09,
        );
        all.add_along(
            CovarianceSource::Contamination,
            Vector2::new(0.6, 0.8),
            0.01,
        );
        all.add(CovarianceSource::ThroughGlare, Matrix2::zeros());
        let before = *all;
        all.raise(
            CovarianceSource::FrameCorrelation,
            &(Matrix2::identity() * 0.05),
        );
        // Across the dirt the variance was smaller than that, along it larger.
        let across = Vector2::new(-0.8, 0.6);
        assert!(across.dot(&(*all * across)) > 0.0499 && (all.trace() > before.trace()));
        let sum: Matrix2<f64> = all.contributions().map(|(_, own)| own).sum();
        assert!((sum - *all).norm() < 1e-15, "{sum} is not {all:?}");
        let sources: Vec<CovarianceSource> =
            all.contributions().map(|(source, _)| source).collect();
        assert_eq!(
            sources,
            [
                CovarianceSource::Fit,
                CovarianceSource::LackOfFit,
                CovarianceSource::Contamination,
                CovarianceSource::FrameCorrelation
            ]
        );
        assert!((all.contribution(CovarianceSource::Contamination).trace() - 0.1).abs() < 1e-15);
    }
}
