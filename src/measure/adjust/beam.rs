//! The beam in flight: curvature and twist to positions, with derivatives (docs/model.md).
//!
//! ```text
//! kappa(s) = m(s/L) sum c_k P_k(2 s/L - 1)      theta(s) = theta_ground(s) + integral kappa
//! phi(s)   = s/L sum t_j P_j(2 s/L - 1)         axis(s)  = root + scale * integral (cos, sin) theta
//! ```
//!
//! `P_k`: Legendre's polynomials; `m`: the reference curvature ([`super::shapes`]), mean 1.

use nalgebra::{Matrix3, Vector3};

use super::ground::{Axis, GroundShape, Station, wing_from_section};
use super::shapes::{Integrals, legendre, shapes_at};

pub use super::shapes::{MAX_CURVATURE_TERMS, curvature_basis};
/// Terms of the correction of the axis' height: powers of s/L, from the constant on.
pub const RAISE_TERMS: usize = 4;
/// Largest number of terms of the twist.
pub const MAX_TWIST_TERMS: usize = 6;
/// Where torques of control surfaces act, shares of the length: a flap's, ailerons', one at the tip. Between two of them the
/// twist's kink is told by both.
pub const TORQUES: [f64; 4] = [0.45, 0.6, 0.75, 0.9];
/// All functions that a twist is the sum of: the terms, then one for each torque.
pub const TWIST_BASIS: usize = MAX_TWIST_TERMS + TORQUES.len();
/// Chord at the tip over that at the root, and power of the chord that torsional stiffness goes with: of a usual wing.
const TORSION: (f64, f64) = (0.3, 3.3);

/// Longest panel of the integration, m.
const PANEL_M: f64 = 2.5;
/// Gauss-Legendre, three points on (0, 1).
const GAUSS: [(f64, f64); 3] =
    [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];

type Raises = [f64; RAISE_TERMS];

/// Basis of the twist at an arc length: s/L P_j(2 s/L - 1), then for each torque what it twists, which no farther outboard
/// grows, over that at its place.
pub fn twist_basis(axis: &Axis, arc_m: f64) -> [f64; TWIST_BASIS] {
    let eta = arc_m / axis.length_m;
    let mut basis = [0.0; TWIST_BASIS];
    let (terms, torques) = basis.split_at_mut(MAX_TWIST_TERMS);
    terms.copy_from_slice(&legendre::<MAX_TWIST_TERMS>(2.0 * eta - 1.0).map(|p| p * eta));
    for (by, place) in torques.iter_mut().zip(TORQUES) {
        *by = compliance(eta.min(place)) / compliance(place);
    }
    basis
}

/// What a torque twists from the root to a share of the length, of any unit.
fn compliance(eta: f64) -> f64 {
    let (taper, power) = TORSION;
    (1.0 - (1.0 - taper) * eta).powf(1.0 - power) - 1.0
}

#[derive(Clone, Debug, PartialEq)]
struct Node {
    /// Weight of the quadrature, m.
    weight_m: f64,
    slope_rad: f64,
    integrals: Integrals,
    /// Slopes of the axis' height corrections, 1/m.
    raise_slopes: Raises,
}

#[derive(Clone, Debug, PartialEq)]
struct Stop {
    /// Number of nodes inboard.
    nodes: usize,
    slope_rad: f64,
    integrals: Integrals,
    twist: [f64; TWIST_BASIS],
    raises: Raises,
}

/// Arc lengths where the beam is wanted, with everything about them that does not change in flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    root_m: Vector3<f64>,
    nose: f64,
    nodes: Vec<Node>,
    stops: Vec<Stop>,
    /// Position in the order asked for, per stop from root to tip.
    order: Vec<usize>,
}

