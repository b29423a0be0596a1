//! The paper's method (MODEL.md section 2): a parabola in the vertical plane through the projection
//! centre, one distance per marker, arc length preserved.
//!
//! Like the paper it takes the camera's orientation and the projection centre as free of error and
//! the ground as a level line along which arc length is counted; neither shows in its residuals.

mod conditions;
mod parabola;
mod response;

pub use parabola::{ArcLength, arc_length};

use nalgebra::{DMatrix, DVector, Matrix3, RowVector4, Vector2, Vector3};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::gauss_helmert::{self, Block, Fit, Group, Problem};
use super::{
    AdjustError, CurvePoint, Estimate, GlobalTest, MarkerSolution, Method, Observation, Options, Parameter,
    SigmaKind, Solution, Torsion,
};
use crate::measure::setup::{Orientation, Setup};
use conditions::{ARC_LENGTH, Geometry, HEIGHT, PER_MARKER, PIXEL};
use response::{Function, Response};

/// Standard deviation of l and y where the survey states none (paper, section 2.2.1), m.
const DEFAULT_SURVEY_SIGMA_M: f64 = 0.005;
/// Intervals of the deflection curve.
const CURVE_INTERVALS: u32 = 40;

const MISSING: &str = "the bending (a) cannot be determined because no marker lies outboard of the bending root; \
    check root_offset_m and span_direction, or mark more of the wing";

/// One adjustment, before it is dressed for the results.
struct Adjusted<'a> {
    geometry: Geometry<'a>,
    observations: &'a [Observation],
    problem: Problem,
    fit: Fit,
    response: Response,
}

impl<'a> Adjusted<'a> {
    fn new(
        setup: &'a Setup,
        orientation: &'a Orientation,
        observations: &'a [Observation],
    ) -> Result<Self, AdjustError> {
        if observations.len() < 2 {
            return Err(AdjustError::TooFewMarkers { found: observations.len(), needed: 2 });
        }
        let geometry = Geometry::new(setup, orientation);
        let problem = problem(&geometry, observations)?;
        let fit = gauss_helmert::solve(&problem, |point| geometry.linearise(point))?;
        let response = Response::new(&problem, &fit);
        Ok(Self { geometry, observations, problem, fit, response })
    }

    fn a_per_m(&self) -> f64 {
        self.fit.global[0]
    }

    fn distance_m(&self, index: usize) -> f64 {
        self.fit.groups[index].local[0]
    }
}

/// Correlation of a with each observation's distance (the paper quotes the largest).
pub fn correlations_with_distances(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
) -> Result<Vec<f64>, AdjustError> {
    Ok(Adjusted::new(setup, orientation, observations)?.distance_correlations())
}

/// The paper's method, one frame.
pub(super) fn solve(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
) -> Result<Solution, AdjustError> {
    let adjusted = Adjusted::new(setup, orientation, observations)?;
    adjusted.solution(options)
}

fn problem(geometry: &Geometry, observations: &[Observation]) -> Result<Problem, AdjustError> {
    let mut starts = Vec::with_capacity(observations.len());
    let mut groups = Vec::with_capacity(observations.len());
    for observation in observations {
        let unknown =
            || AdjustError::Input("an observation names a marker that the survey does not list".into());
        let (l, y) = geometry.ground(observation.marker).ok_or_else(unknown)?;
        let direction = geometry.ray(&observation.pixel)?.direction;
        let x = geometry.in_flight(l);
        let d = (x + geometry.setup.root_offset_m) / direction.x;
        starts.push((x, d * direction.y - y));
        groups.push(Group {
            local: DVector::from_element(1, d),
            priors: Vec::new(),
            blocks: vec![block(geometry, observation, l, y)],
        });
    }
    // Start of a: the parabola nearest to the lifts that the ground's distances give.
    let (up, down) = starts.iter().fold((0.0, 0.0), |(u, d), (x, lift)| (u + lift * x * x, d + x.powi(4)));
    let a = if down > 0.0 { up / down } else { 0.0 };
    Ok(Problem { start: DVector::from_element(1, a), missing: vec![MISSING], priors: Vec::new(), groups })
}

/// Arc length and height with the survey's standard deviation, the pixel with its covariance.
fn block(geometry: &Geometry, observation: &Observation, l: f64, y: f64) -> Block {
    let stated = geometry.setup.markers[observation.marker].sigma_m;
    let sigma = if stated > 0.0 { stated } else { DEFAULT_SURVEY_SIGMA_M };
    let mut covariance = DMatrix::zeros(PER_MARKER, PER_MARKER);
    covariance[(ARC_LENGTH, ARC_LENGTH)] = sigma * sigma;
    covariance[(HEIGHT, HEIGHT)] = sigma * sigma;
    covariance.view_mut((PIXEL, PIXEL), (2, 2)).copy_from(&observation.covariance_px2);
    Block { observed: DVector::from_vec(vec![l, y, observation.pixel.x, observation.pixel.y]), covariance }
}

