//! Axes and curves as SVG, at fixed places of a drawing.

use maud::{Markup, PreEscaped, html};
use nalgebra::{Vector2, vector};

use super::super::number::format_fixed;
pub use super::axis::{Axis, round_step};
use crate::figures::labels::{LabelArea, LabelLayout, leader_line};

/// Rectangle of the drawing with two axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// Left, top, width and height of the plotting area.
    pub area: [f64; 4],
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
}

impl Plot {
    /// Maps a data point to the drawing; y increases upwards in the data, downwards in the drawing.
    pub fn point_at(&self, x: f64, y: f64) -> (f64, f64) {
        let [left, top, width, height] = self.area;
        (
            left + self.x.fraction(x) * width,
            top + height - self.y.fraction(y) * height,
        )
    }

    /// Draws grid, ticks and labels.
    pub fn frame(&self) -> Markup {
        let [left, top, width, height] = self.area;
        let (across, down) = (
            |share: f64| px(left + share * width),
            |share: f64| px(top + share * height),
        );
        html! {
            (draw_ticks(&self.x, &self.y, across, down))
            rect.frame x=(px(left)) y=(px(top)) width=(px(width)) height=(px(height)) {}
            text.label x=(across(0.5)) y=(down(1.0)) dy="34" text-anchor="middle" { (self.x.label()) }
            @let (lx, ly) = (px(left - 46.0), down(0.5));
            text.label x=(lx) y=(ly) text-anchor="middle" transform=(format!("rotate(-90 {lx} {ly})")) { (self.y.label()) }
        }
    }

    /// Draws a line through (x, y); points that are not finite are skipped.
    pub fn line(&self, points: &[(f64, f64)], colour: &str, dashed: bool) -> Markup {
        let finite = points
            .iter()
            .filter(|(x, y)| x.is_finite() && y.is_finite());
        let text = finite.map(|(x, y)| {
            let (x, y) = self.point_at(*x, *y);
            format!("{},{}", px(x), px(y))
        });
        let points = text.collect::<Vec<_>>().join(" ");
        html! { polyline.curve points=(points) stroke=(colour) stroke-dasharray=[dashed.then_some("5 4")] {} }
    }
}

/// Draws grid lines and tick texts. `across` and `down` return the coordinates of a fraction of width and height, from the
/// top left.
pub fn draw_ticks(
    x: &Axis,
    y: &Axis,
    across: impl Fn(f64) -> String,
    down: impl Fn(f64) -> String,
) -> Markup {
    html! {
        g {
            @for (k, (v, text)) in x.ticks().into_iter().enumerate() {
                @let at = across(x.fraction(v));
                g.odd[k % 2 == 1] {
                    line.grid x1=(at) y1=(down(0.0)) x2=(at) y2=(down(1.0)) {}
                    text.tick x=(at) y=(down(1.0)) dy="16" text-anchor="middle" { (text) }
                }
            }
        }
        g {
            @for (v, text) in y.ticks() {
                @let at = down(1.0 - y.fraction(v));
                line.grid x1=(across(0.0)) y1=(at) x2=(across(1.0)) y2=(at) {}
                text.tick x=(across(0.0)) y=(at) dx="-7" dy="3.5" text-anchor="end" { (text) }
            }
        }
    }
}

/// Object of a drawing with its name.
pub struct NamedSpot {
    /// Centre.
    pub at: Vector2<f64>,
    /// Half width and half height.
    pub half: Vector2<f64>,
    /// Name.
    pub name: String,
    /// Colour of the name and of the line to it.
    pub colour: &'static str,
}

