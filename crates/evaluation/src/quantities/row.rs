//! Row of a table of results: the records that its values are read from.

use serde_json::{Map, Value};

use crate::aircraft::{AircraftState, JoinedValue, Quantity};
use crate::pipeline::curvature::CurvatureEstimate;
use crate::pipeline::live::LiveResult;
use crate::record::{
    CurveRecord, ImageRecord, MarkerRecord, MomentRecord, Term, TorsionRecord, json_text,
    variant_name,
};
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_store::{Inputs, installations};

/// Row of a table of results. A part that the row does not have is `None`.
#[derive(Clone, Copy, Default)]
pub struct ResultRow<'a> {
    /// Random id of the recorder's store.
    pub recorder_id: Option<&'a str>,
    pub flight: Option<&'a str>,
    /// Name of the series; `None` for a live result.
    pub series: Option<&'a str>,
    /// Number of the shot from 1; `None` for a live result.
    pub shot: Option<u32>,
    /// File name and SHA-256 of the frame.
    pub frame: Option<&'a str>,
    pub frame_sha256: Option<&'a str>,
    /// Failed attempts of the camera.
    pub failures: &'a [String],
    /// Time of the request to the camera; for a live result the middle of the exposure.
    pub stamp: Option<&'a Stamp>,
    pub exposure: Option<&'a Exposure>,
    /// Aircraft data at the exposure.
    pub aircraft: Option<&'a AircraftState>,
    pub image: Option<&'a ImageRecord>,
    /// Method of a stored live result.
    pub method: Option<&'a str>,
    pub inputs: Option<&'a ResultInputs>,
    pub live: Option<&'a LiveResult>,
    /// Curvature of a live result.
    pub curvature: Option<&'a CurvatureEstimate>,
    pub parameter: Option<&'a Term>,
    /// Index of the marker, the station, the pair or the coefficient in its list.
    pub index: Option<usize>,
    /// Name of the pair, if it has no index.
    pub pair_name: Option<&'a str>,
    /// Quantity of the aircraft data.
    pub quantity: Option<Quantity>,
}

impl<'a> ResultRow<'a> {
    pub(super) fn marker(&self) -> Option<&'a MarkerRecord> {
        self.image?.markers.get(self.index?)
    }

    pub(super) fn station(&self) -> Option<&'a CurveRecord> {
        self.image?.curve.get(self.index?)
    }

    pub(super) fn section(&self) -> Option<&'a MomentRecord> {
        self.image?.moments.get(self.index?)
    }

    pub(super) fn pair(&self) -> Option<&'a TorsionRecord> {
        let pairs = &self.image?.torsion;
        match self.pair_name {
            Some(name) => pairs.iter().find(|pair| pair.name == name),
            None => pairs.get(self.index?),
        }
    }

    pub(super) fn joined(&self) -> Option<&'a JoinedValue> {
        self.aircraft?.get(&self.quantity?)
    }

    /// Returns the key of the result, unique within a recorder: series and shot of a frame; for a live result the first 8
    /// digits of the boot id and the microseconds from boot to exposure.
    pub(super) fn result_id(&self) -> Option<String> {
        if let Some(series) = self.series {
            return Some(format!("{series}/{}", self.shot?));
        }
        let stamp = self.stamp?;
        let boot: String = stamp
            .boot_id
            .chars()
            .filter(char::is_ascii_alphanumeric)
            .take(8)
            .collect();
        Some(format!("{boot}/{:.0}", 1e6 * stamp.since_boot_s))
    }

    /// Returns the status of the image; a shot without a result has one too.
    pub(super) fn status(&self) -> Option<String> {
        let unsolved = || {
            self.series.map(|_| {
                if self.frame.is_some() {
                    "not solved"
                } else {
                    "no frame"
                }
                .to_owned()
            })
        };
        self.image
            .map(|image| variant_name(image.status))
            .or_else(unsolved)
    }
}

/// Inputs of a result, as text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultInputs {
    /// Name and version of the program.
    pub program: Option<String>,
    /// Digest of the installation, which is the name of its folder in the store.
    pub installation_sha256: Option<String>,
    /// Options of the adjustment as JSON.
    pub parameters: Option<String>,
    /// SHA-256 over all inputs.
    pub key: Option<String>,
}

impl ResultInputs {
    /// Collects the inputs from a result's provenance; `key` is their digest.
    pub fn new(provenance: &Map<String, Value>, key: Option<String>) -> Self {
        Self {
            program: provenance.get("program").map(json_text),
            installation_sha256: installations::digest_from_provenance(provenance),
            parameters: provenance.get("parameters").map(json_text),
            key,
        }
    }

    /// Collects the inputs of live results, whose provenance is all of them.
    pub fn from_provenance(provenance: &Map<String, Value>) -> Self {
        Self::new(
            provenance,
            (!provenance.is_empty()).then(|| Inputs::new(provenance.clone()).key("")),
        )
    }
}
