//! The beam in flight: computes positions from curvature and twist, with derivatives (docs/adjustment.md).
//!
//! ```text
//! kappa(s) = m(s/L) sum c_k P_k(2 s/L - 1)      theta(s) = theta_ground(s) + integral kappa
//! phi(s)   = s/L sum t_j P_j(2 s/L - 1)         axis(s)  = root + scale * integral (cos, sin) theta
//! ```
//!
//! `P_k`: Legendre's polynomials; `m`: the reference curvature ([`super::shapes`]), mean 1.

use std::sync::LazyLock;

use nalgebra::Vector3;

use super::ground::{BendingAxis, GroundShape};
use super::shapes::{curvature_integrals, legendre_polynomials};
use crate::ordering::sort_by_value;

pub use super::shapes::{MAX_CURVATURE_TERMS, curvature_basis};
/// Number of terms in the correction of the axis height: powers of s/L, starting with the constant.
pub const RAISE_TERMS: usize = 4;
/// Largest number of terms of the twist.
pub const MAX_TWIST_TERMS: usize = 6;
/// Positions at which control surfaces apply a torque, as fractions of the length: a flap, two ailerons, one at the tip.
/// The kink in the twist between two positions is determined by both.
pub const TORQUE_POSITIONS: [f64; 4] = [0.45, 0.6, 0.75, 0.9];
/// Number of functions in the twist basis: the polynomial terms, then one function per torque.
pub const TWIST_FUNCTIONS: usize = MAX_TWIST_TERMS + TORQUE_POSITIONS.len();
/// Tip chord over root chord, and the power of the chord that the torsional stiffness follows, for a typical wing.
const TORSION_TAPER_AND_POWER: (f64, f64) = (0.3, 3.3);

/// Longest panel of the integration, m.
const PANEL_M: f64 = 2.5;
/// Gauss-Legendre, three points on (0, 1).
const GAUSS_POINTS: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// Places of joints that give with the load, as fractions of the length: outer wings that fold or are bolted on.
pub const JOINTS: [f64; 3] = [0.7, 0.8, 0.9];
/// Number of rotations and shifts that go with the curvature of the root: rotation of the root, its rise, rotations of joints.
pub const COMPLIANCES: usize = 2 + JOINTS.len();
/// Number of functions of bending: the curvature terms, then the compliances.
pub const BENDING_FUNCTIONS: usize = MAX_CURVATURE_TERMS + COMPLIANCES;

/// Curvature of the root per unit of the leading coefficient.
static ROOT_CURVATURE: LazyLock<f64> = LazyLock::new(|| curvature_basis(0.0)[0]);

/// Twists at the positions of the torques, arbitrary units.
static TORQUE_COMPLIANCES: LazyLock<[f64; 4]> =
    LazyLock::new(|| TORQUE_POSITIONS.map(torsional_compliance));

type RaiseCoefficients = [f64; RAISE_TERMS];
type BendingValues = [f64; BENDING_FUNCTIONS];
type TwistValues = [f64; TWIST_FUNCTIONS];
type TwistMotions = [SectionMotion; TWIST_FUNCTIONS];

/// Slopes at a fraction of the length per unit of each function of bending, times the length for the curvature terms.
fn bending_slopes(eta: f64, length_m: f64) -> BendingValues {
    let mut slopes = [0.0; BENDING_FUNCTIONS];
    let (terms, compliances) = slopes.split_at_mut(MAX_CURVATURE_TERMS);
    terms.copy_from_slice(&curvature_integrals(eta).map(|v| v * length_m));
    compliances[0] = 1.0;
    let given = JOINTS.map(|joint| if eta > joint { 1.0 } else { 0.0 });
    compliances[2..].copy_from_slice(&given);
    slopes
}

/// Basis of the twist at an arc length: s/L P_j(2 s/L - 1), then one function per torque: the twist it causes there over
/// the twist at its own position (constant outboard of it).
pub fn twist_basis(axis: &BendingAxis, arc_m: f64) -> TwistValues {
    let eta = arc_m / axis.length_m;
    let mut basis = [0.0; TWIST_FUNCTIONS];
    let (terms, torques) = basis.split_at_mut(MAX_TWIST_TERMS);
    terms.copy_from_slice(
        &legendre_polynomials::<MAX_TWIST_TERMS>(2.0 * eta - 1.0).map(|p| p * eta),
    );
    let positions = TORQUE_POSITIONS.into_iter().zip(*TORQUE_COMPLIANCES);
    for (value, (position, whole)) in torques.iter_mut().zip(positions) {
        *value = if eta < position {
            torsional_compliance(eta) / whole
        } else {
            1.0
        };
    }
    basis
}

