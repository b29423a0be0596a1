//! Values of shapes before they are written: bending moments, displacements in the CAD frame, reduced factors.

use std::rc::Rc;

use nalgebra::{DMatrix, DVector, SMatrix, SymmetricEigen, Vector3};

use super::{CadValues, LOST_VARIANCE, ReducedShape, factors};
use wingd_evaluation::installation::Installation;
use wingd_measure::adjust::{JointShape, ShapeMean, principal_sources};
use wingd_measure::geometry::TransformFit;
use wingd_measure::setup::Width;
use wingd_measure::stress::{BendingCurvature, DEFAULT_STEPS};

/// Adds the moments at the installation's sections to the functions of a shape, and returns their factor by the errors of
/// stiffness (one source for each section) and root (moments x sources).
pub(super) fn add_moments(
    mean: &mut ShapeMean,
    shape: &JointShape,
    installation: &Installation,
) -> DMatrix<f64> {
    let sections = installation.structure.as_ref().map(|s| &s.sections[..]);
    let sections = sections.unwrap_or_default();
    let (first, count) = (shape.curvature_function(), shape.curvature_terms);
    let curvature = BendingCurvature {
        coefficients_per_m: mean.values.rows(first, count).into_owned(),
        covariance: DMatrix::zeros(count, count),
        length_m: shape.length_m,
        root_sigma_m: installation.setup.uncertainty[Width::RootOffset],
        steps: DEFAULT_STEPS,
    };
    let rows = mean.values.len();
    let mut stiffness = DMatrix::zeros(sections.len(), sections.len() + 1);
    let mut linear = DMatrix::zeros(sections.len(), count);
    for (k, section) in sections.iter().enumerate() {
        let moment = curvature.moment_function(section);
        stiffness[(k, k)] = moment.by_stiffness;
        stiffness[(k, sections.len())] = moment.by_root;
        linear.set_row(k, &moment.by_coefficient.transpose());
    }
    let extend = |matrix: &DMatrix<f64>| {
        let added = &linear * matrix.rows(first, count);
        let mut all = matrix.clone().resize_vertically(rows + sections.len(), 0.0);
        all.rows_mut(rows, sections.len()).copy_from(&added);
        all
    };
    mean.lasting = extend(&mean.lasting);
    mean.shared = extend(&mean.shared);
    mean.own = extend(&mean.own);
    let added = &linear * mean.values.rows(first, count);
    let joined = mean.values.iter().chain(added.iter()).copied();
    mean.values = DVector::from_iterator(rows + sections.len(), joined);
    stiffness
}

/// Reduces the factors of a flight's shapes to the sources that carry their variance and that of their differences.
pub(super) fn reduce_shapes(shapes: &mut [ReducedShape]) {
    let take = |shapes: &[ReducedShape], kind: usize| -> Vec<DMatrix<f64>> {
        let of = |one: &ReducedShape| factors(&one.dated.shape)[kind].clone();
        shapes.iter().map(of).collect()
    };
    let [lasting, shared] = [0, 1].map(|kind| common_basis(&take(shapes, kind)));
    let basis = Rc::new(lasting);
    for one in shapes {
        let own = common_basis(std::slice::from_ref(&one.dated.shape.own));
        let shape = &mut one.dated.shape;
        let parts = [
            (&mut shape.lasting, &*basis),
            (&mut shape.shared, &shared),
            (&mut shape.own, &own),
        ];
        one.rests = parts.map(|(factor, basis)| {
            let reduced = &*factor * basis;
            let rest = |k: usize| {
                let lost = factor.row(k).norm_squared() - reduced.row(k).norm_squared();
                lost.max(0.0).sqrt()
            };
            let rests = DVector::from_fn(factor.nrows(), |k, _| rest(k));
            *factor = reduced;
            rests
        });
        one.basis = Some(Rc::clone(&basis)).filter(|basis| basis.ncols() > 0);
    }
}

/// Deviations from the mean of the frames below this fraction of a value's standard deviation are rounding.
const MIN_DEVIATION: f64 = 1e-9;

