//! This file composes what `wingd time-check` says of a picture and of them all, and the lines for the configuration.

use serde_json::{Value, json};

use super::Reading;
use crate::clock::exposure::Source;
use crate::measure::adjust::GlobalTest;
use crate::measure::estimation::quality::global_test;
use crate::measure::time_code::{Delay, Screen, delay};
use crate::record::Reason;
use crate::report::grid::Grid;
use crate::report::number::fixed;

/// The record's exposures agree with the screen within so many standard deviations of the mean.
const AGREES: f64 = 3.0;
/// And where their scatter would be exceeded by chance with this probability.
const BY_CHANCE: f64 = 0.001;
/// A delay from fewer pictures is not worth writing down.
const MIN_PICTURES: usize = 5;

/// The record's exposures against the screen.
struct Test {
    /// Exposure less screen.
    found: Delay,
    /// Root mean square of the standard deviations in the record, s.
    stated_s: f64,
    /// The mean over its standard deviation, the stated one included.
    normalised: f64,
    agrees: bool,
}

/// What to write into the configuration.
#[derive(Debug)]
struct Lines {
    text: String,
    /// Where they belong.
    section: &'static str,
}

/// Why there is nothing to write there.
#[derive(Debug, PartialEq, thiserror::Error)]
enum NoLines {
    #[error("the record has no instants of exposure")]
    NoInstants,
    #[error("the pictures' exposures are told by different sources; choose one --series")]
    SeveralSources,
    #[error("the camera tells nothing of its exposure, so that there is no delay to configure")]
    NoEvent,
    #[error("the record does not keep the delay that was assumed; take the pictures anew")]
    NoDelay,
    #[error("{0} pictures are too few, {MIN_PICTURES} are needed")]
    TooFew(usize),
}

/// All pictures together.
pub(super) struct Summary {
    pictures: usize,
    command: Option<Delay>,
    exposure: Option<Test>,
    delay: Option<Delay>,
    lines: Result<Lines, NoLines>,
}

impl Summary {
    pub(super) fn of(readings: &[Reading], pictures: usize, screen: &Screen) -> Self {
        let over = |of: &dyn Fn(&Reading) -> Option<f64>| {
            let values: Vec<(f64, f64)> = readings.iter().filter_map(|r| Some((of(r)?, r.sigma_s))).collect();
            delay(&values, screen.systematic_s())
        };
        let found = over(&|r| r.delay_s());
        Self {
            pictures,
            command: over(&|r| Some(r.command_s)),
            exposure: over(&|r| r.exposure_s).map(|found| test(found, readings)),
            delay: found,
            lines: lines(readings, found),
        }
    }

    pub(super) fn json(&self) -> Value {
        json!({ "summary": {
            "pictures": self.pictures,
            "read": self.command.map(|d| d.pictures),
            "command_less_shown": self.command.as_ref().map(statistics),
            "exposure_less_shown": self.exposure.as_ref().map(|test| {
                let mut all = statistics(&test.found);
                all["stated_sigma_s"] = test.stated_s.into();
                all["normalised"] = test.normalised.into();
                all["verdict"] = verdict(test).into();
                all
            }),
            "delay": self.delay.as_ref().map(statistics),
            "configuration": self.lines.as_ref().ok().map(|lines| &lines.text),
            "reason": self.lines.as_ref().err().map(NoLines::to_string),
        }})
    }

