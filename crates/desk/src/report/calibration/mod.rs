//! Page of a calibration: verdict, parameters, images and residuals.

mod figures;

use crate::report::standalone_page;
use maud::{Markup, html};
use wingd_evaluation::grid::Grid;
use wingd_evaluation::number::{count_text, format_fixed, format_rounded};
use wingd_measure::calibrate::Calibration;
use wingd_measure::calibrate::Verdict;
use wingd_measure::geometry::Lens;

/// Index of k1 in [`Lens::PARAMETERS`].
pub const FIRST_DISTORTION: usize = 4;
/// Ratio of value to sigma that is significant at 95 %. With hundreds of points, Student's t equals the normal
/// distribution.
pub const SIGNIFICANT_RATIO: f64 = 1.96;

/// Returns the values in the order of [`Lens::PARAMETERS`].
pub fn parameter_values(c: &Calibration) -> [f64; 9] {
    c.lens.parameters().into()
}

/// Returns the correlation of two parameters; `None` if one of them was fixed.
fn parameter_correlation(c: &Calibration, one: usize, other: usize) -> Option<f64> {
    let product = (c.covariance[(one, one)] * c.covariance[(other, other)]).sqrt();
    (product > 0.0).then(|| c.covariance[(one, other)] / product)
}

/// Returns the complete page, without external resources. `accepted` is the reason for accepting a rejected calibration;
/// `names` and `excluded` have one entry per image.
pub fn calibration_page(
    c: &Calibration,
    (verdict, accepted): (Verdict, Option<&str>),
    reasons: &[String],
    names: &[&str],
    excluded: &[Option<String>],
) -> String {
    let main = html! {
        h1 { "Calibration: " (verdict.name()) }
        @if let Some(accepted) = accepted { p.warning { "Rejected, but accepted by the user: " (accepted) } }
        @for reason in reasons { p.warning { (reason) } }
        (summary_paragraph(c))
        h2 { "Projection uncertainty" } (figures::draw_uncertainty(c))
        h2 { "Coverage of the image" } (figures::draw_coverage(c))
        h2 { "Parameters" } (parameter_table(c)) (correlation_table(c))
        h2 { "Distortion" } (figures::draw_distortion(c))
        h2 { "Residuals over the image" } (figures::draw_residuals(c))
        h2 { "Shape of the board" } (board_section(c))
        h2 { "Images" } (image_table(c, names, excluded))
    };
    standalone_page(
        &format!("Calibration: {}", verdict.name()),
        &main,
        "Image coordinates in pixels; sigma is one standard deviation.",
    )
}

fn summary_paragraph(c: &Calibration) -> Markup {
    let used = c.view_rms_px.iter().flatten().count();
    html! {
        p {
            (used) " of " (count_text(c.view_rms_px.len(), "image")) " of " (c.lens.width) " x " (c.lens.height) " px, "
            (count_text(c.observations, "point")) ", rms "
            (format!("{:.4}", c.rms_px)) " px, of which " (format!("{:.4}", c.pattern.image_px))
            " px depend systematically on the position in the image and " (format!("{:.4}", c.pattern.board_px)) " px on the position on the board."
            @if let Some(h) = c.halves {
                " Calibrations from two halves of the images differ by " (format!("{:.3}", h.difference_px)) " px at " (h.distance_m)
                " m; expected from their standard deviations: " (format!("{:.3}", h.predicted_px)) " px."
            }
        }
    }
}

fn significance_text(significant: bool) -> String {
    if significant {
        "significant"
    } else {
        "not significant"
    }
    .to_owned()
}

fn parameter_table(c: &Calibration) -> Markup {
    let values = parameter_values(c);
    let mut grid = Grid::new(&["<parameter", "value", "sigma", "value / sigma", "<at 95 %"]);
    for (k, value) in values.iter().enumerate() {
        let sigma = c.covariance[(k, k)].max(0.0).sqrt();
        let t = (k >= FIRST_DISTORTION && sigma > 0.0).then(|| value / sigma);
        let digits = if k < FIRST_DISTORTION { 3 } else { 6 };
        grid.push(vec![
            Lens::PARAMETERS[k].to_owned(),
            format_fixed(Some(*value), digits),
            if c.fixed[k] {
                "fixed".to_owned()
            } else {
                format_fixed(Some(sigma), digits)
            },
            t.map_or(String::new(), |t| format_fixed(Some(t), 1)),
            t.map_or(String::new(), |t| {
                significance_text(t.abs() > SIGNIFICANT_RATIO)
            }),
        ]);
    }
    grid.html()
}

fn correlation_table(c: &Calibration) -> Markup {
    let denominator = |k: usize| {
        format!(
            "k{} {:.6} ± {:.6}",
            k + 4,
            c.lens.denominator[k],
            c.denominator_sigma[k]
        )
    };
    let correlation_text = |i: usize, j: usize| {
        parameter_correlation(c, i, j)
            .filter(|_| j <= i)
            .map_or(String::new(), |r| format!("{r:.2}"))
    };
    let mut titles = vec!["<correlation"];
    titles.extend(Lens::PARAMETERS);
    let mut grid = Grid::new(&titles);
    for (i, name) in Lens::PARAMETERS.iter().enumerate() {
        grid.push(
            std::iter::once((*name).to_owned())
                .chain((0..9).map(|j| correlation_text(i, j)))
                .collect(),
        );
    }
    html! {
        @if c.lens.denominator != [0.0; 3] {
            p {
                "A rational lens, with the denominator " (denominator(0)) ", " (denominator(1)) ", " (denominator(2))
                ". The standard deviations of the other parameters apply to this fixed denominator."
            }
        }
        (grid.html())
    }
}

fn board_section(c: &Calibration) -> Markup {
    let mut grid = Grid::new(&[
        "<direction",
        "side / m",
        "bow / mm",
        "sigma / mm",
        "<at 95 %",
    ]);
    for (k, name) in ["along the rows", "across them"].iter().enumerate() {
        let bow = &c.bow[k];
        let (height, sigma) = format_rounded(Some(1e3 * bow.value_m), Some(1e3 * bow.sigma_m), 3);
        let side = format_fixed(Some(c.board_side_m[k]), 3);
        grid.push(vec![
            (*name).to_owned(),
            side,
            height,
            sigma,
            significance_text(bow.is_significant()),
        ]);
    }
    html! {
        (grid.html())
        @if let Some(s) = c.stretch {
            p {
                (format!("Stretch across over along {:.4} ± {:.4} %", 1e2 * s.value, 1e2 * s.sigma)) ", "
                (significance_text(s.is_significant()))
                @if s.prior_sigma.is_some() { ": estimated in the calibration" } @else { ": tested only; the board is used as described" }
                (format!("; it changes the projection at 15 m by {:.3} px.", s.projection_change_px))
            }
        }
    }
}

fn image_table(c: &Calibration, names: &[&str], excluded: &[Option<String>]) -> Markup {
    let mut grid = Grid::new(&["<image", "points", "rms / px", "tilt / deg", "<excluded"]);
    for (k, name) in names.iter().enumerate() {
        grid.push(vec![
            (*name).to_owned(),
            c.view_points[k].to_string(),
            format_fixed(c.view_rms_px[k], 4),
            format_fixed(c.tilt_deg[k], 1),
            excluded[k].clone().unwrap_or_default(),
        ]);
    }
    grid.html()
}
