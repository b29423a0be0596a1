//! The covariance of a detection's place: named contributions, summed here and nowhere else.
//!
//! What shifts a place and leaves no trace in the residuals is a [`Source`] of its own. A new one needs a name here, and a place
//! in the code that calls [`Covariance::add`]; its share then stands in `wingd detect --json` by itself.

use std::ops::Deref;

use nalgebra::{Cholesky, Matrix2, SymmetricEigen, Vector2};
use serde::Serialize;

/// Why a place is uncertain; its name in results is the variant's in small letters, as `curved_skin`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CovarianceSource {
    /// The fit's residuals, as if they were independent, and its Jacobian.
    Fit,
    /// Residuals that hang together in this marker: uneven light, something foreign, JPEG's blocks.
    LackOfFit,
    /// Residuals that hang together in all of the frame's markers, as JPEG leaves them.
    FrameCorrelation,
    /// How a decal lies on a curved skin.
    CurvedSkin,
    /// Glare's fringe beside what is seen of a disc.
    GlareFringe,
    /// Glare that lies over a disc and changes across it.
    ThroughGlare,
    /// An end that glare saturates.
    SaturatedEnd,
    /// What lies on the skin beside an edge or across it, as dirt that the air draws along a disc, a streak, another light.
    Beside,
    /// What takes contrast from quadrants, as frost, drops and dirt on the pane: light that comes another way.
    LostContrast,
    /// Residuals larger than noise: what the image formula leaves may be a bias of edges.
    Misfit,
    /// A thin disc is longer or shorter than its neighbours predict.
    NeighbourLength,
    /// A disc is thinner than the one beside it, whose decal may hide a part of it.
    NeighbourThickness,
    /// A disc is larger or smaller than the survey's diameter at its distance.
    SurveyedSize,
    /// A second look at the same disc saw it elsewhere.
    SecondLook,
    /// The perspective bias of a disc's centre, which is removed, is known to some share.
    Perspective,
    /// Stated by whoever made the detection, with no more said.
    Stated,
}

/// The covariance of a place, px^2, with what it is the sum of. It is read as the matrix that it is, and only grows by name.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    sum: Matrix2<f64>,
    contributions: Vec<(CovarianceSource, Matrix2<f64>)>,
}

impl Covariance {
    /// Of a fit, px^2: as its residuals deserve, and `white`, as if they were independent.
    pub fn of_fit(deserved: Matrix2<f64>, white: Matrix2<f64>) -> Self {
        let mut out = Self { sum: deserved, contributions: Vec::new() };
        out.note(CovarianceSource::Fit, white);
        out.note(CovarianceSource::LackOfFit, deserved - white);
        out
    }

    /// Adds what a source makes doubtful, px^2.
    pub fn add(&mut self, source: CovarianceSource, doubt: Matrix2<f64>) {
        self.sum += doubt;
        self.note(source, doubt);
    }

    /// Adds a standard deviation, px, along a unit vector.
    pub fn add_along(&mut self, source: CovarianceSource, axis: Vector2<f64>, variance_px2: f64) {
        self.add(source, axis * axis.transpose() * variance_px2);
    }

    /// Raises it to what a source shows, px^2, in the directions in which that is more; not to what is not positive definite.
    pub fn raise(&mut self, source: CovarianceSource, shown: &Matrix2<f64>) {
        if let Some((raised, _)) = at_least(shown, &self.sum, 1.0) {
            self.note(source, raised - self.sum);
            self.sum = raised;
        }
    }

    /// What it is the sum of, in the order in which it came, px^2.
    pub fn contributions(&self) -> impl Iterator<Item = (CovarianceSource, &Matrix2<f64>)> {
        self.contributions.iter().map(|(source, own)| (*source, own))
    }

    /// What a source contributes, px^2; zero where it does not.
    pub fn of(&self, source: CovarianceSource) -> Matrix2<f64> {
        self.contributions.iter().find(|(own, _)| *own == source).map_or_else(Matrix2::zeros, |(_, own)| *own)
    }

    fn note(&mut self, source: CovarianceSource, own: Matrix2<f64>) {
        /// What rounding leaves where nothing is raised, as a share of the sum.
        const ROUNDING: f64 = 1e-12;
        match self.contributions.iter_mut().find(|(known, _)| *known == source) {
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
    fn from(stated: Matrix2<f64>) -> Self {
        Self { sum: stated, contributions: vec![(CovarianceSource::Stated, stated)] }
    }
}

/// The square of how far two places are apart, px, in standard deviations of their difference; infinite where its covariance
/// is singular.
pub fn mahalanobis(apart: &Vector2<f64>, covariance: &Matrix2<f64>) -> f64 {
    covariance.try_inverse().map_or(f64::INFINITY, |inverse| apart.dot(&(inverse * apart)))
}

/// `white` raised to `seen` in the directions in which that is greater by more than a factor, and the greatest of their
/// ratios; `None` where `white` is not positive definite.
pub fn at_least(white: &Matrix2<f64>, seen: &Matrix2<f64>, factor: f64) -> Option<(Matrix2<f64>, f64)> {
    let root = Cholesky::new(*white)?.l();
    let inverse = root.try_inverse()?;
    let eigen = SymmetricEigen::new(inverse * seen * inverse.transpose());
    let raised = Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| if v > factor { v } else { 1.0 }));
    let back = root * eigen.eigenvectors;
    Some((back * raised * back.transpose(), eigen.eigenvalues.max()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contributions_add_up_to_the_covariance() {
        let mut all = Covariance::of_fit(Matrix2::new(0.04, 0.01, 0.01, 0.02), Matrix2::identity() * 0.01);
        all.add_along(CovarianceSource::Beside, Vector2::new(0.6, 0.8), 0.09);
        all.add_along(CovarianceSource::Beside, Vector2::new(0.6, 0.8), 0.01);
        all.add(CovarianceSource::ThroughGlare, Matrix2::zeros());
        let before = *all;
        all.raise(CovarianceSource::FrameCorrelation, &(Matrix2::identity() * 0.05));
        // Across the dirt there was less than that, along it more.
        let across = Vector2::new(-0.8, 0.6);
        assert!(across.dot(&(*all * across)) > 0.0499 && (all.trace() > before.trace()));
        let sum: Matrix2<f64> = all.contributions().map(|(_, own)| own).sum();
        assert!((sum - *all).norm() < 1e-15, "{sum} is not {all:?}");
        let sources: Vec<CovarianceSource> = all.contributions().map(|(source, _)| source).collect();
        assert_eq!(sources, [CovarianceSource::Fit, CovarianceSource::LackOfFit, CovarianceSource::Beside, CovarianceSource::FrameCorrelation]);
        assert!((all.of(CovarianceSource::Beside).trace() - 0.1).abs() < 1e-15);
    }
}
