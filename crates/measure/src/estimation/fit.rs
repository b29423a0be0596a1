//! The solution of a problem, and propagation of its covariance to functions of the unknowns.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::linear::{add_products, dot_product};
use super::problem::{InformationPrior, Linearised};

/// Solution of one block.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockFit {
    /// Adjusted minus observed.
    pub residuals: DVector<f64>,
    /// Conditions with their derivatives at the solution.
    pub linearised: Linearised,
    /// `Q B' M^-1`: minus the derivative of the residuals with respect to the conditions.
    pub(super) gain: DMatrix<f64>,
    /// `Q - Q B' M^-1 B Q`: covariance of the adjusted observations for given parameters.
    pub(super) conditional: DMatrix<f64>,
}

/// Solution of one group.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupFit {
    pub local: DVector<f64>,
    /// Derivative of the local parameters with respect to the global ones, at the minimum.
    pub sensitivity: DMatrix<f64>,
    /// Covariance of the local parameters for given global parameters.
    pub conditional: DMatrix<f64>,
    /// Covariance of local with global parameters (local x global).
    pub(super) cross: DMatrix<f64>,
    /// Covariance of the local parameters.
    pub covariance: DMatrix<f64>,
    pub blocks: Vec<BlockFit>,
}

/// Solution of a [`Problem`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    pub global: DVector<f64>,
    /// Covariance of the global parameters, a priori (variance factor 1).
    pub covariance: DMatrix<f64>,
    /// Derivative of the global parameters with respect to the right side of the normal equations.
    pub(super) response: DMatrix<f64>,
    /// Inverse of the covariance: the normal matrix, if that is close to the second derivatives.
    pub information: DMatrix<f64>,
    pub groups: Vec<GroupFit>,
    /// Weighted sum of squared residuals, priors included.
    pub omega: f64,
    /// Contribution of the priors to `omega`.
    pub omega_priors: f64,
    /// Conditions and priors minus parameters.
    pub redundancy: usize,
    /// Iterations until convergence.
    pub iterations: usize,
}

/// Derivatives of functions of the unknowns of one group, one column per function.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradient {
    /// Global parameters on which the functions depend, each once.
    pub columns: Vec<usize>,
    /// Derivatives with respect to these global parameters (columns x functions).
    pub global: DMatrix<f64>,
    /// Derivatives with respect to the group's local parameters (local x functions).
    pub local: DMatrix<f64>,
    /// Derivatives with respect to adjusted observations: (block, observations x functions).
    pub observed: Vec<(usize, DMatrix<f64>)>,
}

impl Gradient {
    /// Creates functions with derivatives 0.
    pub fn empty(columns: Vec<usize>, local: usize, functions: usize) -> Self {
        Self {
            global: DMatrix::zeros(columns.len(), functions),
            local: DMatrix::zeros(local, functions),
            observed: vec![],
            columns,
        }
    }

    fn function_count(&self) -> usize {
        self.global.ncols()
    }

    /// Returns these functions, followed by some global parameters as functions of their own.
    pub fn with_parameters(&self, parameters: &[usize]) -> Self {
        let mut columns = self.columns.clone();
        columns.extend(
            parameters
                .iter()
                .filter(|column| !self.columns.contains(column)),
        );
        let count = self.function_count() + parameters.len();
        let mut global = self.global.clone().resize(columns.len(), count, 0.0);
        for (row, column) in columns.iter().enumerate() {
            let function = parameters.iter().position(|parameter| parameter == column);
            function
                .into_iter()
                .for_each(|k| global[(row, self.function_count() + k)] = 1.0);
        }
        let widen = |m: &DMatrix<f64>| m.clone().resize_horizontally(count, 0.0);
        let observed = self
            .observed
            .iter()
            .map(|(block, by)| (*block, widen(by)))
            .collect();
        Self {
            columns,
            global,
            local: widen(&self.local),
            observed,
        }
    }

    /// Returns a single function.
    pub fn single_function(&self, index: usize) -> Self {
        let column = |m: &DMatrix<f64>| m.columns(index, 1).into_owned();
        let observed = self.observed.iter().map(|(block, by)| (*block, column(by)));
        Self {
            columns: self.columns.clone(),
            global: column(&self.global),
            local: column(&self.local),
            observed: observed.collect(),
        }
    }
}

