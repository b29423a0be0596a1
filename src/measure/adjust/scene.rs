//! From unknowns to pixels: the observation equation of the spatial methods with all derivatives.

use nalgebra::{Matrix2x3, Matrix3, Rotation3, SMatrix, Vector2, Vector3};

use super::beam::{Bending, Grid, Mount, Section};
use super::estimated::Neighbour;
use super::ground::GroundShape;
use super::marker_state::{Answers, ESTIMATED, MarkerState};
use super::values::{Pose, Values};
use super::{AdjustError, Observation};
use crate::environment::Plate;
use crate::geometry::{BROWN, Lens, left_jacobian, cross_matrix};
use crate::setup::{Orientation, Setup};

/// Difference for the derivative by the bow, in which the image is linear to 1e-3 of its effect.
const BOW_STEP: f64 = 1e-3;

/// Everything about an installation that no adjustment changes.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The wing as surveyed.
    pub ground: GroundShape,
    /// The beam at the markers' stations.
    pub grid: Grid,
    /// How each marker sits on its section.
    pub mounts: Vec<Mount>,
    /// Which markers are rigid to the cabin.
    fixed: Vec<bool>,
    /// Wings that differ in what the user can only estimate; `None` for what is held.
    pub neighbours: [Option<Neighbour>; ESTIMATED],
    /// Sights of the ground frames, per marker of the survey.
    pub ground_sights: Vec<Option<Observation>>,
    lens: Lens,
    /// On ground, before corrections.
    pub camera_from_wing: Matrix3<f64>,
    /// The window's panes in flight and on ground, wing frame.
    panes: [Option<Plate>; 2],
}

/// A pose, prepared for many points.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    lens: Lens,
    centre_m: Vector3<f64>,
    mount: Matrix3<f64>,
    camera_from_wing: Matrix3<f64>,
    mount_jacobian: Matrix3<f64>,
    ground_jacobian: Matrix3<f64>,
    /// What it looks through, camera frame.
    pane: Option<Plate>,
    /// What its bow is more than stated, a share of the curvature.
    bow: f64,
    /// Whether pressure bows it.
    bows: bool,
    /// Camera constants over those on ground.
    scale: f64,
}

impl Camera {
    /// Where a point of the camera frame is seen, m, with the derivatives by its place and by the bow.
    fn seen(&self, point_m: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>, Vector3<f64>) {
        let Some(stated) = self.pane else { return (*point_m, Matrix3::identity(), Vector3::zeros()) };
        let (seen, by_place) = stated.with_bow_change(self.bow).apparent_with_jacobian(point_m);
        let more = || stated.with_bow_change(self.bow + BOW_STEP).apparent_point(point_m);
        let by_bow = if self.bows { (more() - seen) / BOW_STEP } else { Vector3::zeros() };
        (seen, by_place, by_bow)
    }
}

/// A predicted pixel with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predicted {
    /// px.
    pub pixel: Vector2<f64>,
    /// d pixel / d point, wing frame, px/m.
    pub by_point: Matrix2x3<f64>,
    /// d pixel / d share of the bow's curvature, px; 0 where that is known.
    pub by_bow: Vector2<f64>,
    /// d pixel / d mounting rotation, px/rad.
    pub by_mount: Matrix2x3<f64>,
    /// d pixel / d ground rotation, px/rad.
    pub by_ground_rotation: Matrix2x3<f64>,
    /// d pixel / d interior orientation, in the order of [`Lens::PARAMETERS`].
    pub by_lens: SMatrix<f64, 2, BROWN>,
    /// d pixel / d share by which both camera constants are larger, px.
    pub by_scale: Vector2<f64>,
}

/// The wing bent, and its neighbours bent alike: sections at the markers' stations.
#[derive(Clone, Debug, PartialEq)]
pub struct Bent {
    sections: Vec<Section>,
    neighbours: [Vec<Section>; ESTIMATED],
}

impl Scene {
    /// Prepares an installation.
    pub fn new(setup: &Setup, orientation: &Orientation) -> Result<Self, AdjustError> {
        let trusted = trusted(setup, orientation);
        let ground = GroundShape::new(setup, &trusted)?;
        let neighbours = Neighbour::all(setup, &trusted)?;
        let arcs: Vec<f64> = ground.stations.iter().map(|s| s.arc_m).collect();
        let grid = Grid::new(&ground, &arcs);
        let mounts = grid.mounts(&ground.stations);
        let mut ground_sights = vec![None; setup.markers.len()];
        for s in &orientation.ground {
            if let Some(slot) = ground_sights.get_mut(s.marker) {
                *slot =
                    Some(Observation { marker: s.marker, pixel: s.pixel, covariance_px2: s.covariance_px2 });
            }
        }
        // Two or three sights fix the rotation without a check; the stated rotation is better then.
        if ground_sights.iter().flatten().count() < 4 {
            ground_sights.fill(None);
        }
        let wing_from_survey = ground.frame.wing_from_survey.matrix();
        let camera_from_wing = orientation.camera_from_survey.matrix() * wing_from_survey.transpose();
        let panes = [true, false]
            .map(|flight| Plate::from_window(setup.window.as_ref(), &ground.frame.wing_from_survey, flight));
        Ok(Self {
            ground,
            grid,
            mounts,
            fixed: setup.markers.iter().map(|m| m.fixed).collect(),
            neighbours,
            ground_sights,
            lens: setup.lens,
            camera_from_wing,
            panes,
        })
    }

