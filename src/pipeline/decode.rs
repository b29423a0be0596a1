//! Bytes as a camera or a file delivers them -> grey picture.

use std::ops::Range;

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

use crate::camera::Format;
use crate::measure::raster::Raster;
use crate::measure::samples;

mod jpeg;

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

/// Of each pixel row of a picture of some width and height, px, the columns that are wanted.
pub type Wanted<'a> = dyn Fn(usize, usize) -> Vec<Range<usize>> + 'a;

/// Decodes by `format`, or by the first bytes where none is known.
pub fn decode(bytes: &[u8], format: Option<&Format>) -> Result<Raster, DecodeError> {
    decode_into(bytes, format, None)
}

/// The same, but of a camera's JPEG only what is `wanted` need be there: elsewhere it may be black. The whole file is
/// read all the same, and damage anywhere noticed.
pub fn decode_part(bytes: &[u8], format: Option<&Format>, wanted: &Wanted) -> Result<Raster, DecodeError> {
    decode_into(bytes, format, Some(wanted))
}

fn decode_into(
    bytes: &[u8],
    format: Option<&Format>,
    wanted: Option<&Wanted>,
) -> Result<Raster, DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    match format {
        Some(Format::Raw { fourcc, width, height, stride }) => {
            let size = (*width as usize, *height as usize, *stride as usize);
            samples::luma(fourcc, size.0, size.1, size.2, bytes).map_err(|e| DecodeError::Raw(e.to_string()))
        }
        _ if bytes.starts_with(&[0xff, 0xd8]) => jpeg(bytes, wanted),
        _ => picture(bytes),
    }
}

/// As cameras write it: its luma in one pass; any other kind (progressive, arithmetic) by a general decoder.
fn jpeg(bytes: &[u8], wanted: Option<&Wanted>) -> Result<Raster, DecodeError> {
    jpeg::luma(bytes, wanted).unwrap_or_else(|| any_jpeg(bytes))
}

/// Strict mode: without it half a file is taken as whole.
fn any_jpeg(bytes: &[u8]) -> Result<Raster, DecodeError> {
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

    /// Files of every kind that cameras write, of one picture: sequential, grey and in colour, with and without restart
    /// markers, and one progressive file.
    fn jpeg_files(width: u16, height: u16) -> Vec<Vec<u8>> {
        use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
        let wave = |x: u32, y: u32| (128.0 + 90.0 * (f64::from(x * x + 7 * y) / 90.0).sin()) as u8;
        let (w, h) = (u32::from(width), u32::from(height));
        let grey: Vec<u8> = (0..w * h).map(|k| wave(k % w, k / w)).collect();
        let colour: Vec<u8> = grey.iter().flat_map(|&v| [v, v / 2, 255 - v]).collect();
        let file = |rgb: bool, set: &dyn Fn(&mut Encoder<&mut Vec<u8>>)| {
            let mut bytes = vec![];
            let mut encoder = Encoder::new(&mut bytes, 90);
            set(&mut encoder);
            let (data, kind) = if rgb { (&colour, ColorType::Rgb) } else { (&grey, ColorType::Luma) };
            encoder.encode(data, width, height, kind).unwrap();
            bytes
        };
        let sampled = |factor| file(true, &|e| e.set_sampling_factor(factor));
        vec![
            file(false, &|_| ()),
            file(false, &|e| e.set_restart_interval(3)),
            file(false, &|e| e.set_optimized_huffman_tables(true)),
            sampled(SamplingFactor::R_4_4_4),
            sampled(SamplingFactor::R_4_2_2),
            sampled(SamplingFactor::R_4_2_0),
            file(true, &|e| e.set_restart_interval(2)),
            file(false, &|e| e.set_progressive(true)),
        ]
    }

    /// The two decoders round differently by one grey level.
    #[test]
    fn one_pass_gives_what_the_general_decoder_gives() {
        for (k, bytes) in jpeg_files(61, 43).iter().enumerate() {
            let general = any_jpeg(bytes).unwrap();
            assert_eq!((general.width(), general.height()), (61, 43));
            match jpeg::luma(bytes, None) {
                Some(ours) => {
                    let ours = ours.unwrap();
                    assert_eq!((ours.width(), ours.height()), (61, 43));
                    let off = ours.luma().iter().zip(general.luma()).map(|(a, b)| a.abs_diff(*b)).max();
                    assert!(off <= Some(1), "file {k}: {off:?}");
                }
                None => assert_eq!(k, 7, "only the progressive file is for the general decoder"),
            }
        }
    }

    /// Columns that move from row to row, and rows of which nothing is wanted.
    fn slanted(width: usize, height: usize) -> Vec<Range<usize>> {
        let columns = |y: usize| (y / 2).min(width)..(y / 2 + 13).min(width);
        (0..height).map(|y| if (16..27).contains(&y) { 0..0 } else { columns(y) }).collect()
    }

    #[test]
    fn a_part_is_as_in_the_whole() {
        for (k, bytes) in jpeg_files(61, 43).iter().enumerate() {
            let whole = decode(bytes, None).unwrap();
            let part = decode_part(bytes, None, &slanted).unwrap();
            for (y, columns) in slanted(61, 43).into_iter().enumerate() {
                assert_eq!(part.row(y)[columns.clone()], whole.row(y)[columns], "file {k}, row {y}");
            }
            // Nothing else is transformed, but by the general decoder.
            assert_eq!(part.row(20) == [0; 61], k != 7, "file {k}");
            let cut = &bytes[..bytes.len() - bytes.len() / 4];
            assert!(decode_part(cut, None, &slanted).is_err(), "file {k}: the end was not read");
            assert!(decode_part(bytes, None, &|_, _| Vec::new()).is_ok());
        }
    }

    #[test]
    fn every_truncation_is_noticed() {
        for whole in jpeg_files(61, 43) {
            assert!(decode(&whole, None).is_ok());
            for cut in 0..whole.len() - 1 {
                let taken = decode(&whole[..cut], None).is_ok();
                assert!(!taken, "cut at {cut} of {} was taken as whole", whole.len());
            }
        }
    }

    /// A packet lost on the way from the camera: the file has its end, but not all of its picture.
    #[test]
    fn a_stretch_lost_in_the_middle_is_noticed() {
        for (k, whole) in jpeg_files(301, 203).into_iter().take(7).enumerate() {
            let scan = whole.windows(2).rposition(|w| w == [0xff, 0xda]).unwrap() + 14;
            for lost in [512, 1000, 2000] {
                for start in (scan..whole.len() - 2 - lost).step_by(97) {
                    let mut bytes = whole.clone();
                    bytes.drain(start..start + lost);
                    assert!(
                        decode(&bytes, None).is_err(),
                        "file {k}: {lost} bytes lost at {start} of {}",
                        whole.len()
                    );
                }
            }
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
        fn damaged_bytes_never_panic(kind in 0usize..8, at in 0usize..2000, value: u8, cut in 0usize..4000) {
            let mut bytes = jpeg_files(61, 43).swap_remove(kind);
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
