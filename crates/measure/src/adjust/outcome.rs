//! Converts a fit of the spatial methods to a [`Solution`]: positions, deflections, torsion and curves, each with its
//! standard deviation.

mod cause_remarks;
mod deflections;
mod global_test;
mod prior_conflict;
mod sections;
mod torsion;

use nalgebra::{DMatrix, DVector, Vector2, Vector3};
pub use prior_conflict::with_prior_if_consistent;
pub use sections::{MovedSection, MovedSections, SectionFunction};

use self::cause_remarks::cause_remarks;
use super::beam::RAISE_TERMS;
use super::causes::{WidenedPriors, inseparable_image};
use super::curve::AxisCurve;
use super::layout::{GroundPositions, ParameterLayout};
use super::marker_state::MarkerState;
use super::scene::BentWing;
use super::snooping::{ResidualSum, SolvedGroup, Suspect, SuspectTarget};
use super::values::UnknownValues;
use super::{CurvePoint, Estimate, GlobalTest, MarkerSolution, Parameter, ParameterKind, Solution};
use crate::estimation::quality::Reliability;
use crate::estimation::{Gradient, VarianceSources};
use crate::widths::{Unknown, Width};

/// Part of a fit that belongs to one frame.
pub struct FrameOutcome<'a> {
    /// The frame's group.
    pub solved: SolvedGroup<'a>,
    /// Columns of the unknowns.
    pub layout: &'a ParameterLayout,
    /// Values of the unknowns.
    pub values: UnknownValues,
    bent: BentWing,
    global_test: Option<GlobalTest>,
    posterior: bool,
    /// Factor of the standard deviations: 1 if they are a priori.
    scale: f64,
    /// Sum of squares for the global test.
    tested_sum: ResidualSum,
    /// True if `tested_sum` includes observations that were removed.
    before_removal: bool,
    /// Free causes, and whether the camera stayed since the ground frames.
    causes: Option<(&'a WidenedPriors, bool)>,
}

impl<'a> FrameOutcome<'a> {
    /// Evaluates the model at the solution.
    pub fn new(solved: SolvedGroup<'a>, layout: &'a ParameterLayout) -> Self {
        let SolvedGroup {
            input, fit, group, ..
        } = solved;
        let values = layout.values(&fit.global, &fit.groups[group].local);
        let bent = input.scene.bend_frame(&values);
        Self {
            solved,
            layout,
            values,
            bent,
            global_test: None,
            posterior: false,
            scale: 1.0,
            tested_sum: ResidualSum::from_fit(fit),
            before_removal: false,
            causes: None,
        }
        .apply_global_test()
    }

    /// Adds the free causes. `stayed`: without a remount since the ground frames.
    pub fn with_causes(self, free: &'a WidenedPriors, stayed: bool) -> Self {
        Self {
            causes: Some((free, stayed)),
            ..self
        }
    }

    /// Returns whether the root's rotation is free, which images do not separate from its flexibility.
    fn withholds_root(&self) -> bool {
        let flexibility = self.solved.input.setup.uncertainty[Width::RootFlexibility];
        self.causes
            .is_some_and(|(free, _)| free.increase(Unknown::RootRotation) * flexibility > 0.0)
    }

