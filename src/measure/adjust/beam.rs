//! The beam in flight: curvature and twist to positions, with derivatives (docs/model.md).
//!
//! ```text
//! kappa(s) = m(s/L) sum c_k P_k(2 s/L - 1)      theta(s) = theta_ground(s) + integral kappa
//! phi(s)   = s/L sum t_j P_j(2 s/L - 1)         axis(s)  = root + scale * integral (cos, sin) theta
//! ```
//!
//! `P_k`: Legendre's polynomials. `m`: curvature of a tapered cantilever under an elliptic load,
//! mean 1. It carries the free end (no moment, hence no curvature) and the taper, so that few terms
//! follow a real wing to a millimetre where a plain polynomial of four terms leaves ten.

use std::sync::LazyLock;

use nalgebra::{Matrix3, Vector3};

use super::ground::{Axis, GroundShape, Station, wing_from_section};

/// Largest number of terms of the curvature.
pub const MAX_CURVATURE_TERMS: usize = 10;
/// Largest number of terms of the twist.
pub const MAX_TWIST_TERMS: usize = 6;

/// Chord at the tip over chord at the root, of the reference beam.
const TAPER: f64 = 0.3;
/// Bending stiffness goes with this power of the chord: skins of constant thickness.
const STIFFNESS_POWER: i32 = 3;
const TABLE: usize = 1025;
/// Longest panel of the integration, m.
const PANEL_M: f64 = 2.5;
/// Gauss-Legendre, three points on (0, 1).
const GAUSS: [(f64, f64); 3] =
    [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];

type Integrals = [f64; MAX_CURVATURE_TERMS];

/// Integrals of m P_k from 0 to eta, per unit of length.
static SHAPES: LazyLock<Vec<Integrals>> = LazyLock::new(shape_integrals);

/// Reference curvature over the span, not yet normalised: bending moment over stiffness.
fn reference_curvature() -> Vec<f64> {
    let step = 1.0 / (TABLE - 1) as f64;
    let load = |eta: f64| (1.0 - eta * eta).max(0.0).sqrt();
    let (mut shear, mut moment) = (0.0, 0.0);
    let mut curvature = vec![0.0; TABLE];
    for k in (0..TABLE - 1).rev() {
        let eta = k as f64 * step;
        let added = step * load(eta + 0.5 * step);
        moment += step * (shear + 0.5 * added);
        shear += added;
        let chord: f64 = 1.0 - (1.0 - TAPER) * eta;
        curvature[k] = moment / chord.powi(STIFFNESS_POWER);
    }
    curvature
}

fn shape_integrals() -> Vec<Integrals> {
    let step = 1.0 / (TABLE - 1) as f64;
    let curvature = reference_curvature();
    let mean = curvature.iter().sum::<f64>() * step;
    let value = |k: usize| {
        let p = legendre::<MAX_CURVATURE_TERMS>(2.0 * k as f64 * step - 1.0);
        p.map(|p| p * curvature[k] / mean)
    };
    let mut sums = vec![[0.0; MAX_CURVATURE_TERMS]; TABLE];
    for k in 1..TABLE {
        let (a, b) = (value(k - 1), value(k));
        let before = sums[k - 1];
        sums[k] = std::array::from_fn(|j| before[j] + 0.5 * step * (a[j] + b[j]));
    }
    sums
}

fn shapes_at(eta: f64) -> Integrals {
    let table = &*SHAPES;
    let at = eta.clamp(0.0, 1.0) * (TABLE - 1) as f64;
    let k = (at as usize).min(TABLE - 2);
    let t = at - k as f64;
    std::array::from_fn(|j| table[k][j] + t * (table[k + 1][j] - table[k][j]))
}

/// Legendre's polynomials of degree 0 to N - 1.
pub fn legendre<const N: usize>(x: f64) -> [f64; N] {
    let mut p = [1.0; N];
    if N > 1 {
        p[1] = x;
    }
    for k in 2..N {
        let n = k as f64;
        p[k] = ((2.0 * n - 1.0) * x * p[k - 1] - (n - 1.0) * p[k - 2]) / n;
    }
    p
}

/// Basis of the twist at an arc length: s/L P_j(2 s/L - 1).
pub fn twist_basis(axis: &Axis, arc_m: f64) -> [f64; MAX_TWIST_TERMS] {
    let eta = arc_m / axis.length_m;
    legendre::<MAX_TWIST_TERMS>(2.0 * eta - 1.0).map(|p| p * eta)
}

#[derive(Clone, Debug, PartialEq)]
struct Node {
    /// Weight of the quadrature, m.
    weight_m: f64,
    slope_rad: f64,
    integrals: Integrals,
}

#[derive(Clone, Debug, PartialEq)]
struct Stop {
    /// Number of nodes inboard.
    nodes: usize,
    slope_rad: f64,
    integrals: Integrals,
    twist: [f64; MAX_TWIST_TERMS],
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
    pub twist_by_terms: [f64; MAX_TWIST_TERMS],
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
}

impl Grid {
    /// For these arc lengths, in any order.
    pub fn new(ground: &GroundShape, arcs_m: &[f64]) -> Self {
        let axis = &ground.axis;
        let mut order: Vec<usize> = (0..arcs_m.len()).collect();
        order.sort_by(|&a, &b| arcs_m[a].total_cmp(&arcs_m[b]));
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
                };
                grid.nodes.push(node);
            }
            grid.stops.push(Stop {
                nodes: grid.nodes.len(),
                slope_rad: axis.slope_rad(to),
                integrals: integrals(to),
                twist: twist_basis(axis, to),
            });
            from = to;
        }
        grid.order = order;
        grid
    }

    /// The bent axis at every stop, in the order asked for at [`Grid::new`].
    pub fn bend(&self, bending: &Bending) -> Vec<Section> {
        let c = bending.curvature_per_m;
        let dot = |integrals: &Integrals| c.iter().zip(integrals).map(|(a, b)| a * b).sum::<f64>();
        let mut axis = self.root_m;
        let mut by_curvature = [Vector3::zeros(); MAX_CURVATURE_TERMS];
        let mut done = 0;
        let mut sections: Vec<Option<Section>> = vec![None; self.stops.len()];
        for (stop, &index) in self.stops.iter().zip(&self.order) {
            for node in &self.nodes[done..stop.nodes] {
                let (sin, cos) = (node.slope_rad + dot(&node.integrals)).sin_cos();
                let ds = bending.scale * node.weight_m;
                axis.x += ds * cos;
                axis.y += ds * sin;
                for (by, integral) in by_curvature.iter_mut().zip(&node.integrals).take(c.len()) {
                    by.x -= ds * sin * integral;
                    by.y += ds * cos * integral;
                }
            }
            done = stop.nodes;
            sections[index] = Some(Section {
                axis_m: axis,
                axis_by_curvature: by_curvature,
                slope_rad: stop.slope_rad + dot(&stop.integrals),
                slope_by_curvature: stop.integrals,
                twist_rad: bending.twist_rad.iter().zip(&stop.twist).map(|(a, b)| a * b).sum(),
                twist_by_terms: stop.twist,
            });
        }
        sections.into_iter().flatten().collect()
    }

    /// Arms on ground in section axes (tangent, normal, chord), m, per stop as asked for.
    pub fn mounts(&self, stations: &[Station]) -> Vec<Mount> {
        let ground = self.bend(&Bending { curvature_per_m: &[], twist_rad: &[], scale: 1.0 });
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
        let arm = self.section_from_wing * (ground_m - self.axis_m);
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