/// Covariance of functions in two parts: `total Qxx total' + own`. Functions of different groups have the covariance
/// `total_1 Qxx total_2'`.
#[derive(Clone, Debug, PartialEq)]
pub struct PropagatedCovariance {
    /// Total derivative with respect to the global parameters.
    pub total: DMatrix<f64>,
    /// Covariance for given global parameters.
    pub own: DMatrix<f64>,
}

impl Fit {
    /// Returns the a-posteriori variance factor; `None` at redundancy 0.
    pub fn variance_factor(&self) -> Option<f64> {
        (self.redundancy > 0).then(|| self.omega / self.redundancy as f64)
    }

    /// Returns the residuals by group and block.
    pub fn residuals(&self) -> Vec<Vec<DVector<f64>>> {
        let of_group =
            |group: &GroupFit| group.blocks.iter().map(|b| b.residuals.clone()).collect();
        self.groups.iter().map(of_group).collect()
    }

    /// Returns the solution's information about the global parameters, as a prior for another problem.
    pub fn information_prior(&self) -> InformationPrior {
        let conditions = self.global.len();
        InformationPrior {
            mean: self.global.clone(),
            information: self.information.clone(),
            conditions,
        }
    }

    /// Replaces adjusted observations by the parameters on which they depend. Returns functions of parameters alone and the
    /// covariance of the remaining noise.
    pub(super) fn eliminate_observations<'a>(
        &self,
        group: usize,
        gradient: &'a Gradient,
    ) -> (Cow<'a, Gradient>, DMatrix<f64>) {
        let functions = gradient.function_count();
        let mut own = DMatrix::zeros(functions, functions);
        if gradient.observed.is_empty() {
            return (Cow::Borrowed(gradient), own);
        }
        let mut by = Gradient {
            observed: vec![],
            ..gradient.clone()
        };
        for (index, derivative) in &gradient.observed {
            let block = &self.groups[group].blocks[*index];
            let lin = &block.linearised;
            let answer = small_product(&block.gain, derivative);
            for (k, column) in lin.columns.iter().enumerate() {
                let at = by
                    .columns
                    .iter()
                    .position(|c| c == column)
                    .unwrap_or_else(|| {
                        by.columns.push(*column);
                        by.global.resize_vertically_mut(by.columns.len(), 0.0);
                        by.columns.len() - 1
                    });
                for f in 0..functions {
                    by.global[(at, f)] -= lin.global.column(k).dot(&answer.column(f));
                }
            }
            by.local -= small_product(&lin.local, &answer);
            own += small_product(derivative, &small_product(&block.conditional, derivative));
        }
        (Cow::Owned(by), own)
    }

    /// Splits functions of one group into their dependence on the global parameters and their own noise.
    pub fn propagate(&self, group: usize, gradient: &Gradient) -> PropagatedCovariance {
        let (by, mut own) = self.eliminate_observations(group, gradient);
        if by.local.nrows() > 0 {
            own += by.local.transpose() * (&self.groups[group].conditional * &by.local);
        }
        PropagatedCovariance {
            total: self.total_derivative(group, &by),
            own,
        }
    }

    /// Derivative of functions of parameters alone with respect to the global ones, on which the local ones depend.
    fn total_derivative(&self, group: usize, by: &Gradient) -> DMatrix<f64> {
        let mut total = DMatrix::zeros(by.function_count(), self.global.len());
        for (k, &column) in by.columns.iter().enumerate() {
            (0..by.function_count()).for_each(|f| total[(f, column)] += by.global[(k, f)]);
        }
        if by.local.nrows() > 0 {
            total += by.local.transpose() * &self.groups[group].sensitivity;
        }
        total
    }

    /// Returns a factor `F` of the covariance of functions of one group for given global parameters: `own = F F'` of
    /// [`Fit::propagate`] (functions x any number of independent sources). Also returns the total derivative with respect
    /// to the global parameters.
    pub fn propagate_factors(
        &self,
        group: usize,
        gradient: &Gradient,
    ) -> (DMatrix<f64>, DMatrix<f64>) {
        let (by, _) = self.eliminate_observations(group, gradient);
        let total = self.total_derivative(group, &by);
        let fit = &self.groups[group];
        let mut parts = vec![by.local.tr_mul(&symmetric_root(&fit.conditional))];
        for (index, derivative) in &gradient.observed {
            parts.push(derivative.tr_mul(&symmetric_root(&fit.blocks[*index].conditional)));
        }
        let columns: Vec<_> = parts.iter().flat_map(|part| part.column_iter()).collect();
        let own = match columns.is_empty() {
            true => DMatrix::zeros(gradient.function_count(), 0),
            false => DMatrix::from_columns(&columns),
        };
        (total, own)
    }

    /// Returns the covariance of functions of one group.
    pub fn function_covariance(&self, group: usize, gradient: &Gradient) -> DMatrix<f64> {
        let (by, mut covariance) = self.eliminate_observations(group, gradient);
        let common = FunctionCovariance::new(self, group, &by);
        for f in 0..by.function_count() {
            for g in 0..=f {
                let both = common.entry(f, g);
                covariance[(f, g)] += both;
                if g < f {
                    covariance[(g, f)] += both;
                }
            }
        }
        covariance
    }

    /// Returns the variances of functions of one group.
    pub fn function_variances(&self, group: usize, gradient: &Gradient) -> Vec<f64> {
        let (by, own) = self.eliminate_observations(group, gradient);
        let common = FunctionCovariance::new(self, group, &by);
        (0..by.function_count())
            .map(|f| own[(f, f)] + common.entry(f, f))
            .collect()
    }

    /// Returns the covariance of a block's adjusted observations, a priori.
    pub fn adjusted_covariance(&self, group: usize, block: usize) -> DMatrix<f64> {
        let block = &self.groups[group].blocks[block];
        let lin = &block.linearised;
        let conditions = Gradient {
            columns: lin.columns.clone(),
            global: lin.global.transpose(),
            local: lin.local.transpose(),
            observed: vec![],
        };
        let covariance = self.function_covariance(group, &conditions);
        &block.gain * covariance * block.gain.transpose() + &block.conditional
    }
}

