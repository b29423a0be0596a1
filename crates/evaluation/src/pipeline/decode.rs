//! Decoding of image files and raw camera frames to grey images.

use crate::frame_format::Format;
use crate::pipeline::guard::catch_panic;
use wingd_measure::jpeg;
use wingd_measure::jpeg::JpegFault;
pub use wingd_measure::jpeg::PartialImage;
pub use wingd_measure::jpeg::TileSelection;
use wingd_measure::raster::Raster;
use wingd_measure::samples;
use wingd_measure::tiles::Tiles;

mod image_file;

/// Reason why a frame cannot be read; each message says what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DecodeError {
    /// The file has no bytes.
    #[error("the file is empty; copy the frame again from the camera or the store")]
    Empty,
    /// The JPEG is truncated or damaged.
    #[error(
        "the JPEG is damaged or cut short ({0}); copy the frame again from the camera or the store"
    )]
    Jpeg(String),
    /// Intact JPEG of an unsupported kind.
    #[error(
        "this kind of JPEG ({0}) is not supported; set the camera to baseline JPEG, 8 bits, YCbCr colour or grey"
    )]
    UnsupportedJpeg(String),
    /// Bytes before the first marker of a JPEG.
    #[error("{0} bytes precede the JPEG's first marker; save the frame again, or remove them")]
    LeadingBytes(usize),
    /// Image file of another format that cannot be read.
    #[error("the image cannot be read ({0}); use JPEG, PNG, PNM or TIFF")]
    Unreadable(String),
    /// Samples of 16 bits of which the camera used only the lower ones.
    #[error(
        "its samples have 16 bits, of which only {0} are used: the image would be black; save it with 8 bits, or with its samples shifted \
         to the upper bits"
    )]
    LowBits(u32),
    /// The decoding library panicked.
    #[error(
        "the decoder failed at this file, which is most likely damaged; copy the frame again from the camera or the store, and report it with the file"
    )]
    DecoderPanic,
    /// Samples of a V4L2 device that do not form an image.
    #[error("the raw frame cannot be read ({0}); compare series.json with the camera's format")]
    Raw(String),
}

/// First marker of a JPEG and the first byte of the next one.
const JPEG_START: [u8; 3] = [0xff, 0xd8, 0xff];

impl From<JpegFault> for DecodeError {
    fn from(fault: JpegFault) -> Self {
        match fault {
            JpegFault::Damaged(what) => Self::Jpeg(what),
            JpegFault::Unsupported(kind) => Self::UnsupportedJpeg(kind),
        }
    }
}

/// Decodes an image in `format`; without one, the first bytes decide.
pub fn decode_image(bytes: &[u8], format: Option<&Format>) -> Result<Raster, DecodeError> {
    decode_partial(bytes, format, &Tiles::all).map(PartialImage::into_raster)
}

/// Decodes the `wanted` tiles of an image; more can be decoded later ([`PartialImage::decode_tiles`]).
///
/// Only camera JPEGs are decoded in part. The whole file is read nevertheless, so damage anywhere is found.
pub fn decode_partial(
    bytes: &[u8],
    format: Option<&Format>,
    wanted: &TileSelection,
) -> Result<PartialImage, DecodeError> {
    catch_panic(|| decode_without_panic_guard(bytes, format, wanted))
        .unwrap_or(Err(DecodeError::DecoderPanic))
}

/// Returns width and height of an image file, px. Of a JPEG only the header is read, and a damaged one gives `None`: it is
/// still worth keeping.
///
/// # Errors
/// Returns why another file cannot be read.
pub fn read_size(bytes: &[u8]) -> Result<Option<(usize, usize)>, DecodeError> {
    let zeros = bytes.iter().take_while(|b| **b == 0).count();
    if bytes[zeros..].starts_with(&JPEG_START) {
        let header =
            catch_panic(|| jpeg::header::read_header(&bytes[zeros..])).and_then(Result::ok);
        return Ok(header.map(|(data, _)| (data.frame.width.into(), data.frame.height.into())));
    }
    decode_image(bytes, None).map(|raster| Some((raster.width(), raster.height())))
}

