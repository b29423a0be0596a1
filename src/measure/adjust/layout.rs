//! Where each unknown of a frame stands, and a marker's conditions written into it.

use std::sync::Arc;

use nalgebra::{DVector, Matrix2x3, Matrix3, Vector2, Vector3};

use super::factors::Factors;
use super::flight_prior::{MARKS, SKIN};
use super::input::{Input, Sights};
use super::marker_state::{Answers, MarkerState};
use super::scene::{Bent, Camera, Scene, moved};
use super::term::{Columns, ParameterScope, Placed, Term};
use super::terms;
use super::values::Values;
use crate::estimation::{EstimationError, Gradient, GroupPoint, Linearised, Prior};

/// Where the markers' positions on ground stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Survey {
    /// The first three observations of the marker's block.
    Observed,
    /// Global parameters, three per marker, from this column to the last.
    Global(usize),
}

/// How markers may move in flight by themselves, each along its own directions: the skin along its normal, a fixed mark
/// along all axes. An unknown for each, the same in all frames.
#[derive(Debug)]
pub struct Motions {
    /// Column of the first.
    first: usize,
    /// Per marker: directions on ground, wing frame, and where its unknowns begin among them.
    of: Vec<(Vec<Vector3<f64>>, usize)>,
}

const MISSING_MOTION: &str = "a marker's motion in flight is not determined";

impl Motions {
    /// Takes columns for them, with what is known beforehand.
    pub fn place(input: &Input, factors: &Factors, columns: &mut Columns) -> Self {
        let width = &input.setup.uncertainty.in_flight;
        let axis = &input.scene.ground.axis;
        let first = columns.missing.len();
        let mut of = vec![];
        for (marker, station) in input.setup.markers.iter().zip(&input.scene.ground.stations) {
            let (name, sigma_m, directions) = if marker.fixed {
                let all = vec![Vector3::x(), Vector3::y(), Vector3::z()];
                (MARKS, factors.marks * marker.flight_motion_m, all)
            } else {
                (SKIN, factors.skin * width.skin_motion_m, vec![axis.normal(station.arc_m)])
            };
            let directions = if sigma_m > 0.0 { directions } else { vec![] };
            let own = columns.take(directions.len(), MISSING_MOTION);
            let prior = |k| Prior::scalar(name, own + k, 0.0, sigma_m);
            columns.priors.extend((0..directions.len()).map(prior));
            of.push((directions, own - first));
        }
        Self { first, of }
    }

    /// A marker's columns.
    pub fn columns(&self, marker: usize) -> std::ops::Range<usize> {
        let (directions, own) = &self.of[marker];
        self.first + own..self.first + own + directions.len()
    }

    /// Its directions.
    pub fn directions(&self, marker: usize) -> &[Vector3<f64>] {
        &self.of[marker].0
    }
}

/// A frame's own global parameters behind the head: those of its mounting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Own {
    /// Its first column.
    pub first: usize,
    /// Their number.
    pub count: usize,
}

/// The unknowns of one frame.
#[derive(Clone, Debug)]
pub struct Layout {
    /// All of them but the markers' positions on ground.
    pub terms: Vec<Placed>,
    /// Coefficients of the curvature, which are reported.
    pub curvature: ParameterScope,
    /// Their number.
    pub curvature_terms: usize,
    /// Coefficients of the twist, which are reported.
    pub twist: ParameterScope,
    /// Their number.
    pub twist_terms: usize,
    /// Parts of the camera's rotation, which is reported: a flight's frames have one in common and one of their own.
    pub rotation: Vec<ParameterScope>,
    /// Height of the bending axis, which is reported.
    pub axis_height: ParameterScope,
    /// Expected thermal scale.
    pub expected_scale: f64,
    /// The markers on ground.
    pub survey: Survey,
    /// How each marker may move in flight by itself.
    pub motions: Arc<Motions>,
    /// How markers answer to what the user can only estimate, where a frame's own noise is to be kept out of it.
    pub answers: Option<Arc<Answers>>,
    /// The root's motion, without which a deflection is counted from the root's tangent.
    pub root: Vec<Placed>,
    /// Number of leading global parameters that all blocks depend on.
    pub head: usize,
    /// The mounting's.
    pub own: Own,
    /// Number of local parameters.
    pub local: usize,
}

