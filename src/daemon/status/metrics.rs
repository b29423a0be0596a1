//! The status is given out as Prometheus metrics, too (text exposition format 0.0.4).

use std::fmt::Write as _;

use super::{Activity, Health, LiveStatus, Recent, Status};

/// One metric without labels: name, kind, help, value. Without a value it is left out.
type Metric = (&'static str, &'static str, &'static str, Option<f64>);

/// All of the status that is a number.
pub fn exposition(status: &Status) -> String {
    let mut text = String::new();
    let shares = recent(&status.recent, SERIES);
    for (name, kind, help, value) in metrics(status).into_iter().chain(shares).chain(live(status)) {
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

fn total(name: &'static str, help: &'static str, value: u64) -> Metric {
    (name, "counter", help, Some(value as f64))
}

fn gauge(name: &'static str, help: &'static str, value: Option<f64>) -> Metric {
    (name, "gauge", help, value)
}

fn flag(yes: bool) -> Option<f64> {
    Some(f64::from(u8::from(yes)))
}

fn metrics(status: &Status) -> Vec<Metric> {
    let counts = &status.counts;
    vec![
        gauge("healthy", "1 while health is good.", flag(status.health == Health::Ok)),
        gauge("health", "0 good, 1 doubtful, 2 bad.", Some(f64::from(status.health as u8))),
        gauge("result_age_seconds", "Since the last result.", status.age_s),
        gauge("capturing", "1 during a series.", flag(status.activity == Activity::Capturing)),
        gauge("last_frame_age_seconds", "Since the last good frame.", status.last_frame_age_s),
        gauge("next_series_seconds", "Until the next scheduled series.", status.next_series_s),
        gauge("frames_to_solve", "Frames that wait to be solved.", Some(status.to_solve as f64)),
        gauge("camera_open", "1 while the camera is open.", flag(status.camera.open)),
        gauge(
            "camera_warnings",
            "Settings that are not as configured.",
            Some(status.camera.warnings.len() as f64),
        ),
        gauge("camera_hanging_calls", "Calls that hang still.", Some(status.camera.hanging_calls as f64)),
        gauge("store_free_bytes", "Free space.", status.store.free_mb.map(|mb| mb as f64 * 1e6)),
        gauge(
            "store_reserve_bytes",
            "Below it no series begins.",
            Some(status.store.reserve_mb as f64 * 1e6),
        ),
        total("frames_total", "Frames made durable.", counts.frames),
        total("failed_shots_total", "Shots without a frame.", counts.failed_shots),
        total("failed_attempts_total", "Attempts that failed.", counts.failed_attempts),
        total("stale_frames_total", "Old frames in place of new ones.", counts.stale_frames),
        total("hangs_total", "Camera calls given up.", counts.hangs),
        total("series_complete_total", "Series.", counts.series_complete),
        total("series_interrupted_total", "Series broken off.", counts.series_interrupted),
        total("series_refused_total", "Series that the store did not take.", counts.series_refused),
        total("solved_total", "Frames solved.", counts.solved),
        total("unsolvable_total", "Frames that could not be solved.", counts.unsolvable),
        total("solver_hangs_total", "Frames given up after the solver's deadline.", counts.solver_hangs),
    ]
}

/// Names of the shares with numbers, rejected and skipped.
const SERIES: [&str; 3] = ["solved_ratio", "rejected_ratio", "skipped_ratio"];
const LIVE: [&str; 3] = ["live_solved_ratio", "live_rejected_ratio", "live_skipped_ratio"];

fn recent(recent: &Recent, [solved, rejected, skipped]: [&'static str; 3]) -> Vec<Metric> {
    vec![
        gauge(solved, "Of the last results, those with numbers.", recent.solved),
        gauge(rejected, "Of the last results, those that the global test rejects.", recent.rejected),
        gauge(skipped, "Of the last frames, those that were skipped.", recent.skipped),
    ]
}

/// Of live mode, where it is on.
fn live(status: &Status) -> Vec<Metric> {
    let Some(live) = &status.live else { return Vec::new() };
    let mut all = of_live(live);
    all.extend(recent(&live.recent, LIVE));
    all
}

fn of_live(live: &LiveStatus) -> Vec<Metric> {
    let seconds = |ms: Option<f64>| ms.map(|ms| 1e-3 * ms);
    vec![
        gauge("live_rate_hertz", "Results a second, over ten seconds.", Some(live.rate_hz)),
        gauge("live_wanted_hertz", "Frames a second asked for.", Some(live.wanted_hz)),
        gauge("live_allowed_hertz", "Frames a second that the temperature allows.", Some(live.allowed_hz)),
        gauge(
            "live_latency_median_seconds",
            "From exposure to result, over a minute.",
            seconds(live.latency_median_ms),
        ),
        gauge("live_latency_p95_seconds", "Of 20 results 19 were quicker.", seconds(live.latency_p95_ms)),
        gauge("live_temperature_celsius", "The hottest place.", live.temperature_c),
        gauge("live_healthy", "0 while something is wrong.", flag(live.fault.is_none())),
        total("live_frames_total", "Frames taken.", live.frames),
        total("live_failed_shots_total", "Frames that the camera did not deliver.", live.failed_shots),
        total("live_results_total", "Results.", live.results),
        total("live_unsolvable_total", "Results without numbers.", live.unsolvable),
        total("live_full_searches_total", "Frames searched as a whole.", live.full_searches),
        total("live_skipped_total", "Frames not solved: the next had come.", live.skipped),
        total("live_solver_hangs_total", "Frames given up after the deadline.", live.solver_hangs),
        total(
            "live_mount_disturbances_total",
            "Times that the camera mount was disturbed.",
            live.mount_disturbances,
        ),
        total("live_stored_total", "Results made durable.", live.stored),
        total("live_dropped_total", "Results that the disk did not take.", live.dropped),
        total("live_lines_lost_total", "Lines that listeners were too slow for.", live.lines_lost),
        total("live_datagrams_total", "Datagrams sent.", live.datagrams),
        total("live_datagrams_lost_total", "Datagrams that were not sent.", live.datagrams_lost),
        total("live_events_total", "Events.", live.events),
        total("live_kept_frames_total", "Raw frames kept.", live.kept_frames),
        total("live_lost_frames_total", "Raw frames that were to be kept and are lost.", live.lost_frames),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_has_help_type_and_value_once() {
        let mut status = Status::default();
        status.counts.frames = 7;
        assert!(!exposition(&status).contains("_live_"), "live mode is off");
        status.live = Some(super::super::LiveStatus { skipped: 3, ..Default::default() });
        let text = exposition(&status);
        assert!(text.contains("# TYPE wingd_frames_total counter\nwingd_frames_total 7\n"));
        assert!(text.contains("\nwingd_live_skipped_total 3\n"));
        assert!(!text.contains("last_frame_age"), "no frame, no age");
        let values: Vec<_> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(text.lines().count(), 3 * values.len());
        let mut names: Vec<_> = values.iter().filter_map(|line| line.split(' ').next()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), values.len());
    }
}
