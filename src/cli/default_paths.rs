//! Configuration and installation of the working directory are found by themselves.

use std::path::{Path, PathBuf};

use super::Failure;

/// As `wingd init` names them.
const CONFIGURATION: &str = "wingd.toml";
const INSTALLATION: &str = "installation";
const MAIN_FILE: &str = "installation.toml";

/// The configuration that is named, or the one that lies here.
///
/// # Errors
/// Where none is named and none lies here.
pub(super) fn configuration(named: Option<&Path>) -> Result<PathBuf, Failure> {
    let mend = format!(
        "name the configuration: --config FILE (there is no {CONFIGURATION} here; `wingd init` writes one)"
    );
    named.map(Path::to_owned).or_else(configuration_here).ok_or(Failure::Usage(mend))
}

/// The configuration that lies here.
pub(super) fn configuration_here() -> Option<PathBuf> {
    let here = PathBuf::from(CONFIGURATION);
    here.is_file().then_some(here)
}

/// The installation that is named, or the one that lies here: `installation/`, or this very folder.
///
/// # Errors
/// Where none is named and none lies here.
pub(super) fn installation(named: Option<&Path>) -> Result<PathBuf, Failure> {
    let mend = format!(
        "name the installation: --installation DIR (there is no {INSTALLATION}/ here; `wingd init` writes one)"
    );
    named.map(Path::to_owned).or_else(installation_here).ok_or(Failure::Usage(mend))
}

/// The installation that lies here.
pub(super) fn installation_here() -> Option<PathBuf> {
    let places = [Path::new(INSTALLATION), Path::new(".")];
    places.into_iter().find(|folder| folder.join(MAIN_FILE).is_file()).map(Path::to_owned)
}
