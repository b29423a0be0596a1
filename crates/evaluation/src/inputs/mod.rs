//! Inputs of commands: images, flights and frames of stores, manual marks, the installation; their parallel processing.

pub mod batch;
mod dated_image;
pub mod default_paths;
pub mod flight_marks;
pub mod image_files;
pub mod image_names;
pub mod image_times;
pub mod manual_points;
pub mod mount_comparison;
pub mod stopping;
pub mod stored_flights;
pub mod stored_frames;
pub mod time_list;

use crate::installation::{self, Installation};

/// Prints to standard error that a prior from earlier flights is used.
pub fn print_flight_prior(installation: &Installation) {
    if let Some(prior) = &installation.flight_prior {
        eprintln!(
            "wingd: using the prior from {} ({})",
            prior.flight_count_text(),
            installation::FLIGHT_PRIOR_FILE
        );
    }
}

/// Waits for Ctrl-C or SIGTERM.
pub async fn stop_signal() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut terminate) => tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = terminate.recv() => {}
        },
        Err(_) => {
            let _ = tokio::signal::ctrl_c().await;
        }
    }
}
