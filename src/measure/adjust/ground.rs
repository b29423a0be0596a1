//! The wing on the ground: bending axis, stations and rigid arms (docs/adjustment.md).

use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector3};

use super::{AdjustError, AdjustResult};
use crate::estimation::robust;
use crate::geometry::WingFrame;
use crate::setup::{Setup, SkinHeight, SurveyMarker, Width, WingSide};

/// Number of points in the axis table.
const AXIS_POINTS: usize = 257;
/// Length of the axis table beyond the outermost marker, m.
const OVERHANG_M: f64 = 2.0;
/// Distance of the wing tip over that of the outermost marker, if the installation gives no tip position.
const TIP_OVER_LAST_MARKER: f64 = 1.03;

/// Bending axis on the ground as slope over arc length, wing frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct BendingAxis {
    /// Bending root, wing frame, m.
    pub root_m: Vector3<f64>,
    /// Arc length from the root to the tip, at which bending moment and curvature end, m.
    pub length_m: f64,
    arc_m: Vec<f64>,
    x_m: Vec<f64>,
    y_m: Vec<f64>,
    slope_rad: Vec<f64>,
}

/// Section of one marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Arc length of the foot point, m; 0 for a fixed target, which has no section.
    pub arc_m: f64,
    /// Surveyed position, wing frame, m.
    pub surveyed_m: Vector3<f64>,
}

/// Shape of the wing as surveyed.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundShape {
    /// Wing frame of the adjustment.
    pub frame: WingFrame,
    pub axis: BendingAxis,
    /// Stations, one per marker of the survey.
    pub stations: Vec<Station>,
    /// Covariance of the coefficients (powers of s/L) of the axis height, m^2.
    pub axis_covariance: Matrix4<f64>,
    /// Standard deviation of the height of the skin above the bending axis, m.
    pub skin_height_sigma_m: f64,
    /// Sign of a nose-up twist: +1 if Z points aft (right wing), -1 if it points forward.
    pub nose: f64,
}

impl GroundShape {
    /// Fits the axis to the surveyed markers, lowered by the skin height and free of the chordwise crown. `trusted` holds
    /// one flag per marker: whether it may shape the surface. A marker that does not fit the surface of the others is
    /// excluded even if trusted.
    ///
    /// # Errors
    /// Returns an error if there are fewer than 2 markers on the wing or the geometry is not plausible.
    pub fn new(setup: &Setup, trusted: &[bool]) -> AdjustResult<Self> {
        let frame = setup.wing_frame();
        let surveyed: Vec<_> = setup.markers.iter().map(|m| frame.wing_point(&m.position_m)).collect();
        let (wing, points): (Vec<usize>, Vec<_>) = setup.wing_markers().into_iter().unzip();
        if points.len() < 2 || surveyed.iter().any(|p| !p.iter().all(|v| v.is_finite())) {
            return Err(AdjustError::TooFewMarkers { found: points.len(), needed: 6 });
        }
        let mean = points.iter().map(|p| p.z).sum::<f64>() / points.len() as f64;
        let axis_z = setup.axis_chord_offset_m.unwrap_or(mean);
        let (skin, skin_height_sigma_m) = skin_height(setup, &points);
        let all = height_weights(setup, trusted);
        let weights: Vec<f64> = wing.iter().map(|k| all[*k]).collect();
        let (axis, axis_covariance) = BendingAxis::fit_to_points(&points, &weights, axis_z, setup.root_offset_m, skin)?;
        let station = |(m, p): (&SurveyMarker, &Vector3<f64>)| Station {
            arc_m: if m.fixed { 0.0 } else { axis.foot_arc_length(p) },
            surveyed_m: *p,
        };
        let stations = setup.markers.iter().zip(&surveyed).map(station).collect();
        Ok(Self { frame, axis, stations, axis_covariance, skin_height_sigma_m, nose: nose_sign(setup) })
    }
}

