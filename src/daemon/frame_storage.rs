//! Here alone a frame becomes a stored frame, whether it is of the timetable, of live mode or from a camera's card.

use serde_json::Value;

use super::core::Core;
use crate::camera::{CameraFrame, file_extension};
use crate::store::manifest::{FrameEntry, Shot};
use crate::store::{NewFrame, OpenSeries, SeriesPlan, Recovery, StoreError};

/// Begins a series, of which the status names the flight; what had to be recovered for it is in the log.
pub(crate) fn begin(core: &Core, plan: SeriesPlan) -> Result<OpenSeries, StoreError> {
    let (series, recovery) = core.store.begin_series(plan, &core.clock.stamp())?;
    log_recovery(&recovery);
    core.board.update(|status| status.flight = Some(series.flight().to_owned()));
    Ok(series)
}

/// Adds a shot with its frame, or with the reasons why there is none. What is returned is durable.
pub(crate) fn add(
    series: &mut OpenSeries,
    shot: Shot,
    frame: Option<&CameraFrame>,
) -> Result<Option<FrameEntry>, StoreError> {
    let new = frame.map(|frame| NewFrame {
        bytes: &frame.bytes,
        extension: file_extension(&frame.format),
        format: serde_json::to_value(&frame.format).unwrap_or(Value::Null),
        settings: frame.settings.clone(),
    });
    Ok(series.add_shot(shot, new)?.frame.clone())
}

/// Writes into the log what was recovered.
pub(crate) fn log_recovery(recovery: &Recovery) {
    for series in &recovery.series {
        tracing::warn!(series, "recovered");
    }
    for name in &recovery.set_aside {
        tracing::warn!(name, "half data kept under partial/");
    }
    for remark in &recovery.remarks {
        tracing::warn!(remark, "recovery");
    }
}
