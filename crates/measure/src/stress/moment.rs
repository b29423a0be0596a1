//! Bending moment from curvature: Euler and Bernoulli, small strains. A survey on the ground does not see the bending by
//! the wing's weight, so the moment is the change relative to the ground.

use nalgebra::{DMatrix, DVector};

use crate::adjust::beam::curvature_basis;
use crate::setup::StiffnessSection;

/// A bending moment with its standard deviation and the contributions to it, N m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BendingMoment {
    /// Moment; positive if it bends the tip up.
    pub value: f64,
    /// Standard deviation from all contributions.
    pub sigma: f64,
    /// Contribution of the stiffness and of steps, engines and struts that a smooth curvature does not resolve: common to
    /// all frames.
    pub sigma_by_stiffness: f64,
}

/// Bending moment as a function of its sources of errors, which have standard deviation 1 except for the coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct MomentFunction {
    /// Derivatives with respect to the coefficients of the curvature, N m per 1/m.
    pub by_coefficient: DVector<f64>,
    /// Effect of the stiffness, N m.
    pub by_stiffness: f64,
    /// Effect of the position of the bending root, N m.
    pub by_root: f64,
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

    /// Returns the bending moment at a section as a function of its sources of errors.
    pub fn moment_function(&self, section: &StiffnessSection) -> MomentFunction {
        let (s_m, step_m) = (section.s_m, DERIVATIVE_STEP * self.length_m);
        let basis = self.curvature_basis_at(s_m);
        let (before_m, after_m) = ((s_m - step_m).max(0.0), s_m + step_m);
        let slope = (self.curvature_basis_at(after_m) - self.curvature_basis_at(before_m))
            .dot(&self.coefficients_per_m)
            / (after_m - before_m);
        let curvature_per_m = basis.dot(&self.coefficients_per_m);
        let sigma_ei = section.sigma_ei_n_m2.hypot(self.steps * section.ei_n_m2);
        MomentFunction {
            by_coefficient: basis * section.ei_n_m2,
            by_stiffness: sigma_ei * curvature_per_m,
            // Stations come from drawings, but the curve begins at the root of the adjustment.
            by_root: section.ei_n_m2 * slope * self.root_sigma_m,
        }
    }

    /// Returns the change of the bending moment relative to the ground.
    pub fn bending_moment(&self, section: &StiffnessSection) -> BendingMoment {
        let function = self.moment_function(section);
        let by = &function.by_coefficient;
        let variance = (by.transpose() * &self.covariance * by)[(0, 0)].max(0.0);
        let sigma_by_curvature = variance.sqrt().hypot(function.by_root);
        let sigma_by_stiffness = function.by_stiffness.abs();
        BendingMoment {
            value: by.dot(&self.coefficients_per_m),
            sigma: sigma_by_curvature.hypot(sigma_by_stiffness),
            sigma_by_stiffness,
        }
    }
}
