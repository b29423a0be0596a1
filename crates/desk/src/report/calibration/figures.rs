//! Figures of a calibration over the image area, with axes in image pixels and a common scale.

use maud::{Markup, html};
use nalgebra::Vector2;

use wingd_evaluation::figures::figure::{
    Figure, FigureTrack, MAIN_COLOUR, all_abscissas, all_values,
};
use wingd_evaluation::figures::plot::{Axis, Plot, px, svg_drawing};
use wingd_evaluation::number::{decimals_for, format_fixed};
use wingd_measure::calibrate::Calibration;
use wingd_measure::calibrate::ProjectionUncertainty;

/// Width of the image in a figure, px of the page.
const WIDTH: f64 = 640.0;
/// Space to the left of the image for the labels of the axis, px of the page.
const LEFT: f64 = 64.0;
const RIGHT: f64 = 110.0;
const TOP: f64 = 12.0;
/// Space below the image, px of the page.
const BOTTOM: f64 = 46.0;
/// Length of the longest arrow, px of the page.
const MAX_ARROW: f64 = 36.0;
const INK: &str = "#1c2430";
/// Approximate spacing of the grid lines, px of the page.
const TICK_SPACING: f64 = 90.0;

/// Figure of the image area with its axes, u to the right and v downwards, px.
struct ImageFigure {
    plot: Plot,
    size: Vector2<f64>,
    height: f64,
}

impl ImageFigure {
    fn from_calibration(c: &Calibration) -> Self {
        let size = Vector2::new(f64::from(c.lens.width), f64::from(c.lens.height));
        let step = wingd_evaluation::figures::axis::round_step(TICK_SPACING * size.x / WIDTH);
        let x = Axis::from_exact_range(0.0, size.x, step, "u / px");
        let y = Axis::from_exact_range(0.0, size.y, step, "v / px").reversed();
        let height = WIDTH * y.length() / x.length();
        Self {
            plot: Plot {
                area: [LEFT, TOP, WIDTH, height],
                x,
                y,
            },
            size,
            height,
        }
    }

    fn point_at(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let (x, y) = self.plot.point_at(pixel.x, -pixel.y);
        Vector2::new(x, y)
    }

    /// Clips content at the edges of the image.
    fn clip_to_image(&self, content: &Markup) -> Markup {
        let [left, top, width, height] = self.plot.area.map(px);
        let part = format!("{left} {top} {width} {height}");
        html! { svg x=(left) y=(top) width=(width) height=(height) viewBox=(part) overflow="hidden" { (content) } }
    }

