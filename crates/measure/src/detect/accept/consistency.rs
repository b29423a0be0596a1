//! Consistency of a frame's detections: rejects duplicates and those whose size, blur or direction differs too much from
//! the other markers.

use super::found::FoundMarkers;
use super::preference::is_preferred;
use super::verdict::MeasuredMarker;
use crate::detect::accept::options::CONSISTENCY;
use crate::detect::detection::{Detection, RejectReason};
use crate::detect::hypothesis::neighbours;
use crate::detect::image::ellipse::wrap_half_turn;
use crate::detect::numbers::{MIN_GROUP, MIN_TYPICAL};
use crate::ordering::sort_by_value;
use crate::setup::Shape;

/// Rejects every detection whose centre lies well within the outline of a better one: one marker segmented at two
/// thresholds.
pub fn reject_duplicates(found: &mut FoundMarkers) {
    let within = |one: &Detection, other: &Detection| {
        let most = if one.shape == other.shape {
            CONSISTENCY.same_radius
        } else {
            CONSISTENCY.same_radius_other_shape
        };
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

/// Rejects detections that are far more blurred than the frame's median edge. One lens produces all edges of a frame, so
/// such an edge belongs to dirt or a shadow, unless it is a marker out of focus ([`is_out_of_focus`]).
pub fn reject_blur_outliers(found: &mut FoundMarkers) {
    if let Some(softest) = blur_limit(found) {
        found.reject_matching(RejectReason::BlurOutlier, |m| {
            let Detection {
                shape,
                semi_minor_px,
                ..
            } = m.detection;
            m.blur > softest && !is_out_of_focus(shape, semi_minor_px, m.blur)
        });
    }
}

/// Returns whether an unusually soft edge can be that of a marker out of focus, for example a marker near a camera that is
/// focused on the wing. This holds for quadrants whose edges are narrow compared with their size; dirt and shadows are soft
/// throughout and show no four quadrants.
pub fn is_out_of_focus(shape: Shape, semi_minor_px: f64, blur: f64) -> bool {
    shape == Shape::Quadrant && semi_minor_px > CONSISTENCY.crisp_blurs * blur
}

/// Returns the largest blur, px, that is consistent with the frame's other edges; `None` with fewer than
/// `MIN_TYPICAL` detections. Edges are weighted by their length, because the image noise next to the wing yields
/// many short ones.
pub fn blur_limit(found: &FoundMarkers) -> Option<f64> {
    if found.measured.len() < MIN_TYPICAL {
        return None;
    }
    let mut blurs: Vec<[f64; 2]> = found
        .measured
        .iter()
        .map(|m| [m.blur, m.detection.semi_major_px])
        .collect();
    blurs.sort_unstable_by(|[one, _], [other, _]| one.total_cmp(other));
    let half = 0.5 * blurs.iter().map(|[_, length]| length).sum::<f64>();
    let mut sum = 0.0;
    let median_blur = blurs.iter().find(|[_, length]| {
        sum += length;
        sum >= half
    });
    median_blur.map(|[blur, _]| CONSISTENCY.max_blur_ratio * blur)
}

/// Rejects flat detections that lie across the common direction of the markers. Flat markers on a nearly plane skin all
/// point along its horizon in the image, to within a few 0.1 rad; a flat detection across it is part of a seam, a shadow or
/// an edge next to the wing.
pub fn reject_orientation_outliers(found: &mut FoundMarkers) {
    let flatter = |d: &Detection, than: f64| d.semi_major_px > than * d.semi_minor_px;
    let flat: Vec<&Detection> = found
        .measured
        .iter()
        .map(|m| &m.detection)
        .filter(|d| flatter(d, CONSISTENCY.min_flatness))
        .collect();
    if flat.len() < MIN_TYPICAL {
        return;
    }
    // Directions repeat after half a turn. Weighting by area keeps many small objects next to the wing from
    // outweighing the markers on it.
    let (sin, cos) = flat.iter().fold((0.0, 0.0), |(sin, cos), d| {
        let (s, c) = (2.0 * d.angle_rad).sin_cos();
        let area = d.semi_major_px * d.semi_minor_px;
        (sin + area * s, cos + area * c)
    });
    let along = 0.5 * f64::atan2(sin, cos);
    found.reject_matching(
        RejectReason::OrientationOutlier,
        |MeasuredMarker { detection: d, .. }| {
            let limit = if d.shape == Shape::Circle {
                CONSISTENCY.disc_across
            } else {
                CONSISTENCY.quadrants_across
            };
            flatter(d, limit.min_flatness)
                && wrap_half_turn(d.angle_rad - along).abs() > limit.max_rad
        },
    );
}

/// Rejects detections that are far smaller than the frame's markers. All markers are prints of about one diameter along one
/// wing: a marker seen at less than half the size of the next larger one would have to be more than twice as far away as
/// all others. Detections far smaller than their larger neighbours are rejected too.
pub fn reject_size_outliers(found: &mut FoundMarkers) {
    let mut sizes: Vec<f64> = found
        .measured
        .iter()
        .map(|m| m.detection.semi_major_px)
        .collect();
    sizes.sort_unstable_by(|a, b| b.total_cmp(a));
    let gap = sizes
        .windows(2)
        .skip(MIN_GROUP - 1)
        .find(|w| w[0] > CONSISTENCY.max_size_ratio * w[1]);
    let least = gap.map_or(0.0, |w| w[0]);
    found.reject_matching(RejectReason::SizeOutlier, |m| {
        m.detection.semi_major_px < least
    });
    // Small detections support each other, so the rest is checked again after each removal.
    loop {
        let all: Vec<Detection> = found.measured.iter().map(|m| m.detection.clone()).collect();
        found.reject_matching(RejectReason::SizeOutlier, |m| {
            is_size_outlier(&m.detection, &all)
        });
        if found.measured.len() == all.len() {
            return;
        }
    }
}

/// Returns whether a detection is far smaller than its larger neighbours predict or, if these do not lie on a plane
/// (letters, for example), far smaller than all but one of the nearest ones.
fn is_size_outlier(own: &Detection, all: &[Detection]) -> bool {
    let far_larger = |major: f64| major > CONSISTENCY.max_size_ratio * own.semi_major_px;
    // Other dots do not count.
    let larger = || {
        all.iter()
            .filter(|d| d.semi_major_px > CONSISTENCY.min_longer * own.semi_major_px)
    };
    if let Some(major) = neighbours::predict_major(larger(), own.centre_px) {
        return far_larger(major.value);
    }
    let apart = |d: &Detection| (d.centre_px - own.centre_px).norm();
    let mut near: Vec<&Detection> = larger().collect();
    sort_by_value(&mut near, |one| apart(one));
    // One of the nearest may be a dot.
    near.truncate(MIN_GROUP + 1);
    near.iter().filter(|d| far_larger(d.semi_major_px)).count() >= MIN_GROUP
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
            marker: None,
        };
        MeasuredMarker::whole(detection)
    }

    /// Builds detections at separate positions from shape, semi-axes (px), direction (rad) and blur (px).
    fn build_detections(things: &[(Shape, [f64; 2], f64, f64)]) -> FoundMarkers {
        let one =
            |(k, &(shape, [major, minor], angle, blur)): (usize, &(Shape, [f64; 2], f64, f64))| {
                let mut m = measured(shape, 500.0 * k as f64, major);
                (m.detection.semi_minor_px, m.detection.angle_rad, m.blur) = (minor, angle, blur);
                m
            };
        FoundMarkers {
            measured: things.iter().enumerate().map(one).collect(),
            rejected: Vec::new(),
        }
    }

    #[test]
    fn many_small_detections_do_not_outweigh_the_markers() {
        let discs = [(Shape::Circle, [40.0, 4.0], 0.1, 1.0); 6];
        let quadrants = [(Shape::Quadrant, [80.0, 20.0], -0.3, 1.0); 2];
        // Round ones have no direction.
        let round = [(Shape::Quadrant, [20.0, 12.0], 1.5, 1.0)];
        let grain = [(Shape::Quadrant, [9.0, 3.0], 1.4, 1.0); 40];
        let mut found = build_detections(&[&discs[..], &quadrants, &round, &grain].concat());
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
    fn quadrants_out_of_focus_stay_and_shadows_are_rejected() {
        let markers = [(Shape::Circle, [60.0, 6.0], 0.0, 0.9); 6];
        let near = [(Shape::Quadrant, [130.0, 120.0], 0.0, 2.1)];
        // A shadow that looks like quadrants, and a dark spot.
        let soft = [
            (Shape::Quadrant, [40.0, 15.0], 0.0, 2.1),
            (Shape::Circle, [130.0, 120.0], 0.0, 2.1),
        ];
        let mut found = build_detections(&[&markers[..], &near, &soft].concat());
        reject_blur_outliers(&mut found);
        assert_eq!((found.measured.len(), found.rejected.len()), (7, 2));
        assert!(
            found
                .measured
                .iter()
                .any(|m| m.detection.semi_minor_px == 120.0)
        );
    }

    #[test]
    fn long_edges_determine_the_blur_limit() {
        let markers = [(Shape::Circle, [60.0, 6.0], 0.0, 1.2); 6];
        let grain = [(Shape::Circle, [6.0, 3.0], 0.0, 0.4); 30];
        assert_eq!(
            blur_limit(&build_detections(&[&markers[..], &grain].concat())),
            Some(2.4)
        );
        assert_eq!(blur_limit(&build_detections(&grain[..4])), None);
    }
}
