//! A flight as one tar archive whose layout is computed before sending: it has a length, an ETag and byte ranges, and the
//! same state of the flight always gives the same bytes.

use axum::body::Bytes;
use tokio::sync::OwnedSemaphorePermit;

use super::Refusal;
use super::send::{Content, ContentSource};
use wingd_store::bundle::{BundleFile, FlightBundle};
use wingd_store::receive::Listing;

/// Size of a tar block, bytes: header and content fill whole blocks, and two empty blocks end the archive.
const BLOCK_BYTES: u64 = 512;

/// Returns the tar archive of a bundle. `begun_s` dates its files: seconds since 1970.
pub fn tar_content(
    flight: &str,
    bundle: FlightBundle,
    begun_s: u64,
    permit: OwnedSemaphorePermit,
) -> Result<Content, Refusal> {
    let mut parts = Vec::with_capacity(3 * bundle.items.len() + 1);
    for item in bundle.items {
        parts.push((
            BLOCK_BYTES,
            ContentSource::Bytes(build_tar_header(&item, begun_s)?),
        ));
        let padding = item.length.next_multiple_of(BLOCK_BYTES) - item.length;
        parts.push((item.length, item.content.into()));
        parts.push((padding, zero_padding(padding)));
    }
    parts.push((2 * BLOCK_BYTES, zero_padding(2 * BLOCK_BYTES)));
    Ok(Content {
        parts,
        digest: bundle.digest,
        kind: "application/x-tar",
        save_as: Some(format!("{flight}.tar")),
        by_range: true,
        permit: Some(permit),
    })
}

/// Returns the files of the archive with the offsets of their bytes in it.
pub fn archive_listing(flight: &str, bundle: &FlightBundle) -> Listing {
    let mut listing = Listing::from_bundle(flight, bundle);
    let mut at = 0;
    for item in &mut listing.items {
        item.offset = at + BLOCK_BYTES;
        at = item.offset + item.length.next_multiple_of(BLOCK_BYTES);
    }
    listing
}

fn zero_padding(length: u64) -> ContentSource {
    const ZEROS: [u8; 1024] = [0; 1024];
    let length = usize::try_from(length).unwrap_or(0);
    ContentSource::Bytes(Bytes::from_static(ZEROS.get(..length).unwrap_or_default()))
}

fn build_tar_header(item: &BundleFile, begun_s: u64) -> Result<Bytes, Refusal> {
    let mut head = tar::Header::new_ustar();
    head.set_path(&item.name)
        .map_err(|e| Refusal::Failed(format!("{}: {e}", item.name)))?;
    head.set_size(item.length);
    head.set_mode(0o644);
    head.set_uid(0);
    head.set_gid(0);
    head.set_mtime(begun_s);
    head.set_entry_type(tar::EntryType::Regular);
    head.set_cksum();
    Ok(Bytes::copy_from_slice(head.as_bytes()))
}
