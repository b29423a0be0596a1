//! Rigid and similarity transforms from corresponding points: from the survey to the CAD model.

use nalgebra::{DMatrix, Matrix3, Matrix3xX, Rotation3, SMatrix, SVector, Vector3};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::cross_matrix;

/// Similarity transform `target = scale * rotation * source + translation`; scale 1 for a rigid transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Scale, target over source.
    pub scale: f64,
    /// Rotation target_from_source.
    pub rotation: Rotation3<f64>,
    /// Translation in the target frame, m.
    pub translation_m: Vector3<f64>,
}

impl Similarity {
    /// Transforms a point of the source frame to the target frame, m.
    pub fn apply(&self, source_m: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * source_m * self.scale + self.translation_m
    }
}

/// Fitted transform with its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformFit {
    pub transform: Similarity,
    /// 7 x 7, a priori, or a posteriori if the test rejects: small rotation (target frame, left perturbation, rad), translation (m), scale; the scale's row and
    /// column are 0 for a rigid transform.
    pub covariance: DMatrix<f64>,
    /// Residuals target - transform(source) of the points, m.
    pub residuals_m: Vec<Vector3<f64>>,
    /// Number of conditions less that of parameters.
    pub redundancy: usize,
    /// Weighted squared residuals over the redundancy; `None` at redundancy 0.
    pub variance_factor: Option<f64>,
}

/// Reason why no transform was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// Fewer than three points, or all on one line.
    #[error("at least three corresponding points that are not collinear are needed")]
    Degenerate,
    /// Only a reflection would map the points.
    #[error(
        "the two point sets are mirror images of each other; one axis of one frame has the wrong sign"
    )]
    Mirrored,
    /// A coordinate or a standard deviation cannot be used.
    #[error("tie point coordinates must be finite and standard deviations positive")]
    Input,
}

/// Point in both frames with the standard deviation of each coordinate of the source, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointPair {
    pub source_m: Vector3<f64>,
    pub target_m: Vector3<f64>,
    pub sigma_m: f64,
}

/// Ratio of the second to the largest extent of the points below which they count as collinear.
const LINE_RATIO: f64 = 1e-4;
/// Number of Gauss-Newton steps after the closed form; one is enough except for rounding.
const REFINEMENTS: usize = 2;

/// Significance level of the test that decides on the covariance.
const REJECTION_ALPHA: f64 = 0.01;

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;

impl TransformFit {
    /// Estimates the transformation by weighted least squares: the closed form (Umeyama 1991, with the determinant
    /// guard), then Gauss-Newton for the last digits and the covariance.
    ///
    /// # Errors
    /// Returns an error if the points are invalid, collinear or mirrored.
    pub fn estimate(points: &[PointPair], with_scale: bool) -> Result<Self, FitError> {
        let usable = |p: &PointPair| {
            (p.source_m + p.target_m).iter().all(|c| c.is_finite())
                && p.sigma_m > 0.0
                && p.sigma_m.is_finite()
        };
        if !points.iter().all(usable) {
            return Err(FitError::Input);
        }
        if points.len() < 3 {
            return Err(FitError::Degenerate);
        }
        let mut transform = fit_closed_form(points, with_scale)?;
        let mut cofactor = Matrix7::zeros();
        for _ in 0..REFINEMENTS {
            let step;
            (step, cofactor) = gauss_newton_step(points, &transform, with_scale)?;
            transform.rotation = Rotation3::new(step.fixed_rows::<3>(0)) * transform.rotation;
            transform.translation_m += step.fixed_rows::<3>(3);
            transform.scale += step[6];
        }
        let mut fit = Self::from_transform(points, transform, cofactor, with_scale);
        // The standard deviations of points that contradict each other are too small.
        if let (Some(false), Some(factor)) = (fit.passes_test(REJECTION_ALPHA), fit.variance_factor)
        {
            fit.covariance *= factor;
        }
        Ok(fit)
    }

