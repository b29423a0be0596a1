//! Configuration `wingd.toml`, composed of the sections that each module defines.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::camera::section::CameraSection;
use crate::daemon::{LiveConfig, PowerConfig, SeriesConfig, StatusConfig};
use wingd_base::fault::{Fault, KeyFault};
use wingd_base::regular_file::{MAX_FILE_BYTES, read_regular_file};
use wingd_base::text::decode_text;
use wingd_base::toml_fault::parse_toml;
use wingd_evaluation::pipeline::SolveJob;
use wingd_measure::adjust::{AdjustmentMethod, Options};
use wingd_pages::section::ServeConfig;
use wingd_store::StoreConfig;

/// Configuration of the recorder.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Installation directory; without it frames are only recorded.
    pub installation: Option<PathBuf>,
    pub camera: CameraSection,
    #[serde(default)]
    pub series: SeriesConfig,
    pub store: StoreConfig,
    #[serde(default)]
    pub status: StatusConfig,
    #[serde(default)]
    pub power: PowerConfig,
    #[serde(default)]
    pub live: LiveConfig,
    #[serde(default)]
    pub solve: SolveConfig,
    /// Web page; without this section the recorder has none.
    pub serve: Option<ServeConfig>,
}

/// Section `[solve]`: solution of frames on board.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolveConfig {
    /// `spatial` (default) or `profile`.
    pub method: SolveMethod,
    /// Number of curvature terms, 1 to 10; absent: 10, live 8.
    pub curvature_terms: Option<usize>,
    /// Maximum time for a frame; one that takes longer is recorded as failed.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub deadline: Duration,
}

impl Default for SolveConfig {
    fn default() -> Self {
        Self {
            method: SolveMethod::default(),
            curvature_terms: None,
            deadline: Duration::from_secs(60),
        }
    }
}

/// Values of `[solve] method`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SolveMethod {
    /// Beam of rigid sections.
    #[default]
    Spatial,
    /// Published method.
    Profile,
}

impl SolveConfig {
    /// Converts the section to a job of the pipeline.
    pub fn to_job(&self) -> SolveJob {
        let method = match self.method {
            SolveMethod::Spatial => AdjustmentMethod::Spatial,
            SolveMethod::Profile => AdjustmentMethod::Profile,
        };
        SolveJob {
            method,
            options: Options {
                curvature_terms: self.curvature_terms,
                ..Options::default()
            },
        }
    }

    fn faults(&self) -> Vec<KeyFault> {
        let terms = self
            .curvature_terms
            .filter(|n| !(1..=10).contains(n))
            .map(|terms| {
                let remedy = "give 1 to 10, or omit it";
                KeyFault::new("solve.curvature_terms", format!("is {terms}"), remedy)
            });
        let deadline = (self.deadline < Duration::from_secs(1)).then(|| {
            let remedy = "give at least \"1s\", or omit it";
            KeyFault::new("solve.deadline", format!("is {:?}", self.deadline), remedy)
        });
        terms.into_iter().chain(deadline).collect()
    }
}

/// Reads and checks a configuration. Relative paths refer to the folder of the file.
///
/// # Errors
/// Returns all errors found, each with its key and remedy.
pub fn load_configuration(file: &Path) -> Result<Config, Vec<Fault>> {
    let text = read_text(file)?;
    let mut config: Config = parse_text(file, &text)?;
    let mut faults = config.tilde_faults(file);
    let config = config.with_resolved_paths(file.parent().unwrap_or(Path::new("")));
    faults.extend(config.faults(file));
    if faults.is_empty() {
        Ok(config)
    } else {
        Err(faults)
    }
}

/// Reads only the section `[camera]`.
///
/// # Errors
/// Returns all errors found in the section.
pub fn load_camera(file: &Path) -> Result<CameraSection, Vec<Fault>> {
    #[derive(Deserialize)]
    struct CameraOnly {
        camera: CameraSection,
    }
    let text = read_text(file)?;
    let mut camera = parse_text::<CameraOnly>(file, &text)?.camera;
    let faults: Vec<Fault> = camera
        .faults()
        .into_iter()
        .map(|fault| fault.into_fault(file))
        .collect();
    resolve_camera(&mut camera, file.parent().unwrap_or(Path::new("")));
    if faults.is_empty() {
        Ok(camera)
    } else {
        Err(faults)
    }
}

fn read_text(file: &Path) -> Result<String, Vec<Fault>> {
    let remedy = "name it with --config; config/wingd.toml is a commented default";
    let bytes = read_regular_file(file, MAX_FILE_BYTES).map_err(|e| {
        vec![Fault::new(
            file,
            "file",
            format!("cannot be read ({e})"),
            remedy,
        )]
    })?;
    decode_text(bytes).map_err(|(problem, remedy)| vec![Fault::new(file, "file", problem, remedy)])
}

