//! Surface of the skin through the surveyed markers, with the breaks of the dihedral that they establish.

use nalgebra::{DMatrix, DVector, Matrix4, Vector3};

use crate::adjust::{AdjustError, AdjustResult};
use crate::estimation::robust;
use crate::setup::{MAX_BREAKS, Setup};

/// Coordinates of the skin's surface and its breaks.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceFrame {
    /// Z from which the chord counts, wing frame, m.
    pub axis_z: f64,
    /// X from which the span counts, wing frame, m.
    pub root_x: f64,
    /// Span from the root to the outermost marker, m.
    pub reach: f64,
    /// X at which the slope along the span breaks, wing frame, m.
    pub breaks_x_m: Vec<f64>,
}

/// Shortest span from the root to the outermost marker, m: that of a model.
const MIN_REACH_M: f64 = 0.5;

impl SurfaceFrame {
    /// Creates the coordinates for points in the wing frame, m, with the stated breaks. `axis_z`: origin of the chord, m.
    ///
    /// # Errors
    /// Returns an error if no point is sufficiently far outboard of the root.
    pub fn new(points: &[Vector3<f64>], axis_z: f64, setup: &Setup) -> AdjustResult<Self> {
        let root_x = setup.root_offset_m;
        let reach = points.iter().fold(f64::MIN, |last, p| last.max(p.x)) - root_x;
        if reach.is_nan() || reach <= MIN_REACH_M {
            return Err(AdjustError::Input(format!(
                "the outermost marker is {reach:.2} m outboard of the bending root, more than {MIN_REACH_M} m are needed; check span_direction and root_offset_m"
            )));
        }
        Ok(Self {
            axis_z,
            root_x,
            reach,
            breaks_x_m: setup.breaks.iter().map(|one| one.span_m).collect(),
        })
    }

    /// Row of the surface's design matrix for one point.
    fn row(&self, p: &Vector3<f64>) -> DVector<f64> {
        let (x, z) = (p.x - self.root_x, p.z - self.axis_z);
        let chord = 1.0 - (1.0 - TYPICAL_TAPER) * (x / self.reach).clamp(0.0, 1.0);
        let smooth = [1.0, x, x * x, x * x * x, z, z * x, z * z / chord];
        let broken = self.breaks_x_m.iter().map(|at| (p.x - at).max(0.0));
        DVector::from_iterator(
            smooth.len() + self.breaks_x_m.len(),
            smooth.into_iter().chain(broken),
        )
    }
}

