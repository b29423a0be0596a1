//! This page shows a calibration: its verdict, its parameters, its pictures and what its residuals look like.

use maud::{Markup, html};
use nalgebra::Vector2;

use super::html::document;
use crate::measure::calibrate::{Calibration, Verdict};
use crate::measure::geometry::Lens;

/// Width of a figure, px of the page.
const WIDTH: f64 = 640.0;
/// Length of the longest arrow, px of the page.
const ARROW: f64 = 36.0;
/// Index of k1.
pub const FIRST_DISTORTION: usize = 4;
/// Some hundred points leave Student's t at 95 % at the normal's.
pub const SIGNIFICANT: f64 = 1.96;

/// In the order of [`Lens::PARAMETERS`].
pub fn values(c: &Calibration) -> [f64; 9] {
    c.lens.parameters().into()
}

/// Correlation of two parameters; `None` with one that was held.
pub fn correlation(c: &Calibration, one: usize, other: usize) -> Option<f64> {
    let product = (c.covariance[(one, one)] * c.covariance[(other, other)]).sqrt();
    (product > 0.0).then(|| c.covariance[(one, other)] / product)
}

/// The whole page; nothing in it comes from outside. `names` and `left_out` per picture.
pub fn page(
    c: &Calibration,
    verdict: Verdict,
    reasons: &[String],
    names: &[&str],
    left_out: &[Option<String>],
) -> String {
    let main = html! {
        h1 { "Calibration: " (verdict.name()) }
        @for reason in reasons { p { (reason) } }
        (summary(c))
        h2 { "Parameters" } (parameters(c)) (correlations(c))
        h2 { "Distortion" } (distortion(c))
        h2 { "Residuals over the image" } (residuals(c))
        h2 { "Where the board was" } (coverage(c))
        h2 { "Projection uncertainty" } (uncertainty(c))
        h2 { "The board's shape" } (board(c))
        h2 { "Pictures" } (pictures(c, names, left_out))
    };
    document(
        &format!("Calibration: {}", verdict.name()),
        &main,
        "Image coordinates in pixels; sigma is one standard deviation.",
    )
}

fn summary(c: &Calibration) -> Markup {
    let used = c.view_rms_px.iter().flatten().count();
    html! {
        p {
            (used) " of " (c.view_rms_px.len()) " pictures, " (c.observations) " points, rms "
            (format!("{:.4}", c.rms_px)) " px; of it " (format!("{:.4}", c.pattern.image_px))
            " px follow the place in the image, " (format!("{:.4}", c.pattern.board_px)) " px that on the board."
            @if let Some(h) = c.halves {
                " Two halves of the pictures differ by " (format!("{:.3}", h.difference_px)) " px at " (h.distance_m)
                " m; their standard deviations let expect " (format!("{:.3}", h.predicted_px)) " px."
            }
        }
    }
}

fn parameters(c: &Calibration) -> Markup {
    let values = values(c);
    html! {
        table {
            thead { tr { th { "parameter" } th { "value" } th { "sigma" } th { "value / sigma" } th { "at 95 %" } } }
            tbody {
                @for k in 0..9 {
                    @let sigma = c.covariance[(k, k)].max(0.0).sqrt();
                    @let t = (k >= FIRST_DISTORTION && sigma > 0.0).then(|| values[k] / sigma);
                    @let digits = if k < FIRST_DISTORTION { 3 } else { 6 };
                    tr {
                        td { (Lens::PARAMETERS[k]) }
                        td { (format!("{:.digits$}", values[k])) }
                        td { @if c.held[k] { "held" } @else { (format!("{sigma:.digits$}")) } }
                        td { @if let Some(t) = t { (format!("{t:.1}")) } }
                        td { @if let Some(t) = t { @if t.abs() > SIGNIFICANT { "significant" } @else { "not significant" } } }
                    }
                }
            }
        }
    }
}

fn correlations(c: &Calibration) -> Markup {
    let denominator =
        |k: usize| format!("k{} {:.6} +- {:.6}", k + 4, c.lens.denominator[k], c.denominator_sigma[k]);
    let of = |i: usize, j: usize| correlation(c, i, j).map_or(String::new(), |r| format!("{r:.2}"));
    html! {
        @if c.lens.denominator != [0.0; 3] {
            p {
                "A rational lens, with the denominator " (denominator(0)) ", " (denominator(1)) ", " (denominator(2))
                ". The other parameters' standard deviations hold while it stays as it is."
            }
        }
        table {
            thead { tr { th { "correlation" } @for name in Lens::PARAMETERS { th { (name) } } } }
            tbody { @for i in 0..9 { tr { td { (Lens::PARAMETERS[i]) } @for j in 0..=i { td { (of(i, j)) } } } } }
        }
    }
}

