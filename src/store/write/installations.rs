//! Keeping what results are computed from.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use super::root::Root;
use crate::store::disk::StoreError;
use crate::store::format::{layout, sha256, sums};
use crate::store::read::installations::{File, folder};

/// Keeps an installation durably and returns its digest. One that is there already stays.
pub(crate) fn keep(root: Root<'_>, files: &[File]) -> Result<String, StoreError> {
    let digests: BTreeMap<_, _> = files.iter().map(|(name, bytes)| (name.clone(), sha256(bytes))).collect();
    let text = sums::text(&digests);
    let digest = sha256(text.as_bytes());
    let place = folder(root.path, &digest);
    if root.disk.exists(&place) {
        return Ok(digest);
    }
    let mut parts = files.iter().map(|(name, _)| name);
    if let Some(name) = parts.find(|name| !is_plain(name)) {
        let what = format!("the installation's file {name:?} lies outside of its folder and is not kept");
        let mend = "copy it into the folder and name it there";
        return Err(StoreError::Damaged { path: PathBuf::from(name), what, mend });
    }
    let made = layout::incoming(root.path, &digest);
    if !root.disk.exists(&made) {
        root.disk.make_dir(&made)?;
    }
    let sums = (layout::SUMS_FILE.to_owned(), text.into_bytes());
    for (name, bytes) in files.iter().chain([&sums]) {
        root.disk.save(&made.join(name), bytes)?;
    }
    root.disk.sync(&made)?;
    root.ensure_dir(layout::INSTALLATIONS)?;
    root.disk.move_durably(&made, &place)?;
    Ok(digest)
}

/// A name without a folder, and not one of ours.
fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let plain = matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None));
    plain && name != layout::SUMS_FILE
}
