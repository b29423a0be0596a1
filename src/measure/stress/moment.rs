//! Bending moment from curvature: Euler and Bernoulli, small strains. What the weight of the wing bends on ground is not
//! seen by a survey on ground, so it is the change against ground.

use nalgebra::{DMatrix, DVector};

use crate::adjust::beam::curvature_basis;
use crate::adjust::ground::GroundShape;
use crate::adjust::{AdjustError, Estimate};
use crate::setup::{Orientation, Setup};

/// A place of the wing of which the stiffness is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// Along the bending axis from the bending root, m.
    pub s_m: f64,
    /// Bending stiffness, N m^2.
    pub ei_n_m2: f64,
    /// Its standard deviation, N m^2.
    pub sigma_ei_n_m2: f64,
    /// Moment on ground, N m; 0 where not stated.
    pub ground_n_m: f64,
    /// Moment at which the section fails, N m.
    pub ultimate_n_m: Option<f64>,
}

/// A moment with its standard deviation and that one's parts, N m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Positive where it bends the tip up.
    pub value: f64,
    /// Of all.
    pub sigma: f64,
    /// From the curvature: another one in each frame but for what survey and mounting share.
    pub sigma_by_curvature: f64,
    /// From the stiffness, and from its steps and the engines and struts that a smooth curvature spreads: one for all frames.
    pub sigma_by_stiffness: f64,
}

/// The curvature of a solved bending line.
#[derive(Clone, Debug, PartialEq)]
pub struct Curvature {
    /// Coefficients of the basis, 1/m.
    pub coefficients_per_m: DVector<f64>,
    /// Their covariance, 1/m^2.
    pub covariance: DMatrix<f64>,
    /// From the bending root to the wing's tip, m.
    pub length_m: f64,
    /// Standard deviation of the bending root along the span, m; 0 where it is held.
    pub root_sigma_m: f64,
    /// What steps, engines and struts change of the curvature at a place against the smooth one, standard deviation as a
    /// share of it: [`USUAL_STEPS`] where nobody knows.
    pub steps: f64,
}

/// What a curvature of eight terms, which is smooth over an eighth of the length, misses by at a place where the stiffness
/// steps by a fifth, the slope has a kink of 1 mrad or an engine takes a tenth of the root's moment, as a share.
pub const USUAL_STEPS: f64 = 0.02;

/// Step of the derivative of the curvature by the place, over the length.
const STEP: f64 = 1e-3;

impl Curvature {
    fn basis(&self, s_m: f64) -> DVector<f64> {
        let basis = curvature_basis(s_m / self.length_m);
        DVector::from_fn(self.coefficients_per_m.len(), |k, _| basis.get(k).copied().unwrap_or(0.0))
    }

    /// Change of the curvature against ground, 1/m.
    pub fn at(&self, s_m: f64) -> Estimate {
        let by = self.basis(s_m);
        let step_m = STEP * self.length_m;
        let slope = self.basis(s_m + step_m) - self.basis((s_m - step_m).max(0.0));
        let apart_m = s_m + step_m - (s_m - step_m).max(0.0);
        // The stations stand where the drawing has them, the curve where the adjustment has its root.
        let by_root = slope.dot(&self.coefficients_per_m) / apart_m * self.root_sigma_m;
        let variance = (by.transpose() * &self.covariance * &by)[(0, 0)].max(0.0);
        Estimate { value: by.dot(&self.coefficients_per_m), sigma: Some(variance.sqrt().hypot(by_root)) }
    }

    /// The change of the bending moment against ground.
    pub fn moment(&self, section: &Section) -> Moment {
        let curvature = self.at(section.s_m);
        let sigma_by_curvature = section.ei_n_m2 * curvature.sigma.unwrap_or(0.0);
        let sigma_ei = section.sigma_ei_n_m2.hypot(self.steps * section.ei_n_m2);
        let sigma_by_stiffness = sigma_ei * curvature.value.abs();
        Moment {
            value: section.ei_n_m2 * curvature.value,
            sigma: sigma_by_curvature.hypot(sigma_by_stiffness),
            sigma_by_curvature,
            sigma_by_stiffness,
        }
    }
}

/// Length of the bending axis, from the root to where curvature ends, m.
pub fn bending_length_m(setup: &Setup, orientation: &Orientation) -> Result<f64, AdjustError> {
    let trusted = orientation.may_shape(setup.markers.len());
    Ok(GroundShape::new(setup, &trusted)?.axis.length_m)
}
