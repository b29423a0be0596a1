//! Which pixels a fit uses, and how much: along the outline, or along the edges between the quadrants.
//!
//! Weights fall to zero smoothly with the distance from the outline, and where not all pixels are
//! needed, the share that is used changes smoothly with the marker's size. So the choice, and with it
//! the answer, hardly depends on how the geometry it follows was reached.

use nalgebra::Vector2;

use super::bands::{EdgeBands, FADE_PX, clamp_blur};
use super::foreign::{mask_darker, mask_foreign};
use super::pixels::Pixels;
use super::weight::{EdgeLines, EdgeGeometry, PixelCollector};
use crate::detect::appearance::parameters::MarkerParameters;
use crate::detect::hypothesis::{EdgePair, Hypothesis};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::image::scanline::{EllipseFrame, EdgeLine, PixelBox, Ring, EllipseRows, columns, row_of};
use crate::detect::segment::{bitmask::WORD_BITS, blob::Blob};
use crate::raster::Raster;

/// About how many pixels are wanted: at the edges, where they tell the place, and beside them, where
/// they only tell the levels.
#[derive(Clone, Copy)]
pub struct PixelBudget {
    pub edge: f64,
    pub flat: f64,
    /// Share of the flat ground that is used about the thinnest disc. What lies on the skin is as foreshortened as the
    /// disc: light that is a plane about a thick one is none about a thin one.
    pub nearest: f64,
}

/// Pixels of a fit: more would only cost time.
pub const FINAL: PixelBudget = PixelBudget { edge: 450.0, flat: 550.0, nearest: 0.55 };
/// Enough for the geometry that the pixels of the last stage are chosen by.
pub const COARSE: PixelBudget = PixelBudget { edge: 130.0, flat: 70.0, nearest: 1.0 };
/// All that there are, where much of the outline is hidden.
pub const UNLIMITED: PixelBudget = PixelBudget { edge: 1e9, flat: 1e9, nearest: 0.55 };
/// Length from which on an edge's pixels are not all used, px.
const LONG_EDGE_PX: f64 = 150.0;
/// Share of the flat pixels that is wanted about the longest.
const MIN_FLAT_SHARE: f64 = 0.5;
/// Band of a sharp edge, px.
const SHARP_BAND_PX: f64 = 1.5;

/// How far from quadrants' rim pixels are used at least and at most, blurs. At 1.5 there is 7 % of skin mixed in, on opposite
/// sides alike, so that the crossing stays. Thick ones have edges enough farther in.
const END_MARGIN: (f64, f64) = (1.5, 2.5);
/// Semi-minor axes, blurs, from where on it grows, and to where on by one blur.
const END_THICK: (f64, f64) = (10.0, 25.0);
/// Share of the semi-minor axis, and px, that it is at most and at least.
const END_PART: (f64, f64) = (0.45, 1.0);

/// That margin, px, of quadrants of some thickness, px.
fn end_margin(minor: f64, blur: f64) -> f64 {
    let by = (minor / blur - END_THICK.0) / (END_THICK.1 - END_THICK.0);
    let margin = (END_MARGIN.0 + by).clamp(END_MARGIN.0, END_MARGIN.1) * blur;
    margin.min(END_PART.0 * minor).max(END_PART.1)
}

/// Pixels of a pattern: shares of pixels are told to a sixteenth of one of them.
const PERIOD: usize = 16;
/// By how much it is shifted from column to column: prime to the period, so that each place comes once, far from the last.
const COLUMN_SHIFT: usize = 5;
/// The same from row to row.
const ROW_SHIFT: usize = 7;

/// Of a pattern's pixels, how many are used.
#[derive(Clone, Copy)]
struct PatternShare {
    edge: f64,
    flat: f64,
}

impl PatternShare {
    /// For an edge of some length, px, seen on both sides.
    fn new(wanted: PixelBudget, bands: EdgeBands, length: f64) -> Self {
        let (edge, flat) = (f64::from(bands.edge), f64::from(bands.flat));
        // A blurred edge spreads what it tells over more pixels.
        let more = (edge / SHARP_BAND_PX).max(1.0);
        let share = |wanted: f64, width: f64| {
            PERIOD as f64 * (more * wanted / (2.0 * width * length).max(1.0)).min(1.0)
        };
        // Where an edge is long, there is enough of it to know the levels less well.
        let levels = wanted.flat * (LONG_EDGE_PX / length.max(1.0)).clamp(MIN_FLAT_SHARE, 1.0);
        Self { edge: share(wanted.edge, edge), flat: share(levels, flat - edge) }
    }

