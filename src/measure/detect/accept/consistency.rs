//! Among a frame's detections each thing once, and nothing far smaller, softer or otherwise turned than the markers.

use super::better::is_preferred;
use super::found::FoundMarkers;
use super::verdict::MeasuredMarker;
use crate::detect::accept::options::CONSISTENCY;
use crate::detect::detection::{Detection, RejectReason};
use crate::detect::hypothesis::neighbours;
use crate::detect::image::ellipse::{Ellipse, half_turn};
use crate::setup::Shape;

/// Turns down a detection whose centre lies well within the outline of another one that is better:
/// one thing was seen at two levels.
pub fn reject_duplicates(found: &mut FoundMarkers) {
    reject_disc_pairs(found);
    let within = |one: &Detection, other: &Detection| {
        let most = if one.shape == other.shape { CONSISTENCY.within } else { CONSISTENCY.within_other };
        other.ellipse().normalized_radius(one.centre_px) < most
    };
    let mut i = 0;
    while let Some(one) = found.measured.get(i).map(|m| m.detection.clone()) {
        let beaten = found.measured.iter().enumerate().any(|(j, other)| {
            let other = &other.detection;
            let near = within(&one, other) || within(other, &one);
            let beats = || is_preferred(other, &one) || j < i && !is_preferred(&one, other);
            j != i && near && beats()
        });
        if beaten {
            found.reject(i, RejectReason::Duplicate);
        } else {
            i += 1;
        }
    }
}

/// Turns down quadrants in which two discs were found with skin between them: the black of quadrants meets. One of the two
/// was seen badly, else the pair was known for discs before it was measured (`Ladder::are_discs`); but no
/// worse than the quadrants, as their black parts are that pass for discs.
fn reject_disc_pairs(found: &mut FoundMarkers) {
    let discs = found.measured.iter().map(|m| &m.detection).filter(|d| d.shape == Shape::Circle);
    let discs: Vec<(Ellipse, f64)> = discs.map(|d| (d.ellipse(), d.fit_rms)).collect();
    found.reject_matching(RejectReason::Duplicate, |m| {
        let whole = m.detection.ellipse();
        let apart = |one: &Ellipse, other: &Ellipse| {
            let between = other.centre - one.centre;
            between.norm() - one.radius(between) - other.radius(between) > CONSISTENCY.apart_blurs * m.blur
        };
        let inside =
            discs.iter().filter(|(disc, rms)| whole.contains(disc.centre) && *rms < m.detection.fit_rms);
        let inside: Vec<&Ellipse> = inside.map(|(disc, _)| disc).collect();
        let two_apart = || (1..inside.len()).any(|i| inside[..i].iter().any(|other| apart(inside[i], other)));
        m.detection.shape == Shape::Quadrant && two_apart()
    });
}

/// One lens makes all the edges of a frame: one that is far softer than their median belongs to
/// dirt or to a shadow, unless it shows itself that it does not.
pub fn reject_blur_outliers(found: &mut FoundMarkers) {
    if let Some(softest) = blur_limit(found) {
        found.reject_matching(RejectReason::BlurOutlier, |m| {
            let Detection { shape, semi_minor_px, .. } = m.detection;
            m.blur > softest && !is_out_of_focus(shape, semi_minor_px, m.blur)
        });
    }
}

/// Whether an edge softer than the frame's others may be that of a marker out of focus, as those are that stand near the camera
/// while it is focused on the wing: quadrants whose edges are narrow beside themselves. Dirt and shadows are soft all through,
/// and show no four quadrants.
pub fn is_out_of_focus(shape: Shape, semi_minor_px: f64, blur: f64) -> bool {
    shape == Shape::Quadrant && semi_minor_px > CONSISTENCY.crisp_blurs * blur
}

/// The greatest blur of an edge that the frame's other ones allow, px, where there are some. Long edges count more: grain
/// beside the wing has many short ones.
pub fn blur_limit(found: &FoundMarkers) -> Option<f64> {
    if found.measured.len() < CONSISTENCY.blurs {
        return None;
    }
    let mut blurs: Vec<[f64; 2]> =
        found.measured.iter().map(|m| [m.blur, m.detection.semi_major_px]).collect();
    blurs.sort_unstable_by(|[one, _], [other, _]| one.total_cmp(other));
    let half = 0.5 * blurs.iter().map(|[_, length]| length).sum::<f64>();
    let mut sum = 0.0;
    let usual = blurs.iter().find(|[_, length]| {
        sum += length;
        sum >= half
    });
    usual.map(|[blur, _]| CONSISTENCY.softer * blur)
}

