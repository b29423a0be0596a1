//! Concurrency and rate limit of uploads.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time bound for an object: an interruption should not cost more than this much sending. More objects are sent
/// concurrently only if each is finished sooner.
const MAX_OBJECT_TIME: Duration = Duration::from_secs(2);
/// Number of recent objects from which the rate is measured.
const RATE_WINDOW: usize = 8;

/// Measured upload rate, which determines the number of concurrent objects.
#[derive(Debug)]
pub(super) struct SendPace {
    max_objects: usize,
    /// Time of arrival and length of recent objects.
    arrived: VecDeque<(Instant, u64)>,
}

impl SendPace {
    /// Starts with one object at a time; never more than `most`.
    pub fn new(most: usize, now: Instant) -> Self {
        Self {
            max_objects: most.max(1),
            arrived: VecDeque::from([(now, 0)]),
        }
    }

    /// Records an object of `length` bytes that arrived at `now`.
    pub fn record_object(&mut self, length: u64, now: Instant) {
        self.arrived.push_back((now, length));
        if self.arrived.len() > RATE_WINDOW {
            self.arrived.pop_front();
        }
    }

    /// Returns the number of objects of this length to send concurrently.
    pub fn max_concurrent(&self, length: u64) -> usize {
        let (Some(first), Some(last)) = (self.arrived.front(), self.arrived.back()) else {
            return 1;
        };
        let bytes: u64 = self.arrived.iter().skip(1).map(|(_, length)| length).sum();
        let seconds = last.0.duration_since(first.0).as_secs_f64();
        if seconds <= 0.0 || length == 0 {
            return 1;
        }
        let objects = bytes as f64 / seconds * MAX_OBJECT_TIME.as_secs_f64() / length as f64;
        (objects as usize).clamp(1, self.max_objects)
    }
}

/// Maximum rate of sending, over all objects.
#[derive(Debug)]
pub(super) struct RateLimit {
    bytes_per_s: f64,
    /// Time until which the objects so far use the rate.
    free_at: Mutex<Instant>,
}

impl RateLimit {
    /// Creates a limit of at least 1 byte per second.
    pub fn new(bytes_per_s: u64) -> Self {
        Self {
            bytes_per_s: bytes_per_s.max(1) as f64,
            free_at: Mutex::new(Instant::now()),
        }
    }

    /// Reserves the time that sending `length` bytes may take; returns its end.
    fn reserve_time(&self, length: u64, now: Instant) -> Instant {
        let mut free = self.free_at.lock().unwrap_or_else(PoisonError::into_inner);
        *free = (*free).max(now) + Duration::from_secs_f64(length as f64 / self.bytes_per_s);
        *free
    }

    /// Sends `length` bytes and waits until they use no more than the rate: an object goes out as fast as the network is, and
    /// the next one follows after a pause.
    pub async fn send_within<T>(&self, length: u64, sending: impl Future<Output = T>) -> T {
        let end = self.reserve_time(length, Instant::now());
        let sent = sending.await;
        tokio::time::sleep_until(end.into()).await;
        sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_link_gets_one_object_at_a_time() {
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut pace = SendPace::new(4, start);
        assert_eq!(pace.max_concurrent(1_000_000), 1, "nothing is known yet");
        pace.record_object(1_000_000, at(4000));
        assert_eq!(pace.max_concurrent(1_000_000), 1, "0.25 MB/s");
        assert_eq!(pace.max_concurrent(100_000), 4, "short ones finish soon");
        for n in 1..=RATE_WINDOW as u64 {
            pace.record_object(1_000_000, at(4000 + 100 * n));
        }
        assert_eq!(
            pace.max_concurrent(4_000_000),
            4,
            "10 MB/s: the old rate is forgotten"
        );
    }

    #[test]
    fn objects_sent_together_share_the_rate() {
        let limit = RateLimit::new(1000);
        let now = Instant::now() + Duration::from_secs(1);
        let ends: Vec<f64> = (0..3)
            .map(|_| {
                limit
                    .reserve_time(500, now)
                    .duration_since(now)
                    .as_secs_f64()
            })
            .collect();
        assert_eq!(ends, [0.5, 1.0, 1.5]);
    }
}
