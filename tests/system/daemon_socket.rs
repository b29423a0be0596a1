//! Promise: the recorder's socket answers while it records, and triggers a series.

use std::sync::Arc;
use std::time::Duration;

use wingd::clock::{Clock, SimulatedClock};
use wingd::daemon::{self, DaemonStatus, StatusConfig};

use super::daemon_replay::Flight;

#[test]
fn the_socket_answers_and_triggers_a_series() {
    let mut flight = Flight::new(Vec::new());
    let socket = flight.dir.path().join("run").join("wingd.sock");
    flight.status = Some(StatusConfig {
        socket: socket.clone(),
    });
    // Paced: the flight of 2 h takes about 2 s.
    let start = flight.clock.stamp();
    flight.clock = Arc::new(SimulatedClock::starting_at(&start, Some(3600.0)));
    std::thread::scope(|scope| {
        let flying = scope.spawn(|| flight.run_flight());
        let mut answer = daemon::query_daemon(&socket, "status");
        for _ in 0..200 {
            if answer
                .as_ref()
                .is_ok_and(|status| status["counts"]["series_complete"] == 1)
            {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
            answer = daemon::query_daemon(&socket, "status");
        }
        // The output of `wingd status --json`, unchanged.
        let answer = answer.unwrap();
        crate::json_schemas::assert_valid("status", answer.to_string().as_bytes());
        let status: DaemonStatus = serde_json::from_value(answer).unwrap();
        assert_eq!(status.flight.as_deref(), Some("f0001"));
        assert!(status.counts.frames >= 4 && status.last_frame_age_s.is_some());
        assert!(daemon::query_daemon(&socket, "new-flight").is_ok());
        assert!(
            daemon::query_daemon(&socket, "dance")
                .unwrap_err()
                .to_string()
                .contains("unknown command")
        );
        flying.join().unwrap();
    });
    let triggered: Vec<_> = flight
        .manifests()
        .into_iter()
        .filter(|m| m.flight == "f0002")
        .collect();
    assert_eq!(
        triggered.len(),
        3,
        "the extra series and the two scheduled after it"
    );
    assert_eq!(flight.manifests().len(), 4);
    assert!(
        daemon::query_daemon(&socket, "status")
            .unwrap_err()
            .to_string()
            .contains("no daemon is running")
    );
    flight.verify_store();
}
