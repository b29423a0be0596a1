//! A replay camera delivers the files of a folder, or those of a list.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;

use super::ReplayConfig;
use crate::camera::{CameraError, Format};

/// A file to deliver.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Item {
    /// The picture.
    pub file: PathBuf,
    /// Since the replay's origin; from then on this item and its equals are delivered in turn.
    #[serde(default, with = "jiff::fmt::serde::unsigned_duration::friendly::compact::optional")]
    pub at: Option<Duration>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    #[serde(default)]
    frame: Vec<Item>,
}

/// What a folder or a list says is to be delivered; an error where that is nothing.
pub fn read_items(config: &ReplayConfig) -> Result<Vec<Item>, CameraError> {
    let (items, source) = match (&config.folder, &config.list) {
        (Some(folder), _) => (read_folder(folder)?, folder),
        (None, Some(list)) => (read_list(list)?, list),
        (None, None) => return Err(CameraError::Refused("camera: set folder or list".to_owned())),
    };
    if items.is_empty() {
        let what = "holds no frames; put .jpg, .png, .pgm or .tiff files there";
        return Err(CameraError::Refused(format!("{}: {what}", source.display())));
    }
    Ok(items)
}

fn read_folder(folder: &Path) -> Result<Vec<Item>, CameraError> {
    let fault = |error| {
        let what = format!("{}: {error}; set [camera] folder to the frames", folder.display());
        CameraError::Refused(what)
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fault)? {
        let path = entry.map_err(fault)?.path();
        if path.is_file() && format_of(&path).is_some() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files.into_iter().map(|file| Item { file, at: None }).collect())
}

fn read_list(path: &Path) -> Result<Vec<Item>, CameraError> {
    let refused = |what: String| CameraError::Refused(format!("{}: {what}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| refused(error.to_string()))?;
    let list: List = toml::from_str(&text).map_err(|error| refused(error.to_string()))?;
    let base = path.parent().unwrap_or(Path::new("."));
    let mut items = list.frame;
    for item in &mut items {
        item.file = base.join(&item.file);
        if format_of(&item.file).is_none() {
            return Err(refused(format!("{} is no .jpg, .png, .pgm or .tiff", item.file.display())));
        }
        if !item.file.is_file() {
            return Err(refused(format!("{} does not exist", item.file.display())));
        }
    }
    Ok(items)
}

/// By the file's name; `None` where it is no picture.
pub fn format_of(path: &Path) -> Option<Format> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    match extension.as_str() {
        "jpg" | "jpeg" | "jpe" | "mpo" => Some(Format::Jpeg),
        "png" | "pgm" | "ppm" | "pnm" | "tif" | "tiff" => Some(Format::File { extension }),
        _ => None,
    }
}