impl Layout {
    /// Reads a frame's unknowns.
    pub fn values(&self, global: &DVector<f64>, local: &DVector<f64>) -> Values {
        let mut values = Values { answers: self.answers.clone(), ..Values::expected(self.expected_scale) };
        self.terms.iter().for_each(|placed| placed.enter(global, local, &mut values));
        values
    }

    /// What is known beforehand of the local parameters.
    pub fn local_priors(&self) -> Vec<Prior> {
        let of = |placed: &Placed| match placed.place {
            ParameterScope::Local(first) => {
                placed.term.priors.iter().map(|p| p.clone().shift_columns(first)).collect()
            }
            ParameterScope::Global(_) => vec![],
        };
        self.terms.iter().flat_map(of).collect()
    }

    /// A frame's own unknowns of this name: their columns and the standard deviations that they are 0 with.
    pub fn own_of<'s>(&'s self, name: &'s str) -> impl Iterator<Item = (usize, f64)> + 's {
        self.terms.iter().filter(move |placed| placed.term.name == name).flat_map(|placed| {
            let first = if let ParameterScope::Local(first) = placed.place { Some(first) } else { None };
            let sigma = |prior: &Prior| prior.covariance[(0, 0)].sqrt();
            let one = move |(k, prior)| first.map(|first| (first + k, sigma(prior)));
            placed.term.priors.iter().enumerate().filter_map(one)
        })
    }

    /// The same with the instants of the rows in which another frame shows its markers.
    pub fn with_rows(&self, input: &Input, sights: &Sights) -> Self {
        let rows = terms::of_rows(input, sights, &Factors::default());
        let of_name = |name: &str| rows.iter().find(|term| term.name == name).cloned();
        let terms = self.terms.iter().map(|placed| match of_name(placed.term.name) {
            Some(term) => Placed { term: Arc::new(term), place: placed.place },
            None => placed.clone(),
        });
        Self { terms: terms.collect(), ..self.clone() }
    }

    /// The ground frame's part of it, which knows neither bending nor mounting.
    pub fn on_ground_only(&self) -> Self {
        let shared =
            |placed: &&Placed| matches!(placed.place, ParameterScope::Global(first) if first < self.head);
        Self {
            terms: self.terms.iter().filter(shared).cloned().collect(),
            own: Own { first: 0, count: 0 },
            local: 0,
            rotation: vec![],
            motions: self.motions.clone(),
            root: vec![],
            answers: None,
            ..*self
        }
    }

    /// The marker's place on ground, wing frame, m.
    pub fn on_ground(&self, marker: usize, global: &DVector<f64>, observed: &DVector<f64>) -> Vector3<f64> {
        match self.survey {
            Survey::Observed => Vector3::new(observed[0], observed[1], observed[2]),
            Survey::Global(first) => {
                let c = first + 3 * marker;
                Vector3::new(global[c], global[c + 1], global[c + 2])
            }
        }
    }

    /// A marker's place on ground, moved by its own motion in flight, wing frame, m.
    pub fn with_motion(&self, marker: usize, ground_m: &Vector3<f64>, global: &DVector<f64>) -> Vector3<f64> {
        let columns = self.motions.columns(marker);
        let moved = self.motions.directions(marker).iter().zip(columns).map(|(d, c)| d * global[c]);
        ground_m + moved.sum::<Vector3<f64>>()
    }

    /// Column of an unknown among [`Layout::columns`].
    fn column(&self, first: usize) -> usize {
        if first < self.head { first } else { self.head + first - self.own.first }
    }

