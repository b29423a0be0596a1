//! Texts and JSON of `wingd time-check`: readings, summary, and lines for the configuration.

use serde_json::{Value, json};

use super::ScreenReading;
use crate::clock::exposure::ExposureSource;
use crate::measure::adjust::GlobalTest;
use crate::measure::estimation::quality::global_test;
use crate::measure::time_code::{DelayEstimate, Screen, estimate_delay};
use crate::record::Reason;
use crate::report::grid::Grid;
use crate::report::number::format_fixed;

/// Maximum mean difference between record and screen, in standard deviations, for them to agree.
const MAX_NORMALIZED: f64 = 3.0;
/// Significance level of the test of the scatter.
const SIGNIFICANCE: f64 = 0.001;
/// Minimum number of images for a delay.
const MIN_PICTURES: usize = 5;

/// Comparison of the recorded exposures with the screen.
struct ExposureTest {
    /// Recorded exposure minus screen.
    difference: DelayEstimate,
    /// Root mean square of the recorded standard deviations, s.
    recorded_s: f64,
    /// Mean difference divided by its standard deviation, including the recorded one.
    normalised: f64,
    agrees: bool,
}

/// Lines for the configuration.
#[derive(Debug)]
struct ConfigurationLines {
    text: String,
    /// Section of the configuration that they belong to.
    section: &'static str,
}

/// Reason why there are no lines for the configuration.
#[derive(Debug, PartialEq, thiserror::Error)]
enum NoConfiguration {
    #[error("the record has no times of exposure")]
    NoInstants,
    #[error("the times of exposure come from different sources; choose one --series")]
    SeveralSources,
    #[error("the camera reports no event at the exposure, so there is no delay to configure")]
    NoEvent,
    #[error("the images were recorded without the delay that was configured then; record them again with this version")]
    NoDelay,
    #[error("{0} images are too few; {MIN_PICTURES} are needed")]
    TooFew(usize),
}

/// Summary of all images.
pub(super) struct TimeCheckSummary {
    pictures: usize,
    command: Option<DelayEstimate>,
    exposure: Option<ExposureTest>,
    delay: Option<DelayEstimate>,
    lines: Result<ConfigurationLines, NoConfiguration>,
}

impl TimeCheckSummary {
    pub(super) fn from_readings(readings: &[ScreenReading], pictures: usize, screen: &Screen) -> Self {
        let over = |of: &dyn Fn(&ScreenReading) -> Option<f64>| {
            let values: Vec<(f64, f64)> = readings.iter().filter_map(|r| Some((of(r)?, r.sigma_s))).collect();
            estimate_delay(&values, screen.systematic_s())
        };
        let found = over(&|r| r.delay_s());
        Self {
            pictures,
            command: over(&|r| Some(r.command_s)),
            exposure: over(&|r| r.exposure_s).map(|found| test_exposures(found, readings)),
            delay: found,
            lines: configuration_lines(readings, found),
        }
    }

    pub(super) fn to_json(&self) -> Value {
        json!({ "summary": {
            "pictures": self.pictures,
            "read": self.command.map(|d| d.images),
            "command_less_shown": self.command.as_ref().map(delay_json),
            "exposure_less_shown": self.exposure.as_ref().map(|test| {
                let mut all = delay_json(&test.difference);
                all["stated_sigma_s"] = test.recorded_s.into();
                all["normalised"] = test.normalised.into();
                all["verdict"] = verdict_word(test).into();
                all
            }),
            "delay": self.delay.as_ref().map(delay_json),
            "configuration": self.lines.as_ref().ok().map(|lines| &lines.text),
            "reason": self.lines.as_ref().err().map(NoConfiguration::to_string),
        }})
    }

