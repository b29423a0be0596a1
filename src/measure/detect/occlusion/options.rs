//! Tuned numbers of what hides a part of a marker: meaning, unit, origin.

/// Decals that may lie over a marker.
pub struct DecalOptions {
    /// How far a decal reaches beyond its print, before and behind it, px. The decals of the rendered sets, seen
    /// from the cabin; `tests/detect/decals.rs`.
    pub margin_px: f64,
    /// Points of a blob's contour of which a line is made, about. A bound on time: all pairs of them are tried.
    pub line_points: usize,
    /// Points that must lie on the line in which a decal cuts a blob. Chosen; the slanted decals of
    /// `tests/detect/decals.rs`.
    pub line_support: usize,
    /// Least distance of the two points that a line is drawn through, px. Derived: contours are told to half a
    /// pixel, so that the direction is told to 0.06 rad before all points refine it.
    pub line_reach_px: f64,
    /// How far a point may lie from the line, px. Derived: contour points lie half a pixel beside the pixels, and a
    /// tenth is added for rounding.
    pub line_off_px: f64,
    /// Directions for which rows or columns stand, rad. Derived: 0.4 px over a disc of 40 px, less than a contour
    /// tells.
    pub level_rad: f64,
}

/// The numbers in use.
pub const DECAL: DecalOptions = DecalOptions {
    margin_px: 7.0,
    line_points: 40,
    line_support: 12,
    line_reach_px: 12.0,
    line_off_px: 0.6,
    level_rad: 0.01,
};

/// Glare over a marker, told by the skin beside it.
pub struct GlareOptions {
    /// Grey value from which on skin is saturated. Derived: 255 less what JPEG leaves about edges.
    pub white: u8,
    /// Where beyond a disc's tip that is looked at, px: beyond the greatest blur. Chosen; `tests/detect/glare.rs`.
    pub past_px: [f64; 3],
    /// Skin over the usual skin at which glare is believed, a ratio. Chosen on the rendered glare frames;
    /// `tests/detect/glare.rs`.
    pub lighter: f64,
    /// The same where it begins. What lights the skin by a tenth doubles the light of black, which is a tenth of an
    /// edge's width.
    pub begins: f64,
    /// The same at its brightest over a predicted marker, along which light changes by itself. Chosen on the glare
    /// frames of 112 rendered sets; `tests/detect/closer.rs`.
    pub bright: f64,
    /// Where the skin beside a marker is looked at, px from its outline: beyond the greatest blur. Chosen;
    /// `tests/detect/glare.rs`.
    pub beside_px: [f64; 4],
    /// How far beyond the marker's ends it is, px. Chosen; `tests/detect/glare.rs`.
    pub beyond_px: i32,
    /// What glare blurs into what it leaves, px: a usual blur and a half. Chosen; `tests/detect/glare.rs`.
    pub margin_px: f64,
    /// Most that a band may shift along the marker for each pixel across. Chosen: farther, what is seen on both
    /// sides is not one band; the test of this file.
    pub slant: f64,
}

/// The numbers in use.
pub const GLARE: GlareOptions = GlareOptions {
    white: 250,
    past_px: [3.0, 4.5, 6.0],
    lighter: 1.15,
    begins: 1.10,
    bright: 1.3,
    beside_px: [4.0, 5.0, 6.0, 7.0],
    beyond_px: 20,
    margin_px: 2.0,
    slant: 1.5,
};

