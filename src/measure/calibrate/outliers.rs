//! Pictures and points that do not fit the others, each with its reason.

use nalgebra::Vector2;

use super::{Adjusted, LEAST_POINTS, View, rms, start};

/// A point whose residual is this many times the scale is a gross error (a wrong corner).
const GROSS: f64 = 6.0;
/// A picture whose rms is this many times the median picture's was taken with another zoom or focus,
/// or of another board, or is blurred. Chosen, not derived: it does not tell these apart.
const OTHER_CAMERA: f64 = 3.0;
/// A view whose misfit to a plane is this many times the median's shows another thing.
const FOREIGN: f64 = 5.0;
/// Corners are not better than this, px: below it no residual is gross.
const LEAST_SCALE_PX: f64 = 0.02;

/// Why a picture took no part.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Dropped {
    /// Not enough of the board.
    #[error("only {found} points of the board found, {LEAST_POINTS} are needed")]
    TooFewPoints {
        /// Points found.
        found: usize,
    },
    /// The same picture twice tells nothing and passes for twice as sure.
    #[error("its points are those of picture {of} (counted from 1): given twice")]
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
    /// The whole picture disagrees.
    #[error(
        "its points are {rms_px:.2} px rms off, {times:.1} times the others'; another zoom or focus, or blurred?"
    )]
    OtherCamera {
        /// Root mean square of its residuals, px.
        rms_px: f64,
        /// Over the median of all pictures.
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
    pub used: Vec<(usize, View)>,
    /// Per view.
    pub dropped: Vec<Option<Dropped>>,
}

impl Selection {
    /// What can be told before any adjustment: with such views it may not converge.
    pub(super) fn first(views: &[View], width: u32, height: u32) -> Self {
        let mut dropped: Vec<Option<Dropped>> = (0..views.len()).map(|k| obvious(views, k)).collect();
        let misfits: Vec<f64> = views.iter().map(|v| start::misfit_px(v, width, height)).collect();
        let rest: Vec<f64> =
            misfits.iter().zip(&dropped).filter(|(_, d)| d.is_none()).map(|(m, _)| *m).collect();
        // Lens distortion is in every view's misfit alike.
        let limit = FOREIGN * median(rest) + 1.0;
        for (reason, misfit) in dropped.iter_mut().zip(&misfits) {
            if reason.is_none() && (misfit.is_nan() || *misfit > limit) {
                *reason = Some(Dropped::NoPlane { misfit_px: *misfit });
            }
        }
        let used = views.iter().cloned().enumerate().filter(|(k, _)| dropped[*k].is_none()).collect();
        Self { used, dropped }
    }

    /// Takes out the worst picture, or where all agree, the gross points; whether there were any.
    pub(super) fn narrow(&mut self, adjusted: &Adjusted, views: &[View]) -> bool {
        let residuals = adjusted.residuals(&self.used);
        self.drop_worst(&residuals) || self.drop_points(&residuals, views)
    }

    fn drop_worst(&mut self, residuals: &[Vec<Vector2<f64>>]) -> bool {
        let all: Vec<f64> = residuals.iter().map(|r| typical(r)).collect();
        let scale = median(all.clone()).max(LEAST_SCALE_PX);
        let Some((k, worst)) = all.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)) else { return false };
        if *worst <= OTHER_CAMERA * scale {
            return false;
        }
        let reason = Dropped::OtherCamera { rms_px: rms(residuals[k].iter()), times: worst / scale };
        let (index, _) = self.used.remove(k);
        self.dropped[index] = Some(reason);
        true
    }

    /// A picture counts as lost by its points as found, not by what earlier rounds left of them.
    fn drop_points(&mut self, residuals: &[Vec<Vector2<f64>>], views: &[View]) -> bool {
        let limit = GROSS * typical(&residuals.concat()).max(LEAST_SCALE_PX);
        let mut changed = false;
        for ((index, view), r) in std::mem::take(&mut self.used).into_iter().zip(residuals) {
            let before = view.len();
            let kept: View =
                view.into_iter().zip(r).filter(|(_, r)| r.norm() <= limit).map(|(p, _)| p).collect();
            changed |= kept.len() < before;
            let of = views[index].len();
            if 2 * kept.len() >= of && kept.len() >= LEAST_POINTS {
                self.used.push((index, kept));
            } else {
                self.dropped[index] = Some(Dropped::Points { lost: of - kept.len(), of });
            }
        }
        changed
    }
}

fn obvious(views: &[View], k: usize) -> Option<Dropped> {
    if views[k].len() < LEAST_POINTS {
        return Some(Dropped::TooFewPoints { found: views[k].len() });
    }
    views[..k].iter().position(|v| *v == views[k]).map(|first| Dropped::Twice { of: first + 1 })
}

/// Root mean square that the median tells: a gross error blows up the mean. The median of a Rayleigh
/// distribution is 1.177 standard deviations, its root mean square 1.414.
fn typical(residuals: &[Vector2<f64>]) -> f64 {
    median(residuals.iter().map(|r| r.norm()).collect()) * 1.414 / 1.177
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
