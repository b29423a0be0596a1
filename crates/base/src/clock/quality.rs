//! Quality of the kernel's UTC, as reported to the kernel (`adjtimex`) by the program that disciplines the clock: chrony or
//! another NTP client, `phc2sys` behind PTP, or a receiver's pulses.

use serde::{Deserialize, Serialize};

/// Maximum error from which the kernel treats its clock as unsynchronised, s (`NTP_PHASE_LIMIT`, 16 s).
const UNSYNCHRONISED_S: f64 = 16.0;
/// Standard deviation of a clock whose service reports no error at all, s: an assumption for NTP over a network.
/// (systemd-timesyncd writes 0 for both errors.)
const UNSTATED_SIGMA_S: f64 = 0.01;

/// Quality of the clock reported by the kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockQuality {
    /// True if a program disciplines the clock.
    pub synchronised: bool,
    /// Maximum error, s; grows by 500 ppm from one correction to the next. `null` if the kernel cannot be queried.
    pub max_error_s: Option<f64>,
    pub estimated_error_s: Option<f64>,
    /// Standard deviation of UTC derived from these, s; `null` if unknown.
    pub sigma_s: Option<f64>,
}

impl ClockQuality {
    /// Derives the standard deviation from the kernel's values. An estimated error above the maximum is the kernel's
    /// initial value, which nobody has set (`phc2sys` sets the maximum only): then the error is uniform up to the maximum.
    pub fn from_kernel_values(
        synchronised: bool,
        max_error_s: f64,
        estimated_error_s: f64,
    ) -> Self {
        let sigma = if estimated_error_s > 0.0 && estimated_error_s <= max_error_s {
            estimated_error_s
        } else {
            let unstated = if estimated_error_s > 0.0 {
                0.0
            } else {
                UNSTATED_SIGMA_S
            };
            (max_error_s / 3f64.sqrt()).hypot(unstated)
        };
        let known = synchronised && max_error_s < UNSYNCHRONISED_S;
        Self {
            synchronised: known,
            max_error_s: Some(max_error_s),
            estimated_error_s: Some(estimated_error_s),
            sigma_s: known.then_some(sigma),
        }
    }

    /// Returns the quality of a clock that is exact by definition.
    pub fn exact() -> Self {
        Self {
            synchronised: true,
            max_error_s: Some(0.0),
            estimated_error_s: Some(0.0),
            sigma_s: Some(0.0),
        }
    }

    /// Returns the quality if the kernel cannot be queried: only whether a service has set the clock.
    pub fn without_kernel_values(synchronised: bool) -> Self {
        Self {
            synchronised,
            ..Self::default()
        }
    }
}

/// Queries the kernel; `None` if it refuses (a sandbox without `adjtimex`).
#[allow(unsafe_code)]
pub(super) fn read_kernel_quality() -> Option<ClockQuality> {
    /// Unit of the kernel's errors: microseconds.
    const UNIT_S: f64 = 1e-6;
    // SAFETY: a plain structure of integers, for which all zeros is a valid value; `modes` 0 only reads.
    let (state, timex) = unsafe {
        let mut timex: libc::timex = std::mem::zeroed();
        (libc::adjtimex(&raw mut timex), timex)
    };
    let synchronised = state != libc::TIME_ERROR && timex.status & libc::STA_UNSYNC == 0;
    (state >= 0).then(|| {
        ClockQuality::from_kernel_values(
            synchronised,
            timex.maxerror as f64 * UNIT_S,
            timex.esterror as f64 * UNIT_S,
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_follows_the_errors_of_each_time_service() {
        // chrony sets both errors, phc2sys only the maximum (16 s remain as estimate), systemd-timesyncd
        // zeros that grow.
        let chrony = ClockQuality::from_kernel_values(true, 0.012, 0.0008);
        assert_eq!(chrony.sigma_s, Some(0.0008));
        let ptp = ClockQuality::from_kernel_values(true, 0.0005, 16.0);
        assert!((ptp.sigma_s.unwrap() - 0.000_289).abs() < 1e-6);
        let timesyncd = ClockQuality::from_kernel_values(true, 0.1, 0.0);
        assert!((timesyncd.sigma_s.unwrap() - (0.1 / 3f64.sqrt()).hypot(0.01)).abs() < 1e-12);
    }

    #[test]
    fn an_undisciplined_clock_has_no_sigma() {
        assert_eq!(
            ClockQuality::from_kernel_values(false, 0.01, 0.001).sigma_s,
            None
        );
        let lost = ClockQuality::from_kernel_values(true, 16.0, 16.0);
        assert!(!lost.synchronised && lost.sigma_s.is_none());
        assert_eq!(ClockQuality::without_kernel_values(true).sigma_s, None);
    }

    #[test]
    fn this_machine_answers_or_refuses() {
        if let Some(quality) = read_kernel_quality() {
            assert!(
                quality.max_error_s.unwrap() >= 0.0 && quality.estimated_error_s.unwrap() >= 0.0
            );
            assert_eq!(quality.synchronised, quality.sigma_s.is_some());
        }
    }
}
