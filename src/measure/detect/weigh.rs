//! The weights of a fit's pixels, from their distances to an outline or to two edges.

use nalgebra::Vector2;

use super::super::raster::Raster;
use super::candidate::Outline;
use super::disc::from_ellipse;
use super::model::{LANES, Pixel, each};
use super::select::{Bands, FADE};
use super::wide::wide;

/// How far a geometry may still move, px.
const SLACK: f32 = 0.3;

/// A straight edge between quadrants: a point, and the direction across it.
#[derive(Clone, Copy)]
pub struct Line {
    pub at: Vector2<f64>,
    pub across: Vector2<f64>,
}

/// A pixel that may be used, and how much it would count.
pub struct Spot {
    pub x: usize,
    pub y: usize,
    pub keep: [f32; 2],
}

/// Tells how far pixels are from an outline, or from two edges that end a margin inside it.
pub struct Ruler<'a> {
    pub bands: Bands,
    pub outline: &'a Outline,
    pub edges: Option<([Line; 2], f64)>,
}

wide! {
    /// The pixels that have weight, or would if the geometry moved a little: it is not the last yet.
    pub fn weigh(image: &Raster, spots: &[Spot], ruler: &Ruler) -> Vec<Pixel> = weighed
}

#[inline(always)]
fn weighed(image: &Raster, spots: &[Spot], ruler: &Ruler) -> Vec<Pixel> {
    let Ruler { bands, outline, edges } = ruler;
    let (sin, cos) = outline.angle.sin_cos();
    let (a, b, centre) = (outline.major as f32, outline.minor as f32, outline.centre);
    let mut out = Vec::with_capacity(spots.len());
    for some in spots.chunks(LANES) {
        let of = |value: &dyn Fn(&Spot) -> f64| each(|i| some.get(i).map_or(0.0, |s| value(s) as f32));
        let (dx, dy) = (of(&|s| s.x as f64 - centre.x), of(&|s| s.y as f64 - centre.y));
        let (sin, cos) = (sin as f32, cos as f32);
        let s = each(|i| dx[i] * cos + dy[i] * sin);
        let t = each(|i| dy[i] * cos - dx[i] * sin);
        let mut keep = [
            each(|i| some.get(i).map_or(0.0, |s| s.keep[0])),
            each(|i| some.get(i).map_or(0.0, |s| s.keep[1])),
        ];
        let mut distance = from_ellipse(a, b, &s, &t);
        if let Some((lines, margin)) = edges {
            let rim = each(|i| {
                let share = (distance[i] - *margin as f32) / FADE as f32 + 0.5;
                let share = if share > 0.0 { share } else { 0.0 };
                if share < 1.0 { share } else { 1.0 }
            });
            keep = keep.map(|keep| each(|i| keep[i] * rim[i]));
            let [one, other] = lines.map(|l| {
                let off = (centre - l.at).dot(&l.across) as f32;
                let (u, v) = (l.across.x as f32, l.across.y as f32);
                each(|i| (off + dx[i] * u + dy[i] * v).abs())
            });
            distance = each(|i| if one[i] < other[i] { one[i] } else { other[i] });
        }
        let weight = each(|i| bands.weight([keep[0][i], keep[1][i]], distance[i]));
        let near = each(|i| bands.weight([keep[0][i], keep[1][i]], distance[i] - SLACK));
        for (i, spot) in some.iter().enumerate().filter(|&(i, _)| near[i] > 0.0) {
            out.push(Pixel {
                x: spot.x as f64,
                y: spot.y as f64,
                value: f64::from(image.row(spot.y)[spot.x]),
                p: f64::from(s[i]) / outline.major,
                q: f64::from(t[i]) / outline.minor,
                weight: f64::from(weight[i]),
                keep: [keep[0][i], keep[1][i]],
            });
        }
    }
    out
}
