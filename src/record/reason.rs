//! An image without a result has a reason: one sentence, with the error that it comes from.

use std::error::Error;
use std::fmt::Display;
use std::sync::Arc;

/// One sentence for a person that says what to do, with the error that it comes from. All that anybody does with it is to
/// write it down.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{text}")]
pub struct Reason {
    text: String,
    source: Option<Arc<dyn Error + Send + Sync>>,
}

impl Reason {
    /// Where the error says it all.
    pub fn of(error: impl Error + Send + Sync + 'static) -> Self {
        Self::new(error.to_string(), error)
    }

    /// A sentence with the error that it comes from.
    pub fn new(text: impl Into<String>, source: impl Error + Send + Sync + 'static) -> Self {
        Self { text: text.into(), source: Some(Arc::new(source)) }
    }

    /// The sentence.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The same after what it is about.
    pub fn about(self, what: impl Display) -> Self {
        Self { text: format!("{what}: {}", self.text), ..self }
    }
}

impl<T: Into<String>> From<T> for Reason {
    fn from(text: T) -> Self {
        Self { text: text.into(), source: None }
    }
}

impl PartialEq for Reason {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text
    }
}
