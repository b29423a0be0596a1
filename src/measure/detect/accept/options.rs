//! Tuned numbers of what is accepted: meaning, unit, origin.

/// What a fit must be to be a marker.
pub struct VerdictOptions {
    /// Share of a disc's sag that is added along its axis: how a decal lies on a curved skin is not known, and
    /// stretched or not differs by the sag times the skin's slope, for which one in fourteen stands.
    pub laid: f64,
    /// Share of a disc's outline that glare may hide. Chosen on the rendered glare frames; `tests/detect/glare.rs`.
    pub hidden_by_glare: f64,
    /// What glare's fringe, up to a tenth of the skin's light before it is seen, does to an edge beside it, px.
    /// Derived: a tenth of an edge's width.
    pub fringe_px: f64,
    /// The same where most of the fringe is left out, or measured. Normalised errors of 1626 discs in glare 0.99
    /// and 0.96 (`docs/decisions/0014`).
    pub rest_of_fringe_px: f64,
    /// Semi-minor axis below which it shifts a disc less across, px: both edges lie in about the same light. Chosen
    /// with the last one.
    pub even_px: f64,
    /// Greatest standard deviation of a centre, px. Chosen: beyond, it bears nothing on the wing's shape.
    pub vaguest_px: f64,
    /// The same of a disc whose length is predicted, so that no more than the place along it is in doubt.
    pub vaguest_predicted_px: f64,
    /// The same of quadrants whose outline is predicted: edges that only point at their crossing are off by more
    /// than they say (1.3 px with 0.4 px stated; `tests/detect/closer.rs`).
    pub vaguest_crossing_px: f64,
    /// Axis ratio of the flattest disc. Seen from a metre above the skin, discs are 1:28 on a wing that bends
    /// downwards, and seams are far flatter.
    pub flattest: f64,
    /// That of quadrants, which are nearer: flatter ones are two discs side by side.
    pub flattest_quadrants: f64,
    /// Least darkness: 3 % of the grey of white or skin. Dirt and panel lines are as pale.
    pub least_dark: f64,
    /// Least contrast, grey levels: steps of JPEG's are as high.
    pub least_contrast: f64,
    /// The same in standard deviations of the noise: of the hundred pixels about the smallest marker's edge chance makes
    /// no such step.
    pub over_noise: f64,
    /// Greatest blur that is measured, px. Chosen: farther out of focus than a camera is left.
    pub softest_px: f64,
    /// What noise may be at edges, grey levels, where JPEG has left none of it beside them. Chosen;
    /// `tests/detect/bad_light.rs`.
    pub lost_noise: f64,
}

/// The numbers in use.
pub const VERDICT: VerdictOptions = VerdictOptions {
    laid: 0.07,
    hidden_by_glare: 0.64,
    fringe_px: 0.1,
    rest_of_fringe_px: 0.06,
    even_px: 20.0,
    vaguest_px: 2.0,
    vaguest_predicted_px: 2.5,
    vaguest_crossing_px: 0.5,
    flattest: 40.0,
    flattest_quadrants: 26.0,
    least_dark: 0.06,
    least_contrast: 5.0,
    over_noise: 4.0,
    softest_px: 3.2,
    lost_noise: 1.0,
};

/// Quadrants of a target against squares of a checkerboard.
pub struct PatternOptions {
    /// How much farther black may reach along the middle of a quadrant than to both sides of it, a ratio. Half way
    /// between a circle's 1 and a square's 1.37; `tests/detect/background.rs`.
    pub corner: f64,
    /// Least semi-minor axis of which that can be told, blurs. Chosen; `tests/detect/background.rs`.
    pub tells_corner_blurs: f64,
    /// Where, from the middle (0) to the edges (1) of a quadrant, its sides are looked at. Chosen: a square's
    /// corner is far, the edges' blur not yet near.
    pub aside: f64,
}

/// The numbers in use.
pub const PATTERN: PatternOptions = PatternOptions { corner: 1.18, tells_corner_blurs: 8.0, aside: 0.65 };

