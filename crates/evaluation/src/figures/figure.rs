//! Figures of the report and of the pages of the server.
//!
//! A figure is drawn here, once. Ticks and labels are at fractions of its width, and its tracks are in the units of the data,
//! so it fits a phone, a desk and paper. The script of a page reads the values of the tracks, changes the range shown, and
//! replaces the points of a track.

use maud::{Markup, PreEscaped, html};
use serde::Serialize;

use super::plot::{Axis, draw_ticks};

/// Figure of tracks over a common abscissa.
pub struct Figure {
    /// Name, also of saved files.
    pub name: String,
    /// Largest height of the plotting area, px.
    pub height: f64,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Tracks, which can be shown or hidden one by one.
    pub tracks: Vec<FigureTrack>,
}

/// Colour of the first quantity of a figure.
pub const MAIN_COLOUR: &str = "#17456f";

/// Abscissa, value and standard deviation of a point.
pub type FigurePoint = (f64, f64, Option<f64>);

/// Points of a figure that belong together.
#[derive(Clone, Debug, Default)]
pub struct FigureTrack {
    /// Name in the legend.
    pub name: String,
    /// Colour on white, `#rrggbb`.
    pub colour: String,
    /// Style of its points.
    pub style: TrackStyle,
    /// The line is dashed.
    pub dashed: bool,
    /// Hidden until the reader chooses it in the legend.
    pub hidden: bool,
    /// Points; one that is not finite ends a line.
    pub points: Vec<FigurePoint>,
    /// Additional text of each point; may be empty.
    pub texts: Vec<String>,
    /// Class of the drawn track in the style sheet of its page.
    pub class: &'static str,
}

/// Style of the points of a track. A line has a band of 1 sigma, a dot a bar of 1 sigma.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrackStyle {
    /// Points joined by a line.
    #[default]
    Line,
    /// Line and dots.
    DottedLine,
    /// Dots.
    Dots,
    /// Small, pale dots.
    SmallDots,
}

impl Figure {
    /// Draws the figure, with a legend if it has several tracks.
    pub fn draw(&self) -> Markup {
        let ((left, right), (bottom, top)) = (self.x.range(), self.y.range());
        html! {
            div.plot {
                svg.figure role="img" aria-label=(self.name) style=(format!("--height:{}px", self.height))
                    data-x=(self.x.to_json()) data-y=(self.y.to_json()) {
                    (draw_ticks(&self.x, &self.y))
                    svg.area width="100%" height="100%" preserveAspectRatio="none" overflow="visible"
                        viewBox=(format!("{left:?} {:?} {:?} {:?}", -top, right - left, top - bottom)) {
                        g transform="scale(1 -1)" {
                            @for (index, track) in self.tracks.iter().enumerate() { (track.draw(index)) }
                        }
                    }
                    rect.frame width="100%" height="100%" {}
                    text.label x="50%" y="100%" dy="34" text-anchor="middle" { (self.x.label()) }
                    text.label dx="-50" dy="-10" { (self.y.label()) }
                }
            }
            @if self.tracks.len() > 1 {
                ul.legend.long[self.tracks.len() > 12] {
                    @for track in &self.tracks { li { button type="button" disabled {
                        i class=(track.style.class()) style=(format!("--colour:{}", track.colour)) {}
                        (track.name)
                    } } }
                }
            }
        }
    }
}

/// Returns the abscissas of all points.
pub fn all_abscissas(tracks: &[FigureTrack]) -> impl Iterator<Item = f64> {
    tracks
        .iter()
        .flat_map(|track| &track.points)
        .map(|point| point.0)
}

/// Returns the values of all points, less and plus their standard deviations.
pub fn all_values(tracks: &[FigureTrack]) -> impl Iterator<Item = f64> {
    let ends = |(_, y, sigma): &FigurePoint| [y - sigma.unwrap_or(0.0), y + sigma.unwrap_or(0.0)];
    tracks.iter().flat_map(|track| &track.points).flat_map(ends)
}

impl TrackStyle {
    fn class(self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::DottedLine | Self::Dots => "dot",
            Self::SmallDots => "dot small",
        }
    }
}

impl FigureTrack {
    /// Creates a line through points.
    pub fn from_points(
        name: impl Into<String>,
        colour: impl Into<String>,
        points: Vec<FigurePoint>,
    ) -> Self {
        Self {
            name: name.into(),
            colour: colour.into(),
            points,
            ..Self::default()
        }
    }

