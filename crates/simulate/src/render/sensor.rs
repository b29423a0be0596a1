//! Sensor model, radiance to grey values: blur, tone curve, noise.

use nalgebra::Vector2;
use rayon::prelude::*;

use super::random::SeededRandom;
use wingd_measure::raster::Raster;

/// Parameters of the conversion from radiance to grey values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorModel {
    /// Standard deviation of the point spread, px.
    pub blur_px: f64,
    /// Movement during the exposure, px.
    pub motion_px: Vector2<f64>,
    /// Standard deviation of the noise at white, grey levels.
    pub noise: f64,
    /// Fraction of the noise variance that remains in the dark.
    pub read_fraction: f64,
    /// Exponent of the tone curve.
    pub gamma: f64,
}

impl Default for SensorModel {
    fn default() -> Self {
        Self {
            blur_px: 0.8,
            motion_px: Vector2::zeros(),
            noise: 1.5,
            read_fraction: 0.3,
            gamma: 2.2,
        }
    }
}

const TONES: usize = 4096;

impl SensorModel {
    /// Develops `radiance` (row by row, 1 saturates).
    pub fn develop(
        &self,
        radiance: Vec<f32>,
        width: usize,
        height: usize,
        seed: u64,
    ) -> Option<Raster> {
        let smeared = smear_image(radiance, width, &self.motion_px);
        let blurred = blur_image(smeared, width, self.blur_px);
        let tones: Vec<f32> = (0..=TONES)
            .map(|i| 255.0 * (i as f64 / TONES as f64).powf(1.0 / self.gamma) as f32)
            .collect();
        let mut luma = vec![0; width * height];
        luma.par_chunks_mut(width)
            .zip(blurred.par_chunks(width))
            .enumerate()
            .for_each(|(y, (out, row))| {
                // A stream per row, so that the result does not depend on the number of threads.
                let mut random = SeededRandom::new(seed, 1000 + y as u64);
                for (grey, &value) in out.iter_mut().zip(row) {
                    *grey =
                        self.add_noise_and_quantise(apply_tone_curve(&tones, value), &mut random);
                }
            });
        Raster::new(width, height, luma)
    }

    fn add_noise_and_quantise(&self, level: f32, random: &mut SeededRandom) -> u8 {
        let read = self.read_fraction as f32;
        let sigma = self.noise as f32 * (read + (1.0 - read) * level / 255.0).sqrt();
        (level + sigma * random.quick_normal() + 0.5).clamp(0.0, 255.0) as u8
    }
}

fn apply_tone_curve(tones: &[f32], value: f32) -> f32 {
    let position = value.clamp(0.0, 1.0) * TONES as f32;
    let i = (position as usize).min(TONES - 1);
    let fraction = position - i as f32;
    tones[i] + fraction * (tones[i + 1] - tones[i])
}

/// Returns the weights of a Gaussian, sampled at whole pixels; odd in number.
fn gaussian_kernel(sigma: f64) -> Vec<f32> {
    let radius = (4.0 * sigma).ceil() as i64;
    let weight = |x: i64| (-0.5 * (x as f64 / sigma).powi(2)).exp();
    let sum: f64 = (-radius..=radius).map(weight).sum();
    (-radius..=radius)
        .map(|x| (weight(x) / sum) as f32)
        .collect()
}

fn blur_image(image: Vec<f32>, width: usize, sigma: f64) -> Vec<f32> {
    if sigma <= 0.05 {
        return image;
    }
    let kernel = gaussian_kernel(sigma);
    let radius = kernel.len() / 2;
    let mut across = vec![0.0; image.len()];
    across
        .par_chunks_mut(width)
        .zip(image.par_chunks(width))
        .for_each(|(out, row)| {
            let padded: Vec<f32> = (0..width + 2 * radius)
                .map(|x| row[x.saturating_sub(radius).min(width - 1)])
                .collect();
            for (k, weight) in kernel.iter().enumerate() {
                out.iter_mut()
                    .zip(&padded[k..])
                    .for_each(|(o, p)| *o += weight * p);
            }
        });
    drop(image);
    let height = across.len() / width;
    let mut down = vec![0.0; across.len()];
    down.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, weight) in kernel.iter().enumerate() {
            let from = (y + k).saturating_sub(radius).min(height - 1);
            let row = &across[from * width..(from + 1) * width];
            out.iter_mut().zip(row).for_each(|(o, p)| *o += weight * p);
        }
    });
    down
}