/// Motion of the section at an arc length per unit of each function of the twist: twist inboard of a break carries what lies
/// outboard of it along about the inboard axis, to first order in the break.
fn twist_motions(axis: &BendingAxis, nose: f64, arc_m: f64) -> TwistMotions {
    let own = twist_basis(axis, arc_m);
    let mut motions = own.map(|twist_rad| SectionMotion {
        twist_rad,
        ..SectionMotion::default()
    });
    for (beyond_m, one) in axis.breaks_inboard_of(arc_m) {
        for ((motion, own), inboard) in motions
            .iter_mut()
            .zip(own)
            .zip(twist_basis(axis, one.arc_m))
        {
            let (carried, further) = (nose * inboard, nose * (own - inboard));
            motion.rotation_rad +=
                Vector3::new(0.0, -carried * one.turn_rad, further * one.sweep_rad);
            motion.displacement_m +=
                Vector3::new(0.0, -one.sweep_rad, one.turn_rad) * (carried * beyond_m);
        }
    }
    motions
}

/// Twist about the span at an arc length per unit of each function of bending: outboard of a break of the sweep the wing bends
/// about another chord.
fn twist_by_bending(axis: &BendingAxis, nose: f64, arc_m: f64) -> BendingValues {
    let slopes = |arc_m: f64| bending_slopes(arc_m / axis.length_m, axis.length_m);
    let mut twist = [0.0; BENDING_FUNCTIONS];
    for (_, one) in axis.breaks_inboard_of(arc_m) {
        for ((twist, own), inboard) in twist.iter_mut().zip(slopes(arc_m)).zip(slopes(one.arc_m)) {
            *twist -= nose * one.sweep_rad * (own - inboard);
        }
    }
    twist
}

/// Computes the twist that a torque causes from the root to a fraction of the length, in arbitrary units.
fn torsional_compliance(eta: f64) -> f64 {
    let (taper, power) = TORSION_TAPER_AND_POWER;
    (1.0 - (1.0 - taper) * eta).powf(1.0 - power) - 1.0
}

#[derive(Clone, Debug, PartialEq)]
struct QuadratureNode {
    /// Quadrature weight, m.
    weight_m: f64,
    /// Sine and cosine of the slope on the ground.
    slope: (f64, f64),
    bending_slopes: BendingValues,
    /// Slopes of the axis height corrections, 1/m.
    raise_slopes: RaiseCoefficients,
}

#[derive(Clone, Debug, PartialEq)]
struct GridPoint {
    /// Number of quadrature nodes inboard of the point.
    nodes: usize,
    slope_rad: f64,
    bending_slopes: BendingValues,
    twist_by_bending: BendingValues,
    by_twist: TwistMotions,
    /// Distance from the straight axis along Z, m.
    swept_m: f64,
    raises: RaiseCoefficients,
}

/// Arc lengths at which the beam is evaluated, with all quantities that do not change in flight.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamGrid {
    root_m: Vector3<f64>,
    nose: f64,
    nodes: Vec<QuadratureNode>,
    points: Vec<GridPoint>,
    /// Index from root to tip, for each point in the caller's order.
    ranks: Vec<usize>,
}

/// State of the axis at one grid point in flight, with derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamSection {
    /// Point on the axis, wing frame, m.
    pub axis_m: Vector3<f64>,
    /// d axis / d functions of bending: curvature coefficients, m^2, then compliances.
    pub axis_by_bending: [Vector3<f64>; BENDING_FUNCTIONS],
    pub slope_rad: f64,
    /// d slope / d functions of bending.
    pub slope_by_bending: BendingValues,
    /// Twist about the span, nose up positive, rad.
    pub twist_rad: f64,
    /// d twist / d functions of bending.
    pub twist_by_bending: BendingValues,
    /// Rotation vector by twist inboard of breaks, wing frame, rad.
    pub turned_rad: Vector3<f64>,
    /// d motion / d twist coefficients.
    pub by_twist: TwistMotions,
    /// Height of the axis on the ground above the surveyed axis, m.
    pub raise_m: f64,
    /// d raise / d height coefficients.
    pub raise_by_terms: RaiseCoefficients,
    /// d axis / d height coefficients.
    pub axis_by_raise: [Vector3<f64>; RAISE_TERMS],
}

/// Motion of a section, or its derivative with respect to an unknown, wing frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SectionMotion {
    /// Displacement of the bending axis, m.
    pub displacement_m: Vector3<f64>,
    /// Rotation vector without the twist, rad.
    pub rotation_rad: Vector3<f64>,
    /// Twist about the bending axis, nose up positive, rad.
    pub twist_rad: f64,
}

impl SectionMotion {
    /// Displacement without rotation.
    pub fn displacement(displacement_m: Vector3<f64>) -> Self {
        Self {
            displacement_m,
            ..Self::default()
        }
    }
}

