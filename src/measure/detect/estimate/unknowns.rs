//! What a fit seeks, and what is known of it beforehand.

use crate::measure::detect::appearance::parameters::N;

/// What is sought, and what is known of it beforehand.
#[derive(Clone, Debug)]
pub struct Unknowns {
    /// Parameters that are sought.
    pub free: [bool; N],
    /// Usual value and its standard deviation, infinite where nothing is known.
    pub prior: [(f64, f64); N],
}