/// Smears along a straight line centred on the pixel, so that centres do not move.
fn smear_image(image: Vec<f32>, width: usize, motion: &Vector2<f64>) -> Vec<f32> {
    if motion.norm() < 0.05 {
        return image;
    }
    let taps = (4.0 * motion.norm()).ceil() as usize | 1;
    let height = image.len() / width;
    let mut out = vec![0.0; image.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for tap in 0..taps {
            let share = (tap as f64 + 0.5) / taps as f64 - 0.5;
            let (dx, dy) = (share * motion.x, share * motion.y);
            for (weight, ox, oy) in bilinear_weights(dx, dy) {
                let weight = weight / taps as f32;
                let line = (y as i64 + oy).clamp(0, height as i64 - 1) as usize * width;
                for (x, value) in row.iter_mut().enumerate() {
                    let from = (x as i64 + ox).clamp(0, width as i64 - 1) as usize;
                    *value += weight * image[line + from];
                }
            }
        }
    });
    out
}

fn bilinear_weights(dx: f64, dy: f64) -> [(f32, i64, i64); 4] {
    let (x, y) = (dx.floor(), dy.floor());
    let (a, b) = ((dx - x) as f32, (dy - y) as f32);
    let (x, y) = (x as i64, y as i64);
    [
        ((1.0 - a) * (1.0 - b), x, y),
        (a * (1.0 - b), x + 1, y),
        ((1.0 - a) * b, x, y + 1),
        (a * b, x + 1, y + 1),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point() -> Vec<f32> {
        let mut image = vec![0.0; 41 * 41];
        image[20 * 41 + 20] = 1.0;
        image
    }

    fn moments(image: &[f32]) -> (f64, f64, f64, f64) {
        let mut sums = [0.0; 5];
        for (i, &value) in image.iter().enumerate() {
            let (x, y, w) = ((i % 41) as f64, (i / 41) as f64, f64::from(value));
            for (sum, term) in sums.iter_mut().zip([1.0, x, y, x * x, y * y]) {
                *sum += w * term;
            }
        }
        let (mx, my) = (sums[1] / sums[0], sums[2] / sums[0]);
        (
            mx,
            my,
            sums[3] / sums[0] - mx * mx,
            sums[4] / sums[0] - my * my,
        )
    }

    #[test]
    fn blur_keeps_the_centre_and_has_its_sigma() {
        let (mx, my, vx, vy) = moments(&blur_image(point(), 41, 1.5));
        assert!((mx - 20.0).abs() < 1e-5 && (my - 20.0).abs() < 1e-5);
        assert!((vx.sqrt() - 1.5).abs() < 0.01 && (vy.sqrt() - 1.5).abs() < 0.01);
    }

    #[test]
    fn motion_keeps_the_centre() {
        let (mx, my, vx, vy) = moments(&smear_image(point(), 41, &Vector2::new(3.0, -1.0)));
        assert!((mx - 20.0).abs() < 1e-5 && (my - 20.0).abs() < 1e-5);
        assert!(vx > vy && vx > 0.6);
    }

    #[test]
    fn noise_has_its_size_and_repeats() {
        let sensor = SensorModel {
            noise: 4.0,
            read_fraction: 1.0,
            ..SensorModel::default()
        };
        let develop = || sensor.develop(vec![0.25; 200 * 200], 200, 200, 9).unwrap();
        let image = develop();
        assert_eq!(image, develop());
        let mean = image.luma().iter().map(|&g| f64::from(g)).sum::<f64>() / 4e4;
        let variance = image
            .luma()
            .iter()
            .map(|&g| (f64::from(g) - mean).powi(2))
            .sum::<f64>()
            / 4e4;
        assert!((variance.sqrt() - 4.0).abs() < 0.15, "{variance}");
    }
}