/// Bytes at which the decoder panics, for tests of the consequences.
#[cfg(test)]
pub const BREAKS: &[u8] = b"\xff\xd8\xff breaks";

fn decode_without_panic_guard(
    bytes: &[u8],
    format: Option<&Format>,
    wanted: &TileSelection,
) -> Result<PartialImage, DecodeError> {
    #[cfg(test)]
    assert_ne!(bytes, BREAKS);
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    if let Some(Format::Raw {
        fourcc,
        width,
        height,
        stride,
    }) = format
    {
        let size = (*width as usize, *height as usize, *stride as usize);
        return samples::decode_luma(fourcc, size.0, size.1, size.2, bytes)
            .map(PartialImage::from_raster)
            .map_err(|e| DecodeError::Raw(e.to_string()));
    }
    // Zeros before the image are padding.
    let zeros = bytes.iter().take_while(|b| **b == 0).count();
    if bytes[zeros..].starts_with(&JPEG_START) {
        return Ok(jpeg::decode_partial(&bytes[zeros..], wanted)?);
    }
    // Such files may hold a preview as JPEG.
    if bytes.get(4..8) == Some(b"ftyp") {
        return Err(DecodeError::Unreadable(
            "it is HEIC, AVIF, CR3 or a video".into(),
        ));
    }
    match (
        image::guess_format(bytes),
        memchr::memmem::find(bytes, &JPEG_START),
    ) {
        (Ok(format), _) => image_file::decode_luma(bytes, format).map(PartialImage::from_raster),
        (Err(_), Some(before)) => Err(DecodeError::LeadingBytes(before)),
        (Err(_), None) => Err(DecodeError::Unreadable("its format is unknown".into())),
    }
}

#[cfg(test)]
mod tests {

    use super::*;
    use proptest::prelude::*;

    /// Encodes one image as each kind of file that cameras write: sequential, grey and colour, with and without restart
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
            let (data, kind) = if rgb {
                (&colour, ColorType::Rgb)
            } else {
                (&grey, ColorType::Luma)
            };
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

    #[test]
    fn single_pass_decoding_equals_scan_decoding() {
        for (k, bytes) in jpeg_files(61, 43).iter().enumerate() {
            let (header, colour) = jpeg::header::read_header(bytes).unwrap();
            let general = jpeg::scans::decode_luma(bytes, &header, colour).unwrap();
            assert_eq!((general.width(), general.height()), (61, 43));
            assert!(
                decode_image(bytes, None).unwrap().luma() == general.luma(),
                "file {k}"
            );
        }
    }

    /// Selects columns that move from row to row, in two stretches, and leaves some rows without any.
    fn slanted(width: usize, height: usize) -> Tiles {
        let mut tiles = Tiles::none(width, height);
        for y in (0..height).filter(|y| !(16..27).contains(y)) {
            tiles.mark(y / 2..y / 2 + 13, y..y + 1);
            tiles.mark(y / 2 + 37..y / 2 + 38, y..y + 1);
        }
        tiles
    }

