//! Images of a checkerboard with known truth: a bowed board in front of a distorting lens, anti-aliased.
//!
//! Pixels are Gaussian means of the board's reflectance: of many samples near an edge, of one elsewhere. Positions on the
//! board are traced exactly at every eighth pixel of a row and interpolated cubically between.

use nalgebra::{Matrix2, Rotation3, Unit, Vector2, Vector3};

use super::SeededRandom;
use wingd_measure::environment::Plate;
use wingd_measure::geometry::Lens;
use wingd_measure::raster::Raster;

/// Spacing of the traced pixels of a row, px.
const STRIDE: usize = 8;
/// Number of samples along each side of a pixel's neighbourhood.
const SAMPLES: i32 = 13;
/// Half the side of the neighbourhood, in blurs.
const SAMPLE_RADIUS_BLURS: f64 = 3.0;
/// Grey values of black squares, white squares and the background.
const GREY: [f64; 3] = [45.0, 205.0, 110.0];
/// Width of the white rim around the squares, in squares.
const RIM: f64 = 0.7;

/// Distance of a board for a calibration (docs/calibration.md) over the one at which it fills the image, from and to.
const DISTANCE_RANGE: [f64; 2] = [1.8, 2.7];
/// Tilt of a board for a calibration, from and to, degrees.
const TILT_RANGE_DEG: [f64; 2] = [20.0, 40.0];
/// Maximum rotation in the board's plane, rad.
const MAX_ROTATION_RAD: f64 = 0.25;
/// Number of cells along each side of the image that the boards cover.
const CELLS: usize = 4;
/// Distance from the outermost corners to the board's edge, in squares.
const EDGE: f64 = 1.7;

/// Checkerboard in front of a camera.
#[derive(Clone, Debug)]
pub struct RenderedBoard {
    pub lens: Lens,
    /// Inner corners along a row and a column.
    pub corners: (usize, usize),
    /// Side of a square, m.
    pub square_m: f64,
    /// Height of the middle over the chords between the outermost corners, along and across, m.
    pub bow_m: [f64; 2],
    /// Attitude; the board's first inner corner is its origin, x along its rows.
    pub camera_from_board: Rotation3<f64>,
    /// The board's origin, camera frame, m.
    pub origin_m: Vector3<f64>,
    /// Standard deviation of the blur, px.
    pub blur_px: f64,
    /// Standard deviation of the noise, grey values.
    pub noise: f64,
    /// Panes between camera and board, in the camera frame.
    pub pane: Option<Plate>,
}