/// Seams of the skin that meet a disc. All were chosen on drawn seams and rendered sets, where the normalised error
/// fell from 3.5 at most to 0.8 to 1.2 (`docs/decisions/0014`), unless they say otherwise;
/// `tests/detect/robustness.rs` holds them.
pub struct SeamOptions {
    /// Where the ring beside a disc begins that is searched, blurs from its outline. Derived: beyond, the edge's
    /// blur leaves 0.1 % of the contrast.
    pub clear_blurs: f64,
    /// Where it ends, px from the outline.
    pub reach_px: f64,
    /// Residual scales by which a pixel is darker than the skin to be a sign of a seam. Derived: by chance one in
    /// 160 is.
    pub sign_scales: f32,
    /// Residual scales by which all of a seam is darker.
    pub darker_scales: f64,
    /// Signs that must lie on one line.
    pub least_signs: usize,
    /// The darkest of them, of which the first line is made: a bound on time, all pairs of them are tried.
    pub most_signs: usize,
    /// Distance from which on two signs tell a line, px.
    pub apart_px: f64,
    /// Half the width in which a seam's signs lie, px.
    pub half_width_px: f64,
    /// From where to where the skin beside a seam is looked at, px: beyond its blur and its profile.
    pub beside_px: (f64, f64),
    /// Width of a bin of its profile, px.
    pub bin_px: f64,
    /// Bins: the profile ends where the skin beside begins.
    pub bins: usize,
    /// How near to a line is on it, px.
    pub on_px: f32,
    /// Residual scales from which on what is unlike the skin is something else.
    pub foreign_scales: f32,
    /// What a seam's blur still darkens beyond where it seems to end, px.
    pub skirt_px: f64,
    /// Standard deviations of a seam's darkness. The line is the best of some 500, and chance lines up signs.
    pub certain: f64,
    /// Length of the pieces of which a seam's most are dark, px.
    pub piece_px: f64,
    /// Share of them: letters and dirt are no lines.
    pub unbroken: f64,
    /// Pieces that must be seen.
    pub pieces: usize,
    /// Share of darkness and of its standard deviations from which on a line is looked at more closely: the first
    /// look is in single precision.
    pub hint: f64,
    /// Share of the outline that a seam may hide: more could not be missed.
    pub hides: f64,
    /// Most seams at a disc: one at each tip.
    pub most: usize,
    /// Most lines that are tried: a bound on time.
    pub tries: usize,
}

/// The numbers in use.
pub const SEAM: SeamOptions = SeamOptions {
    clear_blurs: 3.0,
    reach_px: 14.0,
    sign_scales: 2.5,
    darker_scales: 1.5,
    least_signs: 8,
    most_signs: 32,
    apart_px: 6.0,
    half_width_px: 1.2,
    beside_px: (4.5, 7.5),
    bin_px: 0.5,
    bins: 9,
    on_px: 1.0,
    foreign_scales: 4.0,
    skirt_px: 1.0,
    certain: 8.0,
    piece_px: 4.0,
    unbroken: 0.75,
    pieces: 4,
    hint: 0.9,
    hides: 0.35,
    most: 2,
    tries: 3,
};

/// Dark paint at a disc's end. Derived, unless said otherwise; `tests/detect/robustness.rs` holds it.
pub struct PaintOptions {
    /// Radius of curvature of an end up to which it is thin, blurs: blur then takes more of it than is left.
    pub thin_blurs: f64,
    /// Share of the contrast by which paint is darker than the skin. Chosen on two rendered sets: with a quarter of it panel
    /// lines count too, which shift a disc by less (0.1 px) than it costs to leave out an end (0.2 px).
    pub dark: f64,
    /// The same in residual scales: by chance one pixel in 16 000.
    pub certain: f64,
    /// Where beside an end it begins to be sought, blurs from the outline: the disc's own edge leaves 16 % there.
    pub clear_blurs: f64,
    /// Where that ends: what paint a blur farther off than its own edge darkens at the outline is less than 2 %.
    pub reach_blurs: f64,
    /// Where an end begins, as a share of the semi-major axis: there it is 0.6 times as thick as the middle.
    pub end: f64,
    /// Pixels that tell it.
    pub least_px: usize,
    /// What paint's edge still darkens, blurs: 1.4 % of it.
    pub skirt_blurs: f64,
}

/// The numbers in use.
pub const PAINT: PaintOptions = PaintOptions {
    thin_blurs: 1.0,
    dark: 0.5,
    certain: 4.0,
    clear_blurs: 1.0,
    reach_blurs: 3.0,
    end: 0.8,
    least_px: 3,
    skirt_blurs: 2.2,
};