    fn from_transform(
        points: &[PointPair],
        transform: Similarity,
        cofactor: Matrix7,
        with_scale: bool,
    ) -> Self {
        let residuals_m: Vec<_> = points
            .iter()
            .map(|p| p.target_m - transform.apply(&p.source_m))
            .collect();
        let redundancy = 3 * points.len() - if with_scale { 7 } else { 6 };
        let weighted: f64 = points
            .iter()
            .zip(&residuals_m)
            .map(|(p, r)| r.norm_squared() / (transform.scale * p.sigma_m).powi(2))
            .sum();
        Self {
            transform,
            covariance: DMatrix::from_column_slice(7, 7, cofactor.as_slice()),
            residuals_m,
            redundancy,
            variance_factor: (redundancy > 0).then(|| weighted / redundancy as f64),
        }
    }

    /// Tests the variance factor against 1, one-sided chi-square: `Some(true)` if it is accepted at the significance
    /// `alpha`; `None` without redundancy.
    pub fn passes_test(&self, alpha: f64) -> Option<bool> {
        let freedom = self.redundancy as f64;
        let limit = ChiSquared::new(freedom).ok()?.inverse_cdf(1.0 - alpha);
        Some(self.variance_factor? * freedom <= limit)
    }

    /// Returns a point and its covariance in the target frame, including the transform's own uncertainty.
    pub fn apply_with_covariance(
        &self,
        source_m: &Vector3<f64>,
        covariance_m2: &Matrix3<f64>,
    ) -> (Vector3<f64>, Matrix3<f64>) {
        let turned = self.transform.rotation * source_m;
        let linear = self.transform.rotation.matrix() * self.transform.scale;
        let jacobian = parameter_jacobian(&turned, self.transform.scale, true);
        let own = jacobian * &self.covariance * jacobian.transpose();
        (
            self.transform.apply(source_m),
            linear * covariance_m2 * linear.transpose() + own,
        )
    }
}

fn fit_closed_form(points: &[PointPair], with_scale: bool) -> Result<Similarity, FitError> {
    let weight = |p: &PointPair| p.sigma_m.powi(-2);
    let total: f64 = points.iter().map(weight).sum();
    let source: Vector3<f64> = points
        .iter()
        .map(|p| p.source_m * weight(p))
        .sum::<Vector3<f64>>()
        / total;
    let target: Vector3<f64> = points
        .iter()
        .map(|p| p.target_m * weight(p))
        .sum::<Vector3<f64>>()
        / total;
    check_not_collinear(points.iter().map(|p| p.source_m - source))?;
    check_not_collinear(points.iter().map(|p| p.target_m - target))?;
    let (mut cross, mut inertia) = (Matrix3::zeros(), 0.0);
    for p in points {
        let (s, t) = (p.source_m - source, p.target_m - target);
        cross += t * s.transpose() * weight(p);
        inertia += s.norm_squared() * weight(p);
    }
    let svd = cross.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(FitError::Degenerate);
    };
    let sign = (u * v_t).determinant().signum();
    let values = svd.singular_values;
    if sign < 0.0 && values[2] > MIRROR_RATIO * values[1] {
        return Err(FitError::Mirrored);
    }
    let guard = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign));
    let rotation = Rotation3::from_matrix_unchecked(u * guard * v_t);
    let scale = if with_scale {
        (values[0] + values[1] + sign * values[2]) / inertia
    } else {
        1.0
    };
    Ok(Similarity {
        scale,
        rotation,
        translation_m: target - rotation * source * scale,
    })
}

/// Ratio of the third to the second extent above which a reflection is not caused by noise: points in a plane give either
/// sign of the determinant.
const MIRROR_RATIO: f64 = 0.01;

fn check_not_collinear(centred: impl Iterator<Item = Vector3<f64>>) -> Result<(), FitError> {
    let columns: Vec<_> = centred.collect();
    let values = Matrix3xX::from_columns(&columns).singular_values();
    let line = values[1] <= LINE_RATIO * values[0] || values[0] == 0.0;
    if line {
        Err(FitError::Degenerate)
    } else {
        Ok(())
    }
}

