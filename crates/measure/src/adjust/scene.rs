//! Observation equation of the spatial methods: projects markers to pixels, with all derivatives.

use nalgebra::{Matrix2x3, Matrix3, Rotation3, SMatrix, Vector2, Vector3};

use super::beam::{BeamGrid, BeamSection, Bending};
use super::estimated_dimensions::NeighbourWing;
use super::ground::GroundShape;
use super::image_line::ImageLine;
use super::marker_arm::MarkerArm;
use super::marker_state::{DimensionDerivatives, ESTIMATED_DIMENSIONS, MarkerState};
use super::values::{CameraPose, UnknownValues};
use super::{AdjustResult, Observation};
use crate::environment::Plate;
use crate::geometry::{BROWN, Lens, cross_matrix, left_jacobian};
use crate::setup::{Orientation, Setup, Shape};

/// Step of the numerical derivative with respect to the bow; the image is linear in it to 1e-3 of its effect.
const BOW_STEP: f64 = 1e-3;

/// Model of an installation: all quantities that no adjustment changes.
#[derive(Clone, Debug)]
pub struct WingScene {
    pub ground: GroundShape,
    /// Beam grid at the markers' stations.
    pub grid: BeamGrid,
    /// Position of each marker relative to its section.
    pub arms: Vec<MarkerArm>,
    /// True if each marker is fixed to the cabin.
    fixed: Vec<bool>,
    /// Neighbouring wings, one per estimated dimension; `None` for a dimension without uncertainty.
    pub neighbours: [Option<NeighbourWing>; ESTIMATED_DIMENSIONS],
    /// Image observations of the ground frames, per marker of the survey.
    pub ground_observations: Vec<Option<Observation>>,
    /// Additional covariance of each surveyed position, wing frame, m^2 ([`Self::define_points`]); 0 for a decal.
    pub point_covariances_m2: Vec<Matrix3<f64>>,
    lens: Lens,
    /// Rotation on the ground, before corrections.
    pub camera_from_wing: Matrix3<f64>,
    /// Panes of the window in flight and on the ground, wing frame.
    panes: [Option<Plate>; 2],
    /// Modes of the field of bent rays at each marker ([`ImageLine::modes`]).
    pub ray_modes: Vec<Vector3<f64>>,
}

/// Camera at a given pose, prepared for projecting many points.
#[derive(Clone, Copy, Debug)]
pub struct PosedCamera {
    lens: Lens,
    centre_m: Vector3<f64>,
    mount: Matrix3<f64>,
    camera_from_wing: Matrix3<f64>,
    mount_jacobian: Matrix3<f64>,
    ground_jacobian: Matrix3<f64>,
    /// Panes between camera and wing, camera frame.
    pane: Option<Plate>,
    /// Change of the bow's curvature from its nominal value, as a fraction.
    bow: f64,
    /// True if the bow is uncertain.
    bows: bool,
    /// Ratios of the focal lengths along u and v to those on the ground.
    factors: Vector2<f64>,
}

impl PosedCamera {
    /// Computes the apparent position of a point through the panes, camera frame, m, with its derivatives with respect to
    /// the position and the bow.
    fn apparent_point(&self, point_m: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>, Vector3<f64>) {
        let Some(plate) = self.pane else {
            return (*point_m, Matrix3::identity(), Vector3::zeros());
        };
        let (seen, by_place) = plate
            .with_bow_change(self.bow)
            .apparent_with_jacobian(point_m);
        let more = || {
            plate
                .with_bow_change(self.bow + BOW_STEP)
                .apparent_point(point_m)
        };
        let by_bow = if self.bows {
            (more() - seen) / BOW_STEP
        } else {
            Vector3::zeros()
        };
        (seen, by_place, by_bow)
    }
}

