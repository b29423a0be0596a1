//! Is it good enough to fly? In words that tell what to do.

use nalgebra::Vector2;

use super::quality::ProjectionUncertainty;
use super::{Calibration, ImageRejection};

/// The judgement over a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Fly with it.
    Good,
    /// Usable, with the reasons in mind.
    Poor,
    /// Not a camera.
    Refused,
}

impl Verdict {
    /// A pattern of the residuals beyond which a lens model does not do, px.
    pub(super) const PATTERN_PX: f64 = GOOD_PX;

    /// As written: `good`, `poor`, `refused`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Poor => "poor",
            Self::Refused => "refused",
        }
    }
}

/// Markers at 15 m are measured to about a tenth of a pixel, and this is the error that the camera may
/// add to all of them alike, px (the rms that rendered boards must keep for the small camera).
const GOOD_PX: f64 = 0.25;
/// Ten times that: 1 mm at 15 m becomes 1 cm, more than a survey of the ground would forgive.
const REFUSED_PX: f64 = 2.5;
/// A corner's fit that is this far off is no noise, px: corners come to a few hundredths, in poor
/// light and compressed to some tenths.
const POOR_RMS_PX: f64 = 0.75;
/// As far off as a fisheye seen through Brown's model or a board with another spacing, px.
const REFUSED_RMS_PX: f64 = 2.0;
/// Share of the rms that must be common for the residuals to have a pattern: a tenth of the squares.
const PATTERN_SHARE: f64 = 0.316;
/// Ratio of two halves' difference to its prediction that chance does not reach.
const HALVES: f64 = 3.0;
/// Board and image plane: below this tilt, perspective hardly tells camera constant from distance, degrees.
const TILT_DEG: f64 = 15.0;
/// Boards that are tilted by 20 to 40 degrees to all sides lie some 30 degrees rms from their mean; a third of that is
/// one side only, degrees.
const PARALLEL_DEG: f64 = 10.0;

/// The verdict with its reasons, the gravest first; `board` is what shows that it is not as described.
pub fn judge_calibration(calibration: &Calibration, board: Option<String>) -> (Verdict, Vec<String>) {
    let found = collect_findings(calibration, board);
    let verdict = found.first().map_or(Verdict::Good, |f| f.0);
    (verdict, found.into_iter().map(|f| f.1).collect())
}

/// Of the reasons of [`judge`] so many refuse the calibration.
pub fn count_refusals(calibration: &Calibration, board: Option<String>) -> usize {
    collect_findings(calibration, board).iter().filter(|f| f.0 == Verdict::Refused).count()
}

/// The gravest first.
fn collect_findings(calibration: &Calibration, board: Option<String>) -> Vec<(Verdict, String)> {
    let mut found: Vec<(Verdict, String)> = [
        board.map(|reason| (Verdict::Refused, reason)),
        residual_finding(calibration),
        fold_finding(calibration),
        stretch_finding(calibration),
        halves_finding(calibration),
        rejection_finding(calibration),
        coverage_finding(calibration),
    ]
    .into_iter()
    .flatten()
    .collect();
    found.extend(uncertainty_finding(calibration));
    found.sort_by_key(|(verdict, _)| std::cmp::Reverse(*verdict));
    found
}

fn fold_finding(c: &Calibration) -> Option<(Verdict, String)> {
    if c.projections.is_some() {
        return None;
    }
    let (lens, corner, shown_px) = (&c.lens, c.farthest_corner_px(), c.shown_px);
    let middle = Vector2::new(lens.cx, lens.cy);
    let folds = |k: &i32| lens.ray(&(middle + corner * (f64::from(*k) / 100.0))).is_err();
    let fold_px = (1..=100).find(folds).map_or(corner.norm(), |k| corner.norm() * f64::from(k) / 100.0);
    let why = if !c.covers_corner() {
        "nothing told the lens's distortion out there: show the board in all corners of the image, or let --select drop \
         the terms that the pictures do not tell"
    } else {
        "neither Brown's model nor the rational one fits this lens: take one that is less wide"
    };
    let text = format!(
        "the lens model has no inverse over the whole image: it folds at {fold_px:.0} px from the principal point, the \
         image's corners lie at {:.0} px, and boards were shown up to {shown_px:.0} px; {why}",
        corner.norm()
    );
    Some((Verdict::Refused, text))
}

fn residual_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let verdict = match (c.rms_px, c.pattern.image_px.max(c.pattern.board_px)) {
        (r, _) if r > REFUSED_RMS_PX => Verdict::Refused,
        (r, _) if r > POOR_RMS_PX => Verdict::Poor,
        (_, pattern) if pattern > GOOD_PX => Verdict::Poor,
        _ => return None,
    };
    Some((verdict, format!("the points are {:.2} px rms off: {}", c.rms_px, residual_cause(c))))
}

/// What the residuals follow: the place in the image, the place on the board, both (the stronger first), or neither.
fn residual_cause(c: &Calibration) -> String {
    let (image, board) = (c.pattern.image_px, c.pattern.board_px);
    let lens = format!(
        "the place in the image ({image:.2} px): {} does not fit this lens (a fisheye, or one that is too wide for it)",
        model_name(c)
    );
    let shape = format!(
        "the place on the board ({board:.2} px): it is not as described (count its rows and columns, measure a square \
         or a tag and the gap), or it is bent in more than a bow"
    );
    let mut found: Vec<(f64, String)> = vec![(image, lens), (board, shape)];
    found.retain(|(pattern, _)| *pattern >= PATTERN_SHARE * c.rms_px);
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let told: Vec<String> = found.into_iter().map(|(_, text)| text).collect();
    if told.is_empty() {
        return "they follow neither the image nor the board; the pictures are blurred, dark or compressed, or the \
                board moved while they were taken, or it is not as described"
            .to_owned();
    }
    format!("they follow {}", told.join("; and "))
}

