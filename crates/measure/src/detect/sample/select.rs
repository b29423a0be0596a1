//! Selection and weights of the pixels of a fit: along the outline, or along the edges between the quadrants.
//!
//! Weights decrease to zero smoothly with the distance from the outline, and if not all pixels are needed, the fraction
//! that is used changes smoothly with the size of the marker. The selection, and with it the result, therefore hardly
//! depends on the way in which the geometry was obtained.

use std::ops::Range;

use nalgebra::Vector2;

use super::bands::{EdgeBands, FADE_PX, clamp_blur};
use super::foreign::{mask_darker, mask_foreign};
use super::pixels::Pixels;
use super::weight::{EdgeGeometry, EdgeLines, PixelCollector};
use crate::detect::appearance::parameters::MarkerParameters;
use crate::detect::hypothesis::{EdgePair, Hypothesis};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::image::scanline::{
    EdgeLine, EllipseFrame, EllipseRows, PixelBox, Ring, columns_in_area, row_interval,
};
use crate::detect::segment::{bitmask::WORD_BITS, blob::Blob};
use crate::raster::Raster;

/// Approximate number of pixels of a fit: at the edges, which determine the position, and next to them, where they only
/// determine the grey levels.
#[derive(Clone, Copy)]
pub struct PixelBudget {
    pub edge: f64,
    pub flat: f64,
    /// Fraction of the flat background that is used around the thinnest disc. Objects on the skin are foreshortened like
    /// the disc: light that is a plane around a thick disc may not be one around a thin one.
    pub nearest: f64,
}

/// Budget of a final fit: more pixels would only cost time.
pub const FINAL: PixelBudget = PixelBudget {
    edge: 450.0,
    flat: 550.0,
    nearest: 0.55,
};
/// Budget of a coarse fit: enough for the geometry by which the pixels of the final fit are selected.
pub const COARSE: PixelBudget = PixelBudget {
    edge: 130.0,
    flat: 70.0,
    nearest: 1.0,
};
/// Budget of all available pixels, for a marker whose outline is hidden in large part.
pub const UNLIMITED: PixelBudget = PixelBudget {
    edge: 1e9,
    flat: 1e9,
    nearest: 0.55,
};
/// Length above which not all pixels of an edge are used, px.
const LONG_EDGE_PX: f64 = 150.0;
/// Minimum fraction of the flat pixels that is used around the longest edges.
const MIN_FLAT_SHARE: f64 = 0.5;
/// Half width of the band of a sharp edge, px.
const SHARP_BAND_PX: f64 = 1.5;

/// Range of the distance from the rim of quadrants within which pixels are excluded, blurs. At 1.5 blurs 7 % of skin is
/// mixed in, equally on opposite sides, so that the crossing does not shift. Thick quadrants have enough edge farther
/// inside.
const END_MARGIN: Range<f64> = 1.5..2.5;
/// Range of semi-minor axes, in blurs, over which the distance from the rim increases by one blur.
const END_THICK: Range<f64> = 10.0..25.0;
/// Maximum distance from the rim as a fraction of the semi-minor axis; the minimum is a pixel.
const END_PART: f64 = 0.45;

/// Returns the distance from the rim within which pixels are excluded, px, for quadrants of a given semi-minor axis and
/// blur, px.
fn end_margin(minor: f64, blur: f64) -> f64 {
    let by = (minor / blur - END_THICK.start) / (END_THICK.end - END_THICK.start);
    let margin = (END_MARGIN.start + by).clamp(END_MARGIN.start, END_MARGIN.end) * blur;
    margin.min(END_PART * minor).max(1.0)
}

/// Number of pixels in the period of a sampling pattern: fractions of pixels are resolved to 1/16 of a pixel.
const PERIOD: usize = 16;
/// Shift of the pattern between columns: coprime to the period, so that each position occurs once, far from the previous
/// one.
const COLUMN_SHIFT: usize = 5;
/// Shift of the pattern between rows.
const ROW_SHIFT: usize = 7;

