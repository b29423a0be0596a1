//! Pictures of a checkerboard with known truth: a bowed board before a distorting lens, anti-aliased.
//!
//! Pixels are Gaussian means of the board's reflectance: near an edge of many samples, elsewhere of one.
//! The places on the board are traced exactly at every eighth pixel of a row and interpolated cubically between.

use nalgebra::{Matrix2, Rotation3, Unit, Vector2, Vector3};

use super::SeededRandom;
use crate::environment::Plate;
use crate::geometry::Lens;
use crate::raster::Raster;

/// Traced pixels of a row, px.
const STRIDE: usize = 8;
/// Samples along each side of a pixel's neighbourhood.
const SAMPLES: i32 = 13;
/// Half the neighbourhood, in blurs.
const REACH: f64 = 3.0;
/// Grey values of black and white squares, and of what is behind the board.
const GREY: [f64; 3] = [45.0, 205.0, 110.0];
/// White rim around the squares, in squares.
const RIM: f64 = 0.7;

/// How a board is held for a calibration (docs/calibration.md): so many times as far away as where it would fill the
/// picture, from and to.
const DISTANCE: [f64; 2] = [1.8, 2.7];
/// How far it is tilted, from and to, degrees.
const TILT_DEG: [f64; 2] = [20.0, 40.0];
/// How far it is turned in its own plane, rad.
const TURN: f64 = 0.25;
/// The picture is covered in cells, so many along each side.
const CELLS: usize = 4;
/// From the outermost corners to the board's edge, in squares.
const EDGE: f64 = 1.7;

/// A checkerboard in front of a camera.
#[derive(Clone, Debug)]
pub struct RenderedBoard {
    /// The camera.
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
    /// Of the noise, grey values.
    pub noise: f64,
    /// The panes between camera and board, in the camera frame.
    pub pane: Option<Plate>,
}

