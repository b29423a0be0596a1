//! Start values of the adjustment: focal length and poses from homographies (Zhang 2000).

use nalgebra::{DMatrix, Matrix3, Rotation3, Vector2, Vector3};

use super::model::{BoardPose, ImageSize};
use super::{BoardPoint, BoardView};
use crate::geometry::Lens;

/// Camera constants over the image width of typical lenses, from wide to long: each may be off by the square root of its
/// neighbours' ratio.
pub(super) const TYPICAL_FOCAL_RATIOS: [f64; 6] = [0.4, 0.65, 1.0, 1.6, 2.6, 4.5];

/// Returns a lens without distortion, its principal point at the centre, and the views' poses; the focal length is
/// `f_px` or estimated from the views.
pub(super) fn start_from_homographies(
    views: &[&BoardView],
    size: ImageSize,
    f_px: Option<f64>,
) -> Option<(Lens, Vec<BoardPose>)> {
    let centre = size.centre();
    let homographies: Vec<Matrix3<f64>> = views
        .iter()
        .map(|v| fit_homography(v, &centre))
        .collect::<Option<Vec<_>>>()?;
    let f = f_px.or_else(|| estimate_camera_constant(&homographies))?;
    let poses = homographies
        .iter()
        .map(|h| pose_from_homography(h, f))
        .collect::<Option<Vec<_>>>()?;
    Some((
        Lens::pinhole(size.width, size.height, f, centre.x, centre.y),
        poses,
    ))
}

/// Distortions tried for the fit of a plane, as `1 + d r^2` with `r` over half the image's diagonal: from barrel to
/// pincushion distortion (division model, Fitzgibbon 2001).
const TRIAL_DISTORTIONS: [f64; 9] = [-0.6, -0.5, -0.4, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2];

/// Returns the root mean square distance of a view's points from the best image of a plane through an approximate lens, px;
/// infinite if there is none.
pub(super) fn min_plane_misfit_px(view: &BoardView, size: ImageSize) -> f64 {
    let centre = size.centre();
    let flattened = |distortion: f64| -> BoardView {
        let place = |p: &BoardPoint| {
            let off = p.pixel - centre;
            let stretched = off / (1.0 + distortion * off.norm_squared() / centre.norm_squared());
            BoardPoint {
                pixel: centre + stretched,
                ..*p
            }
        };
        view.iter().map(place).collect()
    };
    TRIAL_DISTORTIONS
        .iter()
        .map(|d| homography_misfit_px(&flattened(*d), &centre))
        .fold(f64::INFINITY, f64::min)
}

fn homography_misfit_px(view: &BoardView, centre: &Vector2<f64>) -> f64 {
    let Some(h) = fit_homography(view, centre) else {
        return f64::INFINITY;
    };
    let squared = |p: &BoardPoint| {
        let q = h * Vector3::new(p.board_m.x, p.board_m.y, 1.0);
        (q.xy() / q.z + centre - p.pixel).norm_squared()
    };
    (view.iter().map(squared).sum::<f64>() / view.len() as f64).sqrt()
}

