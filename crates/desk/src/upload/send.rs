//! Stages of uploading a flight: manifest, results, frames.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use futures_util::stream::{self, FuturesUnordered, StreamExt, TryStreamExt};

use super::manifest::{self, UploadManifest, UploadObject, UploadStage};
use super::pace::SendPace;
use super::{PutOutcome, TargetError, Upload, UploadCounts, UploadError, UploadTarget};
use wingd_store as store;
use wingd_store::bundle;
use wingd_store::{FlightRef, RealDisk, StoreError};

/// Flight whose manifest is published.
pub(super) struct FlightUpload {
    pub manifest: UploadManifest,
    pub sent: UploadCounts,
    /// Objects in sending order.
    pieces: Vec<UploadObject>,
}

impl Upload<'_> {
    /// Publishes a flight's manifest, so that the flight is known before its data arrive.
    pub(super) async fn publish_manifest(
        &self,
        flight: &FlightRef,
        first: bool,
    ) -> Result<FlightUpload, UploadError> {
        let bundle = bundle::bundle_flight(&RealDisk, self.root, flight)?;
        let manifest = UploadManifest::from_bundle(self.root, flight, self.labels, &bundle)?;
        let (key, target) = (manifest.key(), self.target);
        if first {
            target
                .check_access(key.trim_end_matches("/manifest.json"))
                .await?;
        }
        let pieces = manifest.upload_objects(&bundle);
        let mut sent = UploadCounts::default();
        let there = target.read_object(&key).await?;
        let manifest = match there.as_deref().map(UploadManifest::parse_sealed) {
            Some(Some(there)) => self.adopt_published(manifest, &there)?,
            Some(None) if !self.repair => return Err(target.different_error(&key).into()),
            _ => manifest,
        };
        let text = manifest.json_text();
        let digest = store::sha256_hex(text.as_bytes());
        let length = text.len() as u64;
        let put = match there {
            Some(bytes) if bytes == text.as_bytes() => PutOutcome::AlreadyPresent,
            Some(_) => {
                sent.repaired += 1;
                target
                    .replace_object(&key, text.into_bytes(), &digest)
                    .await?
            }
            None => target.put_object(&key, text.into_bytes(), &digest).await?,
        };
        sent.count_put(put, length);
        Ok(FlightUpload {
            manifest,
            sent,
            pieces,
        })
    }

    /// Returns the manifest with the labels of the published one.
    ///
    /// # Errors
    /// Returns an error if the published one describes another state of the flight, or another aircraft.
    fn adopt_published(
        &self,
        manifest: UploadManifest,
        there: &UploadManifest,
    ) -> Result<UploadManifest, TargetError> {
        let key = manifest.key();
        let Some(agreed) = manifest.adopt_labels(there, self.labels) else {
            let or_none = |text: &Option<String>| text.clone().unwrap_or_else(|| "none".to_owned());
            let there = format!(
                "aircraft {}, type {}, wing {}",
                there.aircraft,
                or_none(&there.aircraft_type),
                or_none(&there.wing)
            );
            return Err(TargetError::Contradicted {
                url: self.target.display_url(&key),
                published: there,
            });
        };
        if agreed == *there {
            Ok(agreed)
        } else {
            Err(self.target.different_error(&key))
        }
    }

    /// Uploads all objects of a stage, then its completion object.
    pub(super) async fn upload_stage(
        &self,
        flight: &mut FlightUpload,
        stage: UploadStage,
        pace: &mut SendPace,
    ) -> Result<(), UploadError> {
        let target = self.target;
        let there = list_objects(target, &flight.manifest).await?;
        refuse_foreign(target, &flight.pieces, &there)?;
        let pieces: Vec<&UploadObject> = flight
            .pieces
            .iter()
            .filter(|piece| piece.stage == stage)
            .collect();
        let (known, mut missing): (Vec<&UploadObject>, Vec<&UploadObject>) = pieces
            .iter()
            .copied()
            .partition(|piece| there.contains_key(&piece.key));
        let mut sent = flight.sent;
        self.compare_objects(&known, &there, &mut sent).await?;
        let (key, text) = flight.manifest.completion_object(stage);
        // Frames that had arrived and are missing were deleted by a lifecycle rule of the bucket.
        if stage == UploadStage::Frames && !self.repair && target.read_object(&key).await?.is_some()
        {
            sent.expired = missing.len();
            missing.clear();
        }
        self.send_objects(&missing, pace, &mut sent).await?;
        if !missing.is_empty() {
            check_arrived(
                target,
                &pieces,
                &list_objects(target, &flight.manifest).await?,
            )?;
        }
        let (length, digest) = (text.len() as u64, store::sha256_hex(text.as_bytes()));
        let put = match target
            .put_object(&key, text.clone().into_bytes(), &digest)
            .await
        {
            Err(TargetError::Different { .. }) if self.repair => {
                sent.repaired += 1;
                target
                    .replace_object(&key, text.into_bytes(), &digest)
                    .await?
            }
            put => put?,
        };
        sent.count_put(put, length);
        flight.sent = sent;
        Ok(())
    }

    /// Compares existing objects with the flight's digests; a difference is an error, or is repaired.
    async fn compare_objects(
        &self,
        known: &[&UploadObject],
        there: &BTreeMap<String, u64>,
        sent: &mut UploadCounts,
    ) -> Result<(), UploadError> {
        let target = self.target;
        let comparisons = known.iter().map(|piece| async move {
            let fits = there.get(&piece.key) == Some(&piece.length);
            let same = fits
                && target
                    .has_digest(&piece.key, piece.length, &piece.sha256)
                    .await?;
            Result::<_, UploadError>::Ok((*piece, same))
        });
        let mut compared = stream::iter(comparisons).buffer_unordered(target.settings().jobs);
        let mut damaged = Vec::new();
        while let Some((piece, same)) = compared.try_next().await? {
            match same {
                true => {
                    sent.count_put(PutOutcome::AlreadyPresent, piece.length);
                    (self.progress)(piece.length);
                }
                false if self.repair => damaged.push(piece),
                false => return Err(target.different_error(&piece.key).into()),
            }
        }
        for piece in damaged {
            let put = target
                .replace_object(&piece.key, read_object(piece).await?, &piece.sha256)
                .await?;
            sent.count_put(put, piece.length);
            sent.repaired += 1;
            (self.progress)(piece.length);
        }
        Ok(())
    }

    /// Sends missing objects concurrently, as far as the measured rate permits.
    async fn send_objects(
        &self,
        missing: &[&UploadObject],
        pace: &mut SendPace,
        sent: &mut UploadCounts,
    ) -> Result<(), UploadError> {
        let target = self.target;
        let mut waiting = missing.iter().copied().peekable();
        let mut under_way = FuturesUnordered::new();
        loop {
            while let Some(piece) =
                waiting.next_if(|next| under_way.len() < pace.max_concurrent(next.length))
            {
                under_way.push(async move {
                    let put = target
                        .put_object(&piece.key, read_object(piece).await?, &piece.sha256)
                        .await?;
                    Result::<_, UploadError>::Ok((put, piece.length))
                });
            }
            let Some((put, length)) = under_way.try_next().await? else {
                return Ok(());
            };
            pace.record_object(length, Instant::now());
            sent.count_put(put, length);
            (self.progress)(length);
        }
    }
}