/// Resolves a path relative to the folder of the configuration.
fn resolve_path(folder: &Path, path: &mut PathBuf) {
    // Collected from components, so that messages contain no `/./`.
    *path = folder.join(&*path).components().collect();
}

fn resolve_camera(camera: &mut CameraSection, folder: &Path) {
    if let Some(replay) = camera.replay_mut() {
        replay
            .folder
            .iter_mut()
            .chain(replay.list.iter_mut())
            .for_each(|path| resolve_path(folder, path));
    }
}

impl Config {
    fn with_resolved_paths(mut self, folder: &Path) -> Self {
        resolve_path(folder, &mut self.store.path);
        resolve_path(folder, &mut self.status.socket);
        let optional = [
            &mut self.installation,
            &mut self.power.file,
            &mut self.store.signing_key,
        ];
        optional
            .into_iter()
            .flatten()
            .for_each(|path| resolve_path(folder, path));
        self.live
            .socket
            .iter_mut()
            .for_each(|path| resolve_path(folder, path));
        self.serve
            .iter_mut()
            .flat_map(ServeConfig::file_paths)
            .for_each(|path| resolve_path(folder, path));
        resolve_camera(&mut self.camera, folder);
        self
    }

    /// Reports paths that begin with `~`: only a shell expands it.
    fn tilde_faults(&mut self, file: &Path) -> Vec<Fault> {
        let mut paths = vec![
            ("store.path", &self.store.path),
            ("status.socket", &self.status.socket),
        ];
        paths.extend(self.installation.iter().map(|path| ("installation", path)));
        paths.extend(self.live.socket.iter().map(|path| ("live.socket", path)));
        paths.extend(self.power.file.iter().map(|path| ("power.file", path)));
        paths.extend(
            self.store
                .signing_key
                .iter()
                .map(|path| ("store.signing_key", path)),
        );
        if let Some(replay) = self.camera.replay_mut() {
            paths.extend(replay.folder.iter().map(|path| ("camera.folder", path)));
            paths.extend(replay.list.iter().map(|path| ("camera.list", path)));
        }
        let one = |(place, path): (&str, &PathBuf)| {
            let problem = format!("is \"{}\", but only a shell expands ~", path.display());
            Fault::new(
                file,
                place,
                problem,
                "write the full path, beginning with /",
            )
        };
        paths
            .into_iter()
            .filter(|(_, path)| path.starts_with("~"))
            .map(one)
            .collect()
    }

    fn faults(&self, file: &Path) -> Vec<Fault> {
        let mut keys = self.camera.faults();
        let live = self.live.socket.iter().map(|path| ("live.socket", path));
        let sockets = live.chain([("status.socket", &self.status.socket)]);
        keys.extend(sockets.filter_map(|(key, path)| socket_length_fault(key, path)));
        keys.extend(self.series.faults());
        keys.extend(self.store.faults());
        keys.extend(self.power.faults());
        keys.extend(self.live.faults());
        // The recorder works without its page: `wingd check` examines [serve].
        keys.extend(self.solve.faults());
        keys.into_iter()
            .map(|fault| fault.into_fault(file))
            .collect()
    }
}

/// Largest length of a socket's path on Linux, bytes (`sun_path` of unix(7), without its terminator).
const MAX_SOCKET_PATH_BYTES: usize = 107;

fn socket_length_fault(key: &str, path: &Path) -> Option<KeyFault> {
    let length = path.as_os_str().len();
    let problem = format!(
        "{} has {length} bytes, but the path of a socket can have {MAX_SOCKET_PATH_BYTES}",
        path.display()
    );
    let remedy = "give a shorter path, such as /run/wingd/wingd.sock";
    (length > MAX_SOCKET_PATH_BYTES).then(|| KeyFault::new(key, problem, remedy))
}

/// Tables whose `kind` chooses the keys: `[camera.frames]` is within the release camera.
const TABLES_WITH_KIND: [&[&str]; 2] = [&["camera", "frames"], &["camera"]];

/// Parses the text of a configuration, without examining its values.
///
/// # Errors
/// Returns the first error with line, key and remedy; `file` is its file.
pub fn parse_configuration(file: &Path, text: &str) -> Result<Config, Vec<Fault>> {
    parse_text(file, text)
}

fn parse_text<T: DeserializeOwned>(file: &Path, text: &str) -> Result<T, Vec<Fault>> {
    let remedy = "compare it with config/wingd.toml";
    parse_toml(file, text, &TABLES_WITH_KIND, remedy).map_err(|fault| vec![fault])
}