/// Predicted pixel with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedPixel {
    pub pixel: Vector2<f64>,
    /// d pixel / d point, wing frame, px/m.
    pub by_point: Matrix2x3<f64>,
    /// d pixel / d relative change of the bow's curvature, px; 0 if the bow is known.
    pub by_bow: Vector2<f64>,
    /// d pixel / d mounting rotation, px/rad.
    pub by_mount: Matrix2x3<f64>,
    /// d pixel / d ground rotation, px/rad.
    pub by_ground_rotation: Matrix2x3<f64>,
    /// d pixel / d interior orientation, in the order of [`Lens::PARAMETERS`].
    pub by_lens: SMatrix<f64, 2, BROWN>,
    /// d pixel / d relative change of both focal lengths, px.
    pub by_scale: Vector2<f64>,
    /// d pixel / d relative change of the focal length along v, px.
    pub by_aspect: Vector2<f64>,
    /// d pixel / d coefficients of the field of bent rays, along u and along v; 0 where no marker is projected.
    pub by_ray_field: Vector3<f64>,
}

/// The bent wing and its neighbours with the same bending: sections at the markers' stations.
#[derive(Clone, Debug, PartialEq)]
pub struct BentWing {
    sections: Vec<BeamSection>,
    neighbours: [Vec<BeamSection>; ESTIMATED_DIMENSIONS],
}

impl WingScene {
    /// Prepares an installation.
    ///
    /// # Errors
    /// Returns an error if the surveyed markers do not define a bending axis.
    pub fn new(setup: &Setup, orientation: &Orientation) -> AdjustResult<Self> {
        let trusted = trusted_markers(setup, orientation);
        let ground = GroundShape::new(setup, &trusted)?;
        let neighbours = NeighbourWing::all_from_setup(setup, &trusted, &ground)?;
        let arcs: Vec<f64> = ground.stations.iter().map(|s| s.arc_m).collect();
        let grid = BeamGrid::new(&ground, &arcs);
        let mounts = MarkerArm::all_on_ground(&grid, &ground);
        let mut ground_sights = vec![None; setup.markers.len()];
        for s in &orientation.ground {
            if let Some(slot) = ground_sights.get_mut(s.marker) {
                *slot = Some(*s);
            }
        }
        // Two or three observations determine the rotation without redundancy; the orientation is better then.
        if ground_sights.iter().flatten().count() < 4 {
            ground_sights.fill(None);
        }
        let wing_from_survey = ground.frame.wing_from_survey.matrix();
        let camera_from_wing =
            orientation.camera_from_survey.matrix() * wing_from_survey.transpose();
        let panes = [true, false].map(|flight| {
            Plate::from_window(
                setup.window.as_ref(),
                &ground.frame.wing_from_survey,
                flight,
            )
        });
        let mut scene = Self {
            ground,
            grid,
            arms: mounts,
            fixed: setup.markers.iter().map(|m| m.fixed).collect(),
            neighbours,
            ground_observations: ground_sights,
            point_covariances_m2: vec![Matrix3::zeros(); setup.markers.len()],
            lens: setup.lens,
            camera_from_wing,
            panes,
            ray_modes: vec![],
        };
        scene.define_points(setup);
        let pixel_of = |k: usize| {
            let surveyed_m = scene.ground.stations[k].surveyed_m;
            scene.lens.project(&(camera_from_wing * surveyed_m))
        };
        let on_wing = (0..setup.markers.len()).filter(|k| !scene.fixed[*k]);
        let line = ImageLine::from_pixels(&on_wing.filter_map(pixel_of).collect::<Vec<_>>());
        scene.ray_modes = (0..setup.markers.len())
            .map(|k| pixel_of(k).map_or_else(Vector3::zeros, |pixel| line.modes(&pixel)))
            .collect();
        Ok(scene)
    }

