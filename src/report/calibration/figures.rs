//! The calibration's figures lie over the image: axes in its pixels, the same scale for all.

use maud::{Markup, html};
use nalgebra::Vector2;

use super::super::html::plot::{Axis, Plot, drawing as figure, px};
use super::super::number::{decimals_for, fixed};
use crate::measure::calibrate::{Calibration, ProjectionUncertainty};

/// Width of the image in a figure, px of the page.
const WIDTH: f64 = 640.0;
/// Beside it for the axis' texts and the scale of colours, px of the page.
const LEFT: f64 = 64.0;
const RIGHT: f64 = 110.0;
const TOP: f64 = 12.0;
/// Under it, px of the page.
const UNDER: f64 = 46.0;
/// Length of the longest arrow, px of the page.
const ARROW: f64 = 36.0;
const INK: &str = "#1c2430";
/// Lines on either axis about so many pixels of the page apart.
const TICKS: f64 = 90.0;

/// The image with its axes, u to the right and v downwards, px.
struct Sheet {
    plot: Plot,
    size: Vector2<f64>,
    height: f64,
}

impl Sheet {
    fn of(c: &Calibration) -> Self {
        let size = Vector2::new(f64::from(c.lens.width), f64::from(c.lens.height));
        let step = super::super::html::round_step(TICKS * size.x / WIDTH);
        let x = Axis::exactly(0.0, size.x, step, "u / px");
        let y = Axis::exactly(0.0, size.y, step, "v / px").turned();
        let height = WIDTH * y.width() / x.width();
        Self { plot: Plot { area: [LEFT, TOP, WIDTH, height], x, y }, size, height }
    }

    fn at(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let (x, y) = self.plot.at(pixel.x, -pixel.y);
        Vector2::new(x, y)
    }

    /// Cut off at the image's edges.
    fn inside(&self, content: &Markup) -> Markup {
        let [left, top, width, height] = self.plot.area.map(px);
        let part = format!("{left} {top} {width} {height}");
        html! { svg x=(left) y=(top) width=(width) height=(height) viewBox=(part) overflow="hidden" { (content) } }
    }

    fn draw(&self, label: &str, content: &Markup) -> Markup {
        let content = html! { (self.plot.frame()) (content) };
        figure(LEFT + WIDTH + RIGHT, TOP + self.height + UNDER, label, &content)
    }
}

/// Arrows from where a pinhole would image to where the lens does.
pub(super) fn distortion(c: &Calibration) -> Markup {
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
    let field: Vec<_> = (0..=16).flat_map(|i| (0..=12).filter_map(move |j| at(i, j))).collect();
    arrows(c, &field, "distortion", "how far the lens images a point from where a pinhole would")
}

/// The mean residual of the cells of the image.
pub(super) fn residuals(c: &Calibration) -> Markup {
    let size = Vector2::new(f64::from(c.lens.width), f64::from(c.lens.height));
    let mut cells = vec![(0usize, Vector2::zeros(), Vector2::zeros()); 16 * 12];
    for (at, r) in c.residuals.iter().flatten() {
        let index = |v: f64, n: usize| ((v * n as f64).max(0.0) as usize).min(n - 1);
        let cell = &mut cells[index(at.y / size.y, 12) * 16 + index(at.x / size.x, 16)];
        *cell = (cell.0 + 1, cell.1 + at, cell.2 + r);
    }
    let mean = |(n, at, r): &(usize, Vector2<f64>, Vector2<f64>)| (at / *n as f64, r / *n as f64);
    let field: Vec<_> = cells.iter().filter(|cell| cell.0 > 2).map(mean).collect();
    arrows(c, &field, "mean residuals", "observed less projected, the mean of a cell's points")
}

