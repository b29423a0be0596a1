//! Stage 4: the outline of quadrants, from one level for all of them, or from all that is unlike the skin.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2};

use super::super::raster::Raster;
use super::blob::{self, Blob};
use super::candidate::{self, Candidate, Outline};
use super::counts::Counts;
use super::fit::contrast;
use super::model::{BLUR, LIGHT, Parameters, X, Y};
use super::oval::{Oval, columns, row_of};

/// How much longer quadrants' white must be than their black to tell their length; and its least contrast against the skin,
/// as a share of theirs.
const LONGER: f64 = 1.1;
const WHITER: f64 = 0.12;
/// Ratio of the areas of two black quadrants beyond which they were seen against different thresholds.
const UNEQUAL: f64 = 1.2;
/// Semi-minor axis from which on blur takes too little of quadrants to tell, px.
const THICK: f64 = 20.0;
/// Semi-minor axis, in blurs, below which black and white together tell the outline better than black alone.
const NARROW: f64 = 8.0;
/// How far the outline's centre may lie from where the edges of such quadrants cross, px.
const ASIDE: f64 = 1.5;

/// Flat quadrants of whose black blur may take so much that what is left tells neither outline nor edges: greatest
/// semi-minor axis, over the greatest blur, and least axis ratio of what is seen; how much larger they may be, and skin about
/// them, px.
const BLURRED: f64 = 3.2;
const FLAT: f64 = 3.0;
const HIDDEN: f64 = 2.5;
const SKIN: f64 = 8.0;

/// Quadrants with the outline of what is nearer to black than to white.
pub fn outlined(image: &Raster, candidate: Candidate, m: &Parameters) -> Candidate {
    if candidate.edges.is_none() {
        return candidate;
    }
    let saddle = Vector2::new(m[X], m[Y]);
    let outline = &candidate.outline;
    if candidate.against_skin {
        return Candidate { outline: Outline { centre: saddle, ..*outline }, ..candidate };
    }
    // Skin is darker than white: nearer to black it does not run into the quadrants.
    let found = [0.65, 0.8].iter().find_map(|share| {
        let level = (m[LIGHT] - share * contrast(m)).clamp(0.0, 255.0) as u8;
        let own = blob::dark_parts(image, outline, 0.0, level);
        candidate::quadrants(&[0, 1], &own).or_else(|| candidate::quadrants(&[0], &own))
    });
    let mut out = found.map_or(*outline, |f| f.outline);
    if let Some(longer) = length_of_white(image, &out, m).filter(|longer| *longer > LONGER * out.major) {
        out.major = longer;
    }
    if out.minor < NARROW * m[BLUR] {
        let alike = |seen: &Outline| {
            let (longer, wider) = (seen.major / out.major, seen.minor / out.minor);
            (0.8..1.5).contains(&longer) && (0.8..1.4).contains(&wider)
        };
        out = unlike_skin(image, &out).filter(alike).unwrap_or(out);
    }
    // Blur takes more of one black part's thin end than of the other's.
    if out.minor < THICK && (out.centre - saddle).norm() > ASIDE {
        out.centre = saddle;
    }
    Candidate { outline: out, ..candidate }
}

/// Quadrants whose two black parts were seen against thresholds so different that one is much larger, seen once more
/// against one; `None` where they are alike.
pub fn at_one_level(image: &Raster, candidate: &Candidate, blobs: &[Blob]) -> Option<Candidate> {
    let [one, other] = candidate.blobs[..] else { return None };
    let ratio = blobs.get(one)?.area / blobs.get(other)?.area;
    if candidate.edges.is_none() || (1.0 / UNEQUAL..UNEQUAL).contains(&ratio) {
        return None;
    }
    let outline = &candidate.outline;
    let counts = Counts::of(inside(image, outline));
    let (black, white) = (counts.at(counts.total() / 10)?, counts.at(counts.total() * 9 / 10)?);
    let own = blob::dark_parts(image, outline, 0.0, black.midpoint(white) as u8);
    let found = candidate::quadrants(&[0, 1], &own)?;
    Some(Candidate { blobs: candidate.blobs.clone(), ..found })
}

