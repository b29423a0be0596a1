//! Verdict on a calibration, with reasons and remedies in plain sentences.

use nalgebra::Vector2;

use super::quality::ProjectionUncertainty;
use super::{Calibration, ImageRejection};
use crate::ordering::sort_by_value;

/// Verdict on a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Fit for flight.
    Good,
    /// Usable with limitations.
    Poor,
    /// Not usable.
    Refused,
}

impl Verdict {
    /// Residual pattern above which a lens model does not fit, px.
    pub(super) const PATTERN_PX: f64 = GOOD_PX;

    /// Returns the word used in files: `good`, `poor`, `refused`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Poor => "poor",
            Self::Refused => "refused",
        }
    }
}

/// Error that the camera may add to all markers in common, px (the rms required of rendered boards for the small camera).
/// Markers at 15 m are measured to about 0.1 px.
const GOOD_PX: f64 = 0.25;
/// Ten times the good limit: 1 mm at 15 m becomes 1 cm, more than the survey could compensate.
const REFUSED_PX: f64 = 2.5;
/// Rms of the corner fit that is too large for noise, px: corners have a few hundredths, in poor light and compressed some
/// tenths.
const POOR_RMS_PX: f64 = 0.75;
/// Rms typical for a fisheye seen through Brown's model, or a board with another spacing, px.
const REFUSED_RMS_PX: f64 = 2.0;
/// Part of the rms that must be systematic for the residuals to have a pattern: 10 % of the variance.
const PATTERN_FRACTION: f64 = 0.316;
/// Maximum ratio of the halves' difference to its prediction that random errors cause.
const MAX_HALVES_RATIO: f64 = 3.0;
/// Tilt of the board against the image plane below which perspective hardly separates focal length and distance,
/// degrees.
const MIN_TILT_DEG: f64 = 15.0;
/// Spread of the boards' normals below which they are tilted to one side only, degrees rms. Boards tilted by 20 to 40
/// degrees to all sides have about 30 degrees.
const MIN_SPREAD_DEG: f64 = 10.0;

/// Returns the verdict with its reasons, the most serious first; `board` is the difference of the board from its
/// description.
pub fn judge_calibration(
    calibration: &Calibration,
    board: Option<String>,
) -> (Verdict, Vec<String>) {
    let found = collect_findings(calibration, board);
    let verdict = found.first().map_or(Verdict::Good, |f| f.0);
    (verdict, found.into_iter().map(|f| f.1).collect())
}

/// Counts the reasons of [`judge_calibration`] that refuse the calibration.
pub fn count_refusals(calibration: &Calibration, board: Option<String>) -> usize {
    collect_findings(calibration, board)
        .iter()
        .filter(|f| f.0 == Verdict::Refused)
        .count()
}

/// Collects the findings, the most serious first.
fn collect_findings(calibration: &Calibration, board: Option<String>) -> Vec<(Verdict, String)> {
    let mut found: Vec<(Verdict, String)> = [
        board.map(|reason| (Verdict::Refused, reason)),
        large_residual_finding(calibration),
        distortion_fold_finding(calibration),
        stretch_finding(calibration),
        halves_finding(calibration),
        rejected_images_finding(calibration),
        coverage_finding(calibration),
    ]
    .into_iter()
    .flatten()
    .collect();
    found.extend(uncertainty_finding(calibration));
    found.sort_by_key(|(verdict, _)| std::cmp::Reverse(*verdict));
    found
}