    /// Whether the ground frame's sights take part.
    pub fn has_ground_sights(&self) -> bool {
        self.ground_sights.iter().any(Option::is_some)
    }

    /// What the description of the panes leaves unknown of the projection centre in flight against that on
    /// ground, wing frame, m^2; `None` where ground and flight are seen alike.
    pub fn window_covariance_m2(&self) -> Option<Matrix3<f64>> {
        let axis = self.camera_from_wing.transpose() * Vector3::z();
        let [flight, ground] = &self.panes;
        flight.filter(|_| ground.is_none()).map(|pane| pane.shift_covariance_m2(&axis))
    }

    /// Standard deviation of the bow's curvature as a share of it or of the usual one; `None` without panes.
    pub fn bow_sigma(&self) -> Option<f64> {
        self.panes[0].map(|plate| plate.pane.bow_sigma)
    }

    /// The camera at a pose in flight.
    pub fn camera(&self, pose: &Pose) -> Camera {
        Camera {
            bows: self.bow_sigma().is_some_and(|sigma| sigma > 0.0),
            ..self.behind(pose, self.panes[0].as_ref())
        }
    }

    /// The camera on ground, before it was remounted.
    pub fn ground_camera(&self, pose: &Pose) -> Camera {
        self.behind(&pose.on_ground(), self.panes[1].as_ref())
    }

    fn behind(&self, pose: &Pose, pane: Option<&Plate>) -> Camera {
        let ground_from_wing = Rotation3::new(pose.ground_rad).matrix() * self.camera_from_wing;
        let mount = *Rotation3::new(pose.mount_rad).matrix();
        let camera_from_wing = mount * ground_from_wing;
        Camera {
            lens: self.lens.with_changes(&pose.lens).with_flight_change(pose.flight_scale, &pose.flight_principal_px),
            centre_m: pose.centre_m + pose.shift_m + pose.window_m,
            mount,
            camera_from_wing,
            mount_jacobian: left_jacobian(&pose.mount_rad),
            ground_jacobian: left_jacobian(&pose.ground_rad),
            pane: pane.map(|pane| pane.rotated(&camera_from_wing)),
            bow: pose.bow,
            bows: false,
            scale: 1.0 + pose.flight_scale,
        }
    }

    /// The pixel of a point (wing frame, m); `None` behind the camera.
    pub fn project(&self, point_m: &Vector3<f64>, camera: &Camera) -> Option<Predicted> {
        let in_camera = camera.camera_from_wing * (point_m - camera.centre_m);
        let (seen, by_place, by_bow) = camera.seen(&in_camera);
        let (pixel, by_seen) = camera.lens.project_with_jacobian(&seen)?;
        // Panes and point turn together, so what is seen turns with them.
        let before_mount = camera.mount.transpose() * seen;
        let turned = by_seen * camera.mount;
        let Lens { cx, cy, .. } = camera.lens;
        let mut by_lens = camera.lens.parameter_jacobian(&seen);
        (0..2).for_each(|k| by_lens[(k, k)] *= camera.scale);
        Some(Predicted {
            pixel,
            by_point: by_seen * by_place * camera.camera_from_wing,
            by_bow: by_seen * by_bow,
            by_mount: -(by_seen * cross_matrix(&seen)) * camera.mount_jacobian,
            by_ground_rotation: -(turned * cross_matrix(&before_mount)) * camera.ground_jacobian,
            by_lens,
            by_scale: (pixel - Vector2::new(cx, cy)) / camera.scale,
        })
    }

    /// The wing and its neighbours, bent.
    pub fn bend(&self, bending: &Bending) -> Bent {
        let neighbours = [0, 1, 2].map(|k| self.neighbours[k].as_ref().map_or(vec![], |n| n.bend(bending)));
        Bent { sections: self.grid.bend(bending), neighbours }
    }

    /// Whether a marker is rigid to the cabin.
    pub fn is_fixed(&self, marker: usize) -> bool {
        self.fixed.get(marker).copied().unwrap_or(false)
    }

    /// A marker in flight with all that moves it there. `ground_m`: its place on ground, moved by its own motion in
    /// flight, wing frame, m.
    pub fn in_flight(
        &self,
        marker: usize,
        bent: &Bent,
        ground_m: &Vector3<f64>,
        values: &Values,
    ) -> MarkerState {
        let bending = values.bending();
        let nominal = self.on_beam(marker, &bent.sections[marker], ground_m, &bending);
        let mut state = nominal;
        match &values.answers {
            Some(answers) => state.answer(&answers[marker], &values.estimated),
            None => state = self.estimated(nominal, bent, ground_m, &bending, &values.estimated),
        }
        if let Some((turn_rad, from_root_m)) = values.plane_rad.zip(nominal.from_root_m) {
            let root_m = nominal.carried.position_m - from_root_m;
            let there_m = ground_m + Vector3::x().cross(&(ground_m - root_m));
            state.lean(turn_rad, &nominal, &self.on_beam(marker, &bent.sections[marker], &there_m, &bending));
        }
        state.carry_with_root(&values.root_rotation_rad, &values.root_translation_m);
        state.carried.position_m += moved(&values.moved_m, marker);
        state
    }

