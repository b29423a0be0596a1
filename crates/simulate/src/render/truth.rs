//! Truth of a shot: the result of a perfect measurement.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::light::SkinLight;
use super::markers::MarkerDisc;
use super::picture::outline_box;
use super::scene::{Scene, SceneShot};
use super::trace::Hit;
use super::wing::{DeformedWing, SceneState};
use wingd_measure::setup::Shape;

/// Truth of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameTruth {
    /// Rise of the axis at its tip by bending, m.
    pub tip_deflection_m: f64,
    /// Attitude in this frame.
    pub camera_from_survey: Rotation3<f64>,
    /// Torsion of the installation's first pair, as defined in the paper, rad.
    pub torsion_rad: Option<f64>,
    /// Markers, in the survey's order.
    pub markers: Vec<MarkerTruth>,
}

/// Truth of one marker in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerTruth {
    pub id: String,
    pub shape: Shape,
    /// Image of the centre, px; `None` behind the camera.
    pub pixel: Option<Vector2<f64>>,
    /// Width and height of the outline's box, px.
    pub size_px: Vector2<f64>,
    /// True if the marker is complete, in the frame, not hidden and not saturated by glare.
    pub visible: bool,
    /// Centre, survey frame, m.
    pub position_m: Vector3<f64>,
    /// Deflection from the true position on ground, m.
    pub deflection_m: f64,
}

/// Added light over diffuse light beyond which a marker's contrast is gone.
const SATURATED: f64 = 0.9;

impl Scene {
    /// Computes the truth of a shot.
    pub fn truth(&self, shot: &SceneShot) -> FrameTruth {
        let ground = self
            .marker_survey_positions(&self.wing.deform(&SceneState::ground(shot.state.load)), &[]);
        let pose = self.wing.deform(&shot.state);
        let flight = self.marker_survey_positions(&pose, &shot.target_shifts_m);
        let deflection: Vec<f64> = flight.iter().zip(&ground).map(|(f, g)| f.z - g.z).collect();
        let light = self.illumination(shot, &pose);
        let placed = self.marker_discs(&pose, &shot.target_shifts_m);
        let plates = self.plate_boxes(shot, &placed);
        let markers = self.markers.iter().zip(&placed).enumerate();
        FrameTruth {
            tip_deflection_m: shot.state.tip_deflection_m,
            camera_from_survey: self.camera_from_survey(shot),
            torsion_rad: self.setup.torsion.first().map(|pair| {
                let arm = (ground[pair.leading] - ground[pair.trailing]).xy().norm();
                (deflection[pair.leading] - deflection[pair.trailing]).atan2(arm)
            }),
            markers: markers
                .map(|(i, (marker, placed))| {
                    let (pixel, size_px, in_view) = self.marker_image(shot, &pose, placed);
                    let behind = |(k, low, high): &(usize, Vector2<f64>, Vector2<f64>)| {
                        let reach = 0.5 * size_px;
                        let within = |p: Vector2<f64>| p > low - reach && p < high + reach;
                        *k != i && pixel.is_some_and(within)
                    };
                    let in_view = in_view && !plates.iter().any(behind);
                    let lit = light.light_at(
                        &pose,
                        &Hit {
                            s: marker.s_m,
                            z: marker.z_m,
                        },
                    );
                    MarkerTruth {
                        id: marker.id.clone(),
                        shape: marker.shape,
                        pixel,
                        size_px,
                        visible: in_view
                            && !is_highlight_saturated(&lit)
                            && !shot.hidden.contains(&i),
                        position_m: flight[i],
                        deflection_m: deflection[i],
                    }
                })
                .collect(),
        }
    }

    /// Returns the image boxes of the plates of fixed targets, px.
    fn plate_boxes(
        &self,
        shot: &SceneShot,
        placed: &[MarkerDisc],
    ) -> Vec<(usize, Vector2<f64>, Vector2<f64>)> {
        let camera_from_wing = self.camera_from_wing(shot);
        let plate_box = |(k, p): (usize, &MarkerDisc)| {
            let (low, high) = outline_box(p, &camera_from_wing, &self.lens(shot))?;
            p.plate_m.map(|_| (k, low, high))
        };
        placed.iter().enumerate().filter_map(plate_box).collect()
    }

    fn marker_survey_positions(
        &self,
        pose: &DeformedWing,
        target_shifts_m: &[Vector3<f64>],
    ) -> Vec<Vector3<f64>> {
        // The origin is the camera's position at the ground frame.
        let still = |placed: &MarkerDisc| placed.centre_m - pose.cabin_m;
        self.marker_discs(pose, target_shifts_m)
            .iter()
            .map(|placed| self.frame.survey_point(&still(placed)))
            .collect()
    }

    /// Returns the image of the centre, the size of the outline's box, and true if all of it is visible.
    pub(super) fn marker_image(
        &self,
        shot: &SceneShot,
        pose: &DeformedWing,
        placed: &MarkerDisc,
    ) -> (Option<Vector2<f64>>, Vector2<f64>, bool) {
        let camera_from_wing = self.camera_from_wing(shot);
        let lens = &self.lens(shot);
        let pixel = lens.project(&(camera_from_wing * placed.centre_m));
        let Some((low, high)) = outline_box(placed, &camera_from_wing, lens) else {
            return (pixel, Vector2::zeros(), false);
        };
        let facing = placed.normal.dot(&placed.centre_m) < 0.0;
        let clear = |point: &Vector3<f64>| {
            pose.first_hit(point)
                .is_some_and(|hit| placed.covers(hit.s))
        };
        let in_frame = lens.contains(&low) && lens.contains(&high);
        let clear = |point: &Vector3<f64>| placed.plate_m.is_some() || clear(point);
        let visible =
            facing && in_frame && clear(&placed.centre_m) && placed.outline(16).all(|p| clear(&p));
        // The box contains the plate, which is larger than the print by this ratio.
        let share = placed.plate_m.map_or(1.0, |half| placed.radius_m / half);
        (pixel, (high - low) * share, visible)
    }
}

fn is_highlight_saturated(lit: &SkinLight) -> bool {
    lit.added > SATURATED || (lit.added > 0.2 && lit.added + 0.045 * lit.diffuse > 0.97)
}
