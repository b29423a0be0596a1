//! Pictures and points that do not fit the others, each with its reason.
//!
//! Residuals count in their own standard deviations: a blurred or a far board is no outlier, its corners'
//! covariances say so already. Two tests of a picture, each at 1 % over the whole set, against the
//! pictures' own spread (median absolute deviation), so that a lens that Brown's model fits badly does not
//! condemn its pictures: the camera constant that the picture alone would choose, and the size of its residuals.

use nalgebra::{SMatrix, SVector, Vector2};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::adjust::CameraAdjustment;
use super::model::{ProjectionJacobians, ImageSize, projection_jacobians, rms_length};
use super::{CalibrateError, MIN_POINTS, MIN_VIEWS, BoardView, start};
use crate::estimation::robust::{Location, MEDIAN_SQUARE_1D, common_variance, median, scale_from_squares};

/// A point whose residual is this many times the scale is a gross error (a wrong corner).
const GROSS: f64 = 6.0;
/// A view whose misfit to a plane is this many times the median's shows another thing.
const FOREIGN: f64 = 5.0;
/// Chance that a test leaves out a picture of a set in which all are sound.
const LEVEL: f64 = 0.01;
/// No hand holds a board so still between two pictures, px.
const STILL_PX: f64 = 0.05;
/// Relative standard deviation of a scale from the median of `n` squared lengths, times root n.
const MEDIAN_SCALE: f64 = 0.72;

/// Why a picture took no part.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ImageRejection {
    /// Not enough of the board.
    #[error("only {found} points of the board found, {MIN_POINTS} are needed")]
    TooFewPoints {
        /// Points found.
        found: usize,
    },
    /// The same picture twice tells nothing and passes for twice as sure.
    #[error(
        "its points are those of picture {of} (counted from 1): given twice, or neither board nor camera moved"
    )]
    Twice {
        /// Index of the earlier one, counted from 1.
        of: usize,
    },
    /// No plane board.
    #[error("its points do not lie on a plane board ({misfit_px:.1} px off); another board?")]
    NoPlane {
        /// Root mean square distance from the best plane image, px.
        misfit_px: f64,
    },
    /// It alone would choose another camera constant.
    #[error(
        "it asks for a camera constant {percent:+.2} % from the others' ({times:.1} standard deviations): zoom or focus \
         was moved"
    )]
    OtherZoom {
        /// Camera constant over the others', less 1, per cent.
        percent: f64,
        /// Over its standard deviation.
        times: f64,
    },
    /// The whole picture disagrees.
    #[error(
        "its points are {rms_px:.2} px rms off, {times:.1} times as far as the others' for their sharpness; another \
         zoom or focus, a moving board, or a bent one?"
    )]
    OtherCamera {
        /// Root mean square of its residuals, px.
        rms_px: f64,
        /// Normalised residuals over the median picture's.
        times: f64,
    },
    /// Too many of its points disagree.
    #[error("{lost} of its {of} points do not fit the others; another zoom or focus?")]
    Points {
        /// Points that do not fit.
        lost: usize,
        /// Points found in the picture.
        of: usize,
    },
}

/// Views that take part, and why others do not.
pub(super) struct Selection {
    /// Index and points.
    pub used: Vec<(usize, BoardView)>,
    /// Per view.
    pub dropped: Vec<Option<ImageRejection>>,
}

impl Selection {
    /// What can be told before any adjustment: with such views it may not converge.
    pub(super) fn from_views(views: &[BoardView], size: ImageSize) -> Self {
        let mut dropped: Vec<Option<ImageRejection>> = (0..views.len()).map(|k| unusable_reason(views, k)).collect();
        let misfits: Vec<f64> = views.iter().map(|v| start::min_plane_misfit_px(v, size)).collect();
        let rest: Vec<f64> =
            misfits.iter().zip(&dropped).filter(|(_, d)| d.is_none()).map(|(m, _)| *m).collect();
        let limit = FOREIGN * median(rest.clone()).unwrap_or(0.0) + 1.0;
        let foreign = |misfit: f64| misfit.is_nan() || misfit > limit;
        // Where too few would be left, the adjustment must say.
        if rest.iter().filter(|m| !foreign(**m)).count() >= MIN_VIEWS {
            for (reason, misfit) in dropped.iter_mut().zip(&misfits) {
                if reason.is_none() && foreign(*misfit) {
                    *reason = Some(ImageRejection::NoPlane { misfit_px: *misfit });
                }
            }
        }
        let used = views.iter().cloned().enumerate().filter(|(k, _)| dropped[*k].is_none()).collect();
        Self { used, dropped }
    }