/// Returns the basis (sources x reduced sources) that carries the variance of each value of factors with common sources, and
/// that of its deviation from the mean: in differences of frames, common errors cancel.
fn common_basis(factors: &[DMatrix<f64>]) -> DMatrix<f64> {
    let Some(first) = factors.first() else {
        return DMatrix::zeros(0, 0);
    };
    let (rows, sources) = first.shape();
    let sum = factors
        .iter()
        .fold(DMatrix::zeros(rows, sources), |sum, factor| sum + factor);
    let mean = sum / factors.len() as f64;
    let deviation = |factor: &DMatrix<f64>| {
        let mut off = factor - &mean;
        for (mut row, of_factor) in off.row_iter_mut().zip(factor.row_iter()) {
            if row.norm() <= MIN_DEVIATION * of_factor.norm() {
                row.fill(0.0);
            }
        }
        off
    };
    let deviations: Vec<_> = factors.iter().map(deviation).collect();
    principal_sources(&[factors, &deviations].concat(), LOST_VARIANCE)
}

impl CadValues {
    /// Transforms displacements, three values each, to the CAD frame. Its sources are those of rotation and scale.
    pub(super) fn new(shape: &ShapeMean, rows: &[usize], fit: &TransformFit) -> Self {
        let linear = fit.transform.rotation.matrix() * fit.transform.scale;
        let of_fit = fit_factor(fit);
        let mut by_fit = DMatrix::zeros(rows.len(), of_fit.ncols());
        let (mut values, mut sigmas) = (vec![], vec![]);
        for (k, triple) in rows.chunks_exact(3).enumerate() {
            let moved = linear * Vector3::from_fn(|i, _| shape.values[triple[i]]);
            let mut jacobian = SMatrix::<f64, 3, 4>::zeros();
            jacobian
                .fixed_columns_mut::<3>(0)
                .copy_from(&-moved.cross_matrix());
            jacobian.set_column(3, &(moved / fit.transform.scale));
            let of_triple = jacobian * of_fit;
            by_fit.rows_mut(3 * k, 3).copy_from(&of_triple);
            let turned = factors(shape).map(|factor| linear * factor.select_rows(triple));
            let variance = |row: usize| {
                let parts = turned.iter().map(|factor| factor.row(row).norm_squared());
                parts.sum::<f64>() + of_triple.row(row).norm_squared()
            };
            values.extend(moved.iter());
            sigmas.extend((0..3).map(|row| match moved[row].is_nan() {
                true => f64::NAN,
                false => variance(row).sqrt(),
            }));
        }
        Self {
            values,
            sigmas,
            fit: by_fit,
        }
    }
}

/// Symmetric root of the covariance of small rotation (rad) and scale of a fitted transform.
fn fit_factor(fit: &TransformFit) -> SMatrix<f64, 4, 4> {
    /// Rows of rotation and scale in the covariance of a fit; a displacement does not depend on the translation.
    const PARAMETERS: [usize; 4] = [0, 1, 2, 6];
    let covariance =
        SMatrix::<f64, 4, 4>::from_fn(|i, j| fit.covariance[(PARAMETERS[i], PARAMETERS[j])]);
    let SymmetricEigen {
        eigenvectors,
        eigenvalues,
    } = SymmetricEigen::new(covariance);
    eigenvectors
        * SMatrix::from_diagonal(&eigenvalues.map(|v| v.max(0.0).sqrt()))
        * eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two factors of forty sources: one source carries nearly all, another the difference, the others are small.
    fn two_factors() -> [DMatrix<f64>; 2] {
        [1.0, -1.0].map(|sign| {
            DMatrix::from_fn(12, 40, |row, source| match source {
                0 => 1.0 + row as f64,
                1 => sign * 1e-2,
                _ => 1e-4 * ((row * 40 + source) as f64).sin(),
            })
        })
    }

    #[test]
    fn reduced_factors_carry_the_variance_of_values_and_of_differences() {
        let factors = two_factors();
        let basis = common_basis(&factors);
        assert!(
            basis.ncols() >= 2 && basis.ncols() < 12,
            "{}",
            basis.ncols()
        );
        let carried = |factor: &DMatrix<f64>| {
            let reduced = factor * &basis;
            for (part, whole) in reduced.row_iter().zip(factor.row_iter()) {
                let lost = 1.0 - part.norm_squared() / whole.norm_squared();
                // An orthonormal basis adds nothing but rounding.
                assert!((-1e-12..LOST_VARIANCE).contains(&lost), "{lost}");
            }
        };
        factors.iter().for_each(carried);
        carried(&(&factors[0] - &factors[1]));
        // Factors without sources, as those of frames that were adjusted singly, stay so.
        assert_eq!(common_basis(&[DMatrix::zeros(3, 0)]).ncols(), 0);
    }
}