    /// Defines each point without a decal as the spot of the skin that its template shows, because flights are matched to
    /// the template: the error of the place that a person marked on the ground becomes one of the surveyed position along
    /// the skin, common to all frames, and the ground observation is exact.
    fn define_points(&mut self, setup: &Setup) {
        let points = setup
            .markers
            .iter()
            .enumerate()
            .filter(|(_, m)| m.shape == Shape::Point);
        for (k, marker) in points {
            let station = &self.ground.stations[k];
            let point_m = station.surveyed_m;
            let facing = || -point_m.normalize();
            let normal = if marker.fixed {
                facing()
            } else {
                station.skin_normal
            };
            let seen = self
                .lens
                .project_with_jacobian(&(self.camera_from_wing * point_m));
            let (Some((_, by_camera)), Some(observation)) =
                (seen, &mut self.ground_observations[k])
            else {
                continue;
            };
            let by_point = by_camera * self.camera_from_wing;
            let rows = Matrix3::from_rows(&[
                by_point.row(0).into(),
                by_point.row(1).into(),
                normal.transpose(),
            ]);
            let Some(inverse) = rows.try_inverse() else {
                continue;
            };
            let by_pixel = inverse.fixed_columns::<2>(0);
            self.point_covariances_m2[k] =
                by_pixel * observation.covariance_px2 * by_pixel.transpose();
            observation.covariance_px2.fill(0.0);
        }
    }

    /// Returns whether ground-frame observations are used.
    pub fn has_ground_observations(&self) -> bool {
        self.ground_observations.iter().any(Option::is_some)
    }

    /// Uncertainty of the projection centre in flight relative to that on the ground due to the panes' parameters, wing
    /// frame, m^2; `None` if ground frame and flight frames are taken through the same panes.
    pub fn window_covariance_m2(&self) -> Option<Matrix3<f64>> {
        let axis = self.camera_from_wing.transpose() * Vector3::z();
        let [flight, ground] = &self.panes;
        flight
            .filter(|_| ground.is_none())
            .map(|pane| pane.shift_covariance_m2(&axis))
    }

    /// Standard deviation of the bow's curvature, as a fraction of it or of the default; `None` without panes.
    pub fn bow_sigma(&self) -> Option<f64> {
        self.panes[0].map(|plate| plate.pane.bow_sigma)
    }

    /// Camera at a pose in flight.
    pub fn flight_camera(&self, pose: &CameraPose) -> PosedCamera {
        PosedCamera {
            bows: self.bow_sigma().is_some_and(|sigma| sigma > 0.0),
            ..self.camera_behind_pane(pose, self.panes[0].as_ref())
        }
    }

    /// Camera on the ground, before a remount.
    pub fn ground_camera(&self, pose: &CameraPose) -> PosedCamera {
        self.camera_behind_pane(&pose.on_ground(), self.panes[1].as_ref())
    }

    fn camera_behind_pane(&self, pose: &CameraPose, pane: Option<&Plate>) -> PosedCamera {
        let ground_from_wing = Rotation3::new(pose.ground_rad).matrix() * self.camera_from_wing;
        let mount = *Rotation3::new(pose.mount_rad).matrix();
        let scale = 1.0 + pose.flight_scale;
        let factors = Vector2::new(scale, scale * (1.0 + pose.flight_aspect));
        let camera_from_wing = mount * ground_from_wing;
        PosedCamera {
            lens: self
                .lens
                .with_changes(&pose.lens)
                .with_flight_change(&factors, &pose.flight_principal_px),
            centre_m: pose.centre_m + pose.shift_m + pose.window_m,
            mount,
            camera_from_wing,
            mount_jacobian: left_jacobian(&pose.mount_rad),
            ground_jacobian: left_jacobian(&pose.ground_rad),
            pane: pane.map(|pane| pane.rotated(&camera_from_wing)),
            bow: pose.bow,
            bows: false,
            factors,
        }
    }