/// Weights of the markers' heights for the fit of a smooth skin, 1/m^2; 0 for markers that are not trusted.
fn height_weights(setup: &Setup, trusted: &[bool]) -> Vec<f64> {
    let weight = |(k, m): (usize, &SurveyMarker)| {
        let trusted = trusted.get(k).copied().unwrap_or(true);
        if trusted { 1.0 / (m.sigma_m * m.sigma_m + WAVINESS_M * WAVINESS_M) } else { 0.0 }
    };
    setup.markers.iter().enumerate().map(weight).collect()
}

/// Default height of the skin above the axis at the root and at the tip, and the standard deviation of both, as fractions
/// of the length. Assumption: half the thickness of 13 and 11 % sections on chords of 0.23 and 0.07 lengths; the standard
/// deviation is about 50 % of the root value, which the elastic axis of a section does not exceed.
const TYPICAL_HALF_THICKNESS: (f64, f64, f64) = (0.015, 0.004, 0.007);

/// Height of the skin above the bending axis and its standard deviation, m: as configured, otherwise the default.
fn skin_height(setup: &Setup, points: &[Vector3<f64>]) -> (SkinHeight, f64) {
    let configured = setup.uncertainty[Width::SkinHeight];
    if let Some(skin) = setup.skin_height {
        return (skin, configured);
    }
    let reach = points.iter().fold(0.0, |a: f64, p| a.max(p.x - setup.root_offset_m));
    let (root, tip, sigma) = TYPICAL_HALF_THICKNESS;
    (SkinHeight { root_m: root * reach, tip_m: tip * reach, tip_span_m: reach }, configured.max(sigma * reach))
}

/// Sign of a nose-up twist. If the side is unknown no twist is reported, and either sign is correct.
fn nose_sign(setup: &Setup) -> f64 {
    if setup.side() == Some(WingSide::Left) { -1.0 } else { 1.0 }
}

impl BendingAxis {
    fn fit_to_points(
        points: &[Vector3<f64>],
        weights: &[f64],
        axis_z: f64,
        root_x: f64,
        skin: SkinHeight,
    ) -> AdjustResult<(Self, Matrix4<f64>)> {
        let last = points.iter().fold(f64::MIN, |a, p| a.max(p.x));
        let reach = last - root_x;
        if reach.is_nan() || reach <= 0.5 {
            return Err(AdjustError::Input(format!(
                "the outermost marker is {reach:.2} m outboard of the bending root, more than 0.5 m are needed; check span_direction and root_offset_m"
            )));
        }
        let surface = SurveySurface::fit_robust(points, weights, axis_z, root_x);
        let skin_slope = (skin.tip_m - skin.root_m) / skin.tip_span_m;
        let step = (reach + OVERHANG_M) / (AXIS_POINTS - 1) as f64;
        let mut axis =
            Self { root_m: Vector3::new(root_x, surface.height_at(0.0) - skin.root_m, axis_z), ..Self::default() };
        let mut arc = 0.0;
        for k in 0..AXIS_POINTS {
            let x = step * k as f64;
            let slope = (surface.slope_at(x) - skin_slope).atan();
            if let Some(before) = axis.slope_rad.last() {
                arc += step / (0.5 * (slope + before)).cos();
            }
            axis.arc_m.push(arc);
            axis.x_m.push(root_x + x);
            axis.y_m.push(surface.height_at(x) - skin.root_m - skin_slope * x);
            axis.slope_rad.push(slope);
        }
        let last_arc = interpolate_table(&axis.x_m, &axis.arc_m, last);
        let tip_span_m = skin.tip_span_m;
        let is_plausible = (1.0..1.25).contains(&(tip_span_m / last_arc));
        axis.length_m = if is_plausible { tip_span_m } else { TIP_OVER_LAST_MARKER * last_arc };
        let powers = SVector::<f64, 4>::from_fn(|j, _| axis.length_m.powi(j as i32));
        let covariance = surface.covariance.component_mul(&(powers * powers.transpose()));
        Ok((axis, covariance))
    }

    /// Slope of the axis at an arc length, rad.
    pub fn slope_rad(&self, arc_m: f64) -> f64 {
        interpolate_table(&self.arc_m, &self.slope_rad, arc_m)
    }