fn distortion_fold_finding(c: &Calibration) -> Option<(Verdict, String)> {
    if c.projections.is_some() {
        return None;
    }
    let (lens, corner, shown_px) = (&c.lens, c.farthest_corner_px(), c.covered_radius_px);
    let middle = Vector2::new(lens.cx, lens.cy);
    let folds = |k: &i32| {
        lens.ray(&(middle + corner * (f64::from(*k) / 100.0)))
            .is_err()
    };
    let fold_px = (1..=100)
        .find(folds)
        .map_or(corner.norm(), |k| corner.norm() * f64::from(k) / 100.0);
    let why = if !c.covers_corner() {
        "the distortion is unconstrained there. Show the board in every corner of the image, or use \
         --select to drop insignificant terms"
    } else {
        "neither Brown's model nor the rational model fits this lens. Use a less wide one"
    };
    let text = format!(
        "the lens model cannot be inverted over the whole image: it folds at {fold_px:.0} px from the \
         principal point; the image's corners are at {:.0} px, and boards were shown up to {shown_px:.0} \
         px; {why}",
        corner.norm()
    );
    Some((Verdict::Refused, text))
}

fn large_residual_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let verdict = match (c.rms_px, c.pattern.image_px.max(c.pattern.board_px)) {
        (r, _) if r > REFUSED_RMS_PX => Verdict::Refused,
        (r, _) if r > POOR_RMS_PX => Verdict::Poor,
        (_, pattern) if pattern > GOOD_PX => Verdict::Poor,
        _ => return None,
    };
    Some((
        verdict,
        format!(
            "the residuals are {:.2} px rms: {}",
            c.rms_px,
            residual_cause(c)
        ),
    ))
}

/// Describes the dependence of the residuals: on the position in the image, on the board, both (the stronger first), or
/// neither.
fn residual_cause(c: &Calibration) -> String {
    let (image, board) = (c.pattern.image_px, c.pattern.board_px);
    let lens = format!(
        "the position in the image ({image:.2} px): {} does not fit this lens (a fisheye, or too wide)",
        distortion_model_name(c)
    );
    let shape = format!(
        "the position on the board ({board:.2} px): the board is not as described (count its rows and \
         columns, measure a square or a tag and the gap), or its bend is not a simple bow"
    );
    let mut found: Vec<(f64, String)> = vec![(image, lens), (board, shape)];
    found.retain(|(pattern, _)| *pattern >= PATTERN_FRACTION * c.rms_px);
    sort_by_value(&mut found, |one| -one.0);
    let causes: Vec<String> = found.into_iter().map(|(_, text)| text).collect();
    if causes.is_empty() {
        return "they depend neither on the position in the image nor on the board: the images are blurred, \
                dark or compressed, the board moved during the exposure, or it is not as described"
            .to_owned();
    }
    format!("they depend on {}", causes.join("; and "))
}

fn distortion_model_name(c: &Calibration) -> &'static str {
    if c.lens.denominator == [0.0; 3] {
        "Brown's model"
    } else {
        "the rational model"
    }
}

/// Compares two halves of the images: if they differ by more than expected, the standard deviations are too small.
fn halves_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let h = c
        .halves
        .filter(|h| h.difference_px > MAX_HALVES_RATIO * h.predicted_px)?;
    let times = h.difference_px / h.predicted_px;
    let why = if c.pattern.image_px.max(c.pattern.board_px) > PATTERN_FRACTION * c.rms_px {
        format!(
            "the residuals ({:.2} px rms) are not random: {}",
            c.rms_px,
            residual_cause(c)
        )
    } else {
        "zoom, focus or the board's shape changed between the images; tape the rings and use a stiff board".to_owned()
    };
    let text = format!(
        "the cameras from two halves of the images differ by {:.2} px at {} m, {times:.1} times the \
         difference expected: the standard deviations are too small by a factor of about {times:.0}. \
         Cause: {why}",
        h.difference_px, h.distance_m,
    );
    Some((Verdict::Poor, text))
}

/// Multiple of the standard deviation above which a stretch is significant.
const MAX_STRETCH_SIGMAS: f64 = 3.0;