    pub(super) fn text(&self, readings: &[Reading], screen: &Screen) -> String {
        let mut out = table(readings).text();
        let ms = |seconds: f64| format!("{:.1}", 1e3 * seconds);
        let said = |name: &str, d: &Delay| {
            let scatter = d.scatter_s.map_or("-".to_owned(), ms);
            format!(
                "{name}: {:+.1} ms in the mean, standard deviation {} ms; scatter {scatter} ms, of which reading makes {} ms\n",
                1e3 * d.mean_s,
                ms(d.mean_sigma_s),
                ms(d.read_sigma_s)
            )
        };
        out.push_str(&format!(
            "\n{} of {} pictures read; {} ms of each standard deviation of a mean are the screen's latency, the same in all; the rows leave it out\n",
            readings.len(),
            self.pictures,
            ms(screen.latency_sigma_s)
        ));
        out.push_str(&self.command.as_ref().map_or(String::new(), |d| said("command less screen", d)));
        if let Some(test) = &self.exposure {
            out.push_str(&said("exposure less screen", &test.found));
            out.push_str(&format!(
                "the record states {} ms: {} ({:.1} standard deviations)\n",
                ms(test.stated_s),
                verdict(test),
                test.normalised
            ));
        }
        out.push_str(
            &self.delay.as_ref().map_or(String::new(), |d| said("from stamp or edge to exposure", d)),
        );
        match &self.lines {
            Ok(Lines { text, section }) => out.push_str(&format!("\nFor {section}:\n{text}")),
            Err(reason) => out.push_str(&format!("\nNo lines for the configuration: {reason}\n")),
        }
        out
    }
}

fn verdict(test: &Test) -> &'static str {
    if test.agrees { "agrees" } else { "disagrees" }
}

/// The mean against its standard deviation, the stated one taken as the same in every picture; the scatter against both.
fn test(found: Delay, readings: &[Reading]) -> Test {
    let stated: Vec<f64> =
        readings.iter().filter_map(|r| Some(r.exposure.as_ref()?.exposure_sigma_s.powi(2))).collect();
    let stated2 = stated.iter().sum::<f64>() / stated.len().max(1) as f64;
    let normalised = found.mean_s.abs() / (found.mean_sigma_s.powi(2) + stated2).sqrt();
    let freedom = found.pictures.saturating_sub(1);
    let scattered = found.scatter_s.is_some_and(|scatter_s| {
        let omega = freedom as f64 * scatter_s.powi(2) / (found.read_sigma_s.powi(2) + stated2);
        global_test(omega, freedom, BY_CHANCE) == GlobalTest::Rejected
    });
    Test { found, stated_s: stated2.sqrt(), normalised, agrees: normalised <= AGREES && !scattered }
}

/// The delay as the configuration takes it.
fn lines(readings: &[Reading], found: Option<Delay>) -> Result<Lines, NoLines> {
    let sources: Vec<Source> =
        readings.iter().filter_map(|r| Some(r.exposure.as_ref()?.exposure_source)).collect();
    let Some(&source) = sources.first() else { return Err(NoLines::NoInstants) };
    if sources.iter().any(|other| *other != source) {
        return Err(NoLines::SeveralSources);
    }
    let (key, section) = match source {
        Source::StartOfExposure | Source::EndOfFrame => ("stamp_delay", "the section with kind = \"v4l\""),
        Source::ReleaseEdge | Source::TriggerAndEvent => {
            ("exposure_delay", "[camera] with kind = \"release\" (a camera on USB alone has no such key)")
        }
        Source::AskedAndDelivered | Source::CameraClock => return Err(NoLines::NoEvent),
    };
    let found = found.ok_or(NoLines::NoDelay)?;
    let sigma_s = found.sigma_s.filter(|_| found.pictures >= MIN_PICTURES);
    let sigma_s = sigma_s.ok_or(NoLines::TooFew(found.pictures))?;
    let text = format!("{key}_s = {:.4}\n{key}_sigma_s = {:.4}\n", found.mean_s, sigma_s);
    Ok(Lines { text, section })
}

fn statistics(d: &Delay) -> Value {
    json!({
        "pictures": d.pictures, "mean_s": d.mean_s, "sigma_mean_s": d.mean_sigma_s, "scatter_s": d.scatter_s,
        "reading_sigma_s": d.read_sigma_s, "sigma_s": d.sigma_s,
    })
}

