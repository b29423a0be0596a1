//! A disc that glare drowns in part: the ellipse through the outline that is left. Where light is
//! mirrored, black is no darker than the skin, and the blob ends before the disc does.

use nalgebra::Vector2;

use super::super::raster::Raster;
use super::arc::{any_ellipse, rim};
use super::blob::Blob;
use super::candidate::{Band, Candidate};
use super::outline::Outline;

/// Grey value from which on skin is saturated, and where beyond a disc's tip it is looked at, px.
const WHITE: u8 = 250;
const PAST: [f64; 3] = [3.0, 4.5, 6.0];
/// How far on either side of the outline the step from black to skin is taken, px.
const REACH: f64 = 3.0;
/// Share of the usual step below which an outline is not the disc's.
const STEP: f64 = 0.6;
/// How much lighter than the skin the glare is, and where it begins.
const LIGHTER: f64 = 1.15;
pub const BEGINS: f64 = 1.10;
/// How much lighter at its brightest over a foretold marker, along which light may change by itself.
const BRIGHT: f64 = 1.3;
/// Where the skin beside a blob is looked at, px from its outline; and how far beyond its ends.
const BESIDE: [f64; 4] = [4.0, 5.0, 6.0, 7.0];
const BEYOND: i32 = 20;
/// Rim points that must be left.
const LEFT: usize = 40;
/// What glare blurs into what it leaves, px.
const MARGIN: f64 = 2.0;

/// A point of a blob's rim, px: where, along the blob's axis, and the step across it, grey levels.
struct Rim {
    at: Vector2<f64>,
    along: f64,
    step: f64,
}

/// A blob with what glare has left of its rim.
struct Part {
    axis: Vector2<f64>,
    left: Vec<Vector2<f64>>,
    /// Bands along the axis that glare hides: before the first, after the second.
    ends: [Option<f64>; 2],
}

/// The candidate with the outline of its whole disc, where glare hides an end of it; together with
/// the part on the other side of the glare, if there is one.
pub fn completed(image: &Raster, candidate: &Candidate, index: usize, blobs: &[Blob]) -> Option<Candidate> {
    let blob = blobs.get(index)?;
    let part = part(image, blob, LEFT)?;
    let far = (blobs.iter().enumerate())
        .filter(|&(i, other)| i != index && opposite(&part, blob, other))
        .find_map(|(i, other)| together(image, &part, i, other, candidate, blob));
    far.or_else(|| {
        // Too little of the rim may be left: then only the discs about it tell the size.
        let seen = Outline::of(blob);
        let outline = any_ellipse(&part.left, blob).and_then(|o| sound(o, blob)).unwrap_or(seen);
        let bands = bands(part.axis, part.ends);
        Some(Candidate { outline, bands, ..candidate.clone() })
    })
}

/// Whether the skin beyond an end of a disc is saturated: glare may have cut it.
pub fn ends_in_white(image: &Raster, outline: &Outline) -> bool {
    let axis = outline.axis();
    [-1.0, 1.0].iter().any(|side| {
        PAST.iter().all(|past| {
            let at = outline.centre + axis * (side * (outline.major + past));
            image.nearest(at.x, at.y) >= WHITE
        })
    })
}

fn bands(axis: Vector2<f64>, [first, second]: [Option<f64>; 2]) -> Vec<Band> {
    let band = |from: f64, to: f64| Band { axis, from, to };
    let before = first.map(|end| band(f64::NEG_INFINITY, end));
    before.into_iter().chain(second.map(|end| band(end, f64::INFINITY))).collect()
}

/// Whether a blob may be the rest of the disc: across the glare, on the axis, and of no other size.
fn opposite(part: &Part, blob: &Blob, other: &Blob) -> bool {
    let d = other.centroid - blob.centroid;
    let own = Outline::of(blob);
    let (along, across) = (d.dot(&part.axis), d.perp(&part.axis).abs());
    let side = if along > 0.0 { part.ends[1] } else { part.ends[0] };
    side.is_some()
        && other.area > 30.0
        && other.area < 3.0 * blob.area
        && along.abs() > own.major
        && along.abs() < 5.0 * own.major
        && across < own.minor + 0.1 * along.abs()
}

