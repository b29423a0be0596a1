//! Tuned numbers of dark regions and blobs: meaning, unit, origin.

/// The local background, and what is dark against it.
pub struct BackgroundOptions {
    /// Distances at which both sides of a dark pixel are looked at, reduced px. Chosen, as all of these: the longest
    /// bounds the thickness of what can be found.
    pub reach: [usize; 5],
    /// Farther ones, for thick markers only: between two stretches of sky the whole wing is dark.
    pub far: [usize; 2],
    /// Least thickness of a region that is taken up against the far background, reduced px.
    pub thick: usize,
    /// Grey over local background below which a reduced pixel is dark, in 1/256, strictest first: several, so that a
    /// faint line that touches a marker does not swallow it. The last three are for frames whose contrast haze or
    /// stray light take away with distance; the last one shows discs of 6 grey levels (`tests/detect/sweep.rs`).
    pub levels: [u16; 7],
    /// How many of them are for any frame.
    pub usual: usize,
    /// Grey levels by which a pixel must be darker than the background beside that: the lighter of two sides is lighter
    /// than the mean of both by chance.
    pub above_noise: u8,
    /// Percent of the background by which it differs within an uneven region.
    pub uneven_percent: u32,
}

/// The numbers in use.
pub const BACKGROUND: BackgroundOptions = BackgroundOptions {
    reach: [2, 4, 8, 16, 24],
    far: [40, 64],
    thick: 24,
    levels: [115, 160, 195, 225, 240, 248, 252],
    usual: 4,
    above_noise: 2,
    uneven_percent: 8,
};

/// Blobs at full resolution.
pub struct BlobOptions {
    /// Fewer pixels are noise.
    pub least_px: u32,
    /// Where a line touches a disc, the threshold's share of the way from black to the background at which they come
    /// apart. Chosen; `tests/detect/bad_light.rs`.
    pub strict: f64,
    /// Least area of a blob that is looked at again, px.
    pub ragged_px: f64,
    /// Pixels over those of the ellipse with the same moments, least and most, of what is neither an ellipse nor two
    /// quadrants: perhaps a disc with a line that touches it. An ellipse fills 1, quadrants 0.64.
    pub ragged: (f64, f64),
    /// Part of a large frame's longer side that the longest marker takes.
    pub longest: usize,
    /// How long it may be in any frame, px.
    pub longest_px: usize,
    /// Reduced pixels by which a window is wider than its region, on each side.
    pub pad: usize,
}

/// The numbers in use.
pub const BLOB: BlobOptions = BlobOptions {
    least_px: 6,
    strict: 0.3,
    ragged_px: 100.0,
    ragged: (0.78, 0.95),
    longest: 4,
    longest_px: 1000,
    pad: 2,
};
