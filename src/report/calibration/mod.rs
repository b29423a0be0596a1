//! This page shows a calibration: its verdict, its parameters, its pictures and what its residuals look like.

mod figures;

use super::grid::Grid;
use super::html::document;
use super::number::{count, fixed, rounded};
use crate::measure::calibrate::{Calibration, Verdict};
use crate::measure::geometry::Lens;
use maud::{Markup, html};

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

/// The whole page; nothing in it comes from outside. The verdict with the reason for which a refused one was accepted;
/// `names` and `left_out` per picture.
pub fn page(
    c: &Calibration,
    (verdict, accepted): (Verdict, Option<&str>),
    reasons: &[String],
    names: &[&str],
    left_out: &[Option<String>],
) -> String {
    let main = html! {
        h1 { "Calibration: " (verdict.name()) }
        @if let Some(accepted) = accepted { p.warning { "Refused, and accepted all the same: " (accepted) } }
        @for reason in reasons { p.warning { (reason) } }
        (summary(c))
        h2 { "Projection uncertainty" } (figures::uncertainty(c))
        h2 { "Where the board was" } (figures::coverage(c))
        h2 { "Parameters" } (parameters(c)) (correlations(c))
        h2 { "Distortion" } (figures::distortion(c))
        h2 { "Residuals over the image" } (figures::residuals(c))
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
            (used) " of " (count(c.view_rms_px.len(), "picture")) " of " (c.lens.width) " x " (c.lens.height) " px, "
            (count(c.observations, "point")) ", rms "
            (format!("{:.4}", c.rms_px)) " px; of it " (format!("{:.4}", c.pattern.image_px))
            " px follow the place in the image, " (format!("{:.4}", c.pattern.board_px)) " px that on the board."
            @if let Some(h) = c.halves {
                " Two halves of the pictures differ by " (format!("{:.3}", h.difference_px)) " px at " (h.distance_m)
                " m; their standard deviations let expect " (format!("{:.3}", h.predicted_px)) " px."
            }
        }
    }
}

fn verdict(significant: bool) -> String {
    if significant { "significant" } else { "not significant" }.to_owned()
}

fn parameters(c: &Calibration) -> Markup {
    let values = values(c);
    let mut grid = Grid::new(&["<parameter", "value", "sigma", "value / sigma", "<at 95 %"]);
    for (k, value) in values.iter().enumerate() {
        let sigma = c.covariance[(k, k)].max(0.0).sqrt();
        let t = (k >= FIRST_DISTORTION && sigma > 0.0).then(|| value / sigma);
        let digits = if k < FIRST_DISTORTION { 3 } else { 6 };
        grid.push(vec![
            Lens::PARAMETERS[k].to_owned(),
            fixed(Some(*value), digits),
            if c.held[k] { "held".to_owned() } else { fixed(Some(sigma), digits) },
            t.map_or(String::new(), |t| fixed(Some(t), 1)),
            t.map_or(String::new(), |t| verdict(t.abs() > SIGNIFICANT)),
        ]);
    }
    scroll(&grid)
}

fn scroll(grid: &Grid) -> Markup {
    html! { div.scroll { (grid.html()) } }
}

fn correlations(c: &Calibration) -> Markup {
    let denominator =
        |k: usize| format!("k{} {:.6} ± {:.6}", k + 4, c.lens.denominator[k], c.denominator_sigma[k]);
    let of = |i: usize, j: usize| {
        correlation(c, i, j).filter(|_| j <= i).map_or(String::new(), |r| format!("{r:.2}"))
    };
    let mut titles = vec!["<correlation"];
    titles.extend(Lens::PARAMETERS);
    let mut grid = Grid::new(&titles);
    for (i, name) in Lens::PARAMETERS.iter().enumerate() {
        grid.push(std::iter::once((*name).to_owned()).chain((0..9).map(|j| of(i, j))).collect());
    }
    html! {
        @if c.lens.denominator != [0.0; 3] {
            p {
                "A rational lens, with the denominator " (denominator(0)) ", " (denominator(1)) ", " (denominator(2))
                ". The other parameters' standard deviations hold while it stays as it is."
            }
        }
        (scroll(&grid))
    }
}

fn board(c: &Calibration) -> Markup {
    let mut grid = Grid::new(&["<direction", "side / m", "bow / mm", "sigma / mm", "<at 95 %"]);
    for (k, name) in ["along the rows", "across them"].iter().enumerate() {
        let bow = &c.bow[k];
        let (height, sigma) = rounded(Some(1e3 * bow.value_m), Some(1e3 * bow.sigma_m), 3);
        let side = fixed(Some(c.board_side_m[k]), 3);
        grid.push(vec![(*name).to_owned(), side, height, sigma, verdict(bow.is_significant())]);
    }
    html! {
        (scroll(&grid))
        @if let Some(s) = c.stretch {
            p {
                (format!("Stretch across over along {:.4} ± {:.4} %", 1e2 * s.value, 1e2 * s.sigma)) ", "
                (verdict(s.is_significant()))
                @if s.stated.is_some() { ": allowed for in the camera" } @else { ": looked for only; the board is taken as described" }
                (format!("; it is worth {:.3} px of the projection at 15 m.", s.worth_px))
            }
        }
        figure {
            (figures::profiles(c))
            p.caption { "The board's sections through its middle: along the rows (line) and across them (dashes)." }
        }
    }
}

fn pictures(c: &Calibration, names: &[&str], left_out: &[Option<String>]) -> Markup {
    let mut grid = Grid::new(&["<picture", "points", "rms / px", "tilt / deg", "<left out"]);
    for (k, name) in names.iter().enumerate() {
        grid.push(vec![
            (*name).to_owned(),
            c.view_points[k].to_string(),
            fixed(c.view_rms_px[k], 4),
            fixed(c.tilt_deg[k], 1),
            left_out[k].clone().unwrap_or_default(),
        ]);
    }
    scroll(&grid)
}
