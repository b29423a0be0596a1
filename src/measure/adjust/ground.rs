//! The wing on ground: bending axis, stations and rigid arms (docs/model.md).

use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector3};

use super::AdjustError;
use crate::estimation::robust;
use crate::geometry::WingFrame;
use crate::setup::{Setup, Side, SkinHeight, SurveyMarker};

/// Points of the axis' table.
const AXIS_POINTS: usize = 257;
/// The axis' table reaches this far beyond the outermost marker, m.
const OVERHANG_M: f64 = 2.0;
/// Wing tip over the outermost marker's station where the installation does not say.
const TIP_OVER_LAST_MARKER: f64 = 1.03;

/// The bending axis on ground as slope over arc length, wing frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Where bending starts, wing frame, m.
    pub root_m: Vector3<f64>,
    /// Arc length from the root to the tip, where bending moment and curvature end, m.
    pub length_m: f64,
    arc_m: Vec<f64>,
    x_m: Vec<f64>,
    y_m: Vec<f64>,
    slope_rad: Vec<f64>,
}

/// One marker's section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Arc length of the foot point, m; 0 for a fixed mark, which has none.
    pub arc_m: f64,
    /// As surveyed, wing frame, m.
    pub surveyed_m: Vector3<f64>,
}

/// The wing as surveyed.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundShape {
    /// The frame of the adjustment.
    pub frame: WingFrame,
    /// The bending axis.
    pub axis: Axis,
    /// One per marker of the survey.
    pub stations: Vec<Station>,
    /// Covariance of the axis' height, coefficients of the powers of s/L, m^2.
    pub axis_covariance: Matrix4<f64>,
    /// Standard deviation of the height of the skin above the bending axis, m.
    pub skin_height_sigma_m: f64,
    /// +1 where Z points aft (right wing), -1 where it points forward: sign of a nose-up twist.
    pub nose: f64,
}

impl GroundShape {
    /// Axis through the surveyed markers, lowered by the skin height, crown kept out. `trusted`: per marker,
    /// whether it may shape the surface; one that stands off the others' surface does not, whatever is said.
    pub fn new(setup: &Setup, trusted: &[bool]) -> Result<Self, AdjustError> {
        let frame = setup.wing_frame();
        let surveyed: Vec<_> = setup.markers.iter().map(|m| frame.wing_point(&m.position_m)).collect();
        let (wing, points): (Vec<usize>, Vec<_>) = setup.on_the_wing().into_iter().unzip();
        if points.len() < 2 || surveyed.iter().any(|p| !p.iter().all(|v| v.is_finite())) {
            return Err(AdjustError::TooFewMarkers { found: points.len(), needed: 6 });
        }
        let mean = points.iter().map(|p| p.z).sum::<f64>() / points.len() as f64;
        let axis_z = setup.axis_chord_offset_m.unwrap_or(mean);
        let (skin, skin_height_sigma_m) = skin(setup, &points);
        let all = weights(setup, trusted);
        let weights: Vec<f64> = wing.iter().map(|k| all[*k]).collect();
        let (axis, axis_covariance) = Axis::through(&points, &weights, axis_z, setup.root_offset_m, skin)?;
        let station = |(m, p): (&SurveyMarker, &Vector3<f64>)| Station {
            arc_m: if m.fixed { 0.0 } else { axis.foot(p) },
            surveyed_m: *p,
        };
        let stations = setup.markers.iter().zip(&surveyed).map(station).collect();
        Ok(Self { frame, axis, stations, axis_covariance, skin_height_sigma_m, nose: nose(setup) })
    }
}

/// Weights of the markers' heights over a smooth skin, 1/m^2; 0 for those that are not trusted.
fn weights(setup: &Setup, trusted: &[bool]) -> Vec<f64> {
    let weight = |(k, m): (usize, &SurveyMarker)| {
        let trusted = trusted.get(k).copied().unwrap_or(true);
        if trusted { 1.0 / (m.sigma_m * m.sigma_m + WAVINESS_M * WAVINESS_M) } else { 0.0 }
    };
    setup.markers.iter().enumerate().map(weight).collect()
}

/// Height of the skin above the axis at the root and at the tip where nobody states it, and the width of
/// that, over the length. An assumption: half the thickness of sections of 13 and 11 % on chords of 0.23 and
/// 0.07 lengths, and a width that is half of the former, which a section's elastic axis does not exceed.
const USUAL_HALF_THICKNESS: (f64, f64, f64) = (0.015, 0.004, 0.007);

/// Height of the skin above the bending axis with its standard deviation, m: as stated, else what wings have.
fn skin(setup: &Setup, points: &[Vector3<f64>]) -> (SkinHeight, f64) {
    let stated = setup.uncertainty.skin_height_sigma_m;
    if let Some(skin) = setup.skin_height {
        return (skin, stated);
    }
    let reach = points.iter().fold(0.0, |a: f64, p| a.max(p.x - setup.root_offset_m));
    let (root, tip, sigma) = USUAL_HALF_THICKNESS;
    (SkinHeight { root_m: root * reach, tip_m: tip * reach, tip_span_m: reach }, stated.max(sigma * reach))
}