impl RenderedBoard {
    /// Samples the `k`-th image of a calibration: tilted, near its cell of the image, completely visible.
    pub fn calibration_image(
        lens: &Lens,
        corners: (usize, usize),
        square_m: f64,
        bow_m: [f64; 2],
        k: usize,
        random: &mut SeededRandom,
    ) -> Self {
        let side = |n: usize| (n as f64 - 1.0 + 2.0 * EDGE) * square_m;
        let across_m = side(corners.0) * lens.fx / f64::from(lens.width);
        let filling_m = across_m.max(side(corners.1) * lens.fy / f64::from(lens.height));
        loop {
            let azimuth = random.uniform(0.0, std::f64::consts::TAU);
            let axis = Unit::new_normalize(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0));
            let tilt = random.uniform(
                TILT_RANGE_DEG[0].to_radians(),
                TILT_RANGE_DEG[1].to_radians(),
            );
            let camera_from_board = Rotation3::from_axis_angle(&axis, tilt)
                * Rotation3::from_axis_angle(
                    &Vector3::z_axis(),
                    random.uniform(-MAX_ROTATION_RAD, MAX_ROTATION_RAD),
                );
            let mut cell = |k: usize| (k as f64 + random.unit()) / CELLS as f64;
            let (u, v) = (cell(k % CELLS), cell(k / CELLS % CELLS));
            let at = Vector2::new(u * f64::from(lens.width), v * f64::from(lens.height));
            let distance_m = filling_m * random.uniform(DISTANCE_RANGE[0], DISTANCE_RANGE[1]);
            let half =
                Vector3::new(corners.0 as f64 - 1.0, corners.1 as f64 - 1.0, 0.0) * square_m / 2.0;
            let found = lens.ray(&at).ok().map(|ray| Self {
                lens: *lens,
                corners,
                square_m,
                bow_m,
                camera_from_board,
                origin_m: ray.normalize() * distance_m - camera_from_board * half,
                blur_px: 0.7,
                noise: 1.5,
                pane: None,
            });
            if let Some(found) = found.filter(Self::is_fully_visible) {
                return found;
            }
            // A large board may not fit in a cell at the border: after about 50 attempts another cell is
            // tried.
            if random.unit() < 0.02 {
                return Self::calibration_image(
                    lens,
                    corners,
                    square_m,
                    bow_m,
                    k + CELLS + 1,
                    random,
                );
            }
        }
    }

    fn is_fully_visible(&self) -> bool {
        let edge = |n: usize| {
            [
                -EDGE * self.square_m,
                (n as f64 + EDGE - 1.0) * self.square_m,
            ]
        };
        let (across, along) = (edge(self.corners.0), edge(self.corners.1));
        let seen = |x: f64, y: f64| {
            self.lens
                .project(&self.camera_point(&Vector2::new(x, y)))
                .is_some_and(|p| self.lens.contains(&p))
        };
        across.iter().all(|x| along.iter().all(|y| seen(*x, *y)))
    }

    /// Returns a point of the board in the camera frame, m.
    pub fn camera_point(&self, board_m: &Vector2<f64>) -> Vector3<f64> {
        let raised = Vector3::new(board_m.x, board_m.y, self.bow_height_m(board_m));
        self.camera_from_board * raised + self.origin_m
    }

    fn bow_height_m(&self, board_m: &Vector2<f64>) -> f64 {
        let side = |n: usize| 0.5 * (n as f64 - 1.0) * self.square_m;
        let (hx, hy) = (side(self.corners.0), side(self.corners.1));
        let (u, v) = (board_m.x / hx - 1.0, board_m.y / hy - 1.0);
        self.bow_m[0] * (1.0 - u * u) + self.bow_m[1] * (1.0 - v * v)
    }

    /// Returns the true images of the inner corners, row by row, px.
    pub fn corner_pixels(&self) -> Vec<Vector2<f64>> {
        let (columns, rows) = self.corners;
        let cells =
            (0..rows).flat_map(|r| (0..columns).map(move |c| Vector2::new(c as f64, r as f64)));
        let seen = |p: Vector3<f64>| self.pane.map_or(p, |pane| pane.apparent_point(&p));
        cells
            .filter_map(|c| {
                self.lens
                    .project(&seen(self.camera_point(&(c * self.square_m))))
            })
            .collect()
    }

    /// Renders the image; `None` if its size is 0.
    pub fn render(&self, random: &mut SeededRandom) -> Option<Raster> {
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        let mut luma = Vec::with_capacity(width * height);
        let mut below = self.trace_row(0);
        let samples = self.sample_offsets();
        for y in 0..height {
            let row = std::mem::replace(&mut below, self.trace_row(y + 1));
            for x in 0..width {
                let next = (x + 1).min(width - 1);
                let grey = match (row[x], row[next], below[x]) {
                    (Some(here), Some(right), Some(down)) if next > x => {
                        self.pixel_grey(&here, right - here, down - here, &samples)
                    }
                    _ => GREY[2],
                };
                let noise = f64::from(random.quick_normal()) * self.noise;
                luma.push((grey + noise).round().clamp(0.0, 255.0) as u8);
            }
        }
        Raster::new(width, height, luma)
    }

    /// Returns the board positions under a row's pixels; `None` outside the board.
    fn trace_row(&self, y: usize) -> Vec<Option<Vector2<f64>>> {
        let width = self.lens.width as usize;
        let traced: Vec<Option<Vector2<f64>>> = (0..width / STRIDE + 4)
            .map(|k| self.trace_pixel(&Vector2::new((k as f64 - 1.0) * STRIDE as f64, y as f64)))
            .collect();
        let at = |x: usize| {
            let (k, t) = (x / STRIDE, (x % STRIDE) as f64 / STRIDE as f64);
            let [a, b, c, d] = [traced[k]?, traced[k + 1]?, traced[k + 2]?, traced[k + 3]?];
            // Lagrange interpolation through four positions.
            Some(
                a * (-t * (t - 1.0) * (t - 2.0) / 6.0)
                    + b * ((t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0)
                    + c * (-(t + 1.0) * t * (t - 2.0) / 2.0)
                    + d * ((t + 1.0) * t * (t - 1.0) / 6.0),
            )
        };
        (0..width).map(at).collect()
    }

    /// Returns the position on the bowed board that a pixel sees.
    fn trace_pixel(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let back = self.camera_from_board.inverse();
        let ray = self.lens.ray(pixel).ok()?;
        let (from, ray) = self
            .pane
            .map_or((Vector3::zeros(), ray), |p| p.outside_ray(&ray.normalize()));
        let (ray, eye) = (back * ray, back * (from - self.origin_m));
        let mut position = Vector2::zeros();
        let mut height = 0.0;
        // The board is nearly flat: each round reduces the error to 1 % or less.
        for _ in 0..6 {
            position = eye.xy() + ray.xy() * ((height - eye.z) / ray.z);
            height = self.bow_height_m(&position);
        }
        let squares = Vector2::new(self.corners.0 as f64 + 1.0, self.corners.1 as f64 + 1.0);
        let is_outside = |v: f64, n: f64| v < -2.0 - 2.0 * RIM || v > n + 2.0 * RIM;
        let cell = position / self.square_m;
        (ray.z.abs() > 1e-9 && !is_outside(cell.x, squares.x) && !is_outside(cell.y, squares.y))
            .then_some(position)
    }

    /// Returns the samples' offsets from the pixel, px, and their weights.
    fn sample_offsets(&self) -> Vec<(Vector2<f64>, f64)> {
        let middle = 0.5 * f64::from(SAMPLES - 1);
        let one = |k: i32| {
            let off = Vector2::new(
                f64::from(k % SAMPLES) - middle,
                f64::from(k / SAMPLES) - middle,
            ) * self.step_px();
            (
                off,
                (-0.5 * off.norm_squared() / self.blur_px.powi(2)).exp(),
            )
        };
        (0..SAMPLES * SAMPLES).map(one).collect()
    }

    fn step_px(&self) -> f64 {
        2.0 * SAMPLE_RADIUS_BLURS * self.blur_px / f64::from(SAMPLES)
    }

    fn pixel_grey(
        &self,
        here: &Vector2<f64>,
        right: Vector2<f64>,
        down: Vector2<f64>,
        samples: &[(Vector2<f64>, f64)],
    ) -> f64 {
        let by_pixel = Matrix2::from_columns(&[right, down]);
        let extent = Vector2::new(by_pixel.row(0).norm(), by_pixel.row(1).norm());
        let clear = |v: f64, extent: f64| {
            let cell = v / self.square_m;
            ((cell - cell.round()) * self.square_m).abs()
                > extent * (SAMPLE_RADIUS_BLURS * self.blur_px + 1.0)
        };
        let ramp = extent * (0.5 * self.step_px());
        if !self.on_board(here)
            || (clear(here.x, extent.x) && clear(here.y, extent.y) && self.inside_squares(here))
        {
            return self.reflectance(here, &ramp);
        }
        let (mut sum, mut weights) = (0.0, 0.0);
        for (off, weight) in samples {
            sum += weight * self.reflectance(&(here + by_pixel * off), &ramp);
            weights += weight;
        }
        sum / weights
    }

    fn inside_squares(&self, position: &Vector2<f64>) -> bool {
        self.is_within_rim(position, 0.0)
    }

    fn on_board(&self, position: &Vector2<f64>) -> bool {
        self.is_within_rim(position, RIM)
    }

    fn is_within_rim(&self, position: &Vector2<f64>, rim: f64) -> bool {
        let cell = position / self.square_m;
        let side = |v: f64, n: usize| v > -1.0 - rim && v < n as f64 + rim;
        side(cell.x, self.corners.0) && side(cell.y, self.corners.1)
    }

    /// Returns the reflectance of a sample. Edges rise linearly over the sample's cell; steps along the samples' rows would
    /// jump from one row to the next.
    fn reflectance(&self, position: &Vector2<f64>, ramp: &Vector2<f64>) -> f64 {
        if self.inside_squares(position) {
            let wave = |v: f64, ramp: f64| {
                let line = (v / self.square_m).round();
                let side = if line.rem_euclid(2.0) < 0.5 {
                    1.0
                } else {
                    -1.0
                };
                side * ((v - line * self.square_m) / ramp.max(1e-12)).clamp(-1.0, 1.0)
            };
            let both = wave(position.x, ramp.x) * wave(position.y, ramp.y);
            0.5 * (GREY[0] + GREY[1]) - 0.5 * (GREY[1] - GREY[0]) * both
        } else if self.on_board(position) {
            GREY[1]
        } else {
            GREY[2]
        }
    }
}
