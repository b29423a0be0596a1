//! Place of a point in a frame, or the reason why there is none.

use nalgebra::{Matrix2, Vector2};

use super::PointRejection;
use super::correlation::{LikePlace, find_like_places};
use super::least_squares::{AdjustedShift, CHECK_PASSES, MATCH_PASSES, adjust_shift};
use super::patch::{GreyPatch, centre_offset, frame_patch, template_patch};
use crate::identify::{PATCH_REACH_PX, PatchPrediction};
use crate::raster::Raster;
use crate::setup::PointTemplate;

/// Largest search radius, px of the ground frame: beyond it, places of other structures are as likely.
const MAX_SEARCH_PX: f64 = 48.0;
/// Largest share of saturated pixels.
const MAX_SATURATED: f64 = 0.3;
/// Number of pixels that count as one independent grey value: shadows and reflections differ from the template over larger
/// areas than the adjustment's blocks.
const PIXELS_PER_VALUE: f64 = 60.0;
/// Smallest log odds between the place and another one: 1000 to 1.
const MIN_LOG_ODDS: f64 = 7.0;
/// Log odds of the correlation within which a place is adjusted: it does not know the light's ramps, slopes and blur.
const WIDE_LOG_ODDS: f64 = 10.0;
/// Largest number of places that are adjusted.
const MAX_ADJUSTED: usize = 3;
/// Number of independent residuals of an adjustment, by the blocks over which they are correlated.
const ADJUSTED_VALUES: f64 = 38.0;
/// Distance of another place, in standard deviations of the match, within which it is the same one along an edge.
const SAME_SIGMAS: f64 = 4.0;
/// Smallest share of the contrast that the template must explain.
const MIN_EXPLAINED: f64 = 0.7;
/// Start of the check backward, px: far enough to show that it converges, within the reach of the adjustment.
const BACKWARD_START_PX: f64 = 0.6;
/// Largest difference of the shifts forward and backward: in standard deviations, and px.
const MAX_LOOP: (f64, f64) = (3.0, 0.1);
/// Standard deviation of a place of the correlation, px of the ground frame.
const CORRELATION_SIGMA_PX: f64 = 0.4;

/// Place of a point in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PointMatch {
    /// Image of the point, px.
    pub place_px: Vector2<f64>,
    /// Covariance of the image relative to the template, px^2.
    pub covariance_px2: Matrix2<f64>,
    /// Share of the frame's contrast that the template explains.
    pub explained: f64,
}

/// Template and patch of the frame on one grid.
struct PatchPair<'a> {
    prediction: &'a PatchPrediction,
    template: GreyPatch,
    patch: GreyPatch,
    offset: Vector2<f64>,
    /// Derivative of the grid of the ground frame with respect to the frame.
    inverse: Matrix2<f64>,
    search: [usize; 2],
}

impl<'a> PatchPair<'a> {
    fn new(
        frame: &Raster,
        template: &PointTemplate,
        prediction: &'a PatchPrediction,
    ) -> Result<Self, PointRejection> {
        let inverse = prediction
            .map_jacobian(&Vector2::zeros())
            .try_inverse()
            .ok_or(PointRejection::Grazing)?;
        let reach = inverse.map(f64::abs) * prediction.search_px;
        let search = [reach.x, reach.y].map(|r| r.min(MAX_SEARCH_PX).ceil() as usize);
        let offset = centre_offset(template);
        let (patch, saturated) =
            frame_patch(frame, prediction, offset, search).ok_or(PointRejection::OutsideFrame)?;
        if saturated > MAX_SATURATED {
            return Err(PointRejection::Saturated);
        }
        Ok(Self {
            prediction,
            template: template_patch(template, prediction),
            patch,
            offset,
            inverse,
            search,
        })
    }

    /// Returns the log odds of a shift by the prediction.
    fn prior_odds(&self, shift: &Vector2<f64>) -> f64 {
        let covariance = self.inverse * self.prediction.covariance_px2 * self.inverse.transpose();
        covariance
            .try_inverse()
            .map_or(0.0, |weight| -0.5 * shift.dot(&(weight * shift)))
    }

    /// Returns the places that look like the template with their log odds, most likely first.
    fn places(&self) -> Vec<(LikePlace, f64)> {
        let values = ((2 * PATCH_REACH_PX + 1) as f64).powi(2) / PIXELS_PER_VALUE;
        let odds = |place: LikePlace| {
            let alike = -0.5 * values * (1.0 - place.correlation.powi(2)).max(1e-6).ln();
            (place, alike + self.prior_odds(&place.shift))
        };
        let mut all: Vec<_> = find_like_places(&self.template, &self.patch, self.search)
            .into_iter()
            .map(odds)
            .collect();
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        all
    }
}

