//! A JPEG's bytes to its grey values.
//!
//! | file | subject |
//! |---|---|
//! | `kind` | which JPEGs are read; a header that is sound |
//! | `sequential` | one sequential scan, as cameras write it: at once, or read through and decoded in part |
//! | `codes` | its codes, read or passed over |
//! | `scans` | progressive pictures, and scans of one component each |
//! | `coefficients` | what scans have given until the last of them is read |
//! | `dnl` | a height that stands behind the first scan |
//! | `intervals` | a scan, cut at its restart markers |

use std::ops::Range;

mod codes;
mod coefficients;
mod dnl;
mod intervals;
pub mod kind;
pub mod scans;
pub mod sequential;

use libjpeg_turbo_rs::decode::marker::JpegMetadata;

use self::kind::Colour;
use self::sequential::Scan;
use crate::raster::Raster;

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

/// A picture of which what is wanted is decoded, now and later; elsewhere it is black.
pub struct Part {
    raster: Raster,
    /// What is not decoded yet; `None` where all is.
    passed: Option<sequential::Passed>,
}

impl Part {
    /// Of a JPEG, all of which is read: damage anywhere is noticed. One in several scans is decoded at once.
    pub fn of(bytes: &[u8]) -> Result<Self, JpegFault> {
        resolved(bytes, |bytes| {
            let (header, colour) = kind::header(bytes)?;
            let Some((scan, coded)) = one_scan(bytes, &header, colour) else {
                return scans::luma(bytes, &header, colour).map(Self::whole);
            };
            let [width, height] = scan.size();
            let passed = Some(scan.pass_over(coded)?);
            Ok(Self { raster: raster(width, height, vec![0; width * height])?, passed })
        })
    }

    /// Of a picture that is decoded.
    pub fn whole(raster: Raster) -> Self {
        Self { raster, passed: None }
    }

    /// Decodes of each pixel row at least some columns.
    pub fn read(&mut self, columns: &[Range<usize>]) {
        if let Some(passed) = &mut self.passed {
            passed.decode(columns, self.raster.luma_mut());
        }
    }

    /// As far as it is decoded.
    pub fn raster(&self) -> &Raster {
        &self.raster
    }

    /// The same.
    pub fn into_raster(self) -> Raster {
        self.raster
    }
}

impl AsRef<Raster> for Part {
    fn as_ref(&self) -> &Raster {
        &self.raster
    }
}

/// The grey values.
pub fn luma(bytes: &[u8]) -> Result<Raster, JpegFault> {
    resolved(bytes, |bytes| {
        let (header, colour) = kind::header(bytes)?;
        let Some((scan, coded)) = one_scan(bytes, &header, colour) else {
            return scans::luma(bytes, &header, colour);
        };
        let [width, height] = scan.size();
        raster(width, height, scan.decode(coded)?)
    })
}

/// A picture in one scan, and its coded bytes with what follows them; `None` where it is of another kind.
pub fn one_scan<'a>(bytes: &'a [u8], header: &JpegMetadata, colour: Colour) -> Option<(Scan, &'a [u8])> {
    Some((Scan::of(header, colour)?, bytes.get(header.entropy_data_offset..)?))
}

fn raster(width: usize, height: usize, luma: Vec<u8>) -> Result<Raster, JpegFault> {
    Raster::new(width, height, luma).ok_or_else(|| intervals::damaged("it has no pixels"))
}

/// What is read; where that cannot be as it is, perhaps its height stands behind its first scan.
fn resolved<T>(bytes: &[u8], read: impl Fn(&[u8]) -> Result<T, JpegFault>) -> Result<T, JpegFault> {
    let first = read(bytes);
    let damaged = matches!(first, Err(JpegFault::Damaged(_)));
    match if damaged { dnl::resolved(bytes) } else { None } {
        Some(whole) => read(&whole?),
        None => first,
    }
}
