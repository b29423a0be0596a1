//! Classification of blobs into discs and pairs of black quadrants, with a first geometry.

use std::f64::consts::PI;
use std::sync::LazyLock;

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::hypothesis::{EdgePair, Hypothesis};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::propose::options::MOMENTS;
use crate::detect::segment::blob::Blob;
use crate::ordering::sort_by_value;

/// Area, centroid and second moments of one or several blobs.
struct BlobShape {
    area: f64,
    centre: Vector2<f64>,
    covariance: Matrix2<f64>,
}

fn combine_blob_shapes(blobs: &[&Blob]) -> BlobShape {
    let area: f64 = blobs.iter().map(|b| b.area).sum();
    let centre = blobs
        .iter()
        .map(|b| b.centroid * b.area)
        .sum::<Vector2<f64>>()
        / area;
    let covariance = (blobs.iter())
        .map(|b| {
            let d = b.centroid - centre;
            (b.covariance + d * d.transpose()) * b.area
        })
        .sum::<Matrix2<f64>>()
        / area;
    BlobShape {
        area,
        centre,
        covariance,
    }
}

/// Returns the ellipse of inertia of some of the blobs together.
pub fn inertia_ellipse(indices: &[usize], all: &[Blob]) -> Option<Ellipse> {
    let blobs: Vec<&Blob> = indices.iter().map(|&i| all.get(i)).collect::<Option<_>>()?;
    let shape = combine_blob_shapes(&blobs);
    Some(Ellipse::from_moments(shape.centre, shape.covariance, 2.0))
}

/// Returns a disc if the blob fills its ellipse of inertia.
pub fn disc_from_blob(index: usize, blob: &Blob) -> Option<Hypothesis> {
    let ellipse = Ellipse::from_blob(blob);
    let most = if ellipse.minor < MOMENTS.thin_px {
        MOMENTS.max_squareness_thin
    } else {
        MOMENTS.max_squareness + MOMENTS.max_squareness_px2 / (ellipse.minor * ellipse.minor)
    };
    (MOMENTS.disc_fill.contains(&blob.fill()) && squareness(blob) < most)
        .then(|| Hypothesis::new(MarkerPattern::Disc, ellipse, vec![index]))
}

/// Second moment, relative to their area, of two opposite quadrants of the unit disc along their direction (1, 1)/sqrt 2.
const MOMENT_ALONG: f64 = 0.25 + 0.5 / PI;
/// Second moment, relative to their area, of two opposite quadrants of the unit disc across that direction.
const MOMENT_ACROSS: f64 = 0.25 - 0.5 / PI;

/// Returns two opposite quadrants from one blob or two: the affine image of those of the unit disc that has the observed
/// area, centroids and second moments.
pub fn quadrants_from_blobs(indices: &[usize], all: &[Blob]) -> Option<Hypothesis> {
    let blobs: Vec<&Blob> = indices.iter().map(|&i| all.get(i)).collect::<Option<_>>()?;
    let shape = combine_blob_shapes(&blobs);
    let det = shape.covariance.determinant();
    if det <= MOMENTS.min_determinant_px4
        || !MOMENTS
            .fill
            .contains(&(shape.area / (4.0 * PI * det.sqrt())))
    {
        return None;
    }
    let (whiten, [one, other]) = split_wedges(&blobs, &shape)?;
    // Whitened, the diagonals (1, 1) and (1, -1) of the pattern are orthogonal and of known length.
    let diagonal = (whiten * (other - one)) * (0.5 * 3.0 * PI / 4.0);
    let length = (2.0 / MOMENT_ALONG).sqrt();
    if !MOMENTS.apart.contains(&(diagonal.norm() / length)) {
        return None;
    }
    let unit = diagonal.normalize();
    let back = whiten.try_inverse()?;
    let p = back * unit * length;
    let q = back * Vector2::new(-unit.y, unit.x) * (2.0 / MOMENT_ACROSS).sqrt();
    let (e1, e2) = ((p + q) * 0.5, (p - q) * 0.5);
    let affine = Matrix2::from_columns(&[e1, e2]);
    let expected = 0.5 * PI * affine.determinant().abs();
    if !MOMENTS.area.contains(&(shape.area / expected)) {
        return None;
    }
    let ellipse = Ellipse::from_moments(shape.centre, affine * affine.transpose(), 1.0);
    Some(quadrants_from_edges(e1, e2, ellipse, indices))
}

