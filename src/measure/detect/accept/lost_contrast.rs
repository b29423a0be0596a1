//! What takes contrast from a marker and adds no light, as frost, drops and dirt on the pane or a fluid on the skin, brings a
//! share of its light another way. No residual tells how far aside that light comes from; what still looks like an edge has come
//! within about the blur of its own place, so the place is doubted by that share of the blur.
//!
//! Quadrants tell the share: black and white are printed on one sheet, and show it in the same light. A film of water, or another
//! part of the frost, shifts what shows nothing of it: where several quadrants lose contrast, all of the frame's markers are
//! doubted by what those lose.

use nalgebra::Matrix2;

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::LOST;
use crate::detect::detection::covariance::CovarianceSource;
use crate::detect::estimate::options::PRIOR;
use crate::estimation::robust::median;
use crate::setup::Shape;

/// Adds that to the covariances; by how much any marker of the frame is doubted, px.
pub fn inflate_for_lost_contrast(measured: &mut [MeasuredMarker]) -> f64 {
    let lost = lost_fractions(measured);
    let of_frame =
        median(measured.iter().map(|m| m.blur).collect()).map_or(0.0, |blur| blur * frame_loss(&lost));
    for (marker, lost) in measured.iter_mut().zip(lost) {
        add_lost_contrast(marker, of_frame.max(lost.unwrap_or(0.0) * marker.blur));
    }
    of_frame
}

/// Doubts a marker's place, px.
pub fn add_lost_contrast(marker: &mut MeasuredMarker, by_px: f64) {
    marker.detection.covariance_px2.add(CovarianceSource::LostContrast, Matrix2::identity() * by_px * by_px);
}

/// What several quadrants lose, root mean square over all of them; 0 where it is one, on which something may lie.
fn frame_loss(lost: &[Option<f64>]) -> f64 {
    let shares: Vec<f64> = lost.iter().copied().flatten().collect();
    if shares.iter().filter(|share| **share > 0.0).count() < LOST.several {
        return 0.0;
    }
    (shares.iter().map(|share| share * share).sum::<f64>() / shares.len() as f64).sqrt()
}

/// Of quadrants the share of contrast that they have lost against the frame's others: of the darkness of black as well as of what
/// it takes from the light. A reflection adds light and leaves the latter, and shade leaves the former.
fn lost_fractions(measured: &[MeasuredMarker]) -> Vec<Option<f64>> {
    let told: Vec<Option<[f64; 2]>> = measured.iter().map(quadrant_contrasts).collect();
    let among = |k: usize| {
        let mut all: Vec<f64> = told.iter().flatten().map(|own| own[k]).collect();
        all.sort_by(|a, b| b.total_cmp(a));
        all
    };
    let (darkness, taken) = (among(0), among(1));
    let usual = median(taken).filter(|_| darkness.len() >= LOST.least);
    let (Some(usual), Some(full)) = (usual, darkness.get(darkness.len() / 4)) else {
        return vec![None; measured.len()];
    };
    let share = |[dark, taken]: [f64; 2]| (1.0 - dark / full).min(1.0 - taken / usual);
    told.iter().map(|own| own.map(share).map(|share| if share > LOST.chance { share } else { 0.0 })).collect()
}

/// Of quadrants the share of light that black takes away, and what that is of the lightest grey.
fn quadrant_contrasts(marker: &MeasuredMarker) -> Option<[f64; 2]> {
    let tells = marker.detection.shape == Shape::Quadrant && !marker.through_glare;
    let white = marker.detection.contrast / (marker.darkness * f64::from(u8::MAX));
    (tells && white > 0.0).then(|| [marker.dark, marker.dark * white.powf(1.0 / PRIOR.gamma.value)])
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::detect::detection::Detection;
    use crate::detect::estimate::prior::darkness_for_grey_ratio;

    /// Quadrants whose white and black have some grey values.
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
            };
            let dark = darkness_for_grey_ratio(black / white);
            MeasuredMarker { blur: 0.8, darkness: contrast / white, dark, ..MeasuredMarker::whole(detection) }
        };
        greys.iter().enumerate().map(one).collect()
    }

    fn doubts(greys: &[(f64, f64)]) -> (f64, Vec<f64>) {
        let mut all = quadrants(greys);
        let frame = inflate_for_lost_contrast(&mut all);
        (
            frame,
            all.iter().map(|m| m.detection.covariance_px2.of(CovarianceSource::LostContrast)[(0, 0)].sqrt()).collect(),
        )
    }

    /// White and black of a clear frame's quadrants, grey levels: two lights, and the scatter of rendered frames.
    const CLEAR: [(f64, f64); 6] =
        [(203.0, 88.0), (186.0, 80.0), (204.0, 90.0), (184.0, 78.0), (205.0, 89.0), (183.0, 80.0)];

    #[test]
    fn what_scatters_light_doubts_all_and_most_what_it_covers() {
        assert_eq!(doubts(&CLEAR), (0.0, vec![0.0; 6]));
        let mut frosted = CLEAR;
        (frosted[1], frosted[2]) = ((170.0, 112.0), (186.0, 120.0));
        let (frame, own) = doubts(&frosted);
        assert!(
            (0.08..0.3).contains(&frame) && own[0] == frame && own[1] > frame && own[2] > frame,
            "{frame}, {own:?}"
        );
        // On one alone something may lie.
        frosted[1] = CLEAR[1];
        let (frame, own) = doubts(&frosted);
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
            doubts(&all).0
        };
        assert_eq!([with(&|light| 0.5 * light), with(&|light| light + 0.15)], [0.0; 2]);
        assert!(with(&|light| 0.6 * light + 0.1) > 0.1);
    }
}
