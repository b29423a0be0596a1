//! The instant of exposure, its middle, from what a driver or a wire knows of it (docs/time.md). Pure: times since boot in,
//! time since boot with its standard deviation out.

use serde::{Deserialize, Serialize};

use super::Stamp;
use super::quality::ClockQuality;

/// A delay that somebody measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredDelay {
    /// From the event to the middle of the exposure, s; negative where the exposure comes first.
    pub seconds: f64,
    /// Its standard deviation, s.
    pub sigma_s: f64,
}

impl MeasuredDelay {
    /// From the two keys of a configuration: both, or none.
    pub fn from_config(seconds: Option<f64>, sigma_s: Option<f64>) -> Option<Self> {
        Some(Self { seconds: seconds?, sigma_s: sigma_s? })
    }
}

/// What a camera knows of when it exposed; times since boot, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ExposureEvidence {
    /// The driver stamped the buffer when the exposure began.
    StartOfExposure {
        /// The stamp.
        at_s: f64,
        /// Length of the exposure, s; `None` where it is not known.
        exposure_s: Option<f64>,
        /// From one frame to the next, s.
        period_s: f64,
        /// Measured, from stamp to middle.
        delay: Option<MeasuredDelay>,
    },
    /// The driver stamped the buffer when the last pixel came.
    EndOfFrame {
        /// The stamp.
        at_s: f64,
        /// Length of the exposure, s; `None` where it is not known.
        exposure_s: Option<f64>,
        /// From one frame to the next, s.
        period_s: f64,
        /// Measured, from stamp to middle.
        delay: Option<MeasuredDelay>,
    },
    /// The release's line was pulled between two moments.
    Edge {
        /// Before.
        from_s: f64,
        /// After.
        to_s: f64,
        /// Measured, from edge to middle.
        delay: MeasuredDelay,
    },
    /// The exposure lies between two moments.
    Between {
        /// The trigger.
        from_s: f64,
        /// The camera's word that there is a picture, or its delivery.
        to_s: f64,
    },
}

/// When a frame was exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureInstant {
    /// Middle of the exposure, since boot, s.
    pub since_boot_s: f64,
    /// Standard deviation against this machine's clock, s.
    pub sigma_s: f64,
    /// From the event that determines it, as it was taken to be, s.
    pub delay_s: f64,
    /// What determines it.
    pub source: ExposureSource,
}

/// What determines the instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExposureSource {
    /// A driver's stamp of the beginning.
    StartOfExposure,
    /// A driver's stamp of the end.
    EndOfFrame,
    /// The edge on the release's line and a measured delay.
    ReleaseEdge,
    /// Trigger and answer.
    TriggerAndEvent,
    /// Asking the camera and its delivery.
    AskedAndDelivered,
    /// The camera's own clock, as the picture says it.
    CameraClock,
}

impl ExposureSource {
    /// As in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::StartOfExposure => "start_of_exposure",
            Self::EndOfFrame => "end_of_frame",
            Self::ReleaseEdge => "release_edge",
            Self::TriggerAndEvent => "trigger_and_event",
            Self::AskedAndDelivered => "asked_and_delivered",
            Self::CameraClock => "camera_clock",
        }
    }
}

/// Standard deviation of what may lie anywhere in an interval of this length.
fn uniform_sigma(length: f64) -> f64 {
    length.abs() / 12f64.sqrt()
}

/// The middle of the exposure. What is not known counts as anywhere in its bounds: an exposure in a stream is no longer than
/// a period, nor is the time in which a frame is read out.
pub fn exposure_instant(evidence: &ExposureEvidence) -> ExposureInstant {
    let (event_s, delay_s, sigma_s, source) = match *evidence {
        ExposureEvidence::StartOfExposure { at_s, exposure_s, period_s, delay } => {
            let (half, sigma) = measured_or(delay, || half_exposure(exposure_s, period_s));
            (at_s, half, sigma, ExposureSource::StartOfExposure)
        }
        ExposureEvidence::EndOfFrame { at_s, exposure_s, period_s, delay } => {
            let (delay, sigma) = measured_or(delay, || {
                let (half, sigma) = half_exposure(exposure_s, period_s);
                (-half - 0.5 * period_s, sigma.hypot(uniform_sigma(period_s)))
            });
            (at_s, delay, sigma, ExposureSource::EndOfFrame)
        }
        ExposureEvidence::Edge { from_s, to_s, delay } => {
            let sigma = uniform_sigma(to_s - from_s).hypot(delay.sigma_s);
            (0.5 * (from_s + to_s), delay.seconds, sigma, ExposureSource::ReleaseEdge)
        }
        ExposureEvidence::Between { from_s, to_s } => {
            (from_s, 0.5 * (to_s - from_s), uniform_sigma(to_s - from_s), ExposureSource::TriggerAndEvent)
        }
    };
    ExposureInstant { since_boot_s: event_s + delay_s, sigma_s, delay_s, source }
}

/// From the event to a driver's stamp, where nobody has measured it, standard deviation, s: an assumption that covers
/// interrupts and USB's frames of 1 ms.
const STAMP_SIGMA_S: f64 = 0.001;

fn measured_or(delay: Option<MeasuredDelay>, otherwise: impl FnOnce() -> (f64, f64)) -> (f64, f64) {
    let unmeasured = || {
        let (seconds, sigma) = otherwise();
        (seconds, sigma.hypot(STAMP_SIGMA_S))
    };
    delay.map_or_else(unmeasured, |delay| (delay.seconds, delay.sigma_s))
}

/// Half of the exposure, s, with its standard deviation.
fn half_exposure(exposure_s: Option<f64>, period_s: f64) -> (f64, f64) {
    exposure_s.map_or((0.25 * period_s, uniform_sigma(0.5 * period_s)), |exposure| (0.5 * exposure, 0.0))
}

