//! Check of recorded times of exposure with images of a screen that shows the clock, and the camera's delay from them.

use super::stored_flights::frame_name;
use crate::camera::Format;
use crate::clock::exposure::{Exposure, ExposureSource};
use crate::measure::time_code::{self, DelayEstimate, ExposureTest, Screen, estimate_delay};
use crate::pipeline::guard::PANIC_REASON;
use crate::pipeline::stages;
use crate::record::Reason;
use crate::store::FrameRef;

/// Maximum difference between screen and recorder's clock, s: longer than a shot takes. A larger one means that the screen
/// does not show that clock.
const MAX_OFFSET_S: f64 = 60.0;

/// Reading of one image; times in s.
#[derive(Clone)]
pub struct ScreenReading {
    /// Series and file name.
    pub image: String,
    /// Middle of the exposure according to the screen, UTC.
    pub shown: jiff::Timestamp,
    /// Standard deviation of `shown`, without that of the latency.
    pub sigma_s: f64,
    /// Number of clock ticks during the exposure.
    pub ticks: u32,
    /// Command to the camera minus `shown`.
    pub command_s: f64,
    /// Recorded exposure minus `shown`.
    pub exposure_s: Option<f64>,
    /// Exposure as recorded.
    pub exposure: Option<Exposure>,
}

impl ScreenReading {
    /// Returns the delay from the recorded event (stamp, edge, trigger) to the middle of the exposure according to the
    /// screen.
    pub fn delay_s(&self) -> Option<f64> {
        Some(self.exposure.as_ref()?.exposure_delay_s? - self.exposure_s?)
    }

    /// Reads the screen in a frame.
    ///
    /// # Errors
    /// Returns the reason why the frame shows no readable clock, or another one than the recorder's.
    pub fn read(frame: &FrameRef, bytes: &[u8], screen: &Screen) -> Result<Self, Reason> {
        let name = frame_name(frame);
        let format = Format::from_manifest(&frame.entry.format).map_err(Reason::from_error)?;
        let (processed, raster) = stages::detect_only(&name, bytes, Some(&format));
        if let Some(reason) = processed.failure {
            return Err(reason);
        }
        let Some(raster) = raster else {
            return Err(PANIC_REASON.into());
        };
        let shown =
            time_code::read_time(&raster, &processed.detections).map_err(Reason::from_error)?;
        let recorded = frame
            .exposure
            .as_ref()
            .map_or(frame.stamp.utc, |exposure| exposure.exposure_time);
        let about_ms = 1e-6 * recorded.as_nanosecond() as f64;
        // Subtract first: as a float, milliseconds since 1970 have a resolution of only 0.25 µs.
        let later_s = 1e-3 * (time_code::nearest_time(&shown, about_ms) - about_ms)
            + screen.display_delay_s();
        if later_s.abs() > MAX_OFFSET_S {
            return Err(format!(
                "the screen differs from the recorder's clock by {later_s:+.0} s (or by multiples of 41.5 minutes more); show the recorder's own clock"
            )
            .into());
        }
        let apart = jiff::SignedDuration::try_from_secs_f64(later_s).unwrap_or_default();
        let less = |utc: jiff::Timestamp| utc.duration_since(recorded).as_secs_f64() - later_s;
        Ok(Self {
            image: name,
            shown: recorded.checked_add(apart).unwrap_or(recorded),
            sigma_s: screen.read_sigma_s(1e-3 * shown.width_ms),
            ticks: shown.ticks,
            command_s: less(frame.stamp.utc),
            exposure_s: frame
                .exposure
                .as_ref()
                .map(|exposure| less(exposure.exposure_time)),
            exposure: frame.exposure.clone(),
        })
    }
}

/// Minimum number of images for a delay.
const MIN_PICTURES: usize = 5;

/// Lines for the configuration.
#[derive(Debug)]
pub struct ConfigurationLines {
    pub text: String,
    /// Section of the configuration that they belong to.
    pub section: &'static str,
}

/// Reason why there are no lines for the configuration.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum NoConfiguration {
    #[error("the record has no times of exposure")]
    NoInstants,
    #[error("the times of exposure come from different sources; choose one --series")]
    SeveralSources,
    #[error("the camera reports no event at the exposure, so there is no delay to configure")]
    NoEvent,
    #[error(
        "the images were recorded without the delay that was configured then; record them again with this version"
    )]
    NoDelay,
    #[error("{0} images are too few; {MIN_PICTURES} are needed")]
    TooFew(usize),
}

/// Summary of all images.
pub struct TimeCheckSummary {
    pub pictures: usize,
    pub command: Option<DelayEstimate>,
    pub exposure: Option<ExposureTest>,
    pub delay: Option<DelayEstimate>,
    pub lines: Result<ConfigurationLines, NoConfiguration>,
}