/// Draws the names of objects next to them, without overlap and within `bounds` (left, top, right, bottom); a name without
/// room is omitted. `plate`: opacity of the dark ground of the names.
pub fn draw_names(spots: &[NamedSpot], bounds: [f64; 4], letter: f64, plate: f64) -> Markup {
    let mut labels = LabelLayout::new(LabelArea(bounds));
    for NamedSpot { at, half, .. } in spots {
        labels.occupy(LabelArea([
            at.x - half.x,
            at.y - half.y,
            at.x + half.x,
            at.y + half.y,
        ]));
    }
    let size = |name: &str| {
        vector![
            name.chars().count() as f64 * letter * 0.66 + letter * 0.3,
            letter * 1.15
        ]
    };
    html! {
        @for NamedSpot { at, half, name, colour } in spots {
            @let size = size(name);
            @if let Some(place) = labels.place(*at, *half, size, letter * 0.3) {
                @let [from, to] = leader_line(*at, *half, place, size);
                line x1=(px(from.x)) y1=(px(from.y)) x2=(px(to.x)) y2=(px(to.y)) stroke=(colour) stroke-width=(px(letter / 12.0)) {}
                rect x=(px(place.x)) y=(px(place.y)) width=(px(size.x)) height=(px(size.y)) fill="#10141c" fill-opacity=(plate) {}
                text x=(px(place.x + letter * 0.15)) y=(px(place.y + letter * 0.93)) fill=(colour) stroke="none"
                    font-size=(px(letter)) font-family="sans-serif" { (name) }
            }
        }
    }
}

/// Builds a drawing that scales with the page.
pub fn svg_drawing(width: f64, height: f64, name: &str, content: &Markup) -> Markup {
    html! {
        svg viewBox=(format!("0 0 {} {}", px(width), px(height))) role="img" aria-label=(name) {
            (PreEscaped(&content.0))
        }
    }
}

/// Formats a length of the drawing with one decimal.
pub fn px(value: f64) -> String {
    format_fixed(Some(value.clamp(-1e6, 1e6)), 1)
}

/// Returns a colour from dark blue over teal to orange, for `count` series in order of time, with a contrast of at least
/// 4.5 to white.
pub fn series_colour(index: usize, count: usize) -> String {
    const STOPS: [[f64; 3]; 5] = [
        [27.0, 45.0, 120.0],
        [23.0, 95.0, 160.0],
        [14.0, 112.0, 96.0],
        [150.0, 90.0, 0.0],
        [176.0, 48.0, 24.0],
    ];
    let share = if count > 1 {
        index as f64 / (count - 1) as f64
    } else {
        0.0
    } * 4.0;
    let stop = (share.floor() as usize).min(3);
    let mix = |k: usize| {
        let (a, b) = (STOPS[stop][k], STOPS[stop + 1][k]);
        (a + (b - a) * (share - stop as f64).clamp(0.0, 1.0)).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_go_to_the_corners() {
        let unit = || Axis::from_values([0.0, 1.0].into_iter(), "");
        let plot = Plot {
            area: [10.0, 20.0, 100.0, 50.0],
            x: unit(),
            y: unit(),
        };
        assert_eq!(plot.point_at(0.0, 0.0), (10.0, 70.0));
        assert_eq!(plot.point_at(1.0, 1.0), (110.0, 20.0));
        let line = plot.line(&[(0.0, 0.0), (f64::NAN, 1.0), (1.0, 1.0)], "#000", false);
        assert!(
            line.into_string()
                .contains("points=\"10.0,70.0 110.0,20.0\"")
        );
    }

    #[test]
    fn colours_contrast() {
        let channel =
            |text: &str| match f64::from(u8::from_str_radix(text, 16).unwrap_or(255)) / 255.0 {
                v if v <= 0.04045 => v / 12.92,
                v => ((v + 0.055) / 1.055).powf(2.4),
            };
        for colour in (0..40).map(|i| series_colour(i, 40)) {
            let [r, g, b] = [1, 3, 5].map(|k| channel(&colour[k..k + 2]));
            let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
            assert!(1.05 / (luminance + 0.05) >= 4.5, "{colour}");
        }
    }

    #[test]
    fn series_have_colours_of_their_own() {
        let all: std::collections::BTreeSet<String> = (0..9).map(|i| series_colour(i, 9)).collect();
        assert_eq!(all.len(), 9);
        assert_eq!(series_colour(0, 1).len(), 7);
    }
}