/// Bending, twist and scale of a wing in flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bending<'a> {
    /// Coefficients of the curvature, 1/m.
    pub curvature_per_m: &'a [f64],
    /// Rotations (m) and rise (m^2) over the curvature of the root.
    pub compliances: [f64; COMPLIANCES],
    /// Coefficients of the twist, rad.
    pub twist_rad: &'a [f64],
    /// Length in flight over length on the ground.
    pub scale: f64,
    /// Height of the axis on the ground above the surveyed axis: coefficients of the powers of s/L, m.
    pub raise_m: RaiseCoefficients,
}

impl Bending<'_> {
    /// The shape on the ground.
    pub const UNBENT: Self = Self {
        curvature_per_m: &[],
        compliances: [0.0; COMPLIANCES],
        twist_rad: &[],
        scale: 1.0,
        raise_m: [0.0; RAISE_TERMS],
    };

    /// Rise of the root with the load, m.
    pub fn root_rise_m(&self) -> f64 {
        self.compliances[1] * self.root_curvature_per_m()
    }

    /// Curvature of the root by the leading coefficient, 1/m: the load to which compliances refer.
    fn root_curvature_per_m(&self) -> f64 {
        self.curvature_per_m
            .first()
            .map_or(0.0, |leading| leading * *ROOT_CURVATURE)
    }
}

impl BeamGrid {
    /// Creates a grid for these arc lengths, m, in any order.
    pub fn new(ground: &GroundShape, arcs_m: &[f64]) -> Self {
        let axis = &ground.axis;
        let mut order: Vec<usize> = (0..arcs_m.len()).collect();
        sort_by_value(&mut order, |&one| arcs_m[one]);
        let raises = |arc: f64| std::array::from_fn(|j| (arc / axis.length_m).powi(j as i32));
        let raise_slopes = |arc: f64| {
            std::array::from_fn(|j| match j {
                0 => 0.0,
                _ => j as f64 * (arc / axis.length_m).powi(j as i32 - 1) / axis.length_m,
            })
        };
        let slopes = |arc: f64| bending_slopes(arc / axis.length_m, axis.length_m);
        let joints = JOINTS.map(|joint| joint * axis.length_m);
        let mut grid = Self {
            root_m: axis.root_m,
            nose: ground.nose,
            nodes: vec![],
            points: vec![],
            ranks: vec![0; order.len()],
        };
        let mut from = 0.0;
        for (rank, &index) in order.iter().enumerate() {
            let to = arcs_m[index];
            grid.ranks[index] = rank;
            // No panel contains a break or a joint.
            let breaks = axis.breaks.iter().map(|one| one.arc_m).chain(joints);
            let mut ends: Vec<f64> = breaks.filter(|at| (from..to).contains(at)).collect();
            ends.sort_by(f64::total_cmp);
            for end in ends.into_iter().chain([to]) {
                let panels = ((end - from) / PANEL_M).ceil().max(0.0) as usize;
                let panel_m = (end - from) / panels.max(1) as f64;
                for (panel, (at, weight)) in (0..panels).flat_map(|p| GAUSS_POINTS.map(|g| (p, g)))
                {
                    let arc = from + panel_m * (panel as f64 + at);
                    let node = QuadratureNode {
                        weight_m: weight * panel_m,
                        slope: axis.slope_rad(arc).sin_cos(),
                        bending_slopes: slopes(arc),
                        raise_slopes: raise_slopes(arc),
                    };
                    grid.nodes.push(node);
                }
                from = end;
            }
            grid.points.push(GridPoint {
                nodes: grid.nodes.len(),
                slope_rad: axis.slope_rad(to),
                bending_slopes: slopes(to),
                twist_by_bending: twist_by_bending(axis, ground.nose, to),
                by_twist: twist_motions(axis, ground.nose, to),
                swept_m: axis.swept_m(to),
                raises: raises(to),
            });
        }
        grid
    }

    /// Computes the bent axis at every grid point, in the order given to [`BeamGrid::new`].
    pub fn bend(&self, bending: &Bending) -> Vec<BeamSection> {
        let mut at = AxisIntegrator::new(self.root_m, bending);
        let mut done = 0;
        let section = |stop: &GridPoint| {
            self.nodes[done..stop.nodes]
                .iter()
                .for_each(|node| at.step(node));
            done = stop.nodes;
            at.section_at(stop)
        };
        let sections: Vec<BeamSection> = self.points.iter().map(section).collect();
        self.ranks
            .iter()
            .map(|&rank| sections[rank].clone())
            .collect()
    }

    /// Bending root: the point at which bending starts, wing frame, m.
    pub fn root_m(&self) -> Vector3<f64> {
        self.root_m
    }
}