    /// Normal of the skin at an arc length, wing frame.
    pub fn skin_normal(&self, arc_m: f64) -> Vector3<f64> {
        wing_from_section(self.slope_rad(arc_m)).column(1).into_owned()
    }

    /// Arc length of a point's section, m; not inboard of the root.
    fn foot_arc_length(&self, p: &Vector3<f64>) -> f64 {
        let mut arc = interpolate_table(&self.x_m, &self.arc_m, p.x);
        for _ in 0..4 {
            let (sin, cos) = self.slope_rad(arc).sin_cos();
            let (x, y) =
                (interpolate_table(&self.arc_m, &self.x_m, arc), interpolate_table(&self.arc_m, &self.y_m, arc));
            arc += (p.x - x) * cos + (p.y - y) * sin;
        }
        arc.max(0.0)
    }
}

/// Rotation from section axes (tangent, normal, chord) to the wing frame at a slope.
pub fn wing_from_section(slope_rad: f64) -> Matrix3<f64> {
    let (sin, cos) = slope_rad.sin_cos();
    Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
}

/// Skin surface through the markers: heights over (x from the root, z from the axis), `a0 + a1 x + a2 x^2 + a3 x^3 + b z +
/// c z x + d z^2 / (1 - (1 - taper) x / reach)`. The last term is the crown, flatter for longer chords.
struct SurveySurface {
    along: [f64; 4],
    covariance: Matrix4<f64>,
    all: SVector<f64, 7>,
    all_covariance: SMatrix<f64, 7, 7>,
    reach: f64,
}

/// Row of the surface's design matrix for one point.
fn surface_row(p: &Vector3<f64>, axis_z: f64, root_x: f64, reach: f64) -> SVector<f64, 7> {
    let (x, z) = (p.x - root_x, p.z - axis_z);
    let chord = 1.0 - (1.0 - TYPICAL_TAPER) * (x / reach).clamp(0.0, 1.0);
    SVector::from([1.0, x, x * x, x * x * x, z, z * x, z * z / chord])
}

/// Mean and standard deviation of the surface coefficients for typical wings. They decide only what the markers leave
/// undetermined, such as crown against curvature if the markers are on two lines.
const TYPICAL_SURFACE: [(f64, f64); 7] =
    [(0.0, 100.0), (0.0, 1.0), (0.0, 2e-3), (0.0, 3e-5), (0.0, 0.1), (0.0, 5e-3), (-0.03, 0.02)];
/// Waviness of the skin on top of the survey's noise, m.
const WAVINESS_M: f64 = 0.001;
const TYPICAL_TAPER: f64 = 0.3;
/// A surveyed point that is off the skin surface of the other points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkinOutlier {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Height above the skin, m.
    pub height_m: f64,
    /// Standard deviation of that height including deviations of real wings from a smooth skin, m.
    pub sigma_m: f64,
}

/// Number of standard deviations beyond which a height is significant.
const OUTLIER_SIGMAS: f64 = 6.0;

/// Finds surveyed points off a smooth skin through the others, the worst first. At most 1/3 of the survey is returned;
/// beyond that the correct points cannot be identified.
pub fn find_skin_outliers(setup: &Setup) -> Vec<SkinOutlier> {
    let (wing, points): (Vec<usize>, Vec<_>) = setup.wing_markers().into_iter().unzip();
    let all = height_weights(setup, &[]);
    let weights: Vec<f64> = wing.iter().map(|k| all[*k]).collect();
    let axis_z = points.iter().map(|p| p.z).sum::<f64>() / points.len().max(1) as f64;
    let mut remaining: Vec<usize> = (0..points.len()).collect();
    let mut off = vec![];
    // A test needs one point per coefficient of the surface, and the same number in addition to identify an outlier.
    while remaining.len() >= 2 * TYPICAL_SURFACE.len() && 3 * off.len() < points.len() {
        let tests: Vec<(usize, f64, f64)> = remaining
            .iter()
            .map(|&k| {
                let others: Vec<usize> = remaining.iter().copied().filter(|o| *o != k).collect();
                let pick = |o: &usize| points[*o];
                let other_points: Vec<_> = others.iter().map(pick).collect();
                let other_weights: Vec<f64> = others.iter().map(|o| weights[*o]).collect();
                let surface = SurveySurface::fit(&other_points, &other_weights, axis_z, setup.root_offset_m);
                let (height, variance) = surface.height_above(&points[k], axis_z, setup.root_offset_m);
                (k, height, (variance + 1.0 / weights[k]).sqrt())
            })
            .collect();
        let factor = robust::robust_sigma(tests.iter().map(|(_, height, sigma)| (height / sigma).abs()).collect());
        let worst = tests.iter().max_by(|a, b| (a.1 / a.2).abs().total_cmp(&(b.1 / b.2).abs()));
        let Some(&(marker, height_m, sigma)) = worst else { break };
        let sigma_m = sigma * factor;
        if height_m.abs() <= OUTLIER_SIGMAS * sigma_m {
            break;
        }
        off.push(SkinOutlier { marker: wing[marker], height_m, sigma_m });
        remaining.retain(|k| *k != marker);
    }
    off
}

