//! Where each unknown of the spatial methods stands, and a marker's conditions written into it.

use nalgebra::{DVector, Matrix2x3, Matrix3, SVector, Vector2, Vector3};

use super::AdjustError;
use super::beam::{Bending, RAISE_TERMS};
use super::estimated::ESTIMATED;
use super::gauss_helmert::{Gradient, Linearised};
use super::scene::{Bent, Camera, MarkerState, Pose, Predicted, Scene};

/// First column of a set of unknowns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Among the global parameters.
    Global(usize),
    /// Among the group's local parameters.
    Local(usize),
}

/// Where the markers' positions on ground stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Survey {
    /// The first three observations of the marker's block.
    Observed,
    /// Global parameters, three per marker, from this column to the last.
    Global(usize),
}

/// The unknowns of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Coefficients of the curvature, 1/m.
    pub curvature: Place,
    /// Their number.
    pub curvature_terms: usize,
    /// Coefficients of the twist, rad.
    pub twist: Place,
    /// Their number.
    pub twist_terms: usize,
    /// Rotation of the mounting, rad.
    pub mount: Place,
    /// What counts on top of it: the part that a flight's frames have in common while each has a
    /// rotation of its own.
    pub common_mount: Option<Place>,
    /// Correction of the ground rotation, rad; `None`: held.
    pub ground: Option<Place>,
    /// Correction of the projection centre, m; `None`: held.
    pub centre: Option<Place>,
    /// Shift of the projection centre since the ground frame, m; `None`: none.
    pub shift: Option<Place>,
    /// Correction of the interior orientation, nine parameters; `None`: held.
    pub lens: Option<Place>,
    /// Corrections of what the user can only estimate; `None`: held.
    pub estimated: [Option<Place>; ESTIMATED],
    /// Correction of the panes' shift in flight, m; `None`: held.
    pub window: Option<Place>,
    /// Correction of the panes' bow, a share of its curvature; `None`: held.
    pub bow: Option<Place>,
    /// Thermal scale less its expected value; `None`: held.
    pub scale: Option<Place>,
    /// Height of the bending axis over the surveyed one, [`RAISE_TERMS`] coefficients, m.
    pub raise: Place,
    /// Expected thermal scale.
    pub nominal_scale: f64,
    /// The markers on ground.
    pub survey: Survey,
    /// Number of leading global parameters that all blocks depend on.
    pub head: usize,
    /// The frame's own global parameters behind the head, its mounting's: first and number.
    pub own: (usize, usize),
    /// Number of local parameters.
    pub local: usize,
}

/// A frame's unknowns, read from the vectors.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// 1/m.
    pub curvature_per_m: Vec<f64>,
    /// rad.
    pub twist_rad: Vec<f64>,
    /// Camera.
    pub pose: Pose,
    /// Length in flight over length on ground.
    pub scale: f64,
    /// Height of the bending axis over the surveyed one, coefficients, m.
    pub raise_m: [f64; RAISE_TERMS],
    /// Corrections of what the user can only estimate.
    pub estimated: [f64; ESTIMATED],
}

impl Values {
    /// What bends the wing.
    pub fn bending(&self) -> Bending<'_> {
        Bending {
            curvature_per_m: &self.curvature_per_m,
            twist_rad: &self.twist_rad,
            scale: self.scale,
            raise_m: self.raise_m,
        }
    }
}