/// Position, lift and distance of one marker as linear functions of the observations.
struct Placed {
    position_m: Vector3<f64>,
    lift_m: f64,
    distance: Function,
    lift: Function,
    axes: [Function; 3],
}

impl Adjusted<'_> {
    fn distance_correlations(&self) -> Vec<f64> {
        let sigma_a = self.fit.covariance[(0, 0)].sqrt();
        let one = |k| {
            let d = self.response.function(k, 1.0, RowVector4::zeros());
            self.response.covariance_with_a(&d) / (sigma_a * self.response.covariance(&d, &d).sqrt())
        };
        (0..self.observations.len()).map(one).collect()
    }

    /// Polar point determination (equations 8 and 10) with the observed direction.
    fn place(&self, index: usize) -> Result<Placed, AdjustError> {
        let observation = &self.observations[index];
        let ray = self.geometry.ray(&observation.pixel)?;
        let d = self.distance_m(index);
        let position_m = self.geometry.frame.survey_point(&(ray.direction * d));
        let gradient = |axis: usize, height: f64| {
            let (u, v) = (d * ray.by_pixel[(axis, 0)], d * ray.by_pixel[(axis, 1)]);
            self.response.function(index, ray.direction[axis], RowVector4::new(0.0, height, u, v))
        };
        Ok(Placed {
            position_m,
            lift_m: position_m.z - self.geometry.setup.markers[observation.marker].position_m.z,
            distance: self.response.function(index, 1.0, RowVector4::zeros()),
            lift: gradient(1, -1.0),
            axes: [gradient(0, 0.0), gradient(1, 0.0), gradient(2, 0.0)],
        })
    }

    fn sigma(&self, f: &Function, scale: f64) -> Option<f64> {
        Some(scale * self.response.covariance(f, f).max(0.0).sqrt())
    }

    /// Survey frame, a priori.
    fn position_covariance(&self, placed: &Placed) -> Matrix3<f64> {
        let wing = Matrix3::from_fn(|i, j| self.response.covariance(&placed.axes[i], &placed.axes[j]));
        let survey_from_wing = self.geometry.frame.wing_from_survey.inverse();
        survey_from_wing * wing * survey_from_wing.inverse()
    }

    fn solution(&self, options: &Options) -> Result<Solution, AdjustError> {
        let placed: Vec<_> = (0..self.observations.len()).map(|k| self.place(k)).collect::<Result<_, _>>()?;
        let (global_test, posterior) = verdict(&self.fit, options);
        let scale = if posterior { self.fit.variance_factor().unwrap_or(1.0).sqrt() } else { 1.0 };
        let sigma_a = scale * self.fit.covariance[(0, 0)].sqrt();
        let a = Estimate { value: self.a_per_m(), sigma: Some(sigma_a) };
        Ok(Solution {
            method: Method::Profile,
            variance_factor: self.fit.variance_factor(),
            redundancy: self.fit.redundancy,
            global_test,
            posterior,
            parameters: vec![Parameter { name: "a_per_m", values: vec![a] }],
            correlation: DMatrix::identity(1, 1),
            pitch_bending_correlation: None,
            markers: self.markers(&placed, scale),
            torsion: self.torsion(&placed, scale),
            curve: self.curve(sigma_a),
            variance_components: Vec::new(),
            remarks: self.remarks(),
            iterations: self.fit.iterations,
        })
    }

    fn remarks(&self) -> Vec<String> {
        let strongest = self
            .distance_correlations()
            .into_iter()
            .fold(0.0, |m: f64, c| if c.abs() > m.abs() { c } else { m });
        vec![format!("strongest correlation of a with a distance: {strongest:.2}")]
    }

    fn markers(&self, placed: &[Placed], scale: f64) -> Vec<MarkerSolution> {
        let mut markers: Vec<_> = (0..self.geometry.setup.markers.len()).map(not_observed).collect();
        for (index, (observation, placed)) in self.observations.iter().zip(placed).enumerate() {
            markers[observation.marker] = MarkerSolution {
                used: true,
                reason: None,
                distance_m: Some(Estimate {
                    value: self.distance_m(index),
                    sigma: self.sigma(&placed.distance, scale),
                }),
                position_m: Some(placed.position_m),
                covariance_m2: Some(self.position_covariance(placed) * (scale * scale)),
                lift_m: Some(Estimate { value: placed.lift_m, sigma: self.sigma(&placed.lift, scale) }),
                ..self.image_quality(index, observation.marker)
            };
        }
        markers
    }

    /// Change of the angle of attack from the lifts of two markers (paper, section 4.3).
    fn torsion(&self, placed: &[Placed], scale: f64) -> Vec<Torsion> {
        let find = |marker| Some(&placed[self.observations.iter().position(|o| o.marker == marker)?]);
        let pair = |pair: &crate::measure::setup::TorsionPair| {
            let (leading, trailing) = (find(pair.leading)?, find(pair.trailing)?);
            let markers = &self.geometry.setup.markers;
            let ground = markers[pair.leading].position_m - markers[pair.trailing].position_m;
            let base = ground.xy().norm();
            let difference = leading.lift_m - trailing.lift_m;
            let c = |f: &Function, g: &Function| self.response.covariance(f, g);
            let variance = c(&leading.lift, &leading.lift) + c(&trailing.lift, &trailing.lift)
                - 2.0 * c(&leading.lift, &trailing.lift);
            let by_difference = base / (base * base + difference * difference);
            let sigma = Some(scale * variance.max(0.0).sqrt() * by_difference);
            Some(Estimate { value: difference.atan2(base), sigma })
        };
        let pairs = self.geometry.setup.torsion.iter();
        pairs.map(|p| Torsion { name: p.name.clone(), angle_rad: pair(p), twist_rad: None }).collect()
    }

    /// The parabola from the bending root to the outermost marker of the survey.
    fn curve(&self, sigma_a: f64) -> Vec<CurvePoint> {
        let markers = 0..self.geometry.setup.markers.len();
        let tip = markers.filter_map(|m| self.geometry.ground(m)).fold(0.0, |tip: f64, (l, _)| tip.max(l));
        let point = |k: u32| {
            let ground = tip * f64::from(k) / f64::from(CURVE_INTERVALS);
            let (a, x) = (self.a_per_m(), parabola::span_of(self.geometry.in_flight(ground), self.a_per_m()));
            let arc = arc_length(x, a);
            // At a fixed arc length x falls while a grows.
            let by_a = x * x - 2.0 * a * x * arc.by_a / arc.by_x;
            CurvePoint {
                arc_length_m: ground,
                span_m: self.geometry.setup.root_offset_m + x,
                lift_m: Estimate { value: a * x * x, sigma: Some(by_a.abs() * sigma_a) },
                twist_rad: None,
            }
        };
        (0..=CURVE_INTERVALS).map(point).collect()
    }
}

