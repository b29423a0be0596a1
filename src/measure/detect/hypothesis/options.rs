//! Tuned numbers of what is known beforehand: meaning, unit, origin.

numbers! {
    /// The size of a disc that those about it predict.
    NEIGHBOURS: NeighboursOptions {
        /// Discs that tell it: a plane has three unknowns, and as many are left to judge it.
        nearest: usize = 6,
        /// Discs that tell it at least.
        enough: usize = 5,
        /// Least standard deviation of a predicted size, as a share: what a bent skin departs from a plane. M18 of
        /// `fixtures/dev`; `tests/detect/fixtures.rs`.
        scatter: f64 = 0.007,
        /// Share of the usual size below which a disc is a letter or a dot.
        small: f64 = 0.5,
        /// Two discs nearer to each other are one, seen twice, px.
        same_px: f64 = 2.0,
        /// Share by which sizes may depart from their plane: more, and they lie on no one surface.
        unlike: f64 = 0.02,
        /// Share of the usual size below which a place is too far from them all.
        least: f64 = 0.25,
        /// Greatest sum of variances of the place of a disc that tells, px^2.
        certain_px2: f64 = 0.1,
        /// The same where too few are told so well.
        fairly_px2: f64 = 0.3,
    }
}
