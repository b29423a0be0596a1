//! The recorder's state is given out beside the results, every second and at once where health changes: who listens hears that
//! nothing comes, and why.

use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use tokio::sync::broadcast::Sender;

use super::result::Given;
use super::shared::Shared;
use crate::daemon::status::{Health, Status};
use crate::record::word;

/// Between two looks at the health.
const LOOK: Duration = Duration::from_millis(200);
/// Looks between two states, where health stays the same.
const LOOKS: u32 = 5;
/// Reasons in a datagram at most, bytes.
const REASONS: usize = 900;

/// One object, `state`, without a line's end.
pub(super) fn line(status: &Status) -> String {
    let live = status.live.clone().unwrap_or_default();
    let said = json!({ "health": status.health, "reasons": status.reasons, "age_s": status.age_s,
        "interval_s": live.interval_s, "rate_hz": live.rate_hz, "recent": live.recent });
    json!({ "state": said }).to_string()
}

/// ASCII, fields between commas; docs/live.md has the list.
fn datagram(status: &Status) -> String {
    let live = status.live.clone().unwrap_or_default();
    let utc = status.now.as_ref().map(|now| now.utc.strftime("%Y-%m-%dT%H:%M:%S%.3f").to_string());
    let mut text = format!("WINGDH,{},{}", utc.unwrap_or_default(), word(status.health));
    let numbers =
        [status.age_s, live.interval_s, live.recent.solved, live.recent.rejected, live.recent.skipped];
    for value in numbers {
        text.push_str(&value.map_or(",".to_owned(), |value| format!(",{value:.3}")));
    }
    let plain = |c: char| if c == ',' || !(' '..='~').contains(&c) { ' ' } else { c };
    let reasons: String = status.reasons.join("; ").chars().map(plain).take(REASONS).collect();
    text + "," + &reasons + "\r\n"
}

/// Gives the state out, for ever.
pub(super) async fn tell(shared: Shared, to: Sender<Arc<Given>>) {
    let (mut last, mut looks) = (Health::Ok, LOOKS);
    loop {
        let status = shared.core.board.snapshot();
        looks += 1;
        if status.health != last || looks >= LOOKS {
            (last, looks) = (status.health, 0);
            let given = Given { state: true, line: line(&status), datagram: datagram(&status) };
            // Nobody listening is no error.
            let _ = to.send(Arc::new(given));
        }
        tokio::time::sleep(LOOK).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_one_line_and_one_datagram_of_nine_fields() {
        let mut status = Status { health: Health::Failed, age_s: Some(31.0), ..Status::default() };
        status.reasons = vec!["the last live result is 31 s old, one every 0.1 s is expected".to_owned()];
        let live = status.live.get_or_insert_default();
        (live.interval_s, live.recent.solved) = (Some(0.1), Some(0.5));
        assert!(line(&status).starts_with("{\"state\":{\"health\":\"bad\""), "{}", line(&status));
        let expected = "WINGDH,,bad,31.000,0.100,0.500,,,the last live result is 31 s old  one every 0.1 s is expected\r\n";
        assert_eq!(datagram(&status), expected);
        status.reasons = vec!["x".repeat(2000)];
        assert!(datagram(&status).len() < 1400);
    }
}