impl Layout {
    /// Reads a frame's unknowns.
    pub fn values(&self, global: &DVector<f64>, local: &DVector<f64>) -> Values {
        let at = |place: Place, k: usize| match place {
            Place::Global(first) => global[first + k],
            Place::Local(first) => local[first + k],
        };
        let vector = |place: Option<Place>| {
            place.map_or(Vector3::zeros(), |p| Vector3::new(at(p, 0), at(p, 1), at(p, 2)))
        };
        Values {
            curvature_per_m: (0..self.curvature_terms).map(|k| at(self.curvature, k)).collect(),
            twist_rad: (0..self.twist_terms).map(|k| at(self.twist, k)).collect(),
            pose: Pose {
                mount_rad: vector(Some(self.mount)) + vector(self.common_mount),
                ground_rad: vector(self.ground),
                centre_m: vector(self.centre),
                shift_m: vector(self.shift),
                lens: self.lens.map_or(SVector::zeros(), |p| SVector::from_fn(|k, _| at(p, k))),
                window_m: vector(self.window),
                bow: self.bow.map_or(0.0, |p| at(p, 0)),
            },
            raise_m: std::array::from_fn(|j| at(self.raise, j)),
            estimated: self.estimated.map(|place| place.map_or(0.0, |p| at(p, 0))),
            scale: self.nominal_scale + self.scale.map_or(0.0, |p| at(p, 0)),
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
        if first < self.head { first } else { self.head + first - self.own.0 }
    }

    /// Global columns of conditions on markers: all of the head, the mounting's, three of each marker.
    pub fn columns(&self, markers: &[usize]) -> Vec<usize> {
        let own = markers.iter().flat_map(|marker| match self.survey {
            Survey::Observed => 0..0,
            Survey::Global(first) => first + 3 * marker..first + 3 * marker + 3,
        });
        (0..self.head).chain(self.own.0..self.own.0 + self.own.1).chain(own).collect()
    }

    /// First of the columns of the first marker among [`Layout::columns`].
    pub fn survey_column(&self) -> usize {
        self.head + self.own.1
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
        let mut put = |place: Place, k: usize, v: &Vector3<f64>| {
            for (function, direction) in directions.iter().enumerate() {
                self.put(gradient, place, k, function, direction.dot(v));
            }
        };
        for k in 0..self.curvature_terms {
            put(self.curvature, k, &state.by_curvature[k]);
        }
        for k in 0..self.twist_terms {
            put(self.twist, k, &state.by_twist[k]);
        }
        for j in 0..RAISE_TERMS {
            put(self.raise, j, &state.by_raise[j]);
        }
        if let Some(place) = self.scale {
            put(place, 0, &state.by_scale);
        }
        for (place, by) in self.estimated.iter().zip(&state.by_estimated) {
            place.iter().for_each(|p| put(*p, 0, by));
        }
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

    fn put(&mut self, place: Option<Place>, row: usize, k: usize, v: Vector2<f64>) {
        let (target, column) = match place {
            None => return,
            Some(Place::Global(first)) => (&mut self.out.global, self.layout.column(first) + k),
            Some(Place::Local(first)) => (&mut self.out.local, first + k),
        };
        let first = column * target.nrows() + row;
        target.as_mut_slice()[first..first + 2].copy_from_slice(v.as_slice());
    }

    fn put3(&mut self, place: Option<Place>, row: usize, m: &Matrix2x3<f64>) {
        for k in 0..3 {
            self.put(place, row, k, m.column(k).into_owned());
        }
    }

    fn put_lens(&mut self, row: usize, predicted: &Predicted) {
        for k in 0..9 {
            self.put(self.layout.lens, row, k, predicted.by_lens.column(k).into_owned());
        }
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
        let by = predicted.by_point;
        for k in 0..self.layout.curvature_terms {
            self.put(Some(self.layout.curvature), row, k, by * state.by_curvature[k]);
        }
        for k in 0..self.layout.twist_terms {
            self.put(Some(self.layout.twist), row, k, by * state.by_twist[k]);
        }
        self.put3(Some(self.layout.mount), row, &predicted.by_mount);
        self.put3(self.layout.common_mount, row, &predicted.by_mount);
        self.put3(self.layout.ground, row, &predicted.by_ground_rotation);
        self.put3(self.layout.centre, row, &-by);
        self.put3(self.layout.shift, row, &-by);
        self.put3(self.layout.window, row, &-by);
        self.put(self.layout.bow, row, 0, predicted.by_bow);
        self.put_lens(row, &predicted);
        for (place, by_estimated) in self.layout.estimated.into_iter().zip(&state.by_estimated) {
            self.put(place, row, 0, by * by_estimated);
        }
        for j in 0..RAISE_TERMS {
            self.put(Some(self.layout.raise), row, j, by * state.by_raise[j]);
        }
        self.put(self.layout.scale, row, 0, by * state.by_scale);
        self.put_survey(row, &(by * state.carried.by_ground));
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
        self.put3(self.layout.ground, row, &predicted.by_ground_rotation);
        self.put3(self.layout.centre, row, &-predicted.by_point);
        self.put_lens(row, &predicted);
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
