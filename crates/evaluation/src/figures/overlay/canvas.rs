//! Canvas for lines, ellipses and text on a colour image, clipped at its edges.

use image::{Rgb, RgbImage};
use nalgebra::{Vector2, vector};

use super::super::labels::LabelArea;
use super::font;
use wingd_measure::raster::Raster;

/// Image being drawn on.
pub struct Canvas {
    picture: RgbImage,
    /// Width of a line and size of a font dot, px.
    pub scale: usize,
}

impl Canvas {
    /// Creates a canvas with the grey frame as background; lines and letters scale with its size.
    pub fn new(frame: &Raster) -> Self {
        let (width, height) = (frame.width() as u32, frame.height() as u32);
        let rgb: Vec<u8> = frame.luma().iter().flat_map(|g| [*g, *g, *g]).collect();
        let picture = RgbImage::from_raw(width, height, rgb).unwrap_or_default();
        Self {
            picture,
            scale: (frame.width().max(frame.height()) / 1300).max(1),
        }
    }

    /// Returns the finished image.
    pub fn finish(self) -> RgbImage {
        self.picture
    }

    /// Returns width and height, px.
    pub fn size(&self) -> (f64, f64) {
        (
            f64::from(self.picture.width()),
            f64::from(self.picture.height()),
        )
    }

    /// Draws a straight line of the width of a font dot.
    pub fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, colour: Rgb<u8>) {
        let length = (to - from).norm();
        if !length.is_finite() || length > 1e5 {
            return;
        }
        let steps = length.ceil().max(1.0);
        for i in 0..=steps as usize {
            self.fill_square(from + (to - from) * (i as f64 / steps), colour);
        }
    }

    /// Draws an ellipse: semi-axes px, direction of the major axis rad.
    pub fn ellipse(&mut self, centre: Vector2<f64>, semi: [f64; 2], angle: f64, colour: Rgb<u8>) {
        let corners = (semi[0].abs().clamp(1.0, 1e4) * 2.0).sqrt().ceil() * 8.0;
        let (sin, cos) = angle.sin_cos();
        let point = |i: usize| {
            let (y, x) = (std::f64::consts::TAU * i as f64 / corners).sin_cos();
            let (x, y) = (semi[0] * x, semi[1] * y);
            centre + vector![cos * x - sin * y, sin * x + cos * y]
        };
        for i in 0..corners as usize {
            self.line(point(i), point(i + 1), colour);
        }
    }

    /// Draws a cross with this half-length, px.
    pub fn cross(&mut self, centre: Vector2<f64>, half: f64, colour: Rgb<u8>) {
        self.line(
            centre - vector![half, 0.0],
            centre + vector![half, 0.0],
            colour,
        );
        self.line(
            centre - vector![0.0, half],
            centre + vector![0.0, half],
            colour,
        );
    }

    /// Returns the area of a text, margin included, with its top left corner at (`x`, `y`).
    pub fn text_area(&self, x: f64, y: f64, text: &str) -> LabelArea {
        let s = self.scale as f64;
        let width = text.chars().count() as f64 * (font::WIDTH + 1) as f64 * s;
        LabelArea([x, y, x + width + 3.0 * s, y + (font::HEIGHT + 3) as f64 * s])
    }

    /// Draws text on a dark background, within its [`Self::text_area`].
    pub fn text(&mut self, x: f64, y: f64, text: &str, colour: Rgb<u8>) {
        let s = self.scale as i64;
        let area = self.text_area(x, y, text).0.map(|v| v.round() as i64);
        self.fill(area, Rgb([16, 18, 24]));
        for (i, character) in text.chars().enumerate() {
            let left = area[0] + 2 * s + i as i64 * (font::WIDTH as i64 + 1) * s;
            self.glyph(left, area[1] + 2 * s, character, colour);
        }
    }

    fn glyph(&mut self, left: i64, top: i64, character: char, colour: Rgb<u8>) {
        let s = self.scale as i64;
        for (column, bits) in font::glyph(character).iter().enumerate() {
            for row in (0..font::HEIGHT as i64).filter(|r| bits >> r & 1 == 1) {
                let (x, y) = (left + column as i64 * s, top + row * s);
                self.fill([x, y, x + s, y + s], colour);
            }
        }
    }

    /// Fills the square of one scaled pixel around a position.
    fn fill_square(&mut self, at: Vector2<f64>, colour: Rgb<u8>) {
        let half = (self.scale as f64 - 1.0) / 2.0;
        let (x, y) = ((at.x - half).round() as i64, (at.y - half).round() as i64);
        let s = self.scale as i64;
        self.fill([x, y, x + s, y + s], colour);
    }

    fn fill(&mut self, area: [i64; 4], colour: Rgb<u8>) {
        let (width, height) = (
            i64::from(self.picture.width()),
            i64::from(self.picture.height()),
        );
        for y in area[1].max(0)..area[3].min(height) {
            for x in area[0].max(0)..area[2].min(width) {
                self.picture.put_pixel(x as u32, y as u32, colour);
            }
        }
    }
}
