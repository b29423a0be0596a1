//! A figure's values go into the page beside its drawing: the page's script draws them anew, zoomed, in part, or in the dark.

use maud::{Markup, PreEscaped, html};
use serde::Serialize;

use super::axis::UNDATED;

/// Axes and tracks of a figure.
#[derive(Clone, Debug, Serialize)]
pub struct Chart {
    /// What files of it are called.
    pub name: String,
    /// Of its drawing, px.
    pub height: f64,
    /// Horizontal axis.
    pub x: Across,
    /// Vertical axis.
    pub y: Upright,
    /// One each that can be switched off.
    pub tracks: Vec<Trace>,
}

/// The horizontal axis.
#[derive(Clone, Debug, Serialize)]
pub struct Across {
    /// With its unit.
    pub label: String,
    /// The values are hours since this moment, ms since 1970; `None`: they are in the label's unit.
    pub zero: Option<i64>,
}

impl Across {
    /// A length or another plain quantity.
    pub fn plain(label: &str) -> Self {
        Self { label: label.to_owned(), zero: None }
    }

    /// Hours since a moment, or by number where it is not known.
    pub fn hours(zero: Option<jiff::Timestamp>) -> Self {
        match zero {
            Some(zero) => Self {
                label: format!("UTC, from {}", zero.strftime("%Y-%m-%d %H:%M")),
                zero: Some(zero.as_millisecond()),
            },
            None => Self::plain(UNDATED),
        }
    }
}

/// The vertical axis.
#[derive(Clone, Debug, Serialize)]
pub struct Upright {
    /// With its unit.
    pub label: String,
    /// It begins at 0 where it is not zoomed.
    pub zero: bool,
}

/// Points that belong together.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Trace {
    /// What its switch says.
    pub name: String,
    /// The series that it is of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series: Option<String>,
    /// `#rrggbb`, on white.
    pub colour: String,
    /// A line goes through the points.
    pub joined: bool,
    /// That line has gaps.
    pub dashed: bool,
    /// The points are drawn on the line, too.
    pub dots: bool,
    /// The points are small and pale.
    pub small: bool,
    /// Abscissa, value, standard deviation.
    pub points: Vec<[Option<f64>; 3]>,
    /// What else is said of each point; may be empty.
    pub texts: Vec<String>,
}

/// A point as it is written: seven digits; `None` for what is not finite.
pub fn point(x: f64, y: f64, sigma: Option<f64>) -> [Option<f64>; 3] {
    [brief(x), brief(y), sigma.and_then(brief)]
}

/// Seven digits; `None` for what is not finite.
pub fn brief(value: f64) -> Option<f64> {
    let text = value.is_finite().then(|| format!("{value:.6e}"))?;
    text.parse().ok()
}

/// As JSON for a script: nothing in it ends the element that holds it.
pub fn json(value: &impl Serialize) -> PreEscaped<String> {
    PreEscaped(serde_json::to_string(value).unwrap_or_default().replace('<', "\\u003c"))
}

impl Chart {
    /// Beside the drawing of the same; `of` names what other figures take from it.
    pub fn values(&self, of: Option<&str>) -> Markup {
        html! { script.chart type="application/json" data-of=[of] { (json(self)) } }
    }
}