    fn draw(&self, label: &str, content: &Markup) -> Markup {
        let content = html! { (self.plot.frame()) (content) };
        svg_drawing(
            LEFT + WIDTH + RIGHT,
            TOP + self.height + BOTTOM,
            label,
            &content,
        )
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
    let sheet = ImageFigure::from_calibration(c);
    let longest = field.iter().map(|f| f.1.norm()).fold(0.0, f64::max);
    let factor = if longest > 0.0 {
        MAX_ARROW / longest
    } else {
        0.0
    };
    let key = Vector2::new(LEFT + WIDTH + 14.0, TOP + 24.0);
    let content = html! {
        (sheet.clip_to_image(&html! { @for (at, by) in field { (draw_arrow(sheet.point_at(*at), by * factor)) } }))
        (draw_arrow(key, Vector2::new(MAX_ARROW, 0.0)))
        text.tick x=(px(key.x)) y=(px(key.y + 18.0)) { (format_fixed(Some(longest), decimals_for(longest))) " px" }
    };
    html! {
        figure.sheet {
            (sheet.draw(label, &content))
            p.caption { "Arrows starting at the dots: " (meaning) "; the longest is " (format_fixed(Some(longest), decimals_for(longest))) " px." }
        }
    }
}

fn draw_arrow(from: Vector2<f64>, by: Vector2<f64>) -> Markup {
    let to = from + by;
    html! {
        line x1=(px(from.x)) y1=(px(from.y)) x2=(px(to.x)) y2=(px(to.y)) stroke=(INK) stroke-width="1" {}
        circle cx=(px(from.x)) cy=(px(from.y)) r="1.4" fill=(INK) {}
    }
}

/// Draws all points used, and their number in each ninth of the image.
pub(super) fn draw_coverage(c: &Calibration) -> Markup {
    let sheet = ImageFigure::from_calibration(c);
    let third = |k: usize, of: f64| (k as f64 + 0.5) / 3.0 * of;
    let content = html! {
        @for (at, _) in c.residuals.iter().flatten() {
            @let at = sheet.point_at(*at);
            circle cx=(px(at.x)) cy=(px(at.y)) r="1.5" fill=(MAIN_COLOUR) fill-opacity="0.6" {}
        }
        @for (j, row) in c.coverage.iter().enumerate() {
            @for (i, count) in row.iter().enumerate() {
                @let at = sheet.point_at(Vector2::new(third(i, sheet.size.x), third(j, sheet.size.y)));
                rect x=(px(at.x - 30.0)) y=(px(at.y - 11.0)) width="60" height="17" fill="#ffffff" fill-opacity="0.8" {}
                text x=(px(at.x)) y=(px(at.y + 2.0)) text-anchor="middle" font-size="12" fill=[if *count == 0 { Some("#a02010") } else { Some(INK) }] { (count) }
            }
        }
    };
    html! {
        figure.sheet {
            (sheet.draw("coverage", &content))
            p.caption { "All points used, and their number in each ninth of the image. In a ninth without points the projection is an extrapolation of the lens model." }
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
    html! { @for p in projections { (draw_uncertainty_map(c, p, most)) } }
}

fn draw_uncertainty_map(c: &Calibration, projection: &ProjectionUncertainty, most: f64) -> Markup {
    let sheet = ImageFigure::from_calibration(c);
    let rows = projection.cells_px.len().max(1);
    let columns = projection.cells_px.first().map_or(1, Vec::len).max(1);
    let corner = |i: usize, j: usize| {
        sheet.point_at(Vector2::new(
            i as f64 / columns as f64 * sheet.size.x,
            j as f64 / rows as f64 * sheet.size.y,
        ))
    };
    let content = html! {
        @for (j, row) in projection.cells_px.iter().enumerate() {
            @for (i, cell) in row.iter().enumerate() {
                @if let Some(sigma) = cell {
                    @let (from, to) = (corner(i, j), corner(i + 1, j + 1));
                    rect x=(px(from.x)) y=(px(from.y)) width=(px(to.x - from.x + 0.5)) height=(px(to.y - from.y + 0.5)) fill=(shade_colour(sigma / most)) {}
                    text x=(px((from.x + to.x) / 2.0)) y=(px((from.y + to.y) / 2.0 + 4.0)) text-anchor="middle" font-size="11.5" fill=(INK) { (format_fixed(Some(*sigma), decimals_for(most))) }
                }
            }
        }
        (draw_colour_scale(&sheet, most))
    };
    html! {
        figure.sheet {
            (sheet.draw(&format!("projection uncertainty at {} m", projection.distance_m), &content))
            p.caption {
                "Standard deviation of the image of a point at " (projection.distance_m) " m, px: "
                (format!("{:.3}", projection.sigma_px)) " rms over the image, " (format!("{:.3}", projection.worst_sigma_px))
                " in the worst ninth. All maps have the same colour scale."
            }
        }
    }
}

/// Returns the colour of a fraction of the largest value, from pale yellow to teal: light enough for dark letters, and dark
/// enough for light letters on the inverted page.
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

/// Draws the colour scale with its values, px.
fn draw_colour_scale(sheet: &ImageFigure, most: f64) -> Markup {
    const STEPS: usize = 24;
    let (x, height) = (LEFT + WIDTH + 18.0, sheet.height * 0.8);
    let step = height / STEPS as f64;
    let values = Axis::from_values([0.0, most].into_iter(), "");
    html! {
        @for k in 0..STEPS {
            rect x=(px(x)) y=(px(TOP + 14.0 + height - step * (k as f64 + 1.0))) width="16" height=(px(step + 0.5))
                fill=(shade_colour((k as f64 + 0.5) / STEPS as f64)) {}
        }
        text.tick x=(px(x)) y=(px(TOP + 6.0)) { "sigma / px" }
        @for (value, text) in values.ticks().into_iter().filter(|(value, _)| *value <= most) {
            text.tick x=(px(x + 22.0)) y=(px(TOP + 18.0 + height * (1.0 - value / most))) { (text) }
        }
    }
}

/// Draws the two sections through the middle of the board.
pub(super) fn draw_board_profiles(c: &Calibration) -> Markup {
    let most = c.bow.iter().map(|b| b.value_m.abs()).fold(0.0, f64::max);
    // A board is measured to 0.01 mm.
    let (unit, label) = if most < 1e-5 {
        (1e6, "height / µm")
    } else {
        (1e3, "height / mm")
    };
    let section = |(k, name): (usize, &str)| {
        let place = |u: f64| {
            (
                0.5 * u * c.board_side_m[k],
                unit * c.bow[k].value_m * (1.0 - u * u),
                None,
            )
        };
        let points = (-20..=20).map(|i| place(f64::from(i) / 20.0)).collect();
        FigureTrack {
            dashed: k == 1,
            ..FigureTrack::from_points(name, INK, points)
        }
    };
    let tracks = [(0, "along the rows"), (1, "across them")]
        .map(section)
        .to_vec();
    let x = Axis::from_values(
        all_abscissas(&tracks),
        "distance from the middle of the board / m",
    );
    let y = Axis::from_values(all_values(&tracks), label);
    Figure {
        name: "Sections through the board".to_owned(),
        height: 130.0,
        x,
        y,
        tracks,
    }
    .draw()
}
