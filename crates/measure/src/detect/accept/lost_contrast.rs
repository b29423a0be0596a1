//! Loss of contrast without additional light, as frost, drops and dirt on the pane or a fluid on the skin cause it.
//!
//! Such a cause sends a fraction of a marker's light along another path. The residuals do not show how far that light is
//! displaced; if it still looks like an edge, its displacement is about the blur or less. The position therefore gets a
//! standard deviation of that fraction of the blur.
//!
//! The fraction is determined from quadrants: their black and white are printed on one sheet and lie in the same light. A
//! film of water, or another part of the frost, can shift markers that show no loss. If several quadrants lose contrast,
//! all of the frame's markers get the standard deviation of the mean loss.

use nalgebra::Matrix2;

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::LOST;
use crate::detect::detection::covariance::CovarianceSource;
use crate::detect::estimate::options::PRIOR;
use crate::detect::numbers::MIN_GROUP;
use crate::estimation::robust::median;
use crate::setup::Shape;

/// Adds the variance due to lost contrast to the markers' covariances. Returns the standard deviation added to all markers
/// of the frame, px.
pub fn inflate_for_lost_contrast(measured: &mut [MeasuredMarker]) -> f64 {
    let lost = lost_fractions(measured);
    let of_frame = median(measured.iter().map(|m| m.blur).collect())
        .map_or(0.0, |blur| blur * frame_loss(&lost));
    for (marker, lost) in measured.iter_mut().zip(lost) {
        add_lost_contrast(marker, of_frame.max(lost.unwrap_or(0.0) * marker.blur));
    }
    of_frame
}

/// Adds an isotropic variance due to lost contrast to a marker, from its standard deviation, px.
pub fn add_lost_contrast(marker: &mut MeasuredMarker, by_px: f64) {
    marker.detection.covariance_px2.add(
        CovarianceSource::LostContrast,
        Matrix2::identity() * by_px * by_px,
    );
}

/// Returns the root mean square of the quadrants' lost contrast, as a fraction; 0 if fewer than two are
/// affected, because a single one may just be covered.
fn frame_loss(lost: &[Option<f64>]) -> f64 {
    let fractions: Vec<f64> = lost.iter().copied().flatten().collect();
    if fractions.iter().filter(|fraction| **fraction > 0.0).count() < 2 {
        return 0.0;
    }
    (fractions
        .iter()
        .map(|fraction| fraction * fraction)
        .sum::<f64>()
        / fractions.len() as f64)
        .sqrt()
}

/// Returns the fraction of contrast that each quadrant target has lost compared with the frame's others, `None` for other
/// markers. The loss is the smaller one of two: of the darkness of black, and of the light that black absorbs. A reflection
/// adds light and leaves the latter unchanged, shade leaves the former unchanged.
fn lost_fractions(measured: &[MeasuredMarker]) -> Vec<Option<f64>> {
    let contrasts: Vec<Option<[f64; 2]>> = measured.iter().map(quadrant_contrasts).collect();
    let sorted = |k: usize| {
        let mut all: Vec<f64> = contrasts.iter().flatten().map(|own| own[k]).collect();
        all.sort_by(|a, b| b.total_cmp(a));
        all
    };
    let (darkness, taken) = (sorted(0), sorted(1));
    let typical = median(taken).filter(|_| darkness.len() >= MIN_GROUP);
    let (Some(typical), Some(full)) = (typical, darkness.get(darkness.len() / 4)) else {
        return vec![None; measured.len()];
    };
    let fraction = |[dark, taken]: [f64; 2]| (1.0 - dark / full).min(1.0 - taken / typical);
    contrasts
        .iter()
        .map(|own| {
            own.map(fraction).map(|fraction| {
                if fraction > LOST.chance_fraction {
                    fraction
                } else {
                    0.0
                }
            })
        })
        .collect()
}