fn not_observed(marker: usize) -> MarkerSolution {
    MarkerSolution::unused(marker, "not found in the image".into())
}

impl Adjusted<'_> {
    /// Residual, redundancy numbers, w-test and minimal detectable bias of the pixel.
    fn image_quality(&self, index: usize, marker: usize) -> MarkerSolution {
        let residuals = &self.fit.groups[index].blocks[0].residuals;
        let before = self.problem.groups[index].blocks[0].covariance.clone();
        let cofactor =
            (&before - self.fit.adjusted_covariance(index, 0)).fixed_view::<2, 2>(PIXEL, PIXEL).into_owned();
        let residual = Vector2::new(residuals[PIXEL], residuals[PIXEL + 1]);
        let mut solution = not_observed(marker);
        solution.residual_px = Some(residual);
        let Some(weight) = self.observations[index].covariance_px2.try_inverse() else { return solution };
        let redundancy = cofactor * weight;
        // One condition sees the pixel: its weighted residual has one direction, so that either
        // component gives the test; the larger one is the safer.
        let normal = weight * cofactor * weight;
        let weighted = weight * residual;
        let k = if normal[(0, 0)] > normal[(1, 1)] { 0 } else { 1 };
        let bias = |k: usize| (normal[(k, k)] > 0.0).then(|| NON_CENTRALITY / normal[(k, k)].sqrt());
        solution.redundancy = Some(Vector2::new(redundancy[(0, 0)], redundancy[(1, 1)]));
        solution.w_test = (normal[(k, k)] > 0.0).then(|| weighted[k] / normal[(k, k)].sqrt());
        solution.minimal_detectable_bias_px = bias(0).zip(bias(1)).map(|(u, v)| Vector2::new(u, v));
        solution
    }
}

/// Shift of the w statistic that is found with 80 % power at a level of 0.1 % (Baarda).
const NON_CENTRALITY: f64 = 4.13;

fn verdict(fit: &Fit, options: &Options) -> (GlobalTest, bool) {
    let test = match ChiSquared::new(fit.redundancy as f64) {
        Ok(distribution) if fit.omega > distribution.inverse_cdf(1.0 - options.global_alpha) => {
            GlobalTest::Rejected
        }
        Ok(_) => GlobalTest::Passed,
        Err(_) => GlobalTest::NotPossible,
    };
    let posterior = match options.sigma {
        SigmaKind::ByTest => test == GlobalTest::Rejected,
        SigmaKind::Prior => false,
        SigmaKind::Posterior => test != GlobalTest::NotPossible,
    };
    (test, posterior)
}