    /// A frame's wing: with its neighbours, unless it is taken for granted how markers answer to these.
    pub fn bent(&self, values: &Values) -> Bent {
        match values.answers {
            Some(_) => Bent { sections: self.grid.bend(&values.bending()), neighbours: Default::default() },
            None => self.bend(&values.bending()),
        }
    }

    /// How markers answer in a wing that bends so to what the user can only estimate.
    pub fn answers(&self, bending: &Bending) -> Answers {
        let bent = self.bend(bending);
        let stations = self.ground.stations.iter().enumerate();
        stations
            .map(|(k, s)| self.marker(k, &bent, &s.surveyed_m, bending, &[0.0; ESTIMATED]).by_estimated)
            .collect()
    }

    /// A marker on the wing as it is stated.
    fn on_beam(
        &self,
        index: usize,
        section: &Section,
        ground_m: &Vector3<f64>,
        bending: &Bending,
    ) -> MarkerState {
        let state = match self.fixed[index] {
            true => MarkerState::fixed(ground_m),
            false => MarkerState::of(&self.grid, &self.mounts[index], section, ground_m, bending),
        };
        MarkerState { marker: index, ..state }
    }

    /// Carries a marker from its place on ground (wing frame, m) into flight. `estimated`: by how much what
    /// the user can only estimate differs from what is stated.
    pub fn marker(
        &self,
        index: usize,
        bent: &Bent,
        ground_m: &Vector3<f64>,
        bending: &Bending,
        estimated: &[f64; ESTIMATED],
    ) -> MarkerState {
        let nominal = self.on_beam(index, &bent.sections[index], ground_m, bending);
        self.estimated(nominal, bent, ground_m, bending, estimated)
    }

    /// Moves a marker on the wing as it is stated to the wing that differs from it by so much.
    fn estimated(
        &self,
        nominal: MarkerState,
        bent: &Bent,
        ground_m: &Vector3<f64>,
        bending: &Bending,
        estimated: &[f64; ESTIMATED],
    ) -> MarkerState {
        let index = nominal.marker;
        let mut state = nominal;
        if self.fixed[index] {
            return state;
        }
        for (k, (neighbour, off)) in self.neighbours.iter().zip(estimated).enumerate() {
            let Some(neighbour) = neighbour else { continue };
            let other = neighbour.marker(index, &bent.neighbours[k][index], ground_m, bending);
            state.by_estimated[k] = (other.carried.position_m - nominal.carried.position_m) / neighbour.step;
            state.towards(&nominal, &other, off / neighbour.step);
        }
        let estimated_m = state.carried.position_m - nominal.carried.position_m;
        state.from_root_m = nominal.from_root_m.map(|from| from + estimated_m);
        state
    }
}

/// A marker's own among displacements, of which those that are not there are 0, m.
pub fn moved(displacements_m: &[Vector3<f64>], marker: usize) -> Vector3<f64> {
    displacements_m.get(marker).copied().unwrap_or_else(Vector3::zeros)
}

/// A sight on ground that lies farther from where the survey puts its marker, in standard deviations,
/// speaks against the survey: one in a million by chance.
const TRUSTED: f64 = 5.0;

/// Whether each surveyed point has a sight on ground and agrees with it. Where most do not agree,
/// the orientation is at fault and tells nothing of single points.
fn trusted(setup: &Setup, orientation: &Orientation) -> Vec<bool> {
    let may_shape = orientation.may_shape(setup.markers.len());
    let mut trusted = vec![true; setup.markers.len()];
    for sight in &orientation.ground {
        let Some(marker) = setup.markers.get(sight.marker) else { continue };
        let seen = orientation.camera_from_survey * (marker.position_m - setup.projection_centre_m);
        let Some(pixel) = setup.lens.project(&seen) else { continue };
        let survey = marker.sigma_m.hypot(setup.projection_centre_sigma_m);
        let survey_px = setup.lens.focal_px() * survey / seen.norm().max(1e-3);
        let off = pixel - sight.pixel;
        trusted[sight.marker] = (0..2)
            .all(|k| off[k].abs() <= TRUSTED * sight.covariance_px2[(k, k)].max(0.0).sqrt().hypot(survey_px));
    }
    if 2 * trusted.iter().filter(|t| !**t).count() > orientation.ground.len() {
        trusted.fill(true);
    }
    trusted.into_iter().zip(may_shape).map(|(agrees, seen)| agrees && seen).collect()
}

#[cfg(test)]
mod tests;
