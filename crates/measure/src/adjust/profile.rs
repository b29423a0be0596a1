//! The paper's method (docs/model.md): a parabola in the vertical plane through the projection centre, one distance per
//! marker, arc length preserved.
//!
//! As in the paper, the camera's orientation and projection centre are assumed free of error, and arc length on the ground
//! is counted along a level line. Errors of these assumptions do not appear in the residuals.

mod budget;
mod conditions;
mod parabola;
mod response;
mod torsion;

pub use parabola::{ArcLength, arc_length};

use nalgebra::{DMatrix, DVector, Matrix3, RowVector4, Vector2, Vector3};

use super::snooping;
use super::{
    AdjustError, AdjustResult, CurvePoint, Estimate, MarkerSolution, Observation, Options,
    Parameter, ParameterKind, Solution, VarianceComponent,
};
use crate::estimation::quality::{self, Reliability};
use crate::estimation::{
    Block, Fit, Group, Problem, SolveOptions, VarianceGroup, solve_groups, variance_components,
};
use crate::setup::{Orientation, Setup, SurveyMarker};
use conditions::{ARC_LENGTH, HEIGHT, PER_MARKER, PIXEL, ProfileGeometry};
use response::{LinearResponse, MarkerFunction};

/// Default standard deviation of l and y, m, if the survey gives none (paper, section 2.2.1).
const DEFAULT_SURVEY_SIGMA_M: f64 = 0.005;
/// Number of intervals of the deflection curve.
const CURVE_INTERVALS: u32 = 40;

const MISSING_BENDING: &str = "the bending (a) cannot be determined because no marker is outboard of the bending root; \
    check root_offset_m and span_direction, or add markers on the wing";

/// Minimum number of observations that remain after data snooping.
const MIN_REMAINING: usize = 4;

/// Adjustment of one frame before conversion to results.
struct ProfileAdjustment<'a> {
    geometry: ProfileGeometry<'a>,
    observations: Vec<Observation>,
    problem: Problem,
    fit: Fit,
    response: LinearResponse,
    /// Reliability, per marker and observation.
    reliability: Vec<Vec<Reliability>>,
    components: Vec<VarianceComponent>,
    component_remarks: Vec<String>,
}

impl<'a> ProfileAdjustment<'a> {
    fn new(
        setup: &'a Setup,
        orientation: &Orientation,
        observations: Vec<Observation>,
        alpha: f64,
    ) -> AdjustResult<Self> {
        if observations.len() < 2 {
            return Err(AdjustError::TooFewMarkers {
                found: observations.len(),
                needed: 2,
            });
        }
        let geometry = ProfileGeometry::new(setup, orientation);
        let problem = build_problem(&geometry, &observations)?;
        let fit = solve_groups(&problem, &SolveOptions::default(), |at, blocks| {
            geometry.linearise(at, blocks)
        })?;
        let response = LinearResponse::new(&problem, &fit);
        let reliability = snooping::marker_reliabilities(&problem, &fit, alpha);
        Ok(Self {
            geometry,
            observations,
            problem,
            fit,
            response,
            reliability,
            components: Vec::new(),
            component_remarks: Vec::new(),
        })
    }

    /// Scales the standard deviations of image and survey by their variance components (Koch 1986).
    fn with_components(mut self, alpha: f64) -> AdjustResult<Self> {
        let image = |_: usize, _: usize| vec![PIXEL, PIXEL + 1];
        let survey = |_: usize, _: usize| vec![ARC_LENGTH, HEIGHT];
        let groups = [
            VarianceGroup {
                name: "image",
                members: &image,
            },
            VarianceGroup {
                name: "survey",
                members: &survey,
            },
        ];
        let geometry = &self.geometry;
        let found = variance_components(&mut self.problem, &groups, |at, blocks| {
            geometry.linearise(at, blocks)
        })?;
        (self.fit, self.components, self.component_remarks) =
            (found.fit, found.components, found.remarks);
        self.response = LinearResponse::new(&self.problem, &self.fit);
        self.reliability = snooping::marker_reliabilities(&self.problem, &self.fit, alpha);
        Ok(self)
    }

    /// Returns the adjusted bending coefficient a of the parabola y = a x^2, 1/m.
    fn a_per_m(&self) -> f64 {
        self.fit.global[0]
    }

    fn marker_distance_m(&self, index: usize) -> f64 {
        self.fit.groups[index].local[0]
    }
}

/// Correlations of a with each observation's distance (the paper gives the largest).
///
/// # Errors
/// Returns an error if there are fewer than 2 observations or they do not determine a solution.
pub fn correlations_with_distances(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
) -> AdjustResult<Vec<f64>> {
    Ok(
        ProfileAdjustment::new(setup, orientation, observations.to_vec(), 0.0)?
            .distance_correlations(),
    )
}

