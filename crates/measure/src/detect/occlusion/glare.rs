//! Position of glare over a marker, from the skin next to it. In reflected light, black is no darker than the skin.

use nalgebra::Vector2;

use super::region::OcclusionBand;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::options::GLARE;
use crate::estimation::robust::median;
use crate::raster::Raster;

/// Returns the bands in which glare lies over a marker whose position is known approximately. A band reaches from where the
/// skin is `begins` times lighter than elsewhere.
pub fn find_glare_bands(image: &Raster, ellipse: &Ellipse, begins: f64) -> Vec<OcclusionBand> {
    bright_bands(
        &lighter_side(&skin_profiles(image, ellipse)),
        ellipse,
        begins,
    )
}

/// Returns at each position the lighter grey level of the skin on both sides. A marker off by a few px shows one its
/// own black.
fn lighter_side([one, other]: &[Vec<f64>; 2]) -> Vec<f64> {
    one.iter()
        .zip(other)
        .map(|(one, other)| one.max(*other))
        .collect()
}

/// Returns the bands of glare over a thick marker, for which the slant of the glare matters. If each side shows one band,
/// the band connects the two.
pub fn find_slanting_glare(image: &Raster, ellipse: &Ellipse, begins: f64) -> Vec<OcclusionBand> {
    let middle = ellipse.centre.dot(&ellipse.major_direction());
    // Beyond the ends of the marker, the position of the limit has no effect.
    let open = |band: OcclusionBand| OcclusionBand {
        from: if band.from < middle - ellipse.major {
            f64::NEG_INFINITY
        } else {
            band.from
        },
        to: if band.to > middle + ellipse.major {
            f64::INFINITY
        } else {
            band.to
        },
        ..band
    };
    let lit_on = |skin: &[f64]| bright_bands(skin, ellipse, begins);
    let skin = skin_profiles(image, ellipse);
    let slanting = match skin.each_ref().map(|side| lit_on(side)) {
        [one, other] if one.len() == 1 && other.len() == 1 => {
            slanting_band([one[0], other[0]].map(open), ellipse)
        }
        _ => None,
    };
    slanting.map_or_else(|| lit_on(&lighter_side(&skin)), |band| vec![band])
}

/// Returns the band across a marker of which each side shows a part. `None` if the two are not parts of one band, or if it
/// lies along the marker.
fn slanting_band(sides: [OcclusionBand; 2], ellipse: &Ellipse) -> Option<OcclusionBand> {
    let [one, other] = sides;
    let away =
        ellipse.minor + 0.5 * (GLARE.beside_px[0] + GLARE.beside_px[GLARE.beside_px.len() - 1]);
    let shifts = [other.from - one.from, other.to - one.to];
    let finite: Vec<f64> = shifts
        .into_iter()
        .filter(|shift| shift.is_finite())
        .collect();
    let is_one = [(one.from, other.from), (one.to, other.to)]
        .iter()
        .all(|(a, b)| a.is_finite() == b.is_finite());
    if !is_one || finite.is_empty() {
        return None;
    }
    let slant = 0.5 * finite.iter().sum::<f64>() / finite.len() as f64 / away;
    if slant.abs() > GLARE.slant {
        return None;
    }
    let (along, across) = (ellipse.major_direction(), ellipse.minor_direction());
    let axis = (along + across * slant).normalize();
    // Positions along the marker are measured from the origin of the image.
    let origin = ellipse.centre - along * along.dot(&ellipse.centre);
    let place = |s: f64, side: f64| {
        if s.is_finite() {
            axis.dot(&(origin + along * s + across * (side * away)))
        } else {
            s
        }
    };
    let from = place(one.from, 1.0).min(place(other.from, -1.0));
    let to = place(one.to, 1.0).max(place(other.to, -1.0));
    Some(OcclusionBand { axis, from, to })
}

/// Returns the bands in which the skin along a marker is lit.
fn bright_bands(skin: &[f64], ellipse: &Ellipse, begins: f64) -> Vec<OcclusionBand> {
    let axis = ellipse.major_direction();
    let mut sorted = skin.to_vec();
    sorted.sort_by(f64::total_cmp);
    // Glare may lie over most of the skin.
    let typical = sorted.get(sorted.len() / 5).copied().unwrap_or(0.0);
    let middle = ellipse.centre.dot(&axis);
    let place = |i: usize| middle + i as f64 - (skin.len() / 2) as f64;
    let mut out: Vec<OcclusionBand> = Vec::new();
    let mut first = 0;
    for run in skin.chunk_by(|one, other| (*one > begins * typical) == (*other > begins * typical))
    {
        let next = first + run.len();
        let bright = |v: &f64| *v > GLARE.bright_ratio * typical;
        if run.iter().any(bright) {
            let from = if first == 0 {
                f64::NEG_INFINITY
            } else {
                place(first) - GLARE.margin_px
            };
            let to = if next == skin.len() {
                f64::INFINITY
            } else {
                place(next) + GLARE.margin_px
            };
            match out.last_mut() {
                _ if from > middle + ellipse.major || to < middle - ellipse.major => {}
                Some(OcclusionBand { to: last, .. }) if *last > from => *last = to,
                _ => out.push(OcclusionBand { axis, from, to }),
            }
        }
        first = next;
    }
    out
}

