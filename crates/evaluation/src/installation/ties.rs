//! `[cad]` and `tie_points.csv`: points known in the survey frame and in the CAD frame, and the checks of their transform.

use std::path::Path;

use nalgebra::Vector3;

use super::plausible::principal_axes;
use super::{INSTALLATION_FILE, Reader, tables};
use crate::installation::read_table;
use wingd_measure::geometry::{FitError, PointPair, TransformFit};
use wingd_measure::ordering::sort_by_value;
use wingd_measure::setup::{Setup, WingSide};

const COLUMNS: [&str; 7] = ["id", "x_m", "y_m", "z_m", "cad_x_m", "cad_y_m", "cad_z_m"];
/// Units of length with their metres.
const LENGTH_UNITS: [(&str, f64); 5] = [
    ("m", 1.0),
    ("cm", 0.01),
    ("mm", 1e-3),
    ("in", 0.0254),
    ("ft", 0.3048),
];
/// Default standard deviation of a tie point's coordinate, m.
const DEFAULT_SIGMA_M: f64 = 0.005;
/// Largest relative difference of the scales of CAD model and survey: 20 times the expansion of aluminium by 10 K; a larger
/// one is another unit or a gross error.
const MAX_SCALE_CHANGE: f64 = 0.005;
/// Largest logarithm of a scale over that of a unit at which the unit is named.
const MAX_UNIT_CHANGE: f64 = 0.03;
/// Largest angle between the CAD model's upward axis and the survey's vertical, degrees: an aircraft on jacks or on its
/// wheels is within it.
const MAX_TILT_DEG: f64 = 10.0;
/// Largest angle between the CAD model's aft axis and the normal of the span, degrees: wings are swept by less.
const MAX_SWEEP_DEG: f64 = 60.0;
/// Extent of the tie points, in their standard deviations, below which a mirrored axis fits as well.
const FLAT_SIGMAS: f64 = 10.0;
/// Number of standard deviations beyond which scale and angle are off.
const SIGMAS: f64 = 3.0;
/// Largest number of points, those that fit worst, that are tried as wrong: each needs a fit.
const MAX_SUSPECTS: usize = 12;
/// Significance level of the test of the transform.
pub const CAD_ALPHA: f64 = 0.01;

/// Points of a CAD model with the directions of its axes.
#[derive(Clone, Debug, PartialEq)]
pub struct CadModel {
    /// Names of the tie points, in the order of the file.
    pub ids: Vec<String>,
    /// Survey and CAD coordinates of each tie point, m.
    pub points: Vec<PointPair>,
    /// Unit of the CAD model, m.
    unit_m: f64,
    /// Whether the transform has a scale.
    pub similarity: bool,
    /// Direction upwards in the CAD frame, unit length.
    pub up: Option<Vector3<f64>>,
    /// Direction aft in the CAD frame, unit length: that of the flow at no sideslip and angle of attack.
    pub aft: Option<Vector3<f64>>,
}

pub(super) fn read_cad(reader: &mut Reader, cad: &tables::CadTable) -> Option<CadModel> {
    let remedy = "name the file in cad.tie_points of installation.toml";
    let (file, lines) = read_table(reader, &cad.tie_points, remedy, COLUMNS, &[])?;
    let sigma_m = cad.sigma_m.unwrap_or(DEFAULT_SIGMA_M);
    let installation = reader.directory.join(INSTALLATION_FILE);
    reader.check_range(&installation, "cad.sigma_m", sigma_m, 1e-6..=10.0, "m");
    let before = reader.faults.len();
    let unit = cad.unit.as_deref().unwrap_or("m");
    let named = LENGTH_UNITS.iter().find(|(name, _)| *name == unit);
    let unit_m = named.map_or(f64::NAN, |(_, metres)| *metres);
    if unit_m.is_nan() {
        let remedy = format!(
            "give one of {}",
            LENGTH_UNITS.map(|(name, _)| name).join(", ")
        );
        reader.fault(&installation, "cad.unit", format!("is \"{unit}\""), remedy);
    }
    let [up, aft] = [("cad.up", &cad.up), ("cad.aft", &cad.aft)]
        .map(|(key, value)| read_direction(reader, &installation, key, value.as_ref()?));
    if up
        .zip(aft)
        .is_some_and(|(up, aft)| up.dot(&aft).abs() > MAX_TILT_DEG.to_radians().sin())
    {
        reader.fault(
            &installation,
            "cad.aft",
            "is not at a right angle to cad.up",
            "give two axes of the CAD frame",
        );
    }
    let mut model = CadModel {
        ids: vec![],
        points: vec![],
        unit_m,
        similarity: cad.similarity,
        up,
        aft,
    };
    for line in lines {
        let id = &line.cells[0];
        if model.ids.contains(id) {
            line.cell_fault(
                reader,
                0,
                format!("\"{id}\" occurs twice"),
                "give every tie point a unique name",
            );
        }
        if let Some([x, y, z, cx, cy, cz]) = line.parse_numbers(reader, 1) {
            let (source_m, cad) = (Vector3::new(x, y, z), Vector3::new(cx, cy, cz));
            model.ids.push(id.clone());
            model.points.push(PointPair {
                source_m,
                target_m: cad * unit_m,
                sigma_m,
            });
        }
    }
    if model.points.len() < 3 && reader.faults.len() == before {
        let problem = format!("has {} tie points", model.points.len());
        reader.fault(
            &file,
            "file",
            problem,
            "a transform needs at least 3, not on one line",
        );
    }
    (reader.faults.len() == before).then_some(model)
}