impl SurveySurface {
    /// Fits the surface to points. Crown and chordwise slope count from `axis_z`, so they do not affect the axis.
    fn fit(points: &[Vector3<f64>], weights: &[f64], axis_z: f64, root_x: f64) -> Self {
        let reach = points.iter().fold(0.0, |a: f64, p| a.max(p.x - root_x));
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut right = SVector::<f64, 7>::zeros();
        for (k, (mean, sigma)) in TYPICAL_SURFACE.into_iter().enumerate() {
            normal[(k, k)] = (1.0_f64 / sigma).powi(2);
            right[k] = normal[(k, k)] * mean;
        }
        for (p, &weight) in points.iter().zip(weights) {
            let row = surface_row(p, axis_z, root_x, reach);
            normal += row * row.transpose() * weight;
            right += row * (p.y * weight);
        }
        let scale = normal.diagonal().map(|d| 1.0 / d.sqrt());
        let scaled = SMatrix::<f64, 7, 7>::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
        let inverse = scaled.cholesky().map_or_else(SMatrix::zeros, |f| f.inverse());
        let inverse = inverse.component_mul(&(scale * scale.transpose()));
        let c = inverse * right;
        let covariance = inverse.fixed_view::<4, 4>(0, 0).into_owned();
        Self { along: [c[0], c[1], c[2], c[3]], covariance, all: c, all_covariance: inverse, reach }
    }

    /// Fits the surface robustly: points off the surface of the others lose their weight.
    fn fit_robust(points: &[Vector3<f64>], weights: &[f64], axis_z: f64, root_x: f64) -> Self {
        let off = |surface: &Self| {
            let one = |(p, w): (&Vector3<f64>, &f64)| {
                (p.y - surface_row(p, axis_z, root_x, surface.reach).dot(&surface.all)).abs() * w.sqrt()
            };
            points.iter().zip(weights).map(one).collect()
        };
        robust::fit_robustly(weights, |weights| Self::fit(points, weights, axis_z, root_x), off)
    }

    /// Height of a point above the surface, m, and the variance of the surface there, m^2.
    fn height_above(&self, p: &Vector3<f64>, axis_z: f64, root_x: f64) -> (f64, f64) {
        let row = surface_row(p, axis_z, root_x, self.reach);
        (p.y - row.dot(&self.all), (row.transpose() * self.all_covariance * row)[0])
    }

    fn height_at(&self, x: f64) -> f64 {
        let [a, b, c, d] = self.along;
        a + x * (b + x * (c + x * d))
    }

    fn slope_at(&self, x: f64) -> f64 {
        let [_, b, c, d] = self.along;
        b + x * (2.0 * c + x * 3.0 * d)
    }
}

/// Interpolates linearly in a table with increasing abscissae, and extrapolates beyond its ends.
fn interpolate_table(x: &[f64], y: &[f64], at: f64) -> f64 {
    let k = x.partition_point(|&v| v < at).clamp(1, x.len() - 1);
    let t = (at - x[k - 1]) / (x[k] - x[k - 1]);
    y[k - 1] + t * (y[k] - y[k - 1])
}