    /// Global columns of conditions on markers: all of the head, the mounting's, and of each marker its place on ground
    /// and its motion in flight.
    pub fn columns(&self, markers: &[usize]) -> Vec<usize> {
        let own = markers.iter().flat_map(|&marker| {
            let place = match self.survey {
                Survey::Observed => 0..0,
                Survey::Global(first) => first + 3 * marker..first + 3 * marker + 3,
            };
            place.chain(self.motions.columns(marker))
        });
        (0..self.head).chain(self.own.first..self.own.first + self.own.count).chain(own).collect()
    }

    /// First of the columns of the first marker among [`Layout::columns`].
    pub fn survey_column(&self) -> usize {
        self.head + self.own.count
    }

    /// Its motion's among them.
    fn motion_column(&self) -> usize {
        self.survey_column() + if self.survey == Survey::Observed { 0 } else { 3 }
    }

    /// Adds `value` to the derivative of a function by an unknown; the gradient's columns are
    /// [`Layout::columns`].
    pub fn put(&self, gradient: &mut Gradient, place: ParameterScope, k: usize, function: usize, value: f64) {
        match place {
            ParameterScope::Global(first) => gradient.global[(self.column(first) + k, function)] += value,
            ParameterScope::Local(first) => gradient.local[(first + k, function)] += value,
        }
    }

    /// Adds `directions * d(position in flight)`, a function for each direction.
    pub fn put_position(&self, gradient: &mut Gradient, state: &MarkerState, directions: &[Vector3<f64>]) {
        for (placed, k) in self.unknowns() {
            let by = placed.term.position(k, state);
            for (function, direction) in directions.iter().enumerate() {
                self.put(gradient, placed.place, k, function, direction.dot(&by));
            }
        }
    }

    /// Every unknown: its term and its column in that.
    pub fn unknowns(&self) -> impl Iterator<Item = (&Placed, usize)> {
        self.terms.iter().flat_map(|placed| (0..placed.term.size).map(move |k| (placed, k)))
    }
}

/// Which marker a block belongs to, and where its observations stand in the block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Member {
    /// Index in the survey.
    pub marker: usize,
    /// First of the two pixel coordinates in flight.
    pub flight: Option<usize>,
    /// First of the two pixel coordinates on ground.
    pub ground: Option<usize>,
}

/// The wing and the cameras that see it, at a point of the iteration.
struct Evaluated<'a> {
    scene: &'a Scene,
    values: Values,
    bent: Bent,
    in_flight: Camera,
    on_ground: Camera,
}

impl Layout {
    /// All blocks of a group at a point, a block for each member: where a position on ground is a parameter and the block
    /// holds the survey, three conditions for that; two for the image in flight; two for that on ground.
    pub fn linearise(
        &self,
        scene: &Scene,
        members: &[Member],
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), EstimationError> {
        let values = self.values(at.global, at.local);
        let frame = Evaluated {
            bent: scene.bent(&values),
            in_flight: scene.camera(&values.pose),
            on_ground: scene.ground_camera(&values.pose),
            scene,
            values,
        };
        for (index, (member, observed)) in members.iter().zip(at.observed).enumerate() {
            let surveyed = self.survey != Survey::Observed && member.flight.is_none();
            let images = usize::from(member.flight.is_some()) + usize::from(member.ground.is_some());
            if index == blocks.len() {
                let columns = self.columns(&[member.marker]);
                let conditions = 3 * usize::from(surveyed) + 2 * images;
                blocks.push(Linearised::empty(conditions, columns, self.local, observed.len()));
            }
            let ground_m = self.on_ground(member.marker, at.global, observed);
            let moved_m = self.with_motion(member.marker, &ground_m, at.global);
            let mut rows = Rows { layout: self, out: &mut blocks[index], observed, row: 0 };
            if surveyed {
                rows.surveyed(&ground_m);
            }
            rows.images(member, &ground_m, &moved_m, &frame)?;
        }
        Ok(())
    }
}