/// What a frame's markers have in common.
pub struct ConsistencyOptions {
    /// Skin between two discs in a row from which on they are no quadrants, blurs: the black of quadrants meets.
    /// The test of this file.
    pub apart_blurs: f64,
    /// Greatest blur over the middle one, a ratio: one lens makes all edges. Chosen on the rendered sets; the test
    /// of this file.
    pub softer: f64,
    /// Markers that tell it. Fewer may all be something else.
    pub blurs: usize,
    /// Flat things that tell the skin's horizon. Fewer may all be something else.
    pub directions: usize,
    /// Axis ratio from which on a direction is told.
    pub flat: f64,
    /// Of discs how flat one must be to be judged, and how far across it may lie, rad: of 20 300 markers in 116
    /// rendered sets none lies more than 0.3 rad across.
    pub disc_across: (f64, f64),
    /// The same of quadrants, which lie up to 0.41 rad across near the camera.
    pub quadrants_across: (f64, f64),
    /// Size of the next larger one over a thing that is too small to be a marker: one would have to be so many
    /// times as far away as all others. Chosen on the rendered sets; `tests/detect/near.rs`.
    pub gap: f64,
    /// How much longer those beside a thing must be that tell it: other dots do not.
    pub longer: f64,
    /// Larger ones that tell it: of the nearest one more, for that may be a dot.
    pub sizes: usize,
}

/// The numbers in use.
pub const CONSISTENCY: ConsistencyOptions = ConsistencyOptions {
    apart_blurs: 3.0,
    softer: 2.0,
    blurs: 5,
    directions: 5,
    flat: 2.0,
    disc_across: (8.0, 0.6),
    quadrants_across: (2.5, 0.8),
    gap: 2.5,
    longer: 1.3,
    sizes: 4,
};

/// Residuals that hang together in all of a frame's markers.
pub struct CorrelatedOptions {
    /// How far the median ratio of a frame's markers exceeds 1 by chance. Derived: with twenty of them, two
    /// standard deviations.
    pub chance: f64,
    /// Fewer markers do not tell. Derived: the median of eight scatters by 0.4 of one's scatter.
    pub least: usize,
}

/// The numbers in use.
pub const CORRELATED: CorrelatedOptions = CorrelatedOptions { chance: 1.25, least: 8 };

/// Dirt along a disc. Chosen on 2244 discs of 24 rendered sets, whose normalised error across fell from 1.21 to
/// 1.06; `tests/detect/dirt.rs` holds it.
pub struct DirtOptions {
    /// Where the skin is looked at, blurs from the outline: there the edge leaves 1 % of its contrast.
    pub clear_blurs: f64,
    /// How many pixels outwards from there.
    pub reach_px: usize,
    /// Of these the nearest, which tell, px.
    pub nearest_px: usize,
    /// At every so many along the disc, px.
    pub step_px: f64,
    /// At what share of its length: tips face along it.
    pub length: f64,
    /// How far another marker's blur reaches, blurs. Derived: beyond, it leaves 0.1 % of its contrast.
    pub skirt_blurs: f64,
    /// Pixels of a side that must be seen.
    pub least_px: f64,
    /// Share of the contrast up to which what is unlike the skin counts: more is another thing.
    pub most: f64,
    /// How far what lies beside an edge shifts it, in blurs, for each contrast that it is darker than the skin.
    /// Near the slope of a blurred edge, sqrt(2 pi) = 2.5.
    pub shift_blurs: f64,
    /// By how much the mean of residuals that hang together scatters more than that of independent ones.
    pub together: f64,
    /// Standard deviations up to which a difference is chance.
    pub chance: f64,
    /// Rounds of the robust fit of the skin's light: it hardly changes after two.
    pub rounds: usize,
    /// Residual scales from which on a pixel has no say in it: Tukey's biweight, 95 % efficient.
    pub cut_scales: f64,
    /// Least scale of residuals, grey levels. Derived: a grey value is a whole number, 1/sqrt(12).
    pub floor: f64,
}

/// The numbers in use.
pub const DIRT: DirtOptions = DirtOptions {
    clear_blurs: 2.2,
    reach_px: 6,
    nearest_px: 3,
    step_px: 2.0,
    length: 0.85,
    skirt_blurs: 3.0,
    least_px: 20.0,
    most: 0.5,
    shift_blurs: 2.25,
    together: 2.0,
    chance: 2.0,
    rounds: 3,
    cut_scales: 4.7,
    floor: 0.3,
};

/// Which of two answers for one thing is kept.
pub struct BetterOptions {
    /// Size of one over the other's, products of their semi-axes, from which on the smaller one is a part: a decal or glare that
    /// hides half of a disc.
    pub part: f64,
    /// Standard deviations by which two answers for one place may differ: one in 16 000 by chance.
    pub alike_sigmas: f64,
}

/// The numbers in use.
pub const BETTER: BetterOptions = BetterOptions { part: 2.0, alike_sigmas: 4.0 };
