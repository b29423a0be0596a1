//! A fit of the spatial methods as a [`Solution`]: positions, deflections, torsion, curves, each with its
//! standard deviation.

mod deflections;
mod global_test;
mod prior_conflict;

use nalgebra::{DMatrix, DVector, Vector2, Vector3};
pub use prior_conflict::with_prior_if_consistent;

use super::beam::{Grid, RAISE_TERMS};
use super::curve::Curve;
use super::input::Input;
use super::layout::{Layout, Member, Survey};
use super::marker_state::MarkerState;
use super::scene::Bent;
use super::snooping::{ResidualSum, Suspect, Target};
use super::values::Values;
use super::{CurvePoint, Estimate, GlobalTest, MarkerSolution, Method, Parameter, Solution, Torsion};
use crate::estimation::quality::{self, Reliability};
use crate::estimation::{Fit, Gradient, Problem, Sources};
use crate::setup::TorsionPair;

/// One frame's part of a fit.
pub struct Outcome<'a> {
    /// What it was set up from.
    pub input: &'a Input<'a>,
    /// Where the unknowns stand.
    pub layout: &'a Layout,
    /// What was solved.
    pub problem: &'a Problem,
    /// Its solution.
    pub fit: &'a Fit,
    /// The frame's group.
    pub group: usize,
    /// Its blocks.
    pub members: &'a [Member],
    values: Values,
    bent: Bent,
    global_test: GlobalTest,
    posterior: bool,
    /// Factor of the standard deviations: 1 a priori.
    scale: f64,
    /// What the global test judges.
    judged: ResidualSum,
    /// Whether that is what there was before much was removed.
    before_removal: bool,
}

impl<'a> Outcome<'a> {
    /// Evaluates the model at the solution.
    pub fn new(
        input: &'a Input<'a>,
        layout: &'a Layout,
        problem: &'a Problem,
        fit: &'a Fit,
        group: usize,
        members: &'a [Member],
    ) -> Self {
        let values = layout.values(&fit.global, &fit.groups[group].local);
        let bent = input.scene.bent(&values);
        let (global_test, posterior, scale) = (GlobalTest::NotPossible, false, 1.0);
        let (judged, before_removal) = (ResidualSum::of(fit), false);
        let new = Self {
            input,
            layout,
            problem,
            fit,
            group,
            members,
            values,
            bent,
            global_test,
            posterior,
            scale,
            judged,
            before_removal,
        };
        new.tested()
    }