/// Scale of the image in a figure, and its height.
fn frame(c: &Calibration) -> (f64, f64) {
    let scale = WIDTH / f64::from(c.lens.width);
    (scale, scale * f64::from(c.lens.height))
}

fn drawing(height: f64, label: &str, content: &Markup) -> Markup {
    html! {
        svg viewBox=(format!("0 0 {WIDTH} {height:.1}")) width=(WIDTH) height=(format!("{height:.1}")) role="img" aria-label=(label) {
            rect width=(WIDTH) height=(format!("{height:.1}")) fill="none" stroke="currentColor" {}
            (content)
        }
    }
}

fn arrow(from: Vector2<f64>, by: Vector2<f64>) -> Markup {
    let to = from + by;
    let px = |v: f64| format!("{v:.1}");
    html! {
        line x1=(px(from.x)) y1=(px(from.y)) x2=(px(to.x)) y2=(px(to.y)) stroke="currentColor" stroke-width="1" {}
        circle cx=(px(from.x)) cy=(px(from.y)) r="1.4" fill="currentColor" {}
    }
}

/// Arrows from where a pinhole would image to where the lens does.
fn distortion(c: &Calibration) -> Markup {
    let (scale, height) = frame(c);
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
    arrows(&field, scale, height, "distortion", "the distortion, from a pinhole's image to the lens's")
}

/// The mean residual of the cells of the image.
fn residuals(c: &Calibration) -> Markup {
    let (scale, height) = frame(c);
    let size = Vector2::new(f64::from(c.lens.width), f64::from(c.lens.height));
    let mut cells = vec![(0usize, Vector2::zeros(), Vector2::zeros()); 16 * 12];
    for (at, r) in c.residuals.iter().flatten() {
        let index = |v: f64, n: usize| ((v * n as f64).max(0.0) as usize).min(n - 1);
        let cell = &mut cells[index(at.y / size.y, 12) * 16 + index(at.x / size.x, 16)];
        *cell = (cell.0 + 1, cell.1 + at, cell.2 + r);
    }
    let mean = |(n, at, r): &(usize, Vector2<f64>, Vector2<f64>)| (at / *n as f64, r / *n as f64);
    let field: Vec<_> = cells.iter().filter(|cell| cell.0 > 2).map(mean).collect();
    arrows(&field, scale, height, "mean residuals", "observed less projected, the mean of a cell's points")
}

fn arrows(
    field: &[(Vector2<f64>, Vector2<f64>)],
    scale: f64,
    height: f64,
    label: &str,
    meaning: &str,
) -> Markup {
    let longest = field.iter().map(|f| f.1.norm()).fold(0.0, f64::max);
    let factor = if longest > 0.0 { ARROW / longest } else { 0.0 };
    let content = html! { @for (at, by) in field { (arrow(at * scale, by * factor)) } };
    html! {
        figure {
            (drawing(height, label, &content))
            figcaption { "Arrows: " (meaning) "; the longest is " (format!("{longest:.3}")) " px." }
        }
    }
}

fn coverage(c: &Calibration) -> Markup {
    let (scale, height) = frame(c);
    let px = |v: f64| format!("{:.1}", v * scale);
    let content = html! {
        @for (at, _) in c.residuals.iter().flatten() {
            circle cx=(px(at.x)) cy=(px(at.y)) r="1.5" fill="currentColor" fill-opacity="0.6" {}
        }
    };
    html! { figure { (drawing(height, "coverage", &content)) figcaption { "Every point that took part." } } }
}

fn uncertainty(c: &Calibration) -> Markup {
    let Some(projections) = &c.projections else {
        return html! { p { "The lens has no inverse over the whole image." } };
    };
    html! {
        @for p in projections {
            figure {
                (heat(c, &p.cells_px))
                figcaption {
                    "At " (p.distance_m) " m: " (format!("{:.3}", p.sigma_px)) " px rms over the image, "
                    (format!("{:.3}", p.worst_sigma_px)) " px in the worst ninth."
                }
            }
        }
    }
}

