//! Whether a place where a marker was not found looks as if it showed one.

use crate::detect::accept::options::VISIBLE;
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::segment::blob;
use crate::raster::Raster;

/// Whether what lies about an outline is as light and as dark as about the frame's markers, whose usual contrast is given, grey
/// levels: haze, glare and what hides a marker leave less.
pub fn shows_marker(image: &Raster, outline: &Ellipse, contrast: f64) -> bool {
    let about = outline.larger(VISIBLE.about, 0.0);
    let (low, high) = blob::about(&about, 0.0);
    let pixels = image.part(low, high, 1).filter(|(x, y, _)| {
        let (s, t) = about.local(nalgebra::Vector2::new(*x as f64, *y as f64));
        (s / about.major).powi(2) + (t / about.minor).powi(2) < 1.0
    });
    let greys = Histogram::of(pixels.map(|(_, _, value)| value));
    let at = |share: f64| greys.at((greys.total() as f64 * share) as usize);
    let (Some(dark), Some(light)) = (at(VISIBLE.dark), at(VISIBLE.light)) else { return false };
    light as f64 - dark as f64 > VISIBLE.contrast * contrast
}
