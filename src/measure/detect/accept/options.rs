//! Tuned numbers of what is accepted: meaning, unit, origin.

numbers! {
    /// What a fit must be to be a marker.
    VERDICT: VerdictOptions {
        /// Share of a disc's sag that is added along its axis: how a decal lies on a curved skin is not known, and
        /// stretched or not differs by the sag times the skin's slope, for which one in fourteen stands.
        laid: f64 = 0.07,
        /// Share of a disc's outline that glare may hide. Chosen on the rendered glare frames; `tests/detect/glare.rs`.
        hidden_by_glare: f64 = 0.64,
        /// What glare's fringe, up to a tenth of the skin's light before it is seen, does to an edge beside it, px.
        /// Derived: a tenth of an edge's width.
        fringe_px: f64 = 0.1,
        /// The same where most of the fringe is left out, or measured. Normalised errors of 1626 discs in glare 0.99
        /// and 0.96 (`docs/decisions/0014`).
        rest_of_fringe_px: f64 = 0.06,
        /// Semi-minor axis below which it shifts a disc less across, px: both edges lie in about the same light. Chosen
        /// with the last one.
        even_px: f64 = 20.0,
        /// Greatest standard deviation of a centre, px. Chosen: beyond, it bears nothing on the wing's shape.
        vaguest_px: f64 = 2.0,
        /// The same of a disc whose length is predicted, so that no more than the place along it is in doubt.
        vaguest_predicted_px: f64 = 2.5,
        /// The same of quadrants whose outline is predicted: edges that only point at their crossing are off by more
        /// than they say (1.3 px with 0.4 px stated; `tests/detect/closer.rs`).
        vaguest_crossing_px: f64 = 0.5,
        /// Axis ratio of the flattest disc. Seen from a metre above the skin, discs are 1:28 on a wing that bends
        /// downwards, and seams are far flatter.
        flattest: f64 = 40.0,
        /// That of quadrants, which are nearer: flatter ones are two discs side by side.
        flattest_quadrants: f64 = 26.0,
        /// Least darkness: 3 % of the grey of white or skin. Dirt and panel lines are as pale.
        least_dark: f64 = 0.06,
        /// Least contrast, grey levels: steps of JPEG's are as high.
        least_contrast: f64 = 5.0,
        /// The same in standard deviations of the noise: of the hundred pixels about the smallest marker's edge chance makes
        /// no such step.
        over_noise: f64 = 4.0,
        /// Greatest blur that is measured, px. Chosen: farther out of focus than a camera is left.
        softest_px: f64 = 3.2,
        /// Greatest root mean square of a marker's residuals over the noise, and beside that over its contrast, ratios. Chosen:
        /// `tests/detect/bad_light.rs`.
        poor: (f64, f64) = (1.6, 0.05),
        /// Least mean weight of its pixels: of less, half shows something else.
        inliers: f64 = 0.55,
        /// How far a fit may end from where it began, as a share of the semi-major axis, and px beside that.
        moved: (f64, f64) = (0.25, 2.0),
        /// How near an outline may come to the middle of the frame's outermost pixels, px.
        rim_px: f64 = 0.5,
        /// Least semi-axes, px: fewer pixels tell no outline.
        least_px: [f64; 2] = [3.5, 0.8],
        /// Standard deviations (`PRIOR.taper`) by which a disc's ends may differ.
        lopsided: f64 = 4.0,
        /// Greatest standard deviation of any centre, as a share of the semi-major axis.
        vaguest: f64 = 0.05,
        /// The same of what is seen as a whole, and px where that is less: such an outline tells more than a part does.
        vaguest_whole: (f64, f64) = (0.02, 0.6),
        /// How many times that may be of a disc whose length is predicted.
        predicted: f64 = 2.0,
        /// Sum of a place's variances up to which nothing can hide much of a marker, px^2.
        sure_px2: f64 = 0.1,
        /// What noise may be at edges, grey levels, where JPEG has left none of it beside them. Chosen;
        /// `tests/detect/bad_light.rs`.
        lost_noise: f64 = 1.0,
    }

    /// Quadrants of a target against squares of a checkerboard.
    PATTERN: PatternOptions {
        /// How much farther black may reach along the middle of a quadrant than to both sides of it, a ratio. Half way
        /// between a circle's 1 and a square's 1.37; `tests/detect/background.rs`.
        corner: f64 = 1.18,
        /// Where beyond the outline skin begins: blurs, and at least and at most radii.
        beyond_blurs: f64 = 2.0,
        beyond: (f64, f64) = (0.1, 0.2),
        /// Three places from there, radii, all short of the corner at 1.25 radii of a square of the same size. Most of them
        /// decide, for the outline is rough, and a line may cross it.
        places: [f64; 3] = [0.0, 0.04, 0.08],
        /// Where black is looked at, radii: blur brightens a thin tip.
        inside: f64 = 0.75,
        /// Share of the way from black to white by which skin is lighter than black: it may be darker than half way.
        lighter: f64 = 0.2,
        /// Share of the contrast below white at which black ends.
        ends: f64 = 0.6,
        /// From where to where that is sought, and in which steps, radii.
        reach: (f64, f64) = (0.5, 1.7),
        step: f64 = 0.02,
        /// Least semi-minor axis of which that can be told, blurs. Chosen; `tests/detect/background.rs`.
        tells_corner_blurs: f64 = 8.0,
        /// Where, from the middle (0) to the edges (1) of a quadrant, its sides are looked at. Chosen: a square's
        /// corner is far, the edges' blur not yet near.
        aside: f64 = 0.65,
    }

    /// What a frame's markers have in common.
    CONSISTENCY: ConsistencyOptions {
        /// How far out, from the centre (0) to the outline (1), the centre of one thing lies in another outline at most that is
        /// the same thing, seen at another level.
        within: f64 = 0.5,
        /// The same of a disc and quadrants.
        within_other: f64 = 0.8,
        /// Skin between two discs in a row from which on they are no quadrants, blurs: the black of quadrants meets.
        /// The test of this file.
        apart_blurs: f64 = 3.0,
        /// Greatest blur over the median one, a ratio: one lens makes all edges. Chosen on the rendered sets; the test
        /// of this file.
        softer: f64 = 2.0,
        /// Semi-minor axis of quadrants, blurs, from which on their own edges tell that they are out of focus and no
        /// shadow. Derived: a mark of 0.1 m at 3 m has 50 and more, what a shadow's edge makes of one on the wing fewer
        /// than 8. The test of this file's neighbour, `consistency.rs`.
        crisp_blurs: f64 = 12.0,
        /// Markers that tell it. Fewer may all be something else.
        blurs: usize = 5,
        /// Flat things that tell the skin's horizon. Fewer may all be something else.
        directions: usize = 5,
        /// Axis ratio from which on a direction is told.
        flat: f64 = 2.0,
        /// Of discs how flat one must be to be judged, and how far across it may lie, rad: of 20 300 markers in 116
        /// rendered sets none lies more than 0.3 rad across.
        disc_across: (f64, f64) = (8.0, 0.6),
        /// The same of quadrants, which lie up to 0.41 rad across near the camera.
        quadrants_across: (f64, f64) = (2.5, 0.8),
        /// Size of the next larger one over a thing that is too small to be a marker: one would have to be so many
        /// times as far away as all others. Chosen on the rendered sets; `tests/detect/near.rs`.
        gap: f64 = 2.5,
        /// How much longer those beside a thing must be that tell it: other dots do not.
        longer: f64 = 1.3,
        /// Larger ones that tell it: of the nearest one more, for that may be a dot.
        sizes: usize = 4,
    }

    /// Residuals that hang together in all of a frame's markers.
    CORRELATED: CorrelatedOptions {
        /// How far the median ratio of a frame's markers exceeds 1 by chance. Derived: with twenty of them, two
        /// standard deviations.
        chance: f64 = 1.25,
        /// Fewer markers do not tell. Derived: the median of eight scatters by 0.4 of one's scatter.
        least: usize = 8,
    }

    /// Dirt along a disc. Chosen on 2244 discs of 24 rendered sets, whose normalised error across fell from 1.21 to
    /// 1.06; `tests/detect/dirt.rs` holds it.
    DIRT: DirtOptions {
        /// Where the skin is looked at, blurs from the outline: there the edge leaves 1 % of its contrast.
        clear_blurs: f64 = 2.2,
        /// How many pixels outwards from there.
        reach_px: usize = 6,
        /// Of these the nearest, which tell, px.
        nearest_px: usize = 3,
        /// At every so many along the disc, px.
        step_px: f64 = 2.0,
        /// At so many places to each side of the middle at least.
        steps: f64 = 5.0,
        /// At what share of its length: tips face along it.
        length: f64 = 0.85,
        /// How far another marker's blur reaches, blurs. Derived: beyond, it leaves 0.1 % of its contrast.
        skirt_blurs: f64 = 3.0,
        /// Pixels of a side that must be seen.
        least_px: f64 = 20.0,
        /// Share of the contrast up to which what is unlike the skin counts: more is another thing.
        most: f64 = 0.5,
        /// How far what lies beside an edge shifts it, in blurs, for each contrast that it is darker than the skin.
        /// Near the slope of a blurred edge, sqrt(2 pi) = 2.5.
        shift_blurs: f64 = 2.25,
        /// By how much the mean of residuals that hang together scatters more than that of independent ones.
        together: f64 = 2.0,
        /// Standard deviations up to which a difference is chance.
        chance: f64 = 2.0,
        /// Rounds of the robust fit of the skin's light: it hardly changes after two.
        rounds: usize = 3,
        /// Residual scales from which on a pixel has no say in it: Tukey's biweight, 95 % efficient.
        cut_scales: f64 = 4.7,
        /// Least scale of residuals, grey levels. Derived: a grey value is a whole number, 1/sqrt(12).
        floor: f64 = 0.3,
    }

    /// Contrast that quadrants have lost against the frame's others.
    LOST: LostContrastOptions {
        /// Quadrants that tell what is usual. Chosen: of fewer one decides.
        least: usize = 4,
        /// Share that is chance. Derived: on the clear frames of five rendered sets quadrants' darkness lies up to 0.09 below the
        /// upper quartile of their frame.
        chance: f64 = 0.1,
        /// Quadrants that must have lost some for all of the frame's markers to be doubted: on one something may lie.
        several: usize = 2,
    }

    /// What the image formula leaves beyond what noise may (`VERDICT.poor`).
    MISFIT: MisfitOptions {
        /// Share of an edge's width by which a marker is shifted for residuals as large as its contrast. Chosen: about half of what is
        /// left is a bias of the edge, the rest changes its form alone. Errors of 1500 markers of eight rendered sets are then 0.8
        /// to 1.2 standard deviations (`docs/validation/2026-11-cabin.md`).
        of_width: f64 = 0.5,
    }

    /// Which of two answers for one thing is kept.
    BETTER: BetterOptions {
        /// Size of one over the other's, products of their semi-axes, from which on the smaller one is a part: a decal or glare that
        /// hides half of a disc.
        part: f64 = 2.0,
        /// Standard deviations by which two answers for one place may differ: one in 16 000 by chance.
        alike_sigmas: f64 = 4.0,
    }
}