/// Both parts of a disc that a band of glare crosses.
fn together(
    image: &Raster,
    one: &Part,
    index: usize,
    other: &Blob,
    candidate: &Candidate,
    blob: &Blob,
) -> Option<Candidate> {
    let far = part(image, other, LEFT / 3)?;
    let after = (other.centroid - blob.centroid).dot(&one.axis) > 0.0;
    let facing = if after == (far.axis.dot(&one.axis) > 0.0) { far.ends[0] } else { far.ends[1] };
    facing?;
    let points: Vec<Vector2<f64>> = one.left.iter().chain(&far.left).copied().collect();
    let outline = any_ellipse(&points, blob)?;
    // One ellipse passes through both.
    let off = |p: &Vector2<f64>| (outline.outwards(*p) - 1.0).abs() * outline.minor;
    let mean = points.iter().map(off).sum::<f64>() / points.len() as f64;
    let along = |p: &Vector2<f64>| p.dot(&one.axis);
    let ends = |points: &[Vector2<f64>]| {
        points.iter().map(along).fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)))
    };
    let (near, far_ends) = (ends(&one.left), ends(&far.left));
    let (from, to) = if after { (near.1, far_ends.0) } else { (far_ends.1, near.0) };
    if mean > 1.0 || from >= to {
        return None;
    }
    let blobs = candidate.blobs.iter().copied().chain([index]).collect();
    let bands = vec![Band { axis: one.axis, from: from - MARGIN, to: to + MARGIN }];
    Some(Candidate { outline, bands, blobs, ..candidate.clone() })
}

/// What glare has left of a blob; `None` where no end of it is drowned.
fn part(image: &Raster, blob: &Blob, least: usize) -> Option<Part> {
    let outline = Outline::of(blob);
    let axis = outline.axis();
    let inverse = blob.covariance.try_inverse()?;
    let grey = |at: Vector2<f64>| f64::from(image.nearest(at.x, at.y));
    let points: Vec<Rim> = (rim(blob).into_iter())
        .map(|at| {
            let normal = (inverse * (at - blob.centroid)).normalize() * REACH;
            let (inside, outside) = (grey(at - normal), grey(at + normal));
            Rim { at, along: at.dot(&axis), step: outside - inside }
        })
        .collect();
    let usual = middle_of(points.iter().map(|p| p.step))?;
    let ends = drowned(image, &outline);
    if usual < 8.0 || ends == [None, None] {
        return None;
    }
    let open = |p: &&Rim| {
        p.step > STEP * usual && ends[0].is_none_or(|e| p.along > e) && ends[1].is_none_or(|e| p.along < e)
    };
    let left: Vec<Vector2<f64>> = points.iter().filter(open).map(|p| p.at).collect();
    (left.len() >= least).then_some(Part { axis, left, ends })
}

/// The bands in which glare lies over a marker of which all is known but the exact place: over its ends or its middle; from
/// where the skin is so many times lighter than elsewhere, and farther out by so many times the way from there to where it is
/// bright.
pub fn lit(image: &Raster, outline: &Outline, begins: f64, fringe: f64) -> Vec<Band> {
    lit_along(&lighter(&beside(image, outline)), outline, begins, fringe)
}

/// Of either side the lighter skin: a place that is some px off has the marker's own black on one.
fn lighter([one, other]: &[Vec<f64>; 2]) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one.max(*other)).collect()
}

