//! Images of a screen that shows the clock of `wingd time-check`.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use wingd::measure::raster::Raster;
use wingd::measure::render::{SeededRandom, SensorModel};
use wingd::measure::time_code::{
    BITS, DISC_RADIUS, DISCS, FASTEST, SIZE, TICK_MS, cell_rectangle, code_word,
};

/// About 22 November 2026.
pub const BEGIN_S: f64 = 1_795_300_000.0;

/// Size of the images, px.
pub const SIZE_PX: (usize, usize) = (1200, 900);
/// Samples along each side of a pixel.
const FINE: usize = 3;
/// Samples of an exposure: several meet a screen's frame of 17 ms even if the exposure lasts 0.2 s.
const MOMENTS: usize = 400;

/// A screen that shows the clock, s.
pub struct Display {
    /// Frame period, s.
    pub refresh_s: f64,
    /// Latency from reading the clock to the light in the row of the fastest bits.
    pub latency_s: f64,
    /// Phase of the first frame.
    pub phase_s: f64,
}

impl Display {
    /// The code that a row shows at a moment; the screen is written from top to bottom within a refresh.
    fn word(&self, at_s: f64, y: f64) -> u32 {
        let [_, top, _, height] = cell_rectangle(FASTEST, false);
        let row_s = (y - top - 0.5 * height) / SIZE[1] * self.refresh_s;
        let frame = ((at_s - self.latency_s - row_s - self.phase_s) / self.refresh_s).floor();
        let drawn_s = self.phase_s + frame * self.refresh_s;
        code_word(((1e3 * drawn_s / f64::from(TICK_MS)).floor() as u64 % (1 << 17)) as u32)
    }

    /// Fraction of the exposure during which each bit is one.
    pub fn lit_fractions(&self, middle_s: f64, exposure_s: f64) -> Vec<f64> {
        let share = |bit: usize| {
            let [_, y, _, height] = cell_rectangle(bit, false);
            let lit = |k: usize| {
                let at_s = middle_s + exposure_s * ((k as f64 + 0.5) / MOMENTS as f64 - 0.5);
                f64::from(self.word(at_s, y + 0.5 * height) >> bit & 1)
            };
            (0..MOMENTS).map(lit).sum::<f64>() / MOMENTS as f64
        };
        (0..BITS).map(share).collect()
    }
}

/// Rectangle of a cell and its light.
type LitCell = ([f64; 4], f64);

/// Light at a position of the page, 1 for white.
fn light(cells: &[LitCell], x: f64, y: f64) -> f64 {
    if DISCS
        .iter()
        .any(|[u, v]| (x - u).powi(2) + (y - v).powi(2) < DISC_RADIUS * DISC_RADIUS)
    {
        return 0.0;
    }
    let is_inside = |[left, top, width, height]: &[f64; 4]| {
        (*left..left + width).contains(&x) && (*top..top + height).contains(&y)
    };
    cells
        .iter()
        .find(|(cell, _)| is_inside(cell))
        .map_or(1.0, |(_, light)| *light)
}

/// Renders an image of the screen from a random attitude; the screen takes about 50 % of the width.
pub fn photograph(
    shares: &[f64],
    sensor: &SensorModel,
    white: f64,
    random: &mut SeededRandom,
) -> Raster {
    let (width, height) = SIZE_PX;
    let cell = |bit: usize| {
        [
            (cell_rectangle(bit, false), shares[bit]),
            (cell_rectangle(bit, true), 1.0 - shares[bit]),
        ]
    };
    let cells: Vec<LitCell> = (0..BITS).flat_map(cell).collect();
    let axis = |random: &mut SeededRandom| random.uniform(-0.5, 0.5);
    let attitude =
        Rotation3::from_euler_angles(axis(random), axis(random), random.uniform(-0.6, 0.6));
    let distance = random.uniform(26.0, 34.0);
    let f = 1300.0;
    let k = Matrix3::new(
        f,
        0.0,
        0.5 * width as f64,
        0.0,
        f,
        0.5 * height as f64,
        0.0,
        0.0,
        1.0,
    );
    let m = attitude.matrix();
    let shift =
        Vector3::new(0.0, 0.0, distance) - m * Vector3::new(0.5 * SIZE[0], 0.5 * SIZE[1], 0.0);
    let pixel_from_page =
        k * Matrix3::from_columns(&[m.column(0).into(), m.column(1).into(), shift]);
    let page_from_pixel = pixel_from_page.try_inverse().unwrap();
    let seen = |u: f64, v: f64| {
        let p = page_from_pixel * Vector3::new(u, v, 1.0);
        let page: Vector2<f64> = p.xy() / p.z;
        // A dark frame around the screen, and a wall.
        let rim = (-page.x)
            .max(page.x - SIZE[0])
            .max(-page.y)
            .max(page.y - SIZE[1]);
        if rim < 0.0 {
            white * light(&cells, page.x, page.y)
        } else if rim < 0.6 {
            0.01
        } else {
            0.12
        }
    };
    let mut radiance = Vec::with_capacity(width * height);
    for (v, u) in (0..height).flat_map(|v| (0..width).map(move |u| (v, u))) {
        let part = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
        let parts =
            (0..FINE * FINE).map(|k| seen(u as f64 + part(k % FINE), v as f64 + part(k / FINE)));
        radiance.push((parts.sum::<f64>() / (FINE * FINE) as f64) as f32);
    }
    sensor
        .develop(radiance, width, height, random.bits())
        .unwrap()
}
