//! The stages of a flight: announced, its results there, its frames there.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use futures_util::stream::{self, FuturesUnordered, StreamExt, TryStreamExt};

use super::manifest::{self, Manifest, Piece, Stage};
use super::pace::Pace;
use super::{Put, Sent, Target, TargetError, Upload, UploadError};
use crate::store::bundle;
use crate::store::{self, FlightRef, RealDisk, StoreError};

/// A flight whose manifest is there.
pub(super) struct Flight {
    pub manifest: Manifest,
    pub sent: Sent,
    /// In the order in which they are sent.
    pieces: Vec<Piece>,
}

impl Upload<'_> {
    /// Puts a flight's manifest: what exists is known before the rest has come.
    pub(super) async fn announce(&self, flight: &FlightRef, first: bool) -> Result<Flight, UploadError> {
        let bundle = bundle::flight(&RealDisk, self.root, flight)?;
        let manifest = Manifest::of(self.root, flight, self.about, &bundle)?;
        let (key, target) = (manifest.key(), self.target);
        if first {
            target.greet(key.trim_end_matches("/manifest.json")).await?;
        }
        let pieces = manifest.pieces(&bundle);
        let mut sent = Sent::default();
        let there = target.read(&key).await?;
        let manifest = match there.as_deref().map(Manifest::read) {
            Some(Some(there)) => self.agreed(manifest, &there)?,
            Some(None) if !self.repair => return Err(target.different(&key).into()),
            _ => manifest,
        };
        let text = manifest.text();
        let digest = store::sha256(text.as_bytes());
        let length = text.len() as u64;
        let put = match there {
            Some(bytes) if bytes == text.as_bytes() => Put::There,
            Some(_) => {
                sent.repaired += 1;
                target.replace(&key, text.into_bytes(), &digest).await?
            }
            None => target.put(&key, text.into_bytes(), &digest).await?,
        };
        sent.add(put, length);
        Ok(Flight { manifest, sent, pieces })
    }

    /// The manifest as it is published; an error where it is of another state of the flight, or another aircraft's.
    fn agreed(&self, manifest: Manifest, there: &Manifest) -> Result<Manifest, TargetError> {
        let key = manifest.key();
        let Some(agreed) = manifest.agreed_with(there, self.about) else {
            let or_none = |text: &Option<String>| text.clone().unwrap_or_else(|| "none".to_owned());
            let there = format!(
                "aircraft {}, type {}, wing {}",
                there.aircraft,
                or_none(&there.aircraft_type),
                or_none(&there.wing)
            );
            return Err(TargetError::Contradicted { place: self.target.shown(&key), there });
        };
        if agreed == *there { Ok(agreed) } else { Err(self.target.different(&key)) }
    }

    /// Brings everything of a stage there, and its mark.
    pub(super) async fn stage(
        &self,
        flight: &mut Flight,
        stage: Stage,
        pace: &mut Pace,
    ) -> Result<(), UploadError> {
        let target = self.target;
        let there = listed(target, &flight.manifest).await?;
        refuse_foreign(target, &flight.pieces, &there)?;
        let pieces: Vec<&Piece> = flight.pieces.iter().filter(|piece| piece.stage == stage).collect();
        let (known, mut missing): (Vec<&Piece>, Vec<&Piece>) =
            pieces.iter().copied().partition(|piece| there.contains_key(&piece.key));
        let mut sent = flight.sent;
        self.compare(&known, &there, &mut sent).await?;
        let (key, text) = flight.manifest.mark(stage);
        // Frames that were there and are gone were aged by a rule of the bucket.
        if stage == Stage::Frames && !self.repair && target.read(&key).await?.is_some() {
            sent.aged = missing.len();
            missing.clear();
        }
        self.send(&missing, pace, &mut sent).await?;
        if !missing.is_empty() {
            whole(target, &pieces, &listed(target, &flight.manifest).await?)?;
        }
        let (length, digest) = (text.len() as u64, store::sha256(text.as_bytes()));
        let put = match target.put(&key, text.clone().into_bytes(), &digest).await {
            Err(TargetError::Different { .. }) if self.repair => {
                sent.repaired += 1;
                target.replace(&key, text.into_bytes(), &digest).await?
            }
            put => put?,
        };
        sent.add(put, length);
        flight.sent = sent;
        Ok(())
    }

    /// Holds what is there against the flight's digests; what differs is an error, or put again.
    async fn compare(
        &self,
        known: &[&Piece],
        there: &BTreeMap<String, u64>,
        sent: &mut Sent,
    ) -> Result<(), UploadError> {
        let target = self.target;
        let looks = known.iter().map(|piece| async move {
            let fits = there.get(&piece.key) == Some(&piece.length);
            let same = fits && target.same(&piece.key, piece.length, &piece.sha256).await?;
            Result::<_, UploadError>::Ok((*piece, same))
        });
        let mut looked = stream::iter(looks).buffer_unordered(target.settings().jobs);
        let mut damaged = Vec::new();
        while let Some((piece, same)) = looked.try_next().await? {
            match same {
                true => {
                    sent.add(Put::There, piece.length);
                    (self.progress)(piece.length);
                }
                false if self.repair => damaged.push(piece),
                false => return Err(target.different(&piece.key).into()),
            }
        }
        for piece in damaged {
            let put = target.replace(&piece.key, content(piece).await?, &piece.sha256).await?;
            sent.add(put, piece.length);
            sent.repaired += 1;
            (self.progress)(piece.length);
        }
        Ok(())
    }

    /// Sends what is missing, as many objects at a time as the link is quick.
    async fn send(&self, missing: &[&Piece], pace: &mut Pace, sent: &mut Sent) -> Result<(), UploadError> {
        let target = self.target;
        let mut waiting = missing.iter().copied().peekable();
        let mut under_way = FuturesUnordered::new();
        loop {
            while let Some(piece) = waiting.next_if(|next| under_way.len() < pace.at_once(next.length)) {
                under_way.push(async move {
                    let put = target.put(&piece.key, content(piece).await?, &piece.sha256).await?;
                    Result::<_, UploadError>::Ok((put, piece.length))
                });
            }
            let Some((put, length)) = under_way.try_next().await? else { return Ok(()) };
            pace.arrived(length, Instant::now());
            sent.add(put, length);
            (self.progress)(length);
        }
    }
}

