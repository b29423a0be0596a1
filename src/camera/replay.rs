//! Camera that delivers frames from files, with faults on request. It is part of the product: the demo flies with it, and
//! tests use it to stress the daemon.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Camera, CameraError, CameraFactory, CameraFrame, CameraInfo, DriverSection};
use wingd_base::clock::Clock;
use wingd_base::fault::KeyFault;
use wingd_base::regular_file::{MAX_DATA_BYTES, read_regular_file};
use wingd_evaluation::frame_format::{Format, format_from_path};

mod items;

use items::{ReplayItem, read_items};

/// `[camera] kind = "replay"` of the configuration.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayConfig {
    /// Folder whose images are delivered in order of their names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// List instead of a folder: TOML with `[[frame]] file = "…"` and optionally `at = "1h"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub list: Option<PathBuf>,
    /// Start again after the last frame; otherwise the camera is then gone.
    #[serde(default = "default_repeat", rename = "loop")]
    pub repeat: bool,
    /// Machine time from trigger to delivery.
    #[serde(
        default,
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required"
    )]
    pub delay: Duration,
    /// Faults, each at one shot.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fault: Vec<ScriptedFault>,
}

fn default_repeat() -> bool {
    true
}

/// Fault and the call in which it occurs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptedFault {
    /// Number of the call for a shot, from 1, including repetitions.
    pub shot: u64,
    pub kind: FaultKind,
    /// Duration of a hang, machine time.
    #[serde(
        default = "default_hang",
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required"
    )]
    pub lasting: Duration,
}

fn default_hang() -> Duration {
    Duration::from_secs(3600)
}

/// Kind of a simulated fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FaultKind {
    /// Busy answer.
    Busy,
    /// Unplugged: answers so until it is opened again.
    Gone,
    /// Refusal.
    Refused,
    /// Timeout at the deadline.
    Timeout,
    /// Call that does not return by the deadline.
    Hang,
    /// First half of a frame.
    Truncated,
    /// Repetition of the last frame.
    Stale,
    /// Panic of the driver.
    Panic,
}

impl ReplayConfig {
    /// Replays a folder, endlessly and without faults.
    pub fn from_folder(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: Some(folder.into()),
            repeat: true,
            ..Self::default()
        }
    }

    /// Replays a list, endlessly and without faults.
    pub fn from_list(list: impl Into<PathBuf>) -> Self {
        Self {
            list: Some(list.into()),
            repeat: true,
            ..Self::default()
        }
    }
}

impl DriverSection for ReplayConfig {
    fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        let mut fault =
            |key: &str, problem: &str| faults.push(KeyFault::new(key, problem, "correct it"));
        if self.folder.is_some() == self.list.is_some() {
            fault(
                "folder",
                "a replay camera needs either folder = \"…\" or list = \"….toml\"",
            );
        }
        if self.fault.iter().any(|fault| fault.shot == 0) {
            fault("fault.shot", "shots count from 1");
        }
        faults
    }

    fn factory(&self, clock: Arc<dyn Clock>, origin: Duration) -> CameraFactory {
        let replay = ReplayFactory::new(self.clone(), clock, origin);
        Arc::new(move || Box::new(replay.make()))
    }
}

/// State that outlives one camera object, so that a new camera after a hang continues at the same frame.
#[derive(Default)]
struct ReplayProgress {
    calls: u64,
    /// Number of frames delivered of the present group.
    position: usize,
    group: Option<Duration>,
    last: Option<CameraFrame>,
}

/// Factory of replay cameras that share their progress.
#[derive(Clone)]
pub struct ReplayFactory {
    config: ReplayConfig,
    clock: Arc<dyn Clock>,
    origin: Duration,
    progress: Arc<Mutex<ReplayProgress>>,
}

impl ReplayFactory {
    /// Creates the factory; `at` of a list counts from `origin`, a time since boot.
    pub fn new(config: ReplayConfig, clock: Arc<dyn Clock>, origin: Duration) -> Self {
        Self {
            config,
            clock,
            origin,
            progress: Arc::default(),
        }
    }

    /// Creates a closed camera.
    pub fn make(&self) -> ReplayCamera {
        ReplayCamera {
            shared: self.clone(),
            items: Vec::new(),
            open: false,
        }
    }
}

/// Returns the number of items of the smallest group that is replayed together.
fn smallest_group(items: &[ReplayItem]) -> usize {
    let count = |item: &ReplayItem| items.iter().filter(|other| other.at == item.at).count();
    items.iter().map(count).min().unwrap_or(0)
}

/// Camera that replays files.
pub struct ReplayCamera {
    shared: ReplayFactory,
    items: Vec<ReplayItem>,
    open: bool,
}

