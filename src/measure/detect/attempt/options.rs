//! Tuned numbers of an attempt: meaning, unit, origin.

/// The measuring of one hypothesis.
pub struct MeasureOptions {
    /// Standard deviations beyond which a bend of axis or edges is believed: 9 off the weighted squares for one
    /// unknown.
    pub bend_sigmas: f64,
    /// Share of white or skin below which a contrast does not tell the tone curve's exponent from the darkness: the
    /// grey half way up an edge then changes by less than half a percent with it, and both run away together.
    pub tells_gamma: f64,
    /// How much lighter than the skin glare is where its fringe ends, a ratio: beyond, it hides a disc sooner than
    /// it shows it. Chosen on the glare frames of 112 rendered sets.
    pub fringe: f64,
    /// What glare that changes across a disc too does to its place, px. Normalised error across of 43 discs 1.42 ->
    /// 1.04 (`docs/decisions/0014`).
    pub glare_px: f64,
    /// What an end that glare saturates does to a disc's place along its axis, px: twenty discs in 112 rendered
    /// sets were off by so much more than they said.
    pub one_end_px: f64,
    /// Share of a marker's contrast by which what is darker than the skin around it is foreign. Chosen on the
    /// rendered sets; `tests/detect/bad_light.rs`.
    pub foreign: f64,
    /// Least darkness to begin with: what is measured in the end has a little more.
    pub least_dark: f64,
    /// Least step from the darkest fortieth of the pixels to the lightest fifth, grey levels, to begin with.
    pub least_step: f64,
    /// By how much noise alone spreads them, in least scales of residuals, which are 0.8 of the noise. Derived: 1.96 and
    /// 0.84 standard deviations.
    pub spread_by_noise: f64,
    /// Axis ratio of a blob which is no marker whatever a fit would say: the flattest that is taken, and what a
    /// blob may be off.
    pub surely_flatter: f64,
}

/// The numbers in use.
pub const MEASURE: MeasureOptions = MeasureOptions {
    bend_sigmas: 3.0,
    tells_gamma: 0.3,
    fringe: 1.2,
    glare_px: 0.03,
    one_end_px: 0.4,
    foreign: 0.25,
    least_dark: 0.05,
    least_step: 3.0,
    spread_by_noise: 3.5,
    surely_flatter: 45.0,
};

/// Whether a blob may be a whole disc.
pub struct WholeOptions {
    /// Skin about a disc that tells its grey, px.
    pub beside_px: f64,
    /// Share of the residuals of quadrants that two discs in them may leave to be believed instead. Chosen;
    /// `tests/detect/bad_light.rs`.
    pub better: f64,
}

/// The numbers in use.
pub const WHOLE: WholeOptions = WholeOptions { beside_px: 6.0, better: 0.5 };