/// Adjusts one frame with the paper's method.
///
/// # Errors
/// Returns an error if the input is invalid or the observations do not determine a solution.
pub fn solve_profile(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
) -> AdjustResult<Solution> {
    // Fixed targets do not move with the wing and are not points of its profile.
    let fixed = |o: &&Observation| setup.markers.get(o.marker).is_some_and(|m| m.fixed);
    let observations: Vec<Observation> =
        observations.iter().filter(|o| !fixed(o)).cloned().collect();
    let mut adjusted = ProfileAdjustment::new(
        setup,
        orientation,
        observations.clone(),
        options.snooping_alpha,
    )?;
    let mut outliers = Vec::new();
    let least = MIN_REMAINING.max(observations.len() * 2 / 3);
    while adjusted.observations.len() > least {
        let Some((index, remark)) = adjusted.find_outlier(options) else {
            break;
        };
        let mut left = adjusted.observations.clone();
        outliers.push((left.remove(index).marker, remark));
        adjusted = ProfileAdjustment::new(setup, orientation, left, options.snooping_alpha)?;
    }
    if options.variance_components {
        adjusted = adjusted.with_components(options.snooping_alpha)?;
    }
    adjusted.build_solution(options, &outliers)
}

fn build_problem(
    geometry: &ProfileGeometry,
    observations: &[Observation],
) -> AdjustResult<Problem> {
    let mut starts = Vec::with_capacity(observations.len());
    let mut groups = Vec::with_capacity(observations.len());
    for observation in observations {
        let unknown = || {
            AdjustError::Input("an observation names a marker that the survey does not list".into())
        };
        let (l, y) = geometry
            .ground_coordinates(observation.marker)
            .ok_or_else(unknown)?;
        let ray = geometry.plane_ray(&observation.pixel)?;
        let x = geometry.flight_length_m(l);
        let d = (x + geometry.setup.root_offset_m - ray.from_m.x) / ray.direction.x;
        starts.push((x, ray.from_m.y + d * ray.direction.y - y));
        groups.push(Group {
            local: DVector::from_element(1, d),
            priors: Vec::new(),
            blocks: vec![observation_block(geometry, observation, l, y)],
        });
    }
    // Start value of a: least-squares parabola through the deflections at the distances on the ground.
    let (up, down) = starts.iter().fold((0.0, 0.0), |(u, d), (x, deflection)| {
        (u + deflection * x * x, d + x.powi(4))
    });
    let a = if down > 0.0 { up / down } else { 0.0 };
    Ok(Problem {
        start: DVector::from_element(1, a),
        missing: vec![MISSING_BENDING],
        priors: Vec::new(),
        known: None,
        groups,
    })
}

/// Builds a marker's block: arc length and height with the survey's standard deviation, and the pixel with its covariance.
fn observation_block(
    geometry: &ProfileGeometry,
    observation: &Observation,
    l: f64,
    y: f64,
) -> Block {
    let survey_sigma = geometry.setup.markers[observation.marker].sigma_m;
    let sigma = if survey_sigma > 0.0 {
        survey_sigma
    } else {
        DEFAULT_SURVEY_SIGMA_M
    };
    let mut covariance = DMatrix::zeros(PER_MARKER, PER_MARKER);
    covariance[(ARC_LENGTH, ARC_LENGTH)] = sigma * sigma;
    covariance[(HEIGHT, HEIGHT)] = sigma * sigma;
    covariance
        .view_mut((PIXEL, PIXEL), (2, 2))
        .copy_from(&observation.covariance_px2);
    Block {
        observed: DVector::from_vec(vec![l, y, observation.pixel.x, observation.pixel.y]),
        covariance,
    }
}

/// Position, deflection and distance of one marker as linear functions of the observations.
struct ProfileMarker {
    position_m: Vector3<f64>,
    deflection_m: f64,
    distance: MarkerFunction,
    deflection: MarkerFunction,
    axes: [MarkerFunction; 3],
}