/// Reads the name of an axis or a vector in the CAD frame.
fn read_direction(
    reader: &mut Reader,
    file: &Path,
    key: &str,
    value: &toml::Value,
) -> Option<Vector3<f64>> {
    let number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|k| k as f64));
    let vector = |all: &Vec<toml::Value>| {
        let numbers: Vec<f64> = all.iter().map(number).collect::<Option<_>>()?;
        <[f64; 3]>::try_from(numbers).ok()
    };
    let axis = |text: &str| {
        let name = text.trim_start_matches(['-', '+']);
        let axis = AXES.iter().position(|axis| *axis == name)?;
        Some(Vector3::ith(
            axis,
            if text.starts_with('-') { -1.0 } else { 1.0 },
        ))
    };
    let found = value.as_str().map_or_else(
        || value.as_array().and_then(vector).map(Vector3::from),
        axis,
    );
    let found = found.and_then(|v: Vector3<f64>| v.try_normalize(1e-9));
    if found.is_none() {
        let remedy =
            "name an axis of the CAD frame (x, y, z, -x, -y or -z), or give a vector: [x, y, z]";
        reader.fault(file, key, format!("is {value}"), remedy);
    }
    found
}

const AXES: [&str; 3] = ["x", "y", "z"];

/// Returns the axis nearest to a direction, with its sign, and its vector.
fn nearest_axis(direction: &Vector3<f64>) -> (String, Vector3<f64>) {
    let axis = direction.iamax();
    let sign = direction[axis].signum();
    (
        format!("{}{}", if sign < 0.0 { "-" } else { "" }, AXES[axis]),
        Vector3::ith(axis, sign),
    )
}

