//! Conditions of a marker, written into the columns of a frame's layout.

use nalgebra::{DVector, Matrix2x3, Matrix3, Vector2, Vector3};

use super::{BlockMember, GroundPositions, ParameterLayout};
use crate::adjust::scene::{BentWing, PosedCamera, WingScene, marker_displacement};
use crate::adjust::term::{ParameterScope, ParameterTerm};
use crate::adjust::values::UnknownValues;
use crate::estimation::{EstimationError, EstimationResult, GroupPoint, Linearised};

/// Wing and cameras, evaluated at a point of the iteration.
struct EvaluatedFrame<'a> {
    scene: &'a WingScene,
    values: UnknownValues,
    bent: BentWing,
    in_flight: PosedCamera,
    on_ground: PosedCamera,
}

impl ParameterLayout {
    /// Linearises all blocks of a group at a point, one block per member. If positions on the ground are parameters and the
    /// block holds the survey, it has three conditions for the position; in addition two for the image in flight and two
    /// for the image on the ground.
    ///
    /// # Errors
    /// Returns an error if a marker is behind the camera.
    pub fn linearise(
        &self,
        scene: &WingScene,
        members: &[BlockMember],
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> EstimationResult<()> {
        let values = self.values(at.global, at.local);
        let frame = EvaluatedFrame {
            bent: scene.bend_frame(&values),
            in_flight: scene.flight_camera(&values.pose),
            on_ground: scene.ground_camera(&values.pose),
            scene,
            values,
        };
        for (index, (member, observed)) in members.iter().zip(at.observed).enumerate() {
            let surveyed =
                self.ground_positions != GroundPositions::Observed && member.flight.is_none();
            let images =
                usize::from(member.flight.is_some()) + usize::from(member.ground.is_some());
            if index == blocks.len() {
                let columns = self.block_columns(&[member.marker]);
                let conditions = 3 * usize::from(surveyed) + 2 * images;
                blocks.push(Linearised::empty(
                    conditions,
                    columns,
                    self.local,
                    observed.len(),
                ));
            }
            let ground_m = self.ground_position(member.marker, at.global, observed);
            let moved_m = self.moved_position(member.marker, &ground_m, at.global);
            let mut rows = ConditionRows {
                layout: self,
                out: &mut blocks[index],
                observed,
                row: 0,
            };
            if surveyed {
                rows.write_survey(&ground_m);
            }
            rows.write_images(member, &ground_m, &moved_m, &frame)?;
        }
        Ok(())
    }
}

/// Conditions of a block under construction. The block may hold values of an earlier point.
struct ConditionRows<'a> {
    layout: &'a ParameterLayout,
    out: &'a mut Linearised,
    /// The block's adjusted observations.
    observed: &'a DVector<f64>,
    row: usize,
}

impl ConditionRows<'_> {
    fn set_pixel_derivative(&mut self, scope: ParameterScope, k: usize, v: Vector2<f64>) {
        let (target, column) = match scope {
            ParameterScope::Global(first) => {
                (&mut self.out.global, self.layout.block_column(first) + k)
            }
            ParameterScope::Local(first) => (&mut self.out.local, first + k),
        };
        let first = column * target.nrows() + self.row;
        target.as_mut_slice()[first..first + 2].copy_from_slice(v.as_slice());
    }

    /// Writes the two conditions of an observed pixel, with its derivatives with respect to the unknowns and the
    /// marker's position on the ground.
    fn write_image(
        &mut self,
        first: usize,
        pixel: &Vector2<f64>,
        by: impl Fn(&ParameterTerm, usize) -> Vector2<f64>,
        by_ground: &Matrix2x3<f64>,
    ) {
        for k in 0..2 {
            self.out.misclosure[self.row + k] = pixel[k] - self.observed[first + k];
            self.out.observations[(self.row + k, first + k)] = -1.0;
        }
        let layout = self.layout;
        for (placed, k) in layout.unknowns() {
            self.set_pixel_derivative(placed.scope, k, by(&placed.term, k));
        }
        let (target, column) = match layout.ground_positions {
            GroundPositions::Observed => (&mut self.out.observations, 0),
            GroundPositions::Global(_) => (&mut self.out.global, layout.survey_column()),
        };
        target
            .fixed_view_mut::<2, 3>(self.row, column)
            .copy_from(by_ground);
        self.row += 2;
    }

    /// Writes the derivatives of the next two conditions with respect to the marker's in-flight motion.
    fn write_motion(&mut self, marker: usize, by_ground: &Matrix2x3<f64>) {
        let first = self.layout.motion_column();
        for (k, direction) in self.layout.motions.directions(marker).iter().enumerate() {
            self.out
                .global
                .fixed_view_mut::<2, 1>(self.row, first + k)
                .copy_from(&(by_ground * direction));
        }
    }

    /// Writes the conditions of the images in flight and on the ground.
    fn write_images(
        &mut self,
        member: &BlockMember,
        ground_m: &Vector3<f64>,
        moved_m: &Vector3<f64>,
        EvaluatedFrame {
            scene,
            values,
            bent,
            in_flight,
            on_ground,
        }: &EvaluatedFrame,
    ) -> EstimationResult<()> {
        if let Some(first) = member.flight {
            let state = scene.marker_in_flight(member.marker, bent, moved_m, values);
            let at_row_m = state.carried.position_m
                + marker_displacement(&values.moved_at_row_m, member.marker);
            let mut seen = scene
                .project(&at_row_m, in_flight)
                .ok_or_else(behind_camera_error)?;
            seen.by_ray_field = scene.ray_modes[member.marker];
            seen.pixel += values.pose.ray_field_px * seen.by_ray_field;
            let by_ground = seen.by_point * state.carried.by_ground;
            self.write_motion(member.marker, &by_ground);
            self.write_image(
                first,
                &seen.pixel,
                |term, k| term.flight_pixel_derivative(k, &state, &seen),
                &by_ground,
            );
        }
        if let Some(first) = member.ground {
            let there_m = ground_m + marker_displacement(&values.moved_on_ground_m, member.marker);
            let seen = scene
                .project(&there_m, on_ground)
                .ok_or_else(behind_camera_error)?;
            self.write_image(
                first,
                &seen.pixel,
                |term, k| term.ground_pixel_derivative(k, member.marker, &seen),
                &seen.by_point,
            );
        }
        Ok(())
    }

    /// Writes the three conditions that the surveyed position (the first three observations) equals the parameter.
    fn write_survey(&mut self, ground_m: &Vector3<f64>) {
        let identity = Matrix3::identity();
        for k in 0..3 {
            self.out.misclosure[k] = ground_m[k] - self.observed[k];
        }
        self.out
            .observations
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&-identity);
        self.out
            .global
            .fixed_view_mut::<3, 3>(0, self.layout.survey_column())
            .copy_from(&identity);
        self.row = 3;
    }
}

fn behind_camera_error() -> EstimationError {
    EstimationError::Input(
        "a marker is behind the camera; check projection_centre_m, span_direction and orientation.toml".into(),
    )
}
