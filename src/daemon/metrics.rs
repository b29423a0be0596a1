//! The status as Prometheus metrics (text exposition format 0.0.4).

use std::fmt::Write as _;

use super::status::{Activity, Health, Status};

/// One metric without labels: name, kind, help, value. Without a value it is left out.
type Metric = (&'static str, &'static str, &'static str, Option<f64>);

/// All of the status that is a number.
pub fn exposition(status: &Status) -> String {
    let mut text = String::new();
    for (name, kind, help, value) in metrics(status) {
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

fn metrics(status: &Status) -> Vec<Metric> {
    let counts = &status.counts;
    let total = |name, help, value: u64| (name, "counter", help, Some(value as f64));
    let gauge = |name, help, value: Option<f64>| (name, "gauge", help, value);
    let flag = |yes: bool| Some(f64::from(u8::from(yes)));
    vec![
        gauge("healthy", "1 while good frames come.", flag(status.health != Health::Stale)),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_has_help_type_and_value_once() {
        let mut status = Status::default();
        status.counts.frames = 7;
        let text = exposition(&status);
        assert!(text.contains("# TYPE wingd_frames_total counter\nwingd_frames_total 7\n"));
        assert!(!text.contains("last_frame_age"), "no frame, no age");
        let values: Vec<_> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(text.lines().count(), 3 * values.len());
        let mut names: Vec<_> = values.iter().filter_map(|line| line.split(' ').next()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), values.len());
    }
}
