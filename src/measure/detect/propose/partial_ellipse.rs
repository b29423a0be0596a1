//! Disc that is partly hidden by the decal of a neighbour: the ellipse through the visible outline.

use nalgebra::{Cholesky, Matrix2, Matrix3, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

use crate::detect::hypothesis::{Hypothesis, prior::MarkerPrior};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::TINY;
use crate::detect::occlusion::decal::{Decal, blob_bounds};
use crate::detect::occlusion::options::DECAL;
use crate::detect::propose::options::PARTIAL;
use crate::detect::segment::blob::Blob;

type Conic = SVector<f64, 5>;

/// Returns the hypothesis with the outline of its complete disc and the decals that may hide it, which lie in the
/// `direction` of their print. Neighbouring discs are similar, so the fit starts from the neighbour's shape.
pub fn complete_disc(
    hypothesis: &Hypothesis,
    blob: &Blob,
    others: &[Blob],
    direction: impl Fn(&Blob) -> Vector2<f64>,
) -> Option<Hypothesis> {
    let near: Vec<(&Blob, Decal)> = (others.iter())
        .filter(|o| are_similar(o, blob) && are_near(o, blob))
        .filter_map(|o| {
            let axis = direction(o);
            let own = blob_bounds(blob, axis);
            let decal = Decal::from_print(axis, blob_bounds(o, axis), own, [DECAL.margin_px, PARTIAL.blur_px]);
            let h = decal.bounds;
            (h[0] <= own[2] && own[0] <= h[2] && h[1] <= own[3] && own[1] <= h[3]).then_some((o, decal))
        })
        .filter(|(o, _)| !are_overlapping(o, blob))
        .collect();
    let hidden: Vec<Decal> = near.iter().map(|n| n.1).collect();
    let contour = blob.contour();
    let seen: Vec<Vector2<f64>> =
        contour.iter().filter(|p| !hidden.iter().any(|decal| decal.contains(p))).copied().collect();
    if seen.len() == contour.len()
        || (seen.len() as f64) < PARTIAL.share * contour.len() as f64
        || seen.len() < PARTIAL.min_points
    {
        return None;
    }
    let similar = (near.iter())
        .filter(|(o, _)| is_ellipse(o))
        .min_by(|a, b| centroid_distance(a.0, blob).total_cmp(&centroid_distance(b.0, blob)));
    let (twin, free) = similar.map_or((blob, true), |(o, _)| (*o, false));
    let mut ellipse = if free { fit_ellipse(&seen, twin) } else { fit_similar_ellipse(&seen, twin) }?;
    let size = Ellipse::from_blob(twin).major;
    let same_size = !free && (ellipse.major / size - 1.0).abs() < PARTIAL.same_size;
    if same_size {
        ellipse.major = size;
    } else if (seen.len() as f64) < PARTIAL.share_alone * contour.len() as f64 {
        return None;
    }
    let (seen, larger) = (&hypothesis.ellipse, PARTIAL.larger);
    let fits = ellipse.major < larger[0] * seen.major && ellipse.minor < larger[1] * seen.minor;
    let prior = MarkerPrior { twin: same_size, ..hypothesis.prior };
    fits.then(|| Hypothesis { ellipse, prior, ..hypothesis.clone() }.with_decals(hidden))
}

/// Returns true if two blobs are one object at two levels: the centroid of one lies in the other.
fn are_overlapping(one: &Blob, other: &Blob) -> bool {
    let inside = |a: &Blob, b: &Blob| {
        let ellipse = Ellipse::from_blob(a);
        let (s, t) = ellipse.local_position(b.centroid);
        (s / ellipse.major.max(0.5)).hypot(t / ellipse.minor.max(0.5)) < 1.0
    };
    inside(one, other) || inside(other, one)
}

/// Returns true if a blob is filled as an ellipse is.
pub fn is_ellipse(blob: &Blob) -> bool {
    !blob.at_edge && (PARTIAL.fill.0..PARTIAL.fill.1).contains(&blob.fill())
}

/// Returns true if a blob may be a disc next to another one.
fn are_similar(one: &Blob, other: &Blob) -> bool {
    one.area > PARTIAL.neighbour.0 * other.area && one.area < PARTIAL.neighbour.1 * other.area
}

/// Returns true if the decal of one blob can reach the other, in any direction.
fn are_near(one: &Blob, other: &Blob) -> bool {
    let most = 3 * DECAL.margin_px as usize;
    let (a, b) = (&one.bounds, &other.bounds);
    (0..2).all(|k| a[k] <= b[k + 2] + most && b[k] <= a[k + 2] + most)
}

fn centroid_distance(one: &Blob, other: &Blob) -> f64 {
    (one.centroid - other.centroid).norm()
}

/// Returns the transform that maps a blob's ellipse to a circle.
fn whitening_transform(blob: &Blob) -> Option<Matrix2<f64>> {
    let eigen = SymmetricEigen::new(blob.covariance.try_inverse()?);
    let scale = Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    Some(scale * eigen.eigenvectors.transpose())
}

/// Fits an ellipse through the points; `blob` only conditions the fit.
pub fn fit_ellipse(points: &[Vector2<f64>], blob: &Blob) -> Option<Ellipse> {
    let whiten = whitening_transform(blob)?;
    let white: Vec<Vector2<f64>> = points.iter().map(|p| whiten * (p - blob.centroid)).collect();
    let (centre, moments) = centre_and_shape(&fit_conic(&white)?)?;
    let back = whiten.try_inverse()?;
    Some(Ellipse::from_moments(blob.centroid + back * centre, back * moments * back.transpose(), 1.0))
}

/// Fits an ellipse through the points with the axis ratio and direction of `twin`.
fn fit_similar_ellipse(points: &[Vector2<f64>], twin: &Blob) -> Option<Ellipse> {
    let whiten = whitening_transform(twin)?;
    let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let (mut normal, mut right) = (Matrix3::identity() * TINY, Vector3::zeros());
    for p in points {
        let w = whiten * (p - mean);
        let row = Vector3::new(2.0 * w.x, 2.0 * w.y, 1.0);
        normal += row * row.transpose();
        right += row * w.norm_squared();
    }
    let circle = Cholesky::new(normal)?.solve(&right);
    let centre = circle.xy();
    let radius2 = circle.z + centre.norm_squared();
    let back = whiten.try_inverse()?;
    (radius2 > 0.0).then(|| Ellipse::from_moments(mean + back * centre, back * back.transpose() * radius2, 1.0))
}

/// Returns the design row of a conic at a point.
pub fn conic_row(p: &Vector2<f64>) -> Conic {
    Conic::new(p.x * p.x, p.x * p.y, p.y * p.y, p.x, p.y)
}

/// Fits `a x^2 + b x y + c y^2 + d x + e y = 1` by least squares.
fn fit_conic(points: &[Vector2<f64>]) -> Option<Conic> {
    let mut normal = SMatrix::<f64, 5, 5>::identity() * TINY;
    let mut right = Conic::zeros();
    for p in points {
        let r = conic_row(p);
        normal += r * r.transpose();
        right += r;
    }
    Some(Cholesky::new(normal)?.solve(&right))
}

/// Returns the centre of a conic, and the matrix whose unit ellipse it is; `None` if it is not an ellipse.
fn centre_and_shape(conic: &Conic) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let form = Matrix2::new(conic[0], 0.5 * conic[1], 0.5 * conic[1], conic[2]);
    if form.determinant() <= 0.0 || form.trace() <= 0.0 {
        return None;
    }
    let centre = -0.5 * (form.try_inverse()? * Vector2::new(conic[3], conic[4]));
    let level = 1.0 + (centre.transpose() * form * centre).x;
    Some((centre, (form / level).try_inverse()?))
}
