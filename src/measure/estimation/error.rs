//! Why least squares gives no solution.

/// Why no solution was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EstimationError {
    /// The normal matrix is singular; the datum that is missing is named.
    #[error("the adjustment has no unique solution: {missing}")]
    Singular {
        /// What cannot be determined, and from what it could.
        missing: String,
    },
    /// The iteration did not settle.
    #[error(
        "the adjustment did not converge after {iterations} iterations; look for a wrong survey point or a wrong identity"
    )]
    NoConvergence {
        /// Iterations done.
        iterations: usize,
    },
    /// A condition has no value, or a number is not finite.
    #[error("{0}")]
    Input(String),
}
