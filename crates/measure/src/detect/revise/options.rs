//! Tuned numbers of repeated measurements: meaning, unit, origin.

numbers! {
    /// Markers measured again with size, blur and darkness from their neighbours.
    NEIGHBOUR: NeighbourOptions {
        /// Smallest visible fraction of a disc's length. Chosen; `tests/detect/robustness.rs`.
        min_visible: f64 = 0.4,
        /// Limit for a disc so thin that it determines little more than that size, standard deviations.
        max_thin_size_sigmas: f64 = 2.5,
        /// Largest error of a thin disc's length to remain accepted, as a fraction of its length.
        max_length_error: f64 = 0.25,
    }

    /// Discs under the decal of a neighbouring disc. Chosen on drawn and rendered decals; `tests/detect/decals.rs`.
    UNDER_DECAL: UnderDecalOptions {
        /// Largest distance of a disc whose decal hides another one, in its semi-major axes.
        max_distance: f64 = 1.5,
        /// Largest ratio of the sizes of neighbours: prints are similar.
        max_size_ratio: f64 = 1.1,
        /// Largest ratio of the contrasts of neighbours: they lie in the same light.
        max_contrast_ratio: f64 = 1.3,
        /// Smallest visible fraction of a disc's area: the position of a sliver was off by 0.9 px with a standard deviation
        /// of 0.4 px.
        min_area: f64 = 0.25,
        /// Axis ratio (minor over major) relative to that of the neighbour below which a disc that looks whole may be a
        /// part of a thicker one: beyond the effect of the skin's slope on two neighbours.
        thin_ratio: f64 = 0.88,
        /// Relative axis ratio below which the skin's slope does not explain it.
        thin_ratio_whole: f64 = 0.7,
        /// Relative axis ratio of a partly hidden disc below which the hidden edge may lie elsewhere.
        thin_ratio_part: f64 = 0.95,
    }

    /// Markers whose outline the orientation predicts. Chosen on some 110 rendered sets; `tests/detect/second_pass.rs`.
    ORIENTATION: OrientationOptions {
        /// Sum of a position's variances from which on a disc is checked for another one's decal over it, px^2: its
        /// covariance may be too small.
        recheck_px2: f64 = 0.01,
        /// Sum of a position's variances up to which a disc contributes to the errors of predicted sizes, px^2: with 0.02,
        /// frames with large blur had too few.
        reliable_px2: f64 = 0.08,
        /// Smallest number of such discs.
        min_discs: usize = 3,
        /// Smallest relative error of predicted major axes: diameter over distance; prints differ by as much.
        major_sigma: f64 = 0.0015,
        /// Smallest relative error of predicted minor axes, which depend on the skin's slope: 2 % in rendered frames, plus
        /// the effect of bending.
        minor_sigma: f64 = 0.03,
        /// Smallest error of predicted directions, rad: 0.01 in rendered frames, plus the effect of bending.
        angle_sigma_rad: f64 = 0.015,
        /// Relative error of predicted major axes without reliable discs.
        unknown_major_sigma: f64 = 0.01,
        /// Largest distance of a marker from its predicted position, px, unless the reliable discs are farther away.
        max_distance_px: f64 = 4.0,
        /// Factor on the median distance of the reliable discs.
        distance_factor: f64 = 3.0,
        /// Inner fraction of quadrants that is certainly theirs if the skin slopes slightly differently.
        inner_fraction: f64 = 0.75,
        /// Error of quadrants' outline, px: near the camera the centre of a target's outline is not its own.
        outline_error_px: f64 = 8.0,
        /// Largest blur over that of the frame, a ratio.
        max_blur_ratio: f64 = 2.5,
    }
}
