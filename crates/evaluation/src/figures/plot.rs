//! Ticks of axes, names of objects and colours, as SVG.

use maud::{Markup, html};
use nalgebra::{Vector2, vector};

use super::super::number::format_fixed;
pub use super::axis::{Axis, round_step};
use crate::figures::labels::{LabelArea, LabelLayout, leader_line};

/// Draws grid lines and tick texts at fractions of the width and the height.
pub fn draw_ticks(x: &Axis, y: &Axis) -> Markup {
    let at_share = |share: f64| format!("{}%", format_fixed(Some(100.0 * share), 3));
    html! {
        g {
            @for (k, (v, text)) in x.ticks().into_iter().enumerate() {
                @let at = at_share(x.fraction(v));
                g.odd[k % 2 == 1] {
                    line.grid x1=(at) y1="0%" x2=(at) y2="100%" {}
                    text.tick x=(at) y="100%" dy="16" text-anchor="middle" { (text) }
                }
            }
        }
        g {
            @for (v, text) in y.ticks() {
                @let at = at_share(1.0 - y.fraction(v));
                line.grid x1="0%" y1=(at) x2="100%" y2=(at) {}
                text.tick x="0%" y=(at) dx="-7" dy="3.5" text-anchor="end" { (text) }
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
