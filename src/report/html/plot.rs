//! Axes, curves, bands and labels as SVG.

use maud::{Markup, PreEscaped, html};

use super::super::number::format_fixed;
pub use super::axis::{Axis, round_step};

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
        let share = |axis: &Axis, v: f64| axis.fraction(v);
        (left + share(&self.x, x) * width, top + height - share(&self.y, y) * height)
    }

    /// Draws grid, ticks and labels.
    pub fn frame(&self) -> Markup {
        let [left, top, width, height] = self.area;
        let (right, bottom) = (left + width, top + height);
        html! {
            @for (v, text) in self.x.ticks() {
                @let x = self.point_at(v, self.y.low()).0;
                line.grid x1=(px(x)) y1=(px(top)) x2=(px(x)) y2=(px(bottom)) {}
                text.tick x=(px(x)) y=(px(bottom + 16.0)) text-anchor="middle" { (text) }
            }
            @for (v, text) in self.y.ticks() {
                @let y = self.point_at(self.x.low(), v).1;
                line.grid x1=(px(left)) y1=(px(y)) x2=(px(right)) y2=(px(y)) {}
                text.tick x=(px(left - 7.0)) y=(px(y + 3.5)) text-anchor="end" { (text) }
            }
            rect.frame x=(px(left)) y=(px(top)) width=(px(width)) height=(px(height)) {}
            text.label x=(px(left + width / 2.0)) y=(px(bottom + 34.0)) text-anchor="middle" { (self.x.label()) }
            @let (lx, ly) = (left - 46.0, top + height / 2.0);
            text.label x=(px(lx)) y=(px(ly)) text-anchor="middle"
                transform=(format!("rotate(-90 {} {})", px(lx), px(ly))) { (self.y.label()) }
        }
    }

    /// Draws a line through (x, y); points that are not finite are skipped.
    pub fn line(&self, points: &[(f64, f64)], colour: &str, dashed: bool) -> Markup {
        let points = self.point_list(points);
        let dash = dashed.then_some("5 4");
        html! { polyline.curve points=(points) stroke=(colour) stroke-dasharray=[dash] {} }
    }

    /// Draws the area between y - sigma and y + sigma; points without a sigma are skipped.
    pub fn band(&self, points: &[(f64, f64, Option<f64>)], colour: &str) -> Markup {
        let known: Vec<_> = points.iter().filter_map(|(x, y, s)| Some((*x, *y, (*s)?))).collect();
        let upper = known.iter().map(|(x, y, s)| (*x, y + s));
        let lower = known.iter().rev().map(|(x, y, s)| (*x, y - s));
        let outline: Vec<(f64, f64)> = upper.chain(lower).collect();
        html! { polygon.band points=(self.point_list(&outline)) fill=(colour) {} }
    }

    /// Draws a value with its 1-sigma bar.
    pub fn value(&self, x: f64, y: f64, sigma: Option<f64>, colour: &str, title: &str) -> Markup {
        if !(x.is_finite() && y.is_finite()) {
            return html! {};
        }
        let (cx, cy) = self.point_at(x, y);
        let ends = sigma.filter(|s| s.is_finite()).map(|s| (self.point_at(x, y - s).1, self.point_at(x, y + s).1));
        html! {
            @if let Some((low, high)) = ends {
                line.bar x1=(px(cx)) y1=(px(low)) x2=(px(cx)) y2=(px(high)) stroke=(colour) {}
                @for y in [low, high] {
                    line.bar x1=(px(cx - 4.0)) y1=(px(y)) x2=(px(cx + 4.0)) y2=(px(y)) stroke=(colour) {}
                }
            }
            circle cx=(px(cx)) cy=(px(cy)) r="3.4" fill=(colour) { title { (title) } }
        }
    }

    /// Draws a single shot, small and pale.
    pub fn shot(&self, x: f64, y: f64, colour: &str, title: &str) -> Markup {
        if !(x.is_finite() && y.is_finite()) {
            return html! {};
        }
        let (cx, cy) = self.point_at(x, y);
        html! {
            circle.shot cx=(px(cx)) cy=(px(cy)) r="2" stroke=(colour) { title { (title) } }
        }
    }

    fn point_list(&self, points: &[(f64, f64)]) -> String {
        let finite = points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
        let text = finite.map(|(x, y)| {
            let (x, y) = self.point_at(*x, *y);
            format!("{},{}", px(x), px(y))
        });
        text.collect::<Vec<_>>().join(" ")
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
    const STOPS: [[f64; 3]; 5] =
        [[27.0, 45.0, 120.0], [23.0, 95.0, 160.0], [14.0, 112.0, 96.0], [150.0, 90.0, 0.0], [176.0, 48.0, 24.0]];
    let share = if count > 1 { index as f64 / (count - 1) as f64 } else { 0.0 } * 4.0;
    let stop = (share.floor() as usize).min(3);
    let mix = |k: usize| {
        let (a, b) = (STOPS[stop][k], STOPS[stop + 1][k]);
        (a + (b - a) * (share - stop as f64).clamp(0.0, 1.0)).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

/// Moves labels apart: returns heights near the `desired` ones, in their order, at least `gap` from each other, and within
/// `low` to `high` if they fit.
pub fn spread_labels(desired: &[f64], gap: f64, low: f64, high: f64) -> Vec<f64> {
    let mut order: Vec<usize> = (0..desired.len()).collect();
    order.sort_by(|a, b| desired[*a].total_cmp(&desired[*b]));
    let mut placed = desired.to_vec();
    let mut least = low;
    for &i in &order {
        placed[i] = desired[i].max(least);
        least = placed[i] + gap;
    }
    let mut most = high;
    for &i in order.iter().rev() {
        placed[i] = placed[i].min(most);
        most = placed[i] - gap;
    }
    placed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_go_to_the_corners() {
        let unit = || Axis::from_values([0.0, 1.0].into_iter(), "");
        let plot = Plot { area: [10.0, 20.0, 100.0, 50.0], x: unit(), y: unit() };
        assert_eq!(plot.point_at(0.0, 0.0), (10.0, 70.0));
        assert_eq!(plot.point_at(1.0, 1.0), (110.0, 20.0));
        let line = plot.line(&[(0.0, 0.0), (f64::NAN, 1.0), (1.0, 1.0)], "#000", false);
        assert!(line.into_string().contains("points=\"10.0,70.0 110.0,20.0\""));
    }

    #[test]
    fn colours_contrast() {
        let channel = |text: &str| match f64::from(u8::from_str_radix(text, 16).unwrap_or(255)) / 255.0 {
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
    fn labels_keep_their_distance_and_order() {
        let placed = spread_labels(&[10.0, 11.0, 50.0, 9.0], 12.0, 0.0, 60.0);
        assert!(placed[3] + 12.0 <= placed[0] + 1e-9 && placed[0] + 12.0 <= placed[1] + 1e-9);
        assert_eq!(placed[2], 50.0);
        assert!(spread_labels(&[58.0, 59.0], 12.0, 0.0, 60.0).iter().all(|p| *p <= 60.0));
    }

    #[test]
    fn series_have_colours_of_their_own() {
        let all: std::collections::BTreeSet<String> = (0..9).map(|i| series_colour(i, 9)).collect();
        assert_eq!(all.len(), 9);
        assert_eq!(series_colour(0, 1).len(), 7);
    }
}