    /// Projects a point (wing frame, m) to a pixel; `None` if it is behind the camera.
    pub fn project(&self, point_m: &Vector3<f64>, camera: &PosedCamera) -> Option<PredictedPixel> {
        let in_camera = camera.camera_from_wing * (point_m - camera.centre_m);
        let (seen, by_place, by_bow) = camera.apparent_point(&in_camera);
        let (pixel, by_seen) = camera.lens.project_with_jacobian(&seen)?;
        // Panes and point rotate together, and so does the apparent point.
        let before_mount = camera.mount.transpose() * seen;
        let turned = by_seen * camera.mount;
        let Lens { cx, cy, .. } = camera.lens;
        let mut by_lens = camera.lens.parameter_jacobian(&seen);
        (0..2).for_each(|k| by_lens[(k, k)] *= camera.factors[k]);
        let off_px = pixel - Vector2::new(cx, cy);
        let scale = camera.factors.x;
        Some(PredictedPixel {
            pixel,
            by_ray_field: Vector3::zeros(),
            by_point: by_seen * by_place * camera.camera_from_wing,
            by_bow: by_seen * by_bow,
            by_mount: -(by_seen * cross_matrix(&seen)) * camera.mount_jacobian,
            by_ground_rotation: -(turned * cross_matrix(&before_mount)) * camera.ground_jacobian,
            by_lens,
            by_scale: off_px / scale,
            by_aspect: Vector2::new(0.0, off_px.y * scale / camera.factors.y),
        })
    }

    /// Bends the wing and its neighbours.
    pub fn bend(&self, bending: &Bending) -> BentWing {
        let neighbours = self
            .neighbours
            .each_ref()
            .map(|n| n.as_ref().map_or(vec![], |n| n.grid.bend(bending)));
        BentWing {
            sections: self.grid.bend(bending),
            neighbours,
        }
    }

    /// Returns whether a marker is fixed to the cabin.
    pub fn is_fixed(&self, marker: usize) -> bool {
        self.fixed.get(marker).copied().unwrap_or(false)
    }

    /// Computes a marker's state in flight with all its displacements. `ground_m`: its position on the ground including its
    /// own in-flight motion, wing frame, m.
    pub fn marker_in_flight(
        &self,
        marker: usize,
        bent: &BentWing,
        ground_m: &Vector3<f64>,
        values: &UnknownValues,
    ) -> MarkerState {
        let bending = values.bending();
        let nominal = self.marker_on_beam(marker, &bent.sections[marker], ground_m, &bending);
        let mut state = nominal;
        match &values.dimension_derivatives {
            Some(answers) => state.apply_dimensions(&answers[marker], &values.estimated),
            None => {
                state = self.apply_dimensions(nominal, bent, ground_m, &bending, &values.estimated)
            }
        }
        if let Some((turn_rad, from_root_m)) = values.plane_rad.zip(nominal.from_root_m) {
            let root_m = nominal.carried.position_m - from_root_m;
            let there_m = ground_m + Vector3::x().cross(&(ground_m - root_m));
            state.tilt_bending_plane(
                turn_rad,
                &nominal,
                &self.marker_on_beam(marker, &bent.sections[marker], &there_m, &bending),
            );
        }
        state.carry_with_root(&values.root_rotation_rad, &values.root_translation_m);
        state.carried.position_m += marker_displacement(&values.moved_m, marker);
        state
    }

    /// Bends a frame's wing, and its neighbours unless the derivatives with respect to the estimated dimensions are given.
    pub fn bend_frame(&self, values: &UnknownValues) -> BentWing {
        match values.dimension_derivatives {
            Some(_) => BentWing {
                sections: self.grid.bend(&values.bending()),
                neighbours: Default::default(),
            },
            None => self.bend(&values.bending()),
        }
    }

    /// Derivatives of all markers' positions with respect to the estimated dimensions, for a wing with this bending.
    pub fn dimension_derivatives(&self, bending: &Bending) -> DimensionDerivatives {
        let bent = self.bend(bending);
        let stations = self.ground.stations.iter().enumerate();
        stations
            .map(|(k, s)| {
                self.marker_with_dimensions(
                    k,
                    &bent,
                    &s.surveyed_m,
                    bending,
                    &[0.0; ESTIMATED_DIMENSIONS],
                )
                .by_estimated
            })
            .collect()
    }

