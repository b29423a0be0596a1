//! JPEG decoder: bytes in, grey values out.
//!
//! | file | subject |
//! |---|---|
//! | `header` | supported kinds of JPEG; plausibility of the header |
//! | `partial` | image of which selected tiles are decoded, now and later |
//! | `sequential` | one sequential scan, as cameras write it |
//! | `codes` | its codes, read or skipped |
//! | `intervals` | scan split at its restart markers |
//!
//! Only sequential images in one scan are read: in the scans of others data can be missing without a sign (of 120 cuts of 16
//! to 1200 bytes in small progressive files, a decoder that refuses every improper code took 3 to 15 as whole).

mod codes;
pub mod header;
mod intervals;
mod partial;
mod sequential;

pub use partial::PartialImage;

use crate::tiles::Tiles;

/// Reason why a JPEG cannot be decoded.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JpegFault {
    /// Truncated or damaged file.
    #[error("damaged or cut short ({0})")]
    Damaged(String),
    /// Complete file of an unsupported kind.
    #[error("unsupported kind of JPEG ({0})")]
    Unsupported(String),
}

/// Largest side that is decoded, px: larger ones are more likely a damaged header than a camera.
pub const MAX_SIDE: usize = 30_000;

/// Function that selects the tiles to decode for an image of some width and height, px.
pub type TileSelection<'a> = dyn Fn(usize, usize) -> Tiles + 'a;

/// Decodes the tiles selected by `wanted`. All data are read, so that damage anywhere is detected.
///
/// # Errors
/// Returns an error if the file is damaged or of an unsupported kind.
pub fn decode_partial(bytes: &[u8], wanted: &TileSelection) -> Result<PartialImage, JpegFault> {
    PartialImage::from_jpeg(bytes, wanted)
}
