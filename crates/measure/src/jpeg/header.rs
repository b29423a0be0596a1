//! Header of a JPEG file, and the check that its kind is supported.

use std::sync::Arc;

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::{HuffmanTable, std_huffman_tables};
use libjpeg_turbo_rs::decode::marker::{JpegMetadata, MarkerReader};

use super::{JpegFault, MAX_SIDE};

/// Colour of the first component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FirstComponent {
    /// Luma, alone or with two colour differences.
    Luma,
    /// Red, followed by green and blue.
    Red,
}

/// Maximum number of scans: a progressive file has about ten; very many would cost unlimited time.
const MAX_SCANS: usize = 200;

/// Reads the header of an image of 8 bits, Huffman-coded by cosine transform, grey or in colour.
///
/// # Errors
/// Returns an error if the header is damaged or the kind is not supported.
pub fn read_header(bytes: &[u8]) -> Result<(JpegMetadata, FirstComponent), JpegFault> {
    let mut reader = MarkerReader::new(bytes);
    reader.set_scan_cap(MAX_SCANS);
    let mut header = reader.read_markers().map_err(|error| match error {
        JpegError::Unsupported(_) => JpegFault::Unsupported("hierarchical coding".into()),
        other => JpegFault::Damaged(other.to_string()),
    })?;
    let colour = check_kind(&header).map_err(|kind| JpegFault::Unsupported(kind.into()))?;
    check_plausible(&header, bytes.len())?;
    add_standard_tables(&mut header);
    Ok((header, colour))
}

/// Returns the first component of a supported image, or the name of the unsupported kind.
fn check_kind(header: &JpegMetadata) -> Result<FirstComponent, &'static str> {
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
    let parts = &frame.components;
    let first = match &parts[..] {
        [_] => return Ok(FirstComponent::Luma),
        [first, _, _] => first,
        [_, _, _, _] => return Err("CMYK colour"),
        _ => return Err("two components"),
    };
    let finest = (first.horizontal_sampling, first.vertical_sampling);
    let sampling = || {
        parts
            .iter()
            .map(|c| (c.horizontal_sampling, c.vertical_sampling))
    };
    match first_component(header) {
        FirstComponent::Red if sampling().any(|s| s != finest) => {
            Err("red, green and blue of different resolutions")
        }
        FirstComponent::Luma if sampling().any(|s| s.0 > finest.0 || s.1 > finest.1) => {
            Err("colour of higher resolution than brightness")
        }
        colour => Ok(colour),
    }
}

/// Determines the first of three components from JFIF (luma), then Adobe's marker, then the components' names.
fn first_component(header: &JpegMetadata) -> FirstComponent {
    let names: Vec<u8> = header.frame.components.iter().map(|c| c.id).collect();
    let red = match header.adobe_transform_at_first_sos {
        _ if header.saw_jfif_marker_at_first_sos => false,
        Some(transform) => transform == 0,
        None => names == *b"RGB",
    };
    if red {
        FirstComponent::Red
    } else {
        FirstComponent::Luma
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
