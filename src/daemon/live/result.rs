//! Result of a live frame, as a line of JSON and as a datagram (docs/live.md).

use std::fmt::Write as _;

use crate::daemon::capture::CapturedFrame;
use crate::daemon::status::Health;
use crate::pipeline::live::{LiveResult, TrackedFrame};
use crate::record::variant_name;

/// A frame on its way to be solved.
pub(crate) struct LiveFrame {
    /// Number since the start, from 1; gaps are skipped frames.
    pub number: u64,
    /// Captured frame.
    pub taken: CapturedFrame,
}

impl LiveFrame {
    /// Returns the frame's name in its result.
    pub fn name(&self) -> String {
        let source = self
            .taken
            .frame
            .settings
            .get("source")
            .and_then(|name| name.as_str());
        source.map_or_else(|| format!("live {}", self.number), str::to_owned)
    }

    /// Returns the time of exposure since boot, s.
    pub fn exposed_at_s(&self) -> f64 {
        self.taken.exposure.exposure_since_boot_s
    }
}

/// Number of points of the curve in a datagram.
pub const DATAGRAM_POINTS: usize = 11;

impl LiveResult {
    pub(crate) fn new(
        frame: &LiveFrame,
        tracked: TrackedFrame,
        latency_ms: f64,
        skipped: u64,
    ) -> Self {
        Self {
            number: frame.number,
            exposure: frame.taken.exposure.clone(),
            latency_ms,
            skipped,
            tracked,
        }
    }

    /// Returns the deflection of the outermost marker, m.
    pub fn tip_deflection_m(&self) -> Option<f64> {
        self.tracked
            .record
            .tip
            .as_ref()
            .filter(|_| self.is_solved())
            .map(|tip| tip.deflection_m)
    }

    /// Returns the result as one JSON object without a line end.
    pub fn json_line(&self) -> String {
        serde_json::to_string(self).unwrap_or_else(|error| {
            serde_json::json!({ "number": self.number, "error": error.to_string() }).to_string()
        })
    }

    /// Returns the result as a datagram: ASCII, fields separated by commas, empty if a number is missing; at most 1400
    /// bytes. docs/live.md lists the fields.
    pub fn datagram(&self, health: Health) -> String {
        let mut text = format!(
            "WINGD1,{}",
            self.exposure
                .exposure_time
                .strftime("%Y-%m-%dT%H:%M:%S%.3f")
        );
        let mut field = |value: Option<f64>, digits: usize| {
            text.push(',');
            if let Some(value) = value.filter(|value| value.is_finite()) {
                // Writing to a string does not fail.
                let _ = write!(text, "{value:.digits$}");
            }
        };
        let record = &self.tracked.record;
        let flag = |yes: bool| Some(f64::from(u8::from(yes)));
        field(self.exposure.utc_sigma_s(), 4);
        field(Some(self.number as f64), 0);
        field(flag(self.is_solved()), 0);
        field(flag(self.tracked.mount_disturbed), 0);
        field(Some(self.tracked.mounting as f64), 0);
        field(Some(self.skipped as f64), 0);
        field(Some(self.latency_ms), 1);
        field(record.variance_factor, 3);
        field(self.tip_deflection_m(), 4);
        field(
            record.tip.as_ref().and_then(|tip| tip.sigma_deflection_m),
            4,
        );
        let twist = record.torsion.first();
        field(twist.and_then(|t| t.twist_deg), 3);
        field(twist.and_then(|t| t.sigma_twist_deg), 3);
        let points = if record.curve.is_empty() {
            0
        } else {
            DATAGRAM_POINTS
        };
        field(Some(points as f64), 0);
        for k in 0..points {
            let at = (record.curve.len() - 1) * k / (DATAGRAM_POINTS - 1);
            let point = record.curve.get(at);
            field(point.map(|p| p.arc_length_m), 2);
            field(point.map(|p| p.deflection_m), 4);
            field(point.and_then(|p| p.sigma_deflection_m), 4);
        }
        field(record.global_test.and_then(|_| flag(self.is_rejected())), 0);
        let _ = write!(text, ",{}\r\n", variant_name(health));
        text
    }
}

/// A result, or the recorder's state, as sent to listeners.
pub(crate) struct LiveMessage {
    /// True if it is the state, which is sent only to listeners that requested it, and as a datagram.
    pub is_state: bool,
    /// JSON object without a line end.
    pub line: String,
    /// ASCII datagram.
    pub datagram: String,
}
