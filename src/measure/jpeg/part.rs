//! A picture of which what is wanted is decoded, now and later.

use super::sequential::{Passed, Scan};
use super::{JpegFault, Wanted, kind, scans};
use crate::raster::Raster;
use crate::tiles::Tiles;

/// A picture of which some is decoded; elsewhere it is black.
pub struct Part {
    raster: Raster,
    /// What is decoded.
    read: Tiles,
    /// How the rest is; `None` where all is decoded.
    passed: Option<Passed>,
}

impl Part {
    /// Of a JPEG, all of which is read; one in several scans is decoded at once.
    pub(super) fn of(bytes: &[u8], wanted: &Wanted) -> Result<Self, JpegFault> {
        let (header, colour) = kind::header(bytes)?;
        let coded = bytes.get(header.entropy_data_offset..).unwrap_or_default();
        match Scan::of(&header, colour) {
            Some(scan) => {
                let [width, height] = scan.size();
                let read = wanted(width, height);
                let (raster, passed) = scan.decode(coded, &read)?;
                Ok(Self { raster, read, passed: Some(passed) })
            }
            None => scans::luma(bytes, &header, colour).map(Self::whole),
        }
    }

    /// Of a picture that is decoded.
    pub fn whole(raster: Raster) -> Self {
        Self { read: Tiles::all(raster.width(), raster.height()), raster, passed: None }
    }

    /// Decodes what is wanted and was not yet.
    pub fn read(&mut self, mut wanted: Tiles) {
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

impl AsRef<Raster> for Part {
    fn as_ref(&self) -> &Raster {
        &self.raster
    }
}
