//! Least squares: the engine on which adjustment, orientation and calibration stand.
//!
//! Conditions `f(x, d, l + v) = 0` between global parameters `x`, parameters `d` local to a group
//! (a marker's distance, a frame's amplitude) and observations `l` with residuals `v`; minimised
//! is `v' Q^-1 v` plus the priors' share (Koch, *Parameter Estimation and Hypothesis Testing in
//! Linear Models*; Niemeier, *Ausgleichungsrechnung*). Work goes block by block: `(B Q B')^-1` is as
//! large as one block, a group's local parameters leave by their Schur complement, so the cost is
//! linear in the number of groups.
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
//! | Gauss and Helmert: whitening, elimination, steps, covariance | `linear.rs`, `stack.rs`, `state.rs`, `system.rs`, `solve.rs`, `secants.rs`, `fit.rs` |
//! | what the noise of many groups' own parameters feigns | `second.rs` |
//! | few shared parameters of a fixed number, thousands of points | `arrow.rs` |
//! | global test, redundancy, w, minimal detectable bias | `quality.rs` |
//! | what a variance comes from | `shares.rs` |
//! | variance components, robust weights | `components.rs`, `robust.rs` |
//!
//! How to use it: fill a [`Problem`], give [`solve`] a closure that returns a [`Linearised`] block
//! at a [`Point`], and read the [`Fit`]; [`Fit::propagate`] carries covariance to any function of
//! parameters, local parameters and adjusted observations.

pub mod arrow;
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

pub use components::{Components, VarianceComponent, VarianceGroup, variance_components};
pub use error::EstimationError;
pub use fit::{BlockFit, Fit, Gradient, GroupFit, Propagated};
pub use problem::{Block, Group, GroupPoint, InformationPrior, Linearised, Point, Prior, Problem};
pub use quality::{GlobalTest, SigmaKind};
pub use solve::{SolveOptions, solve, solve_with_options, solve_groups};
pub use variance_budget::{AttributedInformation, Naming, Observed, Part, Sources};

#[cfg(test)]
mod tests;