/// Number of pixels used per period of the pattern, at the edge and next to it.
#[derive(Clone, Copy)]
struct PatternShare {
    edge: f64,
    flat: f64,
}

impl PatternShare {
    /// Computes the numbers for an edge of some length, px, visible on both sides.
    fn new(budget: PixelBudget, bands: EdgeBands, length: f64) -> Self {
        let (edge, flat) = (f64::from(bands.edge), f64::from(bands.flat));
        // A blurred edge spreads its information over more pixels.
        let more = (edge / SHARP_BAND_PX).max(1.0);
        let share = |budget: f64, width: f64| {
            PERIOD as f64 * (more * budget / (2.0 * width * length).max(1.0)).min(1.0)
        };
        // A long edge has enough pixels for less precise grey levels.
        let levels = budget.flat * (LONG_EDGE_PX / length.max(1.0)).clamp(MIN_FLAT_SHARE, 1.0);
        Self {
            edge: share(budget.edge, edge),
            flat: share(levels, flat - edge),
        }
    }

    /// Returns the weight of a pixel at the edge and next to it, for each position in the pattern.
    fn weight_table(self) -> [[f32; 2]; PERIOD] {
        std::array::from_fn(|turn| {
            [self.edge, self.flat].map(|keep| (keep - turn as f64).clamp(0.0, 1.0) as f32)
        })
    }
}

/// Bit masks of the pixels of a word in a row at the start of the pattern: those that are used near an edge, and those that
/// are used next to it.
#[derive(Clone, Copy)]
struct PatternBits([u64; 2]);

impl PatternBits {
    fn new(shares: &[[f32; 2]; PERIOD]) -> Self {
        /// Factor that repeats the bits of the pattern in a word.
        const EVERY: u64 = u64::MAX / ((1 << PERIOD) - 1);
        let bits = |counts: fn(&[f32; 2]) -> bool| -> u64 {
            (0..PERIOD)
                .map(|k| u64::from(counts(&shares[COLUMN_SHIFT * k % PERIOD])) << k)
                .sum()
        };
        Self(
            [
                bits(|[edge, flat]| edge.max(*flat) > 0.0),
                bits(|[_, flat]| *flat > 0.0),
            ]
            .map(|b| b * EVERY),
        )
    }

    /// Returns the masks of used pixels for a row that starts at another position of the sampling pattern.
    fn for_row(self, turn: usize) -> [u64; 2] {
        /// Columns that advance the pattern by one position: `COLUMN_SHIFT` times this is 1 modulo `PERIOD`.
        const COLUMNS_PER_POSITION: usize = 13;
        self.0
            .map(|bits| bits.rotate_right((COLUMNS_PER_POSITION * turn % PERIOD) as u32))
    }
}

/// Returns the bits of the pixels of a word, starting at column `first`, that lie in a range of columns.
fn column_bits(columns: &ColumnRange, first: usize) -> u64 {
    // All bits from a position on; a shift by all of them leaves none.
    let from = |x: usize| {
        u64::MAX
            .checked_shl(x.saturating_sub(first) as u32)
            .unwrap_or(0)
    };
    from(columns.start) & !from(columns.end)
}

type ColumnRange = Range<usize>;

/// Pixels of a frame that may be used, with those of them that are excluded.
struct PixelSource<'a> {
    image: &'a Raster,
    hypothesis: &'a Hypothesis,
    area: PixelBox,
    /// Weight of a pixel by its position in the pattern; `places` holds those with a weight.
    shares: [[f32; 2]; PERIOD],
    places: PatternBits,
    masked: Option<Vec<bool>>,
    /// True if no pixel is excluded.
    clear: bool,
}

