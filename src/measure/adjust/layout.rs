//! Where each unknown of a frame stands, and a marker's conditions written into it.

use nalgebra::{DVector, Matrix2x3, Matrix3, Vector2, Vector3};

use super::AdjustError;
use super::gauss_helmert::{Gradient, Linearised, Prior};
use super::marker_state::MarkerState;
use super::scene::{Bent, Camera, Predicted, Scene};
use super::term::{Place, Placed, Sight};
use super::values::Values;

/// Where the markers' positions on ground stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Survey {
    /// The first three observations of the marker's block.
    Observed,
    /// Global parameters, three per marker, from this column to the last.
    Global(usize),
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
    pub curvature: Place,
    /// Their number.
    pub curvature_terms: usize,
    /// Coefficients of the twist, which are reported.
    pub twist: Place,
    /// Their number.
    pub twist_terms: usize,
    /// Parts of the camera's rotation, which is reported: a flight's frames have one in common and one of their own.
    pub rotation: Vec<Place>,
    /// Height of the bending axis, which is reported.
    pub axis_height: Place,
    /// Expected thermal scale.
    pub expected_scale: f64,
    /// The markers on ground.
    pub survey: Survey,
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
        let mut values = Values::expected(self.expected_scale);
        self.terms.iter().for_each(|placed| placed.enter(global, local, &mut values));
        values
    }

    /// What is known beforehand of the local parameters.
    pub fn local_priors(&self) -> Vec<Prior> {
        let of = |placed: &Placed| match placed.place {
            Place::Local(first) => placed.term.priors().into_iter().map(|p| p.moved(first)).collect(),
            Place::Global(_) => vec![],
        };
        self.terms.iter().flat_map(of).collect()
    }

    /// The ground frame's part of it, which knows neither bending nor mounting.
    pub fn on_ground_only(&self) -> Self {
        let shared = |placed: &&Placed| matches!(placed.place, Place::Global(first) if first < self.head);
        Self {
            terms: self.terms.iter().filter(shared).cloned().collect(),
            own: Own { first: 0, count: 0 },
            local: 0,
            rotation: vec![],
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

    /// Column of an unknown among [`Layout::columns`].
    fn column(&self, first: usize) -> usize {
        if first < self.head { first } else { self.head + first - self.own.first }
    }

    /// Global columns of conditions on markers: all of the head, the mounting's, three of each marker.
    pub fn columns(&self, markers: &[usize]) -> Vec<usize> {
        let own = markers.iter().flat_map(|marker| match self.survey {
            Survey::Observed => 0..0,
            Survey::Global(first) => first + 3 * marker..first + 3 * marker + 3,
        });
        (0..self.head).chain(self.own.first..self.own.first + self.own.count).chain(own).collect()
    }

    /// First of the columns of the first marker among [`Layout::columns`].
    pub fn survey_column(&self) -> usize {
        self.head + self.own.count
    }

    /// Adds `value` to the derivative of a function by an unknown; the gradient's columns are
    /// [`Layout::columns`].
    pub fn put(&self, gradient: &mut Gradient, place: Place, k: usize, function: usize, value: f64) {
        match place {
            Place::Global(first) => gradient.global[(self.column(first) + k, function)] += value,
            Place::Local(first) => gradient.local[(first + k, function)] += value,
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
        self.terms.iter().flat_map(|placed| (0..placed.term.size()).map(move |k| (placed, k)))
    }
}

/// A block's conditions under construction.
pub struct Rows<'a> {
    layout: &'a Layout,
    out: &'a mut Linearised,
}

impl<'a> Rows<'a> {
    /// Block `index` of a group's list, where it may stand from another point; else it is new:
    /// `conditions` rows over `observations` columns, all zero.
    pub fn new(
        layout: &'a Layout,
        (blocks, index): (&'a mut Vec<Linearised>, usize),
        marker: usize,
        conditions: usize,
        observations: usize,
    ) -> Self {
        if index == blocks.len() {
            blocks.push(Linearised::empty(conditions, layout.columns(&[marker]), layout.local, observations));
        }
        Self { layout, out: &mut blocks[index] }
    }

    fn put(&mut self, place: Place, row: usize, k: usize, v: Vector2<f64>) {
        let (target, column) = match place {
            Place::Global(first) => (&mut self.out.global, self.layout.column(first) + k),
            Place::Local(first) => (&mut self.out.local, first + k),
        };
        let first = column * target.nrows() + row;
        target.as_mut_slice()[first..first + 2].copy_from_slice(v.as_slice());
    }

    /// Derivative to the marker's place on ground.
    fn put_survey(&mut self, row: usize, m: &Matrix2x3<f64>) {
        match self.layout.survey {
            Survey::Observed => self.out.observations.fixed_view_mut::<2, 3>(row, 0).copy_from(m),
            Survey::Global(_) => {
                self.out.global.fixed_view_mut::<2, 3>(row, self.layout.survey_column()).copy_from(m)
            }
        }
    }

    fn put_pixel(&mut self, row: usize, observation: usize, predicted: &Predicted, observed: &DVector<f64>) {
        for k in 0..2 {
            self.out.misclosure[row + k] = predicted.pixel[k] - observed[observation + k];
            self.out.observations[(row + k, observation + k)] = -1.0;
        }
    }

    /// Two conditions: the image of a marker in flight.
    pub fn flight(
        &mut self,
        row: usize,
        seen: &Seen,
        scene: &Scene,
        camera: &Camera,
    ) -> Result<(), AdjustError> {
        let (bending, estimated) = (seen.values.bending(), &seen.values.estimated);
        let state = scene.marker(seen.marker, seen.bent, &seen.ground_m, &bending, estimated);
        let predicted = scene.project(&state.carried.position_m, camera).ok_or_else(behind)?;
        self.put_pixel(row, seen.observation, &predicted, seen.observed);
        let sight = Sight { state: &state, predicted: &predicted };
        let layout = self.layout;
        for (placed, k) in layout.unknowns() {
            self.put(placed.place, row, k, placed.term.in_flight(k, &sight));
        }
        self.put_survey(row, &(predicted.by_point * state.carried.by_ground));
        Ok(())
    }

    /// Two conditions: the image of a marker on ground.
    pub fn ground(
        &mut self,
        row: usize,
        seen: &Seen,
        scene: &Scene,
        camera: &Camera,
    ) -> Result<(), AdjustError> {
        let predicted = scene.project(&seen.ground_m, camera).ok_or_else(behind)?;
        self.put_pixel(row, seen.observation, &predicted, seen.observed);
        let layout = self.layout;
        for (placed, k) in layout.unknowns() {
            self.put(placed.place, row, k, placed.term.on_ground(k, &predicted));
        }
        self.put_survey(row, &predicted.by_point);
        Ok(())
    }

    /// Three conditions: a surveyed position (first three observations) is the parameter.
    pub fn surveyed(&mut self, row: usize, ground_m: &Vector3<f64>, observed: &DVector<f64>) {
        let identity = Matrix3::identity();
        for k in 0..3 {
            self.out.misclosure[row + k] = ground_m[k] - observed[k];
        }
        self.out.observations.fixed_view_mut::<3, 3>(row, 0).copy_from(&-identity);
        self.out.global.fixed_view_mut::<3, 3>(row, self.layout.survey_column()).copy_from(&identity);
    }
}

/// One marker's observation at a point of the iteration.
pub struct Seen<'a> {
    /// Index in the survey.
    pub marker: usize,
    /// The wing in flight.
    pub bent: &'a Bent,
    /// The frame's unknowns.
    pub values: &'a Values,
    /// Its place on ground, wing frame, m.
    pub ground_m: Vector3<f64>,
    /// The block's adjusted observations.
    pub observed: &'a DVector<f64>,
    /// First of the pixel's two among them.
    pub observation: usize,
}

fn behind() -> AdjustError {
    AdjustError::Input(
        "a marker comes to lie behind the camera; check projection_centre_m, span_direction and orientation.toml".into(),
    )
}