/// Returns quadrants of which the black ones lie between two directions, and opposite.
pub fn quadrants_from_edges(
    e1: Vector2<f64>,
    e2: Vector2<f64>,
    ellipse: Ellipse,
    blobs: &[usize],
) -> Hypothesis {
    let (u1, u2) = (e1.normalize(), e2.normalize());
    let half = 0.5 * u1.dot(&u2).clamp(-1.0, 1.0).acos();
    let bisector = u1 + u2;
    let along = bisector.y.atan2(bisector.x);
    let (pattern, along_rad, half) = if half <= PI / 4.0 {
        (MarkerPattern::BlackAlong, along, half)
    } else {
        (MarkerPattern::WhiteAlong, along + PI / 2.0, PI / 2.0 - half)
    };
    let edges = EdgePair {
        along_rad,
        tangent: half.tan(),
    };
    Hypothesis {
        edges: Some(edges),
        ..Hypothesis::new(pattern, ellipse, blobs.to_vec())
    }
}

/// Number of directions in which the kurtosis is computed, in equal steps over half a turn.
const DIRECTIONS: usize = 36;

/// Coefficients of the fourth moments x^4, x^3 y, x^2 y^2, x y^3, y^4 for each direction.
static FOURTH_POWERS: LazyLock<[[f64; 5]; DIRECTIONS]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let (s, c) = direction_sin_cos(k);
        [
            c.powi(4),
            4.0 * c.powi(3) * s,
            6.0 * c * c * s * s,
            4.0 * c * s.powi(3),
            s.powi(4),
        ]
    })
});

/// Returns sine and cosine of the `k`-th direction.
fn direction_sin_cos(k: usize) -> (f64, f64) {
    (k as f64 * PI / DIRECTIONS as f64).sin_cos()
}

/// Returns the whitening transform of a shape, and its kurtosis in each of the whitened directions.
fn directional_kurtosis(
    blobs: &[&Blob],
    shape: &BlobShape,
) -> Option<(Matrix2<f64>, [f64; DIRECTIONS])> {
    let inverse = shape.covariance.try_inverse()?;
    let eigen = SymmetricEigen::new(inverse);
    let scale = Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    let whiten = scale * eigen.eigenvectors.transpose();
    // Fourth moments in whitened coordinates: x^4, x^3 y, x^2 y^2, x y^3, y^4.
    let mut fourth = [0.0; 5];
    let (p, q) = (whiten[(0, 0)], whiten[(1, 0)]);
    let (pp, pq, qq) = (p * p, p * q, q * q);
    for &[y, from, to] in blobs.iter().flat_map(|b| &b.runs) {
        // A run's pixels lie at `middle + k (p, q)`, k from `-(n - 1) / 2` on: odd powers of k cancel.
        let middle = Vector2::new(0.5 * (f64::from(from) + f64::from(to)), f64::from(y));
        let w = whiten * (middle - shape.centre);
        let (xx, xy, yy) = (w.x * w.x, w.x * w.y, w.y * w.y);
        let n = f64::from(to - from + 1);
        let second = n * (n * n - 1.0) / 12.0;
        let fourth_power = second * (3.0 * n * n - 7.0) / 20.0;
        let sums = [
            n * xx * xx + 6.0 * second * xx * pp + fourth_power * pp * pp,
            n * xx * xy + 3.0 * second * (xy * pp + xx * pq) + fourth_power * pp * pq,
            n * xx * yy + second * (xx * qq + 4.0 * xy * pq + yy * pp) + fourth_power * pp * qq,
            n * xy * yy + 3.0 * second * (xy * qq + yy * pq) + fourth_power * pq * qq,
            n * yy * yy + 6.0 * second * yy * qq + fourth_power * qq * qq,
        ];
        fourth.iter_mut().zip(sums).for_each(|(f, v)| *f += v);
    }
    let [a, b, d, e, f] = fourth.map(|v| v / shape.area);
    let along = |[xxxx, xxxy, xxyy, xyyy, yyyy]: [f64; 5]| {
        xxxx * a + xxxy * b + xxyy * d + xyyy * e + yyyy * f
    };
    Some((whiten, FOURTH_POWERS.map(along)))
}