fn model_name(c: &Calibration) -> &'static str {
    if c.lens.denominator == [0.0; 3] { "Brown's model" } else { "the rational model" }
}

/// Where two halves of the pictures differ by more than their standard deviations let expect, those are no
/// standard deviations.
fn halves_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let h = c.halves.filter(|h| h.difference_px > HALVES * h.predicted_px)?;
    let times = h.difference_px / h.predicted_px;
    let why = if c.pattern.image_px.max(c.pattern.board_px) > PATTERN_SHARE * c.rms_px {
        format!("the residuals ({:.2} px rms) are not random: {}", c.rms_px, residual_cause(c))
    } else {
        "zoom, focus or the board's shape changed on the way; tape the rings, use a stiff board".to_owned()
    };
    let text = format!(
        "two halves of the pictures give two cameras that differ by {:.2} px at {} m, {times:.1} times what their standard \
         deviations let expect: take these for {times:.0} times as large. The cause: {why}",
        h.difference_px, h.distance_m,
    );
    Some((Verdict::Poor, text))
}

/// Standard deviations beyond which a stretch is no chance.
const STRETCHED: f64 = 3.0;

/// A board that is longer one way than described pulls the camera constants apart.
fn stretch_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let s = c.stretch?;
    let percent = 100.0 * s.value;
    let text = match s.stated {
        Some(stated) if s.value.abs() > STRETCHED * stated.hypot(s.sigma) => format!(
            "the board is stretched across its rows against along them by {percent:+.2} %, more than its scale_sigma \
             lets expect: measure it both ways, over many squares, and mend its description"
        ),
        None if s.value.abs() > STRETCHED * s.sigma && s.worth_px > GOOD_PX => format!(
            "the pictures fit better to a board that is stretched across its rows against along them by {percent:+.2} % \
             ({:.1} standard deviations), with a camera {:.2} px away: measure the board both ways, over many squares; where it was \
             printed to a tolerance only, state scale_sigma in its description",
            s.value.abs() / s.sigma,
            s.worth_px
        ),
        _ => return None,
    };
    Some((Verdict::Poor, text))
}

fn rejection_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let other = c.dropped.iter().flatten().filter(|d| !matches!(d, ImageRejection::TooFewPoints { .. })).count();
    let seen = c.dropped.iter().filter(|d| !matches!(d, Some(ImageRejection::TooFewPoints { .. }))).count();
    (3 * other >= seen && other > 0).then(|| {
        let text = format!(
            "{other} of {seen} pictures with a board do not fit the others: was zoom or focus moved? Tape both \
             rings and take all pictures again"
        );
        (Verdict::Poor, text)
    })
}

/// Where no board was, the distortion is the model's guess: its standard deviation holds only if the
/// lens is exactly the model.
fn coverage_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let empty: Vec<&str> =
        (0..9).filter(|k| c.coverage[k / 3][k % 3] == 0).map(|k| region_name(k % 3, k / 3)).collect();
    (!empty.is_empty()).then(|| {
        let text =
            format!("no board was shown in these parts of the image: {}; show it there", empty.join(", "));
        (Verdict::Poor, text)
    })
}

/// The uncertainty in the picture, and what would lessen it.
fn uncertainty_finding(c: &Calibration) -> Option<(Verdict, String)> {
    let grade = |p: &&ProjectionUncertainty| p.sigma_px > GOOD_PX || p.worst_sigma_px > 2.0 * GOOD_PX;
    let worst =
        c.projections.iter().flatten().filter(grade).max_by(|a, b| a.sigma_px.total_cmp(&b.sigma_px))?;
    let verdict = if worst.sigma_px > REFUSED_PX { Verdict::Refused } else { Verdict::Poor };
    let tilted = c.tilt_deg.iter().flatten().filter(|t| **t > TILT_DEG).count();
    let what = if tilted < 3 {
        format!(
            "only {tilted} pictures show the board tilted by more than {TILT_DEG} degrees; tilt it by 20 to 40"
        )
    } else if c.spread_deg < PARALLEL_DEG {
        format!(
            "all boards face nearly the same way ({:.0} degrees rms from their mean), and parallel boards tell no more than \
             one; tilt it by 20 to 40 degrees to different sides",
            c.spread_deg
        )
    } else {
        format!(
            "show the board some times more in the {} of the image, tilted",
            region_name(worst.worst.0, worst.worst.1)
        )
    };
    let text = format!(
        "a point at {} m is projected to {:.2} px only ({:.2} px in the {}); {what}",
        worst.distance_m,
        worst.sigma_px,
        worst.worst_sigma_px,
        region_name(worst.worst.0, worst.worst.1)
    );
    Some((verdict, text))
}

fn region_name(column: usize, row: usize) -> &'static str {
    [
        ["upper left", "upper middle", "upper right"],
        ["left", "middle", "right"],
        ["lower left", "lower middle", "lower right"],
    ][row.min(2)][column.min(2)]
}