fn arrows(c: &Calibration, field: &[(Vector2<f64>, Vector2<f64>)], label: &str, meaning: &str) -> Markup {
    let sheet = Sheet::of(c);
    let longest = field.iter().map(|f| f.1.norm()).fold(0.0, f64::max);
    let factor = if longest > 0.0 { ARROW / longest } else { 0.0 };
    let key = Vector2::new(LEFT + WIDTH + 14.0, TOP + 24.0);
    let content = html! {
        (sheet.inside(&html! { @for (at, by) in field { (arrow(sheet.at(*at), by * factor)) } }))
        (arrow(key, Vector2::new(ARROW, 0.0)))
        text.tick x=(px(key.x)) y=(px(key.y + 18.0)) { (fixed(Some(longest), decimals_for(longest))) " px" }
    };
    html! {
        figure.sheet {
            (sheet.draw(label, &content))
            p.caption { "Arrows from their dots: " (meaning) "; the longest is " (fixed(Some(longest), decimals_for(longest))) " px." }
        }
    }
}

fn arrow(from: Vector2<f64>, by: Vector2<f64>) -> Markup {
    let to = from + by;
    html! {
        line x1=(px(from.x)) y1=(px(from.y)) x2=(px(to.x)) y2=(px(to.y)) stroke=(INK) stroke-width="1" {}
        circle cx=(px(from.x)) cy=(px(from.y)) r="1.4" fill=(INK) {}
    }
}

/// Every point that took part, and how many lie in each ninth.
pub(super) fn coverage(c: &Calibration) -> Markup {
    let sheet = Sheet::of(c);
    let third = |k: usize, of: f64| (k as f64 + 0.5) / 3.0 * of;
    let content = html! {
        @for (at, _) in c.residuals.iter().flatten() {
            @let at = sheet.at(*at);
            circle cx=(px(at.x)) cy=(px(at.y)) r="1.5" fill="#17456f" fill-opacity="0.6" {}
        }
        @for (j, row) in c.coverage.iter().enumerate() {
            @for (i, count) in row.iter().enumerate() {
                @let at = sheet.at(Vector2::new(third(i, sheet.size.x), third(j, sheet.size.y)));
                rect x=(px(at.x - 30.0)) y=(px(at.y - 11.0)) width="60" height="17" fill="#ffffff" fill-opacity="0.8" {}
                text x=(px(at.x)) y=(px(at.y + 2.0)) text-anchor="middle" font-size="12" fill=[if *count == 0 { Some("#a02010") } else { Some(INK) }] { (count) }
            }
        }
    };
    html! {
        figure.sheet {
            (sheet.draw("coverage", &content))
            p.caption { "Every point that took part, and their number in each ninth of the image. Where there is none, the lens model alone says what the lens does." }
        }
    }
}

/// Standard deviation of a projected point over the image, one map a distance.
pub(super) fn uncertainty(c: &Calibration) -> Markup {
    let Some(projections) = &c.projections else {
        return html! { p { "The lens has no inverse over the whole image." } };
    };
    let cells = projections.iter().flat_map(|p| p.cells_px.iter().flatten().flatten());
    let most = cells.copied().fold(f64::MIN_POSITIVE, f64::max);
    html! { @for p in projections { (map(c, p, most)) } }
}

fn map(c: &Calibration, projection: &ProjectionUncertainty, most: f64) -> Markup {
    let sheet = Sheet::of(c);
    let rows = projection.cells_px.len().max(1);
    let columns = projection.cells_px.first().map_or(1, Vec::len).max(1);
    let corner = |i: usize, j: usize| {
        sheet
            .at(Vector2::new(i as f64 / columns as f64 * sheet.size.x, j as f64 / rows as f64 * sheet.size.y))
    };
    let content = html! {
        @for (j, row) in projection.cells_px.iter().enumerate() {
            @for (i, cell) in row.iter().enumerate() {
                @if let Some(sigma) = cell {
                    @let (from, to) = (corner(i, j), corner(i + 1, j + 1));
                    rect x=(px(from.x)) y=(px(from.y)) width=(px(to.x - from.x + 0.5)) height=(px(to.y - from.y + 0.5)) fill=(shade(sigma / most)) {}
                    text x=(px((from.x + to.x) / 2.0)) y=(px((from.y + to.y) / 2.0 + 4.0)) text-anchor="middle" font-size="11.5" fill=(INK) { (fixed(Some(*sigma), decimals_for(most))) }
                }
            }
        }
        (scale(&sheet, most))
    };
    html! {
        figure.sheet {
            (sheet.draw(&format!("projection uncertainty at {} m", projection.distance_m), &content))
            p.caption {
                "Standard deviation of the image of a point at " (projection.distance_m) " m, px: "
                (format!("{:.3}", projection.sigma_px)) " rms over the image, " (format!("{:.3}", projection.worst_sigma_px))
                " in the worst ninth. All maps have the same colours."
            }
        }
    }
}

