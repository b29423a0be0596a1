//! Tuned numbers of proposals: meaning, unit, origin.

/// Quadrants of whose black blur leaves too little. Chosen on drawn and rendered quadrants; `tests/detect/sweep.rs`
/// holds them, unless they are bounds on time.
pub struct BlurredOptions {
    /// Greatest semi-minor axis of which blur may take so much, over the greatest blur.
    pub most_blurs: f64,
    /// Least axis ratio of what is seen.
    pub flat: f64,
    /// How much larger than what is seen they may be, a ratio.
    pub hidden: f64,
    /// Skin about them that tells its grey, px.
    pub skin_px: f64,
    /// How far along a marker its white is looked for at least, px: black may be seen of its middle only.
    pub half_px: f64,
    /// Greatest semi-minor axis of a blob of which blur may have left what is no quadrant, px.
    pub thickest_px: f64,
    /// Its least area, px.
    pub least_px: f64,
    /// How far about it white is looked for, px.
    pub beside_px: f64,
    /// Greatest semi-major axis of what is looked at, px: sixteen times the thickest.
    pub longest_px: f64,
    /// How many are tried at most, so that clutter cannot take for ever.
    pub seeds: usize,
    /// How far apart two black parts in a row may be, in their semi-major axes: of a target of 78 x 7 px a blur of
    /// 2 px leaves two lobes 100 px from each other.
    pub apart: f64,
    /// How far out of the row each may point, rad.
    pub in_row_rad: f64,
    /// Their blur beforehand, px, with its standard deviation.
    pub blur_px: (f64, f64),
    /// Least share of a hull that is seen.
    pub seen: f64,
    /// Least share of its ellipse that it fills: a parallelogram 0.95.
    pub full: f64,
}

/// The numbers in use.
pub const BLURRED: BlurredOptions = BlurredOptions {
    most_blurs: 3.2,
    flat: 3.0,
    hidden: 2.5,
    skin_px: 8.0,
    half_px: 60.0,
    thickest_px: 10.0,
    least_px: 30.0,
    beside_px: 12.0,
    longest_px: 160.0,
    seeds: 120,
    apart: 2.2,
    in_row_rad: 0.25,
    blur_px: (1.5, 0.7),
    seen: 0.4,
    full: 0.9,
};

/// What is gathered of a frame's dark regions. Those without another origin are bounds on time: far above what a wing shows,
/// but a town beside it, or a board, shows hundreds; the largest are kept.
pub struct GatherOptions {
    /// Most regions of a level that are taken up at full resolution; a level of a faint frame that more pass lies in
    /// the picture's grain. In rendered haze up to 300 pass one.
    pub regions: usize,
    /// Most blobs.
    pub blobs: usize,
    /// Most pairs of blobs.
    pub pairs: usize,
    /// Most hypotheses of a kind.
    pub hypotheses: usize,
    /// Most regions whose background is uneven.
    pub uneven: usize,
    /// What windows may hold together, frames.
    pub frames: usize,
    /// Grey over background, in 1/256, from which on black is so light that quadrants' white, where that is the
    /// background, takes it above the black that lies before the skin. In rendered haze it is three quarters of white.
    pub pale: u16,
    /// How many times larger than a region that went on outside its window what has swallowed it at the next level
    /// is, for it to be seen by itself. Chosen, as the next two.
    pub swallowed: usize,
    /// How large it must be for that, reduced px.
    pub swallowed_least: usize,
    /// How dark, as grey over background, in 1/256.
    pub swallowed_dark: u16,
    /// Centroids of one thing, taken up twice, lie nearer to each other, px.
    pub near_px: f64,
    /// Its areas at two levels over one another at least.
    pub alike: f64,
    /// The same of quadrants of which the near background shows the greater part only.
    pub alike_parted: f64,
    /// Area from which on it may show a part only, px: of quadrants thicker than about 140 px.
    pub thick_px: f64,
    /// Share of its ellipse that such a part fills at most: quadrants 0.64.
    pub parted: f64,
    /// Side of a cell in which blobs are found again, px: some markers' thickness, so that few hold more than two.
    pub cell_px: f64,
}

/// The numbers in use.
pub const GATHER: GatherOptions = GatherOptions {
    regions: 2000,
    blobs: 3000,
    pairs: 30_000,
    hypotheses: 1000,
    uneven: 100,
    frames: 4,
    pale: 140,
    swallowed: 4,
    swallowed_least: 4,
    swallowed_dark: 200,
    near_px: 2.0,
    alike: 0.75,
    alike_parted: 0.95,
    thick_px: 5000.0,
    parted: 0.7,
    cell_px: 32.0,
};

/// Quadrants by the moments of their black.
pub struct MomentsOptions {
    /// Least by which the darker of the white quadrants must be lighter than the lighter of the black ones, each in
    /// a mean along its middle, grey levels; and the noise, if that is more. Of 123 rendered ones with a contrast
    /// of 36 and more the least was 26; a contrast of 8, the least of a marker, leaves a quarter under a blur of
    /// half their thickness.
    pub white_over_black: f64,
}

/// The numbers in use.
pub const MOMENTS: MomentsOptions = MomentsOptions { white_over_black: 2.0 };

