//! Tuned numbers of what is measured once more: meaning, unit, origin.

/// Markers measured once more, when those about them have told size, blur and darkness.
pub struct NeighbourOptions {
    /// Least share of a disc's length that must be seen of it. Chosen; `tests/detect/robustness.rs`.
    pub seen: f64,
    /// Standard deviations of the predicted size beyond which a disc is another thing: one in 16 000 by chance.
    pub unlike_sigmas: f64,
    /// The same where a disc is so thin that it tells little more than that size.
    pub unlike_thin_sigmas: f64,
    /// The same where its standard deviation shall say so: a streak that made a disc 2.5 px longer shifted it by
    /// 2.3 px with 0.4 px stated.
    pub unlikely_sigmas: f64,
    /// Markers that tell blur and darkness of those between them.
    pub enough: usize,
    /// How far blurs differ from one marker to another, as a share. Chosen: one lens blurs all alike.
    pub same_blur: f64,
    /// How far darkness differs. Chosen: one print, in the same light.
    pub same_dark: f64,
    /// Semi-minor axis below which a marker does not tell blur and darkness apart, blurs. Chosen;
    /// `tests/detect/robustness.rs`.
    pub thin_blurs: f64,
    /// Share of its length by which a thin disc's length may be off to stay one.
    pub none: f64,
}

/// The numbers in use.
pub const NEIGHBOUR: NeighbourOptions = NeighbourOptions {
    seen: 0.4,
    unlike_sigmas: 4.0,
    unlike_thin_sigmas: 2.5,
    unlikely_sigmas: 2.0,
    enough: 5,
    same_blur: 0.1,
    same_dark: 0.1,
    thin_blurs: 3.0,
    none: 0.25,
};

/// Discs over which the decal of one beside them lies. Chosen on drawn and rendered decals;
/// `tests/detect/decals.rs` holds them.
pub struct UnderDecalOptions {
    /// How far a disc may be whose decal hides another one, in its semi-major axes.
    pub beside: f64,
    /// Size over the other's at most: prints are alike.
    pub same_size: f64,
    /// Contrast over the other's at most: they lie in the same light.
    pub same_contrast: f64,
    /// Least share of its area that must be left: of a sliver the place was told 0.9 px off with 0.4 px stated.
    pub left: f64,
    /// Flatness over that of the disc beside it below which what looks whole may be a part of a thicker one: beyond
    /// what the skin's slope does to two side by side.
    pub thinner: f64,
    /// The same below which the skin's slope does not explain it.
    pub far_thinner: f64,
    /// The same below which of a disc that is known to be hidden in part the hidden edge may lie elsewhere.
    pub thinner_part: f64,
    /// Lengths of two markers over one another at most: dirt is shorter.
    pub same_kind: f64,
    /// Greatest standard deviation with which one that is too thin stays, px: that of any marker.
    pub most_px: f64,
}

/// The numbers in use.
pub const UNDER_DECAL: UnderDecalOptions = UnderDecalOptions {
    beside: 1.5,
    same_size: 1.1,
    same_contrast: 1.3,
    left: 0.25,
    thinner: 0.88,
    far_thinner: 0.7,
    thinner_part: 0.95,
    same_kind: 2.0,
    most_px: 2.0,
};

/// Markers whose outline the orientation predicts. Chosen on some 110 rendered sets; `tests/detect/closer.rs` holds
/// them.
pub struct OrientationOptions {
    /// Sum of a place's variances from which on a disc is looked at over which another one's decal may lie, px^2:
    /// it is less sure than it looks.
    pub hidden_px2: f64,
    /// The same up to which a disc tells how the predicted sizes fail, px^2: with 0.02 frames of much blur had too
    /// few of them.
    pub sure_px2: f64,
    /// Discs that tell it at least.
    pub enough: usize,
    /// How many of those alike tell what the skin's slope does.
    pub alike: usize,
    /// How far predicted major axes fail at least, as a share: diameter over distance, and prints differ by as
    /// much.
    pub major: f64,
    /// The same of minor axes, which follow the skin's slope: 2 % in rendered frames, and what a bending wing
    /// changes.
    pub minor: f64,
    /// The same of directions, rad: 0.01 in rendered frames, and what a bending wing changes.
    pub angle_rad: f64,
    /// The same of major axes where no disc tells it.
    pub unknown: f64,
    /// How far from its expected place a marker may be, px, unless the sure discs are farther.
    pub near_px: f64,
    /// Share of the former variances from which on a disc is taken for hidden that may be seen as a whole.
    pub surer: f64,
    /// Standard deviations by which a size differs from the predicted one that say that something is wrong.
    pub unlike_sigmas: f64,
    /// Share of quadrants that is surely theirs, wherever the skin slopes a little otherwise.
    pub inner: f64,
    /// How far quadrants' outline may be off, px: near the camera the centre of a target's outline is not its own.
    pub aside_px: f64,
    /// How much farther than it is seen glare is taken to reach, in ways from where it is seen to where it is
    /// bright: black is lit long before the skin is. Where too little is left then, as far as it is seen.
    pub fringes: [f64; 2],
    /// How much lighter glare makes the skin where it leaves too little of an edge, a ratio.
    pub blinds: f64,
    /// The greatest blur over the frame's, a ratio.
    pub softer: f64,
    /// Semi-minor axis below which a disc does not tell the blur, blurs.
    pub thin_blurs: f64,
    /// How far the blur differs in a frame, as a share.
    pub same_blur: f64,
}

/// The numbers in use.
pub const ORIENTATION: OrientationOptions = OrientationOptions {
    hidden_px2: 0.01,
    sure_px2: 0.08,
    enough: 3,
    alike: 5,
    major: 0.0015,
    minor: 0.03,
    angle_rad: 0.015,
    unknown: 0.01,
    near_px: 4.0,
    surer: 0.5,
    unlike_sigmas: 3.0,
    inner: 0.75,
    aside_px: 8.0,
    fringes: [1.0, 0.0],
    blinds: 1.3,
    softer: 2.5,
    thin_blurs: 3.0,
    same_blur: 0.1,
};
