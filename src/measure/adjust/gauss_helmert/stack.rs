//! The blocks of a group, whitened and stacked, so that one matrix product gives what they have in
//! common: parameters that most blocks depend on. What few depend on (a marker's own position) is
//! multiplied block by block.

use nalgebra::{DMatrix, DVector};

use super::linear::{lower_times, sandwich, singular, whitener};
use super::system::BlockSystem;
use super::{Block, Linearised};
use crate::measure::adjust::AdjustError;

/// Blocks on their way into the normal equations.
pub(super) struct Stack {
    local: usize,
    conditions: usize,
    unclosed: f64,
}

/// Columns of one block that few others share.
pub(super) struct Own {
    pub(super) columns: Vec<usize>,
    /// Stack' times these, one column each.
    pub(super) with_stack: DMatrix<f64>,
    pub(super) square: DMatrix<f64>,
}

/// Products of a group.
pub(super) struct Stacked {
    /// Global columns in the stack.
    pub(super) shared: Vec<usize>,
    /// Square of (local, shared, contradiction).
    pub(super) product: DMatrix<f64>,
    pub(super) own: Vec<Own>,
    /// f' M^-1 f.
    pub(super) unclosed: f64,
}

impl Stack {
    pub(super) fn new(local: usize) -> Self {
        Self { local, conditions: 0, unclosed: 0.0 }
    }

    /// Prepares a block.
    pub(super) fn push(
        &mut self,
        block: &Block,
        residuals: &DVector<f64>,
        linearised: Linearised,
    ) -> Result<BlockSystem, AdjustError> {
        let linearised = trimmed(linearised);
        let b = &linearised.observations;
        let mut contradiction = linearised.misclosure.clone();
        contradiction.gemv(-1.0, b, residuals, 1.0);
        let whitener = whitener(&sandwich(b, &block.covariance))
            .ok_or_else(|| singular("a condition without an observation of its own"))?;
        let n = contradiction.len();
        let mut open = vec![0.0; n];
        lower_times(&whitener, linearised.misclosure.as_slice(), &mut open);
        self.unclosed += open.iter().map(|v| v * v).sum::<f64>();
        self.conditions += n;
        Ok(BlockSystem { linearised, contradiction, whitener })
    }

    /// Multiplies.
    pub(super) fn finish(self, blocks: &[BlockSystem]) -> Stacked {
        let shared = shared_columns(blocks);
        let (q, last) = (self.local, self.local + shared.len());
        let mut rows = DMatrix::zeros(self.conditions, last + 1);
        let mut first = 0;
        for block in blocks {
            let n = block.contradiction.len().max(1);
            let mut put = |target: usize, values: &[f64]| {
                let start = target * self.conditions + first;
                lower_times(&block.whitener, values, &mut rows.as_mut_slice()[start..start + n]);
            };
            let lin = &block.linearised;
            lin.local.as_slice().chunks_exact(n).enumerate().for_each(|(k, values)| put(k, values));
            for (column, values) in lin.columns.iter().zip(lin.global.as_slice().chunks_exact(n)) {
                if let Ok(at) = shared.binary_search(column) {
                    put(q + at, values);
                }
            }
            put(last, block.contradiction.as_slice());
            first += block.contradiction.len();
        }
        let mut own = vec![];
        first = 0;
        for block in blocks {
            own.extend(own_part(block, &shared, &rows, first));
            first += block.contradiction.len();
        }
        // Transposed first: nalgebra's product is many times faster than its `tr_mul`.
        Stacked { product: rows.transpose() * rows, shared, own, unclosed: self.unclosed }
    }
}

/// Columns that the first two blocks have, ascending: most of what the group has in common.
fn shared_columns(blocks: &[BlockSystem]) -> Vec<usize> {
    let of = |k: usize| blocks.get(k).map(|b| &b.linearised.columns);
    let mut shared = of(0).cloned().unwrap_or_default();
    if let Some(next) = of(1) {
        shared.retain(|column| next.contains(column));
    }
    shared.sort_unstable();
    shared
}

fn own_part(block: &BlockSystem, shared: &[usize], rows: &DMatrix<f64>, first: usize) -> Option<Own> {
    let n = block.contradiction.len().max(1);
    let lin = &block.linearised;
    let mut columns = vec![];
    let mut white = Vec::with_capacity(lin.global.len());
    for (&column, values) in lin.columns.iter().zip(lin.global.as_slice().chunks_exact(n)) {
        if shared.binary_search(&column).is_err() {
            columns.push(column);
            let start = white.len();
            white.resize(start + n, 0.0);
            lower_times(&block.whitener, values, &mut white[start..]);
        }
    }
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let column = |k: usize| &white[k * n..(k + 1) * n];
    let stacked = |k: usize| &rows.as_slice()[k * rows.nrows() + first..k * rows.nrows() + first + n];
    (!columns.is_empty()).then(|| Own {
        with_stack: DMatrix::from_fn(rows.ncols(), columns.len(), |i, a| dot(stacked(i), column(a))),
        square: DMatrix::from_fn(columns.len(), columns.len(), |i, j| dot(column(i), column(j))),
        columns,
    })
}

/// Without the parameters that the block does not depend on here.
fn trimmed(mut linearised: Linearised) -> Linearised {
    let used = |k: usize| linearised.global.column(k).iter().any(|&v| v != 0.0);
    if !(0..linearised.columns.len()).all(used) {
        let keep: Vec<usize> = (0..linearised.columns.len()).filter(|&k| used(k)).collect();
        linearised.global = linearised.global.select_columns(&keep);
        linearised.columns = keep.into_iter().map(|k| linearised.columns[k]).collect();
    }
    linearised
}
