//! Instant of exposure (its middle) from the time stamps of a driver or a release line (docs/time.md). Pure: times since
//! boot in, time since boot with its standard deviation out.

use serde::{Deserialize, Serialize};

use super::Stamp;
use super::quality::ClockQuality;

/// Measured delay from an event to the exposure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredDelay {
    /// Delay from the event to the middle of the exposure, s; negative if the exposure comes first.
    pub seconds: f64,
    pub sigma_s: f64,
}

impl MeasuredDelay {
    /// Builds the delay from the two keys of a configuration; `None` unless both are given.
    pub fn from_config(seconds: Option<f64>, sigma_s: Option<f64>) -> Option<Self> {
        Some(Self {
            seconds: seconds?,
            sigma_s: sigma_s?,
        })
    }
}

/// Evidence for the time of exposure; times since boot, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ExposureEvidence {
    /// Driver stamp of the buffer at the begin of the exposure.
    StartOfExposure {
        /// Time of the stamp, s.
        at_s: f64,
        /// Length of the exposure, s; `None` if it is not known.
        exposure_s: Option<f64>,
        /// Frame period, s.
        period_s: f64,
        /// Measured delay from stamp to middle.
        delay: Option<MeasuredDelay>,
    },
    /// Driver stamp of the buffer at the last pixel.
    EndOfFrame {
        /// Time of the stamp, s.
        at_s: f64,
        /// Length of the exposure, s; `None` if it is not known.
        exposure_s: Option<f64>,
        /// Frame period, s.
        period_s: f64,
        /// Measured delay from stamp to middle.
        delay: Option<MeasuredDelay>,
    },
    /// Edge on the release line between two times.
    Edge {
        /// Time before the edge, s.
        from_s: f64,
        /// Time after the edge, s.
        to_s: f64,
        /// Measured delay from edge to middle.
        delay: MeasuredDelay,
    },
    /// Exposure between two times.
    Between {
        /// Time of the trigger, s.
        from_s: f64,
        /// Time of the camera's image event, or of the delivery, s.
        to_s: f64,
    },
}

/// Instant of a frame's exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureInstant {
    /// Middle of the exposure, since boot, s.
    pub since_boot_s: f64,
    /// Standard deviation against this machine's clock, s.
    pub sigma_s: f64,
    /// Delay from the event that determines the instant, as configured or assumed, s.
    pub delay_s: f64,
    pub source: ExposureSource,
}

/// Event that determines the instant of exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExposureSource {
    /// Driver's stamp of the begin.
    StartOfExposure,
    /// Driver's stamp of the end.
    EndOfFrame,
    /// Edge on the release line and a measured delay.
    ReleaseEdge,
    /// Trigger and image event.
    TriggerAndEvent,
    /// Request to the camera and delivery.
    AskedAndDelivered,
    /// Camera's own clock, from the image's metadata.
    CameraClock,
}

impl ExposureSource {
    /// All sources.
    pub const ALL: [Self; 6] = [
        Self::StartOfExposure,
        Self::EndOfFrame,
        Self::ReleaseEdge,
        Self::TriggerAndEvent,
        Self::AskedAndDelivered,
        Self::CameraClock,
    ];
}

/// Returns the standard deviation of a uniform distribution over an interval of this length.
fn uniform_sigma(length: f64) -> f64 {
    length.abs() / 12f64.sqrt()
}

/// Estimates the middle of the exposure. An unknown quantity is uniform within its bounds: in a stream neither the exposure
/// nor the readout of a frame is longer than a period.
pub fn exposure_instant(evidence: &ExposureEvidence) -> ExposureInstant {
    let (event_s, delay_s, sigma_s, source) = match *evidence {
        ExposureEvidence::StartOfExposure {
            at_s,
            exposure_s,
            period_s,
            delay,
        } => {
            let (half, sigma) = measured_delay_or(delay, || half_exposure(exposure_s, period_s));
            (at_s, half, sigma, ExposureSource::StartOfExposure)
        }
        ExposureEvidence::EndOfFrame {
            at_s,
            exposure_s,
            period_s,
            delay,
        } => {
            let (delay, sigma) = measured_delay_or(delay, || {
                let (half, sigma) = half_exposure(exposure_s, period_s);
                (-half - 0.5 * period_s, sigma.hypot(uniform_sigma(period_s)))
            });
            (at_s, delay, sigma, ExposureSource::EndOfFrame)
        }
        ExposureEvidence::Edge {
            from_s,
            to_s,
            delay,
        } => {
            let sigma = uniform_sigma(to_s - from_s).hypot(delay.sigma_s);
            (
                0.5 * (from_s + to_s),
                delay.seconds,
                sigma,
                ExposureSource::ReleaseEdge,
            )
        }
        ExposureEvidence::Between { from_s, to_s } => (
            from_s,
            0.5 * (to_s - from_s),
            uniform_sigma(to_s - from_s),
            ExposureSource::TriggerAndEvent,
        ),
    };
    ExposureInstant {
        since_boot_s: event_s + delay_s,
        sigma_s,
        delay_s,
        source,
    }
}

