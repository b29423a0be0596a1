//! Tuned numbers of proposals: meaning, unit, origin.

use crate::detect::hypothesis::prior::PriorValue;

numbers! {
    /// Quadrants of whose black blur leaves too little. Chosen on drawn and rendered quadrants; `tests/detect/sweep.rs`
    /// holds them, unless they are bounds on time.
    BLURRED: BlurredOptions {
        /// Greatest semi-minor axis of which blur may take so much, over the greatest blur.
        max_blurs: f64 = 3.2,
        /// Least axis ratio of what is seen.
        flat: f64 = 3.0,
        /// How much larger than what is seen they may be, a ratio.
        hidden: f64 = 2.5,
        /// Skin about them that tells its grey, px.
        skin_px: f64 = 8.0,
        /// How far along a marker its white is looked for at least, px: black may be seen of its middle only.
        half_px: f64 = 60.0,
        /// Greatest semi-minor axis of a blob of which blur may have left what is no quadrant, px.
        max_minor_px: f64 = 10.0,
        /// Its least area, px.
        min_area_px: f64 = 30.0,
        /// How far about it white is looked for, px.
        beside_px: f64 = 12.0,
        /// Greatest semi-major axis of what is looked at, px: sixteen times the thickest.
        max_major_px: f64 = 160.0,
        /// How many are tried at most, so that clutter cannot take for ever.
        max_seeds: usize = 120,
        /// How far apart two black parts in a row may be, in their semi-major axes: of a target of 78 x 7 px a blur of
        /// 2 px leaves two lobes 100 px from each other.
        apart: f64 = 2.2,
        /// How far out of the row each may point, rad.
        in_row_rad: f64 = 0.25,
        /// Area of one black part over the other's at least, a ratio.
        min_area_ratio: f64 = 0.4,
        /// Least area of a part that counts, a share of the product of the semi-axes that are seen.
        part: f64 = 0.1,
        /// How much longer than what is seen an outline is, a ratio, from which on it is sought once more about that.
        longer: f64 = 1.2,
        /// How often it is at most.
        max_rounds: usize = 3,
        /// Least semi-minor axis of an outline, px.
        min_minor_px: f64 = 1.0,
        /// Their blur beforehand, px, with its standard deviation.
        blur_px: PriorValue = PriorValue { value: 1.5, sigma: 0.7 },
        /// Least share of a hull that is seen.
        min_filled: f64 = 0.4,
        /// Least share of its ellipse that it fills: a parallelogram 0.95.
        min_fill: f64 = 0.9,
    }

    /// What is gathered of a frame's dark regions. Those without another origin are bounds on time: far above what a wing shows,
    /// but a town beside it, or a board, shows hundreds; the largest are kept.
    GATHER: GatherOptions {
        /// Most regions of a level that are taken up at full resolution; a level of a faint frame that more pass lies in
        /// the picture's grain. In rendered haze up to 300 pass one.
        regions: usize = 2000,
        /// Most blobs.
        blobs: usize = 3000,
        /// Most pairs of blobs.
        pairs: usize = 30_000,
        /// Most hypotheses of a kind.
        hypotheses: usize = 1000,
        /// Most regions whose background is uneven.
        uneven: usize = 100,
        /// What windows may hold together, frames.
        frames: usize = 4,
        /// Grey over background, in 1/256, from which on black is so light that quadrants' white, where that is the
        /// background, takes it above the black that lies before the skin. In rendered haze it is three quarters of white.
        pale: u16 = 140,
        /// How many times larger than a region that went on outside its window what has swallowed it at the next level
        /// is, for it to be seen by itself. Chosen, as the next two.
        swallowed: usize = 4,
        /// How large it must be for that, reduced px.
        swallowed_least: usize = 4,
        /// How dark, as grey over background, in 1/256.
        swallowed_dark: u16 = 200,
        /// Centroids of one thing, taken up twice, lie nearer to each other, px.
        near_px: f64 = 2.0,
        /// Its areas at two levels over one another at least.
        min_area_ratio: f64 = 0.75,
        /// The same of quadrants of which the near background shows the greater part only.
        min_area_ratio_partial: f64 = 0.95,
        /// Area from which on it may show a part only, px: of quadrants thicker than about 140 px.
        thick_px: f64 = 5000.0,
        /// Share of its ellipse that such a part fills at most: quadrants 0.64.
        max_partial_fill: f64 = 0.7,
        /// Side of a cell in which blobs are found again, px: some markers' thickness, so that few hold more than two.
        cell_px: f64 = 32.0,
    }

    /// Quadrants by the moments of their black.
    MOMENTS: MomentsOptions {
        /// Least by which the darker of the white quadrants must be lighter than the lighter of the black ones, each in
        /// a mean along its middle, grey levels; and the noise, if that is more. Of 123 rendered ones with a contrast
        /// of 36 and more the least was 26; a contrast of 8, the least of a marker, leaves a quarter under a blur of
        /// half their thickness.
        white_over_black: f64 = 2.0,
        /// Pixels of a disc over those of its ellipse of inertia, at least and at most.
        disc_fill: (f64, f64) = (0.72, 1.2),
        /// Squareness of a disc at most: of one with a semi-minor axis below some px, of others, and over the square of that
        /// axis, px^2, for few pixels across make steps in the outline. An ellipse has 0, a parallelogram 0.6.
        disc_thin: (f64, f64) = (1.8, 1.3),
        disc_square: (f64, f64) = (0.36, 0.6),
        /// The same of two opposite quadrants, which fill 0.64.
        fill: (f64, f64) = (0.5, 0.85),
        /// Least determinant of their second moments, px^4.
        min_determinant_px4: f64 = 1e-6,
        /// Distance of their centroids over what their second moments say.
        apart: (f64, f64) = (0.85, 1.15),
        /// Their area over what both say.
        area: (f64, f64) = (0.75, 1.3),
        /// Greatest kurtosis along them: a disc has 2, quadrants 1.38.
        kurtosis: f64 = 1.62,
        /// Share of the area that either must have.
        half: f64 = 0.35,
        /// How far apart their centroids may be: roots of the sums of variances, and px.
        pair: (f64, f64) = (3.0, 3.0),
    }

    /// What a decal leaves of a disc. Chosen on drawn and rendered decals; `tests/detect/decals.rs` holds them.
    DECAL_CUT: DecalCutOptions {
        /// Share of a disc's outline that a decal must lie over.
        touches: f64 = 0.15,
        /// Share that may lie under decals.
        covered: f64 = 0.85,
        /// The same where only its neighbour tells its slope: of a sliver the place would hang on that.
        covered_alone: f64 = 0.64,
        /// How far an expected outline may be off, px.
        aside_px: f64 = 3.0,
        /// How far the thicknesses of two discs side by side differ, as a share.
        same_minor: f64 = 0.04,
        /// How far their directions differ, rad.
        same_angle_rad: f64 = 0.015,
        /// Rows or columns of a blob that end at the decal, px: they tell no outline.
        cut_px: f64 = 0.75,
        /// Points of a blob's contour that must be left of it.
        min_points: usize = 16,
        /// How far they may lie from the outline, root mean square, px: contours are told to half a pixel.
        off_px: f64 = 0.7,
        /// How far a decal's edge is blurred into what it leaves, blurs: 1 % of the contrast.
        edge_blurs: f64 = 2.4,
        /// Half way up an edge lies between two pixels, px.
        half_way_px: f64 = 0.5,
        /// How far a decal reaches beside its print where nothing tells, px: in the picture it is wider than long.
        side_px: f64 = 35.0,
        /// How far from the middle of what is left of its rim a centre is sought first, radii: towards its neighbour.
        first_step: f64 = 0.7,
        /// Steps in which a centre settles.
        iterations: usize = 12,
    }

    /// What glare leaves of a disc. Chosen on rendered glare frames; `tests/detect/glare.rs` holds them.
    GLARE_CUT: GlareCutOptions {
        /// How far on either side of the contour the step from black to skin is taken, px.
        reach_px: f64 = 3.0,
        /// Share of the usual step below which a contour is not the disc's.
        step: f64 = 0.6,
        /// Least usual step, grey levels: fainter ones are noise.
        min_step: f64 = 8.0,
        /// Area of the rest of a disc beyond the glare: px at least, and over that of the part at most.
        rest: (f64, f64) = (30.0, 3.0),
        /// How far along the axis it may lie, semi-major axes of the part.
        along: (f64, f64) = (1.0, 5.0),
        /// How far across, a share of that, beside the semi-minor axis.
        across: f64 = 0.1,
        /// Mean distance of both rims from one ellipse at most, px.
        off_px: f64 = 1.0,
        /// Axes of a completed outline over those of what is seen of it at most: major, minor.
        larger: [f64; 2] = [2.0, 1.6],
        /// Contour points that must be left.
        min_points: usize = 40,
    }

    /// The ellipse through a part of a contour. Chosen on `fixtures/dev` and drawn decals; `tests/detect/decals.rs`
    /// holds them.
    PARTIAL: PartialOptions {
        /// How far a cut edge is blurred into what it leaves, px.
        blur_px: f64 = 2.5,
        /// Relative difference below which a neighbour is taken to be of the same size.
        same_size: f64 = 0.12,
        /// Share of the contour that must be seen beside a disc of the same size.
        share: f64 = 0.35,
        /// The same without one.
        share_alone: f64 = 0.55,
        /// Area of a neighbour over the blob's, at least and at most.
        neighbour: (f64, f64) = (0.3, 6.0),
        /// Pixels of a blob over those of its ellipse of inertia between which it is filled as an ellipse is.
        fill: (f64, f64) = (0.95, 1.05),
        /// Axes of a completed outline over those of what is seen of it at most: major, minor.
        larger: [f64; 2] = [2.0, 3.0],
        /// Points of the contour that must be seen.
        min_points: usize = 24,
    }

    /// Where dark is parted from light best.
    EDGES: EdgesOptions {
        /// Directions that are tried: steps of 5 degrees, within which a fit finds the edges.
        turns: usize = 72,
        /// Share of an outline's radius within which pixels count: the rest is blurred with the skin.
        inner: f64 = 0.85,
        /// Pixels of an outline that are looked at, about; of a larger one not all rows and columns are. A bound on time: what
        /// edges explain is known from so many to some percent.
        pixels: f64 = 600.0,
        /// Shifts that are tried to each side: a predicted place is off by up to 6 px.
        steps: i32 = 3,
        /// Their step, px: within, a fit finds the crossing.
        step_px: isize = 2,
    }

    /// The outline of quadrants. Chosen on drawn and rendered quadrants; `tests/detect/bad_light.rs` and
    /// `tests/detect/near.rs` hold them.
    OUTLINE: OutlineOptions {
        /// How much longer quadrants' white must be than their black to tell their length, a ratio.
        longer: f64 = 1.1,
        /// Shares of the contrast below white at which black ends, in the order in which they are tried: skin is darker than
        /// white, and nearer to black it does not run into the quadrants.
        ends: [f64; 2] = [0.65, 0.8],
        /// How much larger the box is that tells the skin, and the one in which white is sought, a ratio.
        about: f64 = 1.5,
        about_white: f64 = 2.2,
        /// How far beyond the semi-minor axis white may lie, px.
        white_px: f64 = 2.0,
        /// Least area of a white part, a share of the product of the semi-axes.
        white: f64 = 0.05,
        /// How far out both ends of the white reach at least, semi-major axes, and how unlike both may be, a ratio.
        white_ends: (f64, f64) = (0.7, 1.25),
        /// Ratio of the areas of two black quadrants beyond which they were seen against different thresholds.
        unequal: f64 = 1.2,
        /// Semi-minor axis from which on blur takes too little of quadrants to tell, px.
        thick_px: f64 = 20.0,
        /// Semi-minor axis below which quadrants are measured with their outline, blurs: blur takes too much of their
        /// edges.
        narrow_blurs: f64 = 7.5,
        /// How far the outline's centre may lie from where the edges of such quadrants cross, px.
        aside_px: f64 = 1.5,
        /// Skin about an outline that tells its grey, px.
        beside_px: f64 = 8.0,
        /// How far a first fit's blur is from that of outline and edges, as a share.
        same_blur: f64 = 0.1,
        /// Semi-minor axis of quadrants from which on their crossing is sought in a smaller picture, px: of 400 px,
        /// seen from 2.6 m, the outline's centre is 8 px off.
        large_px: f64 = 24.0,
        /// The same in that picture, px.
        small_px: f64 = 12.0,
        /// How much larger than the outline that picture is, a ratio.
        small_about: f64 = 1.2,
    }
}
