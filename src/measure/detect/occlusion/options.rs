//! Tuned numbers of what hides a part of a marker: meaning, unit, origin.

numbers! {
    /// Decals that may lie over a marker.
    DECAL: DecalOptions {
        /// How far a decal reaches beyond its print, before and behind it, px. The decals of the rendered sets, seen
        /// from the cabin; `tests/detect/decals.rs`.
        margin_px: f64 = 7.0,
        /// Points of a blob's contour of which a line is made, about. A bound on time: all pairs of them are tried.
        line_points: usize = 40,
        /// Points that must lie on the line in which a decal cuts a blob. Chosen; the slanted decals of
        /// `tests/detect/decals.rs`.
        line_support: usize = 12,
        /// Least distance of the two points that a line is drawn through, px. Derived: contours are told to half a
        /// pixel, so that the direction is told to 0.06 rad before all points refine it.
        line_reach_px: f64 = 12.0,
        /// How far a point may lie from the line, px. Derived: contour points lie half a pixel beside the pixels, and a
        /// tenth is added for rounding.
        line_off_px: f64 = 0.6,
        /// Directions for which rows or columns stand, rad. Derived: 0.4 px over a disc of 40 px, less than a contour
        /// tells.
        level_rad: f64 = 0.01,
    }

    /// Glare over a marker, told by the skin beside it.
    GLARE: GlareOptions {
        /// Grey value from which on skin is saturated. Derived: 255 less what JPEG leaves about edges.
        white: u8 = 250,
        /// Where beyond a disc's tip that is looked at, px: beyond the greatest blur. Chosen; `tests/detect/glare.rs`.
        beyond_tip_px: [f64; 3] = [3.0, 4.5, 6.0],
        /// Skin over the usual skin at which glare is believed, a ratio. Chosen on the rendered glare frames;
        /// `tests/detect/glare.rs`.
        min_ratio: f64 = 1.15,
        /// The same where it begins. What lights the skin by a tenth doubles the light of black, which is a tenth of an
        /// edge's width.
        begin_ratio: f64 = 1.10,
        /// The same at its brightest over a predicted marker, along which light changes by itself. Chosen on the glare
        /// frames of 112 rendered sets; `tests/detect/closer.rs`.
        bright_ratio: f64 = 1.3,
        /// Where the skin beside a marker is looked at, px from its outline: beyond the greatest blur. Chosen;
        /// `tests/detect/glare.rs`.
        beside_px: [f64; 4] = [4.0, 5.0, 6.0, 7.0],
        /// How far beyond the marker's ends it is, px. Chosen; `tests/detect/glare.rs`.
        beyond_px: i32 = 20,
        /// What glare blurs into what it leaves, px: a usual blur and a half. Chosen; `tests/detect/glare.rs`.
        margin_px: f64 = 2.0,
        /// Most that a band may shift along the marker for each pixel across. Chosen: farther, what is seen on both
        /// sides is not one band; the test of this file.
        slant: f64 = 1.5,
    }

    /// Seams of the skin that meet a disc. All were chosen on drawn seams and rendered sets, where the normalised error
    /// fell from 3.5 at most to 0.8 to 1.2 (`docs/decisions/0014`), unless they say otherwise;
    /// `tests/detect/robustness.rs` holds them.
    SEAM: SeamOptions {
        /// Where the ring beside a disc begins that is searched, blurs from its outline. Derived: beyond, the edge's
        /// blur leaves 0.1 % of the contrast.
        clear_blurs: f64 = 3.0,
        /// Where it ends, px from the outline.
        reach_px: f64 = 14.0,
        /// Residual scales by which a pixel is darker than the skin to be a sign of a seam. Derived: by chance one in
        /// 160 is.
        sign_scales: f32 = 2.5,
        /// Residual scales by which all of a seam is darker.
        darker_scales: f64 = 1.5,
        /// Signs that must lie on one line.
        min_signs: usize = 8,
        /// The darkest of them, of which the first line is made: a bound on time, all pairs of them are tried.
        max_signs: usize = 32,
        /// Distance from which on two signs tell a line, px.
        apart_px: f64 = 6.0,
        /// Least scale of residuals, grey levels.
        min_scale: f64 = 0.1,
        /// Least variance of the skin beside a seam, in squares of those scales.
        min_variance: f64 = 0.25,
        /// Share of the peak darkness from which on a piece is dark.
        dark_piece: f64 = 0.4,
        /// Share of it below which its profile has ended.
        ended: f64 = 0.12,
        /// Least half width of a seam, px: a pixel's.
        min_half_width_px: f64 = 1.0,
        /// Half the width in which a seam's signs lie, px.
        half_width_px: f64 = 1.2,
        /// From where to where the skin beside a seam is looked at, px: beyond its blur and its profile.
        beside_px: (f64, f64) = (4.5, 7.5),
        /// Width of a bin of its profile, px.
        bin_px: f64 = 0.5,
        /// Bins: the profile ends where the skin beside begins.
        bins: usize = 9,
        /// How near to a line is on it, px.
        on_px: f32 = 1.0,
        /// Residual scales from which on what is unlike the skin is something else.
        foreign_scales: f32 = 4.0,
        /// What a seam's blur still darkens beyond where it seems to end, px.
        skirt_px: f64 = 1.0,
        /// Standard deviations of a seam's darkness. The line is the best of some 500, and chance lines up signs.
        significance: f64 = 8.0,
        /// Length of the pieces of which a seam's most are dark, px.
        piece_px: f64 = 4.0,
        /// Share of them: letters and dirt are no lines.
        unbroken: f64 = 0.75,
        /// Pieces that must be seen.
        pieces: usize = 4,
        /// Share of darkness and of its standard deviations from which on a line is looked at more closely: the first
        /// look is in single precision.
        hint: f64 = 0.9,
        /// Share of the outline that a seam may hide: more could not be missed.
        max_hidden: f64 = 0.35,
        /// Most seams at a disc: one at each tip.
        max_seams: usize = 2,
        /// Most lines that are tried: a bound on time.
        max_tries: usize = 3,
    }

    /// Dark paint at a disc's end. Derived, unless said otherwise; `tests/detect/robustness.rs` holds it.
    PAINT: PaintOptions {
        /// Radius of curvature of an end up to which it is thin, blurs: blur then takes more of it than is left.
        thin_blurs: f64 = 1.0,
        /// Share of the contrast by which paint is darker than the skin. Chosen on two rendered sets: with a quarter of it panel
        /// lines count too, which shift a disc by less (0.1 px) than it costs to leave out an end (0.2 px).
        dark: f64 = 0.5,
        /// The same in residual scales: by chance one pixel in 16 000.
        significance: f64 = 4.0,
        /// Where beside an end it begins to be sought, blurs from the outline: the disc's own edge leaves 16 % there.
        clear_blurs: f64 = 1.0,
        /// Where that ends: what paint a blur farther off than its own edge darkens at the outline is less than 2 %.
        reach_blurs: f64 = 3.0,
        /// Where an end begins, as a share of the semi-major axis: there it is 0.6 times as thick as the middle.
        end: f64 = 0.8,
        /// Pixels that tell it.
        min_pixels: usize = 3,
        /// What paint's edge still darkens, blurs: 1.4 % of it.
        skirt_blurs: f64 = 2.2,
    }
}