/// Returns d(target)/d(small rotation, translation, scale) at a rotated source point.
fn parameter_jacobian(turned: &Vector3<f64>, scale: f64, with_scale: bool) -> SMatrix<f64, 3, 7> {
    let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
    jacobian
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&(-cross_matrix(turned) * scale));
    jacobian.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
    if with_scale {
        jacobian.fixed_view_mut::<3, 1>(0, 6).copy_from(turned);
    }
    jacobian
}

/// Returns one step and the cofactor matrix, both in (rotation, translation, scale).
fn gauss_newton_step(
    points: &[PointPair],
    t: &Similarity,
    with_scale: bool,
) -> Result<(Vector7, Matrix7), FitError> {
    let (mut normal, mut right) = (Matrix7::zeros(), Vector7::zeros());
    for p in points {
        let jacobian = parameter_jacobian(&(t.rotation * p.source_m), t.scale, with_scale);
        let weight = (t.scale * p.sigma_m).powi(-2);
        normal += jacobian.transpose() * jacobian * weight;
        right += jacobian.transpose() * (p.target_m - t.apply(&p.source_m)) * weight;
    }
    if !with_scale {
        normal[(6, 6)] = 1.0;
    }
    let mut cofactor = normal.cholesky().ok_or(FitError::Degenerate)?.inverse();
    if !with_scale {
        cofactor[(6, 6)] = 0.0;
    }
    Ok((cofactor * right, cofactor))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    fn cloud(seed: u64, n: usize) -> Vec<Vector3<f64>> {
        let mut rng = StdRng::seed_from_u64(seed);
        (0..n)
            .map(|_| {
                Vector3::new(
                    rng.random_range(-15.0..15.0),
                    rng.random_range(-3.0..30.0),
                    rng.random_range(-2.0..4.0),
                )
            })
            .collect()
    }

    fn pairs(points: &[Vector3<f64>], truth: &Similarity) -> Vec<PointPair> {
        let pair = |p: &Vector3<f64>| PointPair {
            source_m: *p,
            target_m: truth.apply(p),
            sigma_m: 0.002,
        };
        points.iter().map(pair).collect()
    }

    fn gauss(rng: &mut StdRng) -> Vector3<f64> {
        let sum = |rng: &mut StdRng| (0..12).map(|_| rng.random_range(-0.5..0.5f64)).sum::<f64>();
        Vector3::new(sum(rng), sum(rng), sum(rng))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn exact_points_return_the_transform(
            seed in 0u64..1000, n in 3usize..9, ax in -3.0..3.0f64, ay in -3.0..3.0f64, az in -3.0..3.0f64,
            scale in 0.5..2.0f64,
        ) {
            let truth = Similarity {
                scale,
                rotation: Rotation3::new(Vector3::new(ax, ay, az)),
                translation_m: Vector3::new(30.0 * ax, -70.0, ay),
            };
            let points = cloud(seed, n);
            let fit = TransformFit::estimate(&pairs(&points, &truth), true).unwrap();
            prop_assert!((fit.transform.scale - scale).abs() < 1e-11);
            for p in &points {
                prop_assert!((fit.transform.apply(p) - truth.apply(p)).norm() < 1e-10);
            }
            prop_assert_eq!(fit.redundancy, 3 * n - 7);
        }
    }

    #[test]
    fn a_wrong_scale_is_not_hidden_by_a_rigid_fit() {
        let truth = Similarity {
            scale: 1.001,
            rotation: Rotation3::new(Vector3::new(0.2, -0.4, 2.0)),
            translation_m: Vector3::new(5.0, 6.0, 7.0),
        };
        let points = pairs(&cloud(3, 6), &truth);
        let rigid = TransformFit::estimate(&points, false).unwrap();
        assert_eq!(rigid.transform.scale, 1.0);
        assert_eq!(rigid.passes_test(0.01), Some(false));
        assert_eq!(
            TransformFit::estimate(&points, true)
                .unwrap()
                .passes_test(0.01),
            Some(true)
        );
    }

    #[test]
    fn mirrored_collinear_and_few_points_are_refused() {
        let mirror = |p: &Vector3<f64>| Vector3::new(p.x, -p.y, p.z);
        let pair = |source_m: Vector3<f64>, target_m| PointPair {
            source_m,
            target_m,
            sigma_m: 0.002,
        };
        let mirrored: Vec<_> = cloud(1, 8).iter().map(|p| pair(*p, mirror(p))).collect();
        assert_eq!(
            TransformFit::estimate(&mirrored, false).unwrap_err(),
            FitError::Mirrored
        );
        let line: Vec<_> = (0..5)
            .map(|k| Vector3::new(1.0, 2.0, 3.0) * f64::from(k))
            .map(|p| pair(p, p))
            .collect();
        assert_eq!(
            TransformFit::estimate(&line, false).unwrap_err(),
            FitError::Degenerate
        );
        assert_eq!(
            TransformFit::estimate(&mirrored[..2], false).unwrap_err(),
            FitError::Degenerate
        );
        let same = vec![mirrored[0]; 4];
        assert_eq!(
            TransformFit::estimate(&same, false).unwrap_err(),
            FitError::Degenerate
        );
        let nan = [pair(Vector3::new(f64::NAN, 0.0, 0.0), Vector3::zeros()); 3];
        assert_eq!(
            TransformFit::estimate(&nan, false).unwrap_err(),
            FitError::Input
        );
    }

    #[test]
    fn points_in_a_plane_need_the_determinant_guard() {
        let rotation = Rotation3::new(Vector3::new(1.0, 2.0, 0.3));
        let mut rng = StdRng::seed_from_u64(5);
        for _ in 0..50 {
            let points: Vec<_> = (0..6)
                .map(|_| {
                    let p = Vector3::new(
                        rng.random_range(-9.0..9.0),
                        rng.random_range(-9.0..9.0),
                        0.0,
                    );
                    let target_m = rotation * p + gauss(&mut rng) * 0.002;
                    PointPair {
                        source_m: p,
                        target_m,
                        sigma_m: 0.002,
                    }
                })
                .collect();
            let fit = TransformFit::estimate(&points, false).unwrap();
            assert!((fit.transform.rotation.matrix().determinant() - 1.0).abs() < 1e-9);
            // The library's angle_to returns NaN for equal rotations.
            assert!((fit.transform.rotation.matrix() - rotation.matrix()).amax() < 5e-3);
        }
    }

    #[test]
    fn predicted_and_sampled_covariance_agree() {
        let truth = Similarity {
            scale: 1.0,
            rotation: Rotation3::new(Vector3::new(0.1, 0.2, -1.0)),
            translation_m: Vector3::new(20.0, -3.0, 1.0),
        };
        let clean = pairs(&cloud(11, 6), &truth);
        let tip = Vector3::new(-30.0, 20.0, 5.0);
        let mut rng = StdRng::seed_from_u64(12);
        let (mut sampled, mut factors, mut passed) = (Matrix3::zeros(), 0.0, 0);
        let runs = 1000;
        let mut predicted = Matrix3::zeros();
        for _ in 0..runs {
            let noisy: Vec<_> = clean
                .iter()
                .map(|p| PointPair {
                    source_m: p.source_m + gauss(&mut rng) * p.sigma_m,
                    ..*p
                })
                .collect();
            let fit = TransformFit::estimate(&noisy, false).unwrap();
            let (position, covariance) = fit.apply_with_covariance(&tip, &Matrix3::zeros());
            let error = position - truth.apply(&tip);
            sampled += error * error.transpose() / f64::from(runs);
            predicted = covariance;
            factors += fit.variance_factor.unwrap() / f64::from(runs);
            passed += i32::from(fit.passes_test(0.05) == Some(true));
        }
        for axis in 0..3 {
            let ratio = (sampled[(axis, axis)] / predicted[(axis, axis)]).sqrt();
            assert!((0.93..1.07).contains(&ratio), "{ratio}");
        }
        assert!((factors - 1.0).abs() < 0.04, "{factors}");
        assert!((930..=970).contains(&passed), "{passed}");
    }
}