    pub(super) fn to_text(&self, readings: &[ScreenReading], screen: &Screen) -> String {
        let mut out = reading_table(readings).text();
        let ms = |seconds: f64| format!("{:.1}", 1e3 * seconds);
        let describe = |name: &str, d: &DelayEstimate| {
            let scatter = d.scatter_s.map_or("-".to_owned(), ms);
            format!(
                "{name}: mean {:+.1} ms, standard deviation {} ms; scatter {scatter} ms, of which {} ms from reading the clock\n",
                1e3 * d.mean_s,
                ms(d.mean_sigma_s),
                ms(d.read_sigma_s)
            )
        };
        out.push_str(&format!(
            "\n{} of {} images read; the standard deviation of each mean includes {} ms for the screen's latency, common to all images and not in the rows\n",
            readings.len(),
            self.pictures,
            ms(screen.latency_sigma_s)
        ));
        out.push_str(&self.command.as_ref().map_or(String::new(), |d| describe("command minus screen", d)));
        if let Some(test) = &self.exposure {
            out.push_str(&describe("exposure minus screen", &test.difference));
            out.push_str(&format!(
                "recorded standard deviation {} ms: {} ({:.1} standard deviations)\n",
                ms(test.recorded_s),
                verdict_word(test),
                test.normalised
            ));
        }
        out.push_str(
            &self.delay.as_ref().map_or(String::new(), |d| describe("delay from stamp or edge to exposure", d)),
        );
        match &self.lines {
            Ok(ConfigurationLines { text, section }) => out.push_str(&format!("\nFor {section}:\n{text}")),
            Err(reason) => out.push_str(&format!("\nNo delay to enter in the configuration: {reason}\n")),
        }
        out
    }
}

fn verdict_word(test: &ExposureTest) -> &'static str {
    if test.agrees { "agrees" } else { "disagrees" }
}

/// Tests the mean with its standard deviation, assuming the recorded one is common to all images, and the scatter with
/// both.
fn test_exposures(found: DelayEstimate, readings: &[ScreenReading]) -> ExposureTest {
    let recorded: Vec<f64> =
        readings.iter().filter_map(|r| Some(r.exposure.as_ref()?.exposure_sigma_s.powi(2))).collect();
    let recorded_variance = recorded.iter().sum::<f64>() / recorded.len().max(1) as f64;
    let normalised = found.mean_s.abs() / (found.mean_sigma_s.powi(2) + recorded_variance).sqrt();
    let freedom = found.images.saturating_sub(1);
    let scattered = found.scatter_s.is_some_and(|scatter_s| {
        let omega = freedom as f64 * scatter_s.powi(2) / (found.read_sigma_s.powi(2) + recorded_variance);
        global_test(omega, freedom, SIGNIFICANCE) == GlobalTest::Rejected
    });
    ExposureTest {
        difference: found,
        recorded_s: recorded_variance.sqrt(),
        normalised,
        agrees: normalised <= MAX_NORMALIZED && !scattered,
    }
}

/// Formats the delay for the configuration.
fn configuration_lines(
    readings: &[ScreenReading],
    found: Option<DelayEstimate>,
) -> Result<ConfigurationLines, NoConfiguration> {
    let sources: Vec<ExposureSource> =
        readings.iter().filter_map(|r| Some(r.exposure.as_ref()?.exposure_source)).collect();
    let Some(&source) = sources.first() else { return Err(NoConfiguration::NoInstants) };
    if sources.iter().any(|other| *other != source) {
        return Err(NoConfiguration::SeveralSources);
    }
    let (key, section) = match source {
        ExposureSource::StartOfExposure | ExposureSource::EndOfFrame => {
            ("stamp_delay", "the section with kind = \"v4l\"")
        }
        ExposureSource::ReleaseEdge | ExposureSource::TriggerAndEvent => {
            ("exposure_delay", "[camera] with kind = \"release\" (a camera on USB alone has no such key)")
        }
        ExposureSource::AskedAndDelivered | ExposureSource::CameraClock => {
            return Err(NoConfiguration::NoEvent);
        }
    };
    let found = found.ok_or(NoConfiguration::NoDelay)?;
    let sigma_s = found.sigma_s.filter(|_| found.images >= MIN_PICTURES);
    let sigma_s = sigma_s.ok_or(NoConfiguration::TooFew(found.images))?;
    let text = format!("{key}_s = {:.4}\n{key}_sigma_s = {:.4}\n", found.mean_s, sigma_s);
    Ok(ConfigurationLines { text, section })
}

