//! Stores frames of scheduled series, of live mode and from a camera's card. No other module of the daemon adds frames.

use serde_json::Value;

use super::core::Core;
use crate::camera::CameraFrame;
use wingd_evaluation::frame_format::file_extension;
use wingd_store::manifest::{FrameEntry, Shot};
use wingd_store::{NewFrame, OpenSeries, Recovery, SeriesPlan, StoreResult};

/// Begins a series, writes the flight into the status, and logs everything that had to be recovered first.
pub(crate) fn begin_series(core: &Core, plan: SeriesPlan) -> StoreResult<OpenSeries> {
    let (series, recovery) = core.store.begin_series(plan, &core.clock.stamp())?;
    log_recovery(&recovery);
    core.board
        .update(|status| status.flight = Some(series.flight().to_owned()));
    Ok(series)
}

/// Adds a shot with its frame, or with the reasons for its absence. The returned entry is durable.
pub(crate) fn add_shot(
    series: &mut OpenSeries,
    shot: Shot,
    frame: Option<&CameraFrame>,
) -> StoreResult<Option<FrameEntry>> {
    let new = frame.map(|frame| NewFrame {
        bytes: &frame.bytes,
        extension: file_extension(&frame.format),
        format: serde_json::to_value(&frame.format).unwrap_or(Value::Null),
        settings: frame.settings.clone(),
    });
    Ok(series.add_shot(shot, new)?.frame.clone())
}

/// Logs a recovery.
pub(crate) fn log_recovery(recovery: &Recovery) {
    for series in &recovery.series {
        tracing::warn!(series, "recovered");
    }
    for name in &recovery.set_aside {
        tracing::warn!(name, "incomplete data moved to partial/");
    }
    for remark in &recovery.remarks {
        tracing::warn!(remark, "recovery");
    }
}
