//! Tuned numbers of the fit: meaning, unit, origin.

/// When an iteration is given up or ended: bounds on time, which change answers only where a fit does not settle.
pub struct IterationOptions {
    /// Most steps of a rough fit.
    pub most_rough: usize,
    /// Most steps of the last one: where the blur is another along than across, pixels of an end come back one by
    /// one.
    pub most_last: usize,
    /// Steps after which what still moves by more than the next number is given up.
    pub slow: usize,
    /// That number, px.
    pub slow_px: f64,
    /// Steps after which a fit that leaves a fifth of the contrast is none of a marker's.
    pub early: usize,
    /// Steps after which a rough fit that leaves more than a share of the contrast is none of a marker's: of 116
    /// rendered discs the worst left 0.28 then, of the fits that failed 0.4 more than 0.35.
    pub hopeless: (usize, f64),
    /// The same of edges that cross: of 123 the worst left 0.15, of the fits that failed 0.87 more than that.
    pub hopeless_crossing: (usize, f64),
    /// The same of quadrants by edges and outline together, which leave 0.12 at most in the end.
    pub hopeless_outlined: (usize, f64),
    /// Steps after which one that moves by a pixel is none.
    pub late: usize,
    /// Most steps of the fit with a field of light, which begins at the answer of the last one.
    pub field_most: usize,
    /// Most steps of the fit through glare.
    pub glare_most: usize,
    /// A step of the centre, in its standard deviations, after which that ends.
    pub glare_still: f64,
}

/// The numbers in use.
pub const ITERATION: IterationOptions = IterationOptions {
    most_rough: 20,
    most_last: 30,
    slow: 12,
    slow_px: 0.1,
    early: 5,
    hopeless: (2, 0.35),
    hopeless_crossing: (1, 0.25),
    hopeless_outlined: (2, 0.25),
    late: 8,
    field_most: 4,
    glare_most: 30,
    glare_still: 0.03,
};

/// Robust weights and correlated residuals.
pub struct WeightOptions {
    /// Residuals beyond this many scales have no weight. Tukey's biweight; at 4.7 it is 95 % efficient, wider it
    /// loses less of an edge that the model does not meet.
    pub cut_scales: f64,
    /// Unevenness of a real outline and of its sampling, px, that is no reason to distrust a pixel. Chosen;
    /// `tests/detect/fixtures.rs`.
    pub edge_jitter_px: f64,
    /// Side of the squares whose residuals may hang together, px: JPEG's.
    pub square_px: f64,
    /// Semi-axis, in squares, beyond which whole multiples of them are taken: so many independent squares are
    /// enough.
    pub squares: f64,
    /// Up to this ratio the variance from blocks is not told from the fit's own: there are few blocks.
    /// `tests/detect/fixtures.rs` holds the standard deviations under JPEG.
    pub chance: f64,
}

/// The numbers in use.
pub const WEIGHT: WeightOptions =
    WeightOptions { cut_scales: 6.0, edge_jitter_px: 0.08, square_px: 8.0, squares: 11.0, chance: 2.4 };

/// When the light is freed. Chosen on rendered sets; `tests/detect/bad_light.rs` and `tests/detect/fixtures.rs`
/// hold it.
pub struct LackOfFitOptions {
    /// Times its own variance beyond which a centre's variance from blocks of residuals is not chance.
    pub correlated: f64,
    /// Mean square of residuals by sectors, over that of independent ones, beyond which the light is uneven.
    pub uneven: f64,
    /// Share of pixels that the fit has left out, beyond which they are looked into.
    pub foreign: f64,
    /// What a field of light must take off the residuals' squares to be heard, in variances of one. Its 33 unknowns
    /// take off as many by chance, and several times as many where JPEG lets residuals hang together.
    pub doubtful: f64,
    /// The same to be believed: 8.5 for each unknown.
    pub certain: f64,
    /// What a first step must promise of that to be followed: half of what is heard.
    pub hopeless: f64,
}

/// The numbers in use.
pub const LACK_OF_FIT: LackOfFitOptions = LackOfFitOptions {
    correlated: 4.0,
    uneven: 1.5,
    foreign: 0.01,
    doubtful: 120.0,
    certain: 280.0,
    hopeless: 60.0,
};

/// What is known of a marker's image before the fit.
pub struct PriorOptions {
    /// Exponent of the tone curve with its standard deviation: that of pictures made for the eye (IEC 61966-2-1),
    /// and how far cameras depart from it.
    pub gamma: (f64, f64),
    /// A disc's sag over its semi-major axis, standard deviation: a disc of 0.2 m across on a skin of 5 m radius. A
    /// whole outline tells it better.
    pub sag: f64,
    /// Change of a disc's thickness along it, as a share, standard deviation. Chosen; `tests/detect/glare.rs`.
    pub taper: f64,
    /// How far the blurs of quadrants' edges differ from their mean, as a share: motion blurs them by their
    /// direction. `tests/detect/motion.rs`.
    pub uneven_blur: f64,
    /// How far the directions of twins differ, rad. Chosen, as the next two; `tests/detect/decals.rs`.
    pub twin_angle_rad: f64,
    /// The same of their lengths, as a share.
    pub twin_major: f64,
    /// The same of their thicknesses.
    pub twin_minor: f64,
    /// Semi-minor axis from which on a marker tells more of its light, and quadrants tell their bends, px. Chosen;
    /// `tests/detect/sweep.rs`.
    pub thick_px: f64,
    /// Semi-minor axis of quadrants up to which one of their edges may be too short to tell its bend, px. Chosen;
    /// `tests/detect/sweep.rs`.
    pub narrow_px: f64,
}

