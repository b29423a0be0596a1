//! Tuned numbers of priors: meaning, unit, origin.

numbers! {
    /// Prediction of a disc's size from its neighbours.
    NEIGHBOURS: NeighboursOptions {
        /// Largest number of discs used: a plane has three unknowns, which leaves three redundant discs.
        max_discs: usize = 6,
        /// Smallest relative standard deviation of a predicted size: deviation of a bent skin from a plane. M18 of
        /// `fixtures/dev`; `tests/detect/fixtures.rs`.
        min_scatter: f64 = 0.007,
        /// Fraction of the median size below which a disc is a letter or a dot.
        min_relative_size: f64 = 0.5,
        /// Distance below which two blobs or discs are one, found twice, px.
        same_px: f64 = 2.0,
        /// Largest relative scatter of sizes about their plane: with more they are not on one surface.
        max_scatter: f64 = 0.02,
        /// Fraction of the median size below which a position is too far from all discs.
        min_relative_prediction: f64 = 0.25,
        /// Sum of a position's variances up to which nothing can hide a large part of a marker, px^2.
        certain_px2: f64 = 0.1,
        /// Largest sum of position variances if too few discs satisfy `certain_px2`, px^2.
        fallback_px2: f64 = 0.3,
    }
}
