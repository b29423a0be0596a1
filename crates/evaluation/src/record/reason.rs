//! Reason for an image without a result: one sentence and the error that caused it.

use std::error::Error;
use std::fmt::Display;
use std::sync::Arc;
use wingd_base::failure::Failure;

use wingd_measure::adjust::AdjustError;

/// Sentence for the user that says what to do, with the error that caused it; programs only write it down.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{text}")]
pub struct Reason {
    text: String,
    /// Text without its general remedy, if it has one.
    problem: Option<String>,
    source: Option<Arc<dyn Error + Send + Sync>>,
}

impl Reason {
    /// Creates a reason from an error whose message is sufficient.
    pub fn from_error(error: impl Error + Send + Sync + 'static) -> Self {
        Self::new(error.to_string(), error)
    }

    /// Creates the reason of an adjustment that failed.
    pub fn from_adjustment(error: AdjustError) -> Self {
        let problem = match &error {
            AdjustError::Estimation(cause) => Some(cause.problem()),
            _ => None,
        };
        Self {
            problem,
            ..Self::from_error(error)
        }
    }

    /// Returns the sentence without its general remedy.
    pub fn problem(&self) -> &str {
        self.problem.as_deref().unwrap_or(&self.text)
    }

    /// Creates a reason from a sentence and the error that caused it.
    pub fn new(text: impl Into<String>, source: impl Error + Send + Sync + 'static) -> Self {
        Self {
            text: text.into(),
            problem: None,
            source: Some(Arc::new(source)),
        }
    }

    /// Returns the sentence.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Prefixes the sentence with the thing that it is about.
    pub fn with_context(self, what: impl Display) -> Self {
        Self {
            text: format!("{what}: {}", self.text),
            ..self
        }
    }
}

impl<T: Into<String>> From<T> for Reason {
    fn from(text: T) -> Self {
        Self {
            text: text.into(),
            problem: None,
            source: None,
        }
    }
}

impl PartialEq for Reason {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text
    }
}

impl From<Reason> for Failure {
    fn from(error: Reason) -> Self {
        Self::from_error(error)
    }
}
