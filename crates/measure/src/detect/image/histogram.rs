//! Histograms of grey values.

/// Number of occurrences of each grey value.
pub struct Histogram {
    counts: [usize; 256],
}

impl Histogram {
    /// Counts grey values.
    pub fn from_values(values: impl Iterator<Item = u8>) -> Self {
        let mut counts = [0; 256];
        values.for_each(|v| counts[usize::from(v)] += 1);
        Self { counts }
    }

    /// Returns the number of values.
    pub fn total(&self) -> usize {
        self.counts.iter().sum()
    }

    /// Returns the grey value of a rank, counted from 0 in ascending order; `None` if there are not more values than that.
    pub fn value_at_rank(&self, rank: usize) -> Option<usize> {
        let mut below = 0;
        self.counts.iter().position(|&n| {
            below += n;
            below > rank
        })
    }

    /// Returns the median; `None` without values.
    pub fn median(&self) -> Option<usize> {
        self.value_at_rank(self.total() / 2)
    }
}
