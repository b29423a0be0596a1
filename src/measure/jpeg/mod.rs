//! A JPEG's bytes to its grey values.
//!
//! | file | subject |
//! |---|---|
//! | `kind` | which JPEGs are read; a header that is sound |
//! | `part` | what is wanted of a picture, now and later |
//! | `sequential` | one sequential scan, as cameras write it |
//! | `codes` | its codes, read or passed over |
//! | `scans` | progressive pictures, and scans of one component each |
//! | `coefficients` | what scans have given until the last of them is read |
//! | `dnl` | a height that stands behind the first scan |
//! | `intervals` | a scan, cut at its restart markers |

mod codes;
mod coefficients;
mod dnl;
mod intervals;
pub mod kind;
mod part;
pub mod scans;
mod sequential;

pub use part::PartialImage;

use crate::tiles::Tiles;

/// Why a JPEG is not read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JpegFault {
    /// It is cut short or damaged.
    #[error("damaged or cut short ({0})")]
    Damaged(String),
    /// It is whole, and of a kind that is not read.
    #[error("of a kind that is not read ({0})")]
    Kind(String),
}

/// Largest side that is decoded, px: beyond it a damaged header is likelier than a camera.
pub const MAX_SIDE: usize = 30_000;

/// What is wanted of a picture of some width and height, px.
pub type TileSelection<'a> = dyn Fn(usize, usize) -> Tiles + 'a;

/// The picture, of which what is `wanted` is decoded; all is read, and damage anywhere noticed.
///
/// # Errors
/// Where it is damaged, or of a kind that is not read.
pub fn decode_partial(bytes: &[u8], wanted: &TileSelection) -> Result<PartialImage, JpegFault> {
    let read = PartialImage::from_jpeg(bytes, wanted);
    let damaged = matches!(read, Err(JpegFault::Damaged(_)));
    // Where it cannot be read as it is, perhaps its height stands behind its first scan.
    match if damaged { dnl::resolve_height(bytes) } else { None } {
        Some(whole) => PartialImage::from_jpeg(&whole?, wanted),
        None => read,
    }
}
