//! A JPEG's bytes to its grey values.
//!
//! | file | subject |
//! |---|---|
//! | `kind` | which JPEGs are read; a header that is sound |
//! | `sequential` | one sequential scan, as cameras write it: one pass |
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
pub mod scans;
pub mod sequential;

use crate::raster::Raster;
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
pub const LARGEST_SIDE: usize = 30_000;

/// What is wanted of a picture of some width and height, px.
pub type Wanted<'a> = dyn Fn(usize, usize) -> Tiles + 'a;

/// The grey values; where it cannot be read as it is, perhaps its height stands behind its first scan.
pub fn luma(bytes: &[u8], wanted: Option<&Wanted>) -> Result<Raster, JpegFault> {
    let read = sequential::luma(bytes, wanted);
    let damaged = matches!(read, Err(JpegFault::Damaged(_)));
    match if damaged { dnl::resolved(bytes) } else { None } {
        Some(whole) => sequential::luma(&whole?, wanted),
        None => read,
    }
}
