//! The canvas draws lines, ellipses and text on a colour picture; what falls outside is cut off.

use image::{Rgb, RgbImage};
use nalgebra::{Vector2, vector};

use super::super::labels::Area;
use super::font;
use crate::measure::raster::Raster;

/// A picture that is being drawn on.
pub struct Canvas {
    picture: RgbImage,
    /// Width of a line and size of a font's dot, px.
    pub scale: usize,
}

impl Canvas {
    /// The grey frame as background; lines and letters grow with it.
    pub fn new(frame: &Raster) -> Self {
        let (width, height) = (frame.width() as u32, frame.height() as u32);
        let rgb: Vec<u8> = frame.luma().iter().flat_map(|g| [*g, *g, *g]).collect();
        let picture = RgbImage::from_raw(width, height, rgb).unwrap_or_default();
        Self { picture, scale: (frame.width().max(frame.height()) / 1300).max(1) }
    }

    /// The finished picture.
    pub fn finish(self) -> RgbImage {
        self.picture
    }

    /// Width and height, px.
    pub fn size(&self) -> (f64, f64) {
        (f64::from(self.picture.width()), f64::from(self.picture.height()))
    }

    /// A straight line as wide as a font's dot.
    pub fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, colour: Rgb<u8>) {
        let length = (to - from).norm();
        if !length.is_finite() || length > 1e5 {
            return;
        }
        let steps = length.ceil().max(1.0);
        for i in 0..=steps as usize {
            self.dot(from + (to - from) * (i as f64 / steps), colour);
        }
    }

    /// An ellipse: semi-axes px, direction of the major axis rad.
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

    /// A cross with this half-length, px.
    pub fn cross(&mut self, centre: Vector2<f64>, half: f64, colour: Rgb<u8>) {
        self.line(centre - vector![half, 0.0], centre + vector![half, 0.0], colour);
        self.line(centre - vector![0.0, half], centre + vector![0.0, half], colour);
    }

    /// The area of a text with its margin when its top left corner is at (`x`, `y`).
    pub fn text_area(&self, x: f64, y: f64, text: &str) -> Area {
        let s = self.scale as f64;
        let width = text.chars().count() as f64 * (font::WIDTH + 1) as f64 * s;
        Area([x, y, x + width + 3.0 * s, y + (font::HEIGHT + 3) as f64 * s])
    }

    /// Text on a dark ground, within its [`Self::text_area`].
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

    fn dot(&mut self, at: Vector2<f64>, colour: Rgb<u8>) {
        let half = (self.scale as f64 - 1.0) / 2.0;
        let (x, y) = ((at.x - half).round() as i64, (at.y - half).round() as i64);
        let s = self.scale as i64;
        self.fill([x, y, x + s, y + s], colour);
    }

    fn fill(&mut self, area: [i64; 4], colour: Rgb<u8>) {
        let (width, height) = (i64::from(self.picture.width()), i64::from(self.picture.height()));
        for y in area[1].max(0)..area[3].min(height) {
            for x in area[0].max(0)..area[2].min(width) {
                self.picture.put_pixel(x as u32, y as u32, colour);
            }
        }
    }
}