    /// How much a pixel would count at the edge and beside it, for each place in the pattern.
    fn weight_table(self) -> [[f32; 2]; PERIOD] {
        std::array::from_fn(|turn| {
            [self.edge, self.flat].map(|keep| (keep - turn as f64).clamp(0.0, 1.0) as f32)
        })
    }
}

/// A bit for each of a word's pixels in a row that begins with the pattern: whether it counts near an edge, and whether
/// beside it.
#[derive(Clone, Copy)]
struct PatternBits([u64; 2]);

impl PatternBits {
    fn new(shares: &[[f32; 2]; PERIOD]) -> Self {
        /// The pattern's bits, repeated in a word.
        const EVERY: u64 = u64::MAX / ((1 << PERIOD) - 1);
        let bits = |counts: fn(&[f32; 2]) -> bool| -> u64 {
            (0..PERIOD).map(|k| u64::from(counts(&shares[COLUMN_SHIFT * k % PERIOD])) << k).sum()
        };
        Self([bits(|[edge, flat]| edge.max(*flat) > 0.0), bits(|[_, flat]| *flat > 0.0)].map(|b| b * EVERY))
    }

    /// In a row that begins at another turn of the pattern.
    fn rotated(self, turn: usize) -> [u64; 2] {
        /// So many columns make one turn: `ACROSS` times it is one more than a multiple of `PERIOD`.
        const ONE: usize = 13;
        self.0.map(|bits| bits.rotate_right((ONE * turn % PERIOD) as u32))
    }
}

/// The bits of the pixels of a word from `first` on that lie in some columns.
fn column_bits(columns: &ColumnRange, first: usize) -> u64 {
    // All bits from a place on; a shift by all of them leaves none.
    let from = |x: usize| u64::MAX.checked_shl(x.saturating_sub(first) as u32).unwrap_or(0);
    from(columns.start) & !from(columns.end)
}

type ColumnRange = std::ops::Range<usize>;

/// The pixels of a frame that may be used, and those of them that are not.
struct PixelSource<'a> {
    image: &'a Raster,
    hypothesis: &'a Hypothesis,
    area: PixelBox,
    /// How much a pixel counts, by its place in the pattern; and which do.
    shares: [[f32; 2]; PERIOD],
    places: PatternBits,
    masked: Option<Vec<bool>>,
    /// Whether all pixels may be used.
    clear: bool,
}

impl PixelSource<'_> {
    /// Takes the columns of a row that may count, of which some are near an edge.
    fn take_row(&self, y: usize, columns: ColumnRange, near: &[ColumnRange; 2], taker: &mut PixelCollector) {
        let Some(row) = self.image.row(y).get(columns.clone()) else { return };
        let turn = (columns.start * COLUMN_SHIFT + y * ROW_SHIFT) % PERIOD;
        let [edge, flat] = self.places.rotated(turn);
        for (first, pixels) in (columns.start..).step_by(WORD_BITS).zip(row.chunks(WORD_BITS)) {
            let close = column_bits(&near[0], first) | column_bits(&near[1], first);
            let mut marks = (edge & close | flat & !close) & column_bits(&(first..first + pixels.len()), first);
            let [left, down] = taker.relative_position(first, y);
            while marks != 0 {
                let k = marks.trailing_zeros() as usize;
                marks &= marks - 1;
                let Some(&value) = pixels.get(k) else { break };
                if self.clear || !self.is_hidden(first + k, y) {
                    taker.push([left + k as f32, down], value, self.shares[(turn + COLUMN_SHIFT * k) % PERIOD]);
                }
            }
        }
    }

    fn is_hidden(&self, x: usize, y: usize) -> bool {
        let [x0, y0, x1, _] = self.area;
        self.masked.as_ref().is_some_and(|m| m[(y - y0) * (x1 - x0 + 1) + x - x0])
            || self.hypothesis.hides(&Vector2::new(x as f64, y as f64))
    }
}

/// What of the frame a fit must not use.
pub enum PixelExclusion<'a> {
    /// Near these blobs, where they are not the hypothesis's.
    Blobs(&'a [Blob]),
    /// Near pixels that are darker than the light of a first fit with the same outline, by so many grey
    /// levels. These do not depend on how the hypothesis was found.
    DarkerThan(MarkerParameters, f64),
}

/// How a hypothesis's edges look.
#[derive(Clone, Copy)]
pub struct EdgeAppearance {
    /// Where quadrants' edges cross, px.
    pub crossing: Vector2<f64>,
    /// Blur, px.
    pub blur: f64,
    /// A disc's sag, px.
    pub sag: f64,
}

