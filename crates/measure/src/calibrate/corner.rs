//! Corners of four alternating squares, fitted to the grey values: position with covariance.
//!
//! Grey = `m + a erf(s1) erf(s2) + g (x - c)`: two equally blurred edges through `c`, over a background of linear
//! brightness. The edges may have a known curvature, as a wide lens curves them. The residuals give the unit weight, so
//! that noise, poor light, blur and compression all enter the covariance. The image is smoothed a little first: a sharp
//! edge that jumps from pixel to pixel has no slope to follow.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use statrs::function::erf::erf;

use crate::raster::Raster;

/// Number of unknowns: `c` (2), directions of the two edges, blur, mean, half the contrast, gradient (2).
const UNKNOWNS: usize = 9;
/// Maximum number of iterations.
const ITERATIONS: usize = 30;
/// Step of `c` at which the iteration stops, px.
const SETTLED_PX: f64 = 1e-4;
/// Start value of the blur, px: smoothing (root of 1/2) and width of a pixel (root of 1/12).
const START_BLUR_PX: f64 = 0.76;
/// Smoothing kernel along a row and down a column.
const KERNEL: [f64; 3] = [0.25, 0.5, 0.25];
/// Squared 1 / (sum of the squared weights of the 3 x 3 kernel): smoothing reduces the noise of single pixels by this
/// factor, but not the noise of averages over many pixels.
const SMOOTHING_FACTOR: f64 = (64.0 / 24.0) * (64.0 / 24.0);
/// Variance of rounding grey values to integers.
const ROUNDING: f64 = 1.0 / 12.0;
/// Distance from both edges, in blurs, beyond which pixels carry no information on the corner's position.
const BAND_BLURS: f64 = 4.0;
/// Minimum of that distance as a fraction of the window, for blurred images.
const BAND_FRACTION: f64 = 1.0 / 3.0;
/// Minimum window radius in blurs; with more blur the ends of the edges would count as edges.
const MIN_BLURS: f64 = 1.5;

type CornerParameters = SVector<f64, UNKNOWNS>;
type CornerNormalMatrix = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Start values and limits of a corner's fit, from its neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct CornerHint {
    /// Approximate position, px.
    pub centre: Vector2<f64>,
    /// Directions of the two edges.
    pub edges: [Vector2<f64>; 2],
    /// Curvatures of the two edges, positive to the left of their direction, 1/px.
    pub curvature_per_px: [f64; 2],
    /// Distance within which no other edge is visible, px.
    pub radius_px: f64,
}

/// Radius of the largest window, px. It determines a corner to a few thousandths of a pixel, which is better than boards
/// are printed; further out a wide lens curves edges by more than a constant curvature.
pub(super) const MAX_REFINEMENT_PX: f64 = 24.0;

/// A fitted corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct FittedCorner {
    pub pixel: Vector2<f64>,
    pub covariance_px2: Matrix2<f64>,
}

/// Fits a corner; `None` if the grey values do not show one.
pub(super) fn fit_corner(raster: &Raster, hint: &CornerHint) -> Option<FittedCorner> {
    let pixels = edge_pixels(raster, hint)?;
    let mut at = corner_start_values(hint);
    let (mut normal, mut right, mut sum) =
        (CornerNormalMatrix::zeros(), CornerParameters::zeros(), 0.0);
    // Mean, contrast and gradient are linear: one step is enough.
    assemble_normal_equations(&pixels, hint, &at, &mut normal, &mut right, &mut sum);
    solve_linear_start(&normal, &right, &mut at)?;
    assemble_normal_equations(&pixels, hint, &at, &mut normal, &mut right, &mut sum);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let mut damped = normal;
        (0..UNKNOWNS).for_each(|k| damped[(k, k)] *= 1.0 + damping);
        let step = damped.cholesky()?.solve(&right);
        let next = at + step;
        let (mut n, mut r, mut s) = (CornerNormalMatrix::zeros(), CornerParameters::zeros(), 0.0);
        assemble_normal_equations(&pixels, hint, &next, &mut n, &mut r, &mut s);
        if s > sum * (1.0 + 1e-12) || next[4] <= 0.0 {
            damping *= 10.0;
            if damping > 1e6 {
                return None;
            }
            continue;
        }
        (at, normal, right, sum) = (next, n, r, s);
        damping *= 0.1;
        if step.fixed_rows::<2>(0).norm() < SETTLED_PX {
            return check_fitted_corner(hint, &at, &normal, sum, pixels.len());
        }
    }
    None
}

fn check_fitted_corner(
    hint: &CornerHint,
    at: &CornerParameters,
    normal: &CornerNormalMatrix,
    sum: f64,
    pixels: usize,
) -> Option<FittedCorner> {
    let pixel = Vector2::new(at[0], at[1]);
    let plausible = (pixel - hint.centre).norm() < 0.5 * hint.radius_px
        && at[4] * MIN_BLURS < hint.radius_px
        && at[6].abs() > 1.0;
    let unit = (SMOOTHING_FACTOR * sum / (pixels - UNKNOWNS) as f64).max(ROUNDING);
    let inverse = normal.cholesky()?.inverse();
    plausible.then(|| FittedCorner {
        pixel,
        covariance_px2: inverse.fixed_view::<2, 2>(0, 0) * unit,
    })
}

