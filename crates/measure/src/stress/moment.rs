//! Bending moment from curvature: Euler and Bernoulli, small strains. A survey on the ground does not see the bending by
//! the wing's weight, so the moment is the change relative to the ground.

use nalgebra::{DMatrix, DVector};

use crate::adjust::beam::curvature_basis;
use crate::adjust::ground::GroundShape;
use crate::adjust::{AdjustResult, Estimate};
use crate::setup::{Orientation, Setup, StiffnessSection};

/// A bending moment with its standard deviation and the contributions to it, N m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BendingMoment {
    /// Moment; positive if it bends the tip up.
    pub value: f64,
    /// Standard deviation from all contributions.
    pub sigma: f64,
    /// Contribution of the curvature: independent in each frame except for survey and mounting.
    pub sigma_by_curvature: f64,
    /// Contribution of the stiffness and of steps, engines and struts that a smooth curvature does not resolve: common to
    /// all frames.
    pub sigma_by_stiffness: f64,
}

/// Curvature of an adjusted bending line.
#[derive(Clone, Debug, PartialEq)]
pub struct BendingCurvature {
    /// Coefficients of the basis, 1/m.
    pub coefficients_per_m: DVector<f64>,
    /// Covariance of the coefficients, 1/m^2.
    pub covariance: DMatrix<f64>,
    /// Length from the bending root to the wing tip, m.
    pub length_m: f64,
    /// Standard deviation of the bending root along the span, m; 0 if it is fixed.
    pub root_sigma_m: f64,
    /// Relative standard deviation of the local curvature from the smooth one, by steps, engines and struts; default:
    /// [`DEFAULT_STEPS`].
    pub steps: f64,
}

/// Relative error of a curvature of eight terms, which is smooth over 1/8 of the length, at a position where the stiffness
/// steps by 20 %, the slope has a kink of 1 mrad or an engine carries 10 % of the root's moment.
pub const DEFAULT_STEPS: f64 = 0.02;

/// Step of the derivative of the curvature with respect to position, over the length.
const DERIVATIVE_STEP: f64 = 1e-3;

impl BendingCurvature {
    fn curvature_basis_at(&self, s_m: f64) -> DVector<f64> {
        let basis = curvature_basis(s_m / self.length_m);
        DVector::from_fn(self.coefficients_per_m.len(), |k, _| {
            basis.get(k).copied().unwrap_or(0.0)
        })
    }

    /// Returns the change of the curvature at a position, relative to the ground, 1/m.
    pub fn value_at(&self, s_m: f64) -> Estimate {
        let basis = self.curvature_basis_at(s_m);
        let step_m = DERIVATIVE_STEP * self.length_m;
        let slope = self.curvature_basis_at(s_m + step_m)
            - self.curvature_basis_at((s_m - step_m).max(0.0));
        let apart_m = s_m + step_m - (s_m - step_m).max(0.0);
        // Stations come from drawings, but the curve begins at the root of the adjustment.
        let by_root = slope.dot(&self.coefficients_per_m) / apart_m * self.root_sigma_m;
        let variance = (basis.transpose() * &self.covariance * &basis)[(0, 0)].max(0.0);
        Estimate {
            value: basis.dot(&self.coefficients_per_m),
            sigma: Some(variance.sqrt().hypot(by_root)),
        }
    }

    /// Returns the change of the bending moment relative to the ground.
    pub fn bending_moment(&self, section: &StiffnessSection) -> BendingMoment {
        let curvature = self.value_at(section.s_m);
        let sigma_by_curvature = section.ei_n_m2 * curvature.sigma.unwrap_or(0.0);
        let sigma_ei = section.sigma_ei_n_m2.hypot(self.steps * section.ei_n_m2);
        let sigma_by_stiffness = sigma_ei * curvature.value.abs();
        BendingMoment {
            value: section.ei_n_m2 * curvature.value,
            sigma: sigma_by_curvature.hypot(sigma_by_stiffness),
            sigma_by_curvature,
            sigma_by_stiffness,
        }
    }
}

/// Returns the length of the bending axis, from the root to the end of the curvature, m.
///
/// # Errors
/// Returns an error if the survey gives no wing.
pub fn bending_length_m(setup: &Setup, orientation: &Orientation) -> AdjustResult<f64> {
    let shaping = orientation.shaping_markers(setup.markers.len());
    Ok(GroundShape::new(setup, &shaping)?.axis.length_m)
}