    /// Computes a marker's state on the nominal wing.
    pub fn marker_on_beam(
        &self,
        index: usize,
        section: &BeamSection,
        ground_m: &Vector3<f64>,
        bending: &Bending,
    ) -> MarkerState {
        let state = match self.fixed[index] {
            true => MarkerState::fixed(ground_m),
            false => {
                MarkerState::on_wing(&self.grid, &self.arms[index], section, ground_m, bending)
            }
        };
        MarkerState {
            marker: index,
            ..state
        }
    }

    /// Carries a marker from its position on the ground (wing frame, m) into flight. `estimated`: corrections of the
    /// estimated dimensions.
    pub fn marker_with_dimensions(
        &self,
        index: usize,
        bent: &BentWing,
        ground_m: &Vector3<f64>,
        bending: &Bending,
        estimated: &[f64; ESTIMATED_DIMENSIONS],
    ) -> MarkerState {
        let nominal = self.marker_on_beam(index, &bent.sections[index], ground_m, bending);
        self.apply_dimensions(nominal, bent, ground_m, bending, estimated)
    }

    /// Applies corrections of the estimated dimensions to a marker on the nominal wing.
    fn apply_dimensions(
        &self,
        nominal: MarkerState,
        bent: &BentWing,
        ground_m: &Vector3<f64>,
        bending: &Bending,
        estimated: &[f64; ESTIMATED_DIMENSIONS],
    ) -> MarkerState {
        let index = nominal.marker;
        let mut state = nominal;
        if self.fixed[index] {
            return state;
        }
        for (k, (neighbour, off)) in self.neighbours.iter().zip(estimated).enumerate() {
            let Some(neighbour) = neighbour else { continue };
            let other =
                neighbour.marker_state(index, &bent.neighbours[k][index], ground_m, bending);
            state.by_estimated[k] =
                (other.carried.position_m - nominal.carried.position_m) / neighbour.step;
            state.interpolate_towards(&nominal, &other, off / neighbour.step);
        }
        let estimated_m = state.carried.position_m - nominal.carried.position_m;
        state.from_root_m = nominal.from_root_m.map(|from| from + estimated_m);
        state
    }
}

/// Displacement of one marker, m; 0 if the list does not hold it.
pub fn marker_displacement(displacements_m: &[Vector3<f64>], marker: usize) -> Vector3<f64> {
    displacements_m
        .get(marker)
        .copied()
        .unwrap_or_else(Vector3::zeros)
}

/// Limit of the difference between a ground-frame image and its prediction from the survey, in standard deviations;
/// exceeded once in a million by valid points.
const TRUST_SIGMAS: f64 = 5.0;

/// Returns whether each surveyed point has an image in the ground frame and agrees with it. If most points disagree, the
/// orientation is wrong and single points cannot be judged.
fn trusted_markers(setup: &Setup, orientation: &Orientation) -> Vec<bool> {
    let may_shape = orientation.shaping_markers(setup.markers.len());
    let mut trusted = vec![true; setup.markers.len()];
    for observation in &orientation.ground {
        let Some(marker) = setup.markers.get(observation.marker) else {
            continue;
        };
        let seen = orientation.camera_from_survey * (marker.position_m - setup.projection_centre_m);
        let Some(pixel) = setup.lens.project(&seen) else {
            continue;
        };
        let survey = marker.sigma_m.hypot(setup.projection_centre_sigma_m);
        let survey_px = setup.lens.focal_px() * survey / seen.norm().max(1e-3);
        let off = pixel - observation.pixel;
        trusted[observation.marker] = (0..2).all(|k| {
            off[k].abs()
                <= TRUST_SIGMAS
                    * observation.covariance_px2[(k, k)]
                        .max(0.0)
                        .sqrt()
                        .hypot(survey_px)
        });
    }
    if 2 * trusted.iter().filter(|t| !**t).count() > orientation.ground.len() {
        trusted.fill(true);
    }
    trusted
        .into_iter()
        .zip(may_shape)
        .map(|(agrees, seen)| agrees && seen)
        .collect()
}

#[cfg(test)]
mod tests;
