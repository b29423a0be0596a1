//! Tuned numbers of proposals, with meaning, unit, origin.

use std::ops::Range;

use crate::detect::numbers::GrowingLength;

numbers! {
    /// Quadrants of whose black blur leaves too little. Chosen on drawn and rendered quadrants and checked by
    /// `tests/detect/sweep.rs`, unless they are bounds on time.
    BLURRED: BlurredOptions {
        /// Maximum semi-minor axis of quadrants of which blur may remove that much, relative to the maximum blur.
        max_blurs: f64 = 3.2,
        /// Minimum axis ratio of the visible part.
        flat: f64 = 3.0,
        /// Maximum ratio of the complete quadrants to the visible part.
        hidden: f64 = 2.5,
        /// Width of the skin around them from which its grey level is estimated, px.
        skin_px: f64 = 8.0,
        /// Minimum distance along a marker up to which its white is searched for, px: the black may be visible only in the
        /// middle.
        half_px: f64 = 60.0,
        /// Minimum area of such a blob, px.
        min_area_px: f64 = 30.0,
        /// Distance from the blob up to which white is searched for, px.
        beside_px: f64 = 12.0,
        /// Maximum semi-major axis of the visible part, px: 16 times the maximum semi-minor axis.
        max_major_px: f64 = 160.0,
        /// Maximum number of seeds that are tried, so that clutter cannot take arbitrarily long.
        max_seeds: usize = 120,
        /// Minimum area of a part that is used, a fraction of the product of the visible semi-axes.
        part: f64 = 0.1,
        /// Ratio of an outline to the visible part above which the search is repeated around the outline.
        longer: f64 = 1.2,
        /// Maximum number of repetitions.
        max_rounds: usize = 3,
        /// Minimum semi-minor axis of an outline, px.
        min_minor_px: f64 = 1.0,
        /// Blur with which the fit of such quadrants starts, px.
        blur_px: f64 = 1.5,
        /// Minimum fraction of a hull that the parts cover.
        min_filled: f64 = 0.4,
        /// Minimum fraction of its ellipse that a hull covers: 0.95 for a parallelogram.
        min_fill: f64 = 0.9,
    }

    /// Limits on the dark regions and blobs of a frame. Unless another origin is noted, they are bounds on time: far above
    /// the numbers of a wing, although a town next to it, or a board, has hundreds; the largest are kept.
    GATHER: GatherOptions {
        /// Maximum number of regions of a level that are segmented at full resolution. A level of a faint frame with more
        /// is in the noise of the image. In rendered haze up to 300 pass one level.
        regions: usize = 2000,
        /// Maximum number of blobs.
        blobs: usize = 3000,
        /// Maximum number of pairs of blobs.
        pairs: usize = 30_000,
        /// Maximum number of hypotheses of a kind.
        hypotheses: usize = 1000,
        /// Maximum number of regions with uneven background.
        uneven: usize = 100,
        /// Maximum total size of the windows, in frames.
        frames: usize = 4,
        /// Minimum size ratio of the region with which a region that extended beyond its window merges at the next level,
        /// for the latter to be segmented by itself. Chosen, as the next two.
        swallowed: usize = 4,
        /// Minimum area of such a region, reduced px.
        swallowed_least: usize = 4,
        /// Maximum ratio of grey to background of such a region, in 1/256.
        swallowed_dark: u16 = 200,
        /// Minimum ratio of the areas of one object at two levels.
        min_area_ratio: f64 = 0.75,
        /// Minimum ratio of the areas of quadrants of which the near background shows only the larger part.
        min_area_ratio_partial: f64 = 0.95,
        /// Area above which a blob may be only a part, px: of quadrants thicker than about 140 px.
        thick_px: f64 = 5000.0,
        /// Maximum fill of the ellipse by such a part: 0.64 for quadrants.
        max_partial_fill: f64 = 0.7,
        /// Side of a cell of the index of blobs, px: the thickness of a few markers, so that few cells hold more than two.
        cell_px: f64 = 32.0,
    }

    /// Discs and quadrants by the moments of their black.
    MOMENTS: MomentsOptions {
        /// Minimum difference between the darker of the white quadrants and the lighter of the black ones, each as the mean
        /// along its middle, grey levels; or the noise, if larger. The minimum was 26 for 123 rendered ones with a contrast
        /// of 36 and more; a contrast of 8, the minimum of a marker, leaves 25 % with a blur of half their thickness.
        white_over_black: f64 = 2.0,
        /// Range of a disc's pixels relative to those of its ellipse of inertia.
        disc_fill: Range<f64> = 0.72..1.2,
        /// Maximum squareness of a disc: a constant, and a part over the square of its semi-minor axis, px^2, because the
        /// outline has steps if few pixels lie across. An ellipse has 0, a parallelogram 0.6.
        max_squareness: f64 = 0.36,
        max_squareness_px2: f64 = 0.6,
        /// Semi-minor axis below which a disc may have any outline of pixels, px, and the maximum squareness there.
        thin_px: f64 = 1.8,
        max_squareness_thin: f64 = 1.3,
        /// Range of the pixels of two opposite quadrants relative to their ellipse of inertia, which they fill to 0.64.
        fill: Range<f64> = 0.5..0.85,
        /// Minimum determinant of the second moments of quadrants, px^4.
        min_determinant_px4: f64 = 1e-6,
        /// Range of the distance of the quadrants' centroids relative to the one expected from the second moments.
        apart: Range<f64> = 0.85..1.15,
        /// Range of the quadrants' area relative to the one expected from centroids and second moments.
        area: Range<f64> = 0.75..1.3,
        /// Maximum kurtosis along quadrants: 2 for a disc, 1.38 for quadrants.
        kurtosis: f64 = 1.62,
        /// Minimum fraction of the area in either quadrant.
        half: f64 = 0.35,
        /// Part of the maximum distance of the quadrants' centroids that either adds, by the root of the sum of its
        /// variances.
        pair: GrowingLength = GrowingLength { factor: 3.0, px: 3.0 },
    }

    /// Discs that are partly covered by a decal. Chosen on drawn and rendered decals; `tests/detect/decals.rs` checks them.
    DECAL_CUT: DecalCutOptions {
        /// Minimum fraction of a disc's outline under a decal.
        touches: f64 = 0.15,
        /// Maximum fraction of the outline under decals.
        covered: f64 = 0.85,
        /// Maximum offset of an expected outline, px.
        aside_px: f64 = 3.0,
        /// Prior standard deviation of the relative difference in thickness between neighbouring discs.
        same_minor: f64 = 0.04,
        /// Prior standard deviation of the difference in direction between neighbouring discs, rad.
        same_angle_rad: f64 = 0.015,
        /// Width of the rows or columns of a blob that end at the decal, px: they do not show the outline.
        cut_px: f64 = 0.75,
        /// Minimum number of contour points of a blob outside the decal.
        min_points: usize = 16,
        /// Maximum root mean square distance of these points from the outline, px: contours are accurate to 0.5 px.
        off_px: f64 = 0.7,
        /// Distance to which the edge of a decal is blurred into its surroundings, blurs: 1 % of the contrast.
        edge_blurs: f64 = 2.4,
        /// Default extent of a decal to the sides of its print, px: in the image it is wider than long.
        side_px: f64 = 35.0,
        /// Distance of the first centre from the middle of the visible rim, radii: towards the neighbour.
        first_step: f64 = 0.7,
        /// Iterations in which the centre converges.
        iterations: usize = 12,
    }

    /// Discs that are partly hidden by glare. Chosen on rendered glare frames; `tests/detect/glare.rs` checks them.
    GLARE_CUT: GlareCutOptions {
        /// Distance on either side of the contour at which the step from black to skin is measured, px.
        reach_px: f64 = 3.0,
        /// Fraction of the median step below which a contour does not belong to the disc.
        step: f64 = 0.6,
        /// Minimum median step, grey levels: fainter ones are noise.
        min_step: f64 = 8.0,
        /// Maximum ratio of the axes of a completed outline to those of its visible part: major, minor.
        larger: [f64; 2] = [2.0, 1.6],
        /// Minimum number of visible contour points.
        min_points: usize = 40,
    }

    /// Search for the edges of quadrants that best separate dark from light.
    EDGES: EdgesOptions {
        /// Number of directions that are tried: steps of 5 degrees, within which a fit finds the edges.
        turns: usize = 72,
        /// Fraction of an outline's radius within which pixels are used: those farther out are blurred with the skin.
        inner: f64 = 0.85,
        /// Approximate number of pixels of an outline that are used; of a larger outline rows and columns are skipped. A
        /// bound on time: this number determines the explained variance to a few percent.
        pixels: f64 = 600.0,
        /// Number of shifts that are tried to each side: a predicted position is off by up to 6 px.
        steps: i32 = 3,
        /// Step between the shifts, px: within it, a fit finds the crossing.
        step_px: isize = 2,
    }

    /// Outline of quadrants. Chosen on drawn and rendered quadrants; `tests/detect/bad_light.rs` and `tests/detect/near.rs`
    /// check it.
    OUTLINE: OutlineOptions {
        /// Minimum ratio of the length of the white to that of the black for the white to determine the length.
        longer: f64 = 1.1,
        /// Fraction of the contrast below white at which black ends: skin is darker than white.
        end: f64 = 0.65,
        /// Ratio to the outline of the box from which the grey level of the skin is estimated; `about_white` is that of the
        /// box in which white is searched for.
        about: f64 = 1.5,
        about_white: f64 = 2.2,
        /// Maximum distance of white beyond the semi-minor axis, px.
        white_px: f64 = 2.0,
        /// Minimum area of a white part, a fraction of the product of the semi-axes.
        white: f64 = 0.05,
        /// Minimum distance of both ends of the white from the centre, in semi-major axes.
        min_white_end: f64 = 0.7,
        /// Maximum ratio of these two distances.
        max_white_ratio: f64 = 1.25,
        /// Semi-minor axis above which blur removes too little of quadrants to affect the outline, px.
        thick_px: f64 = 20.0,
        /// Semi-minor axis below which quadrants are fitted with their outline, blurs: blur removes too much of their
        /// edges. With 4, errors in 12 rendered sets are 9 % smaller, but drawn quadrants under strong blur fail.
        narrow_blurs: f64 = 7.5,
        /// Maximum distance of the outline's centre from the crossing of the edges for flat quadrants, px.
        aside_px: f64 = 1.5,
        /// Semi-minor axis of quadrants above which their crossing is searched for in a reduced image, px: with 400 px,
        /// seen from 2.6 m, the centre of the outline is 8 px off. It is half as thick in that image.
        large_px: f64 = 24.0,
    }
}
