//! Least squares: the engine of adjustment, orientation and calibration.
//!
//! A problem has conditions `f(x, d, l + v) = 0` between global parameters `x`, parameters `d` local to a
//! group (a marker's distance, a frame's amplitude) and observations `l` with residuals `v`. The solution
//! minimises `v' Q^-1 v` plus the contribution of the priors (Koch, *Parameter Estimation and Hypothesis
//! Testing in Linear Models*; Niemeier, *Ausgleichungsrechnung*). Work goes block by block: `(B Q B')^-1` is
//! as large as one block, and a group's local parameters are eliminated by their Schur complement, so the
//! cost is linear in the number of groups.
//!
//! ```text
//! linearised:   A dx + L dd + B v + w = 0      w = f(x, d, l0) + B (l - l0)
//! M = B Q B'    N = sum A' M^-1 A - (A' M^-1 L)(L' M^-1 L)^-1(L' M^-1 A) + priors
//! v = -Q B' M^-1 (A dx + L dd + w)
//! ```
//!
//! | subject | file |
//! |---|---|
//! | observations, conditions, priors | `problem.rs`, `prior.rs` |
//! | Gauss-Helmert model: whitening, elimination, steps, covariance | `linear.rs`, `stack.rs`, `state.rs`, `system.rs`, `solve.rs`, `secants.rs`, `fit.rs` |
//! | spurious information from the noise of many groups' own parameters | `hessian_correction.rs` |
//! | global test, redundancy, w-test, minimal detectable bias | `quality.rs` |
//! | sources of a variance | `variance_budget.rs` |
//! | variance components, robust weights | `components.rs`, `robust.rs` |
//!
//! To use it, fill a [`Problem`], give [`solve`] a closure that returns a [`Linearised`] block at a
//! [`BlockPoint`], and read the [`Fit`]. [`Fit::propagate`] carries the covariance to any function of
//! parameters, local parameters and adjusted observations.

mod components;
mod error;
mod fit;
mod hessian_correction;
mod linear;
mod prior;
mod problem;
pub mod quality;
pub mod robust;
mod secants;
mod solve;
mod stack;
mod state;
mod system;
mod variance_budget;

pub use components::{ComponentEstimate, VarianceComponent, VarianceGroup, variance_components};
pub use error::{EstimationError, EstimationResult};
pub use fit::{BlockFit, Fit, Gradient, GroupFit, PropagatedCovariance, symmetric_root};
pub use problem::{
    Block, BlockPoint, Group, GroupPoint, InformationPrior, Linearised, Prior, PriorName, Problem,
};
pub use quality::{GlobalTest, SigmaKind};
pub use solve::{SolveOptions, solve, solve_groups};
pub use variance_budget::{
    AttributedInformation, NamedObservations, SourceNames, VarianceContribution, VarianceSources,
};

#[cfg(test)]
mod tests;
