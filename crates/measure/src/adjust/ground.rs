//! The wing on the ground: bending axis, stations and rigid arms (docs/adjustment.md).

mod surface;

use nalgebra::{Matrix3, Matrix4, Vector3};

use self::surface::{SurfaceFrame, SurveySurface, TYPICAL_SURFACE};
use super::{AdjustError, AdjustResult};
use crate::estimation::robust;
use crate::geometry::WingFrame;
use crate::setup::{Setup, SkinHeight, SurveyMarker, Width};

/// Number of points in the axis table.
const AXIS_POINTS: usize = 257;
/// Length of the axis table beyond the outermost marker, as a fraction of the length to it.
const OVERHANG: f64 = 0.065;
/// Distance of the wing tip over that of the outermost marker, if the installation gives no tip position.
const TIP_OVER_LAST_MARKER: f64 = 1.03;

/// Bending axis on the ground as slope over arc length, wing frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct BendingAxis {
    /// Bending root, wing frame, m.
    pub root_m: Vector3<f64>,
    /// Arc length from the root to the tip, at which bending moment and curvature end, m.
    pub length_m: f64,
    /// Breaks of the dihedral and of the sweep.
    pub breaks: Vec<AxisBreak>,
    arc_m: Vec<f64>,
    x_m: Vec<f64>,
    y_m: Vec<f64>,
    slope_rad: Vec<f64>,
}

/// Break of the bending axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisBreak {
    /// Arc length from the root, m.
    pub arc_m: f64,
    /// Change of the slope outboard of it, rad.
    pub turn_rad: f64,
    /// Change of the direction in plan outboard of it, towards Z of the wing frame, rad.
    pub sweep_rad: f64,
}

/// Section of one marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Arc length of the foot point, m; 0 for a fixed target, which has no section.
    pub arc_m: f64,
    /// Surveyed position, wing frame, m.
    pub surveyed_m: Vector3<f64>,
    /// Normal of the skin, wing frame.
    pub skin_normal: Vector3<f64>,
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
    /// Breaks of the dihedral, of a tip device too: X, wing frame, m.
    pub breaks_x_m: Vec<f64>,
}

impl GroundShape {
    /// Fits the axis to the surveyed markers, lowered by the skin height and free of the chordwise crown. `trusted` holds
    /// one flag per marker: whether it may shape the surface. A marker that does not fit the surface of the others is
    /// excluded even if trusted.
    ///
    /// # Errors
    /// Returns an error if there are fewer than 2 markers on the wing or the geometry is not plausible.
    pub fn new(setup: &Setup, trusted: &[bool]) -> AdjustResult<Self> {
        Self::with_breaks(setup, trusted, None)
    }

    /// Fits the axis with breaks of the dihedral at these X of the wing frame, m; `None`: those that the points establish.
    ///
    /// # Errors
    /// As [`GroundShape::new`].
    pub fn with_breaks(
        setup: &Setup,
        trusted: &[bool],
        breaks_x_m: Option<&[f64]>,
    ) -> AdjustResult<Self> {
        let frame = setup.wing_frame();
        let surveyed: Vec<_> = setup
            .markers
            .iter()
            .map(|m| frame.wing_point(&m.position_m))
            .collect();
        let (wing, points) = straightened_markers(setup);
        if points.len() < 2 || surveyed.iter().any(|p| !p.iter().all(|v| v.is_finite())) {
            return Err(AdjustError::TooFewMarkers {
                found: points.len(),
                needed: 6,
            });
        }
        let mean = points.iter().map(|p| p.z).sum::<f64>() / points.len() as f64;
        let axis_z = setup.axis_chord_offset_m.unwrap_or(mean);
        let (skin, skin_height_sigma_m) = skin_height(setup, &points);
        let all = height_weights(setup, trusted);
        let weights: Vec<f64> = wing.iter().map(|k| all[*k]).collect();
        let smooth = SurfaceFrame::new(&points, axis_z, setup)?;
        let surface = match breaks_x_m {
            Some(x_m) => SurveySurface::fit_robust(
                &points,
                &weights,
                &SurfaceFrame {
                    breaks_x_m: x_m.to_vec(),
                    ..smooth
                },
            ),
            None => SurveySurface::fit_broken(&points, &weights, smooth),
        };
        let mut axis = BendingAxis::below_surface(&surface, &points, skin);
        axis.add_sweeps(setup);
        let tip_m = surface
            .tip_device_m()
            .map(|(x_m, cant)| (interpolate_table(&axis.x_m, &axis.arc_m, x_m), x_m, cant));
        let station = |(m, p): (&SurveyMarker, &Vector3<f64>)| {
            let (arc_m, more_rad) = match tip_m {
                _ if m.fixed => (0.0, 0.0),
                Some((arc_m, x_m, cant_rad)) if p.x > x_m => (arc_m, cant_rad),
                _ => (axis.foot_arc_length(p), 0.0),
            };
            let skin_normal = wing_from_section(axis.slope_rad(arc_m) + more_rad)
                .column(1)
                .into_owned();
            Station {
                arc_m,
                surveyed_m: *p,
                skin_normal,
            }
        };
        let stations = setup.markers.iter().zip(&surveyed).map(station).collect();
        let axis_covariance = surface.height_covariance(axis.length_m);
        let breaks_x_m = surface.frame.breaks_x_m;
        Ok(Self {
            frame,
            axis,
            stations,
            axis_covariance,
            skin_height_sigma_m,
            nose: setup.aft_sign(),
            breaks_x_m,
        })
    }
}