/// The pixels for a hypothesis; `None` where it lies outside the frame.
pub fn select_pixels(
    image: &Raster,
    masked: PixelExclusion,
    hypothesis: &Hypothesis,
    look: EdgeAppearance,
    wanted: PixelBudget,
) -> Option<Pixels> {
    let blur = clamp_blur(look.blur);
    let ellipse = &hypothesis.ellipse;
    let bands = match hypothesis.edges {
        None => EdgeBands::for_disc(ellipse.minor, blur, wanted.nearest),
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
            e.lines.iter().map(|l| 2.0 * ellipse.radius(Vector2::new(l.across.y, -l.across.x))).sum::<f64>()
        },
    );
    let shares = PatternShare::new(wanted, bands, length).weight_table();
    let clear = masked.is_none() && hypothesis.excluded.is_empty();
    let source = PixelSource { image, hypothesis, area, shares, places: PatternBits::new(&shares), masked, clear };
    let mut taker = PixelCollector::new(EdgeGeometry {
        pattern: hypothesis.pattern,
        bands,
        ellipse,
        edges,
        frame: &frame,
        blur,
        sag: look.sag,
    });
    let strips = RowStrips::new(&frame, edges, bands, area);
    for y in area[1]..=area[3] {
        let Some((both, near)) = strips.columns(y as f64) else { continue };
        for columns in both {
            source.take_row(y, columns, &near, &mut taker);
        }
    }
    Some(taker.finish())
}

/// The part of the frame about an ellipse, grown by some px; `None` where it lies outside.
fn frame_box(image: &Raster, ellipse: &Ellipse, by: f64) -> Option<PixelBox> {
    let reach = ellipse.extent().add_scalar(by);
    let (low, high) = (ellipse.centre - reach, ellipse.centre + reach);
    let x0 = low.x.floor().max(0.0) as usize;
    let y0 = low.y.floor().max(0.0) as usize;
    let x1 = (high.x.ceil().max(0.0) as usize).min(image.width() - 1);
    let y1 = (high.y.ceil().max(0.0) as usize).min(image.height() - 1);
    (x0 <= x1 && y0 <= y1).then_some([x0, y0, x1, y1])
}

/// Where in a row pixels may count: two stretches each, of all of them and of those near an edge.
struct RowStrips {
    area: PixelBox,
    edges: Option<EdgeLines>,
    /// How far the flat ground reaches, and how far from an edge a pixel may count as one at it, px.
    flat: f64,
    near: f64,
    /// About a disc's outline, outside and inside of it: of all, and near it.
    far: Ring,
    close: Ring,
    /// Where quadrants' pixels end.
    inside: Option<EllipseRows>,
}

type ColumnPair = [ColumnRange; 2];

impl RowStrips {
    fn new(frame: &EllipseFrame, edges: Option<EdgeLines>, bands: EdgeBands, area: PixelBox) -> Self {
        let flat = f64::from(bands.flat);
        let near = f64::from(bands.edge) + 0.5 * FADE_PX + 1.0;
        let ring = |by: f64| Ring::new(frame, -by, by);
        let inside = edges.and_then(|e: EdgeLines| frame.grown(FADE_PX - e.margin));
        Self { area, edges, flat, near, far: ring(flat + 1.0), close: ring(near), inside }
    }

    /// Of a row; `None` where it is not met.
    fn columns(&self, y: f64) -> Option<(ColumnPair, ColumnPair)> {
        let Some(EdgeLines { lines, .. }) = self.edges else {
            let close = self.close.columns(y, self.area).unwrap_or([0..0, 0..0]);
            return Some((self.far.columns(y, self.area)?, close));
        };
        let (from, to) = row_of(&self.inside, y)?;
        let parts = |reach: f64| {
            let [one, other] = lines.map(|l| {
                let part = l.row(y, reach);
                columns(from.max(part.0), to.min(part.1), self.area)
            });
            let (first, second) = if one.start <= other.start { (one, other) } else { (other, one) };
            // Where both edges are near, once.
            let second = second.start.max(first.end)..second.end;
            [first, second]
        };
        Some((parts(self.flat + FADE_PX), parts(self.near)))
    }
}

/// Length of an ellipse's outline, px, by Ramanujan's formula.
fn outline_length(ellipse: &Ellipse) -> f64 {
    let (a, b) = (ellipse.major, ellipse.minor);
    std::f64::consts::PI * (3.0 * (a + b) - ((3.0 * a + b) * (a + 3.0 * b)).sqrt())
}

/// The two edges through their crossing.
fn edge_lines(edges: EdgePair, crossing: Vector2<f64>) -> [EdgeLine; 2] {
    let half = edges.tangent.atan();
    [half, -half].map(|turn| {
        let (sin, cos) = (edges.along_rad + turn).sin_cos();
        EdgeLine { at: crossing, across: Vector2::new(-sin, cos) }
    })
}
