//! `wingd status` and `wingd trigger` query the running recorder.

use std::path::PathBuf;

use crate::config;
use crate::daemon::{
    self, AircraftStatus, DaemonStatus, Health, LiveStatus, RecentShares, StatusConfig, format_span,
};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_line;
use wingd_evaluation::number::count_text;
use wingd_evaluation::record::variant_name;

/// Show the state of the running recorder.
#[derive(clap::Args)]
pub struct StatusArgs {
    #[command(flatten)]
    socket: SocketArgs,
    /// Print the complete state as one JSON object
    #[arg(long)]
    json: bool,
}

/// Ask the running recorder for an extra series; in live mode it also keeps the raw frames before and after, as set in
/// [live.keep]
#[derive(clap::Args)]
pub struct TriggerArgs {
    #[command(flatten)]
    socket: SocketArgs,
    /// Begin a new flight with the series
    #[arg(long)]
    new_flight: bool,
}

#[derive(clap::Args)]
struct SocketArgs {
    /// Recorder's socket, [status] socket of its configuration [default: the one in wingd.toml of this directory, else
    /// /run/wingd/wingd.sock]
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    /// Recorder's configuration, to find its socket
    #[arg(long, value_name = "wingd.toml", conflicts_with = "socket")]
    config: Option<PathBuf>,
}

impl SocketArgs {
    fn socket_path(&self) -> TaskResult<PathBuf> {
        match (&self.socket, &self.config) {
            (Some(socket), _) => Ok(socket.clone()),
            (None, Some(file)) => Ok(config::load_configuration(file)?.status.socket),
            (None, None) => match wingd_evaluation::inputs::default_paths::local_configuration() {
                Some(file) => Ok(config::load_configuration(&file)?.status.socket),
                None => Ok(StatusConfig::default().socket),
            },
        }
    }
}

/// Prints the status; exit status 1 if the recorder's health is not `ok`.
pub(super) fn print_status(args: &StatusArgs) -> TaskResult<Completion> {
    let value = daemon::query_daemon(&args.socket.socket_path()?, "status")
        .map_err(|why| Failure::Failed(why.to_string()))?;
    if args.json {
        print_line(&value.to_string())?;
    }
    let status: DaemonStatus = serde_json::from_value(value)
        .map_err(|error| Failure::Failed(format!("the recorder has another version: {error}")))?;
    if !args.json {
        print_line(&status_text(&status))?;
    }
    Ok(Completion::from_success(status.health == Health::Ok))
}

pub(super) fn trigger_series(args: &TriggerArgs) -> TaskResult<Completion> {
    let command = if args.new_flight {
        "new-flight"
    } else {
        "trigger"
    };
    let answer = daemon::query_daemon(&args.socket.socket_path()?, command)
        .map_err(|why| Failure::Failed(why.to_string()))?;
    print_line(
        answer
            .get("answer")
            .and_then(|answer| answer.as_str())
            .unwrap_or("done"),
    )?;
    Ok(Completion::All)
}

