//! Watches a file or a GPIO line that announces a power failure shortly before it happens.

use std::path::PathBuf;
use std::sync::mpsc::Sender;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::command::Command;
use super::core::Core;
use wingd_base::fault::KeyFault;

/// Time between two checks. Two equal readings count, so that a bouncing contact is ignored.
const CHECK_INTERVAL: Duration = Duration::from_millis(25);

/// `[power]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PowerConfig {
    /// Maximum time from SIGTERM to the end of the program. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub stop_within: Duration,
    /// Maximum time from the power failure until everything is durable. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub hold_up: Duration,
    /// File that reads 0 while the supply fails, such as `/sys/class/power_supply/AC/online`.
    pub file: Option<PathBuf>,
    /// GPIO line that is active while the supply fails.
    pub line: Option<crate::camera::release::LineSection>,
}

impl Default for PowerConfig {
    fn default() -> Self {
        Self {
            stop_within: Duration::from_secs(30),
            hold_up: Duration::from_secs(2),
            file: None,
            line: None,
        }
    }
}

impl PowerConfig {
    /// Returns every invalid setting, with its key in the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        for (key, time) in [("stop_within", self.stop_within), ("hold_up", self.hold_up)] {
            if time < Duration::from_millis(200) {
                let remedy = "give at least \"200ms\", or remove it";
                faults.push(KeyFault::new(
                    format!("power.{key}"),
                    format!("is {time:?}"),
                    remedy,
                ));
            }
        }
        if let Some(line) = &self.line {
            if !line.is_clear() {
                let remedy = "give either name, or chip and offset";
                faults.push(KeyFault::new(
                    "power.line",
                    "does not name a single GPIO line",
                    remedy,
                ));
            }
            if self.file.is_some() {
                faults.push(KeyFault::new(
                    "power.line",
                    "is given together with file",
                    "remove one of the two",
                ));
            }
        }
        faults
    }

    /// Returns whether a file or line is configured that announces a power failure.
    pub fn is_configured(&self) -> bool {
        if self.line.is_some() {
            return true;
        }
        self.file.is_some()
    }

    /// Opens the configured file or line; `None` if neither is configured.
    fn open_sensor(&self) -> Result<Option<SupplySensor>, SupplyError> {
        if let Some(section) = &self.line {
            let line = crate::camera::release::GpioLine::watch(section)?;
            return Ok(Some(SupplySensor::Line(line)));
        }
        Ok(self.file.clone().map(SupplySensor::File))
    }
}

enum SupplySensor {
    File(PathBuf),
    Line(crate::camera::release::GpioLine),
}

/// Error in reading the supply. It is only reported.
#[derive(Debug, thiserror::Error)]
enum SupplyError {
    #[error("{}: {}", .0.display(), .1)]
    File(PathBuf, std::io::Error),
    #[error(transparent)]
    Line(#[from] crate::camera::CameraError),
}

impl SupplySensor {
    fn is_power_failing(&self) -> Result<bool, SupplyError> {
        match self {
            Self::File(path) => wingd_base::regular_file::read_small_text(path)
                .map(|text| text.trim() == "0")
                .map_err(|error| SupplyError::File(path.clone(), error)),
            Self::Line(line) => Ok(line.is_active()?),
        }
    }
}

/// Watches the supply on its own thread until the daemon ends. Recording matters more than watching the supply: an error is
/// a fault in the status, and nothing stops for it.
pub(crate) fn watch_supply(core: &Core, config: &PowerConfig, commands: Sender<Command>) {
    match config.open_sensor() {
        Ok(None) => {}
        Ok(Some(supply)) => {
            let watcher = SupplyWatcher {
                core: core.clone(),
                supply,
                hold_up: config.hold_up,
                commands,
            };
            if let Err(error) = Core::spawn_thread("power", move || watcher.watch_until_shutdown())
            {
                report_unwatched_supply(core, &error);
            }
        }
        Err(error) => report_unwatched_supply(core, &error),
    }
}

fn report_unwatched_supply(core: &Core, error: &dyn std::fmt::Display) {
    tracing::error!(%error, "the supply cannot be watched");
    core.board.note_fault(&format!("power: {error}"));
}

struct SupplyWatcher {
    core: Core,
    supply: SupplySensor,
    hold_up: Duration,
    commands: Sender<Command>,
}

impl SupplyWatcher {
    fn watch_until_shutdown(self) {
        let (mut known, mut last, mut readable) = (false, false, true);
        while !self.core.halt.is_ending() {
            match self.supply.is_power_failing() {
                Ok(fails) => {
                    readable = true;
                    if fails == last && fails != known {
                        known = fails;
                        self.pause_or_resume_daemon(fails);
                    }
                    last = fails;
                }
                Err(error) => {
                    if std::mem::take(&mut readable) {
                        report_unwatched_supply(&self.core, &error);
                    }
                }
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
    }

    fn pause_or_resume_daemon(&self, fails: bool) {
        if fails {
            tracing::warn!(
                hold_up_s = self.hold_up.as_secs_f64(),
                "the power fails: everything is made durable"
            );
            self.core.halt.pause(self.hold_up);
        } else {
            tracing::info!("the power is back");
            self.core.halt.resume();
        }
        // This only wakes the recorder, which reads the order from the halt.
        let _ = self.commands.send(Command::HaltChanged);
    }
}
