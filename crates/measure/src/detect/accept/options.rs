//! Tuned numbers of the acceptance: meaning, unit, origin.

use std::ops::Range;

use crate::detect::numbers::GrowingLength;

/// Limit on the direction of flat detections.
pub struct DirectionLimit {
    /// Axis ratio from which on the direction is checked.
    pub min_flatness: f64,
    /// Largest deviation from that of the markers, rad.
    pub max_rad: f64,
}

numbers! {
    /// Conditions for a fit to be accepted as a marker.
    VERDICT: VerdictOptions {
        /// Fraction of a disc's sag that is added along its axis as a standard deviation. It is unknown how a decal lies on
        /// a curved skin; stretched or not differs by the sag times the skin's slope, for which 1/14 is assumed.
        decal_stretch: f64 = 0.07,
        /// Shift of an edge due to the fringe of glare, px: up to 10 % of the skin's light, before it is visible. Derived:
        /// 10 % of an edge's width.
        fringe_px: f64 = 0.1,
        /// Shift of an edge if most of the fringe is excluded or measured, px. Normalised errors of 1626 discs in glare
        /// 0.99 and 0.96 (`docs/decisions/0006`).
        residual_fringe_px: f64 = 0.06,
        /// Semi-minor axis below which glare shifts a disc less across, px: both edges lie in about the same light. Chosen
        /// together with `residual_fringe_px`.
        uniform_light_px: f64 = 20.0,
        /// Largest standard deviation of a centre, px. Chosen: beyond, it does not constrain the wing's shape.
        max_sigma_px: f64 = 2.0,
        /// Largest standard deviation of a disc's centre if its length is predicted, so that only the position along it is
        /// uncertain, px.
        max_sigma_predicted_px: f64 = 2.5,
        /// Largest standard deviation of quadrants' centre if their outline is predicted, px: edges that only point at
        /// their crossing are less accurate than their residuals indicate (1.3 px error with a standard deviation of 0.4
        /// px; `tests/detect/second_pass.rs`).
        max_sigma_crossing_px: f64 = 0.5,
        /// Largest axis ratio of a disc. Seen from 1 m above the skin, discs are 1:28 on a wing that bends downwards, and
        /// seams are far flatter.
        max_axis_ratio: f64 = 40.0,
        /// Largest axis ratio of quadrants, which are nearer: flatter ones are two discs side by side.
        max_axis_ratio_quadrants: f64 = 26.0,
        /// Smallest darkness: 3 % of the grey of white or skin. Dirt and panel lines are as pale.
        min_darkness: f64 = 0.06,
        /// Smallest contrast, grey levels: steps of JPEG are as high.
        min_contrast: f64 = 5.0,
        /// Largest blur that is measured, px. Chosen: a camera is not used farther out of focus.
        max_blur_px: f64 = 3.2,
        /// Largest root mean square of a marker's residuals: a multiple of the noise, plus a fraction of its contrast.
        /// Chosen: `tests/detect/bad_light.rs`.
        max_rms_over_noise: f64 = 1.6,
        max_rms_over_contrast: f64 = 0.05,
        /// Smallest mean weight of a marker's pixels: below, half of them show something else.
        min_inliers: f64 = 0.55,
        /// Largest distance of a fit from its start, by its semi-major axis.
        max_shift: GrowingLength = GrowingLength { factor: 0.25, px: 2.0 },
        /// Smallest semi-axes, px: fewer pixels do not determine an outline.
        min_axes_px: [f64; 2] = [3.5, 0.8],
        /// Largest standard deviation of any centre, as a fraction of the semi-major axis.
        max_relative_sigma: f64 = 0.05,
        /// Largest standard deviation of the centre of a marker seen whole, as a fraction of the semi-major axis. A
        /// complete outline determines more than a part does.
        max_relative_sigma_whole: f64 = 0.02,
        /// Smallest such limit, px. Both are doubled for a disc whose length is predicted.
        min_sigma_limit_px: f64 = 0.6,
        /// Noise that may remain at edges if JPEG has removed it next to them, grey levels. Chosen;
        /// `tests/detect/bad_light.rs`.
        edge_noise: f64 = 1.0,
    }

    /// Distinction of quadrant targets from squares of a checkerboard.
    PATTERN: PatternOptions {
        /// Largest ratio of the extents of black along the middle of a quadrant and along both sides of it. Half way
        /// between 1 of a circle and 1.37 of a square; `tests/detect/background.rs`.
        min_corner_ratio: f64 = 1.18,
        /// Range of the distance beyond the outline at which skin begins, two blurs, radii.
        skin_start: Range<f64> = 0.1..0.2,
        /// Three positions from there, radii, all short of the corner at 1.25 radii of a square of the same size. The
        /// majority decides, because the outline is rough and a line may cross it.
        skin_radii: [f64; 3] = [0.0, 0.04, 0.08],
        /// Position at which black is sampled, radii: blur brightens a thin tip.
        black_radius: f64 = 0.75,
        /// Fraction of the way from black to white by which skin must be lighter than black: it may be darker than half
        /// way.
        min_lighter: f64 = 0.2,
        /// Fraction of the contrast below white at which black ends.
        end_contrast: f64 = 0.6,
        /// Range and step of the search for that end, radii.
        end_range: Range<f64> = 0.5..1.7,
        end_step: f64 = 0.02,
        /// Smallest semi-minor axis for which a corner can be recognised, blurs. Chosen; `tests/detect/background.rs`.
        min_corner_blurs: f64 = 8.0,
        /// Position of a quadrant's sides between its middle (0) and its edges (1). Chosen: a square's corner is far away,
        /// the blur of the edges not yet near.
        side_position: f64 = 0.65,
    }

    /// Limits for the consistency of a frame's markers.
    CONSISTENCY: ConsistencyOptions {
        /// Largest normalised radius (0 centre, 1 outline) of a centre in another outline for the two to be one marker,
        /// segmented at two thresholds.
        same_radius: f64 = 0.5,
        /// Largest such radius between a disc and quadrants.
        same_radius_other_shape: f64 = 0.8,
        /// Largest blur over the median one, a ratio: one lens produces all edges. Chosen on the rendered sets; tested in
        /// `consistency.rs`.
        max_blur_ratio: f64 = 2.0,
        /// Semi-minor axis of quadrants, blurs, from which on their own edges show that they are out of focus and no
        /// shadow. Derived: a marker of 0.1 m at 3 m has 50 and more, a shadow's edge on a marker on the wing fewer than 8.
        /// Tested in `consistency.rs`.
        crisp_blurs: f64 = 12.0,
        /// Axis ratio from which on a direction is determined.
        min_flatness: f64 = 2.0,
        /// Direction of discs: of 20,300 markers in 116 rendered sets none deviates by more than 0.3 rad.
        disc_across: DirectionLimit = DirectionLimit { min_flatness: 8.0, max_rad: 0.6 },
        /// Direction of quadrants, which deviate by up to 0.41 rad near the camera.
        quadrants_across: DirectionLimit = DirectionLimit { min_flatness: 2.5, max_rad: 0.8 },
        /// Size of the next larger marker over that of a detection that is too small to be a marker, a ratio: it would have
        /// to be that many times farther away than all others. Chosen on the rendered sets; `tests/detect/near.rs`.
        max_size_ratio: f64 = 2.5,
        /// Ratio by which neighbours must be longer to predict a size: other dots do not.
        min_longer: f64 = 1.3,
    }

    /// Correlation of residuals that all of a frame's markers have in common.
    CORRELATED: CorrelatedOptions {
        /// Level of the median ratio of a frame's markers that noise alone can reach. Derived: 2 standard deviations with
        /// 20 markers.
        chance_level: f64 = 1.25,
        /// Smallest number of markers. Derived: the median of 8 scatters by 0.4 of the scatter of one.
        min_markers: usize = 8,
    }

    /// Contamination along a disc. Chosen on 2244 discs of 24 rendered sets, whose normalised error across fell from 1.21
    /// to 1.06; `tests/detect/dirt.rs`.
    DIRT: DirtOptions {
        /// Number of pixels sampled outwards from the outline; the nearer half is compared between the sides.
        reach_px: usize = 6,
        /// Step of the samples along the disc, px.
        step_px: f64 = 2.0,
        /// Smallest number of samples to each side of the middle.
        steps: f64 = 5.0,
        /// Sampled part of the disc's length, a fraction: the tips face along it.
        length: f64 = 0.85,
        /// Smallest number of pixels that must be visible on a side.
        min_px: f64 = 20.0,
        /// Shift of an edge, blurs, by contamination next to it that is darker than the skin by one contrast. Near the
        /// slope of a blurred edge, sqrt(2 pi) = 2.5.
        shift_blurs: f64 = 2.25,
        /// Factor of the scatter of the mean of correlated residuals over that of independent ones.
        correlation: f64 = 2.0,
        /// Iterations of the robust fit of the skin's light: it hardly changes after two.
        rounds: usize = 3,
        /// Residual scales from which on a pixel has no weight: Tukey's biweight, 95 % efficient.
        cut_scales: f64 = 4.7,
        /// Smallest scale of residuals, grey levels. Derived: rounding of grey values, 1/sqrt(12).
        floor: f64 = 0.3,
    }

    /// Contrast that quadrants have lost compared with the frame's others.
    LOST: LostContrastOptions {
        /// Fraction that is not significant. Derived: in the clear frames of five rendered sets, the darkness of quadrants
        /// is up to 0.09 below the upper quartile of their frame.
        chance_fraction: f64 = 0.1,
    }

    /// Residuals beyond the limit that noise explains (`VERDICT.max_rms_over_noise`).
    MISFIT: MisfitOptions {
        /// Shift of a marker for residuals as large as its contrast, as a fraction of an edge's width. Chosen: about half
        /// of the residuals are a bias of the edge, the rest only changes its form. Errors of 1500 markers of eight
        /// rendered sets are then 0.8 to 1.2 standard deviations (`docs/validation/data/cabin-sets.csv`).
        edge_fraction: f64 = 0.5,
    }
}