/// Standard deviation of the time from the event to a driver's stamp if it was not measured, s: an assumption that covers
/// interrupts and USB's frames of 1 ms.
const STAMP_SIGMA_S: f64 = 0.001;

fn measured_delay_or(
    delay: Option<MeasuredDelay>,
    otherwise: impl FnOnce() -> (f64, f64),
) -> (f64, f64) {
    let unmeasured = || {
        let (seconds, sigma) = otherwise();
        (seconds, sigma.hypot(STAMP_SIGMA_S))
    };
    delay.map_or_else(unmeasured, |delay| (delay.seconds, delay.sigma_s))
}

/// Returns half of the exposure, s, with its standard deviation.
fn half_exposure(exposure_s: Option<f64>, period_s: f64) -> (f64, f64) {
    exposure_s.map_or(
        (0.25 * period_s, uniform_sigma(0.5 * period_s)),
        |exposure| (0.5 * exposure, 0.0),
    )
}

/// Instant of exposure as stored with a shot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Middle of the exposure, UTC of this machine.
    pub exposure_time: jiff::Timestamp,
    /// Middle of the exposure, since boot, s.
    pub exposure_since_boot_s: f64,
    /// Standard deviation against this machine's clock, s.
    pub exposure_sigma_s: f64,
    pub exposure_source: ExposureSource,
    /// Delay from the event named by the source to `exposure_time`, as configured or assumed, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_delay_s: Option<f64>,
    /// Standard deviation of UTC itself, s; `null` if it is not synchronised or unknown.
    pub clock_sigma_s: Option<f64>,
    /// Quality of the clock reported by the kernel.
    pub clock: ClockQuality,
    /// Camera's own clock (EXIF, whole seconds, no zone) less the exposure's UTC, s; constant over the frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_clock_offset_s: Option<f64>,
}

impl Exposure {
    /// Converts an instant of exposure to UTC. `stamp` gives UTC and time since boot of one moment near it.
    pub fn new(instant: &ExposureInstant, stamp: &Stamp, clock: ClockQuality) -> Self {
        let since_s = instant.since_boot_s - stamp.since_boot_s;
        let apart = jiff::SignedDuration::try_from_secs_f64(since_s).unwrap_or_default();
        Self {
            exposure_time: stamp.utc.checked_add(apart).unwrap_or(stamp.utc),
            exposure_since_boot_s: instant.since_boot_s,
            exposure_sigma_s: instant.sigma_s,
            exposure_source: instant.source,
            exposure_delay_s: Some(instant.delay_s),
            clock_sigma_s: clock.sigma_s,
            clock,
            camera_clock_offset_s: None,
        }
    }

    /// Builds the exposure without evidence from the camera: between request and delivery.
    pub fn from_request(asked: &Stamp, delivered_since_boot_s: f64, clock: ClockQuality) -> Self {
        let between = ExposureEvidence::Between {
            from_s: asked.since_boot_s,
            to_s: delivered_since_boot_s,
        };
        let instant = ExposureInstant {
            source: ExposureSource::AskedAndDelivered,
            ..exposure_instant(&between)
        };
        Self::new(&instant, asked, clock)
    }

    /// Builds the exposure from the camera's own clock, which counts steps of `step_s` and truncates: `stamp` is the begin
    /// of the step. `clock_sigma_s` is that clock's standard deviation against UTC, if given.
    pub fn from_camera_clock(stamp: &Stamp, step_s: f64, clock_sigma_s: Option<f64>) -> Self {
        let instant = ExposureInstant {
            since_boot_s: stamp.since_boot_s + 0.5 * step_s,
            sigma_s: uniform_sigma(step_s),
            delay_s: 0.0,
            source: ExposureSource::CameraClock,
        };
        let clock = ClockQuality {
            sigma_s: clock_sigma_s,
            ..ClockQuality::without_kernel_values(false)
        };
        Self {
            exposure_delay_s: None,
            ..Self::new(&instant, stamp, clock)
        }
    }

