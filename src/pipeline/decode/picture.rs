//! Picture files other than JPEG: PNG, PNM and TIFF.

use std::io::Cursor;

use image::codecs::png::PngDecoder;
use image::codecs::pnm::PnmDecoder;
#[cfg(feature = "tiff")]
use image::codecs::tiff::TiffDecoder;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, Limits};

use super::{DecodeError, MAX_SIDE};
use crate::measure::raster::Raster;

/// Each kind by its own decoder: the library's choice among all that any dependency switches on would bring every one of
/// them into the program.
pub fn luma(bytes: &[u8], format: ImageFormat) -> Result<Raster, DecodeError> {
    if format == ImageFormat::Tiff && is_preview(bytes) {
        let what = "it is a camera's raw file, of which only a preview could be read";
        return Err(DecodeError::Picture(what.into()));
    }
    let source = Cursor::new(bytes);
    let decoded = match format {
        ImageFormat::Png => PngDecoder::with_limits(source, limits()).and_then(limited),
        ImageFormat::Pnm => PnmDecoder::new(source).and_then(limited),
        #[cfg(feature = "tiff")]
        ImageFormat::Tiff => TiffDecoder::new(source).and_then(limited),
        other => return Err(DecodeError::Picture(format!("this program reads no {other:?}"))),
    };
    let picture = decoded.map_err(|e| DecodeError::Picture(short(&e.to_string())))?;
    if let Some(bits) = narrow(&picture) {
        return Err(DecodeError::Narrow(bits));
    }
    let luma = picture.into_luma8();
    let (width, height) = luma.dimensions();
    Raster::new(width as usize, height as usize, luma.into_raw())
        .ok_or_else(|| DecodeError::Picture("it has no pixels".into()))
}

fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits
}

/// Within the limits, of which the memory is asked for first.
fn limited(mut decoder: impl ImageDecoder) -> Result<DynamicImage, ImageError> {
    let mut limits = limits();
    limits.reserve(decoder.total_bytes())?;
    decoder.set_limits(limits)?;
    DynamicImage::from_decoder(decoder)
}

/// Whether a TIFF begins with a reduced picture, as raw files do (TIFF 6.0, NewSubfileType): the sensor's lies elsewhere in it.
fn is_preview(bytes: &[u8]) -> bool {
    const NEW_SUBFILE_TYPE: exif::Tag = exif::Tag(exif::Context::Tiff, 254);
    let fields = exif::parse_exif(bytes).map(|(fields, _)| fields).unwrap_or_default();
    let kind = fields.iter().find(|f| f.tag == NEW_SUBFILE_TYPE && f.ifd_num == exif::In::PRIMARY);
    kind.and_then(|field| field.value.get_uint(0)).is_some_and(|kind| kind & 1 == 1)
}

/// Bits of a picture of 16 that are used, where a sensor's 10 or 12 lie at the lower end: all of it would be black. A dark
/// picture of 14 bits has up to 63 of 255 grey levels and may be meant so.
fn narrow(picture: &DynamicImage) -> Option<u32> {
    use DynamicImage::{ImageLuma16, ImageLumaA16, ImageRgb16, ImageRgba16};
    let most = match picture {
        ImageLuma16(p) => p.iter().copied().max(),
        ImageLumaA16(p) => p.pixels().map(|p| p.0[0]).max(),
        ImageRgb16(p) => p.iter().copied().max(),
        ImageRgba16(p) => p.pixels().flat_map(|p| [p.0[0], p.0[1], p.0[2]]).max(),
        _ => None,
    };
    most.filter(|most| (1 << 8..1 << 12).contains(most)).map(|most| u16::BITS - most.leading_zeros())
}

/// The first line of a foreign message, so that a reason stays one sentence.
fn short(text: &str) -> String {
    text.lines().next().unwrap_or_default().chars().take(120).collect()
}
