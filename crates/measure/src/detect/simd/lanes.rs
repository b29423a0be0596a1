//! Numbers that are processed side by side, one for each pixel of a batch.

use std::ops::{Deref, DerefMut};

/// Number of pixels that are processed together.
pub const LANES: usize = 16;

/// Number for each pixel of a batch, aligned so that the widest register reads them in one step.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes([f32; LANES]);

impl Lanes {
    /// Creates lanes with equal values.
    #[inline(always)]
    pub const fn splat(value: f32) -> Self {
        Self([value; LANES])
    }
}

impl Default for Lanes {
    fn default() -> Self {
        Self::splat(0.0)
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

/// Computes a value for each lane.
#[inline(always)]
pub fn each(value: impl Fn(usize) -> f32) -> Lanes {
    let mut out = Lanes::splat(0.0);
    for (i, o) in out.iter_mut().enumerate() {
        *o = value(i);
    }
    out
}

/// Returns whether a test is true for all lanes, without early exit.
#[inline(always)]
pub fn all_lanes(test: impl Fn(usize) -> bool) -> bool {
    let mut all = true;
    (0..LANES).for_each(|i| all &= test(i));
    all
}

/// Returns the sum over the lanes.
#[inline(always)]
pub fn sum_lanes(lanes: &Lanes) -> f64 {
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
