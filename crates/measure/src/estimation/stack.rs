//! The blocks of a group, whitened and stacked, so that one matrix product covers the parameters on which most blocks
//! depend. Parameters of few blocks (a marker's own position) are multiplied block by block.

use nalgebra::{DMatrix, DVector};

use super::error::EstimationResult;
use super::linear::{Whitener, add_scaled, add_square, dot_product};
use super::problem::{Block, Linearised};

/// Contribution of one block to the normal equations.
#[derive(Default)]
pub(super) struct BlockSystem {
    /// Vector `w = f(l0) + B (l - l0)`.
    pub(super) contradiction: DVector<f64>,
    pub(super) whitener: Whitener,
    /// Index in the stack for each column of the block; from the stack's width on, index among the block's own columns.
    positions: Vec<usize>,
    /// Global columns of this block alone.
    own: Vec<usize>,
}

/// Blocks of a group, and the part of the equations that is equal at all points.
pub(super) struct BlockStack {
    /// Global columns in the stack, ascending.
    pub(super) shared: Vec<usize>,
    pub(super) blocks: Vec<BlockSystem>,
    local: usize,
}

/// Workspace that the groups use one after the other.
#[derive(Default)]
pub(super) struct Workspace {
    /// Stack, one condition after the other: local, shared, contradiction.
    rows: Vec<f64>,
    /// Lower triangle of the stack's square.
    pub(super) product: Vec<f64>,
    own: Vec<f64>,
    /// Product of the stack with one of a block's own columns.
    with: Vec<f64>,
}

/// Destination of a group's products, with indices of the global parameters.
pub(super) struct ProductTarget<'a> {
    /// Lower triangle.
    pub(super) normal: &'a mut DMatrix<f64>,
    pub(super) right: &'a mut DVector<f64>,
    /// Matrix `(L' M^-1 A)'`, global x local.
    pub(super) coupling: &'a mut DMatrix<f64>,
}

impl BlockStack {
    /// Creates the stack for blocks with these columns.
    pub(super) fn new(local: usize, linearised: &[Linearised]) -> Self {
        let shared = shared_columns(linearised);
        let block = |lin: &Linearised| {
            let mut system = BlockSystem::default();
            for column in &lin.columns {
                let position = match shared.binary_search(column) {
                    Ok(at) => local + at,
                    Err(_) => {
                        system.own.push(*column);
                        local + shared.len() + system.own.len()
                    }
                };
                system.positions.push(position);
            }
            system
        };
        let blocks = linearised.iter().map(block).collect();
        Self {
            shared,
            blocks,
            local,
        }
    }

    /// Returns the number of columns: local, shared, contradiction.
    pub(super) fn width(&self) -> usize {
        self.local + self.shared.len() + 1
    }

    /// Whitens and stacks the blocks, adds the products of each block's own columns, and leaves the square of the stack in
    /// the workspace. Returns `f' M^-1 f`.
    pub(super) fn accumulate_products(
        &mut self,
        data: &[Block],
        residuals: &[DVector<f64>],
        linearised: &[Linearised],
        workspace: &mut Workspace,
        target: &mut ProductTarget,
    ) -> EstimationResult<f64> {
        let width = self.width();
        let conditions: usize = linearised.iter().map(|l| l.misclosure.len()).sum();
        workspace.rows.clear();
        workspace.rows.resize(width * conditions, 0.0);
        workspace.with.resize(width, 0.0);
        let (mut first, mut unclosed) = (0, 0.0);
        for (k, lin) in linearised.iter().enumerate() {
            let block = &mut self.blocks[k];
            block.update_contradiction(&data[k], &residuals[k], lin)?;
            unclosed += block.whitener.weighted_square(lin.misclosure.as_slice());
            let n = lin.misclosure.len();
            let rows = &mut workspace.rows[first * width..(first + n) * width];
            workspace.own.resize(n * block.own.len(), 0.0);
            block.whiten(lin, rows, &mut workspace.own);
            for (a, &column) in block.own.iter().enumerate() {
                let values = &workspace.own[a * n..(a + 1) * n];
                workspace.with.fill(0.0);
                for (row, &value) in rows.chunks_exact(width).zip(values) {
                    add_scaled(&mut workspace.with, value, row);
                }
                target.add_column_products(column, &workspace.with, self.local, &self.shared);
                for (b, &other) in block.own.iter().enumerate().take(a + 1) {
                    let square = dot_product(values, &workspace.own[b * n..(b + 1) * n]);
                    target.normal[(column.max(other), column.min(other))] += square;
                }
            }
            first += n;
        }
        workspace.product.clear();
        workspace.product.resize(width * width, 0.0);
        add_square(&mut workspace.product, 1.0, &workspace.rows, width);
        Ok(unclosed)
    }
}

