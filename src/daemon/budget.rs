//! Budgets of data with a lower priority than the series: a rate, and a share of the disk. What is beyond them is dropped,
//! counted and reported.

use wingd_store::Store;

/// Multiple of the store's reserve at which data of lower priority stop, so that they never use up the space of the series.
pub(crate) const RESERVE_FACTOR: u64 = 2;

/// Amount that may be used per second, with a burst after a quiet time.
pub(crate) struct RateBudget {
    per_s: f64,
    burst: f64,
    left: f64,
    at_s: f64,
}

impl RateBudget {
    /// Creates a full budget.
    pub fn new(per_s: f64, burst: f64) -> Self {
        Self {
            per_s,
            burst,
            left: burst,
            at_s: 0.0,
        }
    }

    /// Takes `amount` at the time `now_s`, s, if that leaves at least the share `floor` of the burst.
    pub fn take(&mut self, amount: f64, floor: f64, now_s: f64) -> bool {
        self.left = self
            .burst
            .min(self.left + self.per_s * (now_s - self.at_s).max(0.0));
        self.at_s = now_s;
        let enough = self.left - amount >= floor * self.burst;
        if enough {
            self.left -= amount;
        }
        enough
    }
}

/// Checks that one kind of data, of which `used` bytes are on the disk, has not used its `share`, a fraction of the space above
/// the limit of [`RESERVE_FACTOR`].
///
/// # Errors
/// Returns the reason for which no more must be written.
pub(crate) fn check_disk_share(store: &Store, share: f64, used: u64) -> Result<(), String> {
    let free_mb = store.free_mb().map_err(|error| error.to_string())?;
    let limit_mb = RESERVE_FACTOR * store.reserve_mb();
    let above = free_mb.saturating_sub(limit_mb) as f64 * 1e6;
    let remedy = "export flights and move them away";
    if free_mb < limit_mb {
        return Err(format!(
            "{free_mb} MB are free; at {limit_mb} MB, twice the reserve, only series go on; {remedy}"
        ));
    }
    if used as f64 > share * (above + used as f64) {
        let percent = 100.0 * share;
        return Err(format!(
            "{percent:.0} % of the disk are used for them, which is their share; {remedy}"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use wingd_store::{RealDisk, StoreConfig};

    #[test]
    fn a_burst_is_followed_by_the_rate_and_the_floor_is_for_others() {
        let mut budget = RateBudget::new(10.0, 100.0);
        assert_eq!((0..50).filter(|_| budget.take(10.0, 0.5, 0.0)).count(), 5);
        assert_eq!((0..50).filter(|_| budget.take(10.0, 0.0, 0.0)).count(), 5);
        assert_eq!((0..50).filter(|_| budget.take(10.0, 0.0, 3.0)).count(), 3);
        assert!(
            !budget.take(10.0, 0.0, 2.0),
            "time that goes back adds nothing"
        );
    }

    #[test]
    fn a_share_ends_and_nothing_is_taken_near_the_reserve() {
        let dir = tempfile::tempdir().unwrap();
        let open = |reserve_mb| {
            let config = StoreConfig {
                reserve_mb,
                ..StoreConfig::new(dir.path())
            };
            Store::open(Arc::new(RealDisk), config).unwrap().0
        };
        let free_mb = {
            let store = open(0);
            let free = store.free_mb().unwrap() * 1_000_000;
            assert!(check_disk_share(&store, 0.1, free / 20).is_ok());
            let refused = check_disk_share(&store, 0.1, free / 8).unwrap_err();
            assert!(refused.contains("share"), "{refused}");
            free / 1_000_000
        };
        let refused = check_disk_share(&open(free_mb * 3 / 4), 0.1, 0).unwrap_err();
        assert!(refused.contains("reserve"), "{refused}");
    }
}
