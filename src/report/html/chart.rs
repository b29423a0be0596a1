//! Data of a figure, embedded next to its drawing: the script of the page redraws it zoomed, with selected tracks, or in
//! dark mode.

use maud::{Markup, PreEscaped, html};
use serde::Serialize;

use super::axis::UNDATED_LABEL;

/// Axes and tracks of a figure.
#[derive(Clone, Debug, Serialize)]
pub struct Chart {
    /// Name, also of saved files.
    pub name: String,
    /// Height of the drawing, px.
    pub height: f64,
    /// Horizontal axis.
    pub x: HorizontalAxis,
    /// Vertical axis.
    pub y: VerticalAxis,
    /// Tracks, which can be shown or hidden one by one.
    pub tracks: Vec<Trace>,
}

/// Horizontal axis of a chart.
#[derive(Clone, Debug, Serialize)]
pub struct HorizontalAxis {
    /// Label, with the unit.
    pub label: String,
    /// Start time if the values are hours, ms since 1970; `None` if they are in the unit of the label.
    pub zero: Option<i64>,
}

impl HorizontalAxis {
    /// Creates the axis of a length or another plain quantity.
    pub fn from_label(label: &str) -> Self {
        Self { label: label.to_owned(), zero: None }
    }

    /// Creates the axis of hours since a start time; of series numbers if it is unknown.
    pub fn from_start_time(zero: Option<jiff::Timestamp>) -> Self {
        match zero {
            Some(zero) => Self {
                label: format!("UTC, from {}", zero.strftime("%Y-%m-%d %H:%M")),
                zero: Some(zero.as_millisecond()),
            },
            None => Self::from_label(UNDATED_LABEL),
        }
    }
}

/// Vertical axis of a chart.
#[derive(Clone, Debug, Serialize)]
pub struct VerticalAxis {
    /// Label, with the unit.
    pub label: String,
    /// The axis includes 0 unless zoomed.
    pub zero: bool,
}

/// Track of a chart: points that belong together.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Trace {
    /// Name in the legend.
    pub name: String,
    /// Series of the track.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series: Option<String>,
    /// Colour on white, `#rrggbb`.
    pub colour: String,
    /// Points joined by a line.
    pub joined: bool,
    /// Dashed line.
    pub dashed: bool,
    /// Points drawn on the line.
    pub dots: bool,
    /// Small, pale points.
    pub small: bool,
    /// Abscissa, value, standard deviation.
    pub points: Vec<[Option<f64>; 3]>,
    /// Additional text of each point; may be empty.
    pub texts: Vec<String>,
}

/// Returns a point rounded to seven digits; `None` for values that are not finite.
pub fn chart_point(x: f64, y: f64, sigma: Option<f64>) -> [Option<f64>; 3] {
    [rounded_value(x), rounded_value(y), sigma.and_then(rounded_value)]
}

/// Rounds a value to seven digits; `None` if it is not finite.
pub fn rounded_value(value: f64) -> Option<f64> {
    let text = value.is_finite().then(|| format!("{value:.6e}"))?;
    text.parse().ok()
}

/// Formats a value as JSON for a script element, which its text cannot end.
pub fn script_json(value: &impl Serialize) -> PreEscaped<String> {
    PreEscaped(serde_json::to_string(value).unwrap_or_default().replace('<', "\\u003c"))
}

impl Chart {
    /// Returns the data as a script element; `of` is the name under which other figures find it.
    pub fn to_script(&self, of: Option<&str>) -> Markup {
        html! { script.chart type="application/json" data-of=[of] { (script_json(self)) } }
    }
}