    /// Returns all results of the frame. `removed`: observations removed by data snooping; each yields a remark and is
    /// given as the reason of its marker.
    pub fn solution<'s>(
        &self,
        removed: impl Iterator<Item = &'s Suspect>,
        sources: &VarianceSources,
    ) -> Solution {
        let (curve, parabola, a) = self.deflection_curve();
        let (mut parameters, correlation, pitch_bending_correlation) =
            self.parameters(&parabola, a);
        parameters.push(self.axis_raise());
        let (mut markers, mut remarks) = (self.marker_solutions(), vec![]);
        for suspect in removed {
            let remark = suspect.remark(self.solved.input.setup, self.solved.input.options);
            match suspect.target {
                SuspectTarget::Ground => {}
                SuspectTarget::Flight => markers[suspect.marker].reason = Some(remark.clone()),
                // Nothing can be predicted from a wrong survey.
                SuspectTarget::Survey => {
                    markers[suspect.marker] =
                        MarkerSolution::unused(suspect.marker, remark.clone());
                }
            }
            remarks.push(remark);
        }
        remarks.extend(self.removal_remark());
        let budget = self.variance_budget(&markers, sources);
        let (input, fit) = (self.solved.input, self.solved.fit);
        let (mut counted_causes, mut doubt) = (vec![], None);
        if let Some(((free, stayed), budget)) = self.causes.zip(budget.as_ref()) {
            let [counted, decisive] = cause_remarks(self, stayed, free, budget);
            remarks.extend(decisive.into_iter().chain(counted.clone()));
            (counted_causes, doubt) = (counted, inseparable_image(free, budget));
        }
        Solution {
            variance_factor: self.variance_factor(),
            redundancy: self.tested_sum.redundancy,
            global_test: self.global_test,
            posterior: self.posterior,
            parameters,
            correlation,
            pitch_bending_correlation,
            markers,
            torsion: self.torsions(),
            curve,
            axis_length_m: input.scene.ground.axis.length_m,
            budget,
            variance_components: vec![],
            counted_causes,
            doubt,
            remarks,
            iterations: fit.iterations,
        }
    }

    /// Creates an empty gradient for functions of the frame's unknowns and of some markers' positions on the ground.
    pub fn empty_gradient(&self, functions: usize, markers: &[usize]) -> Gradient {
        Gradient::empty(
            self.layout.block_columns(markers),
            self.layout.local,
            functions,
        )
    }

    /// Factor of the standard deviations: 1 if they are a priori.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    fn function_covariance(&self, gradient: &Gradient) -> DMatrix<f64> {
        self.solved
            .fit
            .function_covariance(self.solved.group, gradient)
            * (self.scale * self.scale)
    }

    fn function_sigmas(&self, gradient: &Gradient) -> Vec<f64> {
        let sigma = |variance: f64| self.scale * variance.max(0.0).sqrt();
        self.solved
            .fit
            .function_variances(self.solved.group, gradient)
            .into_iter()
            .map(sigma)
            .collect()
    }

    /// Block of a marker. Where surveyed positions are observed, each marker has one, whether it is seen or not.
    fn marker_block(&self, marker: usize) -> Option<usize> {
        self.solved.members.iter().position(|m| m.marker == marker)
    }

    fn block_with_image(&self, marker: usize) -> Option<usize> {
        self.marker_block(marker)
            .filter(|&block| self.solved.members[block].flight.is_some())
    }

    fn adjusted_ground_position(&self, marker: usize) -> Vector3<f64> {
        let (blocks, fits) = (
            &self.solved.problem.groups[self.solved.group].blocks,
            &self.solved.fit.groups[self.solved.group].blocks,
        );
        let adjusted = |block: usize| &blocks[block].observed + &fits[block].residuals;
        let observed = self
            .marker_block(marker)
            .map_or(DVector::zeros(0), adjusted);
        self.layout
            .ground_position(marker, &self.solved.fit.global, &observed)
    }

    /// Adjusted position of a marker on the ground, wing frame, m, and its state in flight.
    pub fn ground_position_and_flight_state(&self, marker: usize) -> (Vector3<f64>, MarkerState) {
        let ground = self.adjusted_ground_position(marker);
        let moved = self
            .layout
            .moved_position(marker, &ground, &self.solved.fit.global);
        (
            ground,
            self.solved
                .input
                .scene
                .marker_in_flight(marker, &self.bent, &moved, &self.values),
        )
    }

    /// Adds `directions * d(position in flight) + ground * d(position on the ground)` to a gradient, one function per
    /// direction. The gradient must have been created for the marker.
    pub fn add_position(
        &self,
        gradient: &mut Gradient,
        state: &MarkerState,
        directions: &[Vector3<f64>],
        ground: &[Vector3<f64>],
    ) {
        self.layout
            .add_position_derivative(gradient, state, directions);
        let motions = &self.layout.motions;
        for (direction, column) in motions
            .directions(state.marker)
            .iter()
            .zip(motions.columns(state.marker))
        {
            let by = state.carried.by_ground * direction;
            let Some(at) = gradient.columns.iter().position(|c| *c == column) else {
                continue;
            };
            directions
                .iter()
                .enumerate()
                .for_each(|(f, d)| gradient.global[(at, f)] += d.dot(&by));
        }
        let by_ground = directions
            .iter()
            .zip(ground)
            .map(|(d, g)| state.carried.by_ground.tr_mul(d) + g);
        match self.layout.ground_positions {
            GroundPositions::Observed => {
                let Some(block) = self.marker_block(state.marker) else {
                    return;
                };
                let n = self.solved.problem.groups[self.solved.group].blocks[block]
                    .observed
                    .len();
                let mut derivative = DMatrix::zeros(n, directions.len());
                for (f, by) in by_ground.enumerate() {
                    (0..3).for_each(|k| derivative[(k, f)] = by[k]);
                }
                gradient.observed.push((block, derivative));
            }
            GroundPositions::Global(surveyed) => {
                let column = surveyed + 3 * state.marker;
                let Some(first) = gradient.columns.iter().position(|c| *c == column) else {
                    return;
                };
                for (f, by) in by_ground.enumerate() {
                    (0..3).for_each(|k| gradient.global[(first + k, f)] += by[k]);
                }
            }
        }
    }

    /// Results of all markers of the survey. Where one on the wing is not measured, the adjusted shape predicts it.
    fn marker_solutions(&self) -> Vec<MarkerSolution> {
        (0..self.solved.input.setup.markers.len())
            .map(|marker| self.build_marker_solution(marker))
            .collect()
    }

    fn build_marker_solution(&self, marker: usize) -> MarkerSolution {
        let measured = self.block_with_image(marker);
        let unused = MarkerSolution::unused(marker, "not measured in this frame".into());
        if measured.is_none() && self.solved.input.setup.markers[marker].fixed {
            return unused;
        }
        let (ground, state) = self.ground_position_and_flight_state(marker);
        let position = state.carried.position_m;
        let distance = position.norm();
        let towards = position / distance;
        // Functions: position, distance, deflections.
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let none = Vector3::zeros();
        let mut gradient = self.empty_gradient(7, &[marker]);
        let directions = [x, y, z, towards, y, y, y];
        self.add_position(
            &mut gradient,
            &state,
            &directions,
            &[none, none, none, none, -y, -y, -y],
        );
        self.add_reference_derivatives(&mut gradient, &state, &(position - ground), [4, 5, 6]);
        let deflections = self.marker_deflections(&state, &ground);
        let covariance = self.function_covariance(&gradient);
        let frame = &self.solved.input.scene.ground.frame;
        let survey_from_wing = frame.wing_from_survey.inverse();
        let in_wing = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let sigma = |k: usize| Some(covariance[(k, k)].max(0.0).sqrt());
        let deflection = |k: usize| {
            let given = deflections.filter(|_| k < 2 || !self.withholds_root());
            given.map(|all| Estimate {
                value: all[k],
                sigma: sigma(4 + k),
            })
        };
        let solution = MarkerSolution {
            distance_m: Some(Estimate {
                value: distance,
                sigma: sigma(3),
            }),
            position_m: Some(frame.survey_point(&position)),
            covariance_m2: Some(
                survey_from_wing.matrix() * in_wing * survey_from_wing.matrix().transpose(),
            ),
            deflection_m: deflection(0),
            deflection_ground_m: deflection(1),
            deflection_root_m: deflection(2),
            ..unused
        };
        measured.map_or(solution.clone(), |block| {
            self.add_residuals_and_reliability(solution, block)
        })
    }

    fn add_residuals_and_reliability(
        &self,
        mut solution: MarkerSolution,
        block: usize,
    ) -> MarkerSolution {
        let member = self.solved.members[block];
        let Some(first) = member.flight else {
            return solution;
        };
        let residuals = &self.solved.fit.groups[self.solved.group].blocks[block].residuals;
        let all = self.solved.reliability(block);
        let (u, v) = (all[first], all[first + 1]);
        let bias = |r: &Reliability| r.minimal_detectable_bias.unwrap_or(f64::INFINITY);
        (solution.used, solution.reason) = (true, None);
        solution.residual_px = Some(Vector2::new(residuals[first], residuals[first + 1]));
        solution.redundancy = Some(Vector2::new(u.redundancy, v.redundancy));
        solution.w_test = all
            .iter()
            .filter_map(|r| r.w)
            .reduce(|a, b| if b.abs() > a.abs() { b } else { a });
        solution.minimal_detectable_bias_px = Some(Vector2::new(bias(&u), bias(&v)));
        solution.minimal_detectable_bias_m =
            (self.layout.ground_positions == GroundPositions::Observed).then(|| {
                // A bias along the survey's axes affects two or three wing coordinates.
                Vector3::new(bias(&all[0]), bias(&all[1]), bias(&all[2]))
            });
        solution
    }

    /// Computes the motion of the sections from the root to the outermost marker, and fits `a_per_m` to the deflection.
    fn deflection_curve(&self) -> (Vec<CurvePoint>, Gradient, f64) {
        let moved = self.moved_sections(AxisCurve::standard_arcs_m(self.solved.input.scene));
        let (curve, count) = (&moved.curve, moved.sections.len());
        let mut functions = self.reported_functions(&moved.sections);
        // Deflections relative to ground frame and root tangent, before their differences are added.
        functions.splice(1..1, [functions[0].clone(), functions[0].clone()]);
        let mut gradient = self.empty_gradient(functions.len() * count, &[]);
        self.add_section_functions(&mut gradient, &moved, &functions);
        self.add_curve_references(&mut gradient, &moved, &mut functions);
        let mut by_deflection = DVector::zeros(functions.len() * count);
        let (mut moment, mut fourth) = (0.0, 0.0);
        for (k, (section, deflection)) in curve.bent.iter().zip(&functions[0]).enumerate() {
            let x2 = (section.axis_m.x - curve.root_m.x).powi(2);
            by_deflection[k] = x2;
            moment += deflection.value * x2;
            fourth += x2 * x2;
        }
        by_deflection /= fourth;
        let all = self.section_estimates(&gradient, &functions);
        // The sign of a nose-up twist depends on the side.
        let side = self.solved.input.setup.side();
        let point = |k: usize| CurvePoint {
            arc_length_m: curve.arcs_m[k],
            span_m: curve.bent[k].axis_m.x,
            deflection_m: all[0][k],
            other_deflections_m: Some([
                Some(all[1][k]),
                Some(all[2][k]).filter(|_| !self.withholds_root()),
            ]),
            slope_rad: Some(all[3][k]),
            twist_rad: side.map(|_| all[4][k]),
            streamwise_twist_rad: all.get(5).map(|of_all| of_all[k]),
        };
        let parabola = Gradient {
            global: DMatrix::from_columns(&[&gradient.global * &by_deflection]),
            local: DMatrix::from_columns(&[&gradient.local * &by_deflection]),
            ..gradient
        };
        ((0..count).map(point).collect(), parabola, moment / fourth)
    }

    /// Mean height of the bending axis above its nominal position, m.
    fn axis_raise(&self) -> Parameter {
        let mut gradient = self.empty_gradient(1, &[]);
        let mean = |j: usize| 1.0 / (j + 1) as f64;
        (0..RAISE_TERMS).for_each(|j| {
            self.layout
                .add_derivative(&mut gradient, self.layout.axis_height, j, 0, mean(j))
        });
        let value = self
            .values
            .raise_m
            .iter()
            .enumerate()
            .map(|(j, raise)| mean(j) * raise)
            .sum();
        let sigma = self.function_sigmas(&gradient).first().copied();
        Parameter {
            kind: ParameterKind::AxisRaise,
            values: vec![Estimate { value, sigma }],
        }
    }

    /// Parameters, their correlation, and the correlation of the mount's pitch with bending.
    fn parameters(
        &self,
        parabola: &Gradient,
        a: f64,
    ) -> (Vec<Parameter>, DMatrix<f64>, Option<f64>) {
        let (n, t) = (self.layout.curvature_terms, self.layout.twist_terms);
        let count = n + t + 4;
        // An additional row for pitch, which is not a parameter of the results.
        let mut gradient = self.empty_gradient(count + 1, &[]);
        for (scope, first, size) in [(self.layout.curvature, 0, n), (self.layout.twist, n, t)] {
            for k in 0..size {
                self.layout
                    .add_derivative(&mut gradient, scope, k, first + k, 1.0);
            }
        }
        let pitch_axis = self.solved.input.scene.camera_from_wing * Vector3::z();
        for (scope, k) in self
            .layout
            .rotation
            .iter()
            .flat_map(|scope| (0..3).map(move |k| (*scope, k)))
        {
            self.layout
                .add_derivative(&mut gradient, scope, k, n + t + k, 1.0);
            self.layout
                .add_derivative(&mut gradient, scope, k, count, pitch_axis[k]);
        }
        gradient
            .global
            .column_mut(count - 1)
            .copy_from(&parabola.global.column(0));
        gradient
            .local
            .column_mut(count - 1)
            .copy_from(&parabola.local.column(0));
        let covariance = self.function_covariance(&gradient);
        let sigma = |k: usize| covariance[(k, k)].max(0.0).sqrt();
        let correlation = DMatrix::from_fn(count + 1, count + 1, |i, j| {
            covariance[(i, j)] / (sigma(i) * sigma(j))
        });
        let list = |values: &[f64], first: usize| {
            let one = |(k, &value): (usize, &f64)| Estimate {
                value,
                sigma: Some(sigma(first + k)),
            };
            values.iter().enumerate().map(one).collect()
        };
        let v = &self.values;
        let twist = self.solved.input.setup.side().map_or(vec![], |_| {
            list(&v.twist_rad[..t.min(v.twist_rad.len())], n)
        });
        let parameters = vec![
            Parameter {
                kind: ParameterKind::Curvature,
                values: list(&v.curvature_per_m, 0),
            },
            Parameter {
                kind: ParameterKind::Twist,
                values: twist,
            },
            Parameter {
                kind: ParameterKind::MountRotation,
                values: list(v.pose.mount_rad.as_slice(), n + t),
            },
            Parameter {
                kind: ParameterKind::Parabola,
                values: list(&[a], count - 1),
            },
        ];
        let pitch = Some(correlation[(count, count - 1)]).filter(|c| c.is_finite());
        (
            parameters,
            correlation.view((0, 0), (count, count)).into_owned(),
            pitch,
        )
    }
}
