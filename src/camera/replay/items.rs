//! Files that a replay camera delivers: those of a folder, or of a list.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;

use super::ReplayConfig;
use crate::camera::CameraError;
use wingd_base::regular_file::read_small_text;
use wingd_base::toml_fault::parse_toml;
use wingd_evaluation::frame_format::format_from_path;

/// File to deliver.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayItem {
    /// Image file.
    pub file: PathBuf,
    /// Time from the replay's origin at which this item and others of the same time begin to be delivered in turn.
    #[serde(
        default,
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::optional"
    )]
    pub at: Option<Duration>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReplayList {
    #[serde(default)]
    frame: Vec<ReplayItem>,
}

/// Reads the items of a folder or a list.
///
/// # Errors
/// Returns an error if there are none, or a file is missing or of another format.
pub fn read_items(config: &ReplayConfig) -> Result<Vec<ReplayItem>, CameraError> {
    let (items, source) = match (&config.folder, &config.list) {
        (Some(folder), _) => (list_folder_frames(folder)?, folder),
        (None, Some(list)) => (read_frame_list(list)?, list),
        (None, None) => {
            return Err(CameraError::Refused(
                "camera: set folder or list".to_owned(),
            ));
        }
    };
    if items.is_empty() {
        let problem = "contains no frames; put .jpg, .png, .pgm or .tiff files there";
        return Err(CameraError::Refused(format!(
            "{}: {problem}",
            source.display()
        )));
    }
    Ok(items)
}

fn list_folder_frames(folder: &Path) -> Result<Vec<ReplayItem>, CameraError> {
    let fault = |error| {
        let problem = format!(
            "{}: {error}; set [camera] folder to the folder of the frames",
            folder.display()
        );
        CameraError::Refused(problem)
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fault)? {
        let path = entry.map_err(fault)?.path();
        if path.is_file() && format_from_path(&path).is_some() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files
        .into_iter()
        .map(|file| ReplayItem { file, at: None })
        .collect())
}

fn read_frame_list(path: &Path) -> Result<Vec<ReplayItem>, CameraError> {
    let refused = |problem: String| CameraError::Refused(format!("{}: {problem}", path.display()));
    let text = read_small_text(path).map_err(|error| refused(error.to_string()))?;
    let list: ReplayList = parse_toml(path, &text, &[], "name the images in [[frame]] tables")
        .map_err(|fault| CameraError::Refused(fault.to_string()))?;
    let base = path.parent().unwrap_or(Path::new("."));
    let mut items = list.frame;
    for item in &mut items {
        item.file = base.join(&item.file);
        if format_from_path(&item.file).is_none() {
            return Err(refused(format!(
                "{} is not a .jpg, .png, .pgm or .tiff file",
                item.file.display()
            )));
        }
        if !item.file.is_file() {
            return Err(refused(format!("{} does not exist", item.file.display())));
        }
    }
    Ok(items)
}
