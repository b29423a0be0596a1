//! Publishes the recorder's state next to the results, every second and immediately when health changes, so that listeners
//! learn that no results come, and why.

use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use tokio::sync::broadcast::Sender;

use super::context::LiveContext;
use crate::daemon::status::{DaemonStatus, Health};
use wingd_evaluation::record::variant_name;
use wingd_pages::recorder::LiveMessage;

/// Time between two checks of the health.
const CHECK_INTERVAL: Duration = Duration::from_millis(200);
/// Number of checks between two states while health does not change.
const MAX_CHECKS: u32 = 5;
/// Maximum length of the reasons in a datagram, bytes.
const MAX_REASON_BYTES: usize = 900;

/// Returns the state as one JSON object without a line end.
pub(super) fn state_json(status: &DaemonStatus) -> String {
    let live = status.live.clone().unwrap_or_default();
    json!({ "health": status.health, "reasons": status.reasons, "age_s": status.age_s,
        "interval_s": live.interval_s, "rate_hz": live.rate_hz, "recent": live.recent })
    .to_string()
}

/// Returns the datagram of the state: ASCII, fields separated by commas; docs/live.md lists the fields.
fn state_datagram(status: &DaemonStatus) -> String {
    let live = status.live.clone().unwrap_or_default();
    let utc = status
        .now
        .as_ref()
        .map(|now| now.utc.strftime("%Y-%m-%dT%H:%M:%S%.3f").to_string());
    let mut text = format!(
        "WINGDH,{},{}",
        utc.unwrap_or_default(),
        variant_name(status.health)
    );
    let numbers = [
        status.age_s,
        live.interval_s,
        live.recent.solved,
        live.recent.rejected,
        live.recent.skipped,
    ];
    for value in numbers {
        text.push_str(&value.map_or(",".to_owned(), |value| format!(",{value:.3}")));
    }
    let plain = |c: char| {
        if c == ',' || !(' '..='~').contains(&c) {
            ' '
        } else {
            c
        }
    };
    let reasons: String = status
        .reasons
        .join("; ")
        .chars()
        .map(plain)
        .take(MAX_REASON_BYTES)
        .collect();
    text + "," + &reasons + "\r\n"
}

/// Publishes the state, forever.
pub(super) async fn publish_state(shared: LiveContext, to: Sender<Arc<LiveMessage>>) {
    let (mut last, mut checks) = (Health::Ok, MAX_CHECKS);
    loop {
        let status = shared.core.board.snapshot();
        checks += 1;
        if status.health != last || checks >= MAX_CHECKS {
            (last, checks) = (status.health, 0);
            let message = LiveMessage {
                is_state: true,
                json: state_json(&status),
                datagram: state_datagram(&status),
            };
            // Without a listener this fails, which is no error.
            let _ = to.send(Arc::new(message));
        }
        tokio::time::sleep(CHECK_INTERVAL).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_one_line_and_one_datagram_of_nine_fields() {
        let mut status = DaemonStatus {
            health: Health::Failed,
            age_s: Some(31.0),
            ..DaemonStatus::default()
        };
        status.reasons =
            vec!["the last live result is 31 s old, one every 0.1 s is expected".to_owned()];
        let live = status.live.get_or_insert_default();
        (live.interval_s, live.recent.solved) = (Some(0.1), Some(0.5));
        assert!(
            state_json(&status).starts_with("{\"health\":\"failed\""),
            "{}",
            state_json(&status)
        );
        let expected = "WINGDH,,failed,31.000,0.100,0.500,,,the last live result is 31 s old  one every 0.1 s is expected\r\n";
        assert_eq!(state_datagram(&status), expected);
        status.reasons = vec!["x".repeat(2000)];
        assert!(state_datagram(&status).len() < 1400);
    }
}
