//! Deformation of a wing: moves points of a surface from the ground to flight, with the rigid motion of their section.
//!
//! Sections are normal to the bending axis on the ground. With the axis `c(s)`, its displacement `d(s)`, the rotation
//! `R(s)` of the section and the thermal scale `k`, the point `p` of the section at `s` moves to
//! `c(s) + d(s) + k R(s) (p - c(s))`. Between the given sections `c`, `d` and the rotation vector of `R` are cubic with
//! continuous slopes. `k` is the length of the axis in flight over that on the ground: bending keeps the length.
//!
//! Inboard of the root nothing moves. Outboard of it the motion is multiplied by a weight that rises from 0 to 1 over
//! [`BLEND_FRACTION`] of the axis, with slope and curvature 0 at both ends: a surface through the root has no kink there.
//! Beyond the last section points move rigidly with it.

use nalgebra::{DMatrix, DVector, Rotation3, SVector, Vector3};

use crate::adjust::{JointShape, ShapeMean};
use crate::geometry::Similarity;
use crate::render::SeededRandom;

/// Fraction of the axis over which the motion rises from the root. Without blending, a root that moves by 3 mm and 1 mrad
/// within its priors would tear a surface of 4 m chord by 5 mm; over 5 % of 33 m this becomes a slope below 6 mrad. A wing
/// that is fixed at the root is changed by less than 1 mm: curvature and twist rate have moved it by 5 mm where blending ends.
pub const BLEND_FRACTION: f64 = 0.05;
/// Largest rotation of a section, rad: beyond it the rotation vector is no coordinate to interpolate in.
const MAX_ROTATION_RAD: f64 = 1.5;
/// Change of arc length at which the search for a section ends, m.
const FOOT_TOLERANCE_M: f64 = 1e-10;
/// Largest number of steps of that search; a surface within a tenth of the axis' radius of curvature needs 10.
const FOOT_STEPS: usize = 40;

/// Pose of one section of the wing in flight relative to the ground, in the survey frame unless it was transformed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionPose {
    /// Arc length from the bending root along the axis on the ground, m.
    pub arc_m: f64,
    /// Point of the bending axis on the ground, m.
    pub ground_m: Vector3<f64>,
    /// Displacement of that point, m.
    pub displacement_m: Vector3<f64>,
    /// Rotation of the section, flight from ground.
    pub rotation: Rotation3<f64>,
}

impl SectionPose {
    /// Returns the pose in another frame.
    pub fn transformed(&self, target_from_survey: &Similarity) -> Self {
        let Similarity {
            scale, rotation, ..
        } = target_from_survey;
        Self {
            arc_m: self.arc_m * scale,
            ground_m: target_from_survey.apply(&self.ground_m),
            displacement_m: rotation * self.displacement_m * *scale,
            rotation: rotation * self.rotation * rotation.inverse(),
        }
    }
}

/// Thermal scale of a wing: length of its axis in flight over that on the ground, by the chords between its sections.
fn thermal_scale(sections: &[SectionPose]) -> f64 {
    let length = |at: fn(&SectionPose) -> Vector3<f64>| {
        sections
            .windows(2)
            .map(|pair| (at(&pair[1]) - at(&pair[0])).norm())
            .sum::<f64>()
    };
    length(|s| s.ground_m + s.displacement_m) / length(|s| s.ground_m)
}

/// Returns the poses of a wing at the temperature of the ground: the axis in flight has its length on the ground, from the
/// root.
pub fn remove_thermal_scale(sections: &[SectionPose]) -> Vec<SectionPose> {
    let Some(root) = sections.first() else {
        return vec![];
    };
    let root_m = root.ground_m + root.displacement_m;
    let scale = thermal_scale(sections);
    let displacement =
        |s: &SectionPose| root_m + (s.ground_m + s.displacement_m - root_m) / scale - s.ground_m;
    sections
        .iter()
        .map(|s| SectionPose {
            displacement_m: displacement(s),
            ..*s
        })
        .collect()
}

/// Reason why poses of sections describe no deformation.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DeformationError {
    /// Fewer than two sections.
    #[error("{0} sections describe no deformation, at least 2 are needed")]
    TooFewSections(usize),
    /// First section that is not at the root.
    #[error("the first section is {0} m from the bending root, not at it")]
    NoRoot(f64),
    /// Sections that are not listed from root to tip, or at one point.
    #[error("the section at {0} m does not lie outboard of the one before it")]
    Order(f64),
    /// Number that is not finite, or a section turned by more than a wing survives.
    #[error("the pose of the section at {0} m is not plausible")]
    Pose(f64),
}

/// Ground point, displacement and rotation vector at an arc length, or their derivatives.
type AxisValues = SVector<f64, 9>;

/// Axis at a section, with its derivatives with respect to the arc length.
#[derive(Clone, Copy, Debug, PartialEq)]
struct AxisKnot {
    arc_m: f64,
    values: AxisValues,
    slopes: AxisValues,
}

impl AxisKnot {
    /// Unit tangent of the axis on the ground.
    fn tangent(&self) -> Vector3<f64> {
        self.slopes.fixed_rows::<3>(0).normalize()
    }

