//! Prometheus metrics of the status (text exposition format 0.0.4).

use std::fmt::Write as _;

use super::{Activity, AircraftStatus, DaemonStatus, Health, LiveStatus, RecentShares};

/// A metric without labels: name, kind, help, value. A metric without a value is omitted.
type Metric = (&'static str, &'static str, &'static str, Option<f64>);

/// Returns all numbers of the status as Prometheus text.
pub fn prometheus_text(status: &DaemonStatus) -> String {
    let mut text = String::new();
    let shares = recent_share_metrics(&status.recent, SERIES_SHARES);
    for (name, kind, help, value) in status_metrics(status)
        .into_iter()
        .chain(shares)
        .chain(live_metrics(status))
    {
        // Writing to a string does not fail.
        if let Some(value) = value {
            let _ = writeln!(
                text,
                "# HELP wingd_{name} {help}\n# TYPE wingd_{name} {kind}\nwingd_{name} {value}"
            );
        }
    }
    text
}

fn counter(name: &'static str, help: &'static str, value: u64) -> Metric {
    (name, "counter", help, Some(value as f64))
}

fn gauge(name: &'static str, help: &'static str, value: Option<f64>) -> Metric {
    (name, "gauge", help, value)
}

fn flag(yes: bool) -> Option<f64> {
    Some(f64::from(u8::from(yes)))
}

fn status_metrics(status: &DaemonStatus) -> Vec<Metric> {
    let counts = &status.counts;
    let lines = |count: fn(&AircraftStatus) -> u64| {
        status
            .aircraft
            .as_ref()
            .map(|aircraft| count(aircraft) as f64)
    };
    vec![
        gauge(
            "healthy",
            "1 if health is ok, else 0.",
            flag(status.health == Health::Ok),
        ),
        gauge(
            "health",
            "Health: 0 ok, 1 degraded, 2 failed.",
            Some(f64::from(status.health as u8)),
        ),
        gauge(
            "result_age_seconds",
            "Age of the last result, seconds.",
            status.age_s,
        ),
        gauge(
            "capturing",
            "1 during a series, else 0.",
            flag(status.activity == Activity::Capturing),
        ),
        gauge(
            "last_frame_age_seconds",
            "Time since the last good frame, seconds.",
            status.last_frame_age_s,
        ),
        gauge(
            "next_series_seconds",
            "Time until the next scheduled series, seconds.",
            status.next_series_s,
        ),
        gauge(
            "frames_to_solve",
            "Frames waiting to be solved.",
            Some(status.to_solve as f64),
        ),
        gauge(
            "camera_open",
            "1 if the camera is open, else 0.",
            flag(status.camera.open),
        ),
        gauge(
            "camera_warnings",
            "Camera settings that differ from the configuration.",
            Some(status.camera.warnings.len() as f64),
        ),
        gauge(
            "camera_hanging_calls",
            "Camera calls that still hang.",
            Some(status.camera.hanging_calls as f64),
        ),
        gauge(
            "store_free_bytes",
            "Free space on the disk of the store, bytes.",
            status.store.free_mb.map(|mb| mb as f64 * 1e6),
        ),
        gauge(
            "store_reserve_bytes",
            "Free space below which no series begins, bytes.",
            Some(status.store.reserve_mb as f64 * 1e6),
        ),
        counter("frames_total", "Frames stored durably.", counts.frames),
        counter(
            "failed_shots_total",
            "Shots without a frame.",
            counts.failed_shots,
        ),
        counter(
            "failed_attempts_total",
            "Failed attempts at a shot.",
            counts.failed_attempts,
        ),
        counter(
            "stale_frames_total",
            "Old frames delivered instead of new ones.",
            counts.stale_frames,
        ),
        counter("hangs_total", "Camera calls abandoned.", counts.hangs),
        counter(
            "series_complete_total",
            "Complete series.",
            counts.series_complete,
        ),
        counter(
            "series_interrupted_total",
            "Interrupted series.",
            counts.series_interrupted,
        ),
        counter(
            "series_refused_total",
            "Series refused by the store.",
            counts.series_refused,
        ),
        counter("solved_total", "Frames solved.", counts.solved),
        counter(
            "unsolvable_total",
            "Frames that could not be solved.",
            counts.unsolvable,
        ),
        gauge(
            "store_stranded_series",
            "Series in incoming/ that are not under way.",
            Some(status.store.stranded as f64),
        ),
        gauge(
            "faults",
            "Parts of the recorder that do not work.",
            Some(status.faults.len() as f64),
        ),
        (
            "aircraft_lines_total",
            "counter",
            "Lines of aircraft data recorded.",
            lines(|aircraft| aircraft.recorded),
        ),
        (
            "aircraft_lines_lost_total",
            "counter",
            "Lines of aircraft data not recorded.",
            lines(|aircraft| aircraft.lost),
        ),
        counter(
            "solver_hangs_total",
            "Frames of series abandoned at the solver's deadline.",
            counts.solver_hangs,
        ),
    ]
}

/// Metric names of the shares of solved, rejected and skipped frames of series.
const SERIES_SHARES: [&str; 3] = ["solved_ratio", "rejected_ratio", "skipped_ratio"];
const LIVE_SHARES: [&str; 3] = [
    "live_solved_ratio",
    "live_rejected_ratio",
    "live_skipped_ratio",
];

fn recent_share_metrics(
    recent: &RecentShares,
    [solved, rejected, skipped]: [&'static str; 3],
) -> Vec<Metric> {
    vec![
        gauge(
            solved,
            "Fraction of the last results that have numbers.",
            recent.solved,
        ),
        gauge(
            rejected,
            "Fraction of the last results rejected by the global test.",
            recent.rejected,
        ),
        gauge(
            skipped,
            "Fraction of the last frames that were skipped.",
            recent.skipped,
        ),
    ]
}

/// Returns the metrics of live mode; none if it is off.
fn live_metrics(status: &DaemonStatus) -> Vec<Metric> {
    let Some(live) = &status.live else {
        return Vec::new();
    };
    let mut all = live_status_metrics(live);
    all.extend(recent_share_metrics(&live.recent, LIVE_SHARES));
    all
}

fn live_status_metrics(live: &LiveStatus) -> Vec<Metric> {
    let seconds = |ms: Option<f64>| ms.map(|ms| 1e-3 * ms);
    vec![
        gauge(
            "live_rate_hertz",
            "Live results per second over the last 10 s.",
            Some(live.rate_hz),
        ),
        gauge(
            "live_wanted_hertz",
            "Configured live frames per second.",
            Some(live.wanted_hz),
        ),
        gauge(
            "live_allowed_hertz",
            "Live frames per second that the temperature allows.",
            Some(live.allowed_hz),
        ),
        gauge(
            "live_latency_median_seconds",
            "Median of the latency from exposure to result over the last minute, seconds.",
            seconds(live.latency_median_ms),
        ),
        gauge(
            "live_latency_p95_seconds",
            "95th percentile of the latency from exposure to result over the last minute, seconds.",
            seconds(live.latency_p95_ms),
        ),
        gauge(
            "live_temperature_celsius",
            "Highest temperature, degrees Celsius.",
            live.temperature_c,
        ),
        gauge(
            "live_healthy",
            "0 if live mode has a fault, else 1.",
            flag(live.fault.is_none()),
        ),
        counter("live_frames_total", "Live frames taken.", live.frames),
        counter(
            "live_failed_shots_total",
            "Live frames that the camera did not deliver.",
            live.failed_shots,
        ),
        counter("live_results_total", "Live results.", live.results),
        counter(
            "live_unsolvable_total",
            "Live results without numbers.",
            live.unsolvable,
        ),
        counter(
            "live_full_searches_total",
            "Live results from a full search of the frame.",
            live.full_searches,
        ),
        counter(
            "live_skipped_total",
            "Live frames not solved because the next one had come.",
            live.skipped,
        ),
        counter(
            "live_solver_hangs_total",
            "Live frames abandoned at the deadline.",
            live.solver_hangs,
        ),
        counter(
            "live_mount_disturbances_total",
            "Mount disturbances of the camera.",
            live.mount_disturbances,
        ),
        counter(
            "live_stored_total",
            "Live results stored durably.",
            live.stored,
        ),
        counter(
            "live_dropped_total",
            "Live results not stored because of a slow or full disk.",
            live.dropped,
        ),
        counter(
            "live_lines_lost_total",
            "Lines lost because listeners were too slow.",
            live.lines_lost,
        ),
        counter("live_datagrams_total", "Datagrams sent.", live.datagrams),
        counter(
            "live_datagrams_lost_total",
            "Datagrams that could not be sent.",
            live.datagrams_lost,
        ),
        counter("live_events_total", "Events of live mode.", live.events),
        counter(
            "live_kept_frames_total",
            "Raw frames kept.",
            live.kept_frames,
        ),
        counter(
            "live_lost_frames_total",
            "Raw frames lost that were to be kept.",
            live.lost_frames,
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_has_help_type_and_value_once() {
        let mut status = DaemonStatus::default();
        status.counts.frames = 7;
        assert!(
            !prometheus_text(&status).contains("_live_"),
            "live mode is off"
        );
        status.live = Some(super::super::LiveStatus {
            skipped: 3,
            ..Default::default()
        });
        let text = prometheus_text(&status);
        assert!(text.contains("# TYPE wingd_frames_total counter\nwingd_frames_total 7\n"));
        assert!(text.contains("\nwingd_live_skipped_total 3\n"));
        assert!(!text.contains("last_frame_age"), "no frame, no age");
        let values: Vec<_> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(text.lines().count(), 3 * values.len());
        let mut names: Vec<_> = values
            .iter()
            .filter_map(|line| line.split(' ').next())
            .collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), values.len());
    }
}
