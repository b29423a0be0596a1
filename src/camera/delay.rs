//! Check of a configured delay from an event to the exposure, with its standard deviation.

use wingd_base::fault::KeyFault;

/// Maximum plausible delay, s.
const MAX_DELAY_S: f64 = 10.0;

/// Checks a measured delay and its standard deviation, both or none.
pub(crate) fn delay_fault(
    key: &str,
    seconds: Option<f64>,
    sigma_s: Option<f64>,
) -> Option<KeyFault> {
    let remedy = format!("give both {key}_s and {key}_sigma_s, as measured, or omit both");
    match (seconds, sigma_s) {
        (None, None) => None,
        (Some(s), Some(sigma))
            if s.abs() <= MAX_DELAY_S && (0.0..=MAX_DELAY_S).contains(&sigma) =>
        {
            None
        }
        (Some(s), Some(sigma)) => {
            let remedy = format!(
                "use at most {MAX_DELAY_S} s, and a standard deviation from 0 to {MAX_DELAY_S} s"
            );
            let problem =
                format!("is {s} s with a standard deviation of {sigma} s, which is not plausible");
            Some(KeyFault::new(format!("{key}_s"), problem, remedy))
        }
        (Some(_), None) => Some(KeyFault::new(
            format!("{key}_sigma_s"),
            "is missing",
            remedy,
        )),
        (None, Some(_)) => Some(KeyFault::new(format!("{key}_s"), "is missing", remedy)),
    }
}