    /// Distance of a point outboard of the section, m; it falls along the axis.
    fn distance_outboard_m(&self, point_m: &Vector3<f64>) -> f64 {
        (point_m - self.values.fixed_rows::<3>(0)).dot(&self.tangent())
    }
}

/// Deformation of a wing between ground and flight, in the frame of its sections.
#[derive(Clone, Debug, PartialEq)]
pub struct WingDeformation {
    knots: Vec<AxisKnot>,
    scale: f64,
}

/// Section through a point on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionFoot {
    /// Arc length of the section, m: negative inboard of the root, above the length beyond the last section.
    pub arc_m: f64,
    /// Distance of the point from the axis, which continues straight beyond its ends, m.
    pub distance_m: f64,
}

impl WingDeformation {
    /// Creates the deformation from poses of sections, root to tip: the first at arc length 0.
    ///
    /// # Errors
    /// Returns an error if there are fewer than two sections, out of order or with implausible poses.
    pub fn new(sections: &[SectionPose]) -> Result<Self, DeformationError> {
        let [first, _, ..] = sections else {
            return Err(DeformationError::TooFewSections(sections.len()));
        };
        if first.arc_m.abs() > 1e-9 {
            return Err(DeformationError::NoRoot(first.arc_m));
        }
        let to_values = |s: &SectionPose| {
            let turn = s.rotation.scaled_axis();
            AxisValues::from_iterator(
                s.ground_m
                    .iter()
                    .chain(&s.displacement_m)
                    .chain(&turn)
                    .copied(),
            )
        };
        let values: Vec<AxisValues> = sections.iter().map(to_values).collect();
        let is_plausible = |v: &AxisValues| {
            v.iter().all(|x| x.is_finite()) && v.fixed_rows::<3>(6).norm() < MAX_ROTATION_RAD
        };
        if let Some(k) = values.iter().position(|v| !is_plausible(v)) {
            return Err(DeformationError::Pose(sections[k].arc_m));
        }
        let is_ordered = |pair: &[SectionPose]| {
            let (step_m, moved_m) = (
                pair[1].arc_m - pair[0].arc_m,
                pair[1].ground_m - pair[0].ground_m,
            );
            step_m > 0.0 && moved_m.norm() > 0.5 * step_m
        };
        if let Some(k) = sections.windows(2).position(|pair| !is_ordered(pair)) {
            return Err(DeformationError::Order(sections[k + 1].arc_m));
        }
        let arcs_m: Vec<f64> = sections.iter().map(|s| s.arc_m).collect();
        let scale = thermal_scale(sections);
        let slopes = parabolic_slopes(&arcs_m, &values);
        let knots = arcs_m.iter().zip(&values).zip(&slopes);
        let knots = knots
            .map(|((&arc_m, &values), &slopes)| AxisKnot {
                arc_m,
                values,
                slopes,
            })
            .collect();
        Ok(Self { knots, scale })
    }

    /// Arc length of the last section, m.
    pub fn length_m(&self) -> f64 {
        self.knots.last().map_or(0.0, |last| last.arc_m)
    }

    /// Thermal scale: length in flight over that on the ground.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Moves a point from the ground to flight, m.
    pub fn move_point(&self, ground_m: &Vector3<f64>) -> Vector3<f64> {
        let arc_m = self.find_foot(ground_m).arc_m;
        if arc_m <= 0.0 {
            return *ground_m;
        }
        let last_m = self.length_m();
        let weight = blend_weight(arc_m / (BLEND_FRACTION * last_m));
        let axis = self.axis_at(arc_m.min(last_m));
        let [axis_m, displacement_m, turn_rad] =
            [0, 3, 6].map(|k| axis.values.fixed_rows::<3>(k).into_owned());
        let turned = Rotation3::new(turn_rad * weight) * (ground_m - axis_m);
        axis_m + displacement_m * weight + turned * (1.0 + (self.scale - 1.0) * weight)
    }

    /// Finds the section through a point, m.
    pub fn find_foot(&self, point_m: &Vector3<f64>) -> SectionFoot {
        let inboard = self
            .knots
            .partition_point(|knot| knot.distance_outboard_m(point_m) > 0.0);
        let (low, high) = (
            &self.knots[inboard.max(1) - 1],
            &self.knots[inboard.min(self.knots.len() - 1)],
        );
        let mut axis = *low;
        for _ in 0..FOOT_STEPS {
            let step_m = axis.distance_outboard_m(point_m) / axis.slopes.fixed_rows::<3>(0).norm();
            let next_m = (axis.arc_m + step_m).clamp(low.arc_m, high.arc_m);
            if (next_m - axis.arc_m).abs() < FOOT_TOLERANCE_M {
                break;
            }
            axis = self.axis_at(next_m);
        }
        // Only beyond the ends, where both knots are one.
        let beyond_m = if low.arc_m == high.arc_m {
            low.distance_outboard_m(point_m)
        } else {
            0.0
        };
        let arm_m = point_m - axis.values.fixed_rows::<3>(0) - axis.tangent() * beyond_m;
        SectionFoot {
            arc_m: axis.arc_m + beyond_m,
            distance_m: arm_m.norm(),
        }
    }

