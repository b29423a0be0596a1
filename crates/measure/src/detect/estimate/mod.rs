//! Fit of the image model to pixels: Gauss-Newton iteration with robust weights, priors, covariance, optional terms.

pub mod bounds;
pub mod cholesky;
pub mod gauss_newton;
pub mod lack_of_fit;
pub mod normal_equations;
pub mod options;
pub mod outlined_quadrants;
pub mod overshoot;
pub mod prior;
pub mod residuals;
pub mod sandwich;
pub mod scale;
pub mod terms;