/// Describes the status for a person.
fn status_text(status: &DaemonStatus) -> String {
    let counts = &status.counts;
    let or_none = |text: &Option<String>| text.clone().unwrap_or_else(|| "none yet".to_owned());
    let free = status
        .store
        .free_mb
        .map_or("unknown".to_owned(), |mb| format!("{mb} MB"));
    let mut lines = vec![
        format!(
            "wingd {}: {}",
            status.version,
            variant_name(status.activity)
        ),
        health_text(status),
        format!("flight       {}", or_none(&status.flight)),
        format!(
            "series       {}, shot {} of {}",
            or_none(&status.series),
            status.shot,
            status.shots_per_series
        ),
        format!(
            "next series  {}",
            status
                .next_series_s
                .map_or("none planned".to_owned(), |s| format!(
                    "in {}",
                    format_span(s)
                ))
        ),
        format!(
            "since start  {}, {} failed, {} series complete, {} interrupted, {} refused",
            count_text(counts.frames as usize, "frame"),
            count_text(counts.failed_shots as usize, "shot"),
            counts.series_complete,
            counts.series_interrupted,
            counts.series_refused
        ),
        format!(
            "solving      {} solved, {} not solvable, {} waiting",
            counts.solved, counts.unsolvable, status.to_solve
        ),
        format!("camera       {}", or_none(&status.camera.name)),
        format!(
            "store        {}, {free} free, {} MB reserve",
            status.store.path, status.store.reserve_mb
        ),
    ];
    lines.extend(recent_text(&status.recent).map(|text| format!("solving      {text}")));
    lines.extend(status.live.iter().flat_map(live_status_lines));
    if let Some(aircraft) = &status.aircraft {
        let last = aircraft
            .last
            .as_ref()
            .map_or("none yet".to_owned(), |stamp| stamp.utc.to_string());
        let AircraftStatus {
            recorded,
            read,
            impossible,
            lost,
            ..
        } = aircraft;
        lines.push(format!(
            "aircraft     {recorded} lines, {read} read, {impossible} impossible, {lost} lost, last {last}"
        ));
        lines.extend(
            aircraft
                .fault
                .iter()
                .map(|fault| format!("warning      aircraft data: {fault}")),
        );
    }
    lines.extend(
        status
            .camera
            .warnings
            .iter()
            .map(|warning| format!("warning      camera: {warning}")),
    );
    if let Some(fault) = &status.last_fault {
        lines.push(format!("last error   {} ({})", fault.what, fault.stamp.utc));
    }
    lines.join("\n")
}

fn live_status_lines(live: &LiveStatus) -> Vec<String> {
    let ms = |value: Option<f64>| value.map_or("unknown".to_owned(), |ms| format!("{ms:.0} ms"));
    let mut lines = vec![
        format!(
            "live         {:.1} of {} results per second, latency {} (95 %: {})",
            live.rate_hz,
            live.wanted_hz,
            ms(live.latency_median_ms),
            ms(live.latency_p95_ms)
        ),
        format!(
            "live         {} frames, {} results, {} without numbers, {} skipped, {} mount disturbances",
            live.frames, live.results, live.unsolvable, live.skipped, live.mount_disturbances
        ),
        format!(
            "live         {} results stored, {} dropped; {} events, {} raw frames kept, {} lost",
            live.stored, live.dropped, live.events, live.kept_frames, live.lost_frames
        ),
    ];
    lines.extend(recent_text(&live.recent).map(|text| format!("live         {text}")));
    lines.extend(
        live.fault
            .iter()
            .map(|fault| format!("warning      live: {fault}")),
    );
    lines
}

/// Health with its reasons, a line each, and the age of the last result and the last frame.
fn health_text(status: &DaemonStatus) -> String {
    let ago =
        |what: &str, age_s: Option<f64>| age_s.map(|s| format!("{what} {} ago", format_span(s)));
    let ages = [
        ago("last result", status.age_s),
        ago("last frame", status.last_frame_age_s),
    ];
    let ages: Vec<String> = ages.into_iter().flatten().collect();
    let ages = if ages.is_empty() {
        "no frame due yet".to_owned()
    } else {
        ages.join(", ")
    };
    let mut lines = vec![format!(
        "health       {}, {ages}",
        variant_name(status.health)
    )];
    lines.extend(
        status
            .reasons
            .iter()
            .map(|reason| format!("             {reason}")),
    );
    lines.join("\n")
}

/// Percentages of recent results with numbers and rejected.
fn recent_text(recent: &RecentShares) -> Option<String> {
    let percent =
        |share: Option<f64>| share.map_or("unknown".to_owned(), |s| format!("{:.0} %", 100.0 * s));
    (recent.results > 0).then(|| {
        let (solved, rejected) = (percent(recent.solved), percent(recent.rejected));
        format!(
            "of the last {}: {solved} with numbers, {rejected} rejected",
            recent.results
        )
    })
}
