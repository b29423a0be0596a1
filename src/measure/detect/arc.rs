//! A disc that a neighbour's sheet hides in part: the ellipse through the outline that is left.

use nalgebra::{Cholesky, Matrix2, Matrix3, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

use super::super::setup::Shape;
use super::Detection;
use super::blob::Blob;
use super::candidate::Candidate;
use super::outline::Outline;
use super::sheet::{SHEET_PX, Sheet, bounds_of};

/// How far a cut edge is blurred into what it leaves, px.
const BLUR_PX: f64 = 2.5;
/// Relative difference below which a neighbour is taken to be of the same size.
const SAME_SIZE: f64 = 0.12;
/// Share of the outline that must be seen, beside a disc of the same size, and without.
const SHARE: f64 = 0.35;
const SHARE_ALONE: f64 = 0.55;
/// Points of the outline that must be seen.
const LEAST: usize = 24;

type Conic = SVector<f64, 5>;

/// The candidate with the outline of its whole disc, and where it may be hidden by sheets that lie in the direction of their
/// print. Discs side by side look alike, so the neighbour's shape is where the fit starts from.
pub fn completed(
    candidate: &Candidate,
    blob: &Blob,
    others: &[Blob],
    direction: impl Fn(&Blob) -> Vector2<f64>,
) -> Option<Candidate> {
    let near: Vec<(&Blob, Sheet)> = (others.iter())
        .filter(|o| o.area > 0.3 * blob.area && o.area < 6.0 * blob.area && are_near(o, blob))
        .filter_map(|o| {
            let axis = direction(o);
            let own = bounds_of(blob, axis);
            let sheet = Sheet::over(axis, bounds_of(o, axis), own, [SHEET_PX, BLUR_PX]);
            let h = sheet.bounds;
            (h[0] <= own[2] && own[0] <= h[2] && h[1] <= own[3] && own[1] <= h[3]).then_some((o, sheet))
        })
        .filter(|(o, _)| !overlap(o, blob))
        .collect();
    let hidden: Vec<Sheet> = near.iter().map(|n| n.1).collect();
    let rim = rim(blob);
    let seen: Vec<Vector2<f64>> =
        rim.iter().filter(|p| !hidden.iter().any(|sheet| sheet.holds(p))).copied().collect();
    if seen.len() == rim.len() || (seen.len() as f64) < SHARE * rim.len() as f64 || seen.len() < LEAST {
        return None;
    }
    let alike = (near.iter())
        .filter(|(o, _)| is_ellipse(o))
        .min_by(|a, b| distance(a.0, blob).total_cmp(&distance(b.0, blob)));
    let (like, free) = alike.map_or((blob, true), |(o, _)| (*o, false));
    let mut outline = if free { any_ellipse(&seen, like) } else { same_ellipse(&seen, like) }?;
    let size = Outline::of(like).major;
    let same_size = !free && (outline.major / size - 1.0).abs() < SAME_SIZE;
    if same_size {
        outline.major = size;
    } else if (seen.len() as f64) < SHARE_ALONE * rim.len() as f64 {
        return None;
    }
    let fits = outline.major < 2.0 * candidate.outline.major && outline.minor < 3.0 * candidate.outline.minor;
    fits.then(|| Candidate { outline, hidden, alike: same_size, ..candidate.clone() })
}

/// The semi-major axis of a disc at a place and its standard deviation, px, from the whole ones nearest to it: on a
/// surface that is about plane, the scale of what lies on it changes linearly over the picture.
pub fn foretold_major<'a>(
    whole: impl Iterator<Item = &'a Detection>,
    at: Vector2<f64>,
) -> Option<(f64, f64)> {
    const NEAREST: usize = 6;
    const ENOUGH: usize = 5;
    const SPREAD: f64 = 0.007;
    const UNLIKE: f64 = 0.02;
    /// Share of the usual size below which a place is too far from them all.
    const LEAST: f64 = 0.25;
    /// Greatest sum of variances of a place, px^2, of discs that tell; and where too few are told so well.
    const CERTAIN: f64 = 0.1;
    const FAIRLY: f64 = 0.3;
    let discs: Vec<&Detection> = whole.filter(|d| d.shape == Shape::Circle).collect();
    let within = |most: f64| discs.iter().copied().filter(move |d| d.variance() < most);
    let certain = within(CERTAIN).count() >= ENOUGH;
    let whole: Vec<&Detection> = within(if certain { CERTAIN } else { FAIRLY }).collect();
    // Letters and dots are discs too, but far smaller.
    let usual = super::middle(whole.iter().map(|d| d.semi_major_px).collect())?;
    let mut near: Vec<&Detection> = Vec::new();
    for d in whole.into_iter().filter(|d| d.semi_major_px > 0.5 * usual) {
        if near.iter().all(|other| (other.centre_px - d.centre_px).norm() > 2.0) {
            near.push(d);
        }
    }
    near.sort_by(|a, b| (a.centre_px - at).norm_squared().total_cmp(&(b.centre_px - at).norm_squared()));
    near.truncate(NEAREST);
    let row =
        |d: &Detection| Vector3::new(1.0, (d.centre_px.x - at.x) / 100.0, (d.centre_px.y - at.y) / 100.0);
    let (mut normal, mut right) = (Matrix3::identity() * 1e-9, Vector3::zeros());
    for d in &near {
        normal += row(d) * row(d).transpose();
        right += row(d) * d.semi_major_px;
    }
    let factor = Cholesky::new(normal)?;
    let plane = factor.solve(&right);
    // Far from them all the plane itself is less certain.
    let far = 1.0 + factor.solve(&Vector3::x()).x;
    let squares: f64 = near.iter().map(|d| (row(d).dot(&plane) / d.semi_major_px - 1.0).powi(2)).sum();
    let spread = (squares / (near.len() as f64 - 3.0)).sqrt();
    let sound = near.len() >= ENOUGH && spread < UNLIKE && plane.x > LEAST * usual;
    sound.then_some((plane.x, plane.x * spread.max(SPREAD) * far.sqrt()))
}

