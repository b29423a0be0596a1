//! Result of a live frame, as a line of JSON and as a datagram (docs/live.md).

use std::fmt::Write as _;

use crate::daemon::capture::CapturedFrame;
use crate::daemon::status::Health;
use wingd_evaluation::pipeline::live::{LiveResult, TrackedFrame};
use wingd_evaluation::record::variant_name;

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

    /// Creates the frame's result.
    pub fn result(&self, tracked: TrackedFrame, latency_ms: f64, skipped: u64) -> LiveResult {
        LiveResult {
            number: self.number,
            exposure: self.taken.exposure.clone(),
            latency_ms,
            skipped,
            tracked,
        }
    }

    /// Returns the time of exposure since boot, s.
    pub fn exposed_at_s(&self) -> f64 {
        self.taken.exposure.exposure_since_boot_s
    }
}

/// Number of points of the curve in a datagram.
pub const DATAGRAM_POINTS: usize = 11;

/// Returns the result as a datagram: ASCII, fields separated by commas, empty if a number is missing; at most 1400
/// bytes. docs/live.md lists the fields.
pub fn result_datagram(result: &LiveResult, health: Health) -> String {
    let mut text = format!(
        "WINGD1,{}",
        result
            .exposure
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
    let record = &result.tracked.record;
    let flag = |yes: bool| Some(f64::from(u8::from(yes)));
    field(result.exposure.utc_sigma_s(), 4);
    field(Some(result.number as f64), 0);
    field(flag(result.is_solved()), 0);
    field(flag(result.tracked.mount_disturbed), 0);
    field(Some(result.tracked.mounting as f64), 0);
    field(Some(result.skipped as f64), 0);
    field(Some(result.latency_ms), 1);
    field(record.variance_factor, 3);
    field(result.tip_deflection_m(), 4);
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
    field(
        record.global_test.and_then(|_| flag(result.is_rejected())),
        0,
    );
    let _ = write!(text, ",{}\r\n", variant_name(health));
    text
}
