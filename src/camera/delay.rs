//! A delay from an event to the exposure is configured as it was measured, with its standard deviation.

use crate::installation::KeyFault;

/// Longest delay that is believed, s.
const MAX_DELAY_S: f64 = 10.0;

/// What is wrong with a measured delay and its standard deviation.
pub(crate) fn delay_fault(key: &str, seconds: Option<f64>, sigma_s: Option<f64>) -> Option<KeyFault> {
    let mend = format!("give {key}_s and {key}_sigma_s together, measured, or leave both out");
    match (seconds, sigma_s) {
        (None, None) => None,
        (Some(s), Some(sigma)) if s.abs() <= MAX_DELAY_S && (0.0..=MAX_DELAY_S).contains(&sigma) => None,
        (Some(s), Some(sigma)) => {
            let mend = format!("give at most {MAX_DELAY_S} s, and a standard deviation of 0 or more");
            let problem = format!("is {s} s with a standard deviation of {sigma} s");
            Some(KeyFault::new(format!("{key}_s"), problem, mend))
        }
        (Some(_), None) => Some(KeyFault::new(format!("{key}_sigma_s"), "is missing", mend)),
        (None, Some(_)) => Some(KeyFault::new(format!("{key}_s"), "is missing", mend)),
    }
}
