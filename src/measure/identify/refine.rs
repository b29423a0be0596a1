//! Least squares of the ground frames: rotation, with survey and projection centre as uncertain as
//! they are stated. Their errors are common to all frames, so that more frames do not hide them.

use nalgebra::{DMatrix, DVector, Matrix2, Rotation3, SMatrix, Vector2, Vector3};

use super::ground::camera_point;
use super::scene::mahalanobis;
use crate::measure::environment::Plate;
use crate::measure::geometry::skew;
use crate::measure::setup::{GroundSight, Orientation, Setup};

/// Chi-square of two degrees of freedom, 1e-4.
const GATE: f64 = 18.4;
const ITERATIONS: usize = 20;
/// A survey that claims no error at all is taken at this, m.
const LEAST_SIGMA_M: f64 = 1e-5;

/// One marker seen in one ground frame, perspective bias removed.
#[derive(Clone, Debug)]
pub(super) struct Sight {
    pub(super) frame: usize,
    pub(super) detection: usize,
    pub(super) marker: usize,
    pub(super) pixel: Vector2<f64>,
    pub(super) covariance_px2: Matrix2<f64>,
}

/// The adjusted orientation.
pub(super) struct Adjusted {
    pub(super) orientation: Orientation,
    pub(super) variance_factor: f64,
    pub(super) redundancy: usize,
    /// With residuals against the survey as given, adjusted - observed, px.
    pub(super) used: Vec<(Sight, Vector2<f64>)>,
    pub(super) taken_out: Vec<Sight>,
}

/// Unknowns: small rotation, shift of the projection centre, shift of every marker.
struct Unknowns {
    rotation: Rotation3<f64>,
    centre_m: Vector3<f64>,
    markers_m: Vec<Vector3<f64>>,
}

/// Jacobian of one sight by rotation, centre and its own marker.
type Rows = SMatrix<f64, 2, 9>;

struct System {
    inverse: DMatrix<f64>,
    step: DVector<f64>,
    cost: f64,
}

/// Adjusts, taking out the worst sight while its residual fails the test.
pub(super) fn adjust(setup: &Setup, start: &Rotation3<f64>, mut sights: Vec<Sight>) -> Option<Adjusted> {
    let mut taken_out = Vec::new();
    loop {
        let (unknowns, system) = converge(setup, start, &sights)?;
        let worst = sights
            .iter()
            .enumerate()
            .filter_map(|(k, s)| Some((residual_test(setup, &unknowns, &system, s)?, k)))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        match worst {
            Some((t, k)) if t > GATE && sights.len() > 2 => taken_out.push(sights.remove(k)),
            _ => return Some(conclude(setup, &unknowns, &system, sights, taken_out)),
        }
    }
}

fn conclude(
    setup: &Setup,
    unknowns: &Unknowns,
    system: &System,
    sights: Vec<Sight>,
    taken_out: Vec<Sight>,
) -> Adjusted {
    let redundancy = (2 * sights.len()).saturating_sub(3);
    let covariance = system.inverse.fixed_view::<3, 3>(0, 0).into_owned();
    let residual = |s: &Sight| {
        let ground = setup.markers[s.marker].position_m;
        let p = seen(setup, &unknowns.rotation, &ground, &setup.projection_centre_m);
        setup.lens.project(&p).map_or(Vector2::zeros(), |pixel| pixel - s.pixel)
    };
    Adjusted {
        orientation: Orientation {
            camera_from_survey: unknowns.rotation,
            covariance_rad2: Some(covariance),
            ground: means(setup.markers.len(), &sights),
        },
        variance_factor: system.cost / redundancy.max(1) as f64,
        redundancy,
        used: sights.into_iter().map(|s| (s.clone(), residual(&s))).collect(),
        taken_out,
    }
}

/// Per marker the weighted mean over the frames.
fn means(markers: usize, sights: &[Sight]) -> Vec<GroundSight> {
    (0..markers)
        .filter_map(|marker| {
            let (mut weights, mut sum) = (Matrix2::zeros(), Vector2::zeros());
            for sight in sights.iter().filter(|s| s.marker == marker) {
                let weight = sight.covariance_px2.try_inverse()?;
                weights += weight;
                sum += weight * sight.pixel;
            }
            let covariance_px2 = weights.try_inverse()?;
            Some(GroundSight { marker, pixel: covariance_px2 * sum, covariance_px2 })
        })
        .collect()
}