/// Numbers over shades: the darker, the less sure.
fn heat(c: &Calibration, cells_px: &[Vec<Option<f64>>]) -> Markup {
    let (_, height) = frame(c);
    let rows = cells_px.len().max(1);
    let columns = cells_px.first().map_or(1, Vec::len).max(1);
    let (w, h) = (WIDTH / columns as f64, height / rows as f64);
    let most = cells_px.iter().flatten().flatten().copied().fold(f64::MIN_POSITIVE, f64::max);
    let content = html! {
        @for (j, row) in cells_px.iter().enumerate() {
            @for (i, cell) in row.iter().enumerate() {
                @if let Some(sigma) = cell {
                    rect x=(format!("{:.1}", i as f64 * w)) y=(format!("{:.1}", j as f64 * h)) width=(format!("{w:.1}"))
                        height=(format!("{h:.1}")) fill="#b00020" fill-opacity=(format!("{:.2}", 0.6 * sigma / most)) {}
                    text x=(format!("{:.1}", (i as f64 + 0.5) * w)) y=(format!("{:.1}", (j as f64 + 0.6) * h))
                        text-anchor="middle" font-size="11" fill="currentColor" { (format!("{sigma:.3}")) }
                }
            }
        }
    };
    drawing(height, "projection uncertainty", &content)
}

fn board(c: &Calibration) -> Markup {
    html! {
        table {
            thead { tr { th { "direction" } th { "side / m" } th { "bow / mm" } th { "sigma / mm" } th { "at 95 %" } } }
            tbody {
                @for (k, name) in ["along the rows", "across them"].iter().enumerate() {
                    tr {
                        td { (name) }
                        td { (format!("{:.3}", c.board_side_m[k])) }
                        td { (format!("{:.3}", 1e3 * c.bow[k].value_m)) }
                        td { (format!("{:.3}", 1e3 * c.bow[k].sigma_m)) }
                        td { @if c.bow[k].significant() { "significant" } @else { "not significant" } }
                    }
                }
            }
        }
        @if let Some(s) = c.stretch {
            p {
                (format!("Stretch across over along {:.4} +- {:.4} %", 1e2 * s.value, 1e2 * s.sigma)) ": "
                @if s.stated.is_some() { "allowed for in the camera, " } @else { "looked for only; the board is taken as described, " }
                @if s.significant() { "significant" } @else { "not significant" }
                (format!("; it is worth {:.3} px of the projection at 15 m.", s.worth_px))
            }
        }
        figure { (profiles(c)) figcaption { "The board's sections through its middle, along and across, the height enlarged." } }
    }
}

fn profiles(c: &Calibration) -> Markup {
    let height = 120.0;
    let most = c.bow.iter().map(|b| b.value_m.abs()).fold(f64::MIN_POSITIVE, f64::max);
    let line = |bow: f64, dashes: &str| {
        let points: Vec<String> = (0..=40)
            .map(|k| {
                let u = f64::from(k) / 20.0 - 1.0;
                let y = 0.5 * height - 0.4 * height * bow / most * (1.0 - u * u);
                format!("{:.1},{y:.1}", (0.05 + 0.9 * f64::from(k) / 40.0) * WIDTH)
            })
            .collect();
        html! { polyline points=(points.join(" ")) fill="none" stroke="currentColor" stroke-dasharray=(dashes) {} }
    };
    let content = html! { (line(c.bow[0].value_m, "none")) (line(c.bow[1].value_m, "5 4")) };
    drawing(height, "sections of the board", &content)
}

fn pictures(c: &Calibration, names: &[&str], left_out: &[Option<String>]) -> Markup {
    let number = |v: Option<f64>, digits: usize| v.map_or(String::new(), |v| format!("{v:.digits$}"));
    html! {
        table {
            thead { tr { th { "picture" } th { "points" } th { "rms / px" } th { "tilt / deg" } th { "left out" } } }
            tbody {
                @for (k, name) in names.iter().enumerate() {
                    tr {
                        td { (name) }
                        td { (c.view_points[k]) }
                        td { (number(c.view_rms_px[k], 4)) }
                        td { (number(c.tilt_deg[k], 1)) }
                        td { @if let Some(reason) = &left_out[k] { (reason) } }
                    }
                }
            }
        }
    }
}