impl ProfileAdjustment<'_> {
    fn distance_correlations(&self) -> Vec<f64> {
        let sigma_a = self.fit.covariance[(0, 0)].sqrt();
        let one = |k| {
            let d = self.response.marker_function(k, 1.0, RowVector4::zeros());
            self.response.covariance_with_a(&d)
                / (sigma_a * self.response.covariance(&d, &d).sqrt())
        };
        (0..self.observations.len()).map(one).collect()
    }

    /// Computes the marker by polar point determination (equations 8 and 10) with the observed direction.
    fn place_marker(&self, index: usize) -> AdjustResult<ProfileMarker> {
        let observation = &self.observations[index];
        let ray = self.geometry.plane_ray(&observation.pixel)?;
        let d = self.marker_distance_m(index);
        let position_m = self
            .geometry
            .frame
            .survey_point(&(ray.from_m + ray.direction * d));
        let gradient = |axis: usize, height: f64| {
            let (u, v) = (d * ray.by_pixel[(axis, 0)], d * ray.by_pixel[(axis, 1)]);
            self.response.marker_function(
                index,
                ray.direction[axis],
                RowVector4::new(0.0, height, u, v),
            )
        };
        Ok(ProfileMarker {
            position_m,
            deflection_m: position_m.z
                - self.geometry.setup.markers[observation.marker].position_m.z,
            distance: self
                .response
                .marker_function(index, 1.0, RowVector4::zeros()),
            deflection: gradient(1, -1.0),
            axes: [gradient(0, 0.0), gradient(1, 0.0), gradient(2, 0.0)],
        })
    }

    fn function_sigma(&self, f: &MarkerFunction, scale: f64) -> Option<f64> {
        Some(scale * self.response.covariance(f, f).max(0.0).sqrt())
    }

    /// Covariance of the position, survey frame, a priori.
    fn position_covariance(&self, placed: &ProfileMarker) -> Matrix3<f64> {
        let wing =
            Matrix3::from_fn(|i, j| self.response.covariance(&placed.axes[i], &placed.axes[j]));
        let survey_from_wing = self.geometry.frame.wing_from_survey.inverse();
        survey_from_wing * wing * survey_from_wing.inverse()
    }

    fn build_solution(
        &self,
        options: &Options,
        outliers: &[(usize, String)],
    ) -> AdjustResult<Solution> {
        let placed: Vec<_> = (0..self.observations.len())
            .map(|k| self.place_marker(k))
            .collect::<Result<_, _>>()?;
        let global_test =
            quality::global_test(self.fit.omega, self.fit.redundancy, options.global_alpha);
        let posterior = quality::is_posterior(options.sigma, global_test);
        let scale = if posterior {
            self.fit.variance_factor().unwrap_or(1.0).sqrt()
        } else {
            1.0
        };
        let sigma_a = scale * self.fit.covariance[(0, 0)].sqrt();
        let a = Estimate {
            value: self.a_per_m(),
            sigma: Some(sigma_a),
        };
        let markers = self.build_marker_solutions(&placed, scale, outliers);
        let budget = self.variance_budget(&markers, &placed);
        Ok(Solution {
            variance_factor: self.fit.variance_factor(),
            redundancy: self.fit.redundancy,
            global_test,
            posterior,
            parameters: vec![Parameter {
                kind: ParameterKind::Parabola,
                values: vec![a],
            }],
            correlation: DMatrix::identity(1, 1),
            markers,
            torsion: self.torsions(&placed, scale),
            curve: self.deflection_curve(scale),
            budget,
            variance_components: self.components.clone(),
            remarks: self.build_remarks(outliers),
            iterations: self.fit.iterations,
            ..Solution::default()
        })
    }

    fn build_remarks(&self, outliers: &[(usize, String)]) -> Vec<String> {
        let stronger = |m: f64, c: f64| if c.abs() > m.abs() { c } else { m };
        let strongest = self.distance_correlations().into_iter().fold(0.0, stronger);
        let correlation =
            format!("largest correlation of the bending (a) with a distance: {strongest:.2}");
        let outliers = outliers.iter().map(|(_, remark)| remark.clone());
        outliers
            .chain(self.component_remarks.iter().cloned())
            .chain([correlation])
            .collect()
    }

    fn build_marker_solutions(
        &self,
        placed: &[ProfileMarker],
        scale: f64,
        outliers: &[(usize, String)],
    ) -> Vec<MarkerSolution> {
        let unseen = |(marker, surveyed): (usize, &SurveyMarker)| {
            if surveyed.fixed {
                return MarkerSolution::unused(
                    marker,
                    "fixed to the cabin; not used by the profile method".into(),
                );
            }
            let predicted = |(ground_m, _)| self.parabola_deflection(ground_m, scale);
            MarkerSolution {
                deflection_m: self.geometry.ground_coordinates(marker).map(predicted),
                ..MarkerSolution::unused(marker, "not found in the image".into())
            }
        };
        let mut markers: Vec<_> = self
            .geometry
            .setup
            .markers
            .iter()
            .enumerate()
            .map(unseen)
            .collect();
        for (marker, remark) in outliers {
            markers[*marker].reason = Some(remark.clone());
        }
        for (index, (observation, placed)) in self.observations.iter().zip(placed).enumerate() {
            let value = self.marker_distance_m(index);
            markers[observation.marker] = MarkerSolution {
                distance_m: Some(Estimate {
                    value,
                    sigma: self.function_sigma(&placed.distance, scale),
                }),
                position_m: Some(placed.position_m),
                covariance_m2: Some(self.position_covariance(placed) * (scale * scale)),
                deflection_m: Some(Estimate {
                    value: placed.deflection_m,
                    sigma: self.function_sigma(&placed.deflection, scale),
                }),
                ..self.with_quality(index, observation.marker)
            };
        }
        markers
    }

    /// Parabola from the bending root to the outermost marker of the survey.
    fn deflection_curve(&self, scale: f64) -> Vec<CurvePoint> {
        let wing = self.geometry.setup.wing_markers();
        let tip = wing
            .iter()
            .filter_map(|(m, _)| self.geometry.ground_coordinates(*m))
            .fold(0.0, |tip: f64, (l, _)| tip.max(l));
        let point = |k: u32| {
            let ground = tip * f64::from(k) / f64::from(CURVE_INTERVALS);
            CurvePoint {
                arc_length_m: ground,
                span_m: self.geometry.setup.root_offset_m + self.parabola_span_m(ground),
                deflection_m: self.parabola_deflection(ground, scale),
                other_deflections_m: None,
                slope_rad: None,
                twist_rad: None,
                streamwise_twist_rad: None,
            }
        };
        (0..=CURVE_INTERVALS).map(point).collect()
    }

    /// Distance from the bending root along the span at an arc length on the ground, m.
    fn parabola_span_m(&self, ground_m: f64) -> f64 {
        parabola::span_from_length(self.geometry.flight_length_m(ground_m), self.a_per_m())
    }

    /// Derivative of the parabola's deflection by `a` at an arc length on the ground, m^2.
    fn deflection_by_a(&self, ground_m: f64) -> f64 {
        let (a, x) = (self.a_per_m(), self.parabola_span_m(ground_m));
        let arc = arc_length(x, a);
        // At a fixed arc length x decreases while a increases.
        x * x - 2.0 * a * x * arc.by_a / arc.by_x
    }

    /// Deflection of the parabola at an arc length on the ground, m.
    fn parabola_deflection(&self, ground_m: f64, scale: f64) -> Estimate {
        let sigma_a = scale * self.fit.covariance[(0, 0)].sqrt();
        let x = self.parabola_span_m(ground_m);
        let value = self.a_per_m() * x * x;
        Estimate {
            value,
            sigma: Some(self.deflection_by_a(ground_m).abs() * sigma_a),
        }
    }
}

