//! Grey values that are counted.

/// How often each grey value occurs.
pub struct Histogram {
    counts: [usize; 256],
}

impl Histogram {
    /// Of some values.
    pub fn of(values: impl Iterator<Item = u8>) -> Self {
        let mut counts = [0; 256];
        values.for_each(|v| counts[usize::from(v)] += 1);
        Self { counts }
    }

    /// How many there are.
    pub fn total(&self) -> usize {
        self.counts.iter().sum()
    }

    /// The grey value that so many are below or as dark as; `None` where there are not more than that.
    pub fn at(&self, rank: usize) -> Option<usize> {
        let mut below = 0;
        self.counts.iter().position(|&n| {
            below += n;
            below > rank
        })
    }

    /// The median.
    pub fn median(&self) -> Option<usize> {
        self.at(self.total() / 2)
    }
}
