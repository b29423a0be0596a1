//! Decoder of JPEGs in several scans (progressive, or one component each) and of red, green and blue: all coefficients are
//! kept until the last scan (ITU-T T.81, annex G).

use std::ops::Range;

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::HuffmanTable;
use libjpeg_turbo_rs::decode::marker::{JpegMetadata, MarkerReader, ScanInfo};
use libjpeg_turbo_rs::simd;

use super::JpegFault;
use super::codes::{CodeReader, out_of_step_error, remove_stuffing};
use super::coefficients::{self, BlockRuns, CoefficientBlock, SpectralBand};
use super::header::FirstComponent;
use super::intervals::{BLOCK, END, RestartIntervals, damaged_error};
use crate::raster::Raster;
use crate::tiles;

/// Coefficients of a component, and the bits known of them.
struct ComponentPlane {
    /// Blocks of a unit (the blocks that are coded together), across and down.
    unit_blocks: [usize; 2],
    /// Blocks that contain image, across and down, as coded in a scan of this component alone.
    used_blocks: [usize; 2],
    /// Blocks of a row, including those that fill up the last unit.
    row_blocks: usize,
    blocks: Vec<CoefficientBlock>,
    /// Lowest known bit of each coefficient, in coding order; `None` before its first scan.
    lowest_bit: [Option<u8>; BLOCK * BLOCK],
}

/// Decodes the grey values from all scans.
pub fn decode_luma(
    bytes: &[u8],
    header: &JpegMetadata,
    colour: FirstComponent,
) -> Result<Raster, JpegFault> {
    let mut planes = allocate_component_planes(header);
    let units = unit_counts(header);
    let mut runs = BlockRuns::default();
    for scan in &header.scans {
        CoefficientScan::new(header, scan, &mut planes, &mut runs, units)?.decode_scan(bytes)?;
    }
    if runs.is_out_of_step() {
        return Err(damaged_error("codes are out of step: data are missing"));
    }
    let complete = |p: &ComponentPlane| p.lowest_bit.iter().all(|bit| *bit == Some(0));
    if header.extraneous_bytes > 0 || !planes.iter().all(complete) {
        return Err(damaged_error("a scan is missing"));
    }
    let (width, height) = (header.frame.width(), header.frame.height());
    let pixels =
        |k: usize| Ok(planes[k].pixels(&quantisation_steps(bytes, header, k)?, width, height));
    let luma = match colour {
        FirstComponent::Luma => pixels(0)?,
        FirstComponent::Red => luma_from_rgb(&pixels(0)?, &pixels(1)?, &pixels(2)?),
    };
    Raster::new(width, height, luma).ok_or_else(|| damaged_error("the image has no pixels"))
}

/// Converts RGB to luma of ITU-R BT.601, rounded as libjpeg rounds it: factors times 2^16.
fn luma_from_rgb(red: &[u8], green: &[u8], blue: &[u8]) -> Vec<u8> {
    let sum = |((r, g), b): ((&u8, &u8), &u8)| {
        19_595 * u32::from(*r) + 38_470 * u32::from(*g) + 7_471 * u32::from(*b) + 32_768
    };
    red.iter()
        .zip(green)
        .zip(blue)
        .map(|rgb| (sum(rgb) >> 16) as u8)
        .collect()
}

/// Returns the finest sampling, across and down.
fn finest_sampling(header: &JpegMetadata) -> [usize; 2] {
    let parts = &header.frame.components;
    let across = parts
        .iter()
        .map(|c| usize::from(c.horizontal_sampling))
        .max();
    [
        across.unwrap_or(1),
        parts
            .iter()
            .map(|c| usize::from(c.vertical_sampling))
            .max()
            .unwrap_or(1),
    ]
}

/// Returns the number of units of the image, across and down.
fn unit_counts(header: &JpegMetadata) -> [usize; 2] {
    let [across, down] = finest_sampling(header);
    [
        header.frame.width().div_ceil(BLOCK * across),
        header.frame.height().div_ceil(BLOCK * down),
    ]
}