/// Where nothing tells the side, no twist is given, and either sign will do.
fn nose(setup: &Setup) -> f64 {
    if setup.side() == Some(Side::Left) { -1.0 } else { 1.0 }
}

impl Axis {
    fn through(
        points: &[Vector3<f64>],
        weights: &[f64],
        axis_z: f64,
        root_x: f64,
        skin: SkinHeight,
    ) -> Result<(Self, Matrix4<f64>), AdjustError> {
        let last = points.iter().fold(f64::MIN, |a, p| a.max(p.x));
        let reach = last - root_x;
        if reach.is_nan() || reach <= 0.5 {
            return Err(AdjustError::Input(format!(
                "the outermost marker lies {reach:.2} m outboard of the bending root; check span_direction and root_offset_m"
            )));
        }
        let surface = Surface::robust(points, weights, axis_z, root_x);
        let skin_slope = (skin.tip_m - skin.root_m) / skin.tip_span_m;
        let step = (reach + OVERHANG_M) / (AXIS_POINTS - 1) as f64;
        let mut axis = Self {
            root_m: Vector3::new(root_x, surface.height(0.0) - skin.root_m, axis_z),
            length_m: 0.0,
            arc_m: vec![],
            x_m: vec![],
            y_m: vec![],
            slope_rad: vec![],
        };
        let mut arc = 0.0;
        for k in 0..AXIS_POINTS {
            let x = step * k as f64;
            let slope = (surface.slope(x) - skin_slope).atan();
            if let Some(before) = axis.slope_rad.last() {
                arc += step / (0.5 * (slope + before)).cos();
            }
            axis.arc_m.push(arc);
            axis.x_m.push(root_x + x);
            axis.y_m.push(surface.height(x) - skin.root_m - skin_slope * x);
            axis.slope_rad.push(slope);
        }
        let last_arc = interpolate(&axis.x_m, &axis.arc_m, last);
        let told = skin.tip_span_m;
        let believable = (1.0..1.25).contains(&(told / last_arc));
        axis.length_m = if believable { told } else { TIP_OVER_LAST_MARKER * last_arc };
        let powers = SVector::<f64, 4>::from_fn(|j, _| axis.length_m.powi(j as i32));
        let covariance = surface.covariance.component_mul(&(powers * powers.transpose()));
        Ok((axis, covariance))
    }

    /// Slope at an arc length, rad.
    pub fn slope_rad(&self, arc_m: f64) -> f64 {
        interpolate(&self.arc_m, &self.slope_rad, arc_m)
    }

    /// The skin's normal at an arc length, wing frame.
    pub fn normal(&self, arc_m: f64) -> Vector3<f64> {
        wing_from_section(self.slope_rad(arc_m)).column(1).into_owned()
    }

    /// Arc length of the section that a point belongs to, m; not inboard of the root.
    fn foot(&self, p: &Vector3<f64>) -> f64 {
        let mut arc = interpolate(&self.x_m, &self.arc_m, p.x);
        for _ in 0..4 {
            let (sin, cos) = self.slope_rad(arc).sin_cos();
            let (x, y) = (interpolate(&self.arc_m, &self.x_m, arc), interpolate(&self.arc_m, &self.y_m, arc));
            arc += (p.x - x) * cos + (p.y - y) * sin;
        }
        arc.max(0.0)
    }
}

/// Rotation from section axes (tangent, normal, chord) at a slope to the wing frame.
pub fn wing_from_section(slope_rad: f64) -> Matrix3<f64> {
    let (sin, cos) = slope_rad.sin_cos();
    Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
}

/// The skin through the markers, heights over (x from the root, z from the axis):
/// `a0 + a1 x + a2 x^2 + a3 x^3 + b z + c z x + d z^2 / (1 - (1 - taper) x / reach)`; the last is the
/// crown, flatter where the chord is longer.
struct Surface {
    along: [f64; 4],
    covariance: Matrix4<f64>,
    all: SVector<f64, 7>,
    all_covariance: SMatrix<f64, 7, 7>,
    reach: f64,
}

/// A point's functions of the surface's coefficients.
fn row(p: &Vector3<f64>, axis_z: f64, root_x: f64, reach: f64) -> SVector<f64, 7> {
    let (x, z) = (p.x - root_x, p.z - axis_z);
    let chord = 1.0 - (1.0 - TAPER) * (x / reach).clamp(0.0, 1.0);
    SVector::from([1.0, x, x * x, x * x * x, z, z * x, z * z / chord])
}

/// What wings look like, as mean and standard deviation of the surface's coefficients: it decides
/// only what the markers leave open, such as crown against curvature where they sit on two lines.
const USUAL_SURFACE: [(f64, f64); 7] =
    [(0.0, 100.0), (0.0, 1.0), (0.0, 2e-3), (0.0, 3e-5), (0.0, 0.1), (0.0, 5e-3), (-0.03, 0.02)];