fn delay_json(d: &DelayEstimate) -> Value {
    json!({
        "pictures": d.images, "mean_s": d.mean_s, "sigma_mean_s": d.mean_sigma_s, "scatter_s": d.scatter_s,
        "reading_sigma_s": d.read_sigma_s, "sigma_s": d.sigma_s,
    })
}

fn reading_table(readings: &[ScreenReading]) -> Grid {
    let ms = |seconds: Option<f64>| format_fixed(seconds.map(|s| 1e3 * s), 1);
    let recorded = |r: &ScreenReading| r.exposure.as_ref().map(|e| e.exposure_sigma_s.hypot(r.sigma_s));
    Grid::for_rows(readings).columns(&[
        ("<image", &|r| r.image.clone()),
        ("<exposure on the screen (UTC)", &|r| r.shown.strftime("%m-%d %H:%M:%S%.3f").to_string()),
        ("sigma / ms", &|r| ms(Some(r.sigma_s))),
        ("ticks", &|r| r.ticks.to_string()),
        ("command minus screen / ms", &|r| ms(Some(r.command_s))),
        ("exposure minus screen / ms", &|r| ms(r.exposure_s)),
        ("sigma / ms", &|r| ms(recorded(r))),
    ])
}

/// Returns the JSON of an image; its standard deviations include the screen's latency.
pub(super) fn json_line(read: &Result<ScreenReading, (String, Reason)>, screen: &Screen) -> Value {
    match read {
        Err((image, reason)) => json!({ "image": image, "status": "failed", "reason": reason.text() }),
        Ok(r) => {
            let sigma_s = r.sigma_s.hypot(screen.latency_sigma_s);
            let recorded_s = r.exposure.as_ref().map(|e| e.exposure_sigma_s);
            json!({
                "image": r.image, "status": "ok", "shown_time": r.shown, "sigma_shown_s": sigma_s, "ticks": r.ticks,
                "command_less_shown_s": r.command_s, "sigma_command_less_shown_s": sigma_s,
                "exposure_less_shown_s": r.exposure_s,
                "sigma_exposure_less_shown_s": recorded_s.map(|recorded| recorded.hypot(sigma_s)),
                "exposure_sigma_s": recorded_s,
                "exposure_source": r.exposure.as_ref().map(|e| e.exposure_source.name()),
                "delay_s": r.delay_s(),
            })
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
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
        let instant = ExposureInstant { since_boot_s: 100.5, sigma_s: 0.005, delay_s: 0.02, source };
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
        let screen = Screen { refresh_s: 1.0 / 60.0, latency_s: 0.03, latency_sigma_s: 0.0 };
        TimeCheckSummary::from_readings(&readings(n, source, late_s), n, &screen)
    }

    #[test]
    fn an_exposure_that_is_recorded_too_late_shortens_the_delay() {
        let found = summary(20, ExposureSource::EndOfFrame, 0.05);
        assert!(!found.exposure.as_ref().unwrap().agrees);
        let lines = found.lines.unwrap().text;
        assert!(lines.starts_with("stamp_delay_s = -0.0300\nstamp_delay_sigma_s = 0.00"), "{lines}");
        let found = summary(20, ExposureSource::ReleaseEdge, 0.004);
        assert!(found.exposure.as_ref().unwrap().agrees);
        let lines = found.lines.unwrap().text;
        assert!(lines.starts_with("exposure_delay_s = 0.0160\n"), "{lines}");
    }

    #[test]
    fn no_lines_are_printed_if_nothing_can_be_configured() {
        assert!(summary(20, ExposureSource::AskedAndDelivered, 0.0).lines.is_err());
        assert!(summary(4, ExposureSource::EndOfFrame, 0.0).lines.unwrap_err().to_string().contains("too few"));
        let mixed =
            [readings(5, ExposureSource::EndOfFrame, 0.0), readings(5, ExposureSource::ReleaseEdge, 0.0)].concat();
        assert!(configuration_lines(&mixed, None).unwrap_err() == NoConfiguration::SeveralSources);
    }
}
