//! This page shows a calibration: its verdict, its parameters, its pictures and what its residuals look like.

mod figures;

use super::html::document;
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
        figure { (figures::profiles(c)) figcaption { "The board's sections through its middle, along and across, the height enlarged." } }
    }
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
