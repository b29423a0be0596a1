//! Conversion of raw samples, as a V4L2 device delivers them, to luma.
//!
//! Formats follow the Linux kernel's "Video for Linux API", part "Image Formats". A colour mosaic becomes luma (R + 2 G +
//! B) / 4 through the kernel (1 2 1) x (1 2 1) / 16: the kernel is symmetric, so no edge moves, and every pixel has equal
//! weights of the three colours at any position in the mosaic.

use crate::raster::Raster;

/// An error in raw samples.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SamplesError {
    /// The pixel format is not supported.
    #[error(
        "pixel format {0} is not supported; use GREY, YUYV or a Bayer format of 8, 10 or 12 bits"
    )]
    Format(String),
    /// The data are too short for the image's size.
    #[error("{have} bytes, but {width} x {height} px with a stride of {stride} need {need}")]
    Length {
        /// Number of bytes available.
        have: usize,
        /// Number of bytes needed.
        need: usize,
        width: usize,
        height: usize,
        /// Bytes from row to row.
        stride: usize,
    },
}

/// Packing of a row's samples in bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Packing {
    /// Bytes, one per sample.
    Byte,
    /// Every second byte, from this one on (YUYV: 0, UYVY: 1).
    Second(usize),
    /// Words of two bytes, low byte first, with this many significant bits.
    Word(u32),
    /// Groups of four 10-bit samples in five bytes, the low bits in the fifth (MIPI).
    Packed10,
    /// Groups of two 12-bit samples in three bytes, the low bits in the third (MIPI).
    Packed12,
}

/// Returns the packing of a FourCC and whether its samples are a colour mosaic.
fn sample_layout(fourcc: &str) -> Option<(Packing, bool)> {
    Some(match fourcc {
        "GREY" | "NV12" | "NV21" | "YU12" | "YV12" => (Packing::Byte, false),
        "YUYV" | "YVYU" => (Packing::Second(0), false),
        "UYVY" | "VYUY" => (Packing::Second(1), false),
        "Y10 " | "Y10" => (Packing::Word(10), false),
        "Y12 " | "Y12" => (Packing::Word(12), false),
        "Y16 " | "Y16" => (Packing::Word(16), false),
        "BA81" | "GBRG" | "GRBG" | "RGGB" => (Packing::Byte, true),
        "BG10" | "GB10" | "BA10" | "RG10" => (Packing::Word(10), true),
        "BG12" | "GB12" | "BA12" | "RG12" => (Packing::Word(12), true),
        "pBAA" | "pGAA" | "pgAA" | "pRAA" => (Packing::Packed10, true),
        "pBCC" | "pGCC" | "pgCC" | "pRCC" => (Packing::Packed12, true),
        _ => return None,
    })
}

impl Packing {
    /// Returns the number of significant bits per sample.
    fn bits(self) -> u32 {
        match self {
            Self::Byte | Self::Second(_) => 8,
            Self::Word(bits) => bits,
            Self::Packed10 => 10,
            Self::Packed12 => 12,
        }
    }

    /// Returns the number of bytes of a row of `width` samples.
    fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Byte => width,
            Self::Second(_) | Self::Word(_) => width.saturating_mul(2),
            Self::Packed10 => width.div_ceil(4).saturating_mul(5),
            Self::Packed12 => width.div_ceil(2).saturating_mul(3),
        }
    }

    /// Unpacks the samples of a row.
    fn unpack(self, row: &[u8], out: &mut [u16]) {
        match self {
            Self::Byte => {
                out.iter_mut()
                    .zip(row)
                    .for_each(|(sample, byte)| *sample = u16::from(*byte));
            }
            Self::Second(first) => {
                let luma = row.iter().skip(first).step_by(2);
                out.iter_mut()
                    .zip(luma)
                    .for_each(|(sample, byte)| *sample = u16::from(*byte));
            }
            Self::Word(bits) => {
                let top = u16::MAX >> (16 - bits);
                for (sample, pair) in out.iter_mut().zip(row.as_chunks::<2>().0) {
                    *sample = u16::from_le_bytes(*pair).min(top);
                }
            }
            Self::Packed10 => unpack_mipi::<5>(row, out, 2),
            Self::Packed12 => unpack_mipi::<3>(row, out, 4),
        }
    }
}

