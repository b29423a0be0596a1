//! Tuned numbers of the fit, with meaning, unit, origin.

use std::ops::Range;

use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::numbers::GrowingLength;

/// Limit above which a coarse fit cannot be that of a marker.
pub struct HopelessFit {
    /// Number of iterations before the check.
    pub after: usize,
    /// Largest residuals, as a fraction of the contrast.
    pub residuals: f64,
}

numbers! {
    /// Limits of the iteration: bounds on time, which change results only if a fit does not converge.
    ITERATION: IterationOptions {
        /// Maximum iterations of a coarse fit.
        max_coarse_steps: usize = 20,
        /// Maximum iterations of the final fit and of the fit with glare: if the blur differs between the directions,
        /// pixels at an end regain weight one by one.
        max_final_steps: usize = 30,
        /// First scale of the residuals of a coarse fit, a fraction of the contrast: most pixels are flat and contain no
        /// information on an edge that is still misplaced.
        first_scale: f64 = 0.15,
        /// Minimum ratio of the scale to the previous one in one iteration, for the same reason.
        min_scale_ratio: f64 = 0.4,
        /// Iterations of a coarse fit with damped normal equations.
        damped_steps: usize = 2,
        /// Damping in these iterations, a fraction of the diagonal (Levenberg-Marquardt).
        damping: f64 = 1e-3,
        /// Damping in all later iterations, a fraction of the diagonal: against rounding only.
        final_damping: f64 = 1e-10,
        /// Step of the centre below which it is lengthened to correct for the change of the weights, px.
        gain_px: f64 = 0.05,
        /// Maximum factor by which a step is lengthened.
        max_gain: f64 = 1.5,
        /// Step of centre and length below which a coarse fit has converged, px: pixels are selected by it.
        coarse_tolerance_px: f64 = 0.02,
        /// Relative change of the scale between iterations below which a coarse fit has converged.
        coarse_scale_change: f64 = 0.2,
        /// Relative change of the scale between iterations below which the final fit has converged.
        final_scale_change: f64 = 0.15,
        /// Fraction of the squared residuals removed by a step below which a coarse fit has converged, whatever its scale.
        min_reduction: f64 = 0.1,
        /// Step of the centre, in its standard deviations, below which the final fit has converged.
        final_tolerance: f64 = 0.1,
        /// Coarse fit of a disc: the worst of 116 rendered ones had 0.28; 40 % of the fits that failed had more than 0.35.
        hopeless: HopelessFit = HopelessFit { after: 2, residuals: 0.35 },
        /// Coarse fit of crossing edges: the worst of 123 had 0.15; 87 % of the fits that failed had more than that.
        hopeless_crossing: HopelessFit = HopelessFit { after: 1, residuals: 0.25 },
        /// Quadrants fitted by edges and outline, whose final residuals are 0.12 at most.
        hopeless_outlined: HopelessFit = HopelessFit { after: 2, residuals: 0.25 },
        /// Maximum iterations of the fit with a light field, which starts from the result of the final fit.
        max_field_steps: usize = 4,
        /// Damping of the fit with a light field in the first two iterations and afterwards, fractions of the diagonal.
        field_damping: [f64; 2] = [1e-3, 1e-7],
        /// Step of the centre below which the fit with a light field has converged, px.
        field_tolerance_px: f64 = 1e-3,
        /// Maximum step of the centre in the fit with a light field, px.
        max_field_step_px: f64 = 2.0,
        /// Ratio of the scale to the previous one above which the fits with a light field and with glare have converged; it
        /// is at most halved in one iteration.
        scale_ratio_converged: f64 = 0.9,
        /// First scale of the residuals relative to the previous fit, if foreign pixels distorted that fit.
        scale_with_foreign: f64 = 3.0,
        /// First scale of the residuals relative to the previous fit, if glare distorted that fit.
        scale_with_glare: f64 = 4.0,
        /// Maximum step of the centre in the fit with glare, px.
        max_glare_step_px: f64 = 1.5,
        /// Step of the centre, in its standard deviations, below which the fit with glare has converged.
        glare_tolerance: f64 = 0.03,
    }

    /// Robust weights and correlated residuals.
    WEIGHT: WeightOptions {
        /// Residuals beyond this multiple of the scale have no weight (Tukey's biweight). At 4.7 it is 95 % efficient; a
        /// larger value loses less of an edge that the model does not match exactly.
        cut_scales: f64 = 6.0,
        /// Minimum scale of the residuals, a fraction of the contrast: the accuracy of the image formula.
        floor: f64 = 0.02,
        /// Square root of the weight (0.5) above which a pixel is used to estimate the scale of the residuals.
        scale_root: f32 = 0.7,
        /// Irregularity of a real outline and of its sampling, px, for which a pixel is not down-weighted. Chosen;
        /// `tests/detect/fixtures.rs`.
        edge_jitter_px: f64 = 0.08,
        /// Side of the squares within which residuals may be correlated, px: the blocks of JPEG.
        square_px: f64 = 8.0,
        /// Semi-axis, in squares, above which squares are enlarged by whole multiples: more independent squares are not
        /// needed.
        squares: f64 = 11.0,
        /// Maximum correction, a ratio, for the part of each block that the fitted parameters absorb: with that few blocks
        /// a larger correction is not reliable.
        max_correction: f64 = 2.5,
        /// Ratio up to which the variance from blocks does not differ significantly from that of the fit: there are few
        /// blocks. Standard deviations with JPEG: `tests/detect/fixtures.rs`.
        max_random_ratio: f64 = 2.4,
    }

    /// Criteria for estimating a light field. Chosen on rendered sets; `tests/detect/bad_light.rs` and
    /// `tests/detect/fixtures.rs` check them.
    LACK_OF_FIT: LackOfFitOptions {
        /// Ratio of the centre's variance from blocks of residuals to that of the fit above which residuals are
        /// significantly correlated.
        correlated: f64 = 4.0,
        /// Ratio of the mean square of residuals by sectors to that of independent ones above which the light is uneven.
        uneven: f64 = 1.5,
        /// Fraction of pixels with zero weight above which they are treated as foreign.
        foreign: f64 = 0.01,
        /// Minimum reduction of the squared residuals by a light field for it to be used in part, in variances of one
        /// residual. Its 33 unknowns reduce them by 33 at random, and by several times that if JPEG correlates the
        /// residuals.
        uncertain_gain: f64 = 120.0,
        /// Reduction above which the light field is used fully: 8.5 for each unknown.
        certain_gain: f64 = 280.0,
    }

    /// Priors of the image of a marker.
    PRIOR: PriorOptions {
        /// Largest fraction of a disc's outline that may be hidden, if its slope is known only from a neighbour or not at all:
        /// the position of a narrow visible part would depend on it. Chosen on the rendered glare frames;
        /// `tests/detect/glare.rs`, `tests/detect/decals.rs`.
        max_hidden: f64 = 0.64,
        /// Prior standard deviation of the blur of one edge relative to another measured one, and of its darkness. Chosen:
        /// one lens blurs all; one print, in one light.
        edge_scatter: f64 = 0.1,
        /// Exponent of the tone curve with its standard deviation: that of images encoded for viewing (IEC 61966-2-1), and
        /// the scatter between cameras.
        gamma: PriorValue = PriorValue { value: 1.0 / 2.2, sigma: 0.15 },
        /// Prior standard deviation of a disc's sag, relative to its semi-major axis: a disc of 0.2 m diameter on a skin of
        /// 5 m radius. A complete outline determines it better.
        sag: f64 = 0.01,
        /// Prior standard deviation of the relative change of a disc's thickness along it. Chosen; `tests/detect/glare.rs`.
        taper: f64 = 0.05,
        /// Prior standard deviation of the relative difference between the blurs of the edges of quadrants and their mean:
        /// motion blurs them depending on direction. `tests/detect/motion.rs`.
        uneven_blur: f64 = 0.1,
        /// Semi-minor axis above which more parameters of the light and the bends of quadrants are determined, px. Chosen;
        /// `tests/detect/sweep.rs`.
        thick_px: f64 = 2.5,
        /// Semi-minor axis above which the change of darkness across a marker is determined, px. Chosen, as the next two.
        dark_px: f64 = 6.0,
        /// Semi-major axis above which the square term of the light along a marker is determined, px.
        light_px: f64 = 15.0,
        /// Semi-major axis above which bends are determined, px.
        bend_px: f64 = 12.0,
        /// Semi-minor axis of quadrants up to which one of their edges may be too short to determine its bend, px. Chosen;
        /// `tests/detect/sweep.rs`.
        narrow_px: f64 = 10.0,
    }

    /// Narrow quadrants fitted by edges and outline. Chosen on drawn and rendered quadrants; `tests/detect/sweep.rs` checks
    /// them.
    OUTLINED: OutlinedOptions {
        /// Minimum contrast of white against the skin, as a fraction of that of black: 0.21 and more in all 588 of the
        /// rendered sets, 0.06 and less if the marker was a disc.
        whiter: f64 = 0.12,
        /// Prior standard deviation of the offset between the centre of the outline and the crossing, px: perspective, and
        /// tolerance of cutting.
        aside_px: f64 = 1.0,
        /// Prior standard deviation of the bend of edges and outline at their ends, a fraction of the length: a target of
        /// 40 mm on a skin of 10 m radius, seen along it.
        bend: f64 = 0.002,
        /// Prior standard deviation of the difference of darkness between the centre and the outline: one print.
        dark: f64 = 0.005,
        /// Approximate number of pixels for outline and edges: more would only cost time.
        coarse_px: f64 = 400.0,
        /// Approximate number of pixels for the final fit: more than most such targets have.
        final_px: f64 = 6000.0,
        /// Distance up to which pixels outside the outline are used, by blur: it must include flat skin.
        beyond: GrowingLength = GrowingLength { factor: 2.5, px: 2.0 },
        /// Step between the pixels used outside the outline, which only determine the skin's grey level, relative to those
        /// inside.
        outside_step: usize = 3,
        /// Maximum step between the pixels used inside the outline.
        max_step: f64 = 1024.0,
        /// Fraction of a period by which the used pixels of a row are shifted from those of the previous row: the golden
        /// ratio, which repeats least.
        row_shift: f64 = 0.618,
        /// Minimum scale of the residuals for the weights, as a fraction of the contrast: an end that the first outline has
        /// missed is not an outlier.
        min_scale: f64 = 0.1,
        /// Maximum scale of the residuals at the end, as a fraction of the contrast.
        max_scale: f64 = 0.12,
        /// Minimum semi-major axis of such quadrants, px.
        min_major_px: f64 = 10.0,
        /// Minimum contrast, grey levels.
        min_contrast: f64 = 6.0,
        /// Factor by which the region of the pixels, and a reduced image, are larger than the outline.
        larger: f64 = 1.2,
        /// Maximum number of selections of pixels: a bound on time.
        max_rounds: usize = 5,
    }

    /// Overshoot of sharpened images.
    OVERSHOT: OvershotOptions {
        /// Ratio of a marker's residuals to the noise above which sharpening is tested: noise alone leaves less.
        over_noise: f64 = 1.2,
        /// Range of the ratio of a marker's residuals to its contrast in which sharpening is tested: from the accuracy of
        /// the image formula to the residuals next to an edge with an overshoot of twice that edge.
        residual_range: Range<f64> = 0.02..0.2,
        /// Minimum amplitude with an effect. Derived: 2 % of the contrast at an edge, the accuracy of the image formula,
        /// divided by 0.13, the difference between an edge and its copy.
        min_amplitude: f64 = 0.15,
        /// Amplitude at which the fit starts, without prior information.
        first_amplitude: f64 = 0.5,
        /// Halos that are tried, px: cameras compare an image with copies blurred by 0.7 to 2 px, and the residuals of
        /// discs in rendered phone frames change by 2 % between 1 and 2.
        halos_px: [f64; 3] = [1.0, 1.4, 2.0],
        /// Minimum blur at which the fit starts, px: sharpening makes an edge look sharper than it is.
        min_first_blur_px: f64 = 0.8,
        /// Minimum reduction of a marker's squared residuals, in variances of one residual: five standard deviations of one
        /// unknown.
        min_gain: f64 = 25.0,
        /// Distance below which two pieces of evidence belong to one object, px.
        apart_px: f64 = 5.0,
        /// Minimum fraction of the examined markers that must show it.
        min_share: f64 = 0.6,
        /// Number of markers after which no more are examined.
        enough_markers: usize = 10,
        /// Maximum number of possible markers that are examined, the largest first: a bound on time.
        max_examined: usize = 30,
        /// Minimum relative scatter of the amplitude between markers: noise reduction and tone mapping depend on the
        /// position.
        min_scatter: f64 = 0.1,
    }

    /// Optional terms of the image formula.
    TERM: TermOptions {
        /// Prior standard deviation of a knot of the light field, the relative deviation of light and darkness from a
        /// plane: the edge of a shadow. `tests/detect/bad_light.rs`.
        field: f64 = 0.15,
        /// Spacing of the knots of the glare spline, px: glare on a wing changes over tens of pixels. Chosen on 414 discs
        /// of 35 rendered glare frames, as all values for glare; `tests/detect/glare.rs` checks it.
        knot_px: f64 = 10.0,
        /// Grey value above which a pixel is saturated, or JPEG has mixed it with saturated ones.
        saturated: f32 = 250.0,
        /// Initial ratio of the assumed light of a saturated pixel to its grey value.
        saturated_factor: f64 = 1.2,
        /// Extent of the knots along the disc, by its semi-major axis, without what the largest slant adds for its
        /// semi-minor axis. Chosen: as far as its pixels reach.
        reach: GrowingLength = GrowingLength { factor: 1.2, px: 20.0 },
        /// Distance from foreign pixels within which pixels are excluded from a light field, by blur: as far as foreign
        /// objects darken.
        foreign: GrowingLength = GrowingLength { factor: 2.5, px: 1.0 },
        /// Number of slants that are tried to each side.
        slants: i32 = 20,
        /// Step between the tried slants, px along for each px across.
        slant_step: f64 = 0.1,
        /// Length along the disc within which glare is assumed constant in the search for the slant, px.
        bin_px: f64 = 3.0,
        /// Fraction of the semi-major axis that counts as an end.
        tip: f32 = 0.2,
        /// Fraction of an end's pixels that must be unsaturated for it to be visible.
        ends: f64 = 0.9,
        /// Minimum prior standard deviation of the glare of a knot, relative to the skin's own light; the
        /// largest glare next to it is added.
        glare_floor: f64 = 0.03,
    }
}