impl Camera for ReplayCamera {
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        if let Some(fault) = self.shared.config.faults().first() {
            return Err(CameraError::Refused(format!(
                "{}: {}",
                fault.key, fault.problem
            )));
        }
        self.items = read_items(&self.shared.config)?;
        self.open = true;
        let source = self
            .shared
            .config
            .folder
            .as_ref()
            .or(self.shared.config.list.as_ref());
        let mut settings = Map::new();
        settings.insert(
            "source".to_owned(),
            Value::from(source.map(|p| p.display().to_string())),
        );
        settings.insert("frames".to_owned(), Value::from(self.items.len()));
        Ok(CameraInfo {
            name: "replay".to_owned(),
            settings,
            warnings: Vec::new(),
            repeats_after: self
                .shared
                .config
                .repeat
                .then(|| smallest_group(&self.items)),
        })
    }

    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        if !self.open {
            return Err(CameraError::Gone(
                "the replay camera is not open".to_owned(),
            ));
        }
        let config = &self.shared.config;
        let call = self.with_progress(|progress| {
            progress.calls += 1;
            progress.calls
        });
        if config.delay > deadline {
            std::thread::sleep(deadline);
            return Err(timeout_error(deadline));
        }
        std::thread::sleep(config.delay);
        match config.fault.iter().find(|fault| fault.shot == call) {
            Some(fault) => self.inject_fault(fault.kind, fault.lasting, deadline),
            None => self.read_next_frame(),
        }
    }

    fn is_stream(&self) -> bool {
        true
    }

    fn close(&mut self) {
        self.open = false;
    }
}

fn timeout_error(deadline: Duration) -> CameraError {
    CameraError::Timeout {
        after_s: deadline.as_secs_f64(),
        what: "the replayed frame".to_owned(),
    }
}

impl ReplayCamera {
    fn with_progress<T>(&self, f: impl FnOnce(&mut ReplayProgress) -> T) -> T {
        f(&mut self
            .shared
            .progress
            .lock()
            .unwrap_or_else(PoisonError::into_inner))
    }

    #[allow(clippy::panic)] // asked for by the script
    fn inject_fault(
        &mut self,
        kind: FaultKind,
        lasting: Duration,
        deadline: Duration,
    ) -> Result<CameraFrame, CameraError> {
        match kind {
            FaultKind::Busy => Err(CameraError::Busy("as requested by the script".to_owned())),
            FaultKind::Refused => Err(CameraError::Refused(
                "as requested by the script".to_owned(),
            )),
            FaultKind::Gone => {
                self.open = false;
                Err(CameraError::Gone("as requested by the script".to_owned()))
            }
            FaultKind::Timeout => {
                std::thread::sleep(deadline);
                Err(timeout_error(deadline))
            }
            FaultKind::Hang => {
                std::thread::sleep(lasting);
                self.read_next_frame()
            }
            FaultKind::Truncated => {
                let mut frame = self.read_next_frame()?;
                frame.bytes.truncate(frame.bytes.len() / 2);
                Ok(frame)
            }
            FaultKind::Stale => match self.with_progress(|progress| progress.last.clone()) {
                Some(frame) => Ok(frame),
                None => self.read_next_frame(),
            },
            FaultKind::Panic => panic!("the replay camera panics, as requested by the script"),
        }
    }

    fn read_next_frame(&mut self) -> Result<CameraFrame, CameraError> {
        let item = self.next_item()?;
        let bytes = read_regular_file(&item.file, MAX_DATA_BYTES)
            .map_err(|error| CameraError::BadFrame(format!("{}: {error}", item.file.display())))?;
        let format = format_from_path(&item.file).unwrap_or(Format::Jpeg);
        let mut settings = Map::new();
        let name = item.file.file_name().unwrap_or_default().to_string_lossy();
        settings.insert("source".to_owned(), Value::from(name.into_owned()));
        let frame = CameraFrame {
            bytes,
            format,
            settings,
            exposed: None,
        };
        self.with_progress(|progress| progress.last = Some(frame.clone()));
        Ok(frame)
    }

