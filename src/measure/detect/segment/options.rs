//! Tuned numbers of dark regions and blobs: meaning, unit, origin.

numbers! {
    /// The local background, and what is dark against it.
    BACKGROUND: BackgroundOptions {
        /// Distances at which both sides of a dark pixel are looked at, reduced px. Chosen, as all of these: the longest
        /// bounds the thickness of what can be found.
        reach: [usize; 5] = [2, 4, 8, 16, 24],
        /// Farther ones, for thick markers only: between two stretches of sky the whole wing is dark.
        far: [usize; 2] = [40, 64],
        /// Least thickness of a region that is taken up against the far background, reduced px.
        thick: usize = 24,
        /// Grey over local background below which a reduced pixel is dark, in 1/256, strictest first: several, so that a
        /// faint line that touches a marker does not swallow it. The last three are for frames whose contrast haze or
        /// stray light take away with distance; the last one shows discs of 6 grey levels (`tests/detect/sweep.rs`).
        levels: [u16; 7] = [115, 160, 195, 225, 240, 248, 252],
        /// How many of them are for any frame.
        default_levels: usize = 4,
        /// Grey levels by which a pixel must be darker than the background beside that: the lighter of two sides is lighter
        /// than the mean of both by chance.
        above_noise: u8 = 2,
        /// Percent of the background by which it differs within an uneven region.
        uneven_percent: u32 = 8,
    }

    /// Blobs at full resolution.
    BLOB: BlobOptions {
        /// Fewer pixels are noise.
        min_pixels: u32 = 6,
        /// Where a line touches a disc, the threshold's share of the way from black to the background at which they come
        /// apart. Chosen; `tests/detect/bad_light.rs`.
        strict_share: f64 = 0.3,
        /// The usual share.
        default_share: f64 = 0.5,
        /// Least area of a blob that is looked at again, px.
        min_ragged_px: f64 = 100.0,
        /// Pixels over those of the ellipse with the same moments, least and most, of what is neither an ellipse nor two
        /// quadrants: perhaps a disc with a line that touches it. An ellipse fills 1, quadrants 0.64.
        ragged: (f64, f64) = (0.78, 0.95),
        /// Part of a large frame's longer side that the longest marker takes.
        long_side_divisor: usize = 4,
        /// How long it may be in any frame, px.
        max_length_px: usize = 1000,
        /// How much larger than an outline the box about it is in which its parts must lie, a ratio.
        about: f64 = 1.3,
        /// Reduced pixels by which a window is wider than its region, on each side.
        pad: usize = 2,
    }
}
