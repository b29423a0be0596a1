//! Inputs of a result (hashes, program version, parameters) and the duration of each stage.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use wingd_measure::adjust::AdjustmentMethod;
use wingd_measure::adjust::Options;
use wingd_measure::estimation::quality::SigmaKind;

/// Inputs that a result was computed from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// Name and version of the program.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<String>,
    /// `<file>.sha256` -> SHA-256 for every file of the installation; inputs of other programs under their names.
    #[serde(flatten)]
    pub files: Map<String, Value>,
    /// Parameters of the adjustment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parameters: Option<Parameters>,
    /// SHA-256 of the frame.
    #[serde(rename = "frame.sha256", skip_serializing_if = "Option::is_none")]
    pub frame_sha256: Option<String>,
}

impl Provenance {
    /// Returns whether no input is recorded.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Parameters of an adjustment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Parameters {
    /// Deflection model.
    #[serde(with = "super::blank_method")]
    pub method: Option<AdjustmentMethod>,
    /// Number of curvature terms; `null`: 10 in single frames, 8 in flights.
    pub curvature_terms: Option<usize>,
    /// Number of twist terms.
    pub twist_terms: usize,
    /// True if variance components are estimated.
    pub variance_components: bool,
    /// Significance level of the global test.
    pub global_alpha: f64,
    /// Significance level of the w-test; 0: no data snooping.
    pub snooping_alpha: f64,
    /// Requested kind of standard deviations.
    pub sigma: SigmaKind,
}

impl Parameters {
    /// Creates the parameters of a method with its options.
    pub fn new(method: Option<AdjustmentMethod>, options: &Options) -> Self {
        Self {
            method,
            curvature_terms: options.curvature_terms,
            twist_terms: options.twist_terms,
            variance_components: options.variance_components,
            global_alpha: options.global_alpha,
            snooping_alpha: options.snooping_alpha,
            sigma: options.sigma,
        }
    }
}

impl Parameters {
    /// Returns the options of an adjustment with these parameters.
    pub fn options(&self) -> Options {
        Options {
            curvature_terms: self.curvature_terms,
            twist_terms: self.twist_terms,
            variance_components: self.variance_components,
            global_alpha: self.global_alpha,
            snooping_alpha: self.snooping_alpha,
            sigma: self.sigma,
            ..Options::default()
        }
    }
}

impl Default for Parameters {
    fn default() -> Self {
        Self::new(None, &Options::default())
    }
}

/// Durations of the stages, ms, rounded to 0.001; `None` for a stage that was not reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Timing {
    /// Decoding of the file to a grey image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decode: Option<f64>,
    /// Detection of markers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detect: Option<f64>,
    /// Identification of the detected markers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identify: Option<f64>,
    /// Adjustment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub solve: Option<f64>,
}

impl Timing {
    /// Returns the sum of all stages, ms.
    pub fn total(&self) -> f64 {
        [self.decode, self.detect, self.identify, self.solve]
            .into_iter()
            .flatten()
            .sum()
    }
}
