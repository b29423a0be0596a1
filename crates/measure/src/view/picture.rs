//! The picture of a frame, decoded as far as a search needs it.

use crate::detect::{self, MarkerPrediction};
use crate::jpeg::PartialImage;
use crate::raster::Raster;
use crate::tiles::Tiles;

/// Picture of a frame of which parts can be requested.
pub trait Picture {
    /// Returns the picture as far as it is decoded.
    fn raster(&self) -> &Raster;

    /// Decodes tiles that are not decoded yet.
    fn decode_tiles(&mut self, wanted: Tiles);

    /// Returns the picture with the surroundings of predicted markers decoded.
    fn decode_around(&mut self, predictions: &[MarkerPrediction]) -> &Raster {
        let (width, height) = (self.raster().width(), self.raster().height());
        self.decode_tiles(detect::tiles_read(predictions, width, height));
        self.raster()
    }

    /// Returns the complete picture.
    fn decode_all(&mut self) -> &Raster {
        let all = Tiles::all(self.raster().width(), self.raster().height());
        self.decode_tiles(all);
        self.raster()
    }
}

impl Picture for &Raster {
    fn raster(&self) -> &Raster {
        self
    }

    fn decode_tiles(&mut self, _: Tiles) {}

    fn decode_around(&mut self, _: &[MarkerPrediction]) -> &Raster {
        self
    }
}

impl Picture for PartialImage {
    fn raster(&self) -> &Raster {
        PartialImage::raster(self)
    }

    fn decode_tiles(&mut self, wanted: Tiles) {
        PartialImage::decode_tiles(self, wanted);
    }
}