/// Unpacks groups of `GROUP` - 1 high bytes followed by one byte with `low` bits of each, the first sample's lowest.
fn unpack_mipi<const GROUP: usize>(row: &[u8], out: &mut [u16], low: u32) {
    for (samples, group) in out.chunks_mut(GROUP - 1).zip(row.as_chunks::<GROUP>().0) {
        let rest = u16::from(group[GROUP - 1]);
        for (index, (sample, high)) in samples.iter_mut().zip(group).enumerate() {
            let bits = (rest >> (low * index as u32)) & ((1 << low) - 1);
            *sample = (u16::from(*high) << low) | bits;
        }
    }
}

/// Converts raw samples to luma; `stride` is the number of bytes from one row to the next.
///
/// # Errors
/// Returns an error if the format is not supported or there are too few bytes.
pub fn decode_luma(
    fourcc: &str,
    width: usize,
    height: usize,
    stride: usize,
    bytes: &[u8],
) -> Result<Raster, SamplesError> {
    let (packing, mosaic) =
        sample_layout(fourcc).ok_or_else(|| SamplesError::Format(fourcc.to_owned()))?;
    let row_bytes = packing.row_bytes(width);
    let need = height
        .saturating_sub(1)
        .saturating_mul(stride)
        .saturating_add(row_bytes);
    let short = SamplesError::Length {
        have: bytes.len(),
        need,
        width,
        height,
        stride,
    };
    if bytes.len() < need || stride < row_bytes || width < 2 || height < 2 {
        return Err(short);
    }
    let row = |y: usize| bytes.get(y * stride..y * stride + row_bytes).unwrap_or(&[]);
    let mut out = vec![0; width * height];
    if mosaic {
        blend_mosaic(packing, width, height, row, &mut out);
    } else {
        let mut samples = vec![0; width];
        for (y, line) in out.chunks_mut(width).enumerate() {
            packing.unpack(row(y), &mut samples);
            line.iter_mut()
                .zip(&samples)
                .for_each(|(luma, sample)| *luma = (sample >> (packing.bits() - 8)) as u8);
        }
    }
    Raster::new(width, height, out).ok_or(short)
}

/// Converts a colour mosaic to luma, three rows at a time: unpacked, blended along the row, then across rows. Beyond the
/// edge the mosaic is mirrored at the outermost sample, which keeps its colours in step.
fn blend_mosaic<'a>(
    packing: Packing,
    width: usize,
    height: usize,
    row: impl Fn(usize) -> &'a [u8],
    out: &mut [u8],
) {
    let mut samples = vec![0; width];
    let mut along = |y: usize, target: &mut Vec<u32>| {
        packing.unpack(row(y), &mut samples);
        blend_row(&samples, target);
    };
    let (mut above, mut here, mut below) = (vec![0; width], vec![0; width], vec![0; width]);
    along(1, &mut above);
    along(0, &mut here);
    let shift = packing.bits() - 8 + 4;
    let half = 1 << (shift - 1);
    for (y, line) in out.chunks_mut(width).enumerate() {
        along(if y + 1 < height { y + 1 } else { height - 2 }, &mut below);
        for (luma, ((a, h), b)) in line.iter_mut().zip(above.iter().zip(&here).zip(&below)) {
            *luma = ((a + 2 * h + b + half) >> shift).min(255) as u8;
        }
        std::mem::swap(&mut above, &mut here);
        std::mem::swap(&mut here, &mut below);
    }
}

