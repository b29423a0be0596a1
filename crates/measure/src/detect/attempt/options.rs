//! Tuned numbers of the measurement of one hypothesis: meaning, unit, origin.

numbers! {
    /// Fits to one hypothesis.
    MEASURE: MeasureOptions {
        /// Contrast over white or skin below which the tone curve's exponent is not separable from the darkness: the grey
        /// half way up an edge then changes by less than 0.5 % with it, and both diverge together.
        min_gamma_contrast: f64 = 0.3,
        /// Glare over skin, a ratio, at which the fringe of glare ends: beyond, it hides a disc rather than showing it.
        /// Chosen on the glare frames of 112 rendered sets.
        fringe_ratio: f64 = 1.2,
        /// Standard deviation of a disc's position due to glare that changes across it too, px. Normalised error across of
        /// 43 discs 1.42 -> 1.04 (`docs/decisions/0006`).
        glare_px: f64 = 0.03,
        /// Standard deviation of a disc's position along its axis due to an end saturated by glare, px: the additional
        /// error of 20 discs in 112 rendered sets.
        one_end_px: f64 = 0.4,
        /// Fraction of a marker's contrast by which pixels darker than the skin around it are excluded as contamination.
        /// Chosen on the rendered sets; `tests/detect/bad_light.rs`.
        foreign_contrast: f64 = 0.25,
        /// Smallest semi-axes of a hypothesis, px: major, minor. Below, it would not determine anything.
        min_axes_px: [f64; 2] = [3.5, 0.7],
        /// Blur with which a fit starts if none is predicted, px: that of a sharp image.
        blur_px: f64 = 1.0,
        /// Smallest tangent of half the angle between quadrants' edges at the start.
        min_tangent: f64 = 0.02,
        /// Smallest number of pixels for a start.
        min_pixels: usize = 20,
        /// Standard deviation of a coarse fit if no more is required, px: few pixels, with seams among them.
        rough_px: f64 = 0.2,
        /// Distance from the position for which the pixels were chosen below which a position through glare is final, px.
        settled_px: f64 = 1.0,
        /// Smallest scale of residuals over the frame's noise, a ratio.
        min_scale_over_noise: f64 = 0.8,
        /// Smallest scale of residuals, grey levels: grey values are rounded.
        min_scale: f64 = 0.5,
        /// Smallest darkness at the start; that of an accepted marker is slightly larger.
        min_start_darkness: f64 = 0.05,
        /// Smallest step from the darkest 1/40 of the pixels to the lightest 1/5 at the start, grey levels.
        min_start_step: f64 = 3.0,
        /// Spread of these two by noise alone, in smallest scales of residuals, which are 0.8 of the noise. Derived: 1.96
        /// and 0.84 standard deviations.
        spread_by_noise: f64 = 3.5,
        /// Axis ratio from which on a blob is not a marker regardless of a fit: the largest accepted one, plus the error of
        /// a blob.
        max_blob_axis_ratio: f64 = 45.0,
    }

    /// Recognition of whole discs among blobs.
    WHOLE: WholeOptions {
        /// Skin around a disc whose grey is determined, px.
        margin_px: f64 = 6.0,
        /// Largest squareness of a whole disc: constant part, and part over the square of its semi-minor axis, px^2,
        /// because few pixels across make steps in its outline.
        max_squareness: f64 = 0.13,
        max_squareness_px2: f64 = 1.3,
        /// Smallest semi-minor axis for that, px.
        min_axis_px: f64 = 0.5,
    }
}
