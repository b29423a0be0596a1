//! This file draws axes, curves, bands and labels as SVG.

use maud::{Markup, PreEscaped, html};

use super::super::number::fixed;

/// A linear axis with round ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    low: f64,
    high: f64,
    step: f64,
    label: String,
    /// The texts have the other sign.
    turned: bool,
    /// The values are hours since this moment, the texts times of day.
    clock: Option<jiff::Timestamp>,
}

impl Axis {
    /// Covers all the finite values, with `label` beside it. Without values 0 to 1.
    pub fn over(values: impl Iterator<Item = f64>, label: &str) -> Self {
        let range = values.filter(|v| v.is_finite()).fold(None, |range, v| {
            let (low, high): (f64, f64) = range.unwrap_or((v, v));
            Some((low.min(v), high.max(v)))
        });
        let (low, high) = range.unwrap_or((0.0, 1.0));
        let width = if high - low > 1e-9 * (1.0 + high.abs()) { high - low } else { 1.0 };
        let step = round_step(width / 6.0);
        // A band that reaches over a tick by a hair does not open another interval.
        let (low, high) = ((low / step + 0.04).floor() * step, (high / step - 0.04).ceil() * step);
        let high = if high > low { high } else { low + step };
        Self { low, high, step, label: label.to_owned(), turned: false, clock: None }
    }

    /// From tick to tick around `low` to `high`.
    pub fn between(low: f64, high: f64, step: f64, label: &str) -> Self {
        let (low, high) = ((low / step).floor() * step, (high / step).ceil() * step);
        Self {
            low,
            high: if high > low { high } else { low + step },
            step,
            label: label.to_owned(),
            turned: false,
            clock: None,
        }
    }

    /// Covers hours since `zero`, with times of day (UTC) at its ticks.
    pub fn over_hours(hours: impl Iterator<Item = f64>, zero: Option<jiff::Timestamp>) -> Self {
        let Some(zero) = zero else { return Self::over(hours, "time since the first series / h") };
        let label = format!("UTC, from {}", zero.strftime("%Y-%m-%d %H:%M"));
        // Ticks stand at whole minutes: a finer axis has its hours in decimals.
        let axis = Self::over(hours, &label);
        if axis.step < 1.0 / 60.0 {
            return Self { label: format!("time since {} UTC / h", zero.strftime("%Y-%m-%d %H:%M")), ..axis };
        }
        Self { clock: Some(zero), ..axis }
    }

    /// The same axis for values with the other sign: what it shows grows downwards or leftwards.
    pub fn turned(self) -> Self {
        Self { low: -self.high, high: -self.low, turned: !self.turned, ..self }
    }

    /// Its length in the data's unit.
    pub fn width(&self) -> f64 {
        self.high - self.low
    }

    #[cfg(test)]
    fn range(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// Positions of the ticks and their texts.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        let n = ((self.high - self.low) / self.step).round() as usize;
        let decimals = (-self.step.log10().floor()).clamp(0.0, 9.0) as usize;
        let tick = |i: usize| self.low + i as f64 * self.step;
        let sign = if self.turned { -1.0 } else { 1.0 };
        let time = |hours: f64| {
            let moment = self.clock?.checked_add(jiff::SignedDuration::from_secs_f64(3600.0 * hours)).ok()?;
            Some(moment.strftime("%H:%M").to_string())
        };
        let text = |v: f64| time(v).unwrap_or_else(|| fixed(Some(sign * v), decimals));
        (0..=n.min(60)).map(|i| (tick(i), text(tick(i)))).collect()
    }
}

/// 1, 2 or 5 times a power of ten, not below `raw`.
pub fn round_step(raw: f64) -> f64 {
    let decade = 10f64.powf(raw.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|f| f * decade).find(|s| *s >= raw * 0.999).unwrap_or(10.0 * decade)
}