fn allocate_component_planes(header: &JpegMetadata) -> Vec<ComponentPlane> {
    let (finest, units) = (finest_sampling(header), unit_counts(header));
    let size = [header.frame.width(), header.frame.height()];
    let plane = |c: &libjpeg_turbo_rs::ComponentInfo| {
        let unit = [
            usize::from(c.horizontal_sampling),
            usize::from(c.vertical_sampling),
        ];
        let own = [0, 1].map(|k| (size[k] * unit[k]).div_ceil(finest[k]).div_ceil(BLOCK));
        let across = units[0] * unit[0];
        let blocks = vec![[0; BLOCK * BLOCK]; across * units[1] * unit[1]];
        ComponentPlane {
            unit_blocks: unit,
            used_blocks: own,
            row_blocks: across,
            blocks,
            lowest_bit: [None; BLOCK * BLOCK],
        }
    };
    header.frame.components.iter().map(plane).collect()
}

/// Returns the quantisation steps of component `k` at the begin of its first scan: a later scan may change the table.
fn quantisation_steps(
    bytes: &[u8],
    header: &JpegMetadata,
    k: usize,
) -> Result<[u16; BLOCK * BLOCK], JpegFault> {
    let component = &header.frame.components[k];
    let has_component = |s: &&ScanInfo| {
        s.header
            .components
            .iter()
            .any(|c| c.component_id == component.id)
    };
    let first = header
        .scans
        .iter()
        .find(has_component)
        .ok_or_else(|| damaged_error("a component is missing"))?;
    let until = [&bytes[..first.data_offset], &[0xff, END]].concat();
    let then = MarkerReader::new(&until)
        .read_markers()
        .map_err(|e| JpegFault::Damaged(e.to_string()))?;
    let table = then
        .quant_tables
        .into_iter()
        .nth(usize::from(component.quant_table_index))
        .flatten();
    table
        .map(|t| t.values)
        .ok_or_else(|| damaged_error("a quantisation table is missing"))
}

impl ComponentPlane {
    /// Returns the grey values; the component must have the full resolution.
    fn pixels(&self, steps: &[u16; BLOCK * BLOCK], width: usize, height: usize) -> Vec<u8> {
        let transform = simd::detect().idct_islow;
        let mut image = vec![0; width * height];
        let mut pixels = [0; BLOCK * BLOCK];
        for (row, blocks) in self
            .blocks
            .chunks_exact(self.row_blocks)
            .enumerate()
            .take(height.div_ceil(BLOCK))
        {
            for (column, block) in blocks.iter().enumerate().take(width.div_ceil(BLOCK)) {
                transform(block, steps, &mut pixels);
                tiles::copy_tile(&pixels, [column, row], &mut image, width);
            }
        }
        image
    }

    /// Records the bits that a scan codes.
    ///
    /// # Errors
    /// Returns an error if the scan does not continue the bits already known.
    fn record_scan(&mut self, band: Range<usize>, high: u8, low: u8) -> Result<(), JpegFault> {
        let before = if high == 0 { None } else { Some(high) };
        if (high != 0 && high != low + 1)
            || self.lowest_bit[band.clone()]
                .iter()
                .any(|bit| *bit != before)
        {
            return Err(damaged_error("the scans do not continue each other"));
        }
        self.lowest_bit[band].fill(Some(low));
        Ok(())
    }
}

struct ScanComponent<'a> {
    plane: &'a mut ComponentPlane,
    dc: Option<&'a HuffmanTable>,
    ac: Option<&'a HuffmanTable>,
    last: i16,
}

/// Scan being decoded.
struct CoefficientScan<'a> {
    parts: Vec<ScanComponent<'a>>,
    band: SpectralBand,
    progressive: bool,
    runs: &'a mut BlockRuns,
    /// Units across and down; blocks if the scan has one component.
    units: [usize; 2],
    interval: usize,
    offset: usize,
}