/// Returns places at which a point may be, with their covariances, px and px^2: whole pixels of the ground frame.
pub fn find_places(
    frame: &Raster,
    template: &PointTemplate,
    prediction: &PatchPrediction,
) -> Vec<(Vector2<f64>, Matrix2<f64>)> {
    let Ok(pair) = PatchPair::new(frame, template, prediction) else {
        return Vec::new();
    };
    let places = pair.places();
    let best = places.first().map_or(0.0, |(_, odds)| *odds);
    let likely = places
        .into_iter()
        .take_while(|(_, odds)| *odds > best - MIN_LOG_ODDS);
    let place = |(place, _): (LikePlace, f64)| {
        let jacobian = prediction.map_jacobian(&place.shift);
        let covariance = jacobian * jacobian.transpose() * CORRELATION_SIGMA_PX.powi(2);
        (prediction.frame_point(&place.shift), covariance)
    };
    likely.map(place).collect()
}

/// Place with its adjusted shift and the log odds of the adjusted patch.
struct AdjustedPlace {
    adjusted: AdjustedShift,
    odds: f64,
}

impl PatchPair<'_> {
    /// Adjusts the places that may be the point, most likely first; places that lead to one shift count once.
    fn adjust_places(
        &self,
        slopes: [Matrix2<f64>; 2],
    ) -> Result<Vec<AdjustedPlace>, PointRejection> {
        let places = self.places();
        let best = places.first().ok_or(PointRejection::Unlike)?.1;
        let mut all: Vec<AdjustedPlace> = Vec::new();
        let mut failure = PointRejection::NoConvergence;
        for (place, _) in places
            .iter()
            .take_while(|(_, odds)| *odds > best - WIDE_LOG_ODDS)
            .take(MAX_ADJUSTED)
        {
            let adjusted = match adjust_shift(
                &self.template,
                &self.patch,
                place.shift,
                self.offset,
                slopes,
                &MATCH_PASSES,
            ) {
                Ok(adjusted) => adjusted,
                Err(other) => {
                    failure = other;
                    continue;
                }
            };
            let shift = adjusted.shift();
            if all
                .iter()
                .all(|known| (known.adjusted.shift() - shift).norm() > 1.0)
            {
                let odds =
                    -0.5 * ADJUSTED_VALUES * adjusted.misfit().ln() + self.prior_odds(&shift);
                all.push(AdjustedPlace { adjusted, odds });
            }
        }
        all.sort_by(|a, b| b.odds.total_cmp(&a.odds));
        if all.is_empty() {
            Err(failure)
        } else {
            Ok(all)
        }
    }
}

/// Matches the patch of a point to a frame.
///
/// # Errors
/// Returns the reason why the point has no place in the frame.
pub fn match_point(
    frame: &Raster,
    template: &PointTemplate,
    prediction: &PatchPrediction,
) -> Result<PointMatch, PointRejection> {
    let pair = PatchPair::new(frame, template, prediction)?;
    let slopes = prediction.by_slope.map(|by| pair.inverse * by);
    let places = pair.adjust_places(slopes)?;
    let (AdjustedPlace { adjusted, odds }, others) =
        places.split_first().ok_or(PointRejection::Unlike)?;
    let shifted = adjusted.shifted_patch(&pair.patch);
    let mut found = adjusted.conclude(&shifted)?;
    let weight = found
        .covariance
        .try_inverse()
        .ok_or(PointRejection::NoStructure)?;
    for other in others
        .iter()
        .filter(|other| other.odds > odds - MIN_LOG_ODDS)
    {
        let apart = other.adjusted.shift() - found.shift;
        if apart.dot(&(weight * apart)) > SAME_SIGMAS * SAME_SIGMAS {
            return Err(PointRejection::Ambiguous);
        }
        // Along an edge, the place may be any of these.
        found.covariance += apart * apart.transpose();
    }
    if found.explained < MIN_EXPLAINED {
        return Err(PointRejection::Changed);
    }
    let start = Vector2::new(BACKWARD_START_PX, -BACKWARD_START_PX);
    let back = adjust_shift(
        &shifted,
        &pair.template,
        start,
        pair.offset,
        slopes.map(|by| -by),
        &CHECK_PASSES,
    )?
    .shift();
    if back.dot(&(weight * back)) > MAX_LOOP.0 * MAX_LOOP.0 && back.norm() > MAX_LOOP.1 {
        return Err(PointRejection::Inconsistent);
    }
    let jacobian = prediction.map_jacobian(&found.shift);
    Ok(PointMatch {
        place_px: prediction.frame_point(&found.shift),
        covariance_px2: jacobian * found.covariance * jacobian.transpose(),
        explained: found.explained,
    })
}
