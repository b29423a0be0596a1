//! Decoding of image files other than JPEG: PNG, PNM and TIFF.

use std::io::Cursor;

use image::codecs::png::PngDecoder;
use image::codecs::pnm::PnmDecoder;
use image::codecs::tiff::TiffDecoder;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, Limits};

use super::DecodeError;
use wingd_measure::jpeg::MAX_SIDE;
use wingd_measure::raster::Raster;

/// Decodes an image file to grey values with the decoder of its format.
///
/// The library's automatic choice would link every decoder that any dependency enables.
pub fn decode_luma(bytes: &[u8], format: ImageFormat) -> Result<Raster, DecodeError> {
    if format == ImageFormat::Tiff && is_preview(bytes) {
        let what = "it is a camera's raw file, and only its preview could be read";
        return Err(DecodeError::Unreadable(what.into()));
    }
    let source = Cursor::new(bytes);
    let decoded = match format {
        ImageFormat::Png => {
            PngDecoder::with_limits(source, image_size_limits()).and_then(decode_within_limits)
        }
        ImageFormat::Pnm => PnmDecoder::new(source).and_then(decode_within_limits),
        ImageFormat::Tiff => TiffDecoder::new(source).and_then(decode_within_limits),
        other => {
            return Err(DecodeError::Unreadable(format!(
                "{other:?} is not supported"
            )));
        }
    };
    let pixels = decoded.map_err(|e| DecodeError::Unreadable(first_line(&e.to_string())))?;
    if let Some(bits) = misplaced_low_bits(&pixels) {
        return Err(DecodeError::LowBits(bits));
    }
    let luma = pixels.into_luma8();
    let (width, height) = luma.dimensions();
    Raster::new(width as usize, height as usize, luma.into_raw())
        .ok_or_else(|| DecodeError::Unreadable("it has no pixels".into()))
}

fn image_size_limits() -> Limits {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits
}

/// Decodes an image within the size and memory limits; the memory is reserved first.
fn decode_within_limits(mut decoder: impl ImageDecoder) -> Result<DynamicImage, ImageError> {
    let mut limits = image_size_limits();
    limits.reserve(decoder.total_bytes())?;
    decoder.set_limits(limits)?;
    DynamicImage::from_decoder(decoder)
}

/// Returns whether a TIFF begins with a reduced image, as raw files do (TIFF 6.0, NewSubfileType); the sensor's image is
/// elsewhere in it.
fn is_preview(bytes: &[u8]) -> bool {
    const NEW_SUBFILE_TYPE: exif::Tag = exif::Tag(exif::Context::Tiff, 254);
    let fields = exif::parse_exif(bytes)
        .map(|(fields, _)| fields)
        .unwrap_or_default();
    let kind = fields
        .iter()
        .find(|f| f.tag == NEW_SUBFILE_TYPE && f.ifd_num == exif::In::PRIMARY);
    kind.and_then(|field| field.value.get_uint(0))
        .is_some_and(|kind| kind & 1 == 1)
}

/// Returns the number of bits, 9 to 12, if a 16-bit image uses only its lower ones, which would appear black; such an image
/// is rejected.
///
/// A dark image of 14 bits reaches 63 of 255 grey levels and may be intended.
fn misplaced_low_bits(pixels: &DynamicImage) -> Option<u32> {
    use DynamicImage::{ImageLuma16, ImageLumaA16, ImageRgb16, ImageRgba16};
    let most = match pixels {
        ImageLuma16(p) => p.iter().copied().max(),
        ImageLumaA16(p) => p.pixels().map(|p| p.0[0]).max(),
        ImageRgb16(p) => p.iter().copied().max(),
        ImageRgba16(p) => p.pixels().flat_map(|p| [p.0[0], p.0[1], p.0[2]]).max(),
        _ => None,
    };
    most.filter(|most| (1 << 8..1 << 12).contains(most))
        .map(|most| u16::BITS - most.leading_zeros())
}

/// Returns the first line of a foreign message, so that a reason stays one sentence.
fn first_line(text: &str) -> String {
    text.lines()
        .next()
        .unwrap_or_default()
        .chars()
        .take(120)
        .collect()
}