    /// An error with the reasons where too few are left.
    pub(super) fn check_count(&self) -> Result<(), CalibrateError> {
        let (found, needed) = (self.used.len(), MIN_VIEWS);
        if found < needed {
            return Err(CalibrateError::TooFewViews { found, needed, dropped: self.dropped.clone() });
        }
        Ok(())
    }

    /// Takes out the worst picture, or where all agree, the gross points; whether there were any.
    pub(super) fn remove_worst(&mut self, adjusted: &CameraAdjustment, views: &[BoardView]) -> bool {
        let residuals = adjusted.residuals(&self.used);
        let squares = adjusted.normalized_squares(&self.used, &residuals);
        let zoomed = self.zoom_outlier(adjusted, &residuals);
        let worst = zoomed.or_else(|| {
            self.residual_outlier(&residuals, &squares).map(|(k, reason)| self.prefer_zoom_reason(adjusted, &residuals, k, reason))
        });
        match worst.filter(|_| self.used.len() > MIN_VIEWS) {
            Some((k, reason)) => {
                let (index, _) = self.used.remove(k);
                self.dropped[index] = Some(reason);
                true
            }
            None => self.remove_points(&squares, views),
        }
    }

    /// The picture whose own camera constant stands out most.
    fn zoom_outlier(&self, adjusted: &CameraAdjustment, residuals: &[Vec<Vector2<f64>>]) -> Option<(usize, ImageRejection)> {
        let of = |(k, r): (usize, &Vec<Vector2<f64>>)| own_camera_constant(adjusted, k, &self.used[k].1, r);
        let own: Vec<(f64, f64)> = residuals.iter().enumerate().map(of).collect::<Option<_>>()?;
        // What lens and board leave over makes sound pictures differ by more than their standard deviations: by a factor,
        // and where those are small, by a variance that all have in common.
        let squares: Vec<f64> = own.iter().map(|(change, _)| change * change).collect();
        let normalised: Vec<f64> = own.iter().map(|(change, sigma)| change / sigma).collect();
        let factor = Location::from_values(&normalised).sigma.max(1.0);
        let own_variances: Vec<f64> = own.iter().map(|(_, sigma)| sigma * sigma).collect();
        let variances: Vec<f64> = own_variances.iter().map(|v| v * factor * factor).collect();
        let common = common_variance(&squares, &own_variances, MEDIAN_SQUARE_1D);
        let over = |k: usize| own[k].0.abs() / (variances[k] + common).sqrt();
        let k = (0..own.len()).max_by(|a, b| over(*a).total_cmp(&over(*b)))?;
        let reason = ImageRejection::OtherZoom { percent: 100.0 * own[k].0, times: over(k) };
        (over(k) > student_limit(own.len(), 2.0)).then_some((k, reason))
    }

    /// Another camera constant, where that explains a picture that is far off.
    fn prefer_zoom_reason(
        &self,
        adjusted: &CameraAdjustment,
        residuals: &[Vec<Vector2<f64>>],
        k: usize,
        reason: ImageRejection,
    ) -> (usize, ImageRejection) {
        match own_camera_constant(adjusted, k, &self.used[k].1, &residuals[k]) {
            Some((change, sigma)) if change.abs() > sigma * student_limit(residuals.len(), 2.0) => {
                (k, ImageRejection::OtherZoom { percent: 100.0 * change, times: change.abs() / sigma })
            }
            _ => (k, reason),
        }
    }

    /// The picture whose normalised residuals stand out most.
    fn residual_outlier(&self, residuals: &[Vec<Vector2<f64>>], squares: &[Vec<f64>]) -> Option<(usize, ImageRejection)> {
        let logs: Vec<f64> = squares.iter().map(|s| scale_from_squares(s).max(f64::MIN_POSITIVE).ln()).collect();
        let all = Location::from_values(&logs);
        let over = |k: usize| {
            (logs[k] - all.median) / all.sigma.hypot(MEDIAN_SCALE / (squares[k].len() as f64).sqrt())
        };
        let k = (0..logs.len()).max_by(|a, b| over(*a).total_cmp(&over(*b)))?;
        let reason =
            ImageRejection::OtherCamera { rms_px: rms_length(residuals[k].iter()), times: (logs[k] - all.median).exp() };
        (over(k) > student_limit(logs.len(), 1.0)).then_some((k, reason))
    }