/// Flat markers on a skin that is about plane lie along one direction of the picture, that of its horizon, to a few tenths:
/// what is flat and lies across it is a seam's, a shadow's, or the edge's of something beside the wing.
pub fn reject_orientation_outliers(found: &mut FoundMarkers) {
    // Of each shape how flat it must be, and how far across it may lie, rad: quadrants near the camera up to 0.41.
    let flatter = |d: &Detection, than: f64| d.semi_major_px > than * d.semi_minor_px;
    let flat: Vec<&Detection> =
        found.measured.iter().map(|m| &m.detection).filter(|d| flatter(d, CONSISTENCY.flat)).collect();
    if flat.len() < CONSISTENCY.directions {
        return;
    }
    // Directions are the same after half a turn. Many small things beside the wing weigh no more than the markers on it.
    let (sin, cos) = flat.iter().fold((0.0, 0.0), |(sin, cos), d| {
        let (s, c) = (2.0 * d.angle_rad).sin_cos();
        let area = d.semi_major_px * d.semi_minor_px;
        (sin + area * s, cos + area * c)
    });
    let along = 0.5 * f64::atan2(sin, cos);
    found.reject_matching(RejectReason::OrientationOutlier, |MeasuredMarker { detection: d, .. }| {
        let (flat, most) =
            if d.shape == Shape::Circle { CONSISTENCY.disc_across } else { CONSISTENCY.quadrants_across };
        flatter(d, flat) && half_turn(d.angle_rad - along).abs() > most
    });
}

/// A frame's markers are prints of about one diameter along one wing: seen at less than half the size of
/// the next larger one, one would have to be more than twice as far away as all the others.
/// What is as much smaller than larger things about it is none either.
pub fn reject_size_outliers(found: &mut FoundMarkers) {
    let mut sizes: Vec<f64> = found.measured.iter().map(|m| m.detection.semi_major_px).collect();
    sizes.sort_unstable_by(|a, b| b.total_cmp(a));
    let gap = sizes.windows(2).skip(CONSISTENCY.sizes - 1).find(|w| w[0] > CONSISTENCY.gap * w[1]);
    let least = gap.map_or(0.0, |w| w[0]);
    found.reject_matching(RejectReason::SizeOutlier, |m| m.detection.semi_major_px < least);
    // Small things hide one another: those are looked at again beside what is left.
    loop {
        let all: Vec<Detection> = found.measured.iter().map(|m| m.detection.clone()).collect();
        found.reject_matching(RejectReason::SizeOutlier, |m| is_size_outlier(&m.detection, &all));
        if found.measured.len() == all.len() {
            return;
        }
    }
}