/// Returns the fraction of light that black absorbs, and that fraction times the light of white (as a fraction of the
/// lightest grey); `None` for other markers than quadrants.
fn quadrant_contrasts(marker: &MeasuredMarker) -> Option<[f64; 2]> {
    let is_usable = marker.detection.shape == Shape::Quadrant && !marker.through_glare;
    let white = marker.detection.contrast / (marker.darkness * f64::from(u8::MAX));
    (is_usable && white > 0.0).then(|| {
        [
            marker.dark,
            marker.dark * white.powf(1.0 / PRIOR.gamma.value),
        ]
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::detect::detection::Detection;
    use crate::detect::estimate::prior::darkness_for_grey_ratio;

    /// Builds quadrants from the grey values of white and black.
    fn quadrants(greys: &[(f64, f64)]) -> Vec<MeasuredMarker> {
        let one = |(k, (white, black)): (usize, &(f64, f64))| {
            let contrast = white - black;
            let detection = Detection {
                shape: Shape::Quadrant,
                centre_px: Vector2::new(300.0 * k as f64, 50.0),
                covariance_px2: (Matrix2::identity() * 1e-4).into(),
                semi_major_px: 60.0,
                semi_minor_px: 12.0,
                angle_rad: 0.0,
                fit_rms: 1.0,
                contrast,
                marker: None,
            };
            let dark = darkness_for_grey_ratio(black / white);
            MeasuredMarker {
                blur: 0.8,
                darkness: contrast / white,
                dark,
                ..MeasuredMarker::whole(detection)
            }
        };
        greys.iter().enumerate().map(one).collect()
    }

    fn inflations(greys: &[(f64, f64)]) -> (f64, Vec<f64>) {
        let mut all = quadrants(greys);
        let frame = inflate_for_lost_contrast(&mut all);
        (
            frame,
            all.iter()
                .map(|m| {
                    m.detection
                        .covariance_px2
                        .contribution(CovarianceSource::LostContrast)[(0, 0)]
                        .sqrt()
                })
                .collect(),
        )
    }

    /// White and black of a clear frame's quadrants, grey levels: two illuminations, with the scatter of rendered frames.
    const CLEAR: [(f64, f64); 6] = [
        (203.0, 88.0),
        (186.0, 80.0),
        (204.0, 90.0),
        (184.0, 78.0),
        (205.0, 89.0),
        (183.0, 80.0),
    ];

    #[test]
    fn scattered_light_inflates_all_markers_and_most_the_covered_ones() {
        assert_eq!(inflations(&CLEAR), (0.0, vec![0.0; 6]));
        let mut frosted = CLEAR;
        (frosted[1], frosted[2]) = ((170.0, 112.0), (186.0, 120.0));
        let (frame, own) = inflations(&frosted);
        assert!(
            (0.08..0.3).contains(&frame) && own[0] == frame && own[1] > frame && own[2] > frame,
            "{frame}, {own:?}"
        );
        // A single affected marker may just be covered.
        frosted[1] = CLEAR[1];
        let (frame, own) = inflations(&frosted);
        assert!(
            frame == 0.0 && own[2] > 0.1 && own.iter().filter(|px| **px > 0.0).count() == 1,
            "{frame}, {own:?}"
        );
    }

    #[test]
    fn shade_and_reflections_take_no_contrast() {
        let light = |grey: f64| (grey / 255.0).powf(2.2);
        let grey = |light: f64| 255.0 * light.powf(1.0 / 2.2);
        let with = |change: &dyn Fn(f64) -> f64| {
            let mut all = CLEAR;
            for (white, black) in &mut all[1..3] {
                (*white, *black) = (grey(change(light(*white))), grey(change(light(*black))));
            }
            inflations(&all).0
        };
        assert_eq!(
            [with(&|light| 0.5 * light), with(&|light| light + 0.15)],
            [0.0; 2]
        );
        assert!(with(&|light| 0.6 * light + 0.1) > 0.1);
    }
}
