//! Smaller copies of large pictures, in which boards are found in less time and memory; corners are then
//! measured in the picture itself.

use crate::raster::Raster;

/// Pixels above which a smaller copy is searched first: the finders hold some 16 bytes a pixel, and
/// two pictures are worked on at once.
const LARGE: usize = 4_000_000;

/// A copy by 2 x 2 means, or 4 x 4 and so on, and its pixel's side; `None` where the picture is small.
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

/// A part of the picture; `None` where it has no pixels.
#[cfg(feature = "aprilgrid")]
pub(super) fn crop_image(raster: &Raster, left: usize, top: usize, width: usize, height: usize) -> Option<Raster> {
    let right = (left + width).min(raster.width());
    let rows = top..(top + height).min(raster.height());
    let luma: Vec<u8> =
        rows.clone().flat_map(|y| raster.row(y).get(left..right).unwrap_or(&[])).copied().collect();
    Raster::new(right.saturating_sub(left), rows.len(), luma)
}
