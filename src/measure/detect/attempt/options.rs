//! Tuned numbers of an attempt: meaning, unit, origin.

numbers! {
    /// The measuring of one hypothesis.
    MEASURE: MeasureOptions {
        /// Standard deviations beyond which a bend of axis or edges is believed: 9 off the weighted squares for one
        /// unknown.
        bend_sigmas: f64 = 3.0,
        /// Share of white or skin below which a contrast does not tell the tone curve's exponent from the darkness: the
        /// grey half way up an edge then changes by less than half a percent with it, and both run away together.
        tells_gamma: f64 = 0.3,
        /// How much lighter than the skin glare is where its fringe ends, a ratio: beyond, it hides a disc sooner than
        /// it shows it. Chosen on the glare frames of 112 rendered sets.
        fringe: f64 = 1.2,
        /// What glare that changes across a disc too does to its place, px. Normalised error across of 43 discs 1.42 ->
        /// 1.04 (`docs/decisions/0014`).
        glare_px: f64 = 0.03,
        /// What an end that glare saturates does to a disc's place along its axis, px: twenty discs in 112 rendered
        /// sets were off by so much more than they said.
        one_end_px: f64 = 0.4,
        /// Share of a marker's contrast by which what is darker than the skin around it is foreign. Chosen on the
        /// rendered sets; `tests/detect/bad_light.rs`.
        foreign: f64 = 0.25,
        /// Semi-minor axis, blurs, from which on a marker tells how the frame was sharpened: else the overshoots of both
        /// its edges meet.
        tells_overshoot_blurs: f64 = 4.0,
        /// Least semi-axes of what may be a marker, px: major, minor. Below, it would tell nothing.
        least_px: [f64; 2] = [3.5, 0.7],
        /// Blur with which a fit begins where nothing tells it, px: that of a sharp picture.
        blur_px: f64 = 1.0,
        /// The same of large quadrants with which that fails, px: they may be near the camera and out of focus, by half of the
        /// greatest blur that is measured and more.
        soft_px: f64 = 2.0,
        /// Least tangent of half the angle between quadrants' edges to begin with.
        tangent: f64 = 0.02,
        /// Least semi-axes with which the last fit begins, px: major, minor.
        last_px: [f64; 2] = [1.0, 0.5],
        /// Fewer pixels are no beginning.
        least: usize = 20,
        /// How far off a rough fit is where no more is wanted, px, standard deviation: few pixels, and seams among them.
        rough_px: f64 = 0.2,
        /// A place through glare that moves less than so far from where its pixels were chosen stays, px.
        settled_px: f64 = 1.0,
        /// Scale of residuals over the frame's noise at least, a ratio, and grey levels: a grey value is rounded.
        scale: (f64, f64) = (0.8, 0.5),
        /// Least darkness to begin with: what is measured in the end has a little more.
        least_dark: f64 = 0.05,
        /// Least step from the darkest fortieth of the pixels to the lightest fifth, grey levels, to begin with.
        least_step: f64 = 3.0,
        /// By how much noise alone spreads them, in least scales of residuals, which are 0.8 of the noise. Derived: 1.96 and
        /// 0.84 standard deviations.
        spread_by_noise: f64 = 3.5,
        /// Axis ratio of a blob which is no marker whatever a fit would say: the flattest that is taken, and what a
        /// blob may be off.
        surely_flatter: f64 = 45.0,
    }

    /// Whether a blob may be a whole disc.
    WHOLE: WholeOptions {
        /// Skin about a disc that tells its grey, px.
        beside_px: f64 = 6.0,
        /// Squareness of a whole disc at most: always, and over the square of its semi-minor axis, px^2, for few pixels across
        /// make steps in its outline.
        square: (f64, f64) = (0.13, 1.3),
        /// Least semi-minor axis for that, px.
        thin_px: f64 = 0.5,
        /// Share of the residuals of quadrants that two discs in them may leave to be believed instead. Chosen;
        /// `tests/detect/bad_light.rs`.
        better: f64 = 0.5,
    }
}
