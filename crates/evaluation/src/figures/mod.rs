//! Drawing of figures: axes, curves with bands, frames with their markers.

pub mod axis;
pub mod figure;
pub mod labels;
pub mod picture;
pub mod plot;

/// Style sheet of figures, for pages with other styles.
pub const FIGURE_STYLE: &str = include_str!("figure.css");
/// Script that changes ranges and points of figures.
pub const FIGURE_SCRIPT: &str = include_str!("figure.js");