/// A rectangle of the drawing with two axes.
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
    /// From data to the drawing; y grows upwards in the data, downwards in the drawing.
    pub fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let [left, top, width, height] = self.area;
        let share = |axis: &Axis, v: f64| (v - axis.low) / (axis.high - axis.low);
        (left + share(&self.x, x) * width, top + height - share(&self.y, y) * height)
    }

    /// Grid, ticks and labels.
    pub fn frame(&self) -> Markup {
        let [left, top, width, height] = self.area;
        let (right, bottom) = (left + width, top + height);
        html! {
            @for (v, text) in self.x.ticks() {
                @let x = self.at(v, self.y.low).0;
                line.grid x1=(px(x)) y1=(px(top)) x2=(px(x)) y2=(px(bottom)) {}
                text.tick x=(px(x)) y=(px(bottom + 16.0)) text-anchor="middle" { (text) }
            }
            @for (v, text) in self.y.ticks() {
                @let y = self.at(self.x.low, v).1;
                line.grid x1=(px(left)) y1=(px(y)) x2=(px(right)) y2=(px(y)) {}
                text.tick x=(px(left - 7.0)) y=(px(y + 3.5)) text-anchor="end" { (text) }
            }
            rect.frame x=(px(left)) y=(px(top)) width=(px(width)) height=(px(height)) {}
            text.label x=(px(left + width / 2.0)) y=(px(bottom + 34.0)) text-anchor="middle" { (self.x.label) }
            @let (lx, ly) = (left - 46.0, top + height / 2.0);
            text.label x=(px(lx)) y=(px(ly)) text-anchor="middle"
                transform=(format!("rotate(-90 {} {})", px(lx), px(ly))) { (self.y.label) }
        }
    }

    /// A line through (x, y); points that are not finite are left out.
    pub fn line(&self, points: &[(f64, f64)], colour: &str, dashed: bool) -> Markup {
        let points = self.joined(points);
        let dash = dashed.then_some("5 4");
        html! { polyline.curve points=(points) stroke=(colour) stroke-dasharray=[dash] {} }
    }

    /// The area between y - sigma and y + sigma; points without a sigma are left out.
    pub fn band(&self, points: &[(f64, f64, Option<f64>)], colour: &str) -> Markup {
        let known: Vec<_> = points.iter().filter_map(|(x, y, s)| Some((*x, *y, (*s)?))).collect();
        let upper = known.iter().map(|(x, y, s)| (*x, y + s));
        let lower = known.iter().rev().map(|(x, y, s)| (*x, y - s));
        let outline: Vec<(f64, f64)> = upper.chain(lower).collect();
        html! { polygon.band points=(self.joined(&outline)) fill=(colour) {} }
    }

    /// A value with its 1-sigma bar.
    pub fn value(&self, x: f64, y: f64, sigma: Option<f64>, colour: &str, title: &str) -> Markup {
        if !(x.is_finite() && y.is_finite()) {
            return html! {};
        }
        let (cx, cy) = self.at(x, y);
        let ends = sigma.filter(|s| s.is_finite()).map(|s| (self.at(x, y - s).1, self.at(x, y + s).1));
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

    /// A single shot: small and pale.
    pub fn shot(&self, x: f64, y: f64, colour: &str, title: &str) -> Markup {
        if !(x.is_finite() && y.is_finite()) {
            return html! {};
        }
        let (cx, cy) = self.at(x, y);
        html! {
            circle.shot cx=(px(cx)) cy=(px(cy)) r="2" stroke=(colour) { title { (title) } }
        }
    }

    fn joined(&self, points: &[(f64, f64)]) -> String {
        let finite = points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
        let text = finite.map(|(x, y)| {
            let (x, y) = self.at(*x, *y);
            format!("{},{}", px(x), px(y))
        });
        text.collect::<Vec<_>>().join(" ")
    }
}

/// A drawing that scales with the page.
pub fn drawing(width: f64, height: f64, name: &str, content: &Markup) -> Markup {
    html! {
        svg viewBox=(format!("0 0 {} {}", px(width), px(height))) role="img" aria-label=(name) {
            (PreEscaped(&content.0))
        }
    }
}