/// The same of a thick marker, over which it matters that glare slants: where either side shows one band, it reaches from
/// where it is seen on the one to where it is seen on the other.
pub fn lit_slanting(image: &Raster, outline: &Outline, begins: f64) -> Vec<Band> {
    let middle = outline.centre.dot(&outline.axis());
    // Beyond the marker's ends it does not matter where it ends.
    let open = |band: Band| Band {
        from: if band.from < middle - outline.major { f64::NEG_INFINITY } else { band.from },
        to: if band.to > middle + outline.major { f64::INFINITY } else { band.to },
        ..band
    };
    let lit_on = |skin: &[f64]| lit_along(skin, outline, begins, 0.0);
    let skin = beside(image, outline);
    let slanting = match skin.each_ref().map(|side| lit_on(side)) {
        [one, other] if one.len() == 1 && other.len() == 1 => slanting([one[0], other[0]].map(open), outline),
        _ => None,
    };
    slanting.map_or_else(|| lit_on(&lighter(&skin)), |band| vec![band])
}

/// The band across a marker of which the skin on either side shows a part; `None` where these are not parts of one, or where
/// it lies along the marker.
fn slanting(sides: [Band; 2], outline: &Outline) -> Option<Band> {
    /// Most that it may shift along the marker for each pixel across.
    const SLANT: f64 = 1.5;
    let [one, other] = sides;
    let away = outline.minor + 0.5 * (BESIDE[0] + BESIDE[BESIDE.len() - 1]);
    let shifts = [other.from - one.from, other.to - one.to];
    let finite: Vec<f64> = shifts.into_iter().filter(|shift| shift.is_finite()).collect();
    let is_one =
        [(one.from, other.from), (one.to, other.to)].iter().all(|(a, b)| a.is_finite() == b.is_finite());
    if !is_one || finite.is_empty() {
        return None;
    }
    let slant = 0.5 * finite.iter().sum::<f64>() / finite.len() as f64 / away;
    if slant.abs() > SLANT {
        return None;
    }
    let (along, across) = (outline.axis(), outline.across());
    let axis = (along + across * slant).normalize();
    // Places along the marker are counted from the picture's origin.
    let origin = outline.centre - along * along.dot(&outline.centre);
    let place = |s: f64, side: f64| {
        if s.is_finite() { axis.dot(&(origin + along * s + across * (side * away))) } else { s }
    };
    let from = place(one.from, 1.0).min(place(other.from, -1.0));
    let to = place(one.to, 1.0).max(place(other.to, -1.0));
    Some(Band { axis, from, to })
}

/// What of the skin along a marker is lit.
fn lit_along(skin: &[f64], outline: &Outline, begins: f64, fringe: f64) -> Vec<Band> {
    let axis = outline.axis();
    let mut sorted = skin.to_vec();
    sorted.sort_by(f64::total_cmp);
    // Glare may lie over most of it.
    let usual = sorted.get(sorted.len() / 5).copied().unwrap_or(0.0);
    let middle = outline.centre.dot(&axis);
    let place = |i: usize| middle + i as f64 - (skin.len() / 2) as f64;
    let mut out: Vec<Band> = Vec::new();
    let mut first = 0;
    for alike in skin.chunk_by(|one, other| (*one > begins * usual) == (*other > begins * usual)) {
        let next = first + alike.len();
        let bright = |v: &f64| *v > BRIGHT * usual;
        if let (Some(rise), Some(fall)) = (alike.iter().position(bright), alike.iter().rev().position(bright))
        {
            let beyond = |way: usize| MARGIN + fringe * way as f64;
            let from = if first == 0 { f64::NEG_INFINITY } else { place(first) - beyond(rise) };
            let to = if next == skin.len() { f64::INFINITY } else { place(next) + beyond(fall) };
            match out.last_mut() {
                _ if from > middle + outline.major || to < middle - outline.major => {}
                Some(Band { to: last, .. }) if *last > from => *last = to,
                _ => out.push(Band { axis, from, to }),
            }
        }
        first = next;
    }
    out
}