/// Running integral of the axis from root to tip.
struct AxisIntegrator<'a> {
    bending: &'a Bending<'a>,
    /// Values of the functions of bending.
    values: BendingValues,
    axis_m: Vector3<f64>,
    by_bending: [Vector3<f64>; BENDING_FUNCTIONS],
    by_raise: [Vector3<f64>; RAISE_TERMS],
}

fn dot_product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Adds to the derivative by the leading curvature what the compliances contribute, and scales those by compliances.
fn fold_compliances<T>(by: &mut [T; BENDING_FUNCTIONS], bending: &Bending)
where
    T: Copy + std::ops::Mul<f64, Output = T> + std::ops::AddAssign,
{
    let (terms, compliances) = by.split_at_mut(MAX_CURVATURE_TERMS);
    for (by, value) in compliances.iter_mut().zip(bending.compliances) {
        terms[0] += *by * (value * *ROOT_CURVATURE);
        *by = *by * bending.root_curvature_per_m();
    }
}

impl<'a> AxisIntegrator<'a> {
    fn new(root_m: Vector3<f64>, bending: &'a Bending) -> Self {
        /// Index of the root's rise among the functions of bending.
        const RISE: usize = MAX_CURVATURE_TERMS + 1;
        let mut values = [0.0; BENDING_FUNCTIONS];
        values
            .iter_mut()
            .zip(bending.curvature_per_m)
            .for_each(|(value, c)| *value = *c);
        let compliances = values
            .iter_mut()
            .skip(MAX_CURVATURE_TERMS)
            .zip(bending.compliances);
        compliances
            .for_each(|(value, compliance)| *value = compliance * bending.root_curvature_per_m());
        let (mut by_bending, mut by_raise): (
            [Vector3<f64>; BENDING_FUNCTIONS],
            [Vector3<f64>; RAISE_TERMS],
        ) = Default::default();
        (by_bending[RISE].y, by_raise[0].y) = (1.0, 1.0);
        let axis_m = root_m + Vector3::y() * (bending.raise_m[0] + values[RISE]);
        Self {
            bending,
            values,
            axis_m,
            by_bending,
            by_raise,
        }
    }

    /// Advances the axis by one quadrature node: bending rotates the raised ground tangent.
    fn step(&mut self, node: &QuadratureNode) {
        let (bending, length) = (self.bending, self.bending.scale * node.weight_m);
        let bent = dot_product(&self.values, &node.bending_slopes);
        let (bent_sin, bent_cos) = bent.sin_cos();
        let (ground_sin, ground_cos) = node.slope;
        let sin = ground_sin * bent_cos + ground_cos * bent_sin;
        let cos = ground_cos * bent_cos - ground_sin * bent_sin;
        let raised = dot_product(&bending.raise_m, &node.raise_slopes);
        let (dx, dy) = (
            length * (cos - raised * bent_sin),
            length * (sin + raised * bent_cos),
        );
        self.axis_m.x += dx;
        self.axis_m.y += dy;
        for (value, integral) in self.by_bending.iter_mut().zip(&node.bending_slopes) {
            value.x -= dy * integral;
            value.y += dx * integral;
        }
        for (value, slope) in self.by_raise.iter_mut().zip(&node.raise_slopes).skip(1) {
            value.x -= length * slope * bent_sin;
            value.y += length * slope * bent_cos;
        }
    }

    fn section_at(&self, stop: &GridPoint) -> BeamSection {
        let bending = self.bending;
        let (mut axis_by_bending, mut slope_by_bending) = (self.by_bending, stop.bending_slopes);
        let (mut twist_by_bending, mut by_twist) = (stop.twist_by_bending, stop.by_twist);
        fold_compliances(&mut axis_by_bending, bending);
        fold_compliances(&mut slope_by_bending, bending);
        fold_compliances(&mut twist_by_bending, bending);
        by_twist
            .iter_mut()
            .for_each(|by| by.displacement_m *= bending.scale);
        let mut section = BeamSection {
            axis_m: self.axis_m + Vector3::z() * (bending.scale * stop.swept_m),
            axis_by_bending,
            slope_rad: stop.slope_rad + dot_product(&self.values, &stop.bending_slopes),
            slope_by_bending,
            twist_rad: dot_product(&self.values, &stop.twist_by_bending),
            twist_by_bending,
            turned_rad: Vector3::zeros(),
            by_twist,
            raise_m: dot_product(&bending.raise_m, &stop.raises),
            raise_by_terms: stop.raises,
            axis_by_raise: self.by_raise,
        };
        for (by, twist) in by_twist.iter().zip(bending.twist_rad) {
            section.axis_m += by.displacement_m * *twist;
            section.turned_rad += by.rotation_rad * *twist;
            section.twist_rad += by.twist_rad * twist;
        }
        section
    }
}
