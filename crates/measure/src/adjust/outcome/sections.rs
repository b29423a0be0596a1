//! Motions of the wing's sections in a frame, and functions of them with their derivatives.

use nalgebra::{Rotation3, Vector3};

use super::FrameOutcome;
use crate::adjust::Estimate;
use crate::adjust::beam::{BeamSection, SectionMotion};
use crate::adjust::curve::AxisCurve;
use crate::adjust::ground::wing_from_section;
use crate::estimation::Gradient;

/// Function of a section's motion: its value and its derivatives with respect to the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionFunction {
    pub value: f64,
    /// d value / d displacement of the axis, wing frame, 1/m.
    pub by_displacement: Vector3<f64>,
    /// d value / d rotation vector, twist included, wing frame.
    pub by_rotation: Vector3<f64>,
    /// d value / d twist on its own.
    pub by_twist: f64,
}

impl SectionFunction {
    const NONE: Self = Self {
        value: 0.0,
        by_displacement: Vector3::new(0.0, 0.0, 0.0),
        by_rotation: Vector3::new(0.0, 0.0, 0.0),
        by_twist: 0.0,
    };
    /// Function without a value.
    pub const UNKNOWN: Self = Self {
        value: f64::NAN,
        ..Self::NONE
    };

    fn derivative(&self, motion: &SectionMotion, nose_axis: &Vector3<f64>) -> f64 {
        let rotation_rad = motion.rotation_rad + nose_axis * motion.twist_rad;
        self.by_displacement.dot(&motion.displacement_m)
            + self.by_rotation.dot(&rotation_rad)
            + self.by_twist * motion.twist_rad
    }
}

/// Section of the bending axis with its motion from the ground into flight, wing frame.
pub struct MovedSection {
    pub motion: SectionMotion,
    /// Slope of the axis on the ground, rad.
    ground_slope_rad: f64,
    /// Axis of a nose-up twist in flight, unit length.
    nose_axis: Vector3<f64>,
    /// Rotation from the ground into flight.
    pub rotation: Rotation3<f64>,
}

impl MovedSection {
    fn new(motion: SectionMotion, ground_slope_rad: f64, nose: f64) -> Self {
        let rotation = Rotation3::new(motion.rotation_rad);
        let ground_tangent = wing_from_section(ground_slope_rad).column(0).into_owned();
        let nose_axis = rotation * ground_tangent * nose;
        let twist = Rotation3::new(nose_axis * motion.twist_rad);
        Self {
            motion,
            ground_slope_rad,
            nose_axis,
            rotation: twist * rotation,
        }
    }

    /// Displacement of the axis along a unit vector of the wing frame, m.
    pub fn displacement(&self, along: &Vector3<f64>) -> SectionFunction {
        let value = self.motion.displacement_m.dot(along);
        SectionFunction {
            value,
            by_displacement: *along,
            ..SectionFunction::NONE
        }
    }

    /// Change of the axis' slope in the vertical plane of the span, tip up positive, rad.
    pub fn slope(&self) -> SectionFunction {
        let axis = Vector3::z();
        let twist_part = axis.dot(&self.nose_axis);
        let value = self.motion.rotation_rad.dot(&axis);
        SectionFunction {
            value,
            by_rotation: axis,
            by_twist: -twist_part,
            ..SectionFunction::NONE
        }
    }

    /// Twist about the bending axis, nose up positive, rad.
    pub fn twist(&self) -> SectionFunction {
        SectionFunction {
            value: self.motion.twist_rad,
            by_twist: 1.0,
            ..SectionFunction::NONE
        }
    }

    /// Component of the rotation vector along a unit vector of the wing frame, rad.
    pub fn rotation(&self, along: &Vector3<f64>) -> SectionFunction {
        SectionFunction {
            value: self.rotation.scaled_axis().dot(along),
            by_rotation: *along,
            ..SectionFunction::NONE
        }
    }

    /// Change of the incidence in the vertical plane of the flow, nose up positive, rad. `aft`: horizontal direction of the
    /// flow, wing frame, unit length. The section's plane, spanned by axis and chord, intersects that plane in a line whose
    /// inclination is the incidence.
    pub fn streamwise_twist(&self, aft: &Vector3<f64>) -> SectionFunction {
        let up = Vector3::y();
        let on_ground = wing_from_section(self.ground_slope_rad)
            .column(1)
            .into_owned();
        let normal = self.rotation * on_ground;
        let incidence = |n: &Vector3<f64>| n.dot(aft).atan2(n.dot(&up));
        let (along, above) = (normal.dot(aft), normal.dot(&up));
        let by_rotation = (normal.cross(aft) * above - normal.cross(&up) * along)
            / (along * along + above * above);
        let value = incidence(&normal) - incidence(&on_ground);
        SectionFunction {
            value,
            by_rotation,
            ..SectionFunction::NONE
        }
    }
}

/// Sections of the bending axis at a frame's unknowns.
pub struct MovedSections<'a> {
    pub curve: AxisCurve<'a>,
    /// Sections, one per arc length.
    pub sections: Vec<MovedSection>,
    /// Derivatives of their motions, for each unknown of the layout; empty if it does not move them.
    derivatives: Vec<Vec<SectionMotion>>,
}