/// Returns (column, row, grey) of the pixels near the edges; `None` if too few lie in the image.
fn edge_pixels(raster: &Raster, hint: &CornerHint) -> Option<Vec<(f64, f64, f64)>> {
    let (c, r) = (hint.centre, hint.radius_px);
    let band = (BAND_BLURS * START_BLUR_PX).max(BAND_FRACTION * r);
    let sides = hint.edges.map(|e| Vector2::new(-e.y, e.x) / e.norm());
    let reach = Vector2::repeat(r);
    let mut pixels = vec![];
    // The kernel needs one more pixel on each side.
    let inner = |at: usize, n: usize| at > 0 && at + 1 < n;
    for (x, y, _) in raster.pixels_in_box(c - reach, c + reach + Vector2::repeat(1.0), 1) {
        let d = Vector2::new(x as f64, y as f64) - c;
        let near = d.norm_squared() <= r * r && sides.iter().any(|n| n.dot(&d).abs() < band);
        if near && inner(x, raster.width()) && inner(y, raster.height()) {
            pixels.push((x as f64, y as f64, smoothed_grey(raster, x, y)));
        }
    }
    (pixels.len() > 2 * UNKNOWNS).then_some(pixels)
}

fn smoothed_grey(raster: &Raster, x: usize, y: usize) -> f64 {
    let row = |dy: isize| {
        let grey = |dx: isize| f64::from(raster.clamped_value(x as isize + dx, y as isize + dy));
        KERNEL[0] * grey(-1) + KERNEL[1] * grey(0) + KERNEL[2] * grey(1)
    };
    KERNEL[0] * row(-1) + KERNEL[1] * row(0) + KERNEL[2] * row(1)
}

fn corner_start_values(hint: &CornerHint) -> CornerParameters {
    let angle = |e: &Vector2<f64>| e.y.atan2(e.x);
    let (c, e) = (hint.centre, hint.edges);
    let blur = START_BLUR_PX;
    CornerParameters::from_column_slice(&[
        c.x,
        c.y,
        angle(&e[0]),
        angle(&e[1]),
        blur,
        0.0,
        1.0,
        0.0,
        0.0,
    ])
}

/// Solves for the linear unknowns with the others fixed.
fn solve_linear_start(
    normal: &CornerNormalMatrix,
    right: &CornerParameters,
    at: &mut CornerParameters,
) -> Option<()> {
    let step = normal
        .fixed_view::<4, 4>(5, 5)
        .clone_owned()
        .cholesky()?
        .solve(&right.fixed_rows::<4>(5));
    (0..4).for_each(|k| at[5 + k] += step[k]);
    Some(())
}

/// Returns `erf` of an edge at a pixel and its derivatives by the corner's position, the direction and the blur.
fn edge_profile(d: &Vector2<f64>, angle: f64, curvature: f64, blur: f64) -> (f64, [f64; 4]) {
    let (sin, cos) = angle.sin_cos();
    let along = cos * d.x + sin * d.y;
    let side = cos * d.y - sin * d.x - 0.5 * curvature * along * along;
    let q = side / blur;
    let erf = erf(q * std::f64::consts::FRAC_1_SQRT_2);
    let by_side = 2.0 * (-0.5 * q * q).exp() / (std::f64::consts::TAU.sqrt() * blur);
    (
        erf,
        [
            by_side * sin,
            -by_side * cos,
            -by_side * along,
            -by_side * q,
        ],
    )
}

fn assemble_normal_equations(
    pixels: &[(f64, f64, f64)],
    hint: &CornerHint,
    at: &CornerParameters,
    normal: &mut CornerNormalMatrix,
    right: &mut CornerParameters,
    sum: &mut f64,
) {
    (*normal, *right, *sum) = (CornerNormalMatrix::zeros(), CornerParameters::zeros(), 0.0);
    let (blur, mean, contrast) = (at[4], at[5], at[6]);
    for &(x, y, grey) in pixels {
        let d = Vector2::new(x - at[0], y - at[1]);
        let (e1, by1) = edge_profile(&d, at[2], hint.curvature_per_px[0], blur);
        let (e2, by2) = edge_profile(&d, at[3], hint.curvature_per_px[1], blur);
        let residual = grey - (mean + contrast * e1 * e2 + at[7] * d.x + at[8] * d.y);
        let row = [
            contrast * (by1[0] * e2 + e1 * by2[0]) - at[7],
            contrast * (by1[1] * e2 + e1 * by2[1]) - at[8],
            contrast * by1[2] * e2,
            contrast * e1 * by2[2],
            contrast * (by1[3] * e2 + e1 * by2[3]),
            1.0,
            e1 * e2,
            d.x,
            d.y,
        ];
        for i in 0..UNKNOWNS {
            for j in 0..=i {
                normal[(i, j)] += row[i] * row[j];
            }
            right[i] += row[i] * residual;
        }
        *sum += residual * residual;
    }
    for i in 0..UNKNOWNS {
        for j in 0..i {
            normal[(j, i)] = normal[(i, j)];
        }
    }
}