/// Markers on the wing: index in [`Setup::markers`] and position, wing frame, m, with Z from the swept axis instead of a straight
/// one.
fn straightened_markers(setup: &Setup) -> (Vec<usize>, Vec<Vector3<f64>>) {
    let straight = |(k, p): (usize, Vector3<f64>)| (k, p - Vector3::z() * setup.swept_m(p.x));
    setup.wing_markers().into_iter().map(straight).unzip()
}

/// Waviness of the skin on top of the survey's noise, m.
const WAVINESS_M: f64 = 0.001;

/// Weights of the markers' heights for the fit of a smooth skin, 1/m^2; 0 for markers that are not trusted.
fn height_weights(setup: &Setup, trusted: &[bool]) -> Vec<f64> {
    let weight = |(k, m): (usize, &SurveyMarker)| {
        let trusted = trusted.get(k).copied().unwrap_or(true);
        if trusted {
            1.0 / (m.sigma_m * m.sigma_m + WAVINESS_M * WAVINESS_M)
        } else {
            0.0
        }
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
    let reach = points
        .iter()
        .fold(0.0, |a: f64, p| a.max(p.x - setup.root_offset_m));
    let (root, tip, sigma) = TYPICAL_HALF_THICKNESS;
    (
        SkinHeight {
            root_m: root * reach,
            tip_m: tip * reach,
            tip_span_m: reach,
        },
        configured.max(sigma * reach),
    )
}

impl BendingAxis {
    /// Tabulates the axis below the skin's surface through these points.
    fn below_surface(surface: &SurveySurface, points: &[Vector3<f64>], skin: SkinHeight) -> Self {
        let SurfaceFrame {
            axis_z,
            root_x,
            reach,
            ..
        } = surface.frame;
        let skin_slope = (skin.tip_m - skin.root_m) / skin.tip_span_m;
        let step = reach * (1.0 + OVERHANG) / (AXIS_POINTS - 1) as f64;
        let mut axis = Self {
            root_m: Vector3::new(root_x, surface.height_at(0.0) - skin.root_m, axis_z),
            ..Self::default()
        };
        let mut arc = 0.0;
        for k in 0..AXIS_POINTS {
            let x = step * k as f64;
            let slope = (surface.slope_at(x) - skin_slope).atan();
            if let Some(before) = axis.slope_rad.last() {
                arc += step / (0.5 * (slope + before)).cos();
            }
            axis.arc_m.push(arc);
            axis.x_m.push(root_x + x);
            axis.y_m
                .push(surface.height_at(x) - skin.root_m - skin_slope * x);
            axis.slope_rad.push(slope);
        }
        let tip_x = surface.tip_device_m().map_or(f64::INFINITY, |(x_m, _)| x_m);
        let last_x = points
            .iter()
            .fold(f64::MIN, |last, p| last.max(p.x))
            .min(tip_x);
        let arc_at = |x_m: f64| interpolate_table(&axis.x_m, &axis.arc_m, x_m);
        let (last_arc, tip_span_m) = (arc_at(last_x), skin.tip_span_m);
        let is_plausible = (1.0..1.25).contains(&(tip_span_m / last_arc));
        // To the second order of the slope.
        let at_break = |(beyond, slope): (f64, f64)| AxisBreak {
            arc_m: arc_at(root_x - beyond),
            turn_rad: slope.atan(),
            sweep_rad: 0.0,
        };
        let breaks = surface.wing_breaks(0.0).map(at_break).collect();
        let length_m = if is_plausible {
            tip_span_m
        } else {
            TIP_OVER_LAST_MARKER * last_arc
        };
        Self {
            length_m,
            breaks,
            ..axis
        }
    }

    /// Adds the stated breaks of the sweep. One inboard of the root turns nothing that bends.
    fn add_sweeps(&mut self, setup: &Setup) {
        for (span_m, sweep_rad) in setup.sweeps().filter(|(span_m, _)| *span_m > self.root_m.x) {
            let arc_m = interpolate_table(&self.x_m, &self.arc_m, span_m);
            self.breaks.push(AxisBreak {
                arc_m,
                turn_rad: 0.0,
                sweep_rad,
            });
        }
    }

    /// Breaks inboard of an arc length: each with its distance from it, m.
    pub fn breaks_inboard_of(&self, arc_m: f64) -> impl Iterator<Item = (f64, &AxisBreak)> {
        self.breaks
            .iter()
            .filter(move |one| one.arc_m < arc_m)
            .map(move |one| (arc_m - one.arc_m, one))
    }

    /// Distance of the swept axis at an arc length from that inboard of all breaks, along Z of the wing frame, m.
    pub fn swept_m(&self, arc_m: f64) -> f64 {
        self.breaks_inboard_of(arc_m)
            .map(|(beyond_m, one)| one.sweep_rad.tan() * beyond_m)
            .sum()
    }

    /// Slope of the axis at an arc length, rad.
    pub fn slope_rad(&self, arc_m: f64) -> f64 {
        interpolate_table(&self.arc_m, &self.slope_rad, arc_m)
    }

    /// Arc length of a point's section, m; not inboard of the root.
    fn foot_arc_length(&self, p: &Vector3<f64>) -> f64 {
        let mut arc = interpolate_table(&self.x_m, &self.arc_m, p.x);
        for _ in 0..4 {
            let (sin, cos) = self.slope_rad(arc).sin_cos();
            let (x, y) = (
                interpolate_table(&self.arc_m, &self.x_m, arc),
                interpolate_table(&self.arc_m, &self.y_m, arc),
            );
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
    let (wing, points) = straightened_markers(setup);
    let all = height_weights(setup, &[]);
    let weights: Vec<f64> = wing.iter().map(|k| all[*k]).collect();
    let axis_z = points.iter().map(|p| p.z).sum::<f64>() / points.len().max(1) as f64;
    let Ok(frame) = SurfaceFrame::new(&points, axis_z, setup) else {
        return vec![];
    };
    let frame = SurveySurface::fit_broken(&points, &weights, frame).frame;
    let mut remaining: Vec<usize> = (0..points.len()).collect();
    let mut off = vec![];
    // A test needs one point per coefficient of the surface, and the same number in addition to identify an outlier.
    while remaining.len() >= 2 * TYPICAL_SURFACE.len() && 3 * off.len() < points.len() {
        let test = |&k: &usize| {
            let others: Vec<usize> = remaining.iter().copied().filter(|o| *o != k).collect();
            let other_points: Vec<_> = others.iter().map(|o| points[*o]).collect();
            let other_weights: Vec<f64> = others.iter().map(|o| weights[*o]).collect();
            let surface = SurveySurface::fit(&other_points, &other_weights, &frame);
            let variance = surface.variance_at(&points[k]) + 1.0 / weights[k];
            (k, surface.height_above(&points[k]), variance.sqrt())
        };
        let tests: Vec<(usize, f64, f64)> = remaining.iter().map(test).collect();
        let factor = robust::robust_sigma(
            tests
                .iter()
                .map(|(_, height, sigma)| (height / sigma).abs())
                .collect(),
        );
        let worst = tests
            .iter()
            .max_by(|a, b| (a.1 / a.2).abs().total_cmp(&(b.1 / b.2).abs()));
        let Some(&(marker, height_m, sigma)) = worst else {
            break;
        };
        let sigma_m = sigma * factor;
        if height_m.abs() <= OUTLIER_SIGMAS * sigma_m {
            break;
        }
        off.push(SkinOutlier {
            marker: wing[marker],
            height_m,
            sigma_m,
        });
        remaining.retain(|k| *k != marker);
    }
    off
}

/// Interpolates linearly in a table with increasing abscissae, and extrapolates beyond its ends.
fn interpolate_table(x: &[f64], y: &[f64], at: f64) -> f64 {
    let k = x.partition_point(|&v| v < at).clamp(1, x.len() - 1);
    let t = (at - x[k - 1]) / (x[k] - x[k - 1]);
    y[k - 1] + t * (y[k] - y[k - 1])
}