impl ProfileAdjustment<'_> {
    /// Result of a used marker with residual, redundancy numbers, w-test and minimal detectable biases.
    fn with_quality(&self, index: usize, marker: usize) -> MarkerSolution {
        let residuals = &self.fit.groups[index].blocks[0].residuals;
        let all = &self.reliability[index];
        let bias = |k: usize| all[k].minimal_detectable_bias.unwrap_or(f64::INFINITY);
        MarkerSolution {
            used: true,
            reason: None,
            residual_px: Some(Vector2::new(residuals[PIXEL], residuals[PIXEL + 1])),
            redundancy: Some(Vector2::new(
                all[PIXEL].redundancy,
                all[PIXEL + 1].redundancy,
            )),
            w_test: snooping::largest_statistic(&all[PIXEL..]).and_then(|r| r.w),
            minimal_detectable_bias_px: Some(Vector2::new(bias(PIXEL), bias(PIXEL + 1))),
            // The method has no chordwise coordinate.
            minimal_detectable_bias_m: Some(Vector3::new(
                bias(ARC_LENGTH),
                bias(HEIGHT),
                f64::INFINITY,
            )),
            ..MarkerSolution::unused(marker, String::new())
        }
    }

    /// Finds the observation that is most probably an outlier, with its remark. With one redundant condition per marker,
    /// errors of image and survey are not separable.
    fn find_outlier(&self, options: &Options) -> Option<(usize, String)> {
        let limit = quality::critical_w(options.snooping_alpha);
        let shift = quality::detectable_shift(options.snooping_alpha);
        let suspects = (0..self.observations.len()).filter_map(|index| {
            let all = &self.reliability[index];
            let image = snooping::largest_statistic(&all[PIXEL..])?;
            Some((
                index,
                snooping::largest_statistic(all)?.w?.abs(),
                image.w? * image.minimal_detectable_bias? / shift,
            ))
        });
        let (index, w, size) = suspects.reduce(|a, b| if b.1 > a.1 { b } else { a })?;
        let w = w / snooping::root_variance_factor(&self.fit, w, options);
        let id = &self.geometry.setup.markers[self.observations[index].marker].id;
        (w > limit).then(|| {
            let remark = format!(
                "marker {id} was removed: its image or its surveyed position is about {:.1} px off the parabola of the other \
                 markers (w = {w:.1}, limit {limit:.1}); check both",
                size.abs()
            );
            (index, remark)
        })
    }
}
