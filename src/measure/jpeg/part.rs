//! A picture of which what is wanted is decoded, now and later.

use super::sequential::{ResumableScan, SequentialScan};
use super::{JpegFault, TileSelection, kind, scans};
use crate::raster::Raster;
use crate::tiles::Tiles;

/// A picture of which some is decoded; elsewhere it is black.
pub struct PartialImage {
    raster: Raster,
    /// What is decoded.
    read: Tiles,
    /// How the rest is; `None` where all is decoded.
    passed: Option<ResumableScan>,
}

impl PartialImage {
    /// Of a JPEG, all of which is read; one in several scans is decoded at once.
    pub(super) fn from_jpeg(bytes: &[u8], wanted: &TileSelection) -> Result<Self, JpegFault> {
        let (header, colour) = kind::read_header(bytes)?;
        let coded = bytes.get(header.entropy_data_offset..).unwrap_or_default();
        match SequentialScan::from_header(&header, colour) {
            Some(scan) => {
                let [width, height] = scan.size();
                let read = wanted(width, height);
                let (raster, passed) = scan.decode(coded, &read)?;
                Ok(Self { raster, read, passed: Some(passed) })
            }
            None => scans::decode_luma(bytes, &header, colour).map(Self::from_raster),
        }
    }

    /// Of a picture that is decoded.
    pub fn from_raster(raster: Raster) -> Self {
        Self { read: Tiles::all(raster.width(), raster.height()), raster, passed: None }
    }

    /// Decodes what is wanted and was not yet.
    pub fn decode_tiles(&mut self, mut wanted: Tiles) {
        if let Some(passed) = &self.passed {
            self.read.take_up(&mut wanted);
            passed.decode(&wanted, self.raster.luma_mut());
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

impl AsRef<Raster> for PartialImage {
    fn as_ref(&self) -> &Raster {
        &self.raster
    }
}
