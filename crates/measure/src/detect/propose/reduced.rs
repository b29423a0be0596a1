//! Crossing of the edges of large quadrants, from a reduced image.

use nalgebra::Vector2;

use crate::detect::estimate::options::OUTLINED;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::propose::options::OUTLINE;
use crate::raster::Raster;

/// Image around a hypothesis, reduced by an integer factor.
pub struct ReducedImage {
    /// Means of square blocks.
    pub image: Raster,
    /// Hypothesis in the reduced image.
    pub hypothesis: Hypothesis,
    corner: Vector2<f64>,
    factor: f64,
}

impl ReducedImage {
    /// Reduces the image around large quadrants; returns `None` for others. Seen from nearby, the centre of their outline
    /// is not that of the target, and the first crossing is farther from the edges than the distance in which pixels are
    /// selected; less so in a reduced image.
    pub fn from_large_quadrants(image: &Raster, hypothesis: &Hypothesis) -> Option<Self> {
        let ellipse = &hypothesis.ellipse;
        if hypothesis.edges.is_none() || ellipse.minor < OUTLINE.large_px {
            return None;
        }
        let step = (ellipse.minor / (0.5 * OUTLINE.large_px)) as usize;
        let factor = step as f64;
        let reach = ellipse.half_extent() * OUTLINED.larger;
        let corner = (ellipse.centre - reach).map(|v| v.max(0.0).floor());
        let most = Vector2::new(image.width() as f64, image.height() as f64);
        let size =
            ((ellipse.centre + reach).inf(&most) - corner).map(|v| (v / factor).max(0.0) as usize);
        let (x0, y0) = (corner.x as usize, corner.y as usize);
        let mean = |i: usize, j: usize| {
            let rows = (0..step).map(|k| image.row(y0 + j * step + k));
            let parts = rows.map(|row| {
                row.iter()
                    .skip(x0 + i * step)
                    .take(step)
                    .map(|&v| u32::from(v))
                    .sum::<u32>()
            });
            (f64::from(parts.sum::<u32>()) / (factor * factor)).round() as u8
        };
        let means = (0..size.y)
            .flat_map(|j| (0..size.x).map(move |i| (i, j)))
            .map(|(i, j)| mean(i, j))
            .collect();
        let mut out = Self {
            image: Raster::new(size.x, size.y, means)?,
            hypothesis: hypothesis.clone(),
            corner,
            factor,
        };
        // Occlusions are given in the original image.
        out.hypothesis = out.hypothesis.with_glare(Vec::new());
        let (major, minor) = (ellipse.major / factor, ellipse.minor / factor);
        out.hypothesis.ellipse = Ellipse {
            centre: out.to_reduced(ellipse.centre),
            major,
            minor,
            ..*ellipse
        };
        Some(out)
    }

    /// Converts a position of the original image to the reduced one, px: the centre of the first block is its origin.
    fn to_reduced(&self, at: Vector2<f64>) -> Vector2<f64> {
        (at - self.corner).add_scalar(0.5) / self.factor - Vector2::from_element(0.5)
    }

    /// Converts a position of the reduced image to the original one, px.
    pub fn to_original(&self, at: Vector2<f64>) -> Vector2<f64> {
        at.add_scalar(0.5) * self.factor - Vector2::from_element(0.5) + self.corner
    }
}
