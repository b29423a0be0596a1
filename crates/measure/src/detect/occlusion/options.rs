//! Tuned numbers of occlusions, with meaning, unit, origin.

use std::ops::Range;

numbers! {
    /// Decals that may lie over a marker.
    DECAL: DecalOptions {
        /// Extent of a decal beyond its print, above and below it, px. From the decals of the rendered sets, seen from the
        /// cabin; `tests/detect/decals.rs`.
        margin_px: f64 = 7.0,
        /// Approximate number of contour points of a blob from which a line is made. A bound on time: all pairs are tried.
        line_points: usize = 40,
        /// Minimum number of points on the line along which a decal cuts a blob. Chosen; the slanted decals of
        /// `tests/detect/decals.rs`.
        line_support: usize = 12,
        /// Minimum distance between the two points that define a line, px. Derived: a contour is accurate to 0.5 px, so the
        /// direction is accurate to 0.06 rad before all points refine it.
        line_reach_px: f64 = 12.0,
        /// Maximum distance of a point from the line, px. Derived: contour points lie 0.5 px from the pixels, with 0.1 px
        /// for rounding.
        line_off_px: f64 = 0.6,
        /// Angle below which a direction is treated as that of rows or columns, rad. Derived: 0.4 px over a disc of 40 px,
        /// less than the accuracy of a contour.
        level_rad: f64 = 0.01,
    }

    /// Glare over a marker, from the skin next to it.
    GLARE: GlareOptions {
        /// Minimum ratio of lit skin to the median of the skin for glare. Chosen on the rendered glare frames;
        /// `tests/detect/glare.rs`.
        min_ratio: f64 = 1.15,
        /// Ratio of lit skin to the median of the skin at which glare begins. 10 % more light on the skin doubles the light
        /// of black, which shifts an edge by 10 % of its width.
        begin_ratio: f64 = 1.10,
        /// Minimum ratio of lit skin to other skin at the brightest part of glare over a predicted marker, along which
        /// light changes by itself; such glare leaves too little of an edge. Chosen on the glare frames of 112 rendered
        /// sets; `tests/detect/second_pass.rs`.
        bright_ratio: f64 = 1.3,
        /// Distances from the outline of a marker at which the skin is sampled, px: beyond the largest blur. Chosen;
        /// `tests/detect/glare.rs`.
        beside_px: [f64; 4] = [4.0, 5.0, 6.0, 7.0],
        /// Distance beyond the ends of the marker up to which the skin is sampled, px. Chosen; `tests/detect/glare.rs`.
        beyond_px: i32 = 20,
        /// Margin by which glare is blurred into its surroundings, px: 1.5 times a typical blur. Chosen;
        /// `tests/detect/glare.rs`.
        margin_px: f64 = 2.0,
        /// Maximum shift of a band along the marker for each pixel across. Chosen: with a larger shift the two sides do not
        /// show one band; the test in `occlusion/glare.rs`.
        slant: f64 = 1.5,
    }

    /// Seams of the skin that meet a disc. Unless noted otherwise, values were chosen on drawn seams and rendered sets,
    /// where the largest normalised error fell from 3.5 to between 0.8 and 1.2 (`docs/decisions/0006`);
    /// `tests/detect/robustness.rs` checks them.
    SEAM: SeamOptions {
        /// Outer limit of the ring, px from the outline.
        reach_px: f64 = 14.0,
        /// Minimum darkness of a pixel relative to the skin to be a candidate for a seam, residual scales. Derived: 1 of
        /// 160 exceeds it at random.
        sign_scales: f32 = 2.5,
        /// Minimum mean darkness of a seam, residual scales.
        darker_scales: f64 = 1.5,
        /// Minimum number of candidates on one line.
        min_signs: usize = 8,
        /// Number of the darkest candidates from which the first line is made: a bound on time, all pairs are tried.
        max_signs: usize = 32,
        /// Minimum distance between two candidates that define a line, px.
        apart_px: f64 = 6.0,
        /// Minimum variance of the skin next to a seam, in squares of the residual scale.
        min_variance: f64 = 0.25,
        /// Fraction of the peak darkness above which a piece is dark.
        dark_piece: f64 = 0.4,
        /// Fraction of the peak darkness below which the profile has ended.
        ended: f64 = 0.12,
        /// Half width of the strip that contains the candidates of a seam, px.
        half_width_px: f64 = 1.2,
        /// Range of distances from a seam at which the skin next to it is sampled, px: beyond its blur and its profile.
        beside_px: Range<f64> = 4.5..7.5,
        /// Width of a bin of the profile, px.
        bin_px: f64 = 0.5,
        /// Number of bins of the profile, which ends before the sampled skin begins.
        bins: usize = 9,
        /// Minimum darkness of a seam, in its standard deviations. The line is the best of about 500, and some candidates
        /// are aligned at random.
        significance: f64 = 8.0,
        /// Length of the pieces into which a seam is divided, px.
        piece_px: f64 = 4.0,
        /// Minimum fraction of dark pieces: letters and dirt do not form lines.
        unbroken: f64 = 0.75,
        /// Minimum number of visible pieces.
        pieces: usize = 4,
        /// Maximum fraction of the outline that a seam may hide: a larger part would be seen otherwise.
        max_hidden: f64 = 0.35,
        /// Maximum number of seams at a disc: one at each tip. One line more is tried.
        max_seams: usize = 2,
    }

    /// Dark paint at the end of a disc. Derived unless noted otherwise; `tests/detect/robustness.rs` checks it.
    PAINT: PaintOptions {
        /// Position at which an end begins, as a fraction of the semi-major axis: the disc is 0.6 times as thick there as
        /// in the middle.
        end: f64 = 0.8,
        /// Minimum number of dark pixels.
        min_pixels: usize = 3,
    }
}
