//! Header of a JPEG file, and the check that its kind is supported.

use std::sync::Arc;

use libjpeg_turbo_rs::common::huffman_table::{HuffmanTable, std_huffman_tables};
use libjpeg_turbo_rs::decode::marker::{JpegMetadata, MarkerReader};
use libjpeg_turbo_rs::{ComponentInfo, JpegError};

use super::{JpegFault, MAX_SIDE};

/// Maximum number of scans: a progressive file has about ten; very many would cost unlimited time.
const MAX_SCANS: usize = 200;

/// Reads the header of a sequential image of 8 bits, Huffman-coded by cosine transform, grey or luma with two colour
/// differences.
///
/// # Errors
/// Returns an error if the header is damaged or the kind is not supported.
pub fn read_header(bytes: &[u8]) -> Result<JpegMetadata, JpegFault> {
    let mut reader = MarkerReader::new(bytes);
    reader.set_scan_cap(MAX_SCANS);
    let mut header = reader.read_markers().map_err(|error| match error {
        JpegError::Unsupported(_) => JpegFault::Unsupported("hierarchical coding".into()),
        other => JpegFault::Damaged(other.to_string()),
    })?;
    check_kind(&header).map_err(|kind| JpegFault::Unsupported(kind.into()))?;
    check_plausible(&header, bytes.len())?;
    add_standard_tables(&mut header);
    Ok(header)
}

/// Returns the name of the kind of an image that is not supported.
fn check_kind(header: &JpegMetadata) -> Result<(), &'static str> {
    let frame = &header.frame;
    if frame.is_lossless {
        return Err("lossless coding");
    }
    if header.is_arithmetic {
        return Err("arithmetic coding");
    }
    if frame.precision != 8 {
        return Err("more than 8 bits");
    }
    if frame.is_progressive || header.scans.len() > 1 {
        return Err("several scans; `jpegtran -copy all` makes one of them without loss");
    }
    // Line cameras and scanners begin an image without knowing its height.
    if frame.height() == 0 {
        return Err("its height follows the image");
    }
    let parts = &frame.components;
    let first = match &parts[..] {
        [_] => return Ok(()),
        [first, _, _] => first,
        [_, _, _, _] => return Err("CMYK colour"),
        _ => return Err("two components"),
    };
    if is_rgb(header) {
        return Err("red, green and blue");
    }
    let finer = |c: &ComponentInfo| {
        c.horizontal_sampling > first.horizontal_sampling
            || c.vertical_sampling > first.vertical_sampling
    };
    if parts.iter().any(finer) {
        return Err("colour of higher resolution than brightness");
    }
    Ok(())
}

/// Determines whether three components are red, green and blue, from JFIF, then Adobe's marker, then their names.
fn is_rgb(header: &JpegMetadata) -> bool {
    let names = header.frame.components.iter().map(|c| c.id);
    match header.adobe_transform_at_first_sos {
        _ if header.saw_jfif_marker_at_first_sos => false,
        Some(transform) => transform == 0,
        None => names.eq(*b"RGB"),
    }
}

/// Rejects implausible headers, which are most likely damaged.
fn check_plausible(header: &JpegMetadata, length: usize) -> Result<(), JpegFault> {
    let damaged = |problem: String| Err(JpegFault::Damaged(problem));
    let frame = &header.frame;
    let (width, height) = (frame.width(), frame.height());
    if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
        return damaged(format!("the header gives a size of {width} x {height} px"));
    }
    // A block of 8 x 8 px takes at least one bit.
    if width.div_ceil(8) * height.div_ceil(8) > 8 * length {
        return damaged(format!(
            "{length} bytes are too few for {width} x {height} px"
        ));
    }
    let names = frame.components.iter().map(|c| c.id);
    if names.collect::<std::collections::BTreeSet<u8>>().len() < frame.components.len() {
        return damaged("two components have the same name".into());
    }
    Ok(())
}

/// Fills the missing Huffman tables with the standard ones for luma and colour.
fn fill_tables(
    slots: &mut [Option<Arc<HuffmanTable>>; 4],
    luma: &Arc<HuffmanTable>,
    colour: &Arc<HuffmanTable>,
) {
    slots[0].get_or_insert_with(|| luma.clone());
    slots[1].get_or_insert_with(|| colour.clone());
}

/// Adds the tables of ITU-T T.81, K.3, if the file contains none, as in frames of MJPEG.
fn add_standard_tables(header: &mut JpegMetadata) {
    let [dc_luma, dc_colour, ac_luma, ac_colour] = std_huffman_tables();
    fill_tables(&mut header.dc_huffman_tables, dc_luma, dc_colour);
    fill_tables(&mut header.ac_huffman_tables, ac_luma, ac_colour);
    for scan in &mut header.scans {
        fill_tables(&mut scan.dc_huffman_tables, dc_luma, dc_colour);
        fill_tables(&mut scan.ac_huffman_tables, ac_luma, ac_colour);
    }
}