/// Problem of `[cad]`: key, problem and remedy.
type CadFault = (&'static str, String, String);

/// Estimates the transform from the tie points; reports an error if they determine none or contradict the survey.
pub(super) fn estimate_transform(
    reader: &mut Reader,
    model: &CadModel,
    setup: &Setup,
) -> Option<TransformFit> {
    let file = reader.directory.join(INSTALLATION_FILE);
    let fault = |(key, problem, remedy)| reader.fault(&file, key, problem, remedy);
    model.fit_checked(setup).map_err(fault).ok()
}

fn passes(fit: &TransformFit) -> bool {
    fit.passes_test(CAD_ALPHA) != Some(false)
}

impl CadModel {
    fn fit_checked(&self, setup: &Setup) -> Result<TransformFit, CadFault> {
        let estimate = |similarity| TransformFit::estimate(&self.points, similarity);
        let (scaled, fit) = match (estimate(true), estimate(self.similarity)) {
            (Ok(scaled), Ok(fit)) => (scaled, fit),
            (Err(error), _) | (_, Err(error)) => return Err(self.explain_rejection(Err(error))),
        };
        self.check_scale(&scaled, &fit)?;
        if !passes(&fit) {
            return Err(self.explain_rejection(Ok(&fit)));
        }
        self.check_axes(&fit, setup)?;
        Ok(fit)
    }

    /// Checks the scale; one that a contradiction among the points may cause is left to the test of the transform.
    fn check_scale(&self, scaled: &TransformFit, fit: &TransformFit) -> Result<(), CadFault> {
        let scale = scaled.transform.scale;
        let change = (scale - 1.0).abs();
        let unit_of = |factor: f64, stated_m: f64| {
            let is_unit = |(_, m): &&(&str, f64)| (factor * m).ln().abs() < MAX_UNIT_CHANGE;
            let unit = LENGTH_UNITS.iter().find(is_unit);
            unit.filter(|(_, m)| *m != stated_m).map(|(name, _)| *name)
        };
        let problem = format!("the CAD coordinates are {scale:.4} times as large as the survey's");
        let is_certain = change > SIGMAS * scaled.covariance[(6, 6)].sqrt() && passes(scaled);
        let remedy = if let Some(unit) = unit_of(scale / self.unit_m, self.unit_m) {
            format!("give cad.unit = \"{unit}\"")
        } else if let Some(unit) = unit_of(scale.recip(), 1.0) {
            format!("the survey's coordinates in tie_points.csv are in {unit}: give metres")
        } else if is_certain && change > MAX_SCALE_CHANGE {
            "give cad.unit, or correct the points".into()
        } else if is_certain && !passes(fit) {
            "set cad.similarity = true if the model has another temperature, or correct the points"
                .into()
        } else {
            return Ok(());
        };
        Err((TIES, problem, remedy))
    }

    /// Checks the directions of the axes, which also decide between points in one plane and their mirror image.
    fn check_axes(&self, fit: &TransformFit, setup: &Setup) -> Result<(), CadFault> {
        let rotation = fit.transform.rotation;
        let up = rotation * Vector3::z();
        let (name, nearest) = nearest_axis(&up);
        let tilt_deg = up.angle(&self.up.unwrap_or(nearest)).to_degrees();
        let sigma_deg = fit
            .covariance
            .view((0, 0), (3, 3))
            .trace()
            .sqrt()
            .to_degrees();
        if tilt_deg - SIGMAS * sigma_deg > MAX_TILT_DEG {
            let stated = if self.up.is_some() {
                "is"
            } else {
                "nearest axis is"
            };
            let problem = format!(
                "{stated} {tilt_deg:.0} degrees off the survey's vertical, which is about {name} by the tie points"
            );
            let remedy =
                "correct the sign or order of the coordinates of tie points, or the direction";
            return Err(("cad.up", problem, remedy.into()));
        }
        let side = setup
            .side()
            .map(|side| if side == WingSide::Right { 1.0 } else { -1.0 });
        let aft_survey =
            side.map(|side| setup.wing_frame().wing_from_survey.inverse() * Vector3::z() * side);
        let aft = self.aft.zip(aft_survey);
        if let Some((stated, survey)) = aft
            && stated.angle(&(rotation * survey)).to_degrees() > MAX_SWEEP_DEG
        {
            let problem = format!(
                "is {:.0} degrees off the normal of wing.span_direction, which is about {} by the tie points",
                stated.angle(&(rotation * survey)).to_degrees(),
                nearest_axis(&(rotation * survey)).0
            );
            let remedy = "correct the direction, wing.side, or the sign or order of the coordinates of tie points";
            return Err(("cad.aft", problem, remedy.into()));
        }
        let axes = principal_axes(self.points.iter().map(|p| p.source_m));
        let normal = axes
            .eigenvectors
            .column(axes.eigenvalues.imin())
            .into_owned();
        let heights = self.points.iter().map(|p| p.source_m.dot(&normal));
        let extent_m = heights.clone().fold(f64::MIN, f64::max) - heights.fold(f64::MAX, f64::min);
        let sigma_m = self.points.iter().map(|p| p.sigma_m).fold(0.0, f64::max);
        // A mirror image turns a direction by twice its angle to the plane.
        let decides =
            |off: f64, limit_deg: f64| 2.0 * off.abs().min(1.0).asin().to_degrees() > limit_deg;
        let is_decided = self.up.is_some() && decides(normal.z, 2.0 * MAX_TILT_DEG)
            || aft.is_some_and(|(_, survey)| decides(normal.dot(&survey), 90.0));
        if extent_m > FLAT_SIGMAS * sigma_m || is_decided {
            return Ok(());
        }
        let problem =
            format!("are within {extent_m:.3} m of one plane, so that a mirrored axis fits too");
        let remedy = match decides(normal.z, 2.0 * MAX_TILT_DEG) {
            true => {
                format!(
                    "upwards is {name} of the CAD frame by them: if so, give it as cad.up, else correct a sign"
                )
            }
            false => "add a point off the plane".into(),
        };
        Err((TIES, problem, remedy))
    }

    /// Returns whether the points pass the test with a change.
    fn passes_with(&self, change: impl Fn(&mut [PointPair])) -> bool {
        let mut points = self.points.clone();
        change(&mut points);
        TransformFit::estimate(&points, self.similarity).is_ok_and(|fit| passes(&fit))
    }

    /// Names the points or the axis whose correction makes the others agree.
    fn explain_rejection(&self, fit: Result<&TransformFit, FitError>) -> CadFault {
        let contradict = |cause: String| {
            let factor = fit.ok().and_then(|fit| fit.variance_factor);
            let factor = factor.map_or(String::new(), |factor| {
                format!(" (variance factor {factor:.1})")
            });
            format!("contradict each other{factor}: {cause}")
        };
        let mirrored = || {
            (
                TIES,
                FitError::Mirrored.to_string(),
                "correct the sign of an axis".into(),
            )
        };
        if self.passes_with(|points| points.iter_mut().for_each(|p| p.target_m.x *= -1.0)) {
            return mirrored();
        }
        let mut suspects: Vec<usize> = (0..self.points.len()).collect();
        if let Ok(fit) = fit {
            sort_by_value(&mut suspects, |k| -fit.residuals_m[*k].norm());
        }
        suspects.truncate(MAX_SUSPECTS);
        let remedy = "correct them in tie_points.csv, in both frames, or give their standard deviation as cad.sigma_m";
        if let Some(cause) = self.describe_outliers(&suspects) {
            return (TIES, contradict(cause), remedy.into());
        }
        match (fit, suspects.first()) {
            (Ok(fit), Some(worst)) => {
                let (id, off_m) = (&self.ids[*worst], fit.residuals_m[*worst].norm());
                let cause = format!("the largest residual is {off_m:.3} m, of {id}");
                (TIES, contradict(cause), remedy.into())
            }
            (Err(error), _) if error != FitError::Mirrored => (
                TIES,
                error.to_string(),
                "correct the tie points, or delete [cad]".into(),
            ),
            _ => mirrored(),
        }
    }

    /// Describes the suspects without which the others pass the test; `None` if they are more than a third, or fewer than four
    /// would be left, because a transform of three points cannot show which of them is wrong.
    fn describe_outliers(&self, suspects: &[usize]) -> Option<String> {
        let count = self.points.len();
        let mut left_out: Vec<usize> = vec![];
        let estimate = |left_out: &[usize], k: usize| {
            let kept = (0..count).filter(|other| *other != k && !left_out.contains(other));
            let kept: Vec<PointPair> = kept.map(|other| self.points[other]).collect();
            Some((k, TransformFit::estimate(&kept, self.similarity).ok()?))
        };
        let factor = |fit: &TransformFit| fit.variance_factor.unwrap_or(f64::INFINITY);
        loop {
            if count < left_out.len() + 5 || left_out.len() >= count / 3 {
                return None;
            }
            let others = suspects
                .iter()
                .filter(|k| !left_out.contains(k))
                .filter_map(|k| estimate(&left_out, *k));
            let (k, fit) = others.min_by(|a, b| factor(&a.1).total_cmp(&factor(&b.1)))?;
            left_out.push(k);
            if passes(&fit) {
                if let [a, b] = left_out[..] {
                    let exchange = |points: &mut [PointPair]| {
                        (points[a].target_m, points[b].target_m) =
                            (points[b].target_m, points[a].target_m);
                    };
                    if self.passes_with(exchange) {
                        let [a, b] = [&self.ids[a.min(b)], &self.ids[a.max(b)]];
                        return Some(format!("the CAD coordinates of {a} and {b} are exchanged"));
                    }
                }
                let off = |k: &usize| {
                    let off =
                        self.points[*k].target_m - fit.transform.apply(&self.points[*k].source_m);
                    format!(
                        "{} by {:.3} m in x, {:.3} m in y, {:.3} m in z",
                        self.ids[*k], off.x, off.y, off.z
                    )
                };
                let points: Vec<String> = left_out.iter().map(off).collect();
                return Some(format!(
                    "off the fit of the others, in the CAD frame, is {}",
                    points.join("; ")
                ));
            }
        }
    }
}

const TIES: &str = "cad.tie_points";