/// Estimates centred pixel from board plane by the direct linear transform with normalised coordinates.
fn fit_homography(view: &[BoardPoint], centre: &Vector2<f64>) -> Option<Matrix3<f64>> {
    let n = view.len() as f64;
    let mean = view.iter().map(|p| p.board_m).sum::<Vector2<f64>>() / n;
    let radius_m = (view
        .iter()
        .map(|p| (p.board_m - mean).norm_squared())
        .sum::<f64>()
        / n)
        .sqrt();
    let scale = 0.25 * (centre.x + centre.y);
    let mut rows = DMatrix::zeros(2 * view.len(), 9);
    for (k, p) in view.iter().enumerate() {
        let b = (p.board_m - mean) / radius_m;
        let q = (p.pixel - centre) / scale;
        let (x, y) = (b.x, b.y);
        let u = [x, y, 1.0, 0.0, 0.0, 0.0, -q.x * x, -q.x * y, -q.x];
        let v = [0.0, 0.0, 0.0, x, y, 1.0, -q.y * x, -q.y * y, -q.y];
        for c in 0..9 {
            rows[(2 * k, c)] = u[c];
            rows[(2 * k + 1, c)] = v[c];
        }
    }
    let eigen = (rows.transpose() * rows).symmetric_eigen();
    let smallest = eigen.eigenvalues.imin();
    let h = eigen.eigenvectors.column(smallest);
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let board = Matrix3::new(
        1.0 / radius_m,
        0.0,
        -mean.x / radius_m,
        0.0,
        1.0 / radius_m,
        -mean.y / radius_m,
        0.0,
        0.0,
        1.0,
    );
    let pixel = Matrix3::new(scale, 0.0, 0.0, 0.0, scale, 0.0, 0.0, 0.0, 1.0);
    let h = pixel * h * board;
    h.iter().all(|v| v.is_finite()).then_some(h)
}

/// Returns the map from pixels to tag coordinates in tag sides, the tag's first corner at 0; without distortion.
#[cfg(feature = "boards")]
pub(super) fn tag_from_pixel(
    tag: &[Vector2<f64>; 4],
) -> Option<impl Fn(&Vector2<f64>) -> Vector2<f64>> {
    let unit = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    let point =
        |(p, (x, y)): (&Vector2<f64>, (f64, f64))| BoardPoint::new(Vector2::new(x, y), *p, 1.0);
    let view: BoardView = tag.iter().zip(unit).map(point).collect();
    let middle = tag.iter().sum::<Vector2<f64>>() / 4.0;
    let back = fit_homography(&view, &middle)?.try_inverse()?;
    Some(move |p: &Vector2<f64>| {
        let q = back * Vector3::new(p.x - middle.x, p.y - middle.y, 1.0);
        q.xy() / q.z
    })
}

/// Estimates the focal length, px, from h1' w h2 = 0 and h1' w h1 = h2' w h2 with w = diag(1/f^2, 1/f^2, 1) by least
/// squares over all views; `None` if every board is parallel to the sensor.
fn estimate_camera_constant(homographies: &[Matrix3<f64>]) -> Option<f64> {
    let (mut top, mut bottom) = (0.0, 0.0);
    for h in homographies {
        let h = h / h.norm();
        let (a, b) = (h.column(0), h.column(1));
        let conditions = [
            (a[0] * b[0] + a[1] * b[1], a[2] * b[2]),
            (
                a[0] * a[0] + a[1] * a[1] - b[0] * b[0] - b[1] * b[1],
                a[2] * a[2] - b[2] * b[2],
            ),
        ];
        for (image, depth) in conditions {
            top += image * image;
            bottom -= image * depth;
        }
    }
    let squared = top / bottom;
    (squared.is_finite() && squared > 0.0).then(|| squared.sqrt())
}

fn pose_from_homography(h: &Matrix3<f64>, f: f64) -> Option<BoardPose> {
    let k = Matrix3::new(1.0 / f, 0.0, 0.0, 0.0, 1.0 / f, 0.0, 0.0, 0.0, 1.0);
    let m = k * h;
    let scale = 2.0 / (m.column(0).norm() + m.column(1).norm());
    // In front of the camera.
    let m = m * if m[(2, 2)] < 0.0 { -scale } else { scale };
    let (a, b): (Vector3<f64>, Vector3<f64>) = (m.column(0).into(), m.column(1).into());
    let svd = Matrix3::from_columns(&[a, b, a.cross(&b)]).svd(true, true);
    let r = svd.u? * svd.v_t?;
    (r.determinant() > 0.0).then(|| BoardPose {
        camera_from_board: Rotation3::from_matrix_unchecked(r),
        translation_m: m.column(2).into(),
    })
}
