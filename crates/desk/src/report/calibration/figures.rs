//! Figures of a calibration over the image: u to the right and v downwards, px.

use maud::{Markup, html};
use nalgebra::Vector2;

use wingd_evaluation::figures::figure::{
    BREAK, Figure, FigurePoint, FigureTrack, MAIN_COLOUR, TrackStyle, all_abscissas, all_values,
};
use wingd_evaluation::figures::plot::{Axis, round_step};
use wingd_evaluation::number::{decimals_for, format_fixed};
use wingd_measure::calibrate::Calibration;
use wingd_measure::calibrate::ProjectionUncertainty;

/// Height of a figure, px of the page.
const HEIGHT: f64 = 420.0;
/// Length of the longest arrow over the width of the image.
const ARROW_SHARE: f64 = 0.05;
const INK: &str = "#1c2430";

/// Point or end of an arrow, with v downwards.
fn figure_point(pixel: Vector2<f64>) -> FigurePoint {
    (pixel.x, -pixel.y, None)
}

/// Draws tracks over the image.
fn draw_over_image(c: &Calibration, name: &str, tracks: Vec<FigureTrack>) -> Markup {
    let side = |px: u32| [0.0, f64::from(px)].into_iter();
    let x = Axis::from_values(side(c.lens.width).chain(all_abscissas(&tracks)), "u / px");
    let down = all_values(&tracks).map(|v| -v);
    let y = Axis::from_values(side(c.lens.height).chain(down), "v / px").reversed();
    Figure {
        name: name.to_owned(),
        height: HEIGHT,
        x,
        y,
        tracks,
    }
    .draw()
}

fn dot_track(name: &str, pixels: impl Iterator<Item = Vector2<f64>>) -> FigureTrack {
    FigureTrack {
        style: TrackStyle::SmallDots,
        ..FigureTrack::from_points(name, MAIN_COLOUR, pixels.map(figure_point).collect())
    }
}

/// Draws arrows from the pinhole projection of a point to its distorted image.
pub(super) fn draw_distortion(c: &Calibration) -> Markup {
    let l = &c.lens;
    let at = |i: i32, j: i32| {
        let pixel = Vector2::new(
            f64::from(i) / 16.0 * (f64::from(l.width) - 1.0),
            f64::from(j) / 12.0 * (f64::from(l.height) - 1.0),
        );
        let n = l.undistort(&pixel).ok()?;
        let ideal = Vector2::new(l.fx * n.x + l.cx, l.fy * n.y + l.cy);
        Some((pixel, pixel - ideal))
    };
    let field: Vec<_> = (0..=16)
        .flat_map(|i| (0..=12).filter_map(move |j| at(i, j)))
        .collect();
    draw_arrows(
        c,
        &field,
        "distortion",
        "distance of the distorted image of a point from its pinhole projection",
    )
}

/// Draws the mean residuals of the cells of the image.
pub(super) fn draw_residuals(c: &Calibration) -> Markup {
    let size = Vector2::new(f64::from(c.lens.width), f64::from(c.lens.height));
    let mut cells = vec![(0usize, Vector2::zeros(), Vector2::zeros()); 16 * 12];
    for (at, r) in c.residuals.iter().flatten() {
        let index = |v: f64, n: usize| ((v * n as f64).max(0.0) as usize).min(n - 1);
        let cell = &mut cells[index(at.y / size.y, 12) * 16 + index(at.x / size.x, 16)];
        *cell = (cell.0 + 1, cell.1 + at, cell.2 + r);
    }
    let mean = |(n, at, r): &(usize, Vector2<f64>, Vector2<f64>)| (at / *n as f64, r / *n as f64);
    let field: Vec<_> = cells.iter().filter(|cell| cell.0 > 2).map(mean).collect();
    draw_arrows(
        c,
        &field,
        "mean residuals",
        "observed minus projected, mean of the points of a cell",
    )
}