impl FrameOutcome<'_> {
    /// Evaluates the sections at arc lengths, m from the bending root. Effects that the model of the axis omits are linear and
    /// are added.
    pub fn moved_sections(&self, arcs_m: Vec<f64>) -> MovedSections<'_> {
        let curve = AxisCurve::new(self.solved.input.scene, &self.values, arcs_m);
        let derivatives: Vec<_> = self
            .layout
            .unknowns()
            .map(|(placed, k)| placed.term.section_derivatives(k, &curve))
            .collect();
        let mut motions = curve.motions.clone();
        for ((placed, k), by_section) in self.layout.unknowns().zip(&derivatives) {
            if !placed.term.is_added_to_sections() {
                continue;
            }
            let x = placed.value(
                k,
                &self.solved.fit.global,
                &self.solved.fit.groups[self.solved.group].local,
            );
            for (motion, by) in motions.iter_mut().zip(by_section) {
                motion.displacement_m += by.displacement_m * x;
                motion.rotation_rad += by.rotation_rad * x;
                motion.twist_rad += by.twist_rad * x;
            }
        }
        let nose = self.solved.input.scene.ground.nose;
        let moved = |(motion, flat): (SectionMotion, &BeamSection)| {
            MovedSection::new(motion, flat.slope_rad, nose)
        };
        let sections = motions.into_iter().zip(&curve.flat).map(moved).collect();
        MovedSections {
            curve,
            sections,
            derivatives,
        }
    }

    /// Adds the derivatives of functions of each section: `functions` holds, per function, one value for each section, and
    /// function `f` of section `s` is column `f * sections + s` of the gradient.
    pub fn add_section_functions(
        &self,
        gradient: &mut Gradient,
        MovedSections {
            sections,
            derivatives,
            ..
        }: &MovedSections,
        functions: &[Vec<SectionFunction>],
    ) {
        for ((placed, k), by_section) in self.layout.unknowns().zip(derivatives) {
            for (s, (motion, section)) in by_section.iter().zip(sections).enumerate() {
                for (f, of_sections) in functions.iter().enumerate() {
                    let by = of_sections[s].derivative(motion, &section.nose_axis);
                    self.layout.add_derivative(
                        gradient,
                        placed.scope,
                        k,
                        f * sections.len() + s,
                        by,
                    );
                }
            }
        }
    }

    /// Subtracts from function 1 the deflection of each section in the ground frame, and from function 2 that of the root, too.
    pub(super) fn add_curve_references(
        &self,
        gradient: &mut Gradient,
        moved: &MovedSections,
        functions: &mut [Vec<SectionFunction>],
    ) {
        let (curve, count) = (&moved.curve, moved.sections.len());
        let fit = &self.solved.fit;
        let local = &fit.groups[self.solved.group].local;
        for (placed, k) in self.layout.unknowns() {
            let value = placed.value(k, &fit.global, local);
            for (s, rise) in placed.term.ground_rise(curve).into_iter().enumerate() {
                for (f, function) in functions.iter_mut().enumerate().skip(1).take(2) {
                    function[s].value -= rise * value;
                    self.layout
                        .add_derivative(gradient, placed.scope, k, f * count + s, -rise);
                }
            }
        }
        for (placed, k) in self.layout.root_unknowns() {
            let motions = placed.term.section_derivatives(k, curve);
            for (s, by) in motions.iter().enumerate() {
                let rise = by.displacement_m.y;
                self.layout
                    .add_derivative(gradient, placed.scope, k, 2 * count + s, -rise);
            }
        }
        for (function, section) in functions[2].iter_mut().zip(&curve.bent) {
            let from_root_m = section.axis_m - curve.root_m;
            function.value -= self.values.root_displacement_m(&from_root_m).y;
        }
    }

    /// Direction of the flow, wing frame, if the installation has one and the side of the wing is known.
    pub fn flow_in_wing(&self) -> Option<Vector3<f64>> {
        let flow = self
            .solved
            .input
            .setup
            .flow_direction?
            .try_normalize(f64::EPSILON)?;
        self.solved.input.setup.side()?;
        Some(
            self.solved.input.scene.ground.frame.wing_from_survey
                * Vector3::new(flow.x, flow.y, 0.0),
        )
    }

    /// Functions of sections that records report: deflection, slope, twist and, if the flow's direction is known, the
    /// streamwise twist.
    pub(super) fn reported_functions(
        &self,
        sections: &[MovedSection],
    ) -> Vec<Vec<SectionFunction>> {
        let up = Vector3::y();
        let of_all = |function: &dyn Fn(&MovedSection) -> SectionFunction| {
            sections.iter().map(function).collect()
        };
        let mut all = vec![
            of_all(&|section| section.displacement(&up)),
            of_all(&MovedSection::slope),
            of_all(&MovedSection::twist),
        ];
        all.extend(
            self.flow_in_wing()
                .map(|aft| of_all(&|section| section.streamwise_twist(&aft))),
        );
        all
    }

    /// Values of functions with their standard deviations, in the order of the gradient's columns.
    pub(super) fn section_estimates(
        &self,
        gradient: &Gradient,
        functions: &[Vec<SectionFunction>],
    ) -> Vec<Vec<Estimate>> {
        let mut sigmas = self.function_sigmas(gradient).into_iter();
        let estimate = |f: &SectionFunction, sigma| Estimate {
            value: f.value,
            sigma,
        };
        functions
            .iter()
            .map(|of_all| of_all.iter().map(|f| estimate(f, sigmas.next())).collect())
            .collect()
    }
}