impl<'a> CoefficientScan<'a> {
    fn new(
        header: &JpegMetadata,
        scan: &'a ScanInfo,
        planes: &'a mut [ComponentPlane],
        runs: &'a mut BlockRuns,
        units: [usize; 2],
    ) -> Result<Self, JpegFault> {
        let h = &scan.header;
        let progressive = header.frame.is_progressive;
        let (first, last, low) = if progressive {
            (h.spec_start, h.spec_end, h.succ_low)
        } else {
            (0, 63, 0)
        };
        let refines = progressive && h.succ_high > 0;
        let band = SpectralBand {
            first,
            last,
            low,
            refines,
        };
        let single = h.components.len() == 1;
        let in_order = first <= last && last < 64 && low < 14;
        if progressive && (!in_order || if first == 0 { last != 0 } else { !single }) {
            return Err(damaged_error("the header of a scan is wrong"));
        }
        let high = if progressive { h.succ_high } else { 0 };
        let mut parts = Vec::with_capacity(h.components.len());
        for (component, plane) in header.frame.components.iter().zip(planes) {
            if let Some(chosen) = h.components.iter().find(|c| c.component_id == component.id) {
                plane.record_scan(usize::from(first)..usize::from(last) + 1, high, low)?;
                let table = |tables: &'a [Option<std::sync::Arc<HuffmanTable>>; 4], k: u8| {
                    tables.get(usize::from(k)).and_then(Option::as_deref)
                };
                let dc = table(&scan.dc_huffman_tables, chosen.dc_table_index);
                let ac = table(&scan.ac_huffman_tables, chosen.ac_table_index);
                parts.push(ScanComponent {
                    plane,
                    dc,
                    ac,
                    last: 0,
                });
            }
        }
        if parts.is_empty() || parts.len() != h.components.len() {
            return Err(damaged_error("the header of a scan is wrong"));
        }
        let units = if single {
            parts[0].plane.used_blocks
        } else {
            units
        };
        let interval = usize::from(scan.restart_interval);
        Ok(Self {
            parts,
            band,
            progressive,
            runs,
            units,
            interval,
            offset: scan.data_offset,
        })
    }

    fn decode_scan(&mut self, bytes: &[u8]) -> Result<(), JpegFault> {
        let (coded, mut data) = (bytes.get(self.offset..).unwrap_or_default(), Vec::new());
        let mut intervals =
            RestartIntervals::new(coded, self.units[0] * self.units[1], self.interval, None);
        while let Some(units) = intervals.next_interval()? {
            self.runs.restart();
            self.parts.iter_mut().for_each(|p| p.last = 0);
            let row = units.start / self.units[0];
            let near =
                |problem: String| JpegFault::Damaged(format!("{problem} near block row {row}"));
            data.clear();
            remove_stuffing(intervals.coded(), &mut data);
            let mut codes = CodeReader::new(&data);
            for unit in units {
                self.decode_unit_blocks(&mut codes, unit)
                    .map_err(|e| near(e.to_string()))?;
            }
            // Exactly the padding of the last byte is left, so no data are missing in between.
            if self.runs.left > 0 || !(0..8).contains(&codes.bits_left()) {
                return Err(near("data are missing or misplaced".into()));
            }
        }
        Ok(())
    }

    fn decode_unit_blocks(&mut self, codes: &mut CodeReader, unit: usize) -> Result<(), JpegError> {
        let (column, row) = (unit % self.units[0], unit / self.units[0]);
        let is_single = self.parts.len() == 1;
        for k in 0..self.parts.len() {
            let plane = &self.parts[k].plane;
            let [wide, high] = if is_single { [1, 1] } else { plane.unit_blocks };
            let across = plane.row_blocks;
            for b in 0..wide * high {
                let at = (row * high + b / wide) * across + column * wide + b % wide;
                self.decode_block(codes, k, at)?;
            }
        }
        Ok(())
    }

    fn decode_block(
        &mut self,
        codes: &mut CodeReader,
        k: usize,
        at: usize,
    ) -> Result<(), JpegError> {
        let ScanComponent {
            plane,
            dc,
            ac,
            last,
        } = &mut self.parts[k];
        let missing = || JpegError::CorruptData("a Huffman table is missing".into());
        let block = &mut plane.blocks[at];
        let mut band = self.band;
        if band.first == 0 {
            if band.refines {
                block[0] |= (codes.read_bits(1) << band.low) as i16;
            } else {
                *last = last.wrapping_add(codes.read_mean_change(dc.ok_or_else(missing)?)?);
                block[0] = *last << band.low;
            }
            band.first = 1;
        }
        if band.last > 0 {
            coefficients::decode_band(codes, ac.ok_or_else(missing)?, band, self.runs, block)?;
        }
        if !self.progressive {
            // In a sequential scan each block ends on its own.
            if self.runs.left > 0 {
                return Err(out_of_step_error());
            }
            *self.runs = BlockRuns::default();
        }
        Ok(())
    }
}