/// The numbers in use.
pub const PRIOR: PriorOptions = PriorOptions {
    gamma: (1.0 / 2.2, 0.15),
    sag: 0.01,
    taper: 0.05,
    uneven_blur: 0.1,
    twin_angle_rad: 0.02,
    twin_major: 0.03,
    twin_minor: 0.1,
    thick_px: 2.5,
    narrow_px: 10.0,
};

/// Narrow quadrants by edges and outline together. Chosen on drawn and rendered quadrants; `tests/detect/sweep.rs`
/// holds them.
pub struct OutlinedOptions {
    /// Least contrast of white against the skin, as a share of that of black: 0.21 and more in all of 588 of the
    /// rendered sets, 0.06 and less in what were discs.
    pub whiter: f64,
    /// How far the outline's centre is from the crossing, px, standard deviation: perspective, and how a target is
    /// cut.
    pub aside_px: f64,
    /// How far edges and outline bend at their ends, as a share of the length, standard deviation: a target of 40
    /// mm on a skin of 10 m radius, seen along it.
    pub bend: f64,
    /// How far black's darkness differs between the centre and the outline, standard deviation: one print.
    pub dark: f64,
    /// Pixels for outline and edges, about: more would only cost time.
    pub few_px: f64,
    /// Pixels for the answer, about: more than most such targets have.
    pub all_px: f64,
    /// Of so many pixels outside an outline, which only tell the skin, one is used.
    pub outside: usize,
    /// Part of a period by which the pixels of a row lie aside of those of the last: the golden ratio, which
    /// repeats least.
    pub shift: f64,
    /// Least scale of the residuals for the weights, as a share of the contrast: an end that the first outline has
    /// missed is no outlier.
    pub least_scale: f64,
    /// Greatest scale in the end, as a share of the contrast.
    pub most_scale: f64,
    /// Least semi-major axis of what may be such quadrants, px.
    pub shortest_px: f64,
    /// Least contrast, grey levels.
    pub least_contrast: f64,
    /// How much larger than an outline its pixels reach.
    pub room: f64,
    /// How much it may grow until others are chosen: half of that.
    pub grown: f64,
    /// How often they are chosen: a bound on time.
    pub rounds: usize,
}

/// The numbers in use.
pub const OUTLINED: OutlinedOptions = OutlinedOptions {
    whiter: 0.12,
    aside_px: 1.0,
    bend: 0.002,
    dark: 0.005,
    few_px: 400.0,
    all_px: 6000.0,
    outside: 3,
    shift: 0.618,
    least_scale: 0.1,
    most_scale: 0.12,
    shortest_px: 10.0,
    least_contrast: 6.0,
    room: 1.2,
    grown: 1.1,
    rounds: 5,
};

/// Optional terms of the image formula.
pub struct TermOptions {
    /// How far light departs from a plane, as a share, standard deviation of a knot: a shadow's edge.
    /// `tests/detect/bad_light.rs`.
    pub field_light: f64,
    /// The same of darkness.
    pub field_dark: f64,
    /// Distance of the glare spline's knots, px: glare on a wing changes over tens of pixels. Chosen on 414 discs
    /// of 35 rendered glare frames, as all of glare; `tests/detect/glare.rs` holds it.
    pub knot_px: f64,
    /// Grey value from which on a pixel is saturated, or JPEG has mixed it with what is.
    pub saturated: f32,
    /// How much lighter what is saturated is taken for at first than it looks.
    pub more: f64,
    /// Blurs from an edge at which a pixel is black or skin only: 0.1 % of the other.
    pub clear_blurs: f64,
    /// Slants that are tried to each side.
    pub slants: i32,
    /// Their step, px along for each px across.
    pub slant_step: f64,
    /// Length along the disc in which glare is taken for even then, px.
    pub bin_px: f64,
    /// Share of the semi-major axis that is an end.
    pub tip: f32,
    /// Share of an end's pixels that must not be saturated for it to be seen.
    pub ends: f64,
    /// How far the glare of a knot is known beforehand at least, over the skin's own light, standard deviation.
    pub glare_floor: f64,
    /// The same as a share of the greatest glare beside it.
    pub glare_share: f64,
}

/// The numbers in use.
pub const TERM: TermOptions = TermOptions {
    field_light: 0.15,
    field_dark: 0.15,
    knot_px: 10.0,
    saturated: 250.0,
    more: 1.2,
    clear_blurs: 3.0,
    slants: 20,
    slant_step: 0.1,
    bin_px: 3.0,
    tip: 0.2,
    ends: 0.9,
    glare_floor: 0.03,
    glare_share: 1.0,
};
