//! Quality figures of an adjustment and the corrections that were applied.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use wingd_measure::environment::RefractionReport;
use wingd_measure::estimation::VarianceComponent;
use wingd_measure::estimation::quality::GlobalTest;

/// Quality figures of an adjustment and the corrections applied; absent values are omitted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Quality {
    /// Iterations to convergence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Correlation of the mount's pitch with the bending amplitude, -1 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pitch_bending_correlation: Option<f64>,
    /// Correlations of the parameters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub correlation: Option<Correlation>,
    /// Variance components, if they were estimated.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub variance_components: Vec<VarianceComponent>,
    /// Panes of the cabin window.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window: Option<Panes>,
    /// Transform into the CAD frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cad: Option<CadFit>,
    /// Aircraft data at the time of the frame, by quantity.
    #[serde(skip_serializing_if = "Map::is_empty")]
    pub aircraft: Map<String, Value>,
    /// Refraction at the cabin window.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refraction: Option<RefractionReport>,
}

impl Quality {
    /// Returns whether no figure is present.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Correlation matrix of a solution's parameters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Parameter names, `curvature_per_m[0]` and so on.
    pub parameters: Vec<String>,
    /// Square matrix, row by row, in the order of `parameters`; `None` for a parameter that was held fixed.
    pub matrix: Vec<Vec<Option<f64>>>,
}

impl Correlation {
    /// Returns the correlation of two parameters, given by name.
    pub fn coefficient(&self, one: &str, other: &str) -> Option<f64> {
        let place = |name: &str| self.parameters.iter().position(|known| known == name);
        *self.matrix.get(place(one)?)?.get(place(other)?)?
    }
}

/// Panes of a cabin window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Panes {
    /// Total thickness of all panes, m.
    pub thickness_m: f64,
    pub sigma_thickness_m: f64,
    /// Refractive index relative to air.
    pub index: f64,
    /// Radius of the inner face under pressure, m; `null`: plane.
    pub bow_radius_m: Option<f64>,
    /// True if the ground frames were taken through the same panes.
    pub same_on_ground: bool,
}

/// Transform from survey to CAD frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CadFit {
    /// Variance factor; `null` without redundancy.
    pub variance_factor: Option<f64>,
    /// Number of conditions minus number of parameters.
    pub redundancy: usize,
    /// Verdict of the global test at a level of 1 %; `null` without redundancy.
    pub global_test: Option<GlobalTest>,
    /// Ratio of CAD lengths to survey lengths.
    pub scale: f64,
    /// Rows of the transform: homogeneous CAD coordinates from survey coordinates, m.
    pub transform: [[f64; 4]; 4],
    /// Covariance of small rotation (CAD frame, applied after the transform's, rad), translation (m) and scale: 7 rows; scaled by the
    /// variance factor if the test rejects.
    pub covariance: Vec<Vec<f64>>,
    /// Direction aft in the survey frame, unit length; `null` without `cad.aft`.
    pub aft: Option<[f64; 3]>,
    /// Names of the tie points.
    pub tie_points: Vec<String>,
    /// Residuals of the tie points in the CAD frame, m.
    pub residuals_m: Vec<[f64; 3]>,
}

impl CadFit {
    /// Describes the tie points' test, the scale and the largest residual in one line.
    pub fn describe(&self) -> String {
        let verdict = match self.global_test {
            Some(GlobalTest::Passed) => "test passed",
            Some(GlobalTest::Rejected) => "test rejected",
            None => "no test",
        };
        let factor = self.variance_factor.map_or(String::new(), |factor| {
            format!(", variance factor {factor:.2}")
        });
        let length_m = |r: &[f64; 3]| r.iter().fold(0.0, |sum: f64, v| sum.hypot(*v));
        let largest_m = self.residuals_m.iter().map(length_m).fold(0.0, f64::max);
        let (count, scale) = (self.residuals_m.len(), self.scale);
        format!(
            "{count} tie points, {verdict}{factor}, scale {scale:.5}, largest residual {:.1} mm",
            1e3 * largest_m
        )
    }
}
