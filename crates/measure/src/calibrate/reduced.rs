//! Reduced copies of large images, in which boards are found in less time and memory; corners are then measured in the full
//! image.

use crate::raster::Raster;

/// Number of pixels above which a reduced copy is searched first: the finders use about 16 bytes per pixel, and two images
/// are processed at once.
const LARGE: usize = 4_000_000;

/// Averages 2 x 2, 4 x 4, … pixels; returns the copy and its pixel size; `None` if the image is small.
pub(super) fn reduce_image(raster: &Raster) -> (Option<Raster>, f64) {
    let (mut small, mut scale) = (None, 1.0);
    loop {
        let now = small.as_ref().unwrap_or(raster);
        if now.width() * now.height() <= LARGE {
            return (small, scale);
        }
        small = halve_image(now);
        scale *= 2.0;
    }
}

fn halve_image(raster: &Raster) -> Option<Raster> {
    let (width, height) = (raster.width() / 2, raster.height() / 2);
    let mut luma = Vec::with_capacity(width * height);
    for y in 0..height {
        let (above, below) = (raster.row(2 * y), raster.row(2 * y + 1));
        let pairs = above.chunks_exact(2).zip(below.chunks_exact(2));
        luma.extend(pairs.map(|(a, b)| {
            ((u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]) + 2) / 4) as u8
        }));
    }
    Raster::new(width, height, luma)
}

/// Returns a part of the image; `None` if it has no pixels.
#[cfg(feature = "boards")]
pub(super) fn crop_image(
    raster: &Raster,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
) -> Option<Raster> {
    let right = (left + width).min(raster.width());
    let rows = top..(top + height).min(raster.height());
    let luma: Vec<u8> = rows
        .clone()
        .flat_map(|y| raster.row(y).get(left..right).unwrap_or(&[]))
        .copied()
        .collect();
    Raster::new(right.saturating_sub(left), rows.len(), luma)
}