/// The instant of exposure as a shot keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Middle of the exposure, UTC as the machine believes it.
    pub exposure_time: jiff::Timestamp,
    /// The same, since boot, s.
    pub exposure_since_boot_s: f64,
    /// Standard deviation against this machine's clock, s.
    pub exposure_sigma_s: f64,
    /// What determines it.
    pub exposure_source: ExposureSource,
    /// From the event that the source names to `exposure_time`, as it was configured or assumed, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_delay_s: Option<f64>,
    /// Standard deviation of UTC itself, s; `null` where it is not synchronised, or nobody says.
    pub clock_sigma_s: Option<f64>,
    /// What the kernel says of its clock.
    pub clock: ClockQuality,
    /// The camera's own clock (EXIF, whole seconds, no zone) less the exposure's UTC, s; it is the same in every frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_clock_offset_s: Option<f64>,
}

impl Exposure {
    /// `stamp` tells UTC and time since boot of one moment near the exposure.
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

    /// Where the camera knows nothing: between asking and delivery.
    pub fn from_request(asked: &Stamp, delivered_since_boot_s: f64, clock: ClockQuality) -> Self {
        let between = ExposureEvidence::Between { from_s: asked.since_boot_s, to_s: delivered_since_boot_s };
        let instant = ExposureInstant { source: ExposureSource::AskedAndDelivered, ..exposure_instant(&between) };
        Self::new(&instant, asked, clock)
    }

    /// By the camera's own clock, which counts steps of `step_s` and cuts off what is below one: `stamp` tells the beginning
    /// of the step. `clock_sigma_s` is that clock's standard deviation against UTC, where somebody states it.
    pub fn from_camera_clock(stamp: &Stamp, step_s: f64, clock_sigma_s: Option<f64>) -> Self {
        let instant = ExposureInstant {
            since_boot_s: stamp.since_boot_s + 0.5 * step_s,
            sigma_s: uniform_sigma(step_s),
            delay_s: 0.0,
            source: ExposureSource::CameraClock,
        };
        let clock = ClockQuality { sigma_s: clock_sigma_s, ..ClockQuality::without_kernel_values(false) };
        Self { exposure_delay_s: None, ..Self::new(&instant, stamp, clock) }
    }

    /// Standard deviation of the exposure in UTC, s.
    pub fn utc_sigma_s(&self) -> Option<f64> {
        self.clock_sigma_s.map(|clock| clock.hypot(self.exposure_sigma_s))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn close(instant: &ExposureInstant, at_s: f64, sigma_s: f64) {
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(near(instant.since_boot_s, at_s) && near(instant.sigma_s, sigma_s), "{instant:?}");
    }

    #[test]
    fn a_stamp_at_the_start_is_half_an_exposure_early() {
        let stamp =
            |exposure_s, delay| ExposureEvidence::StartOfExposure { at_s: 100.0, exposure_s, period_s: 0.1, delay };
        close(&exposure_instant(&stamp(Some(0.004), None)), 100.002, STAMP_SIGMA_S);
        close(&exposure_instant(&stamp(None, None)), 100.025, (0.05 / 12f64.sqrt()).hypot(STAMP_SIGMA_S));
        let measured = Some(MeasuredDelay { seconds: 0.01, sigma_s: 0.001 });
        close(&exposure_instant(&stamp(Some(0.004), measured)), 100.01, 0.001);
    }

    #[test]
    fn a_stamp_at_the_end_is_late_by_an_unknown_readout() {
        let stamp =
            |exposure_s, delay| ExposureEvidence::EndOfFrame { at_s: 100.0, exposure_s, period_s: 0.1, delay };
        close(&exposure_instant(&stamp(Some(0.004), None)), 99.948, (0.1 / 12f64.sqrt()).hypot(STAMP_SIGMA_S));
        let measured = Some(MeasuredDelay { seconds: -0.035, sigma_s: 0.0005 });
        close(&exposure_instant(&stamp(None, measured)), 99.965, 0.0005);
    }

    #[test]
    fn an_edge_has_its_delay_and_a_trigger_its_interval() {
        let delay = MeasuredDelay { seconds: 0.055, sigma_s: 0.003 };
        close(&exposure_instant(&ExposureEvidence::Edge { from_s: 10.0, to_s: 10.0012, delay }), 10.0556, 0.003_019_933_774);
        close(&exposure_instant(&ExposureEvidence::Between { from_s: 10.0, to_s: 11.2 }), 10.6, 0.346_410_161_514);
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
        let instant =
            ExposureInstant { since_boot_s: 51.25, sigma_s: 0.004, delay_s: -0.05, source: ExposureSource::EndOfFrame };
        let exposure = Exposure::new(&instant, &stamp, clock);
        assert_eq!(exposure.exposure_time, "2026-03-01T06:00:01.25Z".parse().unwrap());
        assert!((exposure.utc_sigma_s().unwrap() - 0.005).abs() < 1e-12);
        let unknown = Exposure::new(&instant, &stamp, ClockQuality::without_kernel_values(false));
        assert_eq!(unknown.utc_sigma_s(), None);
        let asked = Exposure::from_request(&stamp, 52.0, clock);
        assert_eq!((asked.exposure_since_boot_s, asked.exposure_source), (51.0, ExposureSource::AskedAndDelivered));
        // What `wingd time-check` replaces, by what it measures.
        assert_eq!((exposure.exposure_delay_s, asked.exposure_delay_s), (Some(-0.05), Some(1.0)));
    }

    proptest! {
        /// Exposures drawn at random within what is assumed: the error over its sigma is 1 on average.
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
