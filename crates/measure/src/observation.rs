//! Observations of markers, and estimates of quantities: plain data shared by adjustment and environment.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Deserializer, Serialize};

/// Image of a marker's centre in one frame, or the mean of several ground frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index in [`Setup::markers`](super::setup::Setup::markers).
    pub marker: usize,
    /// Image of the marker's centre, px.
    pub pixel: Vector2<f64>,
    /// Covariance of the image, px^2.
    pub covariance_px2: Matrix2<f64>,
}

impl Observation {
    /// Returns the mean observation of each observed marker below `markers`, weighted by the covariances.
    pub fn mean_observations(
        markers: usize,
        observations: impl IntoIterator<Item = Self>,
    ) -> Vec<Self> {
        let mut sums = vec![(Matrix2::zeros(), Vector2::zeros()); markers];
        for observation in observations {
            let weight = observation.covariance_px2.try_inverse();
            if let (Some(weight), Some(sum)) = (weight, sums.get_mut(observation.marker)) {
                sum.0 += weight;
                sum.1 += weight * observation.pixel;
            }
        }
        let mean = |(marker, (weight, sum)): (usize, (Matrix2<f64>, Vector2<f64>))| {
            let covariance_px2 = weight.try_inverse()?;
            Some(Self {
                marker,
                pixel: covariance_px2 * sum,
                covariance_px2,
            })
        };
        sums.into_iter().enumerate().filter_map(mean).collect()
    }
}

/// An estimated number with its standard deviation; `None` for a fixed one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Value, in the unit of the field's name; a value that is not finite is written as `null` and read as NaN.
    #[serde(deserialize_with = "deserialize_or_nan")]
    pub value: f64,
    /// Standard deviation, in the unit of the value.
    pub sigma: Option<f64>,
}

/// Reads a number that is written as `null` if it is not finite.
pub(crate) fn deserialize_or_nan<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(input)?.unwrap_or(f64::NAN))
}
