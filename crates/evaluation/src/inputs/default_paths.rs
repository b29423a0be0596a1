//! Configuration and installation of a command: those named, else those in the working directory.

use std::path::{Path, PathBuf};

use crate::installation::{self, Installation};
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::output::print_notes;
use wingd_measure::setup::Setup;

/// Name of the configuration, as written by `wingd init`.
const CONFIGURATION_FILE: &str = "wingd.toml";
const INSTALLATION_FOLDER: &str = "installation";
const INSTALLATION_FILE: &str = "installation.toml";

/// Returns the configuration given, or the one in the working directory.
///
/// # Errors
/// Returns an error if none is given and the directory has none.
pub fn resolve_configuration(named: Option<&Path>) -> TaskResult<PathBuf> {
    let text = format!(
        "name the configuration with --config FILE (this directory has no {CONFIGURATION_FILE}; `wingd init` writes one)"
    );
    named
        .map(Path::to_owned)
        .or_else(local_configuration)
        .ok_or(Failure::Usage(text))
}

/// Finds the configuration in the working directory.
pub fn local_configuration() -> Option<PathBuf> {
    let here = PathBuf::from(CONFIGURATION_FILE);
    here.is_file().then_some(here)
}

/// Returns the installation given, or the one in the working directory: `installation/`, or the directory itself.
///
/// # Errors
/// Returns an error if none is given and the directory has none.
pub fn resolve_installation(named: Option<&Path>) -> TaskResult<PathBuf> {
    let text = format!(
        "name the installation with --installation DIR (this directory has no {INSTALLATION_FOLDER}/; `wingd init` writes one)"
    );
    named
        .map(Path::to_owned)
        .or_else(local_installation)
        .ok_or(Failure::Usage(text))
}

/// Finds the installation in the working directory.
pub fn local_installation() -> Option<PathBuf> {
    let places = [Path::new(INSTALLATION_FOLDER), Path::new(".")];
    places
        .into_iter()
        .find(|folder| folder.join(INSTALLATION_FILE).is_file())
        .map(Path::to_owned)
}

/// Loads an installation and prints its warnings.
pub fn load_installation(directory: &Path) -> TaskResult<Installation> {
    let installation = installation::load(directory)?;
    print_warnings(&installation);
    Ok(installation)
}

/// Loads an installation whose orientation is ignored, and prints its warnings.
pub fn load_without_orientation(directory: &Path) -> TaskResult<Installation> {
    let installation = installation::load_without_orientation(directory)?;
    print_warnings(&installation);
    Ok(installation)
}

/// Prints warnings about an installation.
pub fn print_warnings(installation: &Installation) {
    print_notes(
        installation::find_warnings(installation)
            .iter()
            .map(|doubt| format!("warning: {doubt}")),
    );
}

/// Loads the setup of an installation that a figure is drawn with, if one is named.
pub fn load_setup(named: Option<&Path>) -> TaskResult<Option<Setup>> {
    let installation = named
        .map(installation::load_without_orientation)
        .transpose()?;
    Ok(installation.map(|installation| installation.setup))
}