fn converge(setup: &Setup, start: &Rotation3<f64>, sights: &[Sight]) -> Option<(Unknowns, System)> {
    let mut unknowns = Unknowns {
        rotation: *start,
        centre_m: setup.projection_centre_m,
        markers_m: setup.markers.iter().map(|m| m.position_m).collect(),
    };
    for _ in 0..ITERATIONS {
        let system = assemble(setup, &unknowns, sights)?;
        let turn = Vector3::new(system.step[0], system.step[1], system.step[2]);
        unknowns.rotation = Rotation3::new(turn) * unknowns.rotation;
        unknowns.centre_m += system.step.fixed_rows::<3>(3);
        for (j, m) in unknowns.markers_m.iter_mut().enumerate() {
            *m += system.step.fixed_rows::<3>(6 + 3 * j);
        }
        if turn.norm() < 1e-9 {
            unknowns.rotation.renormalize();
            let system = assemble(setup, &unknowns, sights)?;
            return Some((unknowns, system));
        }
    }
    None
}

/// Where the camera sees a surveyed point on ground, through the window where that is stated; camera frame.
fn seen(
    setup: &Setup,
    rotation: &Rotation3<f64>,
    survey_m: &Vector3<f64>,
    centre_m: &Vector3<f64>,
) -> Vector3<f64> {
    let p = camera_point(rotation, survey_m, centre_m);
    Plate::seen(setup.window.as_ref(), rotation, false).map_or(p, |pane| pane.apparent(&p))
}

/// Misclosure and Jacobian of a sight.
fn rows(setup: &Setup, unknowns: &Unknowns, sight: &Sight) -> Option<(Vector2<f64>, Rows)> {
    let p = seen(setup, &unknowns.rotation, unknowns.markers_m.get(sight.marker)?, &unknowns.centre_m);
    let (pixel, by_point) = setup.lens.project_with_jacobian(&p)?;
    let by_shift = by_point * unknowns.rotation.matrix();
    let mut rows = Rows::zeros();
    rows.fixed_columns_mut::<3>(0).copy_from(&(by_point * -skew(&p)));
    rows.fixed_columns_mut::<3>(3).copy_from(&-by_shift);
    rows.fixed_columns_mut::<3>(6).copy_from(&by_shift);
    Some((sight.pixel - pixel, rows))
}

/// Places of a sight's nine unknowns in the system.
fn places(marker: usize) -> [usize; 9] {
    std::array::from_fn(|k| if k < 6 { k } else { 6 + 3 * marker + k - 6 })
}

fn assemble(setup: &Setup, unknowns: &Unknowns, sights: &[Sight]) -> Option<System> {
    let size = 6 + 3 * setup.markers.len();
    let mut normal = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    let mut cost = 0.0;
    let mut hold = |at: usize, shift: Vector3<f64>, sigma: f64| {
        let weight = 1.0 / sigma.max(LEAST_SIGMA_M).powi(2);
        for k in 0..3 {
            normal[(at + k, at + k)] += weight;
            right[at + k] += weight * shift[k];
        }
        cost += weight * shift.norm_squared();
    };
    hold(3, setup.projection_centre_m - unknowns.centre_m, setup.projection_centre_sigma_m);
    for (j, (marker, at)) in setup.markers.iter().zip(&unknowns.markers_m).enumerate() {
        hold(6 + 3 * j, marker.position_m - at, marker.sigma_m);
    }
    for sight in sights {
        let (v, rows) = rows(setup, unknowns, sight)?;
        let weight = sight.covariance_px2.try_inverse()?;
        let weighted = rows.transpose() * weight;
        let (block, part) = (weighted * rows, weighted * v);
        let places = places(sight.marker);
        for (a, &row) in places.iter().enumerate() {
            right[row] += part[a];
            for (b, &column) in places.iter().enumerate() {
                normal[(row, column)] += block[(a, b)];
            }
        }
        cost += v.dot(&(weight * v));
    }
    let cholesky = normal.cholesky()?;
    let step = cholesky.solve(&right);
    Some(System { inverse: cholesky.inverse(), cost: (cost - right.dot(&step)).max(0.0), step })
}

/// v' Qv^-1 v of a sight: chi-square with two degrees of freedom where it is no blunder.
fn residual_test(setup: &Setup, unknowns: &Unknowns, system: &System, sight: &Sight) -> Option<f64> {
    let (v, rows) = rows(setup, unknowns, sight)?;
    let places = places(sight.marker);
    let block = SMatrix::<f64, 9, 9>::from_fn(|a, b| system.inverse[(places[a], places[b])]);
    Some(mahalanobis(&v, &(sight.covariance_px2 - rows * block * rows.transpose())))
}