    #[test]
    fn a_part_equals_that_of_the_full_image() {
        for (k, bytes) in jpeg_files(61, 43).iter().enumerate() {
            let whole = decode_image(bytes, None).unwrap();
            let mut part = decode_partial(bytes, None, &slanted).unwrap();
            let tiles = slanted(61, 43);
            for (x, y) in (0..61).flat_map(|x| (0..43).map(move |y| (x, y))) {
                let known = if tiles.row(y / 8)[x / 8] || k == 7 {
                    whole.row(y)[x]
                } else {
                    0
                };
                // Only the progressive file has several scans.
                assert_eq!(
                    part.raster().row(y)[x],
                    known,
                    "file {k}, row {y}, column {x}"
                );
            }
            let mut more = Tiles::none(61, 43);
            more.mark(20..21, 20..21);
            more.mark(9..61, 8..40);
            part.decode_tiles(more);
            assert_eq!(part.raster().row(20)[9..], whole.row(20)[9..], "file {k}");
            assert!(k == 7 || part.raster().row(20)[..8] == [0; 8], "file {k}");
            part.decode_tiles(Tiles::all(61, 43));
            assert!(
                part.into_raster() == whole,
                "file {k}: what was read later is otherwise"
            );
            let cut = &bytes[..bytes.len() - bytes.len() / 4];
            assert!(
                decode_partial(cut, None, &slanted).is_err(),
                "file {k}: the end was not read"
            );
            assert!(decode_partial(bytes, None, &|_, _| Tiles::none(1, 1)).is_ok());
        }
    }

    #[test]
    fn every_truncation_is_detected() {
        for whole in jpeg_files(61, 43) {
            assert!(decode_image(&whole, None).is_ok());
            for cut in 0..whole.len() - 1 {
                let taken = decode_image(&whole[..cut], None).is_ok();
                assert!(!taken, "cut at {cut} of {} was taken as whole", whole.len());
            }
        }
    }

    /// A packet lost during transfer from the camera: the file has its end, but a part of the image is missing.
    #[test]
    fn missing_bytes_in_the_middle_are_noticed() {
        for (k, whole) in jpeg_files(301, 203).into_iter().enumerate() {
            let scan = whole.windows(2).position(|w| w == [0xff, 0xda]).unwrap() + 14;
            for lost in [512, 1000, 2000] {
                for start in (scan..whole.len() - 2 - lost).step_by(97) {
                    let mut bytes = whole.clone();
                    bytes.drain(start..start + lost);
                    assert!(
                        decode_image(&bytes, None).is_err(),
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
        let format = Format::Raw {
            fourcc: "YUYV".into(),
            width: 2,
            height: 2,
            stride: 6,
        };
        assert_eq!(
            decode_image(&bytes, Some(&format)).unwrap().luma(),
            [10, 20, 30, 40]
        );
        let short = Format::Raw {
            fourcc: "YUYV".into(),
            width: 2,
            height: 3,
            stride: 6,
        };
        assert!(matches!(
            decode_image(&bytes, Some(&short)),
            Err(DecodeError::Raw(_))
        ));
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic(kind in 0usize..8, at in 0usize..2000, value: u8, cut in 0usize..4000) {
            let mut bytes = jpeg_files(61, 43).swap_remove(kind);
            let n = bytes.len();
            bytes[at % n] = value;
            bytes.truncate(cut.max(1));
            let _ = decode_image(&bytes, None);
        }

        /// Decoded tiles equal those of the full image in any order of requests, and no other tile is decoded.
        #[test]
        fn tiles_are_decoded_in_any_order(
            kind in 0usize..8,
            boxes in proptest::collection::vec((0usize..70, 0usize..20, 0usize..50, 0usize..20), 1..6),
        ) {
            let bytes = &jpeg_files(61, 43)[kind];
            let whole = decode_image(bytes, None).unwrap();
            let mut part = decode_partial(bytes, None, &Tiles::none).unwrap();
            let mut all = Tiles::none(61, 43);
            for (x, across, y, down) in boxes {
                let mut wanted = Tiles::none(61, 43);
                for tiles in [&mut wanted, &mut all] {
                    tiles.mark(x..x + across, y..y + down);
                }
                part.decode_tiles(wanted);
                for (x, y) in (0..61).flat_map(|x| (0..43).map(move |y| (x, y))) {
                    let known = kind == 7 || all.row(y / 8)[x / 8];
                    prop_assert_eq!(part.raster().row(y)[x], if known { whole.row(y)[x] } else { 0 });
                }
            }
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = decode_image(&bytes, None);
        }
    }
}
