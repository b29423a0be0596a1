//! Recognition of blobs that look like whole discs.

use crate::detect::attempt::options::WHOLE;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::propose::moments;
use crate::detect::segment::blob::{self, Blob};
use crate::raster::Raster;

/// Returns whether a blob is too square for a whole disc of its size.
pub fn looks_cut(blob: &Blob) -> bool {
    let minor = Ellipse::from_blob(blob).minor.max(WHOLE.min_axis_px);
    moments::squareness(blob) / (WHOLE.max_squareness + WHOLE.max_squareness_px2 / (minor * minor))
        > 1.0
}

/// Returns the grey values of a blob and of the skin around it.
fn grey_levels(image: &Raster, blob: &Blob) -> Option<(usize, usize)> {
    let (low, high) = blob::enlarged_box(&Ellipse::from_blob(blob), WHOLE.margin_px);
    let about =
        Histogram::from_values(image.pixels_in_box(low, high, 1).map(|(_, _, value)| value));
    let own = blob.runs.iter().flat_map(|&[y, from, to]| {
        image
            .row(y as usize)
            .iter()
            .take(to as usize + 1)
            .skip(from as usize)
            .copied()
    });
    let (black, typical) = (Histogram::from_values(own).median()?, about.median()?);
    // Between close neighbours most of the surroundings are as black.
    let lightest = about.value_at_rank(about.total() * 9 / 10)?;
    Some((
        black,
        if typical < black.midpoint(lightest) {
            lightest
        } else {
            typical
        },
    ))
}

/// Segments a disc again at one threshold that only looks cut because its local threshold followed a lower background, for
/// example due to a line at its tip.
pub fn resegment_at_one_level(image: &Raster, blob: &Blob, index: usize) -> Option<Hypothesis> {
    let seen = Ellipse::from_blob(blob);
    let (black, skin) = grey_levels(image, blob)?;
    let found = blob::dark_parts(image, &seen, WHOLE.margin_px, black.midpoint(skin) as u8);
    moments::disc_from_blob(index, found.iter().find(|blob| !looks_cut(blob))?)
}
