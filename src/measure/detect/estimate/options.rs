//! Tuned numbers of the fit: meaning, unit, origin.

use crate::detect::hypothesis::prior::PriorValue;

numbers! {
    /// When an iteration is given up or ended: bounds on time, which change answers only where a fit does not settle.
    ITERATION: IterationOptions {
        /// Most steps of a rough fit.
        max_coarse_steps: usize = 20,
        /// Most steps of the last one: where the blur is another along than across, pixels of an end come back one by
        /// one.
        max_final_steps: usize = 30,
        /// Steps after which what still moves by more than the next number is given up.
        slow_after: usize = 12,
        /// That number, px.
        slow_px: f64 = 0.1,
        /// First scale of a rough fit's residuals, a share of the contrast: most pixels are flat and say nothing of an edge that
        /// is still off.
        first_scale: f64 = 0.15,
        /// Least share of itself to which the scale comes down in one step, for the same reason.
        min_scale_ratio: f64 = 0.4,
        /// Steps of a rough fit in which the normal equations are damped.
        damped_steps: usize = 2,
        /// By what share of the diagonal (Levenberg and Marquardt's).
        damping: f64 = 1e-3,
        /// The same afterwards: only against rounding.
        final_damping: f64 = 1e-10,
        /// A step of the centre below which it is lengthened by what the weights' change takes off it, px.
        gain_px: f64 = 0.05,
        /// How much longer it is made at most, a ratio.
        max_gain: f64 = 1.5,
        /// A step of centre and length after which a rough fit ends, px: its pixels are chosen by it.
        coarse_tolerance_px: f64 = 0.02,
        /// A change of the scale from one step to the next, as a share, after which it ends.
        coarse_scale_change: f64 = 0.2,
        /// The same after which the last fit ends.
        final_scale_change: f64 = 0.15,
        /// A share of the residuals' squares that a step takes off, after which a rough fit ends whatever the scale does.
        min_reduction: f64 = 0.1,
        /// A step of the centre, in its standard deviations, after which the last fit ends.
        final_tolerance: f64 = 0.1,
        /// Steps after which a fit that leaves so large a share of the contrast is none of a marker's.
        early_after: usize = 5,
        /// That share.
        early_residual: f64 = 0.2,
        /// Steps after which a rough fit that leaves more than a share of the contrast is none of a marker's: of 116
        /// rendered discs the worst left 0.28 then, of the fits that failed 0.4 more than 0.35.
        hopeless: (usize, f64) = (2, 0.35),
        /// The same of edges that cross: of 123 the worst left 0.15, of the fits that failed 0.87 more than that.
        hopeless_crossing: (usize, f64) = (1, 0.25),
        /// The same of quadrants by edges and outline together, which leave 0.12 at most in the end.
        hopeless_outlined: (usize, f64) = (2, 0.25),
        /// Steps after which one that still moves, and leaves more than a marker does, is none.
        late_after: usize = 8,
        /// By how much it moves then, px.
        late_px: f64 = 1.0,
        /// What it leaves, a share of the contrast.
        late_residual: f64 = 0.05,
        /// Most steps of the fit with a field of light, which begins at the answer of the last one.
        max_field_steps: usize = 4,
        /// Its damping in the first two steps and afterwards, shares of the diagonal.
        field_damping: [f64; 2] = [1e-3, 1e-7],
        /// A step of its centre after which it ends, px, and the longest one, px.
        field_px: (f64, f64) = (1e-3, 2.0),
        /// A fall of the scale from one step to the next, a ratio, below which it ends, as the fit through glare does.
        scale_ratio_converged: f64 = 0.9,
        /// Least share of itself to which their scale comes down in one step.
        min_final_scale_ratio: f64 = 0.5,
        /// First scale of their residuals, over what the fit before left, where something foreign pulled at that.
        scale_with_foreign: f64 = 3.0,
        /// The same where glare did.
        scale_with_glare: f64 = 4.0,
        /// Longest step of the centre through glare, px.
        max_glare_step_px: f64 = 1.5,
        /// Most steps of the fit through glare.
        max_glare_steps: usize = 30,
        /// A step of the centre, in its standard deviations, after which that ends.
        glare_tolerance: f64 = 0.03,
    }

    /// Robust weights and correlated residuals.
    WEIGHT: WeightOptions {
        /// Residuals beyond this many scales have no weight. Tukey's biweight; at 4.7 it is 95 % efficient, wider it
        /// loses less of an edge that the model does not meet.
        cut_scales: f64 = 6.0,
        /// Least scale of residuals, a share of the contrast: the image formula is no better.
        floor: f64 = 0.02,
        /// Root of the weight, half, from which on a pixel tells the residuals' scale.
        scale_root: f32 = 0.7,
        /// Unevenness of a real outline and of its sampling, px, that is no reason to distrust a pixel. Chosen;
        /// `tests/detect/fixtures.rs`.
        edge_jitter_px: f64 = 0.08,
        /// Side of the squares whose residuals may hang together, px: JPEG's.
        square_px: f64 = 8.0,
        /// Semi-axis, in squares, beyond which whole multiples of them are taken: so many independent squares are
        /// enough.
        squares: f64 = 11.0,
        /// Most by which what a fit takes off each block is allowed for, a ratio: with so few blocks more is no estimate.
        max_correction: f64 = 2.5,
        /// Up to this ratio the variance from blocks is not told from the fit's own: there are few blocks.
        /// `tests/detect/fixtures.rs` holds the standard deviations under JPEG.
        max_random_ratio: f64 = 2.4,
    }

    /// When the light is freed. Chosen on rendered sets; `tests/detect/bad_light.rs` and `tests/detect/fixtures.rs`
    /// hold it.
    LACK_OF_FIT: LackOfFitOptions {
        /// Times its own variance beyond which a centre's variance from blocks of residuals is not chance.
        correlated: f64 = 4.0,
        /// Mean square of residuals by sectors, over that of independent ones, beyond which the light is uneven.
        uneven: f64 = 1.5,
        /// Share of pixels that the fit has left out, beyond which they are looked into.
        foreign: f64 = 0.01,
        /// What a field of light must take off the residuals' squares to be heard, in variances of one. Its 33 unknowns
        /// take off as many by chance, and several times as many where JPEG lets residuals hang together.
        uncertain_gain: f64 = 120.0,
        /// The same to be believed: 8.5 for each unknown.
        certain_gain: f64 = 280.0,
        /// What a first step must promise of that to be followed: half of what is heard.
        min_first_gain: f64 = 60.0,
    }

    /// What is known of a marker's image before the fit.
    PRIOR: PriorOptions {
        /// Exponent of the tone curve with its standard deviation: that of pictures made for the eye (IEC 61966-2-1),
        /// and how far cameras depart from it.
        gamma: PriorValue = PriorValue { value: 1.0 / 2.2, sigma: 0.15 },
        /// A disc's sag over its semi-major axis, standard deviation: a disc of 0.2 m across on a skin of 5 m radius. A
        /// whole outline tells it better.
        sag: f64 = 0.01,
        /// Change of a disc's thickness along it, as a share, standard deviation. Chosen; `tests/detect/glare.rs`.
        taper: f64 = 0.05,
        /// How far the blurs of quadrants' edges differ from their mean, as a share: motion blurs them by their
        /// direction. `tests/detect/motion.rs`.
        uneven_blur: f64 = 0.1,
        /// How far the directions of twins differ, rad. Chosen, as the next two; `tests/detect/decals.rs`.
        twin_angle_rad: f64 = 0.02,
        /// The same of their lengths, as a share.
        twin_major: f64 = 0.03,
        /// The same of their thicknesses.
        twin_minor: f64 = 0.1,
        /// Semi-minor axis from which on a marker tells more of its light, and quadrants tell their bends, px. Chosen;
        /// `tests/detect/sweep.rs`.
        thick_px: f64 = 2.5,
        /// Semi-minor axis from which on darkness across it is told, px. Chosen, as the next two.
        dark_px: f64 = 6.0,
        /// Semi-major axis from which on the square of the light along it is, px.
        light_px: f64 = 15.0,
        /// The same of bends.
        bend_px: f64 = 12.0,
        /// Semi-minor axis of quadrants up to which one of their edges may be too short to tell its bend, px. Chosen;
        /// `tests/detect/sweep.rs`.
        narrow_px: f64 = 10.0,
    }

    /// Narrow quadrants by edges and outline together. Chosen on drawn and rendered quadrants; `tests/detect/sweep.rs`
    /// holds them.
    OUTLINED: OutlinedOptions {
        /// Least contrast of white against the skin, as a share of that of black: 0.21 and more in all of 588 of the
        /// rendered sets, 0.06 and less in what were discs.
        whiter: f64 = 0.12,
        /// How far the outline's centre is from the crossing, px, standard deviation: perspective, and how a target is
        /// cut.
        aside_px: f64 = 1.0,
        /// How far edges and outline bend at their ends, as a share of the length, standard deviation: a target of 40
        /// mm on a skin of 10 m radius, seen along it.
        bend: f64 = 0.002,
        /// How far black's darkness differs between the centre and the outline, standard deviation: one print.
        dark: f64 = 0.005,
        /// Pixels for outline and edges, about: more would only cost time.
        coarse_px: f64 = 400.0,
        /// Pixels for the answer, about: more than most such targets have.
        final_px: f64 = 6000.0,
        /// How far beyond their outline pixels are taken, blurs and px: flat skin must be among them.
        beyond: (f64, f64) = (2.5, 2.0),
        /// Of so many pixels outside an outline, which only tell the skin, one is used.
        outside_step: usize = 3,
        /// Of so many pixels within it one at least.
        max_step: f64 = 1024.0,
        /// Part of a period by which the pixels of a row lie aside of those of the last: the golden ratio, which
        /// repeats least.
        row_shift: f64 = 0.618,
        /// Least scale of the residuals for the weights, as a share of the contrast: an end that the first outline has
        /// missed is no outlier.
        min_scale: f64 = 0.1,
        /// Greatest scale in the end, as a share of the contrast.
        max_scale: f64 = 0.12,
        /// Least semi-major axis of what may be such quadrants, px.
        min_major_px: f64 = 10.0,
        /// Least contrast, grey levels.
        min_contrast: f64 = 6.0,
        /// How much larger than an outline its pixels reach.
        larger: f64 = 1.2,
        /// How much it may grow until others are chosen: half of that.
        max_growth: f64 = 1.1,
        /// How often they are chosen: a bound on time.
        max_rounds: usize = 5,
    }

    /// Overshoot of sharpened pictures.
    OVERSHOT: OvershotOptions {
        /// Root mean square of a marker's residuals over the noise from which on sharpening is sought: what noise leaves.
        over_noise: f64 = 1.2,
        /// The same over its contrast, at least and at most: what the image formula's own floor is, and what an overshoot of twice
        /// an edge leaves beside one.
        residual_range: (f64, f64) = (0.02, 0.2),
        /// Least amplitude that matters. Derived: 2 % of the contrast at an edge, the image formula's floor, over the 0.13
        /// that an edge and its copy differ by.
        min_amplitude: f64 = 0.15,
        /// Amplitude with which the search begins: nothing is known.
        first_amplitude: f64 = 0.5,
        /// Halos that are tried, px: cameras hold a picture against copies that are blurred by 0.7 to 2 px, and residuals of
        /// discs in rendered phone frames change by 2 % between 1 and 2.
        halos_px: [f64; 3] = [1.0, 1.4, 2.0],
        /// Least contrast over that without: more of it would be no overshoot but the edge.
        min_contrast_ratio: f64 = 0.5,
        /// Least blur with which it begins, px: sharpening made the edge look sharper than it is.
        min_first_blur_px: f64 = 0.8,
        /// Standard deviations up to which an amplitude is chance.
        significance: f64 = 3.0,
        /// What it must take off a marker's squares, in variances of one: five standard deviations of its one unknown.
        min_gain: f64 = 25.0,
        /// Two sightings nearer to each other are of one thing, px.
        apart_px: f64 = 5.0,
        /// Markers that tell it at least: fewer may all be dirt.
        min_markers: usize = 4,
        /// Share of the markers that were looked at that must show it.
        min_share: f64 = 0.6,
        /// Markers that tell enough.
        enough_markers: usize = 10,
        /// Things that may be markers and are looked at, at most, the largest: a bound on time.
        max_examined: usize = 30,
        /// How far it differs from marker to marker at least, as a share: noise reduction and tone mapping by place.
        min_scatter: f64 = 0.1,
    }

    /// Optional terms of the image formula.
    TERM: TermOptions {
        /// How far light and darkness depart from a plane, as a share, standard deviation of a knot: a shadow's edge.
        /// `tests/detect/bad_light.rs`.
        field: f64 = 0.15,
        /// Distance of the glare spline's knots, px: glare on a wing changes over tens of pixels. Chosen on 414 discs
        /// of 35 rendered glare frames, as all of glare; `tests/detect/glare.rs` holds it.
        knot_px: f64 = 10.0,
        /// Grey value from which on a pixel is saturated, or JPEG has mixed it with what is.
        saturated: f32 = 250.0,
        /// How much lighter what is saturated is taken for at first than it looks.
        saturated_factor: f64 = 1.2,
        /// How far beyond the disc knots reach: shares of its semi-axes, and px. Chosen: as far as its pixels, aslant too.
        reach: (f64, f64, f64) = (1.2, 2.0, 20.0),
        /// How near to foreign pixels the others are left out of a field of light, blurs and px: as far as they darken.
        foreign: (f64, f64) = (2.5, 1.0),
        /// Blurs from an edge at which a pixel is black or skin only: 0.1 % of the other.
        clear_blurs: f64 = 3.0,
        /// Slants that are tried to each side.
        slants: i32 = 20,
        /// Their step, px along for each px across.
        slant_step: f64 = 0.1,
        /// Length along the disc in which glare is taken for even then, px.
        bin_px: f64 = 3.0,
        /// Share of the semi-major axis that is an end.
        tip: f32 = 0.2,
        /// Share of an end's pixels that must not be saturated for it to be seen.
        ends: f64 = 0.9,
        /// How far the glare of a knot is known beforehand at least, over the skin's own light, standard deviation.
        glare_floor: f64 = 0.03,
        /// The same as a share of the greatest glare beside it.
        glare_share: f64 = 1.0,
    }
}