    /// All that the fit says of the frame; `removed`: what data snooping left out of it, with a remark and a reason each.
    pub fn solution<'s>(
        &self,
        method: Method,
        removed: impl Iterator<Item = &'s Suspect>,
        sources: &Sources,
    ) -> Solution {
        let (curve, parabola, a) = self.curve();
        let (mut parameters, correlation, pitch_bending_correlation) = self.parameters(&parabola, a);
        parameters.push(self.axis_raise());
        let (mut markers, mut remarks) = (self.markers(), vec![]);
        for suspect in removed {
            let sentence = suspect.sentence(self.input.setup, self.input.options);
            if suspect.target != Target::Ground {
                markers[suspect.marker].reason = Some(sentence.clone());
            }
            remarks.push(sentence);
        }
        remarks.extend(self.removal_remark());
        let budget = self.budget(&markers, sources);
        Solution {
            method,
            variance_factor: self.variance_factor(),
            redundancy: self.judged.redundancy,
            global_test: self.global_test,
            posterior: self.posterior,
            parameters,
            correlation,
            pitch_bending_correlation,
            markers,
            torsion: self.torsion(),
            curve,
            budget,
            variance_components: vec![],
            remarks,
            iterations: self.fit.iterations,
        }
    }

    /// Of functions of the frame's unknowns and of the places of some markers on ground.
    fn gradient(&self, functions: usize, markers: &[usize]) -> Gradient {
        Gradient::empty(self.layout.columns(markers), self.layout.local, functions)
    }

    /// Factor of the standard deviations.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    fn covariance(&self, gradient: &Gradient) -> DMatrix<f64> {
        self.fit.function_covariance(self.group, gradient) * (self.scale * self.scale)
    }

    fn sigmas(&self, gradient: &Gradient) -> Vec<f64> {
        let sigma = |variance: f64| self.scale * variance.max(0.0).sqrt();
        self.fit.function_variances(self.group, gradient).into_iter().map(sigma).collect()
    }

    fn block_of(&self, marker: usize) -> Option<usize> {
        self.members.iter().position(|m| m.marker == marker && m.flight.is_some())
    }

    fn on_ground(&self, block: usize) -> Vector3<f64> {
        let observed = &self.problem.groups[self.group].blocks[block].observed
            + &self.fit.groups[self.group].blocks[block].residuals;
        self.layout.on_ground(self.members[block].marker, &self.fit.global, &observed)
    }

    fn state(&self, block: usize) -> (Vector3<f64>, MarkerState) {
        let marker = self.members[block].marker;
        let ground = self.on_ground(block);
        let moved = self.layout.with_motion(marker, &ground, &self.fit.global);
        (ground, self.input.scene.in_flight(marker, &self.bent, &moved, &self.values))
    }

    /// Adds `directions * d(position in flight) + ground * d(position on ground)` to a gradient, a function
    /// for each direction. The marker is one of those that the gradient was set up for.
    fn add(
        &self,
        gradient: &mut Gradient,
        block: usize,
        state: &MarkerState,
        directions: &[Vector3<f64>],
        ground: &[Vector3<f64>],
    ) {
        self.layout.put_position(gradient, state, directions);
        let motions = &self.layout.motions;
        for (direction, column) in motions.directions(state.marker).iter().zip(motions.columns(state.marker))
        {
            let by = state.carried.by_ground * direction;
            let Some(at) = gradient.columns.iter().position(|c| *c == column) else { continue };
            directions.iter().enumerate().for_each(|(f, d)| gradient.global[(at, f)] += d.dot(&by));
        }
        let by_ground = directions.iter().zip(ground).map(|(d, g)| state.carried.by_ground.tr_mul(d) + g);
        match self.layout.survey {
            Survey::Observed => {
                let n = self.problem.groups[self.group].blocks[block].observed.len();
                let mut derivative = DMatrix::zeros(n, directions.len());
                for (f, by) in by_ground.enumerate() {
                    (0..3).for_each(|k| derivative[(k, f)] = by[k]);
                }
                gradient.observed.push((block, derivative));
            }
            Survey::Global(surveyed) => {
                let column = surveyed + 3 * state.marker;
                let Some(first) = gradient.columns.iter().position(|c| *c == column) else { return };
                for (f, by) in by_ground.enumerate() {
                    (0..3).for_each(|k| gradient.global[(first + k, f)] += by[k]);
                }
            }
        }
    }

    /// Every marker of the survey; those without an observation stay without numbers.
    fn markers(&self) -> Vec<MarkerSolution> {
        let unseen = |marker| MarkerSolution::unused(marker, "not measured in this frame".into());
        let mut markers: Vec<_> = (0..self.input.setup.markers.len()).map(unseen).collect();
        for (block, member) in self.members.iter().enumerate() {
            if member.flight.is_some() {
                markers[member.marker] = self.marker(block);
            }
        }
        markers
    }

    fn marker(&self, block: usize) -> MarkerSolution {
        let member = self.members[block];
        let (ground, state) = self.state(block);
        let position = state.carried.position_m;
        let distance = position.norm();
        let towards = position / distance;
        // Position, distance, deflections.
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let none = Vector3::zeros();
        let mut gradient = self.gradient(7, &[member.marker]);
        let directions = [x, y, z, towards, y, y, y];
        self.add(&mut gradient, block, &state, &directions, &[none, none, none, none, -y, -y, -y]);
        self.add_references(&mut gradient, &state, &(position - ground), [4, 5, 6]);
        let deflections = self.deflections(&state, &ground);
        let covariance = self.covariance(&gradient);
        let survey_from_wing = self.input.scene.ground.frame.wing_from_survey.inverse();
        let in_wing = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let sigma = |k: usize| Some(covariance[(k, k)].max(0.0).sqrt());
        let solution = MarkerSolution {
            used: true,
            reason: None,
            distance_m: Some(Estimate { value: distance, sigma: sigma(3) }),
            position_m: Some(self.input.scene.ground.frame.survey_point(&position)),
            covariance_m2: Some(survey_from_wing.matrix() * in_wing * survey_from_wing.matrix().transpose()),
            deflection_m: deflections.map(|deflections| Estimate { value: deflections[0], sigma: sigma(4) }),
            deflection_ground_m: deflections
                .map(|deflections| Estimate { value: deflections[1], sigma: sigma(5) }),
            deflection_root_m: deflections
                .map(|deflections| Estimate { value: deflections[2], sigma: sigma(6) }),
            ..MarkerSolution::unused(member.marker, String::new())
        };
        self.with_quality(solution, block)
    }

    fn with_quality(&self, mut solution: MarkerSolution, block: usize) -> MarkerSolution {
        let member = self.members[block];
        let Some(first) = member.flight else { return solution };
        let residuals = &self.fit.groups[self.group].blocks[block].residuals;
        let all = quality::observation_reliability(
            self.problem,
            self.fit,
            self.group,
            block,
            self.input.options.snooping_alpha,
        );
        let (u, v) = (all[first], all[first + 1]);
        let bias = |r: &Reliability| r.minimal_detectable_bias.unwrap_or(f64::INFINITY);
        solution.residual_px = Some(Vector2::new(residuals[first], residuals[first + 1]));
        solution.redundancy = Some(Vector2::new(u.redundancy, v.redundancy));
        solution.w_test = all.iter().filter_map(|r| r.w).reduce(|a, b| if b.abs() > a.abs() { b } else { a });
        solution.minimal_detectable_bias_px = Some(Vector2::new(bias(&u), bias(&v)));
        solution.minimal_detectable_bias_m = (self.layout.survey == Survey::Observed).then(|| {
            // Along the survey's axes: a bias there is one in two or three wing coordinates.
            Vector3::new(bias(&all[0]), bias(&all[1]), bias(&all[2]))
        });
        solution
    }

    /// Torsion of every pair.
    fn torsion(&self) -> Vec<Torsion> {
        let one = |pair: &TorsionPair| Torsion {
            name: pair.name.clone(),
            angle_rad: self.angle(pair),
            twist_rad: self.section_twist(pair),
        };
        self.input.setup.torsion.iter().map(one).collect()
    }

    /// From the deflections of the two markers (paper, section 4.3).
    fn angle(&self, pair: &TorsionPair) -> Option<Estimate> {
        let blocks = [self.block_of(pair.leading)?, self.block_of(pair.trailing)?];
        let markers = &self.input.setup.markers;
        let apart = markers[pair.leading].position_m - markers[pair.trailing].position_m;
        let base = apart.xy().norm();
        let mut gradient = self.gradient(1, &[pair.leading, pair.trailing]);
        let mut difference = 0.0;
        for (block, sign) in blocks.into_iter().zip([1.0, -1.0]) {
            let (ground, state) = self.state(block);
            difference += sign * (state.carried.position_m.y - ground.y);
            let up = Vector3::y() * sign;
            self.add(&mut gradient, block, &state, &[up], &[-up]);
        }
        let by_difference = base / (base * base + difference * difference);
        let sigma = self.sigmas(&gradient).first().map(|s| s * by_difference);
        Some(Estimate { value: difference.atan2(base), sigma })
    }

    /// Rotation of the section half-way between the two stations.
    fn section_twist(&self, pair: &TorsionPair) -> Option<Estimate> {
        let station = |m: usize| self.input.scene.ground.stations.get(m).map(|s| s.arc_m);
        let arc = 0.5 * (station(pair.leading)? + station(pair.trailing)?);
        let grid = Grid::new(&self.input.scene.ground, &[arc]);
        let section = grid.bend(&self.values.bending()).pop()?;
        let mut gradient = self.gradient(1, &[]);
        for (placed, k) in self.layout.unknowns() {
            self.layout.put(&mut gradient, placed.place, k, 0, placed.term.twist(k, &section));
        }
        Some(Estimate { value: section.twist_rad, sigma: self.sigmas(&gradient).first().copied() })
    }

    /// Deflection of the axis and twist from the root to the outermost marker, and `a_per_m` fitted to it.
    fn curve(&self) -> (Vec<CurvePoint>, Gradient, f64) {
        let curve = Curve::new(self.input.scene, &self.values);
        let deflections_m = curve.deflections_m();
        let count = deflections_m.len();
        let gradient = self.along(&curve);
        let mut by_deflection = DVector::zeros(2 * count);
        let (mut moment, mut fourth) = (0.0, 0.0);
        for (k, (section, deflection_m)) in curve.bent.iter().zip(&deflections_m).enumerate() {
            let x2 = (section.axis_m.x - curve.root_m.x).powi(2);
            by_deflection[k] = x2;
            moment += deflection_m * x2;
            fourth += x2 * x2;
        }
        by_deflection /= fourth;
        let sigmas = self.sigmas(&gradient);
        let sigma = |k: usize| sigmas.get(k).copied();
        // Which way is nose up hangs on it.
        let side = self.input.setup.side();
        let point = |k: usize| CurvePoint {
            arc_length_m: curve.arcs_m[k],
            span_m: curve.bent[k].axis_m.x,
            deflection_m: Estimate { value: deflections_m[k], sigma: sigma(k) },
            twist_rad: side.map(|_| Estimate { value: curve.bent[k].twist_rad, sigma: sigma(count + k) }),
        };
        let parabola = Gradient {
            global: DMatrix::from_columns(&[&gradient.global * &by_deflection]),
            local: DMatrix::from_columns(&[&gradient.local * &by_deflection]),
            ..gradient
        };
        ((0..count).map(point).collect(), parabola, moment / fourth)
    }

    /// Deflections, then twists, of the curve's points.
    fn along(&self, curve: &Curve) -> Gradient {
        let count = curve.bent.len();
        let mut gradient = self.gradient(2 * count, &[]);
        for (placed, k) in self.layout.unknowns() {
            let mut put = |function, by| self.layout.put(&mut gradient, placed.place, k, function, by);
            placed.term.deflections(k, curve).into_iter().enumerate().for_each(|(at, by)| put(at, by));
            let twists = curve.bent.iter().map(|section| placed.term.twist(k, section));
            twists.enumerate().for_each(|(at, by)| put(count + at, by));
        }
        gradient
    }

    /// How much higher the bending axis lies than stated, mean along the span, m.
    fn axis_raise(&self) -> Parameter {
        let mut gradient = self.gradient(1, &[]);
        let mean = |j: usize| 1.0 / (j + 1) as f64;
        (0..RAISE_TERMS).for_each(|j| self.layout.put(&mut gradient, self.layout.axis_height, j, 0, mean(j)));
        let value = self.values.raise_m.iter().enumerate().map(|(j, raise)| mean(j) * raise).sum();
        let sigma = self.sigmas(&gradient).first().copied();
        Parameter { name: "axis_raise_m", values: vec![Estimate { value, sigma }] }
    }

    /// Parameters, their correlation, and the correlation of the mount's pitch with bending.
    fn parameters(&self, parabola: &Gradient, a: f64) -> (Vec<Parameter>, DMatrix<f64>, Option<f64>) {
        let (n, t) = (self.layout.curvature_terms, self.layout.twist_terms);
        let count = n + t + 4;
        // One row more for pitch, which is not among the results' parameters.
        let mut gradient = self.gradient(count + 1, &[]);
        for k in 0..n {
            self.layout.put(&mut gradient, self.layout.curvature, k, k, 1.0);
        }
        for k in 0..t {
            self.layout.put(&mut gradient, self.layout.twist, k, n + k, 1.0);
        }
        let pitch_axis = self.input.scene.camera_from_wing * Vector3::z();
        for (place, k) in self.layout.rotation.iter().flat_map(|place| (0..3).map(move |k| (*place, k))) {
            self.layout.put(&mut gradient, place, k, n + t + k, 1.0);
            self.layout.put(&mut gradient, place, k, count, pitch_axis[k]);
        }
        gradient.global.column_mut(count - 1).copy_from(&parabola.global.column(0));
        gradient.local.column_mut(count - 1).copy_from(&parabola.local.column(0));
        let covariance = self.covariance(&gradient);
        let sigma = |k: usize| covariance[(k, k)].max(0.0).sqrt();
        let correlation =
            DMatrix::from_fn(count + 1, count + 1, |i, j| covariance[(i, j)] / (sigma(i) * sigma(j)));
        let list = |values: &[f64], first: usize| {
            let one = |(k, &value): (usize, &f64)| Estimate { value, sigma: Some(sigma(first + k)) };
            values.iter().enumerate().map(one).collect()
        };
        let v = &self.values;
        let twist =
            self.input.setup.side().map_or(vec![], |_| list(&v.twist_rad[..t.min(v.twist_rad.len())], n));
        let parameters = vec![
            Parameter { name: "curvature_per_m", values: list(&v.curvature_per_m, 0) },
            Parameter { name: "twist_rad", values: twist },
            Parameter { name: "mount_rotation_rad", values: list(v.pose.mount_rad.as_slice(), n + t) },
            Parameter { name: "a_per_m", values: list(&[a], count - 1) },
        ];
        let pitch = Some(correlation[(count, count - 1)]).filter(|c| c.is_finite());
        (parameters, correlation.view((0, 0), (count, count)).into_owned(), pitch)
    }
}