/// What a decal leaves of a disc. Chosen on drawn and rendered decals; `tests/detect/decals.rs` holds them.
pub struct DecalCutOptions {
    /// Share of a disc's outline that a decal must lie over.
    pub touches: f64,
    /// Share that may lie under decals.
    pub covered: f64,
    /// The same where only its neighbour tells its slope: of a sliver the place would hang on that.
    pub covered_alone: f64,
    /// How far an expected outline may be off, px.
    pub aside_px: f64,
    /// How far the thicknesses of two discs side by side differ, as a share.
    pub same_minor: f64,
    /// How far their directions differ, rad.
    pub same_angle_rad: f64,
    /// Rows or columns of a blob that end at the decal, px: they tell no outline.
    pub cut_px: f64,
    /// Points of a blob's contour that must be left of it.
    pub least_points: usize,
    /// How far they may lie from the outline, root mean square, px: contours are told to half a pixel.
    pub off_px: f64,
    /// How far a decal's edge is blurred into what it leaves, blurs: 1 % of the contrast.
    pub edge_blurs: f64,
    /// Half way up an edge lies between two pixels, px.
    pub half_way_px: f64,
    /// How far a decal reaches beside its print where nothing tells, px: in the picture it is wider than long.
    pub side_px: f64,
    /// Steps in which a centre settles.
    pub steps: usize,
}

/// The numbers in use.
pub const DECAL_CUT: DecalCutOptions = DecalCutOptions {
    touches: 0.15,
    covered: 0.85,
    covered_alone: 0.64,
    aside_px: 3.0,
    same_minor: 0.04,
    same_angle_rad: 0.015,
    cut_px: 0.75,
    least_points: 16,
    off_px: 0.7,
    edge_blurs: 2.4,
    half_way_px: 0.5,
    side_px: 35.0,
    steps: 12,
};

/// What glare leaves of a disc. Chosen on rendered glare frames; `tests/detect/glare.rs` holds them.
pub struct GlareCutOptions {
    /// How far on either side of the contour the step from black to skin is taken, px.
    pub reach_px: f64,
    /// Share of the usual step below which a contour is not the disc's.
    pub step: f64,
    /// Contour points that must be left.
    pub left: usize,
}

/// The numbers in use.
pub const GLARE_CUT: GlareCutOptions = GlareCutOptions { reach_px: 3.0, step: 0.6, left: 40 };

/// The ellipse through a part of a contour. Chosen on `fixtures/dev` and drawn decals; `tests/detect/decals.rs`
/// holds them.
pub struct PartialOptions {
    /// How far a cut edge is blurred into what it leaves, px.
    pub blur_px: f64,
    /// Relative difference below which a neighbour is taken to be of the same size.
    pub same_size: f64,
    /// Share of the contour that must be seen beside a disc of the same size.
    pub share: f64,
    /// The same without one.
    pub share_alone: f64,
    /// Points of the contour that must be seen.
    pub least: usize,
}

/// The numbers in use.
pub const PARTIAL: PartialOptions =
    PartialOptions { blur_px: 2.5, same_size: 0.12, share: 0.35, share_alone: 0.55, least: 24 };

/// Where dark is parted from light best.
pub struct EdgesOptions {
    /// Directions that are tried: steps of 5 degrees, within which a fit finds the edges.
    pub turns: usize,
    /// Share of an outline's radius within which pixels count: the rest is blurred with the skin.
    pub inner: f64,
    /// Pixels of an outline that are looked at, about; of a larger one not all rows and columns are. A bound on time: what
    /// edges explain is known from so many to some percent.
    pub pixels: f64,
    /// Shifts that are tried to each side: a predicted place is off by up to 6 px.
    pub steps: i32,
    /// Their step, px: within, a fit finds the crossing.
    pub step_px: f64,
}

/// The numbers in use.
pub const EDGES: EdgesOptions =
    EdgesOptions { turns: 72, inner: 0.85, pixels: 600.0, steps: 3, step_px: 2.0 };

/// The outline of quadrants. Chosen on drawn and rendered quadrants; `tests/detect/bad_light.rs` and
/// `tests/detect/near.rs` hold them.
pub struct OutlineOptions {
    /// How much longer quadrants' white must be than their black to tell their length, a ratio.
    pub longer: f64,
    /// Ratio of the areas of two black quadrants beyond which they were seen against different thresholds.
    pub unequal: f64,
    /// Semi-minor axis from which on blur takes too little of quadrants to tell, px.
    pub thick_px: f64,
    /// Semi-minor axis below which quadrants are measured with their outline, blurs: blur takes too much of their
    /// edges.
    pub narrow_blurs: f64,
    /// How far the outline's centre may lie from where the edges of such quadrants cross, px.
    pub aside_px: f64,
    /// Skin about an outline that tells its grey, px.
    pub beside_px: f64,
    /// How far a first fit's blur is from that of outline and edges, as a share.
    pub same_blur: f64,
    /// Semi-minor axis of quadrants from which on their crossing is sought in a smaller picture, px: of 400 px,
    /// seen from 2.6 m, the outline's centre is 8 px off.
    pub large_px: f64,
    /// The same in that picture, px.
    pub small_px: f64,
}

/// The numbers in use.
pub const OUTLINE: OutlineOptions = OutlineOptions {
    longer: 1.1,
    unequal: 1.2,
    thick_px: 20.0,
    narrow_blurs: 7.5,
    aside_px: 1.5,
    beside_px: 8.0,
    same_blur: 0.1,
    large_px: 24.0,
    small_px: 12.0,
};