/// An object's bytes, held against its file's digest and its own.
async fn content(piece: &Piece) -> Result<Vec<u8>, UploadError> {
    let piece = piece.clone();
    let read = tokio::task::spawn_blocking(move || {
        let mut bytes = manifest::whole(&piece.item)?;
        let from = usize::try_from(piece.offset).unwrap_or(usize::MAX).min(bytes.len());
        bytes.drain(..from);
        bytes.truncate(usize::try_from(piece.length).unwrap_or(usize::MAX));
        Result::<_, StoreError>::Ok(bytes)
    });
    let failed = |error: tokio::task::JoinError| TargetError::Failed {
        place: "upload".to_owned(),
        why: error.to_string(),
    };
    Ok(read.await.map_err(failed)??)
}

async fn listed(target: &Target, manifest: &Manifest) -> Result<BTreeMap<String, u64>, TargetError> {
    let mut all = BTreeMap::new();
    for place in manifest.places() {
        all.extend(target.list(&place).await?);
    }
    Ok(all)
}

/// Objects of another flight's, or of nobody's.
fn refuse_foreign(
    target: &Target,
    pieces: &[Piece],
    there: &BTreeMap<String, u64>,
) -> Result<(), TargetError> {
    let ours: BTreeSet<&String> = pieces.iter().map(|piece| &piece.key).collect();
    match there.keys().find(|key| !ours.contains(*key)) {
        Some(key) => Err(TargetError::Foreign { place: target.shown(key) }),
        None => Ok(()),
    }
}

/// What was said to be there is.
fn whole(target: &Target, pieces: &[&Piece], there: &BTreeMap<String, u64>) -> Result<(), TargetError> {
    match pieces.iter().find(|piece| there.get(&piece.key) != Some(&piece.length)) {
        None => Ok(()),
        Some(piece) => {
            let why = "was put, and is not there with its length; call the command again".to_owned();
            Err(TargetError::Failed { place: target.shown(&piece.key), why })
        }
    }
}