/// Whether a thing is far smaller than the larger ones about it predict, or where those lie on no plane, as among letters, than
/// all but one of the nearest.
fn is_size_outlier(own: &Detection, all: &[Detection]) -> bool {
    let far_larger = |major: f64| major > CONSISTENCY.gap * own.semi_major_px;
    // Other dots do not tell.
    let larger = || all.iter().filter(|d| d.semi_major_px > CONSISTENCY.longer * own.semi_major_px);
    if let Some(major) = neighbours::predicted_major(larger(), own.centre_px) {
        return far_larger(major.value);
    }
    let apart = |d: &Detection| (d.centre_px - own.centre_px).norm();
    let mut near: Vec<&Detection> = larger().collect();
    near.sort_by(|one, other| apart(one).total_cmp(&apart(other)));
    near.truncate(CONSISTENCY.sizes + 1);
    near.iter().filter(|d| far_larger(d.semi_major_px)).count() >= CONSISTENCY.sizes
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    fn measured(shape: Shape, x: f64, semi_major_px: f64) -> MeasuredMarker {
        let detection = Detection {
            shape,
            centre_px: Vector2::new(x, 50.0),
            covariance_px2: Matrix2::identity().into(),
            semi_major_px,
            semi_minor_px: 5.0,
            angle_rad: 0.0,
            fit_rms: 1.0,
            contrast: 100.0,
        };
        MeasuredMarker::whole(detection)
    }

    #[test]
    fn two_discs_with_skin_between_them_are_no_quadrants() {
        // The discs' tips are 12 px apart, or 3 as the black of quadrants in blur; or their black passes for discs, which
        // then leave more than the quadrants do.
        let cases = [(36.0, 3.0, [Shape::Circle; 2].as_slice()), (31.5, 3.0, &[Shape::Quadrant])];
        for (half, rms, kept) in cases.into_iter().chain([(36.0, 0.3, [Shape::Quadrant].as_slice())]) {
            let discs = [150.0 - half, 150.0 + half].map(|x| measured(Shape::Circle, x, 30.0));
            let mut quadrants = measured(Shape::Quadrant, 150.0, 66.0);
            quadrants.detection.fit_rms = rms;
            let mut found = FoundMarkers { measured: vec![quadrants], rejected: Vec::new() };
            found.measured.extend(discs);
            reject_duplicates(&mut found);
            let shapes: Vec<Shape> = found.measured.iter().map(|m| m.detection.shape).collect();
            assert_eq!(shapes, kept, "{half}, {rms}");
            assert!(found.rejected.iter().all(|r| r.reason == RejectReason::Duplicate));
        }
    }

    /// Things seen at a place of their own each: shape, semi-axes, px, direction, rad, and blur, px.
    fn seen(things: &[(Shape, [f64; 2], f64, f64)]) -> FoundMarkers {
        let one = |(k, &(shape, [major, minor], angle, blur)): (usize, &(Shape, [f64; 2], f64, f64))| {
            let mut m = measured(shape, 500.0 * k as f64, major);
            (m.detection.semi_minor_px, m.detection.angle_rad, m.blur) = (minor, angle, blur);
            m
        };
        FoundMarkers { measured: things.iter().enumerate().map(one).collect(), rejected: Vec::new() }
    }

    #[test]
    fn many_small_things_that_lie_across_do_not_outweigh_the_markers() {
        let discs = [(Shape::Circle, [40.0, 4.0], 0.1, 1.0); 6];
        let quadrants = [(Shape::Quadrant, [80.0, 20.0], -0.3, 1.0); 2];
        // Round ones have no direction.
        let round = [(Shape::Quadrant, [20.0, 12.0], 1.5, 1.0)];
        let grain = [(Shape::Quadrant, [9.0, 3.0], 1.4, 1.0); 40];
        let mut found = seen(&[&discs[..], &quadrants, &round, &grain].concat());
        reject_orientation_outliers(&mut found);
        assert_eq!((found.measured.len(), found.rejected.len()), (9, 40));
        assert!(
            found
                .rejected
                .iter()
                .all(|r| r.reason == RejectReason::OrientationOutlier && r.semi_major_px < 10.0)
        );
    }

    #[test]
    fn quadrants_out_of_focus_stay_and_soft_things_go() {
        let markers = [(Shape::Circle, [60.0, 6.0], 0.0, 0.9); 6];
        let near = [(Shape::Quadrant, [130.0, 120.0], 0.0, 2.1)];
        // A shadow that looks like quadrants, and a dark spot.
        let soft = [(Shape::Quadrant, [40.0, 15.0], 0.0, 2.1), (Shape::Circle, [130.0, 120.0], 0.0, 2.1)];
        let mut found = seen(&[&markers[..], &near, &soft].concat());
        reject_blur_outliers(&mut found);
        assert_eq!((found.measured.len(), found.rejected.len()), (7, 2));
        assert!(found.measured.iter().any(|m| m.detection.semi_minor_px == 120.0));
    }

    #[test]
    fn long_edges_tell_the_usual_blur() {
        let markers = [(Shape::Circle, [60.0, 6.0], 0.0, 1.2); 6];
        let grain = [(Shape::Circle, [6.0, 3.0], 0.0, 0.4); 30];
        assert_eq!(blur_limit(&seen(&[&markers[..], &grain].concat())), Some(2.4));
        assert_eq!(blur_limit(&seen(&grain[..4])), None);
    }
}