    /// Returns the standard deviation of the exposure in UTC, s.
    pub fn utc_sigma_s(&self) -> Option<f64> {
        self.clock_sigma_s
            .map(|clock| clock.hypot(self.exposure_sigma_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn close(instant: &ExposureInstant, at_s: f64, sigma_s: f64) {
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(
            near(instant.since_boot_s, at_s) && near(instant.sigma_s, sigma_s),
            "{instant:?}"
        );
    }

    #[test]
    fn a_stamp_at_the_start_is_half_an_exposure_early() {
        let stamp = |exposure_s, delay| ExposureEvidence::StartOfExposure {
            at_s: 100.0,
            exposure_s,
            period_s: 0.1,
            delay,
        };
        close(
            &exposure_instant(&stamp(Some(0.004), None)),
            100.002,
            STAMP_SIGMA_S,
        );
        close(
            &exposure_instant(&stamp(None, None)),
            100.025,
            (0.05 / 12f64.sqrt()).hypot(STAMP_SIGMA_S),
        );
        let measured = Some(MeasuredDelay {
            seconds: 0.01,
            sigma_s: 0.001,
        });
        close(
            &exposure_instant(&stamp(Some(0.004), measured)),
            100.01,
            0.001,
        );
    }

    #[test]
    fn a_stamp_at_the_end_is_late_by_an_unknown_readout() {
        let stamp = |exposure_s, delay| ExposureEvidence::EndOfFrame {
            at_s: 100.0,
            exposure_s,
            period_s: 0.1,
            delay,
        };
        close(
            &exposure_instant(&stamp(Some(0.004), None)),
            99.948,
            (0.1 / 12f64.sqrt()).hypot(STAMP_SIGMA_S),
        );
        let measured = Some(MeasuredDelay {
            seconds: -0.035,
            sigma_s: 0.0005,
        });
        close(&exposure_instant(&stamp(None, measured)), 99.965, 0.0005);
    }

    #[test]
    fn an_edge_has_its_delay_and_a_trigger_its_interval() {
        let delay = MeasuredDelay {
            seconds: 0.055,
            sigma_s: 0.003,
        };
        close(
            &exposure_instant(&ExposureEvidence::Edge {
                from_s: 10.0,
                to_s: 10.0012,
                delay,
            }),
            10.0556,
            0.003_019_933_774,
        );
        close(
            &exposure_instant(&ExposureEvidence::Between {
                from_s: 10.0,
                to_s: 11.2,
            }),
            10.6,
            0.346_410_161_514,
        );
    }

    #[test]
    fn utc_follows_from_a_stamp_and_its_sigma_from_both() {
        let stamp = Stamp {
            utc: "2026-03-01T06:00:00Z".parse().unwrap(),
            utc_synchronised: true,
            boot_id: "b".into(),
            since_boot_s: 50.0,
        };
        let clock = ClockQuality::from_kernel_values(true, 0.01, 0.003);
        let instant = ExposureInstant {
            since_boot_s: 51.25,
            sigma_s: 0.004,
            delay_s: -0.05,
            source: ExposureSource::EndOfFrame,
        };
        let exposure = Exposure::new(&instant, &stamp, clock);
        assert_eq!(
            exposure.exposure_time,
            "2026-03-01T06:00:01.25Z".parse().unwrap()
        );
        assert!((exposure.utc_sigma_s().unwrap() - 0.005).abs() < 1e-12);
        let unknown = Exposure::new(&instant, &stamp, ClockQuality::without_kernel_values(false));
        assert_eq!(unknown.utc_sigma_s(), None);
        let asked = Exposure::from_request(&stamp, 52.0, clock);
        assert_eq!(
            (asked.exposure_since_boot_s, asked.exposure_source),
            (51.0, ExposureSource::AskedAndDelivered)
        );
        // Delays that `wingd time-check` replaces by measured ones.
        assert_eq!(
            (exposure.exposure_delay_s, asked.exposure_delay_s),
            (Some(-0.05), Some(1.0))
        );
    }

    proptest! {
        /// Samples exposures uniformly within the assumed bounds, which must contain the truth.
        #[test]
        fn the_truth_lies_within_the_bounds(
            begin in 0.0..1.0f64, exposure in 0.0..1.0f64, readout in 0.0..1.0f64, period in 0.01..0.5f64,
        ) {
            let (exposure, readout) = (exposure * period, readout * period);
            let middle = begin + 0.5 * exposure;
            let within = |found: ExposureInstant| (found.since_boot_s - middle).abs() <= 3f64.sqrt() * 2f64.sqrt() * found.sigma_s + 1e-12;
            let (period_s, delay) = (period, None);
            let end = begin + exposure + readout;
            for exposure_s in [None, Some(exposure)] {
                let start = ExposureEvidence::StartOfExposure { at_s: begin, exposure_s, period_s, delay };
                let stop = ExposureEvidence::EndOfFrame { at_s: end, exposure_s, period_s, delay };
                prop_assert!(within(exposure_instant(&start)));
                prop_assert!(within(exposure_instant(&stop)));
            }
        }
    }
}
