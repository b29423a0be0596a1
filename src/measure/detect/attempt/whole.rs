//! Whether a blob looks like a whole disc.

use crate::detect::attempt::options::WHOLE;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::propose::moments;
use crate::detect::segment::blob::{self, Blob};
use crate::raster::Raster;

/// Whether a blob is too square for a whole disc of its size.
pub fn looks_cut(blob: &Blob) -> bool {
    let minor = Ellipse::from_blob(blob).minor.max(WHOLE.thin_px);
    moments::squareness(blob) / (WHOLE.square.0 + WHOLE.square.1 / (minor * minor)) > 1.0
}

/// Grey values of a blob and of the skin about it.
fn levels(image: &Raster, blob: &Blob) -> Option<(usize, usize)> {
    let (low, high) = blob::enlarged_box(&Ellipse::from_blob(blob), WHOLE.beside_px);
    let about = Histogram::of(image.part(low, high, 1).map(|(_, _, value)| value));
    let own = blob.runs.iter().flat_map(|&[y, from, to]| {
        image.row(y as usize).iter().take(to as usize + 1).skip(from as usize).copied()
    });
    let (black, usual) = (Histogram::of(own).median()?, about.median()?);
    // Between close neighbours most of what is about is as black.
    let lightest = about.at(about.total() * 9 / 10)?;
    Some((black, if usual < black.midpoint(lightest) { lightest } else { usual }))
}

/// The hypothesis of a disc that only looks cut because its threshold followed a background that something beside it
/// lowers, as a line at its tip does: seen once more against one level.
pub fn at_one_level(image: &Raster, blob: &Blob, index: usize) -> Option<Hypothesis> {
    let seen = Ellipse::from_blob(blob);
    let (black, skin) = levels(image, blob)?;
    let found = blob::dark_parts(image, &seen, WHOLE.beside_px, black.midpoint(skin) as u8);
    moments::disc_from_blob(index, found.iter().find(|blob| !looks_cut(blob))?)
}
