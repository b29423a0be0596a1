//! Tuned numbers of what is known beforehand: meaning, unit, origin.

/// The size of a disc that those about it predict.
pub struct NeighboursOptions {
    /// Discs that tell it: a plane has three unknowns, and as many are left to judge it.
    pub nearest: usize,
    /// Discs that tell it at least.
    pub enough: usize,
    /// Least standard deviation of a predicted size, as a share: what a bent skin departs from a plane. M18 of
    /// `fixtures/dev`; `tests/detect/fixtures.rs`.
    pub spread: f64,
    /// Share by which sizes may depart from their plane: more, and they lie on no one surface.
    pub unlike: f64,
    /// Share of the usual size below which a place is too far from them all.
    pub least: f64,
    /// Greatest sum of variances of the place of a disc that tells, px^2.
    pub certain_px2: f64,
    /// The same where too few are told so well.
    pub fairly_px2: f64,
}

/// The numbers in use.
pub const NEIGHBOURS: NeighboursOptions = NeighboursOptions {
    nearest: 6,
    enough: 5,
    spread: 0.007,
    unlike: 0.02,
    least: 0.25,
    certain_px2: 0.1,
    fairly_px2: 0.3,
};