impl RenderedBoard {
    /// The `k`-th picture of a calibration: tilted, about in its cell of the picture, wholly visible.
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
            let tilt = random.uniform(TILT_DEG[0].to_radians(), TILT_DEG[1].to_radians());
            let camera_from_board = Rotation3::from_axis_angle(&axis, tilt)
                * Rotation3::from_axis_angle(&Vector3::z_axis(), random.uniform(-TURN, TURN));
            let mut cell = |k: usize| (k as f64 + random.unit()) / CELLS as f64;
            let (u, v) = (cell(k % CELLS), cell(k / CELLS % CELLS));
            let at = Vector2::new(u * f64::from(lens.width), v * f64::from(lens.height));
            let distance_m = filling_m * random.uniform(DISTANCE[0], DISTANCE[1]);
            let half = Vector3::new(corners.0 as f64 - 1.0, corners.1 as f64 - 1.0, 0.0) * square_m / 2.0;
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
            // In a cell at the border a large board may not fit: after some fifty tries another cell.
            if random.unit() < 0.02 {
                return Self::calibration_image(lens, corners, square_m, bow_m, k + CELLS + 1, random);
            }
        }
    }

    fn is_fully_visible(&self) -> bool {
        let edge = |n: usize| [-EDGE * self.square_m, (n as f64 + EDGE - 1.0) * self.square_m];
        let (across, along) = (edge(self.corners.0), edge(self.corners.1));
        let seen = |x: f64, y: f64| {
            self.lens.project(&self.camera_point(&Vector2::new(x, y))).is_some_and(|p| self.lens.contains(&p))
        };
        across.iter().all(|x| along.iter().all(|y| seen(*x, *y)))
    }

    /// The point in the camera frame of a place on the board, m.
    pub fn camera_point(&self, board_m: &Vector2<f64>) -> Vector3<f64> {
        let raised = Vector3::new(board_m.x, board_m.y, self.height_m(board_m));
        self.camera_from_board * raised + self.origin_m
    }

    fn height_m(&self, board_m: &Vector2<f64>) -> f64 {
        let side = |n: usize| 0.5 * (n as f64 - 1.0) * self.square_m;
        let (hx, hy) = (side(self.corners.0), side(self.corners.1));
        let (u, v) = (board_m.x / hx - 1.0, board_m.y / hy - 1.0);
        self.bow_m[0] * (1.0 - u * u) + self.bow_m[1] * (1.0 - v * v)
    }

    /// True images of the inner corners, row by row, px.
    pub fn corner_pixels(&self) -> Vec<Vector2<f64>> {
        let (columns, rows) = self.corners;
        let cells = (0..rows).flat_map(|r| (0..columns).map(move |c| Vector2::new(c as f64, r as f64)));
        let seen = |p: Vector3<f64>| self.pane.map_or(p, |pane| pane.apparent_point(&p));
        cells.filter_map(|c| self.lens.project(&seen(self.camera_point(&(c * self.square_m))))).collect()
    }

    /// The picture; `None` where its size is 0.
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

    /// Places on the board under a row's pixels; `None` away from the board.
    fn trace_row(&self, y: usize) -> Vec<Option<Vector2<f64>>> {
        let width = self.lens.width as usize;
        let traced: Vec<Option<Vector2<f64>>> = (0..width / STRIDE + 4)
            .map(|k| self.trace_pixel(&Vector2::new((k as f64 - 1.0) * STRIDE as f64, y as f64)))
            .collect();
        let at = |x: usize| {
            let (k, t) = (x / STRIDE, (x % STRIDE) as f64 / STRIDE as f64);
            let [a, b, c, d] = [traced[k]?, traced[k + 1]?, traced[k + 2]?, traced[k + 3]?];
            // Lagrange through four places.
            Some(
                a * (-t * (t - 1.0) * (t - 2.0) / 6.0)
                    + b * ((t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0)
                    + c * (-(t + 1.0) * t * (t - 2.0) / 2.0)
                    + d * ((t + 1.0) * t * (t - 1.0) / 6.0),
            )
        };
        (0..width).map(at).collect()
    }

    /// The place on the bowed board that a pixel sees.
    fn trace_pixel(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let back = self.camera_from_board.inverse();
        let ray = self.lens.ray(pixel).ok()?;
        let (from, ray) = self.pane.map_or((Vector3::zeros(), ray), |p| p.outside_ray(&ray.normalize()));
        let (ray, eye) = (back * ray, back * (from - self.origin_m));
        let mut place = Vector2::zeros();
        let mut height = 0.0;
        // The board is nearly flat: each round leaves a hundredth of the last one's error or less.
        for _ in 0..6 {
            place = eye.xy() + ray.xy() * ((height - eye.z) / ray.z);
            height = self.height_m(&place);
        }
        let squares = Vector2::new(self.corners.0 as f64 + 1.0, self.corners.1 as f64 + 1.0);
        let beside = |v: f64, n: f64| v < -2.0 - 2.0 * RIM || v > n + 2.0 * RIM;
        let cell = place / self.square_m;
        (ray.z.abs() > 1e-9 && !beside(cell.x, squares.x) && !beside(cell.y, squares.y)).then_some(place)
    }

    /// Places about a pixel, px, and their weights.
    fn sample_offsets(&self) -> Vec<(Vector2<f64>, f64)> {
        let middle = 0.5 * f64::from(SAMPLES - 1);
        let one = |k: i32| {
            let off = Vector2::new(f64::from(k % SAMPLES) - middle, f64::from(k / SAMPLES) - middle)
                * self.step_px();
            (off, (-0.5 * off.norm_squared() / self.blur_px.powi(2)).exp())
        };
        (0..SAMPLES * SAMPLES).map(one).collect()
    }

    fn step_px(&self) -> f64 {
        2.0 * REACH * self.blur_px / f64::from(SAMPLES)
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
            ((cell - cell.round()) * self.square_m).abs() > extent * (REACH * self.blur_px + 1.0)
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

    fn inside_squares(&self, place: &Vector2<f64>) -> bool {
        self.is_within_rim(place, 0.0)
    }

    fn on_board(&self, place: &Vector2<f64>) -> bool {
        self.is_within_rim(place, RIM)
    }

    fn is_within_rim(&self, place: &Vector2<f64>, rim: f64) -> bool {
        let cell = place / self.square_m;
        let side = |v: f64, n: usize| v > -1.0 - rim && v < n as f64 + rim;
        side(cell.x, self.corners.0) && side(cell.y, self.corners.1)
    }

    /// A sample stands for its cell: edges rise over it, or those along the samples' rows would jump from one to the next.
    fn reflectance(&self, place: &Vector2<f64>, ramp: &Vector2<f64>) -> f64 {
        if self.inside_squares(place) {
            let wave = |v: f64, ramp: f64| {
                let line = (v / self.square_m).round();
                let side = if line.rem_euclid(2.0) < 0.5 { 1.0 } else { -1.0 };
                side * ((v - line * self.square_m) / ramp.max(1e-12)).clamp(-1.0, 1.0)
            };
            let both = wave(place.x, ramp.x) * wave(place.y, ramp.y);
            0.5 * (GREY[0] + GREY[1]) - 0.5 * (GREY[1] - GREY[0]) * both
        } else if self.on_board(place) {
            GREY[1]
        } else {
            GREY[2]
        }
    }
}
