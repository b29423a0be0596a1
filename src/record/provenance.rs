//! A record says what its numbers follow from and what each stage took.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::Method;
use crate::measure::adjust::{Options, SigmaKind};

/// What a result follows from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// Name and version.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<String>,
    /// `<file>.sha256` of every file of the installation -> SHA-256; other programs' inputs by their names.
    #[serde(flatten)]
    pub files: Map<String, Value>,
    /// What was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parameters: Option<Parameters>,
    /// Of the frame.
    #[serde(rename = "frame.sha256", skip_serializing_if = "Option::is_none")]
    pub frame_sha256: Option<String>,
}

impl Provenance {
    /// Whether nothing is said.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Choices of an adjustment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Parameters {
    /// How the deflection is modelled.
    pub method: Method,
    /// Terms of the curvature; `null`: chosen by test.
    pub curvature_terms: Option<usize>,
    /// Terms of the twist.
    pub twist_terms: usize,
    /// Variance components are estimated.
    pub variance_components: bool,
    /// Level of significance of the global test.
    pub global_alpha: f64,
    /// Level of significance of the w-test; 0: no data snooping.
    pub snooping_alpha: f64,
    /// Which standard deviations are asked for.
    pub sigma: SigmaKind,
}

impl Parameters {
    /// Of a method with its options.
    pub fn new(method: Method, options: &Options) -> Self {
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

impl Default for Parameters {
    fn default() -> Self {
        Self::new(Method::default(), &Options::default())
    }
}

/// Durations of the stages, ms to a thousandth; `None` for one that was not come to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Timing {
    /// Bytes to a grey picture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decode: Option<f64>,
    /// Markers in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detect: Option<f64>,
    /// Their names.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identify: Option<f64>,
    /// The adjustment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub solve: Option<f64>,
}

impl Timing {
    /// All stages together, ms.
    pub fn total(&self) -> f64 {
        [self.decode, self.detect, self.identify, self.solve].into_iter().flatten().sum()
    }
}
