//! Bytes as a camera or a file delivers them -> grey picture.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

use crate::camera::Format;
use crate::measure::raster::Raster;
use crate::measure::samples;

/// Why a frame cannot be read; each says what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DecodeError {
    /// No bytes at all.
    #[error("the file is empty; copy the frame again from the camera or the store")]
    Empty,
    /// The JPEG is cut short or damaged.
    #[error("the JPEG is damaged or cut short ({0}); copy the frame again from the camera or the store")]
    Jpeg(String),
    /// Another picture file that cannot be read.
    #[error("the picture cannot be read ({0}); use JPEG, PNG, PNM or TIFF")]
    Picture(String),
    /// Samples of a V4L2 device that do not make a picture.
    #[error("the raw frame cannot be read ({0}); compare series.json with the camera's format")]
    Raw(String),
}

/// Largest side that is decoded, px: beyond it a damaged header is likelier than a camera.
const LARGEST_SIDE: usize = 30_000;

/// Decodes by `format`, or by the first bytes where none is known.
pub fn decode(bytes: &[u8], format: Option<&Format>) -> Result<Raster, DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    match format {
        Some(Format::Raw { fourcc, width, height, stride }) => {
            let size = (*width as usize, *height as usize, *stride as usize);
            samples::luma(fourcc, size.0, size.1, size.2, bytes).map_err(|e| DecodeError::Raw(e.to_string()))
        }
        _ if bytes.starts_with(&[0xff, 0xd8]) => jpeg(bytes),
        _ => picture(bytes),
    }
}

/// Strict mode: without it half a file is taken as whole.
fn jpeg(bytes: &[u8]) -> Result<Raster, DecodeError> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(LARGEST_SIDE)
        .set_max_height(LARGEST_SIDE)
        .jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let luma = decoder.decode().map_err(|e| DecodeError::Jpeg(short(&e)))?;
    let (width, height) =
        decoder.dimensions().ok_or_else(|| DecodeError::Jpeg("no size in the header".into()))?;
    if !has_end_marker(bytes) {
        return Err(DecodeError::Jpeg("its end is missing".into()));
    }
    Raster::new(width, height, luma).ok_or_else(|| DecodeError::Jpeg("its size does not fit its data".into()))
}

/// The end-of-image marker near the end; some cameras pad after it.
fn has_end_marker(bytes: &[u8]) -> bool {
    let tail = bytes.len().saturating_sub(4096);
    bytes[tail..].windows(2).any(|w| w == [0xff, 0xd9])
}

fn picture(bytes: &[u8]) -> Result<Raster, DecodeError> {
    let reader = image::ImageReader::new(std::io::Cursor::new(bytes)).with_guessed_format();
    let mut reader = reader.map_err(|e| DecodeError::Picture(e.to_string()))?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(LARGEST_SIDE as u32);
    limits.max_image_height = Some(LARGEST_SIDE as u32);
    reader.limits(limits);
    let luma = reader.decode().map_err(|e| DecodeError::Picture(short(&e)))?.into_luma8();
    let (width, height) = luma.dimensions();
    Raster::new(width as usize, height as usize, luma.into_raw())
        .ok_or_else(|| DecodeError::Picture("it has no pixels".into()))
}

/// The first line of a foreign message, so that a reason stays one sentence.
fn short(error: &impl std::fmt::Debug) -> String {
    let text = format!("{error:?}").replace('"', "");
    let line = text.lines().next().unwrap_or_default();
    line.chars().take(120).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn jpeg_file() -> Vec<u8> {
        let luma: Vec<u8> = (0..64 * 48u32).map(|k| (k * 37 % 251) as u8).collect();
        let mut bytes = vec![];
        jpeg_encoder::Encoder::new(&mut bytes, 90)
            .encode(&luma, 64, 48, jpeg_encoder::ColorType::Luma)
            .unwrap();
        bytes
    }

    #[test]
    fn every_truncation_is_noticed() {
        let whole = jpeg_file();
        let raster = decode(&whole, None).unwrap();
        assert_eq!((raster.width(), raster.height()), (64, 48));
        for cut in 0..whole.len() - 1 {
            assert!(
                decode(&whole[..cut], None).is_err(),
                "cut at {cut} of {} was taken as whole",
                whole.len()
            );
        }
    }

    #[test]
    fn yuyv_takes_the_luma_and_honours_the_stride() {
        let bytes = [10, 128, 20, 128, 0, 0, 30, 128, 40, 128, 0, 0];
        let format = Format::Raw { fourcc: "YUYV".into(), width: 2, height: 2, stride: 6 };
        assert_eq!(decode(&bytes, Some(&format)).unwrap().luma(), [10, 20, 30, 40]);
        let short = Format::Raw { fourcc: "YUYV".into(), width: 2, height: 3, stride: 6 };
        assert!(matches!(decode(&bytes, Some(&short)), Err(DecodeError::Raw(_))));
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic(at in 0usize..2000, value: u8, cut in 0usize..4000) {
            let mut bytes = jpeg_file();
            let n = bytes.len();
            bytes[at % n] = value;
            bytes.truncate(cut.max(1));
            let _ = decode(&bytes, None);
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = decode(&bytes, None);
        }
    }
}