/// Flat quadrants of whose black blur has left only the middle, seen once more by all that is unlike the skin, black and
/// white; `None` for those that are too thick for the greatest blur, px.
pub fn against_skin(image: &Raster, candidate: &Candidate, softest: f64) -> Option<Candidate> {
    let seen = &candidate.outline;
    if candidate.edges.is_none() || seen.minor > BLURRED * softest || seen.major < FLAT * seen.minor {
        return None;
    }
    let found = within(unlike_skin(image, seen)?, image, &candidate.blobs)?;
    Some(Candidate { like: candidate.like, ..found })
}

/// Grey values of the pixels within an outline.
fn inside(image: &Raster, outline: &Outline) -> impl Iterator<Item = u8> {
    let rows = Oval::new(outline).grown(0.0);
    let (reach, centre) = (outline.extent().y, outline.centre.y);
    let area = [0, 0, image.width() - 1, image.height() - 1];
    let lines = (centre - reach).max(0.0) as usize..(centre + reach).max(0.0) as usize + 1;
    lines.flat_map(move |y| {
        let columns = row_of(&rows, y as f64).map(|(from, to)| columns(from, to, area));
        columns.and_then(|columns| image.row(y).get(columns)).unwrap_or(&[]).iter().copied()
    })
}

/// The skin's grey value in a box of which a marker takes less than half.
fn skin(image: &Raster, low: Vector2<f64>, high: Vector2<f64>) -> Option<usize> {
    Counts::of(image.part(low, high, 2).map(|(_, _, value)| value)).middle()
}

/// The outline of all that is unlike the skin about what is seen of quadrants.
fn unlike_skin(image: &Raster, seen: &Outline) -> Option<Outline> {
    let reach = (seen.extent() * HIDDEN).add_scalar(SKIN);
    let (low, high) = (seen.centre - reach, seen.centre + reach);
    let skin = skin(image, low, high)?;
    let black = usize::from(inside(image, seen).min()?);
    let far = skin.saturating_sub(black) / 3;
    let parts = blob::blobs_of(image, low, high, |v| usize::from(v).abs_diff(skin) > far);
    let longest = Outline { major: HIDDEN * seen.major, minor: HIDDEN * seen.minor, ..*seen };
    let least = 0.1 * seen.major * seen.minor;
    let parts: Vec<&Blob> = parts.iter().filter(|b| b.area > least && longest.holds(b.centroid)).collect();
    hull(&parts).filter(|outline| outline.minor >= 1.0)
}

/// The ellipse of inertia of the convex hull of some blobs; `None` where they are too far from an ellipse. Cracks between
/// them, as between black and white that are both unlike the skin, do not matter.
fn hull(parts: &[&Blob]) -> Option<Outline> {
    /// Least share of the hull that is seen, and least of its ellipse that it fills: a parallelogram 0.95.
    const SEEN: f64 = 0.4;
    const FULL: f64 = 0.9;
    let ends = |&[y, from, to]: &[u32; 3]| [from, to].map(|x| Vector2::new(f64::from(x), f64::from(y)));
    let mut points: Vec<Vector2<f64>> = parts.iter().flat_map(|b| b.runs.iter().flat_map(ends)).collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    // Lower and upper chain from left to right (Andrew's monotone chain).
    let chain = |points: &mut dyn Iterator<Item = &Vector2<f64>>| {
        let mut out: Vec<Vector2<f64>> = Vec::new();
        for p in points {
            while let [.., a, b] = out[..]
                && (b - a).perp(&(p - a)) <= 0.0
            {
                out.pop();
            }
            out.push(*p);
        }
        out.pop();
        out
    };
    let mut corners = chain(&mut points.iter());
    corners.extend(chain(&mut points.iter().rev()));
    // Moments of the triangles from the first corner, counted from there.
    let first = *corners.first()?;
    let (mut area, mut sum, mut square) = (0.0, Vector2::zeros(), Matrix2::zeros());
    for pair in corners.windows(2) {
        let (a, b) = (pair[0] - first, pair[1] - first);
        let part = 0.5 * a.perp(&b);
        area += part;
        sum += (a + b) * (part / 3.0);
        square += ((a + b) * (a + b).transpose() + a * a.transpose() + b * b.transpose()) * (part / 12.0);
    }
    let area = Some(area).filter(|area| *area > 1.0)?;
    let centre = sum / area;
    let outline = Outline::from_moments(first + centre, square / area - centre * centre.transpose(), 2.0);
    let own: f64 = parts.iter().map(|b| b.area).sum();
    (own > SEEN * area && area > FULL * PI * outline.major * outline.minor).then_some(outline)
}