/// Grey values of the skin on either side of a marker, at each pixel along it and beyond its ends.
fn beside(image: &Raster, outline: &Outline) -> [Vec<f64>; 2] {
    let (axis, across) = (outline.axis(), outline.across());
    let grey = |at: Vector2<f64>| f64::from(image.nearest(at.x, at.y));
    let last = outline.major.ceil() as i32 + BEYOND;
    [1.0, -1.0].map(|side| {
        let beside = BESIDE.map(|d| across * (side * (outline.minor + d)));
        let skin = |s: i32| {
            let at = outline.centre + axis * f64::from(s);
            beside.iter().map(|d| grey(at + d)).sum::<f64>() / BESIDE.len() as f64
        };
        (-last..=last).map(skin).collect()
    })
}

/// Where along the axis glare begins before a blob's middle, and after it, if it reaches the blob: the skin beside it
/// tells, for the blob's own outline fades as the skin lights up.
fn drowned(image: &Raster, outline: &Outline) -> [Option<f64>; 2] {
    let [one, other] = beside(image, outline);
    let skin: Vec<f64> = one.iter().zip(&other).map(|(one, other)| 0.5 * (one + other)).collect();
    let last = (skin.len() / 2) as i32;
    let at = |s: i32| skin.get((s + last) as usize).copied().unwrap_or(0.0);
    let half = outline.major as i32;
    let Some(usual) = middle_of((-half..=half).map(at)) else { return [None; 2] };
    [-1, 1].map(|sign| {
        let peak = (0..=last).find(|&s| at(sign * s) > LIGHTER * usual)?;
        let begin = (0..=peak).rev().find(|&s| at(sign * s) < BEGINS * usual)?;
        (begin < half + 2)
            .then(|| outline.centre.dot(&outline.axis()) + f64::from(sign) * (f64::from(begin) - MARGIN))
    })
}

fn middle_of(values: impl Iterator<Item = f64>) -> Option<f64> {
    super::middle(values.collect())
}

/// The outline, if it is not much larger than what is seen of it.
fn sound(outline: Outline, blob: &Blob) -> Option<Outline> {
    let seen = Outline::of(blob);
    let fits = outline.major < 2.0 * seen.major && outline.minor < 1.6 * seen.minor;
    (fits && outline.major > seen.major).then_some(outline)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn glare_across_a_thick_marker_slants_as_the_skin_beside_it_shows() {
        let outline = Outline { centre: Vector2::new(150.3, 90.6), major: 70.0, minor: 16.0, angle: 0.1 };
        // White to the right of a line that leans by so much for each row, 20 px beyond the centre.
        for lean in [-0.6, 0.0, 0.4] {
            let value = |i: usize| {
                let (x, y) = ((i % 300) as f64, (i / 300) as f64);
                if x - 170.3 > lean * (y - 90.6) { 255 } else { 140 }
            };
            let image = Raster::new(300, 200, (0..300 * 200).map(value).collect()).expect("the sizes agree");
            let bands = lit_slanting(&image, &outline, BRIGHT);
            let [Band { axis, from, to }] = bands[..] else { panic!("{bands:?}") };
            let across = Vector2::new(1.0, -lean).normalize();
            let off = axis.dot(&Vector2::new(170.3, 90.6)) - from;
            assert!(
                axis.dot(&across) > 0.998 && (0.0..4.5).contains(&off) && to == f64::INFINITY,
                "{lean}: {off}"
            );
        }
    }

    #[test]
    fn a_marker_beside_a_dark_thing_has_the_glare_that_the_other_side_shows() {
        let outline = Outline { centre: Vector2::new(150.0, 100.0), major: 70.0, minor: 16.0, angle: 0.0 };
        let value = |i: usize| match (i % 300, i / 300) {
            (_, 115..) => 30,
            (190.., _) => 255,
            _ => 140,
        };
        let image = Raster::new(300, 200, (0..300 * 200).map(value).collect()).expect("the sizes agree");
        let bands = lit_slanting(&image, &outline, BRIGHT);
        assert_eq!(bands, lit(&image, &outline, BRIGHT, 0.0));
        assert!(matches!(bands[..], [Band { from, .. }] if (186.0..190.0).contains(&from)), "{bands:?}");
    }
}