/// Returns the grey values of the skin on either side of a marker, at each px along it and beyond its ends.
fn skin_profiles(image: &Raster, ellipse: &Ellipse) -> [Vec<f64>; 2] {
    let (axis, across) = (ellipse.major_direction(), ellipse.minor_direction());
    let grey = |at: Vector2<f64>| f64::from(image.nearest_value(at.x, at.y));
    let last = ellipse.major.ceil() as i32 + GLARE.beyond_px;
    [1.0, -1.0].map(|side| {
        let beside = GLARE
            .beside_px
            .map(|d| across * (side * (ellipse.minor + d)));
        let skin = |s: i32| {
            let at = ellipse.centre + axis * f64::from(s);
            beside.iter().map(|d| grey(at + d)).sum::<f64>() / GLARE.beside_px.len() as f64
        };
        (-last..=last).map(skin).collect()
    })
}

/// Returns the positions along the axis at which glare begins before and after the middle of a blob, for glare that reaches
/// the blob. The skin next to the blob is used, because the blob's own outline fades as the skin becomes lighter.
pub fn glare_limits(image: &Raster, ellipse: &Ellipse) -> [Option<f64>; 2] {
    let [one, other] = skin_profiles(image, ellipse);
    let skin: Vec<f64> = one
        .iter()
        .zip(&other)
        .map(|(one, other)| 0.5 * (one + other))
        .collect();
    let last = (skin.len() / 2) as i32;
    let at = |s: i32| skin.get((s + last) as usize).copied().unwrap_or(0.0);
    let half = ellipse.major as i32;
    let Some(typical) = median((-half..=half).map(at).collect()) else {
        return [None; 2];
    };
    [-1, 1].map(|sign| {
        let peak = (0..=last).find(|&s| at(sign * s) > GLARE.min_ratio * typical)?;
        let begin = (0..=peak)
            .rev()
            .find(|&s| at(sign * s) < GLARE.begin_ratio * typical)?;
        (begin < half + 2).then(|| {
            ellipse.centre.dot(&ellipse.major_direction())
                + f64::from(sign) * (f64::from(begin) - GLARE.margin_px)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn glare_across_a_thick_marker_has_the_slant_of_the_skin() {
        let ellipse = Ellipse {
            centre: Vector2::new(150.3, 90.6),
            major: 70.0,
            minor: 16.0,
            angle: 0.1,
        };
        // White to the right of a line 20 px beyond the centre, which shifts by `lean` per row.
        for lean in [-0.6, 0.0, 0.4] {
            let value = |i: usize| {
                let (x, y) = ((i % 300) as f64, (i / 300) as f64);
                if x - 170.3 > lean * (y - 90.6) {
                    255
                } else {
                    140
                }
            };
            let image = Raster::new(300, 200, (0..300 * 200).map(value).collect())
                .expect("the sizes agree");
            let bands = find_slanting_glare(&image, &ellipse, GLARE.bright_ratio);
            let [OcclusionBand { axis, from, to }] = bands[..] else {
                panic!("{bands:?}")
            };
            let across = Vector2::new(1.0, -lean).normalize();
            let off = axis.dot(&Vector2::new(170.3, 90.6)) - from;
            assert!(
                axis.dot(&across) > 0.998 && (0.0..4.5).contains(&off) && to == f64::INFINITY,
                "{lean}: {off}"
            );
        }
    }

    #[test]
    fn glare_next_to_a_dark_object_is_seen_on_the_other_side() {
        let ellipse = Ellipse {
            centre: Vector2::new(150.0, 100.0),
            major: 70.0,
            minor: 16.0,
            angle: 0.0,
        };
        let value = |i: usize| match (i % 300, i / 300) {
            (_, 115..) => 30,
            (190.., _) => 255,
            _ => 140,
        };
        let image =
            Raster::new(300, 200, (0..300 * 200).map(value).collect()).expect("the sizes agree");
        let bands = find_slanting_glare(&image, &ellipse, GLARE.bright_ratio);
        assert_eq!(
            bands,
            find_glare_bands(&image, &ellipse, GLARE.bright_ratio)
        );
        assert!(
            matches!(bands[..], [OcclusionBand { from, .. }] if (186.0..190.0).contains(&from)),
            "{bands:?}"
        );
    }
}
