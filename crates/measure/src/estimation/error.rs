//! Errors of least squares.

/// Result of a step of an estimation.
pub type EstimationResult<T> = Result<T, EstimationError>;

/// An error that leaves a problem without a solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EstimationError {
    /// The normal matrix is singular.
    #[error("the adjustment has no unique solution: {missing}")]
    Singular {
        /// Parameter that cannot be determined, and the missing information.
        missing: String,
    },
    /// The iteration did not converge.
    #[error("{}; check for a wrong survey point or a wrong identity", self.problem())]
    NoConvergence { iterations: usize },
    /// A condition has no value, or a number is not finite.
    #[error("{0}")]
    Input(String),
}

impl EstimationError {
    /// Returns the message without its general remedy, for callers that know the cause.
    pub fn problem(&self) -> String {
        match self {
            Self::NoConvergence { iterations } => {
                format!("the adjustment did not converge after {iterations} iterations")
            }
            Self::Singular { .. } | Self::Input(_) => self.to_string(),
        }
    }
}