/// Reports a stretched board, which distorts the ratio of the focal lengths.
fn stretch_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let s = c.stretch?;
    let percent = 100.0 * s.value;
    let text = match s.prior_sigma {
        Some(stated) if s.value.abs() > MAX_STRETCH_SIGMAS * stated.hypot(s.sigma) => format!(
            "the board is longer across its rows than along them by {percent:+.2} %, more than its \
             scale_sigma allows: measure it in both directions over many squares, and correct its \
             description"
        ),
        None if s.value.abs() > MAX_STRETCH_SIGMAS * s.sigma
            && s.projection_change_px > GOOD_PX =>
        {
            format!(
                "the images fit better to a board that is longer across its rows than along them by \
             {percent:+.2} % ({:.1} standard deviations); it changes the projection by {:.2} px. Measure \
             the board in both directions over many squares; if it is printed to a tolerance only, give \
             scale_sigma in its description",
                s.value.abs() / s.sigma,
                s.projection_change_px
            )
        }
        _ => return None,
    };
    Some((Verdict::Poor, text))
}

fn rejected_images_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let other = c
        .rejections
        .iter()
        .flatten()
        .filter(|d| !matches!(d, ImageRejection::TooFewPoints { .. }))
        .count();
    let seen = c
        .rejections
        .iter()
        .filter(|d| !matches!(d, Some(ImageRejection::TooFewPoints { .. })))
        .count();
    (3 * other >= seen && other > 0).then(|| {
        let text = format!(
            "{other} of {seen} images of the board do not fit the others: was zoom or focus changed? Tape \
             both rings and take all images again"
        );
        (Verdict::Poor, text)
    })
}

/// Reports parts of the image without a board: there the distortion is extrapolated, and its standard deviation assumes
/// that the lens follows the model exactly.
fn coverage_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let empty: Vec<&str> = (0..9)
        .filter(|k| c.coverage[k / 3][k % 3] == 0)
        .map(|k| image_region_name(k % 3, k / 3))
        .collect();
    (!empty.is_empty()).then(|| {
        let text = format!(
            "the board was not shown in these parts of the image: {}; show it there",
            empty.join(", ")
        );
        (Verdict::Poor, text)
    })
}

/// Reports the projection uncertainty, with a remedy.
fn uncertainty_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let grade =
        |p: &&ProjectionUncertainty| p.sigma_px > GOOD_PX || p.worst_sigma_px > 2.0 * GOOD_PX;
    let worst = c
        .projections
        .iter()
        .flatten()
        .filter(grade)
        .max_by(|a, b| a.sigma_px.total_cmp(&b.sigma_px))?;
    let verdict = if worst.sigma_px > REFUSED_PX {
        Verdict::Refused
    } else {
        Verdict::Poor
    };
    let tilted = c
        .tilt_deg
        .iter()
        .flatten()
        .filter(|t| **t > MIN_TILT_DEG)
        .count();
    let remedy = if tilted < 3 {
        format!(
            "only {tilted} images show the board tilted by more than {MIN_TILT_DEG} degrees; tilt it by 20 \
             to 40"
        )
    } else if c.spread_deg < MIN_SPREAD_DEG {
        format!(
            "the board has nearly the same tilt in all images ({:.0} degrees rms from the mean), and \
             parallel boards add no information; tilt it by 20 to 40 degrees to \
             different sides",
            c.spread_deg
        )
    } else {
        format!(
            "take more images with a tilted board in the {} of the image",
            image_region_name(worst.worst.0, worst.worst.1)
        )
    };
    let text = format!(
        "a point at {} m is projected with a standard deviation of {:.2} px ({:.2} px in the {}); {remedy}",
        worst.distance_m,
        worst.sigma_px,
        worst.worst_sigma_px,
        image_region_name(worst.worst.0, worst.worst.1)
    );
    Some((verdict, text))
}

fn image_region_name(column: usize, row: usize) -> &'static str {
    [
        ["upper left", "upper middle", "upper right"],
        ["left", "middle", "right"],
        ["lower left", "lower middle", "lower right"],
    ][row.min(2)][column.min(2)]
}
