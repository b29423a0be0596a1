//! JPEG decoder: bytes in, grey values out.
//!
//! | file | subject |
//! |---|---|
//! | `header` | supported kinds of JPEG; plausibility of the header |
//! | `partial` | image of which selected tiles are decoded, now and later |
//! | `sequential` | one sequential scan, as cameras write it |
//! | `codes` | its codes, read or skipped |
//! | `scans` | progressive images, and scans of one component each |
//! | `coefficients` | coefficients collected until the last scan |
//! | `dnl` | height given after the first scan |
//! | `intervals` | scan split at its restart markers |

mod codes;
mod coefficients;
mod dnl;
pub mod header;
mod intervals;
mod partial;
pub mod scans;
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
    let image = PartialImage::from_jpeg(bytes, wanted);
    let damaged = matches!(image, Err(JpegFault::Damaged(_)));
    // If it cannot be read as it is, its height may be given after the first scan.
    match if damaged {
        dnl::resolve_height(bytes)
    } else {
        None
    } {
        Some(whole) => PartialImage::from_jpeg(&whole?, wanted),
        None => image,
    }
}
