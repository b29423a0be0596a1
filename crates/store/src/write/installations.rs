//! Storage of the installations that results are computed from.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use super::root::StoreRoot;
use crate::disk::{StoreError, StoreResult};
use crate::format::{layout, sha256_hex, sums};
use crate::read::installations::{InstallationFile, installation_folder};

/// Stores an installation durably, unless it exists already, and returns its digest.
pub(crate) fn keep_installation(
    root: StoreRoot<'_>,
    files: &[InstallationFile],
) -> StoreResult<String> {
    let digests: BTreeMap<_, _> = files
        .iter()
        .map(|(name, bytes)| (name.clone(), sha256_hex(bytes)))
        .collect();
    let text = sums::format_sums(&digests);
    let digest = sha256_hex(text.as_bytes());
    let place = installation_folder(root.path, &digest);
    if root.disk.exists(&place) {
        return Ok(digest);
    }
    let mut parts = files.iter().map(|(name, _)| name);
    if let Some(name) = parts.find(|name| !is_plain(name)) {
        let problem =
            format!("the installation's file {name:?} is outside its folder and is not stored");
        let remedy = "copy it into the folder and refer to it there";
        return Err(StoreError::Damaged {
            path: PathBuf::from(name),
            problem,
            remedy,
        });
    }
    let made = layout::incoming_folder(root.path, &digest);
    if !root.disk.exists(&made) {
        root.disk.make_dir(&made)?;
    }
    let sums = (layout::SUMS_FILE.to_owned(), text.into_bytes());
    for (name, bytes) in files.iter().chain([&sums]) {
        root.disk.save_file(&made.join(name), bytes)?;
    }
    root.disk.sync_directory(&made)?;
    root.ensure_dir(layout::INSTALLATIONS)?;
    root.disk.move_durably(&made, &place)?;
    Ok(digest)
}

/// Returns whether a name is a plain file name and not reserved.
fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let plain = matches!(
        (parts.next(), parts.next()),
        (Some(Component::Normal(_)), None)
    );
    plain && name != layout::SUMS_FILE
}
