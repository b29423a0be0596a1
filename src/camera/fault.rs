//! A section of the configuration has its faults in this form.

/// Key, problem, mend.
pub type Fault = (String, String, String);

/// Longest delay that is believed, s.
#[cfg(any(feature = "v4l", feature = "gpio"))]
const LONGEST_DELAY_S: f64 = 10.0;

/// What is wrong with a measured delay and its standard deviation.
#[cfg(any(feature = "v4l", feature = "gpio"))]
pub(crate) fn delay_fault(key: &str, seconds: Option<f64>, sigma_s: Option<f64>) -> Option<Fault> {
    let mend = format!("give {key}_s and {key}_sigma_s together, measured, or leave both out");
    match (seconds, sigma_s) {
        (None, None) => None,
        (Some(s), Some(sigma)) if s.abs() <= LONGEST_DELAY_S && (0.0..=LONGEST_DELAY_S).contains(&sigma) => {
            None
        }
        (Some(s), Some(sigma)) => {
            let mend = format!("give at most {LONGEST_DELAY_S} s, and a standard deviation of 0 or more");
            Some((format!("{key}_s"), format!("is {s} s with a standard deviation of {sigma} s"), mend))
        }
        (Some(_), None) => Some((format!("{key}_sigma_s"), "is missing".to_owned(), mend)),
        (None, Some(_)) => Some((format!("{key}_s"), "is missing".to_owned(), mend)),
    }
}