fn draw_arrows(
    c: &Calibration,
    field: &[(Vector2<f64>, Vector2<f64>)],
    label: &str,
    meaning: &str,
) -> Markup {
    let longest = field.iter().map(|f| f.1.norm()).fold(0.0, f64::max);
    let magnified = if longest > 0.0 {
        round_step(ARROW_SHARE * f64::from(c.lens.width) / longest)
    } else {
        1.0
    };
    let arrow = |(at, by): &(Vector2<f64>, Vector2<f64>)| {
        [figure_point(*at), figure_point(at + by * magnified), BREAK]
    };
    let arrows = field.iter().flat_map(arrow).collect();
    let tracks = vec![
        dot_track("beginnings", field.iter().map(|(at, _)| *at)),
        FigureTrack::from_points(label, INK, arrows),
    ];
    html! {
        figure {
            (draw_over_image(c, label, tracks))
            p.caption {
                "Lines starting at the dots: " (meaning) ", magnified " (magnified) " times; the longest is "
                (format_fixed(Some(longest), decimals_for(longest))) " px."
            }
        }
    }
}

/// Draws all points used, and their number in each ninth of the image.
pub(super) fn draw_coverage(c: &Calibration) -> Markup {
    let points = c.residuals.iter().flatten().map(|(at, _)| *at);
    let counts = c.coverage.map(|row| row.map(|n| Some(n as f64)).to_vec());
    let most = c.coverage.iter().flatten().copied().max().unwrap_or(0);
    html! {
        figure {
            (draw_over_image(c, "coverage", vec![dot_track("points used", points)]))
            p.caption { "All points used, and their number in each ninth of the image. In a ninth without points the projection is an extrapolation of the lens model." }
            (cell_table(&counts, most as f64, 0))
        }
    }
}

/// Draws the standard deviation of a projected point over the image, one map per distance.
pub(super) fn draw_uncertainty(c: &Calibration) -> Markup {
    let Some(projections) = &c.projections else {
        return html! { p { "No map of the projection's uncertainty: it cannot be computed over the full image. Add images with the board near the edges." } };
    };
    let cells = projections
        .iter()
        .flat_map(|p| p.cells_px.iter().flatten().flatten());
    let most = cells.copied().fold(f64::MIN_POSITIVE, f64::max);
    html! { @for p in projections { (draw_uncertainty_map(p, most)) } }
}

fn draw_uncertainty_map(projection: &ProjectionUncertainty, most: f64) -> Markup {
    html! {
        figure {
            (cell_table(&projection.cells_px, most, decimals_for(most)))
            p.caption {
                "Standard deviation of the image of a point at " (projection.distance_m) " m, px: "
                (format!("{:.3}", projection.sigma_px)) " rms over the image, " (format!("{:.3}", projection.worst_sigma_px))
                " in the worst ninth. All maps have the same colours."
            }
        }
    }
}

/// Returns a table of the cells of the image, coloured by their fraction of `most`.
fn cell_table(rows: &[Vec<Option<f64>>], most: f64, decimals: usize) -> Markup {
    let style = |value: f64| format!("background:{};color:{INK}", shade_colour(value / most));
    html! {
        div.scroll tabindex="0" { table { tbody {
            @for row in rows { tr { @for cell in row {
                td.n style=[cell.map(style)] { (format_fixed(*cell, decimals)) }
            } } }
        } } }
    }
}

/// Returns the colour of a fraction, from pale yellow to teal: light enough for dark letters.
fn shade_colour(share: f64) -> String {
    const STOPS: [[f64; 3]; 3] = [
        [255.0, 250.0, 205.0],
        [161.0, 218.0, 180.0],
        [65.0, 182.0, 196.0],
    ];
    let place = 2.0 * share.clamp(0.0, 1.0);
    let k = (place as usize).min(1);
    let mix = |i: usize| STOPS[k][i] + (STOPS[k + 1][i] - STOPS[k][i]) * (place - k as f64);
    format!(
        "#{:02x}{:02x}{:02x}",
        mix(0) as u8,
        mix(1) as u8,
        mix(2) as u8
    )
}
