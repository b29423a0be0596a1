//! Mask of the pixels that show other objects than a marker.

use nalgebra::Vector2;

use crate::detect::image::scanline::PixelBox;

/// Excluded pixels of a box.
#[derive(Debug, PartialEq)]
pub struct PixelMask {
    area: PixelBox,
    /// Margin around an object that is excluded as well, px.
    margin: usize,
    marks: Option<Vec<bool>>,
}

impl PixelMask {
    /// Creates a mask of a box without excluded pixels.
    pub fn new(area: PixelBox, margin: usize) -> Self {
        Self {
            area,
            margin,
            marks: None,
        }
    }

    /// Marks the pixels near a run.
    pub fn mark_run(&mut self, y: usize, from: usize, to: usize) {
        let [x0, y0, x1, y1] = self.area;
        let width = x1 - x0 + 1;
        let marks = self
            .marks
            .get_or_insert_with(|| vec![false; width * (y1 - y0 + 1)]);
        let margin = self.margin;
        let (from, to) = (from.saturating_sub(margin).max(x0), (to + margin).min(x1));
        for row in y.saturating_sub(margin).max(y0)..=(y + margin).min(y1) {
            if from <= to {
                marks[(row - y0) * width + from - x0..=(row - y0) * width + to - x0].fill(true);
            }
        }
    }

    /// Returns whether the pixel at a position is excluded.
    pub fn contains(&self, at: &Vector2<f64>) -> bool {
        let [x0, y0, x1, y1] = self.area.map(|v| v as f64);
        let at = at.map(f64::round);
        let place = || ((at.y - y0) * (x1 - x0 + 1.0) + at.x - x0) as usize;
        (x0..=x1).contains(&at.x)
            && (y0..=y1).contains(&at.y)
            && self
                .marks
                .as_ref()
                .is_some_and(|marks| marks.get(place()) == Some(&true))
    }

    /// Returns the mark of each pixel of the box; `None` if no pixel is excluded.
    pub fn into_marks(self) -> Option<Vec<bool>> {
        self.marks
    }
}