    /// Axis at an arc length of the wing, m: cubic between two sections, by values and slopes there.
    fn axis_at(&self, arc_m: f64) -> AxisKnot {
        let k = self
            .knots
            .partition_point(|knot| knot.arc_m <= arc_m)
            .clamp(1, self.knots.len() - 1);
        let (low, high) = (&self.knots[k - 1], &self.knots[k]);
        let step_m = high.arc_m - low.arc_m;
        let t = (arc_m - low.arc_m) / step_m;
        let (a, b, rise) = (low.slopes, high.slopes, (high.values - low.values) / step_m);
        let (second, third) = (rise * 3.0 - a * 2.0 - b, a + b - rise * 2.0);
        let values = low.values + (a + (second + third * t) * t) * (t * step_m);
        AxisKnot {
            arc_m,
            values,
            slopes: a + (second * 2.0 + third * (3.0 * t)) * t,
        }
    }
}

/// Slopes at knots, of the parabola through each knot and its neighbours; at the ends of the one next to them.
fn parabolic_slopes(arcs_m: &[f64], values: &[AxisValues]) -> Vec<AxisValues> {
    let rise = |k: usize| (values[k + 1] - values[k]) / (arcs_m[k + 1] - arcs_m[k]);
    let last = arcs_m.len() - 1;
    let slope = |k: usize| {
        if last == 1 {
            return rise(0);
        }
        let middle = k.clamp(1, last - 1);
        let (low, high) = (rise(middle - 1), rise(middle));
        let bend = (high - low) / (arcs_m[middle + 1] - arcs_m[middle - 1]);
        low + bend * (2.0 * arcs_m[k] - arcs_m[middle - 1] - arcs_m[middle])
    };
    (0..=last).map(slope).collect()
}

/// Weight of the motion at a fraction of the blended length: 0 to 1, with slope and curvature 0 at both ends.
fn blend_weight(fraction: f64) -> f64 {
    let x = fraction.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

/// Standard deviations of a moved point's coordinates over sampled deformations, m; `None` for fewer than two, or if the
/// point is inboard of the root of each and does not move.
pub fn sample_sigma_m(
    samples: &[WingDeformation],
    ground_m: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let moved: Vec<Vector3<f64>> = samples
        .iter()
        .map(|one| one.move_point(ground_m) - ground_m)
        .collect();
    if moved.len() < 2 || moved.iter().all(|m| *m == Vector3::zeros()) {
        return None;
    }
    let count = moved.len() as f64;
    let mean = moved.iter().sum::<Vector3<f64>>() / count;
    let squares = moved
        .iter()
        .map(|m| (m - mean).component_mul(&(m - mean)))
        .sum::<Vector3<f64>>();
    Some((squares / (count - 1.0)).map(f64::sqrt))
}

/// Poses of a wing's sections as measured, and random realisations of them.
#[derive(Clone, Debug, PartialEq)]
pub struct SampledPoses {
    /// Most probable poses, root to tip.
    pub mean: Vec<SectionPose>,
    /// Realisations: each is the whole wing with one error of every source.
    pub samples: Vec<Vec<SectionPose>>,
}

impl SampledPoses {
    /// Samples the mean shape over frames of a flight, or the shape of one frame. Errors that the frames share do not
    /// become smaller by averaging.
    pub fn new(shape: &JointShape, frames: &[usize], count: usize, seed: u64) -> Self {
        let ShapeMean {
            values,
            lasting,
            shared,
            own,
            ..
        } = shape.mean(frames);
        if values.is_empty() {
            return Self {
                mean: vec![],
                samples: vec![],
            };
        }
        let mut random = SeededRandom::new(seed, SAMPLING_STREAM);
        let mut error = |factor: &DMatrix<f64>| {
            factor * DVector::from_fn(factor.ncols(), |_, _| random.normal())
        };
        let sample = |_| {
            section_poses(
                shape,
                &(&values + error(&lasting) + error(&shared) + error(&own)),
            )
        };
        let samples = (0..count).map(sample).collect();
        Self {
            mean: section_poses(shape, &values),
            samples,
        }
    }
}

/// Purpose of the random numbers, so that other samples with the seed are independent.
const SAMPLING_STREAM: u64 = 31;

/// Poses of the stations of a shape from values of its functions.
fn section_poses(shape: &JointShape, values: &DVector<f64>) -> Vec<SectionPose> {
    let vector = |first: usize, k: usize| {
        Vector3::from_fn(|i, _| values[shape.station_function(first + i, k)])
    };
    let pose = |(k, (&arc_m, &ground_m)): (usize, (&f64, &Vector3<f64>))| SectionPose {
        arc_m,
        ground_m,
        displacement_m: vector(0, k),
        rotation: Rotation3::new(vector(6, k)),
    };
    shape
        .arcs_m
        .iter()
        .zip(&shape.ground_m)
        .enumerate()
        .map(pose)
        .collect()
}