    /// Returns the next item of the group whose time came last.
    fn next_item(&mut self) -> Result<ReplayItem, CameraError> {
        let elapsed = self
            .shared
            .clock
            .since_boot()
            .saturating_sub(self.shared.origin);
        let due = |item: &&ReplayItem| item.at.is_none_or(|at| at <= elapsed);
        let group = self
            .items
            .iter()
            .filter(due)
            .map(|item| item.at.unwrap_or_default())
            .max();
        let of_group: Vec<&ReplayItem> = self
            .items
            .iter()
            .filter(|item| Some(item.at.unwrap_or_default()) == group)
            .collect();
        let position = self.with_progress(|progress| {
            if progress.group != group {
                (progress.group, progress.position) = (group, 0);
            }
            progress.position += 1;
            progress.position - 1
        });
        let index = if self.shared.config.repeat {
            position % of_group.len().max(1)
        } else {
            position
        };
        of_group
            .get(index)
            .map(|item| (*item).clone())
            .ok_or_else(|| {
                CameraError::Gone(
                    "all frames have been replayed (set loop = true to start again)".to_owned(),
                )
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wingd_base::clock::SimulatedClock;

    fn folder(count: u8) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for i in 0..count {
            std::fs::write(
                dir.path().join(format!("f{i}.jpg")),
                [0xff, 0xd8, i, 0, 0xff, 0xd9],
            )
            .unwrap();
        }
        dir
    }

    fn clock() -> Arc<SimulatedClock> {
        Arc::new(SimulatedClock::new(
            "b",
            "2026-03-01T06:00:00Z".parse().unwrap(),
            None,
        ))
    }

    fn shots(camera: &mut ReplayCamera, count: usize) -> Vec<Result<u8, String>> {
        let shoot = |_| camera.shoot(Duration::from_millis(10));
        let name = |frame: CameraFrame| frame.bytes[2];
        (0..count)
            .map(shoot)
            .map(|r| r.map(name).map_err(|e| e.to_string()))
            .collect()
    }

    #[test]
    fn frames_come_in_order_and_begin_again_or_end() {
        let dir = folder(2);
        let mut config = ReplayConfig::from_folder(dir.path());
        let mut camera = ReplayFactory::new(config.clone(), clock(), Duration::ZERO).make();
        camera.open().unwrap();
        assert_eq!(shots(&mut camera, 3), [Ok(0), Ok(1), Ok(0)]);
        config.repeat = false;
        let mut camera = ReplayFactory::new(config, clock(), Duration::ZERO).make();
        camera.open().unwrap();
        assert!(
            shots(&mut camera, 3)[2]
                .as_ref()
                .unwrap_err()
                .contains("loop = true")
        );
    }

    #[test]
    fn faults_occur_at_their_shot_and_persist_in_a_new_camera() {
        let dir = folder(4);
        let script = r#"
            folder = "?"
            [[fault]]
            shot = 2
            kind = "stale"
            [[fault]]
            shot = 4
            kind = "truncated"
            [[fault]]
            shot = 5
            kind = "gone"
        "#;
        let mut config: ReplayConfig = toml::from_str(script).unwrap();
        config.folder = Some(dir.path().to_owned());
        let factory = ReplayFactory::new(config, clock(), Duration::ZERO);
        let mut camera = factory.make();
        camera.open().unwrap();
        assert_eq!(shots(&mut camera, 3), [Ok(0), Ok(0), Ok(1)]);
        let mut camera = factory.make();
        camera.open().unwrap();
        assert_eq!(camera.shoot(Duration::ZERO).unwrap().bytes.len(), 3);
        assert!(matches!(
            camera.shoot(Duration::ZERO),
            Err(CameraError::Gone(_))
        ));
        assert!(matches!(
            camera.shoot(Duration::ZERO),
            Err(CameraError::Gone(_))
        ));
        camera.open().unwrap();
        assert_eq!(camera.shoot(Duration::ZERO).unwrap().bytes[2], 3);
    }

    #[test]
    fn a_list_follows_the_clock() {
        let dir = folder(3);
        let list = "[[frame]]\nfile = \"f0.jpg\"\n[[frame]]\nfile = \"f1.jpg\"\nat = \"1h\"\n\
                    [[frame]]\nfile = \"f2.jpg\"\nat = \"1h\"\n";
        let path = dir.path().join("list.toml");
        std::fs::write(&path, list).unwrap();
        let clock = clock();
        let mut camera = ReplayFactory::new(
            ReplayConfig::from_list(&path),
            clock.clone(),
            clock.since_boot(),
        )
        .make();
        camera.open().unwrap();
        assert_eq!(shots(&mut camera, 2), [Ok(0), Ok(0)]);
        clock.sleep(Duration::from_secs(3600));
        assert_eq!(shots(&mut camera, 3), [Ok(1), Ok(2), Ok(1)]);
    }

    #[test]
    fn faulty_settings_are_refused_with_the_name() {
        let missing = ReplayConfig::from_folder("/nonexistent/frames");
        let error = ReplayFactory::new(missing, clock(), Duration::ZERO)
            .make()
            .open()
            .unwrap_err();
        assert!(error.to_string().contains("/nonexistent/frames"), "{error}");
        let dir = folder(1);
        let list = dir.path().join("list.toml");
        std::fs::write(&list, "[[frame]]\nfile = \"f9.jpg\"\n").unwrap();
        let config = ReplayConfig::from_list(&list);
        let error = ReplayFactory::new(config, clock(), Duration::ZERO)
            .make()
            .open()
            .unwrap_err();
        assert!(
            error.to_string().contains("f9.jpg does not exist"),
            "{error}"
        );
    }
}