/// A block's conditions under construction; it may hold those of another point.
struct Rows<'a> {
    layout: &'a Layout,
    out: &'a mut Linearised,
    /// The block's adjusted observations.
    observed: &'a DVector<f64>,
    row: usize,
}

impl Rows<'_> {
    fn put(&mut self, place: ParameterScope, k: usize, v: Vector2<f64>) {
        let (target, column) = match place {
            ParameterScope::Global(first) => (&mut self.out.global, self.layout.column(first) + k),
            ParameterScope::Local(first) => (&mut self.out.local, first + k),
        };
        let first = column * target.nrows() + self.row;
        target.as_mut_slice()[first..first + 2].copy_from_slice(v.as_slice());
    }

    /// Two conditions: a pixel, its answers to the unknowns and to the marker's place on ground.
    fn image(
        &mut self,
        first: usize,
        pixel: &Vector2<f64>,
        by: impl Fn(&Term, usize) -> Vector2<f64>,
        by_ground: &Matrix2x3<f64>,
    ) {
        for k in 0..2 {
            self.out.misclosure[self.row + k] = pixel[k] - self.observed[first + k];
            self.out.observations[(self.row + k, first + k)] = -1.0;
        }
        let layout = self.layout;
        for (placed, k) in layout.unknowns() {
            self.put(placed.place, k, by(&placed.term, k));
        }
        let (target, column) = match layout.survey {
            Survey::Observed => (&mut self.out.observations, 0),
            Survey::Global(_) => (&mut self.out.global, layout.survey_column()),
        };
        target.fixed_view_mut::<2, 3>(self.row, column).copy_from(by_ground);
        self.row += 2;
    }

    /// Derivatives of the next two conditions by the marker's motion in flight.
    fn motion(&mut self, marker: usize, by_ground: &Matrix2x3<f64>) {
        let first = self.layout.motion_column();
        for (k, direction) in self.layout.motions.directions(marker).iter().enumerate() {
            self.out.global.fixed_view_mut::<2, 1>(self.row, first + k).copy_from(&(by_ground * direction));
        }
    }

    /// In flight, and on ground.
    fn images(
        &mut self,
        member: &Member,
        ground_m: &Vector3<f64>,
        moved_m: &Vector3<f64>,
        Evaluated { scene, values, bent, in_flight, on_ground }: &Evaluated,
    ) -> Result<(), EstimationError> {
        if let Some(first) = member.flight {
            let state = scene.in_flight(member.marker, bent, moved_m, values);
            let at_row_m = state.carried.position_m + moved(&values.moved_at_row_m, member.marker);
            let seen = scene.project(&at_row_m, in_flight).ok_or_else(behind)?;
            let by_ground = seen.by_point * state.carried.by_ground;
            self.motion(member.marker, &by_ground);
            self.image(first, &seen.pixel, |term, k| term.in_flight(k, &state, &seen), &by_ground);
        }
        if let Some(first) = member.ground {
            let there_m = ground_m + moved(&values.moved_on_ground_m, member.marker);
            let seen = scene.project(&there_m, on_ground).ok_or_else(behind)?;
            self.image(first, &seen.pixel, |term, k| term.on_ground(k, member.marker, &seen), &seen.by_point);
        }
        Ok(())
    }

    /// Three conditions: a surveyed position (first three observations) is the parameter.
    fn surveyed(&mut self, ground_m: &Vector3<f64>) {
        let identity = Matrix3::identity();
        for k in 0..3 {
            self.out.misclosure[k] = ground_m[k] - self.observed[k];
        }
        self.out.observations.fixed_view_mut::<3, 3>(0, 0).copy_from(&-identity);
        self.out.global.fixed_view_mut::<3, 3>(0, self.layout.survey_column()).copy_from(&identity);
        self.row = 3;
    }
}

fn behind() -> EstimationError {
    EstimationError::Input(
        "a marker comes to lie behind the camera; check projection_centre_m, span_direction and orientation.toml".into(),
    )
}
