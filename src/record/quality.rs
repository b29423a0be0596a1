//! A record says how good its adjustment is and what that allowed for.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::GlobalTest;
use crate::measure::environment::RefractionReport;

/// Figures of an adjustment's quality, and what else was allowed for; what there is not is left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Quality {
    /// Iterations to convergence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Correlation of the mount's pitch with the amplitude of bending, -1 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pitch_bending_correlation: Option<f64>,
    /// Correlations of the parameters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub correlation: Option<Correlation>,
    /// Variance components, where they were estimated.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub variance_components: Vec<VarianceComponent>,
    /// The panes of the cabin window.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window: Option<Panes>,
    /// The transform into the CAD frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cad: Option<CadFit>,
    /// What the aircraft's data say of the frame, by quantity.
    #[serde(skip_serializing_if = "Map::is_empty")]
    pub aircraft: Map<String, Value>,
    /// Refraction at the cabin window.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refraction: Option<RefractionReport>,
}

impl Quality {
    /// Whether there is nothing in it.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Correlations of a solution's parameters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Their names, `curvature_per_m[0]` and so on.
    pub parameters: Vec<String>,
    /// Square, row by row, in that order; `None` with a parameter that was held.
    pub matrix: Vec<Vec<Option<f64>>>,
}

impl Correlation {
    /// The matrix where it is square, complete and has a name for each row.
    pub fn complete(&self) -> Option<Vec<Vec<f64>>> {
        let count = self.parameters.len();
        let square = self.matrix.len() == count && self.matrix.iter().all(|row| row.len() == count);
        let row = |row: &Vec<Option<f64>>| row.iter().copied().collect::<Option<Vec<_>>>();
        self.matrix.iter().map(row).collect::<Option<_>>().filter(|_| square)
    }

    /// Of two parameters by their names.
    pub fn of(&self, one: &str, other: &str) -> Option<f64> {
        let place = |name: &str| self.parameters.iter().position(|known| known == name);
        *self.matrix.get(place(one)?)?.get(place(other)?)?
    }
}

/// A group's variance component.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VarianceComponent {
    /// `image`, `survey` and the like.
    pub group: String,
    /// The component; the standard deviations stated are scaled by its root.
    pub factor: Option<f64>,
    /// Its standard deviation.
    pub sigma_factor: Option<f64>,
    /// The group's share of the redundancy.
    pub redundancy: Option<f64>,
}

/// Panes of a cabin window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Panes {
    /// Of all together, m.
    pub thickness_m: f64,
    /// m.
    pub sigma_thickness_m: f64,
    /// Refractive index against air.
    pub index: f64,
    /// Radius of the inner face under pressure, m; `null`: plane.
    pub bow_radius_m: Option<f64>,
    /// Whether the ground frames were taken through them too.
    pub same_on_ground: bool,
}

/// The transform from survey to CAD frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CadFit {
    /// `null` without redundancy.
    pub variance_factor: Option<f64>,
    /// Conditions less parameters.
    pub redundancy: usize,
    /// At a level of 1 %; `null` without redundancy.
    pub global_test: Option<GlobalTest>,
    /// CAD lengths over survey lengths.
    pub scale: f64,
    /// Of each tie point, CAD frame, m.
    pub residuals_m: Vec<[f64; 3]>,
}
