//! Removal of images and points that do not fit the others, each with its reason.
//!
//! Residuals are normalised: a blurred or a far board is no outlier, as the covariances of its corners already show it. Two
//! tests of an image, each at 1 % over the whole set, use the images' own spread (median absolute deviation), so that a
//! lens that Brown's model fits badly does not cause rejections: the focal length estimated from the image alone, and
//! the size of its residuals.

use nalgebra::{SMatrix, SVector, Vector2};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::adjust::CameraAdjustment;
use super::model::{ImageSize, ProjectionJacobians, projection_jacobians, rms_length};
use super::{BoardView, CalibrateError, MIN_POINTS, MIN_VIEWS, start};
use crate::estimation::robust::{
    MEDIAN_SQUARE_1D, RobustLocation, common_variance, median, scale_from_squares,
};

/// Multiple of the scale above which a residual is a gross error (a wrong corner).
const GROSS_FACTOR: f64 = 6.0;
/// Multiple of the median misfit to a plane above which a view shows something else than the board.
const NOT_PLANAR_FACTOR: f64 = 5.0;
/// Probability that a test rejects an image of a set without outliers.
const SIGNIFICANCE_LEVEL: f64 = 0.01;
/// Movement between two images below which neither board nor camera was moved, px.
const STATIC_PX: f64 = 0.05;
/// Relative standard deviation of a scale from the median of `n` squared lengths, times root n.
const MEDIAN_SCALE: f64 = 0.72;

/// Reason for the rejection of an image.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ImageRejection {
    /// Too little of the board found.
    #[error("only {found} points of the board found; at least {MIN_POINTS} are needed")]
    TooFewPoints { found: usize },
    /// Duplicate of an earlier image, which would count as independent information.
    #[error(
        "its points are those of image {earlier} (counted from 1): the same image twice, or neither board nor \
         camera was moved"
    )]
    Duplicate {
        /// Index of the earlier image, counted from 1.
        earlier: usize,
    },
    /// Points not on a plane board.
    #[error("its points do not lie on a plane board ({misfit_px:.1} px rms); is it another board?")]
    NotPlanar {
        /// Root mean square distance from the best plane image, px.
        misfit_px: f64,
    },
    /// Deviating focal length, estimated from this image alone.
    #[error(
        "its focal length differs by {percent:+.2} % from that of the others ({times:.1} standard \
         deviations): zoom or focus was changed"
    )]
    OtherZoom {
        /// Focal length over that of the other images, less 1, per cent.
        percent: f64,
        /// Deviation over its standard deviation.
        times: f64,
    },
    /// Larger residuals than the other images.
    #[error(
        "its residuals are {rms_px:.2} px rms, {times:.1} times those of the other images at the same \
         sharpness; check for another zoom or focus, a moving or a bent board"
    )]
    LargeResiduals {
        rms_px: f64,
        /// Normalised residuals over those of the median image.
        times: f64,
    },
    /// Too many outliers among its points.
    #[error("{lost} of its {found} points do not fit the others; was zoom or focus changed?")]
    TooManyOutliers {
        /// Outliers.
        lost: usize,
        /// Points found in the image.
        found: usize,
    },
}

/// Views used, and the reasons for the rejection of the others.
pub(super) struct Selection {
    /// Index and points of each view used.
    pub used: Vec<(usize, BoardView)>,
    /// Reason for the rejection of each view.
    pub rejections: Vec<Option<ImageRejection>>,
}

impl Selection {
    /// Rejects views that are unusable before any adjustment, which might not converge with them.
    pub(super) fn from_views(views: &[BoardView], size: ImageSize) -> Self {
        let mut dropped: Vec<Option<ImageRejection>> =
            (0..views.len()).map(|k| view_rejection(views, k)).collect();
        let misfits: Vec<f64> = views
            .iter()
            .map(|v| start::min_plane_misfit_px(v, size))
            .collect();
        let rest: Vec<f64> = misfits
            .iter()
            .zip(&dropped)
            .filter(|(_, d)| d.is_none())
            .map(|(m, _)| *m)
            .collect();
        let limit = NOT_PLANAR_FACTOR * median(rest.clone()).unwrap_or(0.0) + 1.0;
        let foreign = |misfit: f64| misfit.is_nan() || misfit > limit;
        // If too few images would be left, the adjustment decides.
        if rest.iter().filter(|m| !foreign(**m)).count() >= MIN_VIEWS {
            for (reason, misfit) in dropped.iter_mut().zip(&misfits) {
                if reason.is_none() && foreign(*misfit) {
                    *reason = Some(ImageRejection::NotPlanar { misfit_px: *misfit });
                }
            }
        }
        let used = views
            .iter()
            .cloned()
            .enumerate()
            .filter(|(k, _)| dropped[*k].is_none())
            .collect();
        Self {
            used,
            rejections: dropped,
        }
    }

