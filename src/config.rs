//! This file reads `wingd.toml`, which is composed of the sections that each module defines for itself.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;

use crate::camera::section::CameraSection;
use crate::daemon::{LiveConfig, PowerConfig, SeriesConfig, StatusConfig};
use crate::http::section::ServeConfig;
use crate::installation::{Fault, KeyFault, text_of};
use crate::measure::adjust::{Method, Options};
use crate::pipeline::Job;
use crate::store::StoreConfig;

/// The daemon's configuration.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The prepared directory; without it frames are recorded only.
    pub installation: Option<PathBuf>,
    /// `[camera]`.
    pub camera: CameraSection,
    /// `[series]`.
    #[serde(default)]
    pub series: SeriesConfig,
    /// `[store]`.
    pub store: StoreConfig,
    /// `[status]`.
    #[serde(default)]
    pub status: StatusConfig,
    /// `[power]`.
    #[serde(default)]
    pub power: PowerConfig,
    /// `[live]`.
    #[serde(default)]
    pub live: LiveConfig,
    /// `[solve]`.
    #[serde(default)]
    pub solve: SolveConfig,
    /// `[serve]`; without it the recorder shows no page.
    pub serve: Option<ServeConfig>,
}

/// `[solve]`: how frames are solved on board.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolveConfig {
    /// `spatial` (default) or `profile`.
    pub method: SolveMethod,
    /// Terms of the curvature, 1 to 10; chosen by test where not given.
    pub curvature_terms: Option<usize>,
    /// A frame that takes longer is recorded as failed. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub deadline: Duration,
}

impl Default for SolveConfig {
    fn default() -> Self {
        Self { method: SolveMethod::default(), curvature_terms: None, deadline: Duration::from_secs(60) }
    }
}

/// Words of `[solve] method`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SolveMethod {
    /// The rigid-section beam.
    #[default]
    Spatial,
    /// The published method.
    Profile,
}

impl SolveConfig {
    /// What to compute.
    pub fn job(&self) -> Job {
        let method = match self.method {
            SolveMethod::Spatial => Method::Spatial,
            SolveMethod::Profile => Method::Profile,
        };
        Job { method, options: Options { curvature_terms: self.curvature_terms, ..Options::default() } }
    }

    fn faults(&self) -> Vec<KeyFault> {
        let terms = self.curvature_terms.filter(|n| !(1..=10).contains(n)).map(|terms| {
            let mend = "give 1 to 10, or leave it out";
            KeyFault::new("solve.curvature_terms", format!("is {terms}"), mend)
        });
        let deadline = (self.deadline < Duration::from_secs(1)).then(|| {
            let mend = "give at least \"1s\", or leave it out";
            KeyFault::new("solve.deadline", format!("is {:?}", self.deadline), mend)
        });
        terms.into_iter().chain(deadline).collect()
    }
}

/// Reads and checks a configuration; every fault in one go. Relative paths count from the file's folder.
pub fn load(file: &Path) -> Result<Config, Vec<Fault>> {
    let text = read(file)?;
    let mut config: Config = toml::from_str(&text).map_err(|e| vec![syntax(file, &text, &e)])?;
    let mut faults = config.tildes(file);
    let config = config.resolved(file.parent().unwrap_or(Path::new("")));
    faults.extend(config.faults(file));
    if faults.is_empty() { Ok(config) } else { Err(faults) }
}

/// Reads `[camera]` alone; other sections are not looked at.
pub fn load_camera(file: &Path) -> Result<CameraSection, Vec<Fault>> {
    #[derive(Deserialize)]
    struct CameraAlone {
        camera: CameraSection,
    }
    let text = read(file)?;
    let mut camera = toml::from_str::<CameraAlone>(&text).map_err(|e| vec![syntax(file, &text, &e)])?.camera;
    let faults: Vec<Fault> = camera.faults().into_iter().map(|fault| fault.of(file)).collect();
    resolve_camera(&mut camera, file.parent().unwrap_or(Path::new("")));
    if faults.is_empty() { Ok(camera) } else { Err(faults) }
}

fn read(file: &Path) -> Result<String, Vec<Fault>> {
    let mend = "name it with --config; config/wingd.toml is a commented default";
    let bytes = std::fs::read(file)
        .map_err(|e| vec![Fault::new(file, "file", format!("cannot be read ({e})"), mend)])?;
    text_of(bytes).map_err(|(problem, mend)| vec![Fault::new(file, "file", problem, mend)])
}

/// A path of the configuration as seen from its folder.
fn resolve(folder: &Path, path: &mut PathBuf) {
    // Collected anew, so that no `/./` stands in messages.
    *path = folder.join(&*path).components().collect();
}

fn resolve_camera(camera: &mut CameraSection, folder: &Path) {
    if let Some(replay) = camera.replay() {
        replay.folder.iter_mut().chain(replay.list.iter_mut()).for_each(|path| resolve(folder, path));
    }
}

impl Config {
    fn resolved(mut self, folder: &Path) -> Self {
        resolve(folder, &mut self.store.path);
        resolve(folder, &mut self.status.socket);
        let optional = [&mut self.installation, &mut self.power.file, &mut self.store.signing_key];
        optional.into_iter().flatten().for_each(|path| resolve(folder, path));
        self.live.socket.iter_mut().for_each(|path| resolve(folder, path));
        self.serve.iter_mut().flat_map(ServeConfig::paths).for_each(|path| resolve(folder, path));
        resolve_camera(&mut self.camera, folder);
        self
    }

    /// Paths with the shell's word for the home directory: nobody expands it in a file.
    fn tildes(&mut self, file: &Path) -> Vec<Fault> {
        let mut paths = vec![("store.path", &self.store.path), ("status.socket", &self.status.socket)];
        paths.extend(self.installation.iter().map(|path| ("installation", path)));
        paths.extend(self.live.socket.iter().map(|path| ("live.socket", path)));
        paths.extend(self.power.file.iter().map(|path| ("power.file", path)));
        paths.extend(self.store.signing_key.iter().map(|path| ("store.signing_key", path)));
        if let Some(replay) = self.camera.replay() {
            paths.extend(replay.folder.iter().map(|path| ("camera.folder", path)));
            paths.extend(replay.list.iter().map(|path| ("camera.list", path)));
        }
        let one = |(place, path): (&str, &PathBuf)| {
            let problem = format!("is \"{}\"; ~ is known to shells only", path.display());
            Fault::new(file, place, problem, "write the whole path, beginning with /")
        };
        paths.into_iter().filter(|(_, path)| path.starts_with("~")).map(one).collect()
    }

    fn faults(&self, file: &Path) -> Vec<Fault> {
        let mut keys = self.camera.faults();
        keys.extend(self.series.faults());
        keys.extend(self.store.faults());
        keys.extend(self.power.faults());
        keys.extend(self.live.faults());
        let mut faults: Vec<Fault> = keys.into_iter().map(|fault| fault.of(file)).collect();
        if let Some(serve) = &self.serve {
            let place = |key: &str| (file.to_owned(), format!("serve.{key}"));
            faults.extend(serve.open(place).err().unwrap_or_default());
        }
        faults.extend(self.solve.faults().into_iter().map(|fault| fault.of(file)));
        faults
    }
}

fn syntax(file: &Path, text: &str, error: &toml::de::Error) -> Fault {
    crate::installation::toml_fault(file, text, error, "compare it with config/wingd.toml")
}
