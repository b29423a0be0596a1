//! A flight as one tar archive is laid out beforehand: so it has a length, an ETag and ranges, and the same state gives the
//! same bytes.

use axum::body::Bytes;
use tokio::sync::OwnedSemaphorePermit;

use super::Refusal;
use super::send::{Content, Source};
use crate::store::bundle::{FlightBundle, BundleFile};
use crate::store::layout as store_layout;
use crate::store::receive::Listing;

/// Of a tar file: head and content fill whole blocks, two empty ones end it.
const BLOCK: u64 = 512;

/// The archive of a bundle. `begun_s` dates its files: seconds since 1970.
pub fn layout(
    flight: &str,
    bundle: FlightBundle,
    begun_s: u64,
    permit: OwnedSemaphorePermit,
) -> Result<Content, Refusal> {
    let mut parts = Vec::with_capacity(3 * bundle.items.len() + 1);
    for item in bundle.items {
        parts.push((BLOCK, Source::Bytes(head(&item, begun_s)?)));
        let padding = item.length.next_multiple_of(BLOCK) - item.length;
        parts.push((item.length, item.content.into()));
        parts.push((padding, zeros(padding)));
    }
    parts.push((2 * BLOCK, zeros(2 * BLOCK)));
    Ok(Content {
        parts,
        digest: bundle.digest,
        kind: "application/x-tar",
        save_as: Some(format!("{flight}.tar")),
        by_range: true,
        permit: Some(permit),
    })
}

/// The files of the archive, and where in it their bytes begin.
pub fn listing(flight: &str, bundle: &FlightBundle) -> Listing {
    let mut listing = Listing::from_bundle(flight, bundle);
    let mut at = 0;
    for item in &mut listing.items {
        item.offset = at + BLOCK;
        at = item.offset + item.length.next_multiple_of(BLOCK);
    }
    listing
}

/// The results of a flight's series, one after the other.
pub fn results(flight: &str, bundle: FlightBundle, permit: OwnedSemaphorePermit) -> Content {
    let ours = |item: &BundleFile| item.name.ends_with(store_layout::RESULTS_FILE);
    let items: Vec<BundleFile> = bundle.items.into_iter().filter(ours).collect();
    let digests: String = items.iter().map(|item| format!("{}\n", item.sha256)).collect();
    Content {
        parts: items.into_iter().map(|item| (item.length, item.content.into())).collect(),
        digest: crate::store::sha256_hex(digests.as_bytes()),
        kind: "text/plain; charset=utf-8",
        save_as: Some(format!("{flight}-results.jsonl")),
        by_range: true,
        permit: Some(permit),
    }
}

fn zeros(length: u64) -> Source {
    const ZEROS: [u8; 1024] = [0; 1024];
    let length = usize::try_from(length).unwrap_or(0);
    Source::Bytes(Bytes::from_static(ZEROS.get(..length).unwrap_or_default()))
}

fn head(item: &BundleFile, begun_s: u64) -> Result<Bytes, Refusal> {
    let mut head = tar::Header::new_ustar();
    head.set_path(&item.name).map_err(|e| Refusal::Failed(format!("{}: {e}", item.name)))?;
    head.set_size(item.length);
    head.set_mode(0o644);
    head.set_uid(0);
    head.set_gid(0);
    head.set_mtime(begun_s);
    head.set_entry_type(tar::EntryType::Regular);
    head.set_cksum();
    Ok(Bytes::copy_from_slice(head.as_bytes()))
}
