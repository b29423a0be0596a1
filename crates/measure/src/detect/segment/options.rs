//! Tuned numbers of dark regions and blobs, with meaning, unit, origin.

numbers! {
    /// Local background, and levels of darkness relative to it.
    BACKGROUND: BackgroundOptions {
        /// Distances at which both sides of a dark pixel are examined, reduced px. Chosen, as all of these: the largest
        /// limits the thickness of markers that can be found. Only regions as thick as that are segmented relative to the far
        /// background.
        reach: [usize; 5] = [2, 4, 8, 16, 24],
        /// Larger distances, for thick markers only: between two parts of the sky the entire wing is dark.
        far: [usize; 2] = [40, 64],
        /// Ratio of grey to local background below which a reduced pixel is dark, in 1/256, strictest first: several
        /// levels, so that a faint line that touches a marker does not merge with it. The last three are for frames in
        /// which haze or stray light reduces contrast with distance; the last one shows discs of 6 grey levels
        /// (`tests/detect/sweep.rs`).
        levels: [u16; 7] = [115, 160, 195, 225, 240, 248, 252],
        /// Number of levels that are used for every frame.
        default_levels: usize = 4,
        /// Additional grey levels by which a pixel must be darker than the background: the lighter of two sides is lighter
        /// than their mean by noise alone.
        above_noise: u8 = 2,
        /// Variation of the background within a region, in percent, above which it is uneven.
        uneven_percent: u32 = 8,
    }

    /// Blobs at full resolution.
    BLOB: BlobOptions {
        /// Minimum number of pixels of a blob: fewer are noise.
        min_pixels: u32 = 6,
        /// Ratio of the longer side of a large frame to the longest marker.
        long_side_divisor: usize = 4,
        /// Maximum length of a marker in any frame, px.
        max_length_px: usize = 1000,
        /// Ratio of the box in which the parts of a marker must lie to its outline.
        about: f64 = 1.3,
        /// Margin of a window around its region, on each side, reduced px.
        pad: usize = 2,
    }
}

impl BackgroundOptions {
    /// Returns the largest distance of the near background, reduced px. Thicker regions need the far one.
    pub const fn near_reach(&self) -> usize {
        self.reach[self.reach.len() - 1]
    }
}