/// Quadrants with an outline that holds black and white: of the pairs of edges that are conjugate diameters the one that best
/// parts dark from light.
fn within(outline: Outline, image: &Raster, blobs: &[usize]) -> Option<Candidate> {
    const TURNS: usize = 36;
    const INNER: f64 = 0.85;
    let oval = Oval::new(&outline);
    let half = Vector2::new(oval.cos, oval.sin) * outline.major;
    let across = Vector2::new(-oval.sin, oval.cos) * outline.minor;
    let reach = outline.extent();
    // Grey value by the direction in the outline seen as a circle; opposite ones are alike.
    let mut sums = [(0.0, 0.0); TURNS];
    for (x, y, value) in image.part(outline.centre - reach, outline.centre + reach, 1) {
        let (s, t) = oval.local(x as f64, y as f64);
        let (p, q) = (s / outline.major, t / outline.minor);
        if p * p + q * q < INNER * INNER {
            let turn = (q.atan2(p).rem_euclid(PI) / PI * TURNS as f64) as usize % TURNS;
            sums[turn].0 += f64::from(value);
            sums[turn].1 += 1.0;
        }
    }
    let grey = sums.map(|(sum, count)| sum / f64::max(count, 1.0));
    let quarter = |from: usize| (0..TURNS / 2).map(|k| grey[(from + k) % TURNS]).sum::<f64>();
    let darkest = (0..TURNS).min_by(|&i, &j| quarter(i).total_cmp(&quarter(j)))?;
    let edge = |turn: usize| {
        let (q, p) = (PI * turn as f64 / TURNS as f64).sin_cos();
        half * p + across * q
    };
    let found = candidate::between(edge(darkest), edge(darkest + TURNS / 2), outline, blobs);
    Some(Candidate { against_skin: true, ..found })
}

/// Half the length of quadrants' white along their outline's axis, px, which is the whole marker's: of a flat marker blur
/// takes the thin ends of the black, where the white is thickest.
fn length_of_white(image: &Raster, outline: &Outline, m: &Parameters) -> Option<f64> {
    if outline.minor > THICK {
        return None;
    }
    let centre = Vector2::new(m[X], m[Y]);
    let reach = outline.extent() * 2.2;
    let (low, high) = (centre - reach, centre + reach);
    let skin = skin(image, low, high)? as f64;
    let level = 0.5 * (skin + m[LIGHT]);
    if m[LIGHT] - skin < WHITER * contrast(m) {
        return None;
    }
    let own = |s: f64, t: f64| s.abs() < 2.2 * outline.major && t.abs() < outline.minor + 2.0;
    let place = |at: Vector2<f64>| Outline { centre, ..*outline }.local(at);
    let (mut least, mut most) = (0.0f64, 0.0f64);
    for blob in blob::lighter_than(image, low, high, level.clamp(0.0, 254.0) as u8) {
        let (s, t) = place(blob.centroid);
        if !own(s, t) || blob.area < 0.05 * outline.major * outline.minor {
            continue;
        }
        for &[y, from, to] in &blob.runs {
            for x in [from, to] {
                let (s, _) = place(Vector2::new(f64::from(x), f64::from(y)));
                (least, most) = (least.min(s), most.max(s));
            }
        }
    }
    let even = least < -0.7 * outline.major
        && most > 0.7 * outline.major
        && most < -1.25 * least
        && -least < 1.25 * most;
    even.then_some(0.5 * (most - least))
}
