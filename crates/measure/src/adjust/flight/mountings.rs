//! Assignment of a flight's frames to mountings of the camera.

use crate::adjust::Mounting;

/// Mountings of the frames, specified or determined from the frames.
#[derive(Clone, Debug)]
pub struct FrameMountings<'a> {
    /// Number of each frame's mounting; `None`: not determined yet, each frame has a rotation of its own.
    numbers: Option<Vec<usize>>,
    /// Mountings specified by the user or the recorder, one per frame.
    specified: Option<&'a [Mounting]>,
}

impl<'a> FrameMountings<'a> {
    /// Creates the state before the mountings are determined.
    pub fn undetermined(specified: Option<&'a [Mounting]>) -> Self {
        Self {
            numbers: None,
            specified,
        }
    }

    /// Creates the mounting of a single frame.
    pub fn for_single_frame(specified: Option<&'a [Mounting]>) -> Self {
        Self {
            numbers: Some(vec![0]),
            specified,
        }
    }

    /// Sets the mounting numbers: the specified ones if there are any, otherwise those determined from the frames.
    pub fn with_numbers(&self, by_evidence: impl FnOnce() -> Vec<usize>) -> Self {
        Self {
            numbers: Some(
                self.specified_mounting_numbers()
                    .unwrap_or_else(by_evidence),
            ),
            ..*self
        }
    }

    fn specified_mounting_numbers(&self) -> Option<Vec<usize>> {
        let mut seen: Vec<Mounting> = vec![];
        let number = |mounting: &Mounting| {
            seen.iter().position(|m| m == mounting).unwrap_or_else(|| {
                seen.push(*mounting);
                seen.len() - 1
            })
        };
        Some(self.specified?.iter().map(number).collect())
    }

    /// Returns whether each frame is assigned to a mounting; until then each has a rotation of its own.
    pub fn are_assigned(&self) -> bool {
        self.numbers.is_some()
    }

    /// Returns whether a mounting is specified for every frame, or for none.
    pub fn match_frame_count(&self, frames: usize) -> bool {
        self.specified.is_none_or(|list| list.len() == frames)
    }

    /// Returns whether the mountings are specified.
    pub fn are_specified(&self) -> bool {
        self.specified.is_some()
    }

    /// Number of mountings.
    pub fn count(&self) -> usize {
        self.numbers.iter().flatten().max().map_or(1, |m| m + 1)
    }

    /// Number of a frame's mounting.
    pub fn mounting_of_frame(&self, frame: usize) -> usize {
        self.numbers.as_ref().map_or(0, |list| list[frame])
    }

    /// Returns whether a mounting is known to be that of the ground frames.
    pub fn is_ground_mounting(&self, mounting: usize) -> bool {
        let known = self.specified.zip(self.numbers.as_deref());
        known.is_some_and(|(specified, numbers)| {
            specified
                .iter()
                .zip(numbers)
                .any(|(s, n)| *n == mounting && *s == Mounting::Ground)
        })
    }
}
