//! A file's bytes as they are seen, as they are on the medium, and what a power cut may leave of the difference.

use std::ops::Range;

/// What a power cut leaves of bytes that were not synced. Bytes before the first one that was written
/// since the last sync stay: neither appending nor cutting off touches them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bytes {
    /// As after the last sync.
    Lost,
    /// All that was written.
    Whole,
    /// The first half of what was written.
    Half,
    /// The new length (or the old, where it is the longer one) and zeros.
    Zeros,
    /// The same length and anything: what a file system without a journal finds in a block.
    Garbage(u64),
    /// Each sector for itself old, new or zeros, in any order.
    Sectors(u64),
}

/// Shorter than any line or frame that the tests write, so that each can be torn.
const SECTOR_BYTES: usize = 64;

/// A file.
#[derive(Clone, Default)]
pub(super) struct Content {
    pub now: Vec<u8>,
    durable: Vec<u8>,
    /// The first byte that was written since the last sync.
    touched: Option<usize>,
    /// What a failed sync gave up: it is seen until the power goes, but never reaches the medium, not
    /// even by a later sync that succeeds; only by writing it again.
    dropped: Range<usize>,
}

impl Content {
    /// Cuts to `from` (none: appends), then adds.
    pub fn put(&mut self, from: Option<usize>, bytes: &[u8]) {
        self.now.truncate(from.unwrap_or(usize::MAX));
        let at = self.now.len();
        self.touched = Some(self.touched.map_or(at, |touched| touched.min(at)));
        self.dropped.end = self.dropped.end.min(at);
        self.now.extend_from_slice(bytes);
    }

    pub fn sync(&mut self) {
        self.durable.clone_from(&self.now);
        for byte in self.durable.iter_mut().take(self.dropped.end).skip(self.dropped.start) {
            *byte = 0;
        }
        self.touched = None;
    }

    pub fn sync_failed(&mut self) {
        let from = self.touched.unwrap_or(self.now.len());
        let from = if self.dropped.is_empty() { from } else { from.min(self.dropped.start) };
        self.dropped = from..self.now.len();
    }

    /// What the next boot finds.
    pub fn survive(&mut self, how: Bytes) {
        if let Some(safe) = self.touched.take() {
            self.durable = self.survivor(safe, how);
        }
        self.now.clone_from(&self.durable);
        self.dropped = 0..0;
    }

    fn survivor(&self, safe: usize, how: Bytes) -> Vec<u8> {
        let longest = self.now.len().max(self.durable.len());
        let mut all = self.durable.get(..safe).unwrap_or_default().to_vec();
        match how {
            Bytes::Lost => return self.durable.clone(),
            Bytes::Whole => return self.now.clone(),
            Bytes::Half => {
                let half = safe + (self.now.len() - safe) / 2;
                return self.now.get(..half).unwrap_or_default().to_vec();
            }
            Bytes::Zeros => all.resize(longest, 0),
            Bytes::Garbage(seed) => {
                let mut random = Random::new(seed);
                // With newlines now and then: a torn line may look like several.
                all.extend((safe..longest).map(|_| match random.next() % 256 {
                    0..16 => b'\n',
                    other => other as u8,
                }));
            }
            Bytes::Sectors(seed) => {
                let mut random = Random::new(seed);
                let length = if random.next().is_multiple_of(2) { self.now.len() } else { longest };
                let mut choice = 0;
                for at in safe..length {
                    if at == safe || at.is_multiple_of(SECTOR_BYTES) {
                        choice = random.next() % 3;
                    }
                    let source = [Some(&self.now), Some(&self.durable), None].get(choice as usize).copied();
                    all.push(source.flatten().and_then(|bytes| bytes.get(at)).copied().unwrap_or(0));
                }
            }
        }
        all
    }
}

/// xorshift; only for spoiling.
pub(super) struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

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

    fn unsynced() -> Content {
        let mut content = Content::default();
        content.put(None, b"synced");
        content.sync();
        content.put(None, b" and not");
        content
    }

    fn after(mut content: Content, how: Bytes) -> Vec<u8> {
        content.survive(how);
        content.now
    }

    #[test]
    fn of_unsynced_bytes_anything_may_be_there_and_what_was_synced_stays() {
        assert_eq!(after(unsynced(), Bytes::Lost), b"synced");
        assert_eq!(after(unsynced(), Bytes::Whole), b"synced and not");
        assert_eq!(after(unsynced(), Bytes::Half), b"synced and");
        assert_eq!(after(unsynced(), Bytes::Zeros), b"synced\0\0\0\0\0\0\0\0");
        for seed in 0..20 {
            let garbage = after(unsynced(), Bytes::Garbage(seed));
            assert!(garbage.starts_with(b"synced") && garbage.len() == 14);
            assert!(after(unsynced(), Bytes::Sectors(seed)).starts_with(b"synced"));
        }
    }

    #[test]
    fn a_truncation_may_leave_zeros_or_the_old_end() {
        let mut cut = Content::default();
        cut.put(None, b"synced");
        cut.sync();
        cut.put(Some(3), b"");
        assert_eq!(after(cut.clone(), Bytes::Lost), b"synced");
        assert_eq!(after(cut.clone(), Bytes::Whole), b"syn");
        assert_eq!(after(cut, Bytes::Zeros), b"syn\0\0\0");
    }

    #[test]
    fn what_a_failed_sync_gave_up_is_not_brought_back_by_the_next_one() {
        let mut content = unsynced();
        content.sync_failed();
        content.put(None, b"!");
        content.sync();
        assert_eq!(content.now, b"synced and not!");
        assert_eq!(after(content.clone(), Bytes::Whole), b"synced\0\0\0\0\0\0\0\0!");
        content.put(Some(0), b"anew");
        content.sync();
        assert_eq!(after(content, Bytes::Lost), b"anew");
    }
}