    /// Checks that enough views are left.
    ///
    /// # Errors
    /// Returns an error with the rejections if there are too few.
    pub(super) fn check_view_count(&self) -> Result<(), CalibrateError> {
        let (found, needed) = (self.used.len(), MIN_VIEWS);
        if found < needed {
            return Err(CalibrateError::TooFewViews {
                found,
                needed,
                rejections: self.rejections.clone(),
            });
        }
        Ok(())
    }

    /// Removes the worst image or, if the images agree, the outliers among the points; returns true if anything was
    /// removed.
    pub(super) fn remove_worst(
        &mut self,
        adjusted: &CameraAdjustment,
        views: &[BoardView],
    ) -> bool {
        let residuals = adjusted.residuals(&self.used);
        let squares = adjusted.normalized_squares(&self.used, &residuals);
        let zoomed = self.zoom_outlier(adjusted, &residuals);
        let worst = zoomed.or_else(|| self.residual_outlier(&residuals, &squares));
        match worst.filter(|_| self.used.len() > MIN_VIEWS) {
            Some((k, reason)) => {
                let (index, _) = self.used.remove(k);
                self.rejections[index] = Some(reason);
                true
            }
            None => self.remove_points(&squares, views),
        }
    }

    /// Finds the image whose own focal length deviates most.
    fn zoom_outlier(
        &self,
        adjusted: &CameraAdjustment,
        residuals: &[Vec<Vector2<f64>>],
    ) -> Option<(usize, ImageRejection)> {
        let constant_change = |(k, r): (usize, &Vec<Vector2<f64>>)| {
            own_camera_constant(adjusted, k, &self.used[k].1, r)
        };
        let own: Vec<(f64, f64)> = residuals
            .iter()
            .enumerate()
            .map(constant_change)
            .collect::<Option<_>>()?;
        // Deviations of lens and board from their models make good images differ by more than their standard
        // deviations: by a factor and, if those are small, by a common variance.
        let squares: Vec<f64> = own.iter().map(|(change, _)| change * change).collect();
        let normalised: Vec<f64> = own.iter().map(|(change, sigma)| change / sigma).collect();
        let factor = RobustLocation::from_values(&normalised).sigma.max(1.0);
        let own_variances: Vec<f64> = own.iter().map(|(_, sigma)| sigma * sigma).collect();
        let variances: Vec<f64> = own_variances.iter().map(|v| v * factor * factor).collect();
        let common = common_variance(&squares, &own_variances, MEDIAN_SQUARE_1D);
        let over = |k: usize| own[k].0.abs() / (variances[k] + common).sqrt();
        let k = (0..own.len()).max_by(|a, b| over(*a).total_cmp(&over(*b)))?;
        let reason = ImageRejection::OtherZoom {
            percent: 100.0 * own[k].0,
            times: over(k),
        };
        (over(k) > student_limit(own.len(), 2.0)).then_some((k, reason))
    }

    /// Finds the image with the largest normalised residuals.
    fn residual_outlier(
        &self,
        residuals: &[Vec<Vector2<f64>>],
        squares: &[Vec<f64>],
    ) -> Option<(usize, ImageRejection)> {
        let logs: Vec<f64> = squares
            .iter()
            .map(|s| scale_from_squares(s).max(f64::MIN_POSITIVE).ln())
            .collect();
        let all = RobustLocation::from_values(&logs);
        let over = |k: usize| {
            (logs[k] - all.median)
                / all
                    .sigma
                    .hypot(MEDIAN_SCALE / (squares[k].len() as f64).sqrt())
        };
        let k = (0..logs.len()).max_by(|a, b| over(*a).total_cmp(&over(*b)))?;
        let reason = ImageRejection::LargeResiduals {
            rms_px: rms_length(residuals[k].iter()),
            times: (logs[k] - all.median).exp(),
        };
        (over(k) > student_limit(logs.len(), 1.0)).then_some((k, reason))
    }

