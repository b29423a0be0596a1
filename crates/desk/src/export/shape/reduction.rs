//! Moments, which follow from other functions of shapes, and reduced factors.

use std::rc::Rc;

use nalgebra::{DMatrix, DVector};

use super::{ExportedShape, LOST_VARIANCE};
use wingd_evaluation::installation::Installation;
use wingd_measure::adjust::{FrameShape, JointShape, principal_sources};
use wingd_measure::setup::Width;
use wingd_measure::stress::{BendingCurvature, DEFAULT_STEPS};

/// Appends the moments at the installation's sections, and returns their factor by the errors of stiffness (one source for
/// each section) and root (moments x sources).
pub(super) fn append_moments(
    shape: &mut FrameShape,
    joint: &JointShape,
    installation: &Installation,
) -> DMatrix<f64> {
    let sections = installation.structure.as_deref();
    let sections = sections.unwrap_or_default();
    let (first, count) = (joint.curvature_function(), joint.curvature_terms);
    let curvature = BendingCurvature {
        coefficients_per_m: shape.values.rows(first, count).into_owned(),
        covariance: DMatrix::zeros(count, count),
        length_m: joint.length_m,
        root_sigma_m: installation.setup.uncertainty[Width::RootOffset],
        steps: DEFAULT_STEPS,
    };
    let mut stiffness = DMatrix::zeros(sections.len(), sections.len() + 1);
    let mut linear = DMatrix::zeros(sections.len(), count);
    for (k, section) in sections.iter().enumerate() {
        let moment = curvature.moment_function(section);
        stiffness[(k, k)] = moment.by_stiffness;
        stiffness[(k, sections.len())] = moment.by_root;
        linear.set_row(k, &moment.by_coefficient.transpose());
    }
    let extended = |matrix: &DMatrix<f64>| {
        let (old, added) = (matrix.nrows(), &linear * matrix.rows(first, count));
        let mut all = matrix.clone().resize_vertically(old + added.nrows(), 0.0);
        all.rows_mut(old, added.nrows()).copy_from(&added);
        all
    };
    let values = DMatrix::from_columns(std::slice::from_ref(&shape.values));
    shape.values = extended(&values).column(0).into_owned();
    shape.factors = shape.factors.each_ref().map(extended);
    stiffness
}

/// Reduces the factors of a flight's shapes to the sources that carry their variance and that of their differences.
pub(super) fn reduce_shapes(shapes: &mut [ExportedShape]) {
    let [lasting, shared] = [0, 1].map(|kind| {
        let factors = shapes.iter().map(|one| one.factors[kind].clone());
        common_basis(&Vec::from_iter(factors))
    });
    let lasting = Rc::new(lasting);
    for one in shapes {
        let own = common_basis(std::slice::from_ref(&one.factors[2]));
        for (kind, basis) in [&*lasting, &shared, &own].into_iter().enumerate() {
            let factor = &one.factors[kind];
            let reduced = factor * basis;
            let rest = |k: usize| {
                let lost = factor.row(k).norm_squared() - reduced.row(k).norm_squared();
                lost.max(0.0).sqrt()
            };
            one.rests[kind] = DVector::from_fn(factor.nrows(), |k, _| rest(k));
            one.factors[kind] = reduced;
        }
        one.basis = Some(Rc::clone(&lasting)).filter(|basis| basis.ncols() > 0);
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