impl PixelSource<'_> {
    /// Adds the used pixels of a row in a range of columns; those in `near` are near an edge.
    fn take_row(
        &self,
        y: usize,
        columns: ColumnRange,
        near: &[ColumnRange; 2],
        taker: &mut PixelCollector,
    ) {
        let Some(row) = self.image.row(y).get(columns.clone()) else {
            return;
        };
        let turn = (columns.start * COLUMN_SHIFT + y * ROW_SHIFT) % PERIOD;
        let [edge, flat] = self.places.for_row(turn);
        for (first, pixels) in (columns.start..)
            .step_by(WORD_BITS)
            .zip(row.chunks(WORD_BITS))
        {
            let close = column_bits(&near[0], first) | column_bits(&near[1], first);
            let mut marks =
                (edge & close | flat & !close) & column_bits(&(first..first + pixels.len()), first);
            let [left, down] = taker.relative_position(first, y);
            while marks != 0 {
                let k = marks.trailing_zeros() as usize;
                marks &= marks - 1;
                let Some(&value) = pixels.get(k) else { break };
                if self.clear || !self.is_pixel_hidden(first + k, y) {
                    taker.push(
                        [left + k as f32, down],
                        value,
                        self.shares[(turn + COLUMN_SHIFT * k) % PERIOD],
                    );
                }
            }
        }
    }

    fn is_pixel_hidden(&self, x: usize, y: usize) -> bool {
        let [x0, y0, x1, _] = self.area;
        self.masked
            .as_ref()
            .is_some_and(|m| m[(y - y0) * (x1 - x0 + 1) + x - x0])
            || self.hypothesis.excludes(&Vector2::new(x as f64, y as f64))
    }
}

/// Pixels of the frame that a fit must not use.
pub enum PixelExclusion<'a> {
    /// Pixels near these blobs, except for those of the hypothesis.
    Blobs(&'a [Blob]),
    /// Pixels near those that are darker, by a number of grey levels, than the light of a first fit with the same outline.
    /// They do not depend on the way in which the hypothesis was found.
    DarkerThan(MarkerParameters, f64),
}

/// Appearance of the edges of a hypothesis.
#[derive(Clone, Copy)]
pub struct EdgeAppearance {
    /// Crossing of the edges of quadrants, px.
    pub crossing: Vector2<f64>,
    pub blur: f64,
}

/// Selects the pixels of a hypothesis. Returns `None` if it lies outside the frame.
pub fn select_pixels(
    image: &Raster,
    masked: PixelExclusion,
    hypothesis: &Hypothesis,
    look: EdgeAppearance,
    budget: PixelBudget,
) -> Option<Pixels> {
    let blur = clamp_blur(look.blur);
    let ellipse = &hypothesis.ellipse;
    let bands = match hypothesis.edges {
        None => EdgeBands::for_disc(ellipse.minor, blur, budget.nearest),
        Some(_) => EdgeBands::from_blur(blur),
    };
    let area = frame_box(image, ellipse, f64::from(bands.flat) + 2.0)?;
    let masked = match masked {
        PixelExclusion::Blobs(blobs) => mask_foreign(blobs, hypothesis, area),
        PixelExclusion::DarkerThan(..) if hypothesis.edges.is_some() => None,
        PixelExclusion::DarkerThan(m, limit) => mask_darker(image, ellipse, bands, area, &m, limit),
    };
    let frame = EllipseFrame::new(ellipse);
    let edges = hypothesis.edges.map(|edges| EdgeLines {
        lines: edge_lines(edges, look.crossing),
        margin: end_margin(ellipse.minor, blur),
        along: Vector2::new(edges.along_rad.cos(), edges.along_rad.sin()),
    });
    let length = edges.map_or_else(
        || outline_length(ellipse),
        |e: EdgeLines| {
            e.lines
                .iter()
                .map(|l| 2.0 * ellipse.radius_along(Vector2::new(l.across.y, -l.across.x)))
                .sum::<f64>()
        },
    );
    let shares = PatternShare::new(budget, bands, length).weight_table();
    let clear = masked.is_none() && hypothesis.excluded.is_empty();
    let source = PixelSource {
        image,
        hypothesis,
        area,
        shares,
        places: PatternBits::new(&shares),
        masked,
        clear,
    };
    let mut taker = PixelCollector::new(EdgeGeometry {
        pattern: hypothesis.pattern,
        bands,
        ellipse,
        edges,
        frame: &frame,
        blur,
    });
    let strips = RowStrips::new(&frame, edges, bands, area);
    for y in area[1]..=area[3] {
        let Some((both, near)) = strips.columns(y as f64) else {
            continue;
        };
        for columns in both {
            source.take_row(y, columns, &near, &mut taker);
        }
    }
    Some(taker.finish())
}

