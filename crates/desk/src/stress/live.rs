//! Bending lines of live results.

use std::path::Path;

use nalgebra::{DMatrix, DVector};
use serde_json::{Map, Value};

use super::BendingLine;
use crate::stress::tables::StressFrame;
use wingd_evaluation::quantities::{
    CURVATURE, CURVATURE_COVARIANCE, LiveSource, NUMBER, StoredTimes, finite_value,
};
use wingd_store::columns::{LiveBlock, LiveFile, LiveHead, LiveTable};
use wingd_store::{FlightRef, RealDisk, StoreError, StoreResult, live};

fn curvature_provenance(table: &LiveTable) -> Option<Map<String, Value>> {
    let is_there = table
        .columns
        .iter()
        .any(|column| column.name == CURVATURE.name);
    is_there
        .then(|| LiveSource::from_table(table).provenance)
        .filter(|provenance| !provenance.is_empty())
}

/// Returns the provenance of the last live results with a curvature; `None` if there are none.
pub(super) fn last_provenance(
    store: &Path,
    flight: &FlightRef,
) -> StoreResult<Option<Map<String, Value>>> {
    let mut last = None;
    live::for_each_live_file(&RealDisk, store, flight, |file| {
        last = curvature_provenance(&file.head.table).or(last.take());
        Result::<usize, StoreError>::Ok(0)
    })?;
    Ok(last)
}

/// Reads the live results of a provenance, and the reasons for excluding others.
pub(super) fn live_frames(
    store: &Path,
    flight: &FlightRef,
    provenance: &Map<String, Value>,
    line: &BendingLine,
) -> StoreResult<(Vec<StressFrame>, Vec<String>)> {
    let (mut frames, mut without, mut others, mut foreign) = (Vec::new(), 0, 0, Vec::new());
    let notes = live::for_each_live_file(&RealDisk, store, flight, |mut file: LiveFile<'_>| {
        let head = file.head.clone();
        if curvature_provenance(&head.table).as_ref() != Some(provenance) {
            others += 1;
            return Result::<usize, StoreError>::Ok(0);
        }
        while let Some(block) = file.next_block() {
            match block_frames(&head, &block, line) {
                Some(read) => {
                    without += block.len() - read.len();
                    frames.extend(read);
                }
                None => foreign.push(block.len()),
            }
        }
        Ok(file.torn_length())
    })?;
    let mut excluded = notes;
    if others > 0 {
        excluded.push(format!(
            "{others} files of live results come from another installation or have no curvature"
        ));
    }
    if !foreign.is_empty() {
        let rows: usize = foreign.iter().sum();
        excluded.push(format!(
            "{rows} live results have no time, or a curvature without its covariance"
        ));
    }
    if without > 0 {
        excluded.push(format!("{without} live results were not solved"));
    }
    Ok((frames, excluded))
}

/// Returns the solved results of a block; `None` if columns are missing.
fn block_frames(
    head: &LiveHead,
    block: &LiveBlock,
    line: &BendingLine,
) -> Option<Vec<StressFrame>> {
    let curvature = block.named_values(CURVATURE.name)?;
    let covariance = block.named_values(CURVATURE_COVARIANCE.name)?;
    let (times, number) = (
        StoredTimes::from_block(block)?,
        block.named_values(NUMBER.name),
    );
    let (terms, entries) = (
        curvature.len() / block.len().max(1),
        covariance.len() / block.len().max(1),
    );
    if terms == 0 || entries != terms * (terms + 1) / 2 {
        return None;
    }
    let frame = |row: usize| {
        let curvature = curvature.get(row * terms..(row + 1) * terms)?;
        let covariance = covariance.get(row * entries..(row + 1) * entries)?;
        let known = curvature
            .iter()
            .chain(covariance)
            .all(|value| value.is_finite());
        let stamp = times.stamp(&head.began, row).filter(|_| known)?;
        Some(StressFrame {
            series: "live".to_owned(),
            image: finite_value(&number, row)
                .map_or_else(|| stamp.utc.to_string(), |number| number.to_string()),
            stamp,
            curvature: line.with_curvature(
                DVector::from_column_slice(curvature),
                symmetric_matrix(terms, covariance),
            ),
        })
    };
    Some((0..block.len()).filter_map(frame).collect())
}

/// Builds a symmetric matrix from its upper triangle, row by row.
fn symmetric_matrix(terms: usize, upper: &[f64]) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(terms, terms);
    let places = (0..terms).flat_map(|i| (i..terms).map(move |j| (i, j)));
    for ((i, j), value) in places.zip(upper) {
        matrix[(i, j)] = *value;
        matrix[(j, i)] = *value;
    }
    matrix
}