/// Whether two blobs are one thing at two levels: the centroid of one lies in the other.
fn overlap(one: &Blob, other: &Blob) -> bool {
    let inside = |a: &Blob, b: &Blob| {
        let outline = Outline::of(a);
        let (s, t) = outline.local(b.centroid);
        (s / outline.major.max(0.5)).hypot(t / outline.minor.max(0.5)) < 1.0
    };
    inside(one, other) || inside(other, one)
}

/// Whether a blob is filled as an ellipse is.
pub fn is_ellipse(blob: &Blob) -> bool {
    !blob.at_edge && (0.95..1.05).contains(&blob.fill())
}

/// Whether the sheet of one blob can reach the other, in whatever direction it lies.
fn are_near(one: &Blob, other: &Blob) -> bool {
    let most = 3 * SHEET_PX as usize;
    let (a, b) = (&one.bounds, &other.bounds);
    (0..2).all(|k| a[k] <= b[k + 2] + most && b[k] <= a[k + 2] + most)
}

fn distance(one: &Blob, other: &Blob) -> f64 {
    (one.centroid - other.centroid).norm()
}

/// The transform that makes a circle of a blob's ellipse.
fn whitening(blob: &Blob) -> Option<Matrix2<f64>> {
    let eigen = SymmetricEigen::new(blob.covariance.try_inverse()?);
    let scale = Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    Some(scale * eigen.eigenvectors.transpose())
}

/// The ellipse through the points; `blob` only conditions it.
pub fn any_ellipse(points: &[Vector2<f64>], blob: &Blob) -> Option<Outline> {
    let whiten = whitening(blob)?;
    let white: Vec<Vector2<f64>> = points.iter().map(|p| whiten * (p - blob.centroid)).collect();
    let (centre, moments) = ellipse(&through(&white)?)?;
    let back = whiten.try_inverse()?;
    Some(Outline::from_moments(blob.centroid + back * centre, back * moments * back.transpose(), 1.0))
}

/// The ellipse through the points that has the axis ratio and direction of `like`.
fn same_ellipse(points: &[Vector2<f64>], like: &Blob) -> Option<Outline> {
    let whiten = whitening(like)?;
    let middle = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let (mut normal, mut right) = (Matrix3::identity() * 1e-9, Vector3::zeros());
    for p in points {
        let w = whiten * (p - middle);
        let row = Vector3::new(2.0 * w.x, 2.0 * w.y, 1.0);
        normal += row * row.transpose();
        right += row * w.norm_squared();
    }
    let circle = Cholesky::new(normal)?.solve(&right);
    let centre = circle.xy();
    let radius2 = circle.z + centre.norm_squared();
    let back = whiten.try_inverse()?;
    (radius2 > 0.0)
        .then(|| Outline::from_moments(middle + back * centre, back * back.transpose() * radius2, 1.0))
}

/// Points half a pixel outside the first and last pixel of each row and column.
pub fn rim(blob: &Blob) -> Vec<Vector2<f64>> {
    let [x0, y0, x1, y1] = blob.bounds;
    let mut rows = vec![(u32::MAX, 0); y1 - y0 + 1];
    let mut columns = vec![(u32::MAX, 0); x1 - x0 + 1];
    for &[y, from, to] in &blob.runs {
        let row = &mut rows[y as usize - y0];
        *row = (row.0.min(from), row.1.max(to));
        for column in &mut columns[from as usize - x0..=to as usize - x0] {
            *column = (column.0.min(y), column.1.max(y));
        }
    }
    let mut out = Vec::with_capacity(2 * (rows.len() + columns.len()));
    for (y, &(from, to)) in (y0..).zip(&rows) {
        out.push(Vector2::new(f64::from(from) - 0.5, y as f64));
        out.push(Vector2::new(f64::from(to) + 0.5, y as f64));
    }
    for (x, &(from, to)) in (x0..).zip(&columns) {
        out.push(Vector2::new(x as f64, f64::from(from) - 0.5));
        out.push(Vector2::new(x as f64, f64::from(to) + 0.5));
    }
    out
}

fn row(p: &Vector2<f64>) -> Conic {
    Conic::new(p.x * p.x, p.x * p.y, p.y * p.y, p.x, p.y)
}

/// Least squares of `a x^2 + b x y + c y^2 + d x + e y = 1`.
fn through(points: &[Vector2<f64>]) -> Option<Conic> {
    let mut normal = SMatrix::<f64, 5, 5>::identity() * 1e-9;
    let mut right = Conic::zeros();
    for p in points {
        let r = row(p);
        normal += r * r.transpose();
        right += r;
    }
    Some(Cholesky::new(normal)?.solve(&right))
}

/// Centre, and the matrix whose unit ellipse it is.
fn ellipse(conic: &Conic) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let form = Matrix2::new(conic[0], 0.5 * conic[1], 0.5 * conic[1], conic[2]);
    if form.determinant() <= 0.0 || form.trace() <= 0.0 {
        return None;
    }
    let centre = -0.5 * (form.try_inverse()? * Vector2::new(conic[3], conic[4]));
    let level = 1.0 + (centre.transpose() * form * centre).x;
    Some((centre, (form / level).try_inverse()?))
}