/// Waviness of the skin on top of the survey's noise, m.
const WAVINESS_M: f64 = 0.001;
const TAPER: f64 = 0.3;
/// A surveyed point off the skin that the others tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OffTheSkin {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Above the skin, m.
    pub height_m: f64,
    /// Standard deviation of that height with what wings differ from such a skin by, m.
    pub sigma_m: f64,
}

/// Standard deviations from which on a height is no chance.
const DOUBTFUL: f64 = 6.0;

/// The points off a smooth skin through the others, the worst first; a third of the survey at most, for of more nothing
/// tells which are right.
pub fn off_the_skin(setup: &Setup) -> Vec<OffTheSkin> {
    let (wing, points): (Vec<usize>, Vec<_>) = setup.on_the_wing().into_iter().unzip();
    let all = weights(setup, &[]);
    let weights: Vec<f64> = wing.iter().map(|k| all[*k]).collect();
    let axis_z = points.iter().map(|p| p.z).sum::<f64>() / points.len().max(1) as f64;
    let mut kept: Vec<usize> = (0..points.len()).collect();
    let mut off = vec![];
    // As many as the surface has coefficients are needed to tell anything, and as many again to tell one that is off.
    while kept.len() >= 2 * USUAL_SURFACE.len() && 3 * off.len() < points.len() {
        let tests: Vec<(usize, f64, f64)> = kept
            .iter()
            .map(|&k| {
                let others: Vec<usize> = kept.iter().copied().filter(|o| *o != k).collect();
                let pick = |o: &usize| points[*o];
                let some: Vec<_> = others.iter().map(pick).collect();
                let of: Vec<f64> = others.iter().map(|o| weights[*o]).collect();
                let surface = Surface::fit(&some, &of, axis_z, setup.root_offset_m);
                let (height, variance) = surface.above(&points[k], axis_z, setup.root_offset_m);
                (k, height, (variance + 1.0 / weights[k]).sqrt())
            })
            .collect();
        let factor = robust::robust_sigma(tests.iter().map(|(_, height, sigma)| (height / sigma).abs()).collect());
        let worst = tests.iter().max_by(|a, b| (a.1 / a.2).abs().total_cmp(&(b.1 / b.2).abs()));
        let Some(&(marker, height_m, sigma)) = worst else { break };
        let sigma_m = sigma * factor;
        if height_m.abs() <= DOUBTFUL * sigma_m {
            break;
        }
        off.push(OffTheSkin { marker: wing[marker], height_m, sigma_m });
        kept.retain(|k| *k != marker);
    }
    off
}

impl Surface {
    /// `axis_z`: crown and chordwise slope count from there, so they do not enter the axis.
    fn fit(points: &[Vector3<f64>], weights: &[f64], axis_z: f64, root_x: f64) -> Self {
        let reach = points.iter().fold(0.0, |a: f64, p| a.max(p.x - root_x));
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut right = SVector::<f64, 7>::zeros();
        for (k, (mean, sigma)) in USUAL_SURFACE.into_iter().enumerate() {
            normal[(k, k)] = (1.0_f64 / sigma).powi(2);
            right[k] = normal[(k, k)] * mean;
        }
        for (p, &weight) in points.iter().zip(weights) {
            let row = row(p, axis_z, root_x, reach);
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

    /// Without points that stand off the surface of the others.
    fn robust(points: &[Vector3<f64>], weights: &[f64], axis_z: f64, root_x: f64) -> Self {
        let off = |surface: &Self| {
            let one = |(p, w): (&Vector3<f64>, &f64)| {
                (p.y - row(p, axis_z, root_x, surface.reach).dot(&surface.all)).abs() * w.sqrt()
            };
            points.iter().zip(weights).map(one).collect()
        };
        robust::fit_robustly(weights, |weights| Self::fit(points, weights, axis_z, root_x), off)
    }

    /// A point's height above the surface, m, and the surface's variance there, m^2.
    fn above(&self, p: &Vector3<f64>, axis_z: f64, root_x: f64) -> (f64, f64) {
        let row = row(p, axis_z, root_x, self.reach);
        (p.y - row.dot(&self.all), (row.transpose() * self.all_covariance * row)[0])
    }

    fn height(&self, x: f64) -> f64 {
        let [a, b, c, d] = self.along;
        a + x * (b + x * (c + x * d))
    }

    fn slope(&self, x: f64) -> f64 {
        let [_, b, c, d] = self.along;
        b + x * (2.0 * c + x * 3.0 * d)
    }
}

/// Linear in a table with rising abscissae; carried on beyond its ends.
fn interpolate(x: &[f64], y: &[f64], at: f64) -> f64 {
    let k = x.partition_point(|&v| v < at).clamp(1, x.len() - 1);
    let t = (at - x[k - 1]) / (x[k] - x[k - 1]);
    y[k - 1] + t * (y[k] - y[k - 1])
}