/// The axis at one stop in flight, with derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    /// On the axis, wing frame, m.
    pub axis_m: Vector3<f64>,
    /// d axis / d curvature coefficients, m^2.
    pub axis_by_curvature: [Vector3<f64>; MAX_CURVATURE_TERMS],
    /// Slope, rad.
    pub slope_rad: f64,
    /// d slope / d curvature coefficients, m.
    pub slope_by_curvature: Integrals,
    /// Twist, nose up positive, rad.
    pub twist_rad: f64,
    /// d twist / d twist coefficients.
    pub twist_by_terms: [f64; TWIST_BASIS],
    /// Height of the axis on ground over the surveyed one, m.
    pub raise_m: f64,
    /// d raise / d its coefficients.
    pub raise_by_terms: Raises,
    /// d axis / d the raise's coefficients.
    pub axis_by_raise: [Vector3<f64>; RAISE_TERMS],
}

/// What bends the wing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bending<'a> {
    /// Coefficients of the curvature, 1/m.
    pub curvature_per_m: &'a [f64],
    /// Coefficients of the twist, rad.
    pub twist_rad: &'a [f64],
    /// Length in flight over length on ground.
    pub scale: f64,
    /// Height of the axis on ground over the surveyed one: coefficients of the powers of s/L, m.
    pub raise_m: Raises,
}

impl Bending<'_> {
    /// As on ground.
    pub const NONE: Self =
        Self { curvature_per_m: &[], twist_rad: &[], scale: 1.0, raise_m: [0.0; RAISE_TERMS] };
}

impl Grid {
    /// For these arc lengths, in any order.
    pub fn new(ground: &GroundShape, arcs_m: &[f64]) -> Self {
        let axis = &ground.axis;
        let mut order: Vec<usize> = (0..arcs_m.len()).collect();
        order.sort_by(|&a, &b| arcs_m[a].total_cmp(&arcs_m[b]));
        let raises = |arc: f64| std::array::from_fn(|j| (arc / axis.length_m).powi(j as i32));
        let raise_slopes = |arc: f64| {
            std::array::from_fn(|j| match j {
                0 => 0.0,
                _ => j as f64 * (arc / axis.length_m).powi(j as i32 - 1) / axis.length_m,
            })
        };
        let integrals = |arc: f64| shapes_at(arc / axis.length_m).map(|v| v * axis.length_m);
        let mut grid =
            Self { root_m: axis.root_m, nose: ground.nose, nodes: vec![], stops: vec![], order: vec![] };
        let mut from = 0.0;
        for &index in &order {
            let to = arcs_m[index];
            let panels = ((to - from) / PANEL_M).ceil().max(0.0) as usize;
            let width = (to - from) / panels.max(1) as f64;
            for (panel, (at, weight)) in (0..panels).flat_map(|p| GAUSS.map(|g| (p, g))) {
                let arc = from + width * (panel as f64 + at);
                let node = Node {
                    weight_m: weight * width,
                    slope_rad: axis.slope_rad(arc),
                    integrals: integrals(arc),
                    raise_slopes: raise_slopes(arc),
                };
                grid.nodes.push(node);
            }
            grid.stops.push(Stop {
                nodes: grid.nodes.len(),
                slope_rad: axis.slope_rad(to),
                integrals: integrals(to),
                twist: twist_basis(axis, to),
                raises: raises(to),
            });
            from = to;
        }
        grid.order = order;
        grid
    }

    /// The bent axis at every stop, in the order asked for at [`Grid::new`].
    pub fn bend(&self, bending: &Bending) -> Vec<Section> {
        let mut at =
            Walk { axis_m: self.root_m, by_curvature: Default::default(), by_raise: Default::default() };
        at.axis_m.y += bending.raise_m[0];
        at.by_raise[0].y = 1.0;
        let mut done = 0;
        let mut sections: Vec<Option<Section>> = vec![None; self.stops.len()];
        for (stop, &index) in self.stops.iter().zip(&self.order) {
            self.nodes[done..stop.nodes].iter().for_each(|node| at.step(node, bending));
            done = stop.nodes;
            sections[index] = Some(at.section(stop, bending));
        }
        sections.into_iter().flatten().collect()
    }

