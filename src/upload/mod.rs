//! Flights into an object store (S3, or a directory): for `wingd upload`.
//!
//! Every object is put only where none is, with its SHA-256, and the flight's manifest last. Readers take a
//! flight for there when its manifest is: of one that was broken off nothing is published, and the same
//! command goes on with what is missing.

mod manifest;
mod target;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use futures_util::stream::{self, StreamExt, TryStreamExt};

pub use manifest::{Aircraft, Manifest};
pub use target::{Put, Settings, Target, TargetError};

use crate::store::bundle::{self, Content, Item};
use crate::store::{self, Disk, FlightRef, RealDisk, StoreError, catalogue};

/// Why a flight is not published.
#[derive(Debug, thiserror::Error)]
pub enum UploadError {
    /// The flight is not sound here.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The other side did not do its part.
    #[error(transparent)]
    Target(#[from] TargetError),
}

impl UploadError {
    /// Whether other flights will meet the same: the other side cannot be reached, or refuses us.
    pub fn concerns_all(&self) -> bool {
        matches!(self, Self::Target(TargetError::Failed { .. }))
    }
}

/// What was done for a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sent {
    /// Objects of the flight, its manifest among them.
    pub objects: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Objects that this call put.
    pub sent: usize,
    /// Their bytes.
    pub sent_bytes: u64,
}

impl Sent {
    fn add(&mut self, put: Put, length: u64) {
        self.objects += 1;
        self.bytes += length;
        if put == Put::Sent {
            self.sent += 1;
            self.sent_bytes += length;
        }
    }
}

/// Puts a flight's files, then its manifest. `progress` gets the length of each file that is there, and of all.
pub async fn flight(
    target: &Target,
    root: &Path,
    flight: &FlightRef,
    aircraft: &Aircraft,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<(Sent, Manifest), UploadError> {
    let recorder = catalogue::store_id(&RealDisk, root).ok_or_else(|| no_id(root))?;
    let bundle = bundle::flight(&RealDisk, root, flight)?;
    let manifest = Manifest::of(&recorder, aircraft, flight, &bundle)?;
    let published = target.read(&manifest.key()).await?;
    if published.as_ref().is_some_and(|bytes| **bytes != *manifest.text().as_bytes()) {
        return Err(TargetError::different(target, &manifest.key()).into());
    }
    let there = target.list(&manifest.place()).await?;
    refuse_foreign(target, &manifest, &there)?;
    // Where the manifest is, each file's digest was compared before it came.
    let trusted = published.is_some();
    let manifest = &manifest;
    let puts = bundle.items.iter().map(|item| {
        let (key, length) = (manifest.object(&item.name), item.length);
        let known = there.get(&key).copied();
        async move {
            let put = match known {
                Some(size) if trusted && size == length => Put::There,
                Some(_) => target.compare(&key, length, &item.sha256).await?,
                None => target.put(&key, content(item).await?, &item.sha256).await?,
            };
            progress(length, manifest.bytes);
            Result::<_, UploadError>::Ok((put, length))
        }
    });
    let mut sent = Sent::default();
    let mut done = stream::iter(puts).buffer_unordered(target.settings().jobs);
    while let Some((put, length)) = done.try_next().await? {
        sent.add(put, length);
    }
    whole(target, manifest).await?;
    let text = manifest.text();
    let put = target.put(&manifest.key(), text.clone().into_bytes(), &store::sha256(text.as_bytes())).await?;
    sent.add(put, text.len() as u64);
    Ok((sent, manifest.clone()))
}

/// A file's bytes, of the state that the bundle is; they are the ones that the chain knows, or none.
async fn content(item: &Item) -> Result<Vec<u8>, UploadError> {
    let item = item.clone();
    let read = tokio::task::spawn_blocking(move || {
        let (bytes, path) = match item.content {
            Content::Bytes(bytes) => (bytes, item.name.into()),
            Content::File(path) => {
                let mut bytes = RealDisk.read(&path).map_err(StoreError::io(&path, "read"))?;
                bytes.truncate(usize::try_from(item.length).unwrap_or(usize::MAX));
                (bytes, path)
            }
        };
        if store::sha256(&bytes) == item.sha256 {
            return Ok(bytes);
        }
        let what = "has other bytes than its SHA-256 is of, and the flight is not published".to_owned();
        Err(StoreError::Damaged { path, what, mend: "take it from a copy; `wingd verify` says what else" })
    });
    let failed = |error: tokio::task::JoinError| TargetError::Failed {
        place: "upload".to_owned(),
        why: error.to_string(),
    };
    Ok(read.await.map_err(failed)??)
}

/// Objects of another flight's, or of nobody's.
fn refuse_foreign(
    target: &Target,
    manifest: &Manifest,
    there: &BTreeMap<String, u64>,
) -> Result<(), TargetError> {
    let ours: BTreeSet<String> = manifest.objects().map(|(key, _)| key).collect();
    match there.keys().find(|key| !ours.contains(*key)) {
        Some(key) => Err(TargetError::Foreign { place: target.shown(key) }),
        None => Ok(()),
    }
}

/// Looks once more, that what was said to be there is.
async fn whole(target: &Target, manifest: &Manifest) -> Result<(), TargetError> {
    let there = target.list(&manifest.place()).await?;
    for (key, length) in manifest.objects() {
        if there.get(&key) != Some(&length) {
            let why = "was put, and is not there with its length; call the command again".to_owned();
            return Err(TargetError::Failed { place: target.shown(&key), why });
        }
    }
    refuse_foreign(target, manifest, &there)
}

fn no_id(root: &Path) -> StoreError {
    StoreError::Damaged {
        path: root.to_owned(),
        what: "is of format 1 and has no id that would tell its flights from those of other recorders".into(),
        mend: "`wingd verify --upgrade` gives it one",
    }
}
