//! Reduction of a frame for display.

use wingd_measure::raster::Raster;

/// Encodes the image as a JPEG whose longer side is at most `largest` px, from means of square blocks, with `quality` in
/// percent.
///
/// Returns `None` if it is too large for a JPEG.
pub fn small_jpeg(raster: &Raster, largest: usize, quality: u8) -> Option<Vec<u8>> {
    let block = raster.width().max(raster.height()).div_ceil(largest).max(1);
    let (width, height) = (raster.width() / block, raster.height() / block);
    let mut luma = Vec::with_capacity(width * height);
    let mut sums = vec![0_u32; width];
    for row in 0..height {
        sums.fill(0);
        for line in row * block..(row + 1) * block {
            for (sum, pixels) in sums.iter_mut().zip(raster.row(line).chunks_exact(block)) {
                *sum += pixels.iter().map(|p| u32::from(*p)).sum::<u32>();
            }
        }
        luma.extend(sums.iter().map(|sum| (sum / (block * block) as u32) as u8));
    }
    let mut jpeg = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut jpeg, quality);
    let (width, height) = (u16::try_from(width).ok()?, u16::try_from(height).ok()?);
    encoder
        .encode(&luma, width, height, jpeg_encoder::ColorType::Luma)
        .ok()?;
    Some(jpeg)
}
