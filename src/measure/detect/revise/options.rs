//! Tuned numbers of what is measured once more: meaning, unit, origin.

numbers! {
    /// Markers measured once more, when those about them have told size, blur and darkness.
    NEIGHBOUR: NeighbourOptions {
        /// Least share of a disc's length that must be seen of it. Chosen; `tests/detect/robustness.rs`.
        seen: f64 = 0.4,
        /// Standard deviations of the predicted size beyond which a disc is another thing: one in 16 000 by chance.
        unlike_sigmas: f64 = 4.0,
        /// The same where a disc is so thin that it tells little more than that size.
        unlike_thin_sigmas: f64 = 2.5,
        /// The same where its standard deviation shall say so: a streak that made a disc 2.5 px longer shifted it by
        /// 2.3 px with 0.4 px stated.
        unlikely_sigmas: f64 = 2.0,
        /// Markers that tell blur and darkness of those between them.
        enough: usize = 5,
        /// How far blurs differ from one marker to another, as a share. Chosen: one lens blurs all alike.
        same_blur: f64 = 0.1,
        /// How far darkness differs. Chosen: one print, in the same light.
        same_dark: f64 = 0.1,
        /// Semi-minor axis below which a marker does not tell blur and darkness apart, blurs. Chosen;
        /// `tests/detect/robustness.rs`.
        thin_blurs: f64 = 3.0,
        /// Share of its length by which a thin disc's length may be off to stay one.
        none: f64 = 0.25,
    }

    /// Discs over which the decal of one beside them lies. Chosen on drawn and rendered decals;
    /// `tests/detect/decals.rs` holds them.
    UNDER_DECAL: UnderDecalOptions {
        /// How far a disc may be whose decal hides another one, in its semi-major axes.
        beside: f64 = 1.5,
        /// Size over the other's at most: prints are alike.
        same_size: f64 = 1.1,
        /// Contrast over the other's at most: they lie in the same light.
        same_contrast: f64 = 1.3,
        /// Least share of its area that must be left: of a sliver the place was told 0.9 px off with 0.4 px stated.
        left: f64 = 0.25,
        /// Flatness over that of the disc beside it below which what looks whole may be a part of a thicker one: beyond
        /// what the skin's slope does to two side by side.
        thinner: f64 = 0.88,
        /// The same below which the skin's slope does not explain it.
        far_thinner: f64 = 0.7,
        /// The same below which of a disc that is known to be hidden in part the hidden edge may lie elsewhere.
        thinner_part: f64 = 0.95,
        /// Lengths of two markers over one another at most: dirt is shorter.
        same_kind: f64 = 2.0,
    }

    /// Markers whose outline the orientation predicts. Chosen on some 110 rendered sets; `tests/detect/closer.rs` holds
    /// them.
    ORIENTATION: OrientationOptions {
        /// Sum of a place's variances from which on a disc is looked at over which another one's decal may lie, px^2:
        /// it is less sure than it looks.
        hidden_px2: f64 = 0.01,
        /// The same up to which a disc tells how the predicted sizes fail, px^2: with 0.02 frames of much blur had too
        /// few of them.
        sure_px2: f64 = 0.08,
        /// Discs that tell it at least.
        enough: usize = 3,
        /// How many of those alike tell what the skin's slope does.
        alike: usize = 5,
        /// How far predicted major axes fail at least, as a share: diameter over distance, and prints differ by as
        /// much.
        major: f64 = 0.0015,
        /// The same of minor axes, which follow the skin's slope: 2 % in rendered frames, and what a bending wing
        /// changes.
        minor: f64 = 0.03,
        /// The same of directions, rad: 0.01 in rendered frames, and what a bending wing changes.
        angle_rad: f64 = 0.015,
        /// The same of major axes where no disc tells it.
        unknown: f64 = 0.01,
        /// How far from its expected place a marker may be, px, unless the sure discs are farther.
        near_px: f64 = 4.0,
        /// How many times as far as those in the median.
        farther: f64 = 3.0,
        /// Standard deviation of those failures over their median size: 1.48 of the normal law, rounded.
        sigma_over_median: f64 = 1.5,
        /// Share of the former variances from which on a disc is taken for hidden that may be seen as a whole.
        surer: f64 = 0.5,
        /// Standard deviations by which a size differs from the predicted one that say that something is wrong.
        unlike_sigmas: f64 = 3.0,
        /// Share of quadrants that is surely theirs, wherever the skin slopes a little otherwise.
        inner: f64 = 0.75,
        /// How far quadrants' outline may be off, px: near the camera the centre of a target's outline is not its own.
        aside_px: f64 = 8.0,
        /// How much farther than it is seen glare is taken to reach, in ways from where it is seen to where it is
        /// bright: black is lit long before the skin is. Where too little is left then, as far as it is seen.
        fringes: [f64; 2] = [1.0, 0.0],
        /// How much lighter glare makes the skin where it leaves too little of an edge, a ratio.
        blinds: f64 = 1.3,
        /// The greatest blur over the frame's, a ratio.
        softer: f64 = 2.5,
    }
}
