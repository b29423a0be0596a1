//! How far the kernel's UTC may be trusted: what the program that disciplines the clock stated to the kernel (`adjtimex`).
//! It is the same whether that is chrony or another NTP client, `phc2sys` behind PTP, or a receiver's pulses.

use serde::{Deserialize, Serialize};

/// At or above this the kernel takes its clock for unsynchronised, s (`NTP_PHASE_LIMIT`, 16 s).
const UNSYNCHRONISED_S: f64 = 16.0;
/// Standard deviation of a clock whose service states no error at all, s: an assumption for NTP over a network.
/// (systemd-timesyncd writes 0 for both errors.)
const UNSTATED_SIGMA_S: f64 = 0.01;

/// What the kernel says of its clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockQuality {
    /// Whether something disciplines it.
    pub synchronised: bool,
    /// Largest error, s; grows by 500 ppm from one correction to the next. `null` where the kernel may not be asked.
    pub max_error_s: Option<f64>,
    /// Estimated error, s.
    pub estimated_error_s: Option<f64>,
    /// Standard deviation of UTC that follows, s; `null` where nothing is known of it.
    pub sigma_s: Option<f64>,
}

impl ClockQuality {
    /// From the kernel's own figures. An estimated error above the largest is what the kernel began with and nobody has
    /// set (`phc2sys` sets the largest alone): then any error up to the largest is as likely as another.
    pub fn from_kernel_values(synchronised: bool, max_error_s: f64, estimated_error_s: f64) -> Self {
        let sigma = if estimated_error_s > 0.0 && estimated_error_s <= max_error_s {
            estimated_error_s
        } else {
            let unstated = if estimated_error_s > 0.0 { 0.0 } else { UNSTATED_SIGMA_S };
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

    /// Of a clock that is right by definition.
    pub fn exact() -> Self {
        Self { synchronised: true, max_error_s: Some(0.0), estimated_error_s: Some(0.0), sigma_s: Some(0.0) }
    }

    /// Where the kernel may not be asked: only whether a service has set the clock.
    pub fn without_kernel_values(synchronised: bool) -> Self {
        Self { synchronised, ..Self::default() }
    }
}

/// Asks the kernel; `None` where it refuses (a sandbox without `adjtimex`).
#[allow(unsafe_code)]
pub(super) fn read_kernel_quality() -> Option<ClockQuality> {
    /// Microseconds.
    const UNIT_S: f64 = 1e-6;
    // SAFETY: a plain structure of integers, of which all zeros is a value; `modes` 0 only reads.
    let (state, timex) = unsafe {
        let mut timex: libc::timex = std::mem::zeroed();
        (libc::adjtimex(&raw mut timex), timex)
    };
    let synchronised = state != libc::TIME_ERROR && timex.status & libc::STA_UNSYNC == 0;
    (state >= 0).then(|| {
        ClockQuality::from_kernel_values(synchronised, timex.maxerror as f64 * UNIT_S, timex.esterror as f64 * UNIT_S)
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn each_service_gets_what_it_states() {
        // chrony: both errors. phc2sys: the largest alone, over the kernel's 16 s. systemd-timesyncd: zeros that grow.
        let chrony = ClockQuality::from_kernel_values(true, 0.012, 0.0008);
        assert_eq!(chrony.sigma_s, Some(0.0008));
        let ptp = ClockQuality::from_kernel_values(true, 0.0005, 16.0);
        assert!((ptp.sigma_s.unwrap() - 0.000_289).abs() < 1e-6);
        let timesyncd = ClockQuality::from_kernel_values(true, 0.1, 0.0);
        assert!((timesyncd.sigma_s.unwrap() - (0.1 / 3f64.sqrt()).hypot(0.01)).abs() < 1e-12);
    }

    #[test]
    fn a_clock_that_nobody_disciplines_has_no_sigma() {
        assert_eq!(ClockQuality::from_kernel_values(false, 0.01, 0.001).sigma_s, None);
        let lost = ClockQuality::from_kernel_values(true, 16.0, 16.0);
        assert!(!lost.synchronised && lost.sigma_s.is_none());
        assert_eq!(ClockQuality::without_kernel_values(true).sigma_s, None);
    }

    #[test]
    fn this_machine_answers_or_refuses() {
        if let Some(quality) = read_kernel_quality() {
            assert!(quality.max_error_s.unwrap() >= 0.0 && quality.estimated_error_s.unwrap() >= 0.0);
            assert_eq!(quality.synchronised, quality.sigma_s.is_some());
        }
    }
}
