//! Position of a surface's nodes relative to the wing, and the cause if they are not on it.

use std::path::Path;

use super::{Surface, SurfaceFormat, surface_fault};
use crate::desk::TaskResult;
use crate::installation::{LENGTH_UNITS, LengthUnit};
use crate::measure::deformation::WingDeformation;

/// Distance from the bending axis over its length beyond which a node belongs to another part: the longest chord of an
/// airliner, at the fuselage, is 0.4 of the length, and no node is a chord from the axis.
const FAR_FRACTION: f64 = 0.4;
/// Arc length over the length of the axis beyond which a node belongs to another part: winglets end at 1.1.
const END_FRACTION: f64 = 1.25;
/// Fraction of far nodes outboard of the root beyond which the surface is not that of the wing as given.
const MAX_FAR_FRACTION: f64 = 0.5;
/// Largest such fraction in a unit or in axes that are named as the cause.
const MAX_STRAY_FRACTION: f64 = 0.2;
/// Arc length by which a node must be outboard of a marker, m: less is rounding.
const SAME_STATION_M: f64 = 1e-3;
/// Number of nodes that are tried with other units and axes.
const TRIED_NODES: usize = 10_000;

/// Numbers of nodes by their position relative to the wing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeCounts {
    /// All nodes.
    pub all: usize,
    /// Nodes inboard of the bending root, which do not move.
    pub inboard: usize,
    /// Nodes outboard of the outermost marker, where the shape is extrapolated.
    pub beyond_marker: usize,
    /// Moved nodes that are too far from the axis to belong to the wing.
    pub far: usize,
}

impl NodeCounts {
    /// Counts nodes in a unit of length; `outermost_m`: arc length of the outermost marker.
    fn new(
        surface: &Surface,
        unit: LengthUnit,
        wing: &WingDeformation,
        outermost_m: f64,
        step: usize,
    ) -> Self {
        let mut counts = Self::default();
        for point in surface.points.iter().step_by(step.max(1)) {
            let foot = wing.find_foot(&(point * unit.metres));
            let is_inboard = foot.arc_m <= 0.0;
            let is_far = foot.distance_m > FAR_FRACTION * wing.length_m()
                || foot.arc_m > END_FRACTION * wing.length_m();
            counts.all += 1;
            counts.inboard += usize::from(is_inboard);
            counts.far += usize::from(!is_inboard && is_far);
            counts.beyond_marker +=
                usize::from(!is_far && foot.arc_m > outermost_m + SAME_STATION_M);
        }
        counts
    }

    fn moved(&self) -> usize {
        self.all - self.inboard
    }

    /// Returns warnings about nodes whose motion is less certain than it looks.
    pub fn warnings(&self) -> Vec<String> {
        let Self {
            all,
            beyond_marker,
            far,
            ..
        } = self;
        let beyond = format!(
            "{beyond_marker} of {all} nodes are beyond the outermost marker: their motion is extrapolated by the model of the wing"
        );
        let parts = format!(
            "{far} of {all} nodes are farther from the bending axis than any chord, but moved with its sections; give the wing without other parts"
        );
        [(*beyond_marker, beyond), (*far, parts)]
            .into_iter()
            .filter(|(n, _)| *n > 0)
            .map(|(_, text)| text)
            .collect()
    }
}

/// The deformation in the axes that were not chosen, with the remedy if the surface is in these.
pub struct OtherAxes<'a> {
    /// Deformation in the other axes.
    pub wing: &'a WingDeformation,
    /// Remedy, such as to add an option.
    pub remedy: &'static str,
}

/// Counts the nodes by their position relative to the wing; `outermost_m`: arc length of the outermost marker.
///
/// # Errors
/// Returns an error if the surface is not on the wing; it names the unit or the axes in which it would be.
pub fn check_nodes(
    file: &Path,
    surface: &Surface,
    wing: &WingDeformation,
    outermost_m: f64,
    other: Option<OtherAxes>,
) -> TaskResult<NodeCounts> {
    let counts = NodeCounts::new(surface, surface.unit, wing, outermost_m, 1);
    let problem = if counts.moved() == 0 {
        "no node is outboard of the bending root".to_owned()
    } else if counts.far as f64 > MAX_FAR_FRACTION * counts.moved() as f64 {
        format!(
            "{} of {} nodes are farther from the bending axis than any chord",
            counts.far, counts.all
        )
    } else {
        return Ok(counts);
    };
    let step = surface.points.len().div_ceil(TRIED_NODES);
    let count_near = |unit: &LengthUnit, wing: &WingDeformation| {
        let tried = NodeCounts::new(surface, *unit, wing, outermost_m, step);
        let is_on_wing = tried.far as f64 <= MAX_STRAY_FRACTION * tried.moved() as f64;
        if is_on_wing {
            tried.moved() - tried.far
        } else {
            0
        }
    };
    let unit = surface.unit.name;
    let find_unit = |wing: &WingDeformation| {
        let best = LENGTH_UNITS
            .iter()
            .max_by_key(|one| count_near(one, wing))?;
        (count_near(best, wing) > 0).then_some(best.name)
    };
    let add_unit = |name: &str| {
        let remedy = match surface.format {
            SurfaceFormat::Nodes => format!("write x_{name},y_{name},z_{name} in its header"),
            _ => format!("add --unit {name}"),
        };
        format!("its coordinates are in {name}, not {unit}: {remedy}")
    };
    let remedy = match (find_unit(wing), other.map(|other| (find_unit(other.wing), other.remedy))) {
        (Some(name), _) if name != unit => add_unit(name),
        (None, Some((Some(name), remedy))) if name == unit => remedy.to_owned(),
        (None, Some((Some(name), remedy))) => format!("{}; {remedy}", add_unit(name)),
        _ => {
            "give the surface of the measured wing in the axes of the survey, or of the CAD model with --cad".to_owned()
        }
    };
    Err(surface_fault(file, problem, remedy))
}
