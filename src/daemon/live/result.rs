//! A live frame's result is given out as a line of JSON and as a datagram (docs/live.md).

use std::fmt::Write as _;

use serde::Serialize;

use crate::clock::exposure::Exposure;
use crate::daemon::capture::Taken;
use crate::daemon::status::Health;
use crate::pipeline::guided::Search;
use crate::pipeline::live::{Curvature, Outline, Tracked};
use crate::record::{GlobalTest, ImageRecord, Status, word};

/// A frame on its way to be solved.
pub(crate) struct LiveFrame {
    /// Counted since the start, from 1; the gaps are frames that were skipped.
    pub number: u64,
    /// The frame.
    pub taken: Taken,
}

impl LiveFrame {
    /// As its result names it.
    pub fn name(&self) -> String {
        let source = self.taken.frame.settings.get("source").and_then(|name| name.as_str());
        source.map_or_else(|| format!("live {}", self.number), str::to_owned)
    }

    /// When it was exposed, since boot, s.
    pub fn at_s(&self) -> f64 {
        self.taken.exposure.exposure_since_boot_s
    }
}

/// A frame's result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveResult {
    /// Of the frame, since the start, from 1.
    pub number: u64,
    /// When it was exposed.
    #[serde(flatten)]
    pub exposure: Exposure,
    /// From the middle of the exposure to this result, ms.
    pub latency_ms: f64,
    /// Frames skipped since the start.
    pub skipped: u64,
    /// The whole frame, or guided by the one before.
    pub search: Search,
    /// Which mounting of the camera, from 1; 0 before the first solution.
    pub mounting: usize,
    /// This frame showed a mount disturbance.
    pub mount_disturbed: bool,
    /// What was detected.
    pub outlines: Vec<Outline>,
    /// In the store, for moments; not in the line, whose record has the coefficients.
    #[serde(skip)]
    pub curvature: Option<Curvature>,
    /// The result as everywhere, without provenance and correlations.
    #[serde(flatten)]
    pub record: ImageRecord,
}

/// Points of the curve that a datagram has.
pub const DATAGRAM_POINTS: usize = 11;

impl LiveResult {
    pub(crate) fn new(frame: &LiveFrame, tracked: Tracked, latency_ms: f64, skipped: u64) -> Self {
        let Tracked { record, search, mounting, mount_disturbed, outlines, curvature } = tracked;
        let (number, exposure) = (frame.number, frame.taken.exposure.clone());
        Self {
            number,
            exposure,
            latency_ms,
            skipped,
            search,
            mounting,
            mount_disturbed,
            outlines,
            curvature,
            record,
        }
    }

    /// Whether it has numbers.
    pub fn solved(&self) -> bool {
        self.record.status == Status::Ok
    }

    /// Whether its global test rejects: its standard deviations are in doubt.
    pub fn rejected(&self) -> bool {
        self.record.global_test == Some(GlobalTest::Rejected)
    }

    /// Deflection of the outermost marker, m.
    pub fn tip_deflection_m(&self) -> Option<f64> {
        self.record.tip.as_ref().filter(|_| self.solved()).map(|tip| tip.deflection_m)
    }

    /// One object, without a line's end.
    pub fn line(&self) -> String {
        serde_json::to_string(self).unwrap_or_else(|error| {
            serde_json::json!({ "number": self.number, "error": error.to_string() }).to_string()
        })
    }

    /// ASCII, fields between commas, empty where there is no number; at most 1400 bytes. docs/live.md has the list.
    pub fn datagram(&self, health: Health) -> String {
        let mut text = format!("WINGD1,{}", self.exposure.exposure_time.strftime("%Y-%m-%dT%H:%M:%S%.3f"));
        let mut field = |value: Option<f64>, digits: usize| {
            text.push(',');
            if let Some(value) = value.filter(|value| value.is_finite()) {
                // Writing to a string does not fail.
                let _ = write!(text, "{value:.digits$}");
            }
        };
        let record = &self.record;
        let flag = |yes: bool| Some(f64::from(u8::from(yes)));
        field(self.exposure.utc_sigma_s(), 4);
        field(Some(self.number as f64), 0);
        field(flag(self.solved()), 0);
        field(flag(self.mount_disturbed), 0);
        field(Some(self.mounting as f64), 0);
        field(Some(self.skipped as f64), 0);
        field(Some(self.latency_ms), 1);
        field(record.variance_factor, 3);
        field(self.tip_deflection_m(), 4);
        field(record.tip.as_ref().and_then(|tip| tip.sigma_deflection_m), 4);
        let twist = record.torsion.first();
        field(twist.and_then(|t| t.twist_deg), 3);
        field(twist.and_then(|t| t.sigma_twist_deg), 3);
        let points = if record.curve.is_empty() { 0 } else { DATAGRAM_POINTS };
        field(Some(points as f64), 0);
        for k in 0..points {
            let at = (record.curve.len() - 1) * k / (DATAGRAM_POINTS - 1);
            let point = record.curve.get(at);
            field(point.map(|p| p.arc_length_m), 2);
            field(point.map(|p| p.deflection_m), 4);
            field(point.and_then(|p| p.sigma_deflection_m), 4);
        }
        field(record.global_test.and_then(|_| flag(self.rejected())), 0);
        let _ = write!(text, ",{}\r\n", word(health));
        text
    }
}

/// A result, or the recorder's state, as the listeners get it.
pub(crate) struct Given {
    /// The state, which only those get that ask for it, and the datagrams.
    pub state: bool,
    /// JSON, without a line's end.
    pub line: String,
    /// ASCII.
    pub datagram: String,
}