/// Colour of a share of the largest value: from pale yellow to teal, all of them light enough for dark letters, and dark enough
/// for light ones where the page is inverted.
fn shade(share: f64) -> String {
    const STOPS: [[f64; 3]; 3] = [[255.0, 250.0, 205.0], [161.0, 218.0, 180.0], [65.0, 182.0, 196.0]];
    let place = 2.0 * share.clamp(0.0, 1.0);
    let k = (place as usize).min(1);
    let mix = |i: usize| STOPS[k][i] + (STOPS[k + 1][i] - STOPS[k][i]) * (place - k as f64);
    format!("#{:02x}{:02x}{:02x}", mix(0) as u8, mix(1) as u8, mix(2) as u8)
}

/// The colours with their values, px.
fn scale(sheet: &Sheet, most: f64) -> Markup {
    const STEPS: usize = 24;
    let (x, height) = (LEFT + WIDTH + 18.0, sheet.height * 0.8);
    let step = height / STEPS as f64;
    let values = Axis::over([0.0, most].into_iter(), "");
    html! {
        @for k in 0..STEPS {
            rect x=(px(x)) y=(px(TOP + 14.0 + height - step * (k as f64 + 1.0))) width="16" height=(px(step + 0.5))
                fill=(shade((k as f64 + 0.5) / STEPS as f64)) {}
        }
        text.tick x=(px(x)) y=(px(TOP + 6.0)) { "sigma / px" }
        @for (value, text) in values.ticks().into_iter().filter(|(value, _)| *value <= most) {
            text.tick x=(px(x + 22.0)) y=(px(TOP + 18.0 + height * (1.0 - value / most))) { (text) }
        }
    }
}

/// The board's sections, from its middle.
pub(super) fn profiles(c: &Calibration) -> Markup {
    /// Of the plot, px of the page.
    const HEIGHT: f64 = 130.0;
    let most = c.bow.iter().map(|b| b.value_m.abs()).fold(0.0, f64::max);
    // A hundredth of a millimetre is what a board is measured to.
    let (unit, label) = if most < 1e-5 { (1e6, "height / µm") } else { (1e3, "height / mm") };
    let section = |k: usize| {
        (-20..=20).map(move |i| {
            let u = f64::from(i) / 20.0;
            (0.5 * u * c.board_side_m[k], unit * c.bow[k].value_m * (1.0 - u * u))
        })
    };
    let sections = [section(0).collect::<Vec<_>>(), section(1).collect()];
    let over = |of: fn(&(f64, f64)) -> f64, label: &str| Axis::over(sections.iter().flatten().map(of), label);
    let plot = Plot {
        area: [LEFT, TOP, WIDTH, HEIGHT],
        x: over(|p| p.0, "from the board's middle / m"),
        y: over(|p| p.1, label),
    };
    let content = html! {
        (plot.frame())
        (plot.line(&sections[0], INK, false))
        (plot.line(&sections[1], INK, true))
    };
    figure(LEFT + WIDTH + RIGHT, TOP + HEIGHT + UNDER, "sections of the board", &content)
}
