//! Which mounting of the camera each frame of a flight belongs to.

use crate::adjust::Mounting;

/// The frames' mountings, as stated or as found.
#[derive(Clone, Debug)]
pub struct Mountings<'a> {
    /// Number of each frame's mounting; `None`: not found yet, each frame has a rotation of its own.
    numbers: Option<Vec<usize>>,
    /// As the user or the recorder knows them, one per frame.
    stated: Option<&'a [Mounting]>,
}

impl<'a> Mountings<'a> {
    /// Before they are looked for.
    pub fn unknown(stated: Option<&'a [Mounting]>) -> Self {
        Self { numbers: None, stated }
    }

    /// Of a single frame.
    pub fn of_one(stated: Option<&'a [Mounting]>) -> Self {
        Self { numbers: Some(vec![0]), stated }
    }

    /// The same with the numbers that were found; where they are stated, those in the frames' order.
    pub fn found(&self, by_evidence: impl FnOnce() -> Vec<usize>) -> Self {
        Self { numbers: Some(self.stated_numbers().unwrap_or_else(by_evidence)), ..*self }
    }

    fn stated_numbers(&self) -> Option<Vec<usize>> {
        let mut seen: Vec<Mounting> = vec![];
        let number = |mounting: &Mounting| {
            seen.iter().position(|m| m == mounting).unwrap_or_else(|| {
                seen.push(*mounting);
                seen.len() - 1
            })
        };
        Some(self.stated?.iter().map(number).collect())
    }

    /// Whether they are found.
    pub fn are_found(&self) -> bool {
        self.numbers.is_some()
    }

    /// Whether there is a stated one for every frame, or none at all.
    pub fn suit(&self, frames: usize) -> bool {
        self.stated.is_none_or(|list| list.len() == frames)
    }

    /// Whether they are stated.
    pub fn are_stated(&self) -> bool {
        self.stated.is_some()
    }

    /// Their number.
    pub fn count(&self) -> usize {
        self.numbers.iter().flatten().max().map_or(1, |m| m + 1)
    }

    /// That of a frame.
    pub fn of(&self, frame: usize) -> usize {
        self.numbers.as_ref().map_or(0, |list| list[frame])
    }

    /// Whether a mounting is known to be that of the ground frames.
    pub fn stayed(&self, mounting: usize) -> bool {
        let known = self.stated.zip(self.numbers.as_deref());
        known.is_some_and(|(stated, numbers)| {
            stated.iter().zip(numbers).any(|(s, n)| *n == mounting && *s == Mounting::OfTheGround)
        })
    }
}