/// Returns the variation of the kurtosis with direction: 0 for an ellipse, 0.6 for a parallelogram.
pub fn squareness(blob: &Blob) -> f64 {
    let Some((_, k)) = directional_kurtosis(&[blob], &combine_blob_shapes(&[blob])) else {
        return 0.0;
    };
    let (low, high) = k
        .iter()
        .fold((f64::MAX, f64::MIN), |(l, h), &v| (l.min(v), h.max(v)));
    high - low
}

/// Returns the whitening transform and the centroids of the two wedges. After whitening, two opposite wedges lie in the
/// direction of minimum kurtosis, which is 2 in all directions for a disc and 1.38 for two quadrants.
fn split_wedges(blobs: &[&Blob], shape: &BlobShape) -> Option<(Matrix2<f64>, [Vector2<f64>; 2])> {
    let (whiten, kurtosis) = directional_kurtosis(blobs, shape)?;
    let best = (0..DIRECTIONS).min_by(|&i, &j| kurtosis[i].total_cmp(&kurtosis[j]))?;
    if kurtosis[best] > MOMENTS.kurtosis {
        return None;
    }
    let (s, c) = direction_sin_cos(best);
    let direction = whiten.transpose() * Vector2::new(c, s);
    let mut sums = [(0.0, Vector2::zeros()), (0.0, Vector2::zeros())];
    for run in blobs.iter().flat_map(|b| &b.runs) {
        let [y, from, to] = run.map(f64::from);
        // The side changes once along a run.
        let level = direction.y * (y - shape.centre.y);
        let turn = shape.centre.x - level / direction.x;
        let (before, last) = if direction.x > 0.0 {
            (0, turn.floor())
        } else if direction.x < 0.0 {
            (1, turn.ceil() - 1.0)
        } else {
            (usize::from(level > 0.0), to)
        };
        let last = last.clamp(from - 1.0, to);
        for (side, from, to) in [(before, from, last), (1 - before, last + 1.0, to)] {
            let count = to - from + 1.0;
            sums[side].0 += count;
            sums[side].1 += Vector2::new(0.5 * (from + to), y) * count;
        }
    }
    let [(n0, s0), (n1, s1)] = sums;
    let least = MOMENTS.half * shape.area;
    (n0 > least && n1 > least).then(|| (whiten, [s0 / n0, s1 / n1]))
}

/// Maximum ratio of the areas of the two black quadrants of one marker.
const MAX_AREA_RATIO: f64 = 2.5;

/// Returns the pairs of blobs that are close enough to be the two black quadrants of one marker, in ascending order.
pub fn find_pairs(blobs: &[Blob]) -> Vec<[usize; 2]> {
    // Sorted by area, so that only blobs of similar area are compared.
    let mut order: Vec<usize> = (0..blobs.len()).collect();
    sort_by_value(&mut order, |&i| blobs[i].area);
    let sorted: Vec<(f64, Vector2<f64>, f64)> = order
        .iter()
        .map(|&i| &blobs[i])
        .map(|b| {
            (
                b.area,
                b.centroid,
                MOMENTS.pair.at(b.covariance.trace().sqrt()),
            )
        })
        .collect();
    let mut out = Vec::new();
    for (k, &(area, place, reach)) in sorted.iter().enumerate() {
        let similar = sorted[k + 1..]
            .iter()
            .take_while(|other| other.0 < MAX_AREA_RATIO * area);
        for (other, _) in (k + 1..).zip(similar).filter(|(_, other)| {
            let near = reach + other.2;
            (other.1 - place).norm_squared() < near * near
        }) {
            let (i, j) = (order[k], order[other]);
            out.push([i.min(j), i.max(j)]);
        }
    }
    out.sort_unstable();
    out
}