    /// Arms on ground in section axes (tangent, normal, chord), m, per stop as asked for.
    pub fn mounts(&self, stations: &[Station]) -> Vec<Mount> {
        let ground = self.bend(&Bending::NONE);
        let mount = |(section, _): (&Section, &Station)| Mount {
            section_from_wing: wing_from_section(section.slope_rad).transpose(),
            axis_m: section.axis_m,
            nose: self.nose,
        };
        ground.iter().zip(stations).map(mount).collect()
    }

    /// Where bending starts, wing frame, m.
    pub fn root_m(&self) -> Vector3<f64> {
        self.root_m
    }
}

/// The axis on its way from the root to the tip.
struct Walk {
    axis_m: Vector3<f64>,
    by_curvature: [Vector3<f64>; MAX_CURVATURE_TERMS],
    by_raise: [Vector3<f64>; RAISE_TERMS],
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Walk {
    /// The ground axis' tangent, raised, is turned by the bending.
    fn step(&mut self, node: &Node, bending: &Bending) {
        let (c, length) = (bending.curvature_per_m, bending.scale * node.weight_m);
        let bent = dot(c, &node.integrals);
        let (sin, cos) = (node.slope_rad + bent).sin_cos();
        let (bent_sin, bent_cos) = bent.sin_cos();
        let raised = dot(&bending.raise_m, &node.raise_slopes);
        let (dx, dy) = (length * (cos - raised * bent_sin), length * (sin + raised * bent_cos));
        self.axis_m.x += dx;
        self.axis_m.y += dy;
        for (by, integral) in self.by_curvature.iter_mut().zip(&node.integrals).take(c.len()) {
            by.x -= dy * integral;
            by.y += dx * integral;
        }
        for (by, slope) in self.by_raise.iter_mut().zip(&node.raise_slopes).skip(1) {
            by.x -= length * slope * bent_sin;
            by.y += length * slope * bent_cos;
        }
    }

    fn section(&self, stop: &Stop, bending: &Bending) -> Section {
        Section {
            axis_m: self.axis_m,
            axis_by_curvature: self.by_curvature,
            slope_rad: stop.slope_rad + dot(bending.curvature_per_m, &stop.integrals),
            slope_by_curvature: stop.integrals,
            twist_rad: dot(bending.twist_rad, &stop.twist),
            twist_by_terms: stop.twist,
            raise_m: dot(&bending.raise_m, &stop.raises),
            raise_by_terms: stop.raises,
            axis_by_raise: self.by_raise,
        }
    }
}

/// How a marker sits on its section: fixed on ground, rigid in flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    section_from_wing: Matrix3<f64>,
    axis_m: Vector3<f64>,
    nose: f64,
}

/// A marker in flight with derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// Wing frame, m.
    pub position_m: Vector3<f64>,
    /// d position / d slope, m.
    pub by_slope: Vector3<f64>,
    /// d position / d twist, m.
    pub by_twist: Vector3<f64>,
    /// d position / d position on ground.
    pub by_ground: Matrix3<f64>,
}

impl Mount {
    /// Carries a point that is at `ground_m` (wing frame) on ground along with its section.
    pub fn carry(&self, section: &Section, ground_m: &Vector3<f64>, scale: f64) -> Carried {
        let axis_m = self.axis_m + Vector3::y() * section.raise_m;
        let arm = self.section_from_wing * (ground_m - axis_m);
        let (sin, cos) = (self.nose * section.twist_rad).sin_cos();
        let twist = Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos);
        let wing = wing_from_section(section.slope_rad) * scale;
        let a = twist * arm;
        Carried {
            position_m: section.axis_m + wing * a,
            by_slope: wing * Vector3::new(-a.y, a.x, 0.0),
            by_twist: wing * Vector3::new(0.0, -a.z, a.y) * self.nose,
            by_ground: wing * twist * self.section_from_wing,
        }
    }
}