    fn draw(&self, index: usize) -> Markup {
        let points: Vec<FigurePoint> = self.points.iter().copied().map(rounded_point).collect();
        let [line, band, bars, dots, lone] = path_data(&points);
        let joined = matches!(self.style, TrackStyle::Line | TrackStyle::DottedLine);
        let dotted = self.style != TrackStyle::Line;
        let texts = (!self.texts.is_empty())
            .then(|| serde_json::to_string(&self.texts).unwrap_or_default());
        html! {
            g class=(self.class) hidden[self.hidden] data-track=(index) data-name=(self.name) data-texts=[texts]
                data-points=(serde_json::to_string(&points).unwrap_or_default()) stroke=(self.colour) fill=(self.colour) {
                @if joined {
                    path.band d=(band) {}
                    path.curve d=(line) stroke-dasharray=[self.dashed.then_some("5 4")] {}
                }
                @if !dotted { path.lone d=(lone) {} }
                @if dotted {
                    path.bar d=(bars) {}
                    path class=(self.style.class()) d=(dots) {}
                }
            }
        }
    }
}

/// Returns the path data of the line, the band, the bars, the dots and the single points of a track, in the units of the data.
/// A point that is not finite ends a line.
fn path_data(points: &[FigurePoint]) -> [String; 5] {
    let short = |value: f64| format!("{value:.5e}").parse().unwrap_or(value);
    let at = |x: f64, y: f64| format!("{:?},{:?}", short(x), short(y));
    let [mut line, mut band, mut bars, mut dots, mut lone] = [const { String::new() }; 5];
    for run in points
        .split(|p| !(p.0.is_finite() && p.1.is_finite()))
        .filter(|run| !run.is_empty())
    {
        let run_points: Vec<String> = run.iter().map(|(x, y, _)| at(*x, *y)).collect();
        let known: Vec<_> = run
            .iter()
            .filter_map(|(x, y, s)| Some((*x, *y, (*s)?)))
            .collect();
        let upper = known.iter().map(|(x, y, s)| at(*x, y + s));
        let outline: Vec<String> = upper
            .chain(known.iter().rev().map(|(x, y, s)| at(*x, y - s)))
            .collect();
        line.push_str(&format!("M{}h0", run_points.join(" ")));
        band.push_str(&if known.len() > 1 {
            format!("M{}Z", outline.join(" "))
        } else {
            String::new()
        });
        bars.extend(
            known
                .iter()
                .map(|(x, y, s)| format!("M{} {}", at(*x, y - s), at(*x, y + s))),
        );
        let run_dots: String = run_points
            .iter()
            .map(|point| format!("M{point}h0"))
            .collect();
        dots.push_str(&run_dots);
        // A single point makes no line.
        lone.push_str(if run.len() == 1 { &run_dots } else { "" });
    }
    [line, band, bars, dots, lone]
}

/// Point that ends a line.
pub const BREAK: FigurePoint = (f64::NAN, f64::NAN, None);

/// Rounds a point to seven digits.
pub fn rounded_point((x, y, sigma): FigurePoint) -> FigurePoint {
    let round = |value: f64| format!("{value:.6e}").parse().unwrap_or(f64::NAN);
    (
        round(x),
        round(y),
        sigma.filter(|s| s.is_finite()).map(round),
    )
}

/// Formats a value as JSON for a script element, which its text cannot end.
pub fn script_json(value: &impl Serialize) -> PreEscaped<String> {
    PreEscaped(
        serde_json::to_string(value)
            .unwrap_or_default()
            .replace('<', "\\u003c"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_has_line_band_bars_and_dots_of_its_finite_points() {
        let points = [
            (0.0, 1.0, Some(0.5)),
            (1.0, 2.0, Some(0.25)),
            BREAK,
            (2.0, 3.0, None),
        ];
        let [line, band, bars, dots, lone] = path_data(&points);
        assert_eq!(line, "M0.0,1.0 1.0,2.0h0M2.0,3.0h0");
        assert_eq!(band, "M0.0,1.5 1.0,2.25 1.0,1.75 0.0,0.5Z");
        assert_eq!(bars, "M0.0,0.5 0.0,1.5M1.0,1.75 1.0,2.25");
        assert_eq!(dots, "M0.0,1.0h0M1.0,2.0h0M2.0,3.0h0");
        assert_eq!(lone, "M2.0,3.0h0");
        assert_eq!(path_data(&[]), [const { String::new() }; 5]);
    }
}