/// Skin surface through the markers: heights over (x from the root, z from the axis), `a0 + a1 x + a2 x^2 + a3 x^3 + b z +
/// c z x + d z^2 / (1 - (1 - taper) x / reach)`, and for each break of the dihedral `k max(0, x - x_k)`. The crown is flatter
/// for longer chords.
pub struct SurveySurface {
    pub frame: SurfaceFrame,
    pub coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// Mean and standard deviation of the surface coefficients for typical wings, m over powers of m, and the power with which
/// both decrease with [`TYPICAL_REACH_M`] over the wing's: wings of all sizes have these shapes. They decide only what the
/// markers leave undetermined, such as crown against curvature if the markers are on two lines.
pub const TYPICAL_SURFACE: [(f64, f64, i32); 7] = [
    (0.0, 100.0, 0),
    (0.0, 1.0, 0),
    (0.0, 2e-3, 1),
    (0.0, 3e-5, 2),
    (0.0, 0.1, 0),
    (0.0, 5e-3, 1),
    (-0.03, 0.02, 1),
];
/// Span from root to outermost marker of the wings of [`TYPICAL_SURFACE`], m: an airliner's.
const TYPICAL_REACH_M: f64 = 31.0;
/// Standard deviation of the change of slope at a break: up to that of an upright winglet.
const BREAK_SIGMA: f64 = 3.0;
/// Chord at the outermost marker over that at the root, by which the crown flattens: an airliner's. An assumption.
const TYPICAL_TAPER: f64 = 0.3;
/// Decrease of the sum of squares by which a break is established, in units of the residuals' variance. Chance exceeds it
/// once in a million at one place; the places that are tried are some sixty.
const BREAK_SIGNIFICANCE: f64 = 30.0;
/// Largest contribution of one point to the sum of squares that decides on breaks: that of an outlier.
const OUTLIER_SQUARE: f64 = 36.0;
/// Least number of points between two breaks.
const POINTS_BETWEEN_BREAKS: isize = 3;
/// Least number of points inboard and outboard of all breaks: a winglet has two or three.
const POINTS_BESIDE_BREAKS: isize = 2;
/// Number of steps by which the place of a break is found between two points; each divides the interval by 1.6.
const GOLDEN_STEPS: usize = 14;
/// Change of slope from which on a part outboard of a break is a tip device, not the wing: 15 degrees.
const TIP_DEVICE_SLOPE: f64 = 0.27;
/// Fraction of the span outboard of which tip devices begin.
const TIP_DEVICE_SPAN: f64 = 0.75;

impl SurveySurface {
    /// Fits the surface to points. Crown and chordwise slope count from the axis, so they do not affect it.
    pub fn fit(points: &[Vector3<f64>], weights: &[f64], frame: &SurfaceFrame) -> Self {
        let size = TYPICAL_SURFACE.len() + frame.breaks_x_m.len();
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut right = DVector::<f64>::zeros(size);
        for k in 0..size {
            let (mean, sigma, power) =
                TYPICAL_SURFACE
                    .get(k)
                    .copied()
                    .unwrap_or((0.0, BREAK_SIGMA, 0));
            let larger = (TYPICAL_REACH_M / frame.reach).powi(power);
            normal[(k, k)] = (sigma * larger).powi(-2);
            right[k] = normal[(k, k)] * mean * larger;
        }
        for (p, &weight) in points.iter().zip(weights) {
            let row = frame.row(p);
            normal.ger(weight, &row, &row, 1.0);
            right.axpy(p.y * weight, &row, 1.0);
        }
        let scale = normal.diagonal().map(|d| 1.0 / d.sqrt());
        let scales = &scale * scale.transpose();
        let inverse = normal
            .component_mul(&scales)
            .cholesky()
            .map_or_else(|| DMatrix::zeros(size, size), |f| f.inverse());
        let covariance = inverse.component_mul(&scales);
        Self {
            frame: frame.clone(),
            coefficients: &covariance * right,
            covariance,
        }
    }

    /// Distances of points from the surface, in standard deviations.
    fn distances(&self, points: &[Vector3<f64>], weights: &[f64]) -> Vec<f64> {
        points
            .iter()
            .zip(weights)
            .map(|(p, w)| self.height_above(p).abs() * w.sqrt())
            .collect()
    }

    /// Fits the surface robustly: points off the surface of the others lose their weight.
    pub fn fit_robust(points: &[Vector3<f64>], weights: &[f64], frame: &SurfaceFrame) -> Self {
        let fit = |weights: &[f64]| Self::fit(points, weights, frame);
        robust::fit_robustly(weights, fit, |surface| surface.distances(points, weights))
    }

    /// Fits the surface robustly, with the breaks of the dihedral that the points establish.
    pub fn fit_broken(points: &[Vector3<f64>], weights: &[f64], frame: SurfaceFrame) -> Self {
        let squares = |surface: &Self| {
            let of_one = |distance: f64| (distance * distance).min(OUTLIER_SQUARE);
            surface
                .distances(points, weights)
                .into_iter()
                .map(of_one)
                .sum::<f64>()
        };
        let mut spans: Vec<f64> = points
            .iter()
            .zip(weights)
            .filter(|(_, w)| **w > 0.0)
            .map(|(p, _)| p.x)
            .collect();
        spans.sort_by(f64::total_cmp);
        let mut best = Self::fit_robust(points, weights, &frame);
        while best.frame.breaks_x_m.len() < MAX_BREAKS && squares(&best) > BREAK_SIGNIFICANCE {
            let with = |at: f64| {
                let breaks_x_m = best.frame.breaks_x_m.iter().copied().chain([at]).collect();
                Self::fit_robust(
                    points,
                    weights,
                    &SurfaceFrame {
                        breaks_x_m,
                        ..best.frame.clone()
                    },
                )
            };
            // Points on both sides determine a break.
            let inboard = |at: f64| spans.iter().filter(|x| **x < at).count() as isize;
            let ends = best.frame.breaks_x_m.iter().map(|at| inboard(*at));
            let missing = POINTS_BETWEEN_BREAKS - POINTS_BESIDE_BREAKS;
            let ends: Vec<isize> = ends
                .chain([-missing, spans.len() as isize + missing])
                .collect();
            let is_free = |gap: &usize| {
                ends.iter()
                    .all(|end| (end - *gap as isize).abs() >= POINTS_BETWEEN_BREAKS)
            };
            let gaps = (1..spans.len())
                .filter(is_free)
                .map(|gap| (spans[gap - 1], spans[gap]));
            let places = gaps.map(|gap| minimise_between(gap, |at| squares(&with(at))));
            let Some(found) = places
                .map(with)
                .min_by(|a, b| squares(a).total_cmp(&squares(b)))
            else {
                break;
            };
            let freedom = spans.len().saturating_sub(found.coefficients.len()).max(1) as f64;
            if squares(&best) - squares(&found)
                < BREAK_SIGNIFICANCE * (squares(&found) / freedom).max(1.0)
            {
                break;
            }
            best = found;
        }
        best
    }

