//! Content of a simulated file: current bytes, bytes on the medium, and possible remains after a power cut.

use std::ops::Range;

/// Remains of unsynced bytes after a power cut. Bytes before the first one written since the last sync always survive:
/// neither appending nor truncating touches them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnsyncedBytes {
    /// State after the last sync.
    Lost,
    /// Everything that was written.
    Whole,
    /// First half of the written bytes.
    Half,
    /// Zeros, up to the larger of the old and the new length.
    Zeros,
    /// Arbitrary bytes of the same length, as in the blocks of a file system without a journal.
    Garbage(u64),
    /// Old, new or zero bytes, chosen for each sector independently.
    Sectors(u64),
}

/// Sector length, bytes; shorter than any line or frame that the tests write, so that each can be torn.
const SECTOR_BYTES: usize = 64;

/// Content of a simulated file.
#[derive(Clone, Default)]
pub(super) struct FileContent {
    pub current: Vec<u8>,
    durable: Vec<u8>,
    /// Offset of the first byte written since the last sync.
    touched: Option<usize>,
    /// Range that a failed sync gave up: readable until the power goes, but never written to the medium by a later
    /// successful sync, only by writing the bytes again.
    dropped: Range<usize>,
}

impl FileContent {
    /// Truncates to `from` (`None` appends), then adds the bytes.
    pub fn write_at(&mut self, from: Option<usize>, bytes: &[u8]) {
        self.current.truncate(from.unwrap_or(usize::MAX));
        let at = self.current.len();
        self.touched = Some(self.touched.map_or(at, |touched| touched.min(at)));
        self.dropped.end = self.dropped.end.min(at);
        self.current.extend_from_slice(bytes);
    }

    /// Makes the current bytes durable.
    pub fn sync(&mut self) {
        self.durable.clone_from(&self.current);
        for byte in self
            .durable
            .iter_mut()
            .take(self.dropped.end)
            .skip(self.dropped.start)
        {
            *byte = 0;
        }
        self.touched = None;
    }

    /// Simulates a failed sync: the bytes written since the last one may be lost.
    pub fn fail_sync(&mut self) {
        let from = self.touched.unwrap_or(self.current.len());
        let from = if self.dropped.is_empty() {
            from
        } else {
            from.min(self.dropped.start)
        };
        self.dropped = from..self.current.len();
    }

    /// Replaces the content by the one that the next boot finds.
    pub fn apply_power_cut(&mut self, how: UnsyncedBytes) {
        if let Some(safe) = self.touched.take() {
            self.durable = self.surviving_bytes(safe, how);
        }
        self.current.clone_from(&self.durable);
        self.dropped = 0..0;
    }

    fn surviving_bytes(&self, safe: usize, how: UnsyncedBytes) -> Vec<u8> {
        let longest = self.current.len().max(self.durable.len());
        let mut all = self.durable.get(..safe).unwrap_or_default().to_vec();
        match how {
            UnsyncedBytes::Lost => return self.durable.clone(),
            UnsyncedBytes::Whole => return self.current.clone(),
            UnsyncedBytes::Half => {
                let half = safe + (self.current.len() - safe) / 2;
                return self.current.get(..half).unwrap_or_default().to_vec();
            }
            UnsyncedBytes::Zeros => all.resize(longest, 0),
            UnsyncedBytes::Garbage(seed) => {
                let mut random = FaultRandom::new(seed);
                // Occasional newlines, because a torn line may look like several lines.
                all.extend((safe..longest).map(|_| match random.next() % 256 {
                    0..16 => b'\n',
                    other => other as u8,
                }));
            }
            UnsyncedBytes::Sectors(seed) => {
                let mut random = FaultRandom::new(seed);
                let length = if random.next().is_multiple_of(2) {
                    self.current.len()
                } else {
                    longest
                };
                let mut choice = 0;
                for at in safe..length {
                    if at == safe || at.is_multiple_of(SECTOR_BYTES) {
                        choice = random.next() % 3;
                    }
                    let source = [Some(&self.current), Some(&self.durable), None]
                        .get(choice as usize)
                        .copied();
                    all.push(
                        source
                            .flatten()
                            .and_then(|bytes| bytes.get(at))
                            .copied()
                            .unwrap_or(0),
                    );
                }
            }
        }
        all
    }
}

/// Xorshift generator for corrupting content.
pub(super) struct FaultRandom(u64);

impl FaultRandom {
    /// Creates a generator from a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// Returns the next pseudorandom number.
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 >> 8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unsynced() -> FileContent {
        let mut content = FileContent::default();
        content.write_at(None, b"synced");
        content.sync();
        content.write_at(None, b" and not");
        content
    }

    fn after(mut content: FileContent, how: UnsyncedBytes) -> Vec<u8> {
        content.apply_power_cut(how);
        content.current
    }

    #[test]
    fn unsynced_bytes_are_arbitrary_and_synced_bytes_stay() {
        assert_eq!(after(unsynced(), UnsyncedBytes::Lost), b"synced");
        assert_eq!(after(unsynced(), UnsyncedBytes::Whole), b"synced and not");
        assert_eq!(after(unsynced(), UnsyncedBytes::Half), b"synced and");
        assert_eq!(
            after(unsynced(), UnsyncedBytes::Zeros),
            b"synced\0\0\0\0\0\0\0\0"
        );
        for seed in 0..20 {
            let garbage = after(unsynced(), UnsyncedBytes::Garbage(seed));
            assert!(garbage.starts_with(b"synced") && garbage.len() == 14);
            assert!(after(unsynced(), UnsyncedBytes::Sectors(seed)).starts_with(b"synced"));
        }
    }

    #[test]
    fn a_truncation_may_leave_zeros_or_the_old_end() {
        let mut cut = FileContent::default();
        cut.write_at(None, b"synced");
        cut.sync();
        cut.write_at(Some(3), b"");
        assert_eq!(after(cut.clone(), UnsyncedBytes::Lost), b"synced");
        assert_eq!(after(cut.clone(), UnsyncedBytes::Whole), b"syn");
        assert_eq!(after(cut, UnsyncedBytes::Zeros), b"syn\0\0\0");
    }

    #[test]
    fn bytes_of_a_failed_sync_are_not_restored_by_the_next_one() {
        let mut content = unsynced();
        content.fail_sync();
        content.write_at(None, b"!");
        content.sync();
        assert_eq!(content.current, b"synced and not!");
        assert_eq!(
            after(content.clone(), UnsyncedBytes::Whole),
            b"synced\0\0\0\0\0\0\0\0!"
        );
        content.write_at(Some(0), b"again");
        content.sync();
        assert_eq!(after(content, UnsyncedBytes::Lost), b"again");
    }
}