fn table(readings: &[Reading]) -> Grid {
    let ms = |seconds: Option<f64>| fixed(seconds.map(|s| 1e3 * s), 1);
    let stated = |r: &Reading| r.exposure.as_ref().map(|e| e.exposure_sigma_s.hypot(r.sigma_s));
    Grid::each(readings).columns(&[
        ("<picture", &|r| r.image.clone()),
        ("<exposure by the screen (UTC)", &|r| r.shown.strftime("%m-%d %H:%M:%S%.3f").to_string()),
        ("sigma / ms", &|r| ms(Some(r.sigma_s))),
        ("ticks", &|r| r.ticks.to_string()),
        ("command less screen / ms", &|r| ms(Some(r.command_s))),
        ("exposure less screen / ms", &|r| ms(r.exposure_s)),
        ("sigma / ms", &|r| ms(stated(r))),
    ])
}

/// A picture's line; every standard deviation with the screen's latency.
pub(super) fn json_line(read: &Result<Reading, (String, Reason)>, screen: &Screen) -> Value {
    match read {
        Err((image, reason)) => json!({ "image": image, "status": "failed", "reason": reason.text() }),
        Ok(r) => {
            let sigma_s = r.sigma_s.hypot(screen.latency_sigma_s);
            let stated_s = r.exposure.as_ref().map(|e| e.exposure_sigma_s);
            json!({
                "image": r.image, "status": "ok", "shown_time": r.shown, "sigma_shown_s": sigma_s, "ticks": r.ticks,
                "command_less_shown_s": r.command_s, "sigma_command_less_shown_s": sigma_s,
                "exposure_less_shown_s": r.exposure_s,
                "sigma_exposure_less_shown_s": stated_s.map(|stated| stated.hypot(sigma_s)),
                "exposure_sigma_s": stated_s,
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
    use crate::clock::exposure::{Exposure, Instant};
    use crate::clock::quality::Quality;

    /// Pictures whose record puts the exposure `late_s` after where the screen has it, with a delay of 0.02 s assumed.
    fn readings(n: usize, source: Source, late_s: f64) -> Vec<Reading> {
        let stamp = crate::clock::Stamp {
            utc: "2026-11-25T12:00:00Z".parse().unwrap(),
            utc_synchronised: true,
            boot_id: "boot".into(),
            since_boot_s: 100.0,
        };
        let instant = Instant { since_boot_s: 100.5, sigma_s: 0.005, delay_s: 0.02, source };
        let exposure = Exposure::new(&instant, &stamp, Quality::exact());
        let reading = |k: usize| {
            let late_s = late_s + if k.is_multiple_of(2) { 0.003 } else { -0.003 };
            Reading {
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

    fn summary(n: usize, source: Source, late_s: f64) -> Summary {
        let screen = Screen { refresh_s: 1.0 / 60.0, latency_s: 0.03, latency_sigma_s: 0.0 };
        Summary::of(&readings(n, source, late_s), n, &screen)
    }

    #[test]
    fn an_exposure_that_is_recorded_too_late_shortens_the_delay() {
        let found = summary(20, Source::EndOfFrame, 0.05);
        assert!(!found.exposure.as_ref().unwrap().agrees);
        let lines = found.lines.unwrap().text;
        assert!(lines.starts_with("stamp_delay_s = -0.0300\nstamp_delay_sigma_s = 0.00"), "{lines}");
        let found = summary(20, Source::ReleaseEdge, 0.004);
        assert!(found.exposure.as_ref().unwrap().agrees);
        let lines = found.lines.unwrap().text;
        assert!(lines.starts_with("exposure_delay_s = 0.0160\n"), "{lines}");
    }

    #[test]
    fn there_are_no_lines_where_nothing_can_be_configured() {
        assert!(summary(20, Source::AskedAndDelivered, 0.0).lines.is_err());
        assert!(summary(4, Source::EndOfFrame, 0.0).lines.unwrap_err().to_string().contains("too few"));
        let mixed = [readings(5, Source::EndOfFrame, 0.0), readings(5, Source::ReleaseEdge, 0.0)].concat();
        assert!(lines(&mixed, None).unwrap_err() == NoLines::SeveralSources);
    }
}