impl TimeCheckSummary {
    /// Estimates the differences and the delay from the readings of `pictures` images.
    pub fn from_readings(readings: &[ScreenReading], pictures: usize, screen: &Screen) -> Self {
        let over = |of: &dyn Fn(&ScreenReading) -> Option<f64>| {
            let values: Vec<(f64, f64)> = readings
                .iter()
                .filter_map(|r| Some((of(r)?, r.sigma_s)))
                .collect();
            estimate_delay(&values, screen.systematic_s())
        };
        let found = over(&|r| r.delay_s());
        let recorded = readings.iter().filter_map(|r| r.exposure.as_ref());
        let recorded_s: Vec<f64> = recorded.map(|exposure| exposure.exposure_sigma_s).collect();
        Self {
            pictures,
            command: over(&|r| Some(r.command_s)),
            exposure: over(&|r| r.exposure_s)
                .map(|difference| ExposureTest::new(difference, &recorded_s)),
            delay: found,
            lines: configuration_lines(readings, found),
        }
    }
}

/// Formats the delay for the configuration.
fn configuration_lines(
    readings: &[ScreenReading],
    found: Option<DelayEstimate>,
) -> Result<ConfigurationLines, NoConfiguration> {
    let sources: Vec<ExposureSource> = readings
        .iter()
        .filter_map(|r| Some(r.exposure.as_ref()?.exposure_source))
        .collect();
    let Some(&source) = sources.first() else {
        return Err(NoConfiguration::NoInstants);
    };
    if sources.iter().any(|other| *other != source) {
        return Err(NoConfiguration::SeveralSources);
    }
    let (key, section) = match source {
        ExposureSource::StartOfExposure | ExposureSource::EndOfFrame => {
            ("stamp_delay", "the section with kind = \"v4l\"")
        }
        ExposureSource::ReleaseEdge | ExposureSource::TriggerAndEvent => (
            "exposure_delay",
            "[camera] with kind = \"release\" (a camera on USB alone has no such key)",
        ),
        ExposureSource::AskedAndDelivered | ExposureSource::CameraClock => {
            return Err(NoConfiguration::NoEvent);
        }
    };
    let found = found.ok_or(NoConfiguration::NoDelay)?;
    let sigma_s = found.sigma_s.filter(|_| found.images >= MIN_PICTURES);
    let sigma_s = sigma_s.ok_or(NoConfiguration::TooFew(found.images))?;
    let text = format!(
        "{key}_s = {:.4}\n{key}_sigma_s = {:.4}\n",
        found.mean_s, sigma_s
    );
    Ok(ConfigurationLines { text, section })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::exposure::{Exposure, ExposureInstant};
    use crate::clock::quality::ClockQuality;

    /// Readings whose record puts the exposure `late_s` later than the screen, with a configured delay of 0.02 s.
    fn readings(n: usize, source: ExposureSource, late_s: f64) -> Vec<ScreenReading> {
        let stamp = crate::clock::Stamp {
            utc: "2026-11-25T12:00:00Z".parse().unwrap(),
            utc_synchronised: true,
            boot_id: "boot".into(),
            since_boot_s: 100.0,
        };
        let instant = ExposureInstant {
            since_boot_s: 100.5,
            sigma_s: 0.005,
            delay_s: 0.02,
            source,
        };
        let exposure = Exposure::new(&instant, &stamp, ClockQuality::exact());
        let reading = |k: usize| {
            let late_s = late_s + if k.is_multiple_of(2) { 0.003 } else { -0.003 };
            ScreenReading {
                image: format!("{k}"),
                shown: exposure.exposure_time,
                sigma_s: 0.007,
                ticks: 1,
                command_s: late_s - 0.5,
                exposure_s: Some(late_s),
                exposure: Some(exposure.clone()),
            }
        };
        (0..n).map(reading).collect()
    }

    fn summary(n: usize, source: ExposureSource, late_s: f64) -> TimeCheckSummary {
        let screen = Screen {
            refresh_s: 1.0 / 60.0,
            latency_s: 0.03,
            latency_sigma_s: 0.0,
        };
        TimeCheckSummary::from_readings(&readings(n, source, late_s), n, &screen)
    }

    #[test]
    fn an_exposure_that_is_recorded_too_late_shortens_the_delay() {
        let found = summary(20, ExposureSource::EndOfFrame, 0.05);
        assert!(!found.exposure.as_ref().unwrap().agrees);
        let lines = found.lines.unwrap().text;
        assert!(
            lines.starts_with("stamp_delay_s = -0.0300\nstamp_delay_sigma_s = 0.00"),
            "{lines}"
        );
        let found = summary(20, ExposureSource::ReleaseEdge, 0.004);
        assert!(found.exposure.as_ref().unwrap().agrees);
        let lines = found.lines.unwrap().text;
        assert!(lines.starts_with("exposure_delay_s = 0.0160\n"), "{lines}");
    }

    #[test]
    fn no_lines_are_printed_if_nothing_can_be_configured() {
        assert!(
            summary(20, ExposureSource::AskedAndDelivered, 0.0)
                .lines
                .is_err()
        );
        assert!(
            summary(4, ExposureSource::EndOfFrame, 0.0)
                .lines
                .unwrap_err()
                .to_string()
                .contains("too few")
        );
        let mixed = [
            readings(5, ExposureSource::EndOfFrame, 0.0),
            readings(5, ExposureSource::ReleaseEdge, 0.0),
        ]
        .concat();
        assert!(configuration_lines(&mixed, None).unwrap_err() == NoConfiguration::SeveralSources);
    }
}