impl ProductTarget<'_> {
    fn add_column_products(&mut self, column: usize, with: &[f64], local: usize, shared: &[usize]) {
        let p = self.right.len();
        let coupling = self
            .coupling
            .as_mut_slice()
            .iter_mut()
            .skip(column)
            .step_by(p);
        coupling
            .zip(&with[..local])
            .for_each(|(target, value)| *target += value);
        let normal = self.normal.as_mut_slice();
        for (value, &other) in with[local..].iter().zip(shared) {
            normal[column.min(other) * p + column.max(other)] += value;
        }
        self.right[column] -= with[with.len() - 1];
    }
}

impl BlockSystem {
    fn update_contradiction(
        &mut self,
        data: &Block,
        residuals: &DVector<f64>,
        lin: &Linearised,
    ) -> EstimationResult<()> {
        self.whitener.update(&lin.observations, &data.covariance)?;
        self.contradiction.clone_from(&lin.misclosure);
        let contradiction = self.contradiction.as_mut_slice();
        let n = contradiction.len().max(1);
        for (by, &residual) in lin
            .observations
            .as_slice()
            .chunks_exact(n)
            .zip(residuals.as_slice())
        {
            add_scaled(contradiction, -residual, by);
        }
        Ok(())
    }

    /// Multiplies the block's derivatives and contradiction by `W`.
    fn whiten(&self, lin: &Linearised, rows: &mut [f64], own: &mut [f64]) {
        // Of a marker without an image only the survey is known.
        if lin.misclosure.is_empty() {
            return;
        }
        // Images are pairs of coordinates; a single frame has two images of each marker.
        if let Some(white) = self.whitener.row_arrays::<2>() {
            self.whiten_fixed_size(&white, lin, rows, own);
        } else if let Some(white) = self.whitener.row_arrays::<4>() {
            self.whiten_fixed_size(&white, lin, rows, own);
        } else {
            let n = lin.misclosure.len().max(1);
            let width = rows.len() / n;
            for (position, values) in self.indexed_columns(lin, n, width) {
                for i in 0..n {
                    let white = self.whitener.row_times(i, values);
                    match position.checked_sub(width) {
                        None => rows[i * width + position] = white,
                        Some(a) => own[a * n + i] = white,
                    }
                }
            }
        }
    }

    fn whiten_fixed_size<const N: usize>(
        &self,
        white: &[[f64; N]; N],
        lin: &Linearised,
        rows: &mut [f64],
        own: &mut [f64],
    ) {
        let width = rows.len() / N;
        for (position, values) in self.indexed_columns(lin, N, width) {
            let Ok(values) = <&[f64; N]>::try_from(values) else {
                continue;
            };
            let by = white.map(|row| row.iter().zip(values).map(|(w, v)| w * v).sum::<f64>());
            match position.checked_sub(width) {
                None => (0..N).for_each(|i| rows[i * width + position] = by[i]),
                Some(a) => own[a * N..(a + 1) * N].copy_from_slice(&by),
            }
        }
    }

    /// Returns the columns of a block of `n` conditions with their indices.
    fn indexed_columns<'a>(
        &'a self,
        lin: &'a Linearised,
        n: usize,
        width: usize,
    ) -> impl Iterator<Item = (usize, &'a [f64])> {
        let local = lin.local.as_slice().chunks_exact(n).enumerate();
        let global = self
            .positions
            .iter()
            .copied()
            .zip(lin.global.as_slice().chunks_exact(n));
        local
            .chain(global)
            .chain([(width - 1, self.contradiction.as_slice())])
    }
}

/// Returns the columns that the first two blocks share, ascending: most of the columns that the group shares.
fn shared_columns(blocks: &[Linearised]) -> Vec<usize> {
    let mut shared = blocks
        .first()
        .map(|b| b.columns.clone())
        .unwrap_or_default();
    if let Some(next) = blocks.get(1) {
        shared.retain(|column| next.columns.contains(column));
    }
    shared.sort_unstable();
    shared
}
