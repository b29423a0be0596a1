//! Observation blocks for the estimation engine, and the lower bound on image standard deviations.

use nalgebra::{DMatrix, DVector, Matrix2};

use super::Observation;
use super::input::AdjustmentInput;
use crate::estimation::Block;

/// Smallest standard deviation assumed for an image coordinate, px. It corresponds to some micrometres on a nearby quadrant
/// target; neither a decal nor a lens calibration is more precise than that.
const MIN_SIGMA_PX: f64 = 0.005;

/// Computes the covariance with which an image coordinate enters the spatial methods, px^2: standard deviations below
/// [`MIN_SIGMA_PX`] are raised to it, along the axes of the error ellipse.
fn image_covariance(stated_px2: &Matrix2<f64>) -> Matrix2<f64> {
    let least = MIN_SIGMA_PX * MIN_SIGMA_PX;
    let axes = stated_px2.symmetric_eigen();
    if axes.eigenvalues.min() >= least {
        return *stated_px2;
    }
    let raised = Matrix2::from_diagonal(&axes.eigenvalues.map(|v| v.max(least)));
    axes.eigenvectors * raised * axes.eigenvectors.transpose()
}

/// Builds the block of one image observation.
pub fn image_block(seen: &Observation) -> Block {
    Block {
        observed: DVector::from_column_slice(seen.pixel.as_slice()),
        covariance: DMatrix::from_column_slice(
            2,
            2,
            image_covariance(&seen.covariance_px2).as_slice(),
        ),
    }
}

/// Builds a marker's block: its surveyed position in the wing frame, followed by its image coordinates.
pub fn survey_block<'a>(
    input: &AdjustmentInput,
    marker: usize,
    images: impl Iterator<Item = &'a Observation> + Clone,
) -> Block {
    let mut observed = input.scene.ground.stations[marker]
        .surveyed_m
        .as_slice()
        .to_vec();
    observed.extend(images.clone().flat_map(|o| [o.pixel.x, o.pixel.y]));
    let variance = input.setup.markers[marker].sigma_m.powi(2);
    let mut covariance = DMatrix::zeros(observed.len(), observed.len());
    covariance
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&input.scene.point_covariances_m2[marker]);
    (0..3).for_each(|k| covariance[(k, k)] += variance);
    for (k, image) in images.enumerate() {
        let at = 3 + 2 * k;
        covariance
            .fixed_view_mut::<2, 2>(at, at)
            .copy_from(&image_covariance(&image.covariance_px2));
    }
    Block {
        observed: DVector::from_vec(observed),
        covariance,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_small_sigmas_are_raised() {
        let wide = Matrix2::new(0.01, 0.002, 0.002, 0.0025);
        assert_eq!(image_covariance(&wide), wide);
        let sharp = Matrix2::new(0.01, 1e-6, 1e-6, 1e-6);
        let raised = image_covariance(&sharp);
        assert!((raised[(0, 0)] - 0.01).abs() < 1e-7 && (raised[(1, 1)] - 2.5e-5).abs() < 1e-8);
        assert!((raised[(0, 1)] - raised[(1, 0)]).abs() < 1e-15);
        let smallest = raised.symmetric_eigen().eigenvalues.min();
        assert!((smallest - 2.5e-5).abs() < 1e-12);
    }
}