/// Returns the box of the frame around an ellipse, extended by some px; `None` if it lies outside.
fn frame_box(image: &Raster, ellipse: &Ellipse, by: f64) -> Option<PixelBox> {
    let reach = ellipse.half_extent().add_scalar(by);
    let (low, high) = (ellipse.centre - reach, ellipse.centre + reach);
    let x0 = low.x.floor().max(0.0) as usize;
    let y0 = low.y.floor().max(0.0) as usize;
    let x1 = (high.x.ceil().max(0.0) as usize).min(image.width() - 1);
    let y1 = (high.y.ceil().max(0.0) as usize).min(image.height() - 1);
    (x0 <= x1 && y0 <= y1).then_some([x0, y0, x1, y1])
}

/// Ranges of columns in a row that may be used: two each, of all pixels and of those near an edge.
struct RowStrips {
    area: PixelBox,
    edges: Option<EdgeLines>,
    /// Extent of the flat background, and largest distance at which a pixel counts as one at the edge, px.
    flat: f64,
    near: f64,
    /// Rings around the outline of a disc: of all pixels, and of those near it.
    far: Ring,
    close: Ring,
    /// Rows of the pixels of quadrants.
    inside: Option<EllipseRows>,
}

type ColumnPair = [ColumnRange; 2];

impl RowStrips {
    fn new(
        frame: &EllipseFrame,
        edges: Option<EdgeLines>,
        bands: EdgeBands,
        area: PixelBox,
    ) -> Self {
        let flat = f64::from(bands.flat);
        let near = f64::from(bands.edge) + 0.5 * FADE_PX + 1.0;
        let ring = |by: f64| Ring::new(frame, -by, by);
        let inside = edges.and_then(|e: EdgeLines| frame.enlarged_rows(FADE_PX - e.margin));
        Self {
            area,
            edges,
            flat,
            near,
            far: ring(flat + 1.0),
            close: ring(near),
            inside,
        }
    }

    /// Returns the ranges of a row, of all pixels and of those near an edge; `None` if the row has none.
    fn columns(&self, y: f64) -> Option<(ColumnPair, ColumnPair)> {
        let Some(EdgeLines { lines, .. }) = self.edges else {
            let close = self.close.columns(y, self.area).unwrap_or([0..0, 0..0]);
            return Some((self.far.columns(y, self.area)?, close));
        };
        let (from, to) = row_interval(&self.inside, y)?;
        let parts = |reach: f64| {
            let [one, other] = lines.map(|l| {
                let part = l.row_interval(y, reach);
                columns_in_area(from.max(part.0), to.min(part.1), self.area)
            });
            let (first, second) = if one.start <= other.start {
                (one, other)
            } else {
                (other, one)
            };
            // Columns near both edges only once.
            let second = second.start.max(first.end)..second.end;
            [first, second]
        };
        Some((parts(self.flat + FADE_PX), parts(self.near)))
    }
}

/// Returns the length of an ellipse's outline by Ramanujan's formula, px.
fn outline_length(ellipse: &Ellipse) -> f64 {
    let (a, b) = (ellipse.major, ellipse.minor);
    std::f64::consts::PI * (3.0 * (a + b) - ((3.0 * a + b) * (a + 3.0 * b)).sqrt())
}

/// Returns the two edges through their crossing.
fn edge_lines(edges: EdgePair, crossing: Vector2<f64>) -> [EdgeLine; 2] {
    let half = edges.tangent.atan();
    [half, -half].map(|turn| {
        let (sin, cos) = (edges.along_rad + turn).sin_cos();
        EdgeLine {
            at: crossing,
            across: Vector2::new(-sin, cos),
        }
    })
}