    /// Breaks: X, wing frame, m, and the change of slope.
    fn breaks(&self) -> impl Iterator<Item = (f64, f64)> {
        self.frame.breaks_x_m.iter().copied().zip(
            self.coefficients
                .iter()
                .skip(TYPICAL_SURFACE.len())
                .copied(),
        )
    }

    fn is_tip_device(&self, (at, slope): (f64, f64)) -> bool {
        at - self.frame.root_x > TIP_DEVICE_SPAN * self.frame.reach
            && slope.abs() > TIP_DEVICE_SLOPE
    }

    /// Breaks of the wing itself: distance inboard of a span from the root, m, negative outboard of it, and the change of slope.
    pub fn wing_breaks(&self, x: f64) -> impl Iterator<Item = (f64, f64)> {
        let beyond = move |(at, slope)| (x + self.frame.root_x - at, slope);
        self.breaks()
            .filter(|one| !self.is_tip_device(*one))
            .map(beyond)
    }

    /// X at which a winglet or other tip device begins, wing frame, m, and its cant against the wing, rad.
    pub fn tip_device_m(&self) -> Option<(f64, f64)> {
        let device = self
            .breaks()
            .filter(|one| self.is_tip_device(*one))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        device.map(|(at, slope)| (at, slope.atan()))
    }

    /// Height of a point above the surface, m.
    pub fn height_above(&self, p: &Vector3<f64>) -> f64 {
        p.y - self.frame.row(p).dot(&self.coefficients)
    }

    /// Variance of the surface's height at a point, m^2.
    pub fn variance_at(&self, p: &Vector3<f64>) -> f64 {
        let row = self.frame.row(p);
        row.dot(&(&self.covariance * &row))
    }

    /// Covariance of the height along the span: coefficients of the powers of x over a length, m^2.
    pub fn height_covariance(&self, length_m: f64) -> Matrix4<f64> {
        Matrix4::from_fn(|i, j| self.covariance[(i, j)] * length_m.powi((i + j) as i32))
    }

    /// Height of the wing above its Z, without a tip device, m.
    pub fn height_at(&self, x: f64) -> f64 {
        let smooth = (0..4)
            .rev()
            .fold(0.0, |sum, k| sum * x + self.coefficients[k]);
        smooth
            + self
                .wing_breaks(x)
                .map(|(beyond, slope)| slope * beyond.max(0.0))
                .sum::<f64>()
    }

    /// Slope of the wing along the span, without a tip device.
    pub fn slope_at(&self, x: f64) -> f64 {
        let c = &self.coefficients;
        let broken = self
            .wing_breaks(x)
            .filter(|(beyond, _)| *beyond > 0.0)
            .map(|(_, slope)| slope);
        c[1] + x * (2.0 * c[2] + x * 3.0 * c[3]) + broken.sum::<f64>()
    }
}

/// Finds the minimum of a function between two places by golden sections.
fn minimise_between((mut from, mut to): (f64, f64), cost: impl Fn(f64) -> f64) -> f64 {
    /// Golden ratio less one, by which each step shortens the interval.
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let inner = |from: f64, to: f64| (to - GOLDEN * (to - from), from + GOLDEN * (to - from));
    let (mut low, mut high) = inner(from, to);
    let (mut at_low, mut at_high) = (cost(low), cost(high));
    for _ in 0..GOLDEN_STEPS {
        if at_low < at_high {
            (to, high, at_high) = (high, low, at_low);
            low = inner(from, to).0;
            at_low = cost(low);
        } else {
            (from, low, at_low) = (low, high, at_high);
            high = inner(from, to).1;
            at_high = cost(high);
        }
    }
    0.5 * (from + to)
}
