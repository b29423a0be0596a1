//! Numbers that are worked on side by side, one of each pixel of a batch.

use std::ops::{Deref, DerefMut};

/// Pixels that are worked on together.
pub const LANES: usize = 16;

/// One number of each pixel of a batch, where the widest register reads them in one step.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes([f32; LANES]);

impl Lanes {
    /// The same in all.
    #[inline(always)]
    pub const fn of(value: f32) -> Self {
        Self([value; LANES])
    }
}

impl Default for Lanes {
    fn default() -> Self {
        Self::of(0.0)
    }
}

impl Deref for Lanes {
    type Target = [f32; LANES];

    #[inline(always)]
    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl DerefMut for Lanes {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

/// One number per lane.
#[inline(always)]
pub fn each(value: impl Fn(usize) -> f32) -> Lanes {
    let mut out = Lanes::of(0.0);
    for (i, o) in out.iter_mut().enumerate() {
        *o = value(i);
    }
    out
}

/// Whether a test holds for all lanes, in one sweep.
#[inline(always)]
pub fn all(test: impl Fn(usize) -> bool) -> bool {
    let mut all = true;
    (0..LANES).for_each(|i| all &= test(i));
    all
}

/// The sum over the lanes.
#[inline(always)]
pub fn total(lanes: &Lanes) -> f64 {
    let mut eight = [0.0f32; LANES / 2];
    for i in 0..LANES / 2 {
        eight[i] = lanes[i] + lanes[i + LANES / 2];
    }
    let mut four = [0.0f32; LANES / 4];
    for i in 0..LANES / 4 {
        four[i] = eight[i] + eight[i + LANES / 4];
    }
    let four = four.map(f64::from);
    (four[0] + four[1]) + (four[2] + four[3])
}