/// Computes the symmetric root of a positive semidefinite matrix.
pub fn symmetric_root(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    if matrix.is_empty() {
        return matrix.clone();
    }
    let SymmetricEigen {
        eigenvectors,
        eigenvalues,
    } = SymmetricEigen::new(matrix.clone());
    &eigenvectors
        * DMatrix::from_diagonal(&eigenvalues.map(|l| l.max(0.0).sqrt()))
        * eigenvectors.transpose()
}

/// Covariance of functions through the parameters that they share.
struct FunctionCovariance<'a> {
    by: &'a Gradient,
    /// Covariance of the gradient's global columns with the functions.
    with_global: DMatrix<f64>,
    /// Covariance of the local parameters with the functions.
    with_local: DMatrix<f64>,
}

impl<'a> FunctionCovariance<'a> {
    fn new(fit: &Fit, group: usize, by: &'a Gradient) -> Self {
        let (q, n) = (by.local.nrows(), by.columns.len());
        let group = &fit.groups[group];
        // Most columns of a block are neighbours.
        let runs: Vec<_> = by
            .columns
            .chunk_by(|a, b| a + 1 == *b)
            .map(|run| run[0]..run[0] + run.len())
            .collect();
        let mut shared = Vec::with_capacity(n * n);
        for &column in &by.columns {
            let covariance = fit.covariance.column(column);
            for run in &runs {
                shared.extend_from_slice(&covariance.as_slice()[run.clone()]);
            }
        }
        let cross = group.cross.select_columns(&by.columns);
        let mut with_global = small_product(&cross, &by.local);
        let mut with_local = DMatrix::zeros(q, by.function_count());
        let (global, local) = (with_global.as_mut_slice(), with_local.as_mut_slice());
        add_products(global, &shared, n, by.global.as_slice());
        add_products(local, cross.as_slice(), q, by.global.as_slice());
        add_products(local, group.covariance.as_slice(), q, by.local.as_slice());
        Self {
            by,
            with_global,
            with_local,
        }
    }

    /// Returns the covariance of two functions.
    fn entry(&self, f: usize, g: usize) -> f64 {
        self.by.global.column(g).dot(&self.with_global.column(f))
            + self.by.local.column(g).dot(&self.with_local.column(f))
    }
}

/// Returns `a' b`, for matrices too small for a library's product.
fn small_product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let n = a.nrows().max(1);
    let mut out = DMatrix::zeros(a.ncols(), b.ncols());
    for (column, b) in out
        .as_mut_slice()
        .chunks_exact_mut(a.ncols().max(1))
        .zip(b.as_slice().chunks_exact(n))
    {
        for (target, a) in column.iter_mut().zip(a.as_slice().chunks_exact(n)) {
            *target = dot_product(a, b);
        }
    }
    out
}