/// Reads the bytes of an object, after checking the digest of its file.
async fn read_object(piece: &UploadObject) -> Result<Vec<u8>, UploadError> {
    let piece = piece.clone();
    let read = tokio::task::spawn_blocking(move || {
        let mut bytes = manifest::read_verified(&piece.file)?;
        let from = usize::try_from(piece.offset)
            .unwrap_or(usize::MAX)
            .min(bytes.len());
        bytes.drain(..from);
        bytes.truncate(usize::try_from(piece.length).unwrap_or(usize::MAX));
        Result::<_, StoreError>::Ok(bytes)
    });
    let failed = |error: tokio::task::JoinError| TargetError::Failed {
        url: "upload".to_owned(),
        reason: error.to_string(),
    };
    Ok(read.await.map_err(failed)??)
}

async fn list_objects(
    target: &UploadTarget,
    manifest: &UploadManifest,
) -> Result<BTreeMap<String, u64>, TargetError> {
    let mut all = BTreeMap::new();
    for place in manifest.key_prefixes() {
        all.extend(target.list_keys(&place).await?);
    }
    Ok(all)
}

/// Refuses objects that do not belong to the flight.
fn refuse_foreign(
    target: &UploadTarget,
    pieces: &[UploadObject],
    there: &BTreeMap<String, u64>,
) -> Result<(), TargetError> {
    let own_keys: BTreeSet<&String> = pieces.iter().map(|piece| &piece.key).collect();
    match there.keys().find(|key| !own_keys.contains(*key)) {
        Some(key) => Err(TargetError::Foreign {
            url: target.display_url(key),
        }),
        None => Ok(()),
    }
}

/// Checks that the sent objects have arrived completely.
fn check_arrived(
    target: &UploadTarget,
    pieces: &[&UploadObject],
    there: &BTreeMap<String, u64>,
) -> Result<(), TargetError> {
    match pieces
        .iter()
        .find(|piece| there.get(&piece.key) != Some(&piece.length))
    {
        None => Ok(()),
        Some(piece) => {
            let why =
                "was uploaded, but is not there with its length; run the command again".to_owned();
            Err(TargetError::Failed {
                url: target.display_url(&piece.key),
                reason: why,
            })
        }
    }
}
