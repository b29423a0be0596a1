//! Twist of frames in proportion to their bending.

use crate::adjust::beam::Bending;
use crate::adjust::marker_state::DimensionDerivatives;
use crate::adjust::scene::WingScene;
use crate::adjust::values::UnknownValues;

/// Ratio of the twist coefficients to the amplitude of the curvature, from all frames. The twist of a single frame is mostly
/// noise; derivatives with respect to the estimated dimensions, which hardly change in a solution, depend on it, so each
/// frame's noise would be counted as information about them.
#[derive(Clone, Debug, Default)]
pub struct LoadTwist {
    /// Sum of twist coefficients times amplitude, rad/m.
    products: Vec<f64>,
    /// Sum of squared amplitudes, 1/m^2.
    square: f64,
}

impl LoadTwist {
    /// Adds a frame.
    pub fn with_frame(mut self, values: &UnknownValues) -> Self {
        let amplitude = values.curvature_per_m[0];
        self.products.resize(values.twist_rad.len(), 0.0);
        self.products
            .iter_mut()
            .zip(&values.twist_rad)
            .for_each(|(sum, twist)| *sum += twist * amplitude);
        self.square += amplitude * amplitude;
        self
    }

    /// Returns the derivatives with respect to the estimated dimensions of a wing with this curvature, 1/m, and its expected
    /// twist. `scale`: length in flight over length on the ground.
    pub fn dimension_derivatives(
        &self,
        scene: &WingScene,
        curvature_per_m: &[f64],
        scale: f64,
    ) -> DimensionDerivatives {
        let ratio = if self.square > 0.0 {
            curvature_per_m[0] / self.square
        } else {
            0.0
        };
        let twist_rad: Vec<f64> = self
            .products
            .iter()
            .map(|product| product * ratio)
            .collect();
        scene.dimension_derivatives(&Bending {
            curvature_per_m,
            twist_rad: &twist_rad,
            scale,
            ..Bending::UNBENT
        })
    }
}