    /// Removes outliers among the points. An image is rejected by the fraction of its original points that is lost.
    fn remove_points(&mut self, squares: &[Vec<f64>], views: &[BoardView]) -> bool {
        let all = scale_from_squares(&squares.concat()).max(1.0);
        let mut changed = false;
        for ((index, view), s) in std::mem::take(&mut self.used).into_iter().zip(squares) {
            let before = view.len();
            // A common increase of an image's residuals is tested elsewhere.
            let limit = GROSS_FACTOR * scale_from_squares(s).max(all);
            let fits = view.into_iter().zip(s).filter(|(_, s)| s.sqrt() <= limit);
            let kept: BoardView = fits.map(|(p, _)| p).collect();
            changed |= kept.len() < before;
            let found = views[index].len();
            if 2 * kept.len() >= found && kept.len() >= MIN_POINTS {
                self.used.push((index, kept));
            } else {
                self.rejections[index] = Some(ImageRejection::TooManyOutliers {
                    lost: found - kept.len(),
                    found,
                });
            }
        }
        changed
    }
}

/// Returns the relative change of the focal length that an image's residuals ask for, and its standard deviation, scaled
/// by the remaining residuals if they are larger than expected.
fn own_camera_constant(
    adjusted: &CameraAdjustment,
    k: usize,
    view: &BoardView,
    residuals: &[Vector2<f64>],
) -> Option<(f64, f64)> {
    let (mut normal, mut right, mut sum) = (
        SMatrix::<f64, 7, 7>::zeros(),
        SVector::<f64, 7>::zeros(),
        0.0,
    );
    for (p, r) in view.iter().zip(residuals) {
        let point = adjusted.camera_point(k, p);
        let ProjectionJacobians { by_motion, by_lens } =
            projection_jacobians(&adjusted.camera.lens, &point)?;
        let mut derivatives = SMatrix::<f64, 2, 7>::zeros();
        derivatives.fixed_columns_mut::<6>(0).copy_from(&by_motion);
        let relative = by_lens.column(0) * adjusted.camera.lens.fx
            + by_lens.column(1) * adjusted.camera.lens.fy;
        derivatives.set_column(6, &relative);
        let weight = adjusted.covariance_px2(p).try_inverse()?;
        normal += derivatives.transpose() * weight * derivatives;
        right += derivatives.transpose() * weight * r;
        sum += r.dot(&(weight * r));
    }
    let inverse = normal.cholesky()?.inverse();
    let found = inverse * right;
    let unit = ((sum - right.dot(&found)) / (2.0 * view.len() as f64 - 7.0)).max(1.0);
    Some((found[6], (unit * inverse[(6, 6)]).sqrt()))
}

/// Returns the limit of Student's t that one of `n` random values exceeds at the level; `sides` 1 or 2.
fn student_limit(n: usize, sides: f64) -> f64 {
    let share = 1.0 - SIGNIFICANCE_LEVEL / (sides * n.max(2) as f64);
    StudentsT::new(0.0, 1.0, (n.max(2) - 1) as f64).map_or(f64::INFINITY, |t| t.inverse_cdf(share))
}

/// Returns why view `k` cannot be used: too few corners, or the same view as an earlier image.
fn view_rejection(views: &[BoardView], k: usize) -> Option<ImageRejection> {
    if views[k].len() < MIN_POINTS {
        return Some(ImageRejection::TooFewPoints {
            found: views[k].len(),
        });
    }
    views[..k]
        .iter()
        .position(|v| is_same_view(v, &views[k]))
        .map(|first| ImageRejection::Duplicate { earlier: first + 1 })
}

/// Returns true if two views differ by no more than their points' noise.
fn is_same_view(a: &BoardView, b: &BoardView) -> bool {
    let pairs = a
        .iter()
        .filter_map(|p| b.iter().find(|q| q.board_m == p.board_m).map(|q| (p, q)));
    let (mut squares, mut variances, mut n) = (0.0, 0.0, 0);
    for (p, q) in pairs {
        squares += (p.pixel - q.pixel).norm_squared();
        variances += (p.covariance_px2 + q.covariance_px2).trace();
        n += 1;
    }
    // Three standard deviations: an image compressed twice differs by about one.
    2 * n > a.len().min(b.len())
        && squares < (9.0 * variances).max((n as f64) * STATIC_PX * STATIC_PX)
}