/// A length of the drawing, to a tenth.
pub fn px(value: f64) -> String {
    fixed(Some(value.clamp(-1e6, 1e6)), 1)
}

/// Colours from dark blue over teal to orange, for `count` series in order of time; each has a contrast
/// of 4.5 and more against white.
pub fn series_colour(index: usize, count: usize) -> String {
    const STOPS: [[f64; 3]; 5] = [
        [27.0, 45.0, 120.0],
        [23.0, 95.0, 160.0],
        [14.0, 112.0, 96.0],
        [150.0, 90.0, 0.0],
        [176.0, 48.0, 24.0],
    ];
    let share = if count > 1 { index as f64 / (count - 1) as f64 } else { 0.0 } * 4.0;
    let stop = (share.floor() as usize).min(3);
    let mix = |k: usize| {
        let (a, b) = (STOPS[stop][k], STOPS[stop + 1][k]);
        (a + (b - a) * (share - stop as f64).clamp(0.0, 1.0)).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

/// Moves labels apart: the heights wanted, at least `gap` from each other, in their order, and
/// within `low` to `high` where they fit.
pub fn set_apart(wanted: &[f64], gap: f64, low: f64, high: f64) -> Vec<f64> {
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    order.sort_by(|a, b| wanted[*a].total_cmp(&wanted[*b]));
    let mut placed = wanted.to_vec();
    let mut least = low;
    for &i in &order {
        placed[i] = wanted[i].max(least);
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
    fn ticks_are_round_and_cover_the_data() {
        let axis = Axis::over([0.02, 2.93].into_iter(), "lift / m");
        assert_eq!(axis.range(), (0.0, 3.0));
        let texts: Vec<String> = axis.ticks().into_iter().map(|t| t.1).collect();
        assert_eq!(texts, ["0.0", "0.5", "1.0", "1.5", "2.0", "2.5", "3.0"]);
    }

    #[test]
    fn odd_data_still_give_an_axis() {
        for values in [vec![], vec![f64::NAN], vec![7.0], vec![-3e5, f64::INFINITY, 1e-9]] {
            let axis = Axis::over(values.iter().copied(), "");
            let (low, high) = axis.range();
            assert!(low < high && axis.ticks().len() >= 2, "{values:?}: {axis:?}");
        }
    }

    #[test]
    fn data_go_to_the_corners() {
        let unit = || Axis::over([0.0, 1.0].into_iter(), "");
        let plot = Plot { area: [10.0, 20.0, 100.0, 50.0], x: unit(), y: unit() };
        assert_eq!(plot.at(0.0, 0.0), (10.0, 70.0));
        assert_eq!(plot.at(1.0, 1.0), (110.0, 20.0));
        let line = plot.line(&[(0.0, 0.0), (f64::NAN, 1.0), (1.0, 1.0)], "#000", false);
        assert!(line.into_string().contains("points=\"10.0,70.0 110.0,20.0\""));
    }

    #[test]
    fn hours_have_times_of_day_and_colours_contrast() {
        let zero = "2026-03-01T08:30:00Z".parse().ok();
        let ticks = Axis::over_hours([0.0, 6.0].into_iter(), zero).ticks();
        assert_eq!((ticks[0].1.as_str(), ticks[1].1.as_str()), ("08:30", "09:30"));
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
        let placed = set_apart(&[10.0, 11.0, 50.0, 9.0], 12.0, 0.0, 60.0);
        assert!(placed[3] + 12.0 <= placed[0] + 1e-9 && placed[0] + 12.0 <= placed[1] + 1e-9);
        assert_eq!(placed[2], 50.0);
        assert!(set_apart(&[58.0, 59.0], 12.0, 0.0, 60.0).iter().all(|p| *p <= 60.0));
    }

    #[test]
    fn series_have_colours_of_their_own() {
        let all: std::collections::BTreeSet<String> = (0..9).map(|i| series_colour(i, 9)).collect();
        assert_eq!(all.len(), 9);
        assert_eq!(series_colour(0, 1).len(), 7);
    }
}
