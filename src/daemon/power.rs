//! A file or a GPIO line says that the supply fails, a little before it does.

use std::path::PathBuf;
use std::sync::mpsc::Sender;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::command::Command;
use super::core::Core;
use crate::installation::KeyFault;

/// Between two looks; two equal ones count, so that a bounce of the contact is none.
const LOOK: Duration = Duration::from_millis(25);

/// `[power]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PowerConfig {
    /// From SIGTERM to the program's end at most. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub stop_within: Duration,
    /// From the supply's failing to the moment when everything is durable at most. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub hold_up: Duration,
    /// Reads 0 while the supply fails, such as `/sys/class/power_supply/AC/online`.
    pub file: Option<PathBuf>,
    /// Active while the supply fails.
    #[cfg(feature = "gpio")]
    pub line: Option<crate::camera::release::LineSection>,
}

impl Default for PowerConfig {
    fn default() -> Self {
        Self {
            stop_within: Duration::from_secs(30),
            hold_up: Duration::from_secs(2),
            file: None,
            #[cfg(feature = "gpio")]
            line: None,
        }
    }
}

impl PowerConfig {
    /// Every fault, at its key of the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        for (key, time) in [("stop_within", self.stop_within), ("hold_up", self.hold_up)] {
            if time < Duration::from_millis(200) {
                let mend = "give at least \"200ms\", or leave it out";
                faults.push(KeyFault::new(format!("power.{key}"), format!("is {time:?}"), mend));
            }
        }
        #[cfg(feature = "gpio")]
        if let Some(line) = &self.line {
            if !line.is_clear() {
                let mend = "give either name, or chip and offset";
                faults.push(KeyFault::new("power.line", "no single GPIO line is named", mend));
            }
            if self.file.is_some() {
                faults.push(KeyFault::new("power.line", "there is a file too", "leave one of the two out"));
            }
        }
        faults
    }

    /// Whether something says that the supply fails.
    pub fn watches(&self) -> bool {
        #[cfg(feature = "gpio")]
        if self.line.is_some() {
            return true;
        }
        self.file.is_some()
    }

    /// What is to be looked at; `None` where nothing is named.
    fn supply(&self) -> Result<Option<Supply>, Unseen> {
        #[cfg(feature = "gpio")]
        if let Some(section) = &self.line {
            let line = crate::camera::release::Line::watch(section)?;
            return Ok(Some(Supply::Line(line)));
        }
        Ok(self.file.clone().map(Supply::File))
    }
}

enum Supply {
    File(PathBuf),
    #[cfg(feature = "gpio")]
    Line(crate::camera::release::Line),
}

/// Why the supply cannot be looked at; all that is done about it is to say it.
#[derive(Debug, thiserror::Error)]
enum Unseen {
    #[error("{}: {}", .0.display(), .1)]
    File(PathBuf, std::io::Error),
    #[cfg(feature = "gpio")]
    #[error(transparent)]
    Line(#[from] crate::camera::CameraError),
}

impl Supply {
    fn fails(&self) -> Result<bool, Unseen> {
        match self {
            Self::File(path) => std::fs::read_to_string(path)
                .map(|text| text.trim() == "0")
                .map_err(|error| Unseen::File(path.clone(), error)),
            #[cfg(feature = "gpio")]
            Self::Line(line) => Ok(line.is_active()?),
        }
    }
}

/// Looks at the supply on a thread of its own until the daemon ends. Recording matters more than
/// knowing of the supply: what cannot be looked at is a fault in the status, and nothing stops for it.
pub(crate) fn watch(core: &Core, config: &PowerConfig, commands: Sender<Command>) {
    match config.supply() {
        Ok(None) => {}
        Ok(Some(supply)) => {
            let watcher = Watcher { core: core.clone(), supply, hold_up: config.hold_up, commands };
            if let Err(error) = Core::spawn("power", move || watcher.run()) {
                unwatched(core, &error);
            }
        }
        Err(error) => unwatched(core, &error),
    }
}

fn unwatched(core: &Core, error: &dyn std::fmt::Display) {
    tracing::error!(%error, "the supply cannot be watched");
    core.board.fault(&format!("power: {error}"));
}

struct Watcher {
    core: Core,
    supply: Supply,
    hold_up: Duration,
    commands: Sender<Command>,
}

impl Watcher {
    fn run(self) {
        let (mut known, mut last, mut readable) = (false, false, true);
        while !self.core.halt.ending() {
            match self.supply.fails() {
                Ok(fails) => {
                    readable = true;
                    if fails == last && fails != known {
                        known = fails;
                        self.tell(fails);
                    }
                    last = fails;
                }
                Err(error) => {
                    if std::mem::take(&mut readable) {
                        unwatched(&self.core, &error);
                    }
                }
            }
            std::thread::sleep(LOOK);
        }
    }

    fn tell(&self, fails: bool) {
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
        // It only wakes: what to do is in the halt.
        let _ = self.commands.send(Command::Look);
    }
}
