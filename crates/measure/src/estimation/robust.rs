//! Scales and fits that are robust against a few outliers.

use nalgebra::Vector2;

/// Standard deviation over the median of the absolute values, for a normal distribution.
pub const SIGMA_OVER_MEDIAN: f64 = 1.4826;
/// Distance, in robust standard deviations, from which on a point loses weight; at twice the distance its weight is 0.
const OUTLIER_SIGMAS: f64 = 4.0;
/// Maximum number of rounds of either weighting; five or six are typical.
const MAX_ROUNDS: usize = 10;

/// Returns the median, of an even number of values the upper one; `None` without values.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Median of the squared length of two standard normal coordinates.
pub const MEDIAN_SQUARE: f64 = 2.0 * std::f64::consts::LN_2;
/// Median of the square of one standard normal coordinate.
pub const MEDIAN_SQUARE_1D: f64 = 0.4549;
/// Number of bisections of the range of a common variance, for a relative precision of 1e-12.
const BISECTIONS: usize = 40;

/// Returns the median; 0 without values.
fn median_or_0(values: Vec<f64>) -> f64 {
    median(values).unwrap_or(0.0)
}

/// Robust location and scale of a sample.
#[derive(Clone, Copy, Debug)]
pub struct RobustLocation {
    pub median: f64,
    /// Standard deviation, estimated from the median absolute deviation.
    pub sigma: f64,
}

impl RobustLocation {
    /// Estimates location and scale of values; 0 without values.
    pub fn from_values(values: &[f64]) -> Self {
        let median = median_or_0(values.to_vec());
        let off = values.iter().map(|v| (v - median).abs());
        Self {
            median,
            sigma: SIGMA_OVER_MEDIAN * median_or_0(off.collect()),
        }
    }
}

/// Estimates the scale of normalised residuals of two coordinates from the median of their squared lengths, because an
/// outlier would inflate the mean.
pub fn scale_from_squares(squares: &[f64]) -> f64 {
    (median_or_0(squares.to_vec()) / MEDIAN_SQUARE).sqrt()
}

/// Estimates the standard deviation of a coordinate from the median of the residuals' lengths, px.
pub fn coordinate_sigma_px(residuals: &[Vector2<f64>]) -> f64 {
    scale_from_squares(
        &residuals
            .iter()
            .map(Vector2::norm_squared)
            .collect::<Vec<f64>>(),
    )
}

/// Estimates the additional variance, common to all values, with which the median of their normalised squares is `goal`
/// (Paule and Mandel 1982, with the median instead of the mean), by bisection.
pub fn common_variance(squares: &[f64], own: &[f64], goal: f64) -> f64 {
    let over = |common: f64| {
        median_or_0(
            squares
                .iter()
                .zip(own)
                .map(|(s, v)| s / (v + common))
                .collect(),
        )
    };
    if over(0.0) <= goal {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, median_or_0(squares.to_vec()) / goal);
    for _ in 0..BISECTIONS {
        let half = 0.5 * (low + high);
        if over(half) > goal {
            low = half
        } else {
            high = half
        }
    }
    high
}

/// Estimates a robust standard deviation from the median of normalised distances, not below 1.
pub fn robust_sigma(distances: Vec<f64>) -> f64 {
    median(distances).map_or(1.0, |median| (SIGMA_OVER_MEDIAN * median).max(1.0))
}

/// Fits points robustly by iterated weights: first for the sum of distances, to which one point contributes little, then
/// Hampel's weights, 1 up to [`OUTLIER_SIGMAS`] robust standard deviations and 0 from twice that on. `fit` takes weights;
/// `distances` returns the distances of the points from a fit, in standard deviations. Points of weight 0 do not count.
pub fn fit_robustly<F>(
    weights: &[f64],
    fit: impl Fn(&[f64]) -> F,
    distances: impl Fn(&F) -> Vec<f64>,
) -> F {
    let hampel = |off: &[f64]| {
        let counting = off.iter().zip(weights).filter(|(_, w)| **w > 0.0);
        let limit = OUTLIER_SIGMAS * robust_sigma(counting.map(|(o, _)| *o).collect());
        off.iter()
            .map(|o| (2.0 - o / limit).clamp(0.0, 1.0))
            .collect::<Vec<f64>>()
    };
    let nearness = |off: &[f64]| off.iter().map(|o| 1.0 / o.max(1.0)).collect::<Vec<f64>>();
    let mut factors = vec![1.0; weights.len()];
    let mut found = fit(weights);
    for weighting in [&nearness as &dyn Fn(&[f64]) -> Vec<f64>, &hampel] {
        for _ in 0..MAX_ROUNDS {
            let next = weighting(&distances(&found));
            // The same weights give the same fit.
            if next == factors {
                break;
            }
            let weighted: Vec<f64> = weights.iter().zip(&next).map(|(w, f)| w * f).collect();
            (found, factors) = (fit(&weighted), next);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(values: &[f64], weights: &[f64]) -> f64 {
        let sum: f64 = values.iter().zip(weights).map(|(v, w)| v * w).sum();
        sum / weights.iter().sum::<f64>()
    }

    #[test]
    fn outliers_have_no_weight_and_other_points_full_weight() {
        let values = [0.3, -0.5, 0.1, 0.6, -0.2, 50.0, -0.4];
        let found = fit_robustly(
            &[1.0; 7],
            |weights| mean(&values, weights),
            |mean| values.iter().map(|v| (v - mean).abs()).collect(),
        );
        assert!(
            (found - mean(&values, &[1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0])).abs() < 1e-12,
            "{found}"
        );
    }

    #[test]
    fn one_fit_suffices_without_outliers() {
        let fits = std::cell::Cell::new(0);
        let values = [0.3, -0.5, 0.1, 0.6];
        let counted = |weights: &[f64]| {
            fits.set(fits.get() + 1);
            mean(&values, weights)
        };
        fit_robustly(&[1.0; 4], counted, |mean| {
            values.iter().map(|v| (v - mean).abs()).collect()
        });
        assert_eq!(fits.get(), 1);
    }
}
