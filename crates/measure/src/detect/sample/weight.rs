//! Weights of the pixels of a fit, from their distances to an outline or to two edges.

use nalgebra::Vector2;

use super::bands::{EdgeBands, fade_weight};
use super::pixels::{PixelKind, Pixels, Sorter};
use crate::detect::appearance::disc::{END_SIGMAS, distance_to_ellipse, mask_beyond_end};
use crate::detect::appearance::{crossing::NEAR_SIGMAS, parameters::MarkerPattern};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::image::scanline::{EdgeLine, EllipseFrame};
use crate::detect::simd::batch::Batch;
use crate::detect::simd::lanes::{LANES, Lanes, each};
use crate::dispatch::wide;

/// Distance by which ends and crossing may move before a pixel is of another kind than it was sorted by, px.
const MOVE_PX: f32 = 0.2;

/// Two edges that end a margin inside the outline, px, and a unit vector along their bisector.
#[derive(Clone, Copy)]
pub struct EdgeLines {
    pub lines: [EdgeLine; 2],
    pub margin: f64,
    pub along: Vector2<f64>,
}

/// Geometry from which the distance of pixels from an outline or from two edges, and their kind, are computed.
pub struct EdgeGeometry<'a> {
    pub pattern: MarkerPattern,
    pub bands: EdgeBands,
    pub ellipse: &'a Ellipse,
    pub edges: Option<EdgeLines>,
    /// Coordinates of the outline.
    pub frame: &'a EllipseFrame<'a>,
    pub blur: f64,
}

/// Pixels whose weight has not been computed yet; `keep` holds their factors at an edge and next to it, 0 to 1.
struct PendingPixels {
    batch: Batch,
    keep: [Lanes; 2],
}

/// Collects pixels, weights them and sorts those with a weight into batches.
pub struct PixelCollector<'a> {
    ruler: EdgeGeometry<'a>,
    origin: [f64; 2],
    waiting: PendingPixels,
    sorter: Sorter,
}

impl<'a> PixelCollector<'a> {
    /// Creates a collector without pixels.
    pub fn new(ruler: EdgeGeometry<'a>) -> Self {
        let centre = ruler.edges.map_or(ruler.ellipse.centre, |e| e.lines[0].at);
        let origin = [centre.x.round(), centre.y.round()];
        let sorter = Sorter::new(ruler.pattern, origin);
        Self {
            ruler,
            origin,
            waiting: PendingPixels {
                batch: Batch::new(),
                keep: [Lanes::splat(0.0); 2],
            },
            sorter,
        }
    }

    /// Returns column and row of a pixel relative to the origin of the pixels.
    pub fn relative_position(&self, x: usize, y: usize) -> [f32; 2] {
        [x as f64 - self.origin[0], y as f64 - self.origin[1]].map(|v| v as f32)
    }

    /// Adds a pixel with its factors at an edge and next to it.
    #[inline(always)]
    pub fn push(&mut self, [x, y]: [f32; 2], value: u8, keep: [f32; 2]) {
        let PendingPixels {
            batch,
            keep: of_batch,
        } = &mut self.waiting;
        let i = batch.len % LANES;
        (of_batch[0][i], of_batch[1][i]) = (keep[0], keep[1]);
        batch.push(x, y, f32::from(value));
        if batch.is_full() {
            weigh_batch(
                &mut self.waiting,
                &mut self.sorter,
                &self.ruler,
                self.origin,
            );
            self.waiting.batch.len = 0;
        }
    }

    /// Returns the pixels that have a weight.
    pub fn finish(mut self) -> Pixels {
        if self.waiting.batch.len > 0 {
            self.waiting.batch.fill_lanes();
            weigh_batch(
                &mut self.waiting,
                &mut self.sorter,
                &self.ruler,
                self.origin,
            );
        }
        self.sorter.finish()
    }
}

wide! {
    /// Weights the pixels of a batch and sorts those that count.
    fn weigh_batch(waiting: &mut PendingPixels, sorter: &mut Sorter, ruler: &EdgeGeometry, origin: [f64; 2])
        = weigh_batch_generic
}

#[inline(always)]
fn weigh_batch_generic(
    waiting: &mut PendingPixels,
    sorter: &mut Sorter,
    ruler: &EdgeGeometry,
    origin: [f64; 2],
) {
    let PendingPixels { batch, keep } = waiting;
    let EdgeGeometry {
        bands,
        ellipse,
        edges,
        ..
    } = ruler;
    let (sin, cos) = (ruler.frame.sin as f32, ruler.frame.cos as f32);
    let (a, b, centre) = (ellipse.major as f32, ellipse.minor as f32, ellipse.centre);
    let (cx, cy) = ((centre.x - origin[0]) as f32, (centre.y - origin[1]) as f32);
    let (dx, dy) = (each(|i| batch.x[i] - cx), each(|i| batch.y[i] - cy));
    let s = each(|i| dx[i] * cos + dy[i] * sin);
    let t = each(|i| dy[i] * cos - dx[i] * sin);
    let (by_a, by_b) = (1.0 / a, 1.0 / b);
    batch.p = each(|i| s[i] * by_a);
    batch.q = each(|i| t[i] * by_b);
    let mut distance = distance_to_ellipse(a, b, &s, &t);
    let blur = ruler.blur as f32;
    let integrated;
    let mut nothing = Lanes::splat(0.0);
    if let Some(EdgeLines {
        lines,
        margin,
        along,
    }) = edges
    {
        let inside = each(|i| fade_weight(distance[i] - *margin as f32));
        for keep in &mut *keep {
            *keep = each(|i| keep[i] * inside[i]);
        }
        let [mut one, mut other] = [Lanes::splat(0.0); 2];
        for (distance, l) in [&mut one, &mut other].into_iter().zip(lines) {
            let off = (centre - l.at).dot(&l.across) as f32;
            let (u, v) = (l.across.x as f32, l.across.y as f32);
            *distance = each(|i| (off + dx[i] * u + dy[i] * v).abs());
        }
        distance = each(|i| if one[i] < other[i] { one[i] } else { other[i] });
        let off = (centre - lines[0].at).dot(along) as f32;
        let (u, v) = (along.x as f32, along.y as f32);
        let near = NEAR_SIGMAS as f32 * blur + MOVE_PX;
        integrated = each(|i| {
            if (off + dx[i] * u + dy[i] * v).abs() < near {
                1.0
            } else {
                0.0
            }
        });
    } else {
        let end = a - END_SIGMAS as f32 * blur - MOVE_PX;
        integrated = each(|i| if s[i].abs() > end { 1.0 } else { 0.0 });
        nothing = mask_beyond_end(&s, &t, [a, b], 0.0, END_SIGMAS as f32 * blur + MOVE_PX);
    }
    batch.root = each(|i| bands.weight([keep[0][i], keep[1][i]], distance[i]).sqrt());
    for i in (0..batch.len).filter(|&i| batch.root[i] > 0.0) {
        let kind = match () {
            () if nothing[i] > 0.0 => PixelKind::Outside,
            () if integrated[i] > 0.0 => PixelKind::Integrated,
            () => PixelKind::ClosedForm,
        };
        sorter.push(kind, batch, i);
    }
}
