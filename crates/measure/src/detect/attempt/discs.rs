//! Recognition of blobs that are whole discs, by fits of the image model.

use super::strategies::Measurer;
use super::whole::looks_cut;
use crate::detect::accept::verdict::MeasurementResult;
use crate::detect::detection::Detection;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::propose::moments;

impl Measurer<'_> {
    /// Measures a blob that looks like a whole disc; `None` for others.
    fn measure_round(&self, index: usize) -> Option<MeasurementResult> {
        let round = self
            .blobs
            .get(index)
            .filter(|b| !looks_cut(b))
            .and_then(|b| moments::disc_from_blob(index, b));
        round.map(|disc| self.measure_whole(index, &disc))
    }

    /// Returns whether a blob is a whole disc with a precise position.
    pub fn is_sure_disc(&self, index: usize) -> bool {
        matches!(self.measure_round(index), Some(Ok(disc)) if disc.is_sure())
    }

    /// Returns whether two or more discs lie in measured quadrants, each with less than half of their residuals.
    pub fn contain_discs(&self, quadrants: &Detection) -> bool {
        let whole = quadrants.ellipse();
        let mut found: Vec<Ellipse> = Vec::new();
        for (i, _) in self
            .blobs
            .iter()
            .enumerate()
            .filter(|(_, b)| whole.contains(b.centroid))
        {
            let Some(Ok(disc)) = self.measure_round(i) else {
                continue;
            };
            let ellipse = disc.detection.ellipse();
            let better = disc.is_sure() && disc.detection.fit_rms < 0.5 * quadrants.fit_rms;
            if better && !found.iter().any(|other| other.contains(ellipse.centre)) {
                found.push(ellipse);
            }
        }
        found.len() > 1
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::detect::attempt::measure::Bounds;
    use crate::detect::segment::blob::dark_parts;
    use crate::raster::Raster;
    use crate::setup::Shape;

    #[test]
    fn quadrants_that_contain_two_discs_fit_worse_than_they() {
        let disc = |x: f64| Ellipse {
            centre: Vector2::new(x, 40.3),
            major: 30.0,
            minor: 6.0,
            angle: 0.0,
        };
        let contain = |discs: &[Ellipse], fit_rms: f64| {
            // Each pixel is the mean of its surroundings.
            let value = |i: usize| {
                let offsets = (0..64).map(|k| [k % 8, k / 8].map(|v| (f64::from(v) - 3.5) / 4.0));
                let at =
                    offsets.map(|[u, v]| Vector2::new((i % 220) as f64 + u, (i / 220) as f64 + v));
                50 + 2 * at
                    .filter(|&at| !discs.iter().any(|disc| disc.contains(at)))
                    .count() as u8
            };
            let image = Raster::new(220, 80, (0..220 * 80).map(value).collect())
                .expect("a value for each pixel");
            let whole = Ellipse {
                centre: Vector2::new(110.0, 40.3),
                major: 80.0,
                minor: 8.0,
                angle: 0.0,
            };
            let blobs = dark_parts(&image, &whole, 10.0, 120);
            let quadrants = Detection {
                shape: Shape::Quadrant,
                centre_px: whole.centre,
                covariance_px2: Matrix2::identity().into(),
                semi_major_px: whole.major,
                semi_minor_px: whole.minor,
                angle_rad: whole.angle,
                fit_rms,
                contrast: 128.0,
                marker: None,
            };
            Measurer::new(&image, &blobs, Bounds::from_noise(0.5)).contain_discs(&quadrants)
        };
        let two = [disc(72.4), disc(148.7)];
        assert!(contain(&two, 20.0) && !contain(&two[..1], 20.0) && !contain(&two, 0.1));
    }
}
