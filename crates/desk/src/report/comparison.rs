//! Comparison of the measured shape with a computation.

use maud::{Markup, html};

use wingd_evaluation::figures::figure::{
    Figure, FigureTrack, MAIN_COLOUR, TrackStyle, all_abscissas, all_values,
};
use wingd_evaluation::figures::plot::Axis;
use wingd_evaluation::results::{ShapeComparison, ShapeQuantity};

/// Colour of computed values.
const COMPUTED_COLOUR: &str = "#b3541e";

/// Returns the section of a comparison; empty without one.
pub fn comparison_section(comparison: Option<&ShapeComparison>) -> Markup {
    let Some(comparison) = comparison else {
        return html! {};
    };
    html! {
        h2 id="comparison" { "Comparison with a computation" }
        p { b { (comparison.verdict) } }
        @if !comparison.combinations.is_empty() {
            ul { @for text in &comparison.combinations { li { (text) } } }
        }
        @for quantity in &comparison.quantities {
            figure { (draw_quantity(quantity)) }
        }
        p.caption {
            "Line with a band: " (comparison.measured) ", 1 sigma. Dots: " (comparison.computed)
            ". The test takes the covariance of all stations into account; single stations share nearly all of their errors."
        }
    }
}

fn draw_quantity(quantity: &ShapeQuantity) -> Markup {
    let measured = quantity
        .stations
        .iter()
        .map(|s| (s.arc_length_m, s.measured, s.sigma))
        .collect();
    let computed = quantity
        .stations
        .iter()
        .map(|s| (s.arc_length_m, s.computed, s.computed_sigma))
        .collect();
    let tracks = vec![
        FigureTrack::from_points("measured", MAIN_COLOUR, measured),
        FigureTrack {
            style: TrackStyle::Dots,
            ..FigureTrack::from_points("computed", COMPUTED_COLOUR, computed)
        },
    ];
    let x = Axis::from_values(
        all_abscissas(&tracks),
        "arc length from the bending root / m",
    );
    let y = Axis::from_values(all_values(&tracks).chain([0.0]), &quantity.label);
    Figure {
        name: format!("Comparison: {}", quantity.label),
        height: 260.0,
        x,
        y,
        tracks,
    }
    .draw()
}