    /// A picture counts as lost by its points as found, not by what earlier rounds left of them.
    fn remove_points(&mut self, squares: &[Vec<f64>], views: &[BoardView]) -> bool {
        let all = scale_from_squares(&squares.concat()).max(1.0);
        let mut changed = false;
        for ((index, view), s) in std::mem::take(&mut self.used).into_iter().zip(squares) {
            let before = view.len();
            // Whether all of a picture is off is not asked here.
            let limit = GROSS * scale_from_squares(s).max(all);
            let fits = view.into_iter().zip(s).filter(|(_, s)| s.sqrt() <= limit);
            let kept: BoardView = fits.map(|(p, _)| p).collect();
            changed |= kept.len() < before;
            let of = views[index].len();
            if 2 * kept.len() >= of && kept.len() >= MIN_POINTS {
                self.used.push((index, kept));
            } else {
                self.dropped[index] = Some(ImageRejection::Points { lost: of - kept.len(), of });
            }
        }
        changed
    }
}

/// Relative change of the camera constant that a picture's residuals ask for, and its standard deviation, which
/// the residuals that are left tell where they are larger than they should be.
fn own_camera_constant(
    adjusted: &CameraAdjustment,
    k: usize,
    view: &BoardView,
    residuals: &[Vector2<f64>],
) -> Option<(f64, f64)> {
    let (mut normal, mut right, mut sum) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros(), 0.0);
    for (p, r) in view.iter().zip(residuals) {
        let point = adjusted.camera_point(k, p);
        let ProjectionJacobians { by_motion, by_lens } = projection_jacobians(&adjusted.lens, &point)?;
        let mut by = SMatrix::<f64, 2, 7>::zeros();
        by.fixed_columns_mut::<6>(0).copy_from(&by_motion);
        let relative = by_lens.column(0) * adjusted.lens.fx + by_lens.column(1) * adjusted.lens.fy;
        by.set_column(6, &relative);
        let weight = adjusted.covariance_px2(p).try_inverse()?;
        normal += by.transpose() * weight * by;
        right += by.transpose() * weight * r;
        sum += r.dot(&(weight * r));
    }
    let inverse = normal.cholesky()?.inverse();
    let found = inverse * right;
    let unit = ((sum - right.dot(&found)) / (2.0 * view.len() as f64 - 7.0)).max(1.0);
    Some((found[6], (unit * inverse[(6, 6)]).sqrt()))
}

/// Student's t that one of `n` values passes by chance at the level; tests on one side or two.
fn student_limit(n: usize, sides: f64) -> f64 {
    let share = 1.0 - LEVEL / (sides * n.max(2) as f64);
    StudentsT::new(0.0, 1.0, (n.max(2) - 1) as f64).map_or(f64::INFINITY, |t| t.inverse_cdf(share))
}

fn unusable_reason(views: &[BoardView], k: usize) -> Option<ImageRejection> {
    if views[k].len() < MIN_POINTS {
        return Some(ImageRejection::TooFewPoints { found: views[k].len() });
    }
    views[..k].iter().position(|v| is_same_view(v, &views[k])).map(|first| ImageRejection::Twice { of: first + 1 })
}

/// Whether two views differ by no more than their points' noise.
fn is_same_view(a: &BoardView, b: &BoardView) -> bool {
    let pairs = a.iter().filter_map(|p| b.iter().find(|q| q.board_m == p.board_m).map(|q| (p, q)));
    let (mut squares, mut variances, mut n) = (0.0, 0.0, 0);
    for (p, q) in pairs {
        squares += (p.pixel - q.pixel).norm_squared();
        variances += (p.covariance_px2 + q.covariance_px2).trace();
        n += 1;
    }
    // Three standard deviations: two pictures of one moment, compressed twice, differ by about one.
    2 * n > a.len().min(b.len()) && squares < (9.0 * variances).max((n as f64) * STILL_PX * STILL_PX)
}
