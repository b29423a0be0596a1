//! Partially decoded image: selected tiles are decoded now, others later.

use super::sequential::{ResumableScan, SequentialScan};
use super::{JpegFault, TileSelection, header, scans};
use crate::raster::Raster;
use crate::tiles::Tiles;

/// Image of which some tiles are decoded; the others are black.
pub struct PartialImage {
    raster: Raster,
    /// Tiles decoded so far.
    decoded: Tiles,
    /// Data of the other tiles; `None` if all are decoded.
    rest: Option<ResumableScan>,
}

impl PartialImage {
    /// Reads a JPEG and decodes the tiles wanted; an image in several scans is decoded completely.
    pub(super) fn from_jpeg(bytes: &[u8], wanted: &TileSelection) -> Result<Self, JpegFault> {
        let (header, colour) = header::read_header(bytes)?;
        let coded = bytes.get(header.entropy_data_offset..).unwrap_or_default();
        match SequentialScan::from_header(&header, colour) {
            Some(scan) => {
                let [width, height] = scan.size();
                let decoded = wanted(width, height);
                let (raster, rest) = scan.decode(coded, &decoded)?;
                Ok(Self {
                    raster,
                    decoded,
                    rest: Some(rest),
                })
            }
            None => scans::decode_luma(bytes, &header, colour).map(Self::from_raster),
        }
    }

    /// Wraps an image that is completely decoded.
    pub fn from_raster(raster: Raster) -> Self {
        Self {
            decoded: Tiles::all(raster.width(), raster.height()),
            raster,
            rest: None,
        }
    }

    /// Decodes the tiles wanted that are not decoded yet.
    pub fn decode_tiles(&mut self, mut wanted: Tiles) {
        if let Some(rest) = &self.rest {
            self.decoded.merge_new(&mut wanted);
            rest.decode(&wanted, self.raster.luma_mut());
        }
    }

    /// Returns the image as far as it is decoded.
    pub fn raster(&self) -> &Raster {
        &self.raster
    }

    /// Converts to the image as far as it is decoded.
    pub fn into_raster(self) -> Raster {
        self.raster
    }
}

impl AsRef<Raster> for PartialImage {
    fn as_ref(&self) -> &Raster {
        &self.raster
    }
}
