//! Line along the wing in the image, along which bent rays shift images smoothly.

use nalgebra::{Matrix2, Vector2, Vector3};

/// Line along the wing in the image on the ground.
#[derive(Clone, Copy, Debug)]
pub struct ImageLine {
    middle_px: Vector2<f64>,
    /// Direction over half of the length of the line, 1/px.
    along_per_px: Vector2<f64>,
}

impl ImageLine {
    /// Fits the line to the images of markers.
    pub fn from_pixels(pixels: &[Vector2<f64>]) -> Self {
        let middle_px = pixels.iter().sum::<Vector2<f64>>() / pixels.len().max(1) as f64;
        let scatter: Matrix2<f64> = pixels
            .iter()
            .map(|p| (p - middle_px) * (p - middle_px).transpose())
            .sum();
        let axes = scatter.symmetric_eigen();
        let along = axes.eigenvectors.column(axes.eigenvalues.imax());
        let half = pixels
            .iter()
            .map(|p| along.dot(&(p - middle_px)).abs())
            .fold(f64::MIN_POSITIVE, f64::max);
        Self {
            middle_px,
            along_per_px: along / half,
        }
    }

    /// Legendre polynomials of degree 2 to 4 of the position along the line. Those of degree 0 and 1 are a rotation and a
    /// scale of the image.
    pub fn modes(&self, pixel: &Vector2<f64>) -> Vector3<f64> {
        let s = self
            .along_per_px
            .dot(&(pixel - self.middle_px))
            .clamp(-1.0, 1.0);
        let squared = s * s;
        Vector3::new(
            (3.0 * squared - 1.0) / 2.0,
            (5.0 * squared - 3.0) * s / 2.0,
            (35.0 * squared * squared - 30.0 * squared + 3.0) / 8.0,
        )
    }
}
