//! Twist of live frames in proportion to their bending.

use crate::adjust::beam::Bending;
use crate::adjust::layout::ParameterLayout;
use crate::adjust::scene::WingScene;
use crate::estimation::Fit;

/// Ratio of the twist coefficients to the amplitude of the curvature, from all accepted frames. The twist of a single frame
/// is mostly noise; derivatives with respect to the estimated dimensions depend on it, so each frame's noise would be
/// counted as information about them.
#[derive(Clone, Debug, Default)]
pub struct LoadTwist {
    /// Sum of twist coefficients times amplitude, rad/m.
    products: Vec<f64>,
    /// Sum of squared amplitudes, 1/m^2.
    square: f64,
}

impl LoadTwist {
    /// Adds the first frame of a solution.
    pub fn with_frame(mut self, layout: &ParameterLayout, fit: &Fit) -> Self {
        let values = layout.values(&fit.global, &fit.groups[0].local);
        let amplitude = values.curvature_per_m[0];
        self.products.resize(values.twist_rad.len(), 0.0);
        self.products
            .iter_mut()
            .zip(&values.twist_rad)
            .for_each(|(sum, twist)| *sum += twist * amplitude);
        self.square += amplitude * amplitude;
        self
    }

    /// Returns the layout with the derivatives with respect to the estimated dimensions of a wing with this curvature, 1/m,
    /// and its expected twist.
    pub fn fix_derivatives(
        &self,
        scene: &WingScene,
        layout: &ParameterLayout,
        curvature_per_m: &[f64],
    ) -> ParameterLayout {
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
        let bending = Bending {
            curvature_per_m,
            twist_rad: &twist_rad,
            scale: layout.expected_scale,
            ..Bending::UNBENT
        };
        ParameterLayout {
            dimension_derivatives: Some(scene.dimension_derivatives(&bending)),
            ..layout.clone()
        }
    }
}