/// Blends a row by (1 2 1), without dividing.
fn blend_row(samples: &[u16], target: &mut [u32]) {
    let wide = |index: usize| samples.get(index).copied().map_or(0, u32::from);
    let last = samples.len() - 1;
    for (value, three) in target[1..].iter_mut().zip(samples.windows(3)) {
        *value = u32::from(three[0]) + 2 * u32::from(three[1]) + u32::from(three[2]);
    }
    target[0] = 2 * wide(0) + 2 * wide(1);
    target[last] = 2 * wide(last) + 2 * wide(last - 1);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a grey ramp over x and y, with different values in every pixel's neighbourhood.
    fn ramp(width: usize, height: usize) -> Vec<u8> {
        (0..width * height)
            .map(|i| ((i % width) * 3 + (i / width) * 5) as u8)
            .collect()
    }

    #[test]
    fn grey_honours_the_stride() {
        let grey = ramp(6, 4);
        let padded: Vec<u8> = grey
            .chunks(6)
            .flat_map(|row| row.iter().copied().chain([9, 9]))
            .collect();
        assert_eq!(decode_luma("GREY", 6, 4, 8, &padded).unwrap().luma(), grey);
        // The last row's padding may be missing.
        assert_eq!(
            decode_luma("GREY", 6, 4, 8, &padded[..30]).unwrap().luma(),
            grey
        );
        assert!(matches!(
            decode_luma("GREY", 6, 4, 8, &padded[..29]),
            Err(SamplesError::Length { need: 30, .. })
        ));
        assert!(decode_luma("GREY", 6, 4, 5, &padded).is_err());
    }

    #[test]
    fn yuyv_takes_the_luma_bytes() {
        let grey = ramp(6, 4);
        let yuyv: Vec<u8> = grey.iter().flat_map(|y| [*y, 128]).collect();
        let uyvy: Vec<u8> = grey.iter().flat_map(|y| [128, *y]).collect();
        assert_eq!(decode_luma("YUYV", 6, 4, 12, &yuyv).unwrap().luma(), grey);
        assert_eq!(decode_luma("UYVY", 6, 4, 12, &uyvy).unwrap().luma(), grey);
    }

    #[test]
    fn a_uniform_colour_gives_one_luma_in_every_pixel_and_order() {
        let (red, green, blue) = (200u16, 100, 40);
        for (fourcc, tile) in [
            ("RGGB", [red, green, green, blue]),
            ("BA81", [blue, green, green, red]),
            ("GRBG", [green, red, blue, green]),
            ("GBRG", [green, blue, red, green]),
        ] {
            let bytes: Vec<u8> = (0..8 * 6)
                .map(|i| tile[(i / 8 % 2) * 2 + i % 2] as u8)
                .collect();
            let raster = decode_luma(fourcc, 8, 6, 8, &bytes).unwrap();
            assert!(
                raster.luma().iter().all(|l| *l == 110),
                "{fourcc}: {:?}",
                raster.luma()
            );
        }
    }

    #[test]
    fn a_straight_ramp_is_not_moved_by_the_blend() {
        let bytes: Vec<u8> = (0..20 * 8).map(|i| ((i % 20) * 10) as u8).collect();
        let raster = decode_luma("RGGB", 20, 8, 20, &bytes).unwrap();
        for y in 0..8 {
            assert_eq!(&raster.row(y)[1..19], &bytes[1..19]);
        }
    }

    #[test]
    fn deep_samples_agree_in_every_packing() {
        let values: Vec<u16> = (0..8 * 4).map(|i| (i * 37 % 1024) as u16).collect();
        let words: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let packed: Vec<u8> = values
            .chunks(4)
            .flat_map(|v| {
                let low = v
                    .iter()
                    .enumerate()
                    .fold(0, |low, (i, v)| low | ((v & 3) << (2 * i)) as u8);
                v.iter()
                    .map(|v| (v >> 2) as u8)
                    .chain([low])
                    .collect::<Vec<_>>()
            })
            .collect();
        assert_eq!(
            decode_luma("RG10", 8, 4, 16, &words),
            decode_luma("pRAA", 8, 4, 10, &packed)
        );
        let twelve: Vec<u16> = values.iter().map(|v| v * 4).collect();
        let words12: Vec<u8> = twelve.iter().flat_map(|v| v.to_le_bytes()).collect();
        let packed12: Vec<u8> = twelve
            .chunks(2)
            .flat_map(|v| {
                [
                    (v[0] >> 4) as u8,
                    (v[1] >> 4) as u8,
                    ((v[0] & 15) | ((v[1] & 15) << 4)) as u8,
                ]
            })
            .collect();
        assert_eq!(
            decode_luma("RG12", 8, 4, 16, &words12),
            decode_luma("pRCC", 8, 4, 12, &packed12)
        );
        assert_eq!(
            decode_luma("RG10", 8, 4, 16, &words),
            decode_luma("RG12", 8, 4, 16, &words12)
        );
    }

    #[test]
    fn unknown_formats_and_tiny_sizes_are_refused() {
        assert!(matches!(
            decode_luma("H264", 8, 4, 8, &[0; 32]),
            Err(SamplesError::Format(_))
        ));
        assert!(decode_luma("GREY", 0, 0, 0, &[]).is_err());
        assert!(decode_luma("GREY", usize::MAX, usize::MAX, usize::MAX, &[0; 8]).is_err());
    }
}
