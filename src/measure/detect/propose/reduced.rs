//! Where the edges of large quadrants cross, from a smaller picture of them.

use nalgebra::Vector2;

use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::propose::options::OUTLINE;
use crate::raster::Raster;

/// A picture of a hypothesis, smaller by a whole factor.
pub struct ReducedImage {
    /// Means of squares.
    pub image: Raster,
    /// The hypothesis in it.
    pub hypothesis: Hypothesis,
    corner: Vector2<f64>,
    factor: f64,
}

impl ReducedImage {
    /// Of large quadrants; `None` of others. Where they are near, the centre of their outline is not that of the target, and the
    /// first crossing is farther off than its edges' pixels are looked for: less so in a smaller picture.
    pub fn from_large_quadrants(image: &Raster, hypothesis: &Hypothesis) -> Option<Self> {
        let ellipse = &hypothesis.ellipse;
        if hypothesis.edges.is_none() || ellipse.minor < OUTLINE.large_px {
            return None;
        }
        let step = (ellipse.minor / OUTLINE.small_px) as usize;
        let factor = step as f64;
        let reach = ellipse.extent() * OUTLINE.small_about;
        let corner = (ellipse.centre - reach).map(|v| v.max(0.0).floor());
        let most = Vector2::new(image.width() as f64, image.height() as f64);
        let size = ((ellipse.centre + reach).inf(&most) - corner).map(|v| (v / factor).max(0.0) as usize);
        let (x0, y0) = (corner.x as usize, corner.y as usize);
        let mean = |i: usize, j: usize| {
            let rows = (0..step).map(|k| image.row(y0 + j * step + k));
            let parts =
                rows.map(|row| row.iter().skip(x0 + i * step).take(step).map(|&v| u32::from(v)).sum::<u32>());
            (f64::from(parts.sum::<u32>()) / (factor * factor)).round() as u8
        };
        let means =
            (0..size.y).flat_map(|j| (0..size.x).map(move |i| (i, j))).map(|(i, j)| mean(i, j)).collect();
        let mut out = Self {
            image: Raster::new(size.x, size.y, means)?,
            hypothesis: hypothesis.clone(),
            corner,
            factor,
        };
        // What hides quadrants lies in the large picture.
        out.hypothesis = out.hypothesis.with_glare(Vec::new());
        let (major, minor) = (ellipse.major / factor, ellipse.minor / factor);
        out.hypothesis.ellipse = Ellipse { centre: out.to_reduced(ellipse.centre), major, minor, ..*ellipse };
        Some(out)
    }

    /// A place of the large picture in the smaller one, px: the centre of the first square is its origin.
    fn to_reduced(&self, at: Vector2<f64>) -> Vector2<f64> {
        (at - self.corner).add_scalar(0.5) / self.factor - Vector2::from_element(0.5)
    }

    /// The place in the large picture.
    pub fn to_original(&self, at: Vector2<f64>) -> Vector2<f64> {
        at.add_scalar(0.5) * self.factor - Vector2::from_element(0.5) + self.corner
    }
}
