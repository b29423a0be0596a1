//! Small patch of the image: values at its corners, and interpolation between them.

use nalgebra::Vector3;

use super::clutter::{NearbyClutter, PixelFootprint, SkinClutter};
use super::light::SkinLight;
use super::markers::MarkerDisc;
use super::trace::{Hit, HitRates};
use super::wing::DeformedWing;

/// Side of a tile, px. Directions within it are bilinear to 1e-4 px.
pub const TILE: usize = 8;

/// Values of one ray.
#[derive(Clone, Copy)]
pub struct TileCorner {
    /// Direction of the ray, wing frame, not of unit length.
    pub direction: Vector3<f64>,
    /// Intersection with the skin.
    pub hit: Option<Hit>,
    /// Light at the intersection.
    pub lit: SkinLight,
    /// Reflectance of the paint at the intersection.
    pub paint: f64,
    /// Radiance of the sky in this direction.
    pub sky: f64,
}

/// Patch of the image being filled: its corners' values (as in [`TileCorner`]), row by row.
pub struct Tile<'a> {
    pub hits: [Option<Hit>; 4],
    pub directions: [Vector3<f64>; 4],
    pub diffuse: [f64; 4],
    pub added: [f64; 4],
    pub paint: [f64; 4],
    pub sky: [f64; 4],
    /// Markers that may reach into the tile.
    pub markers: Vec<&'a MarkerDisc>,
}

impl<'a> Tile<'a> {
    /// Creates a tile from its corners, row by row.
    pub fn new(corners: [&TileCorner; 4], markers: Vec<&'a MarkerDisc>) -> Self {
        Self {
            hits: corners.map(|corner| corner.hit),
            directions: corners.map(|corner| corner.direction),
            diffuse: corners.map(|corner| corner.lit.diffuse),
            added: corners.map(|corner| corner.lit.added),
            paint: corners.map(|corner| corner.paint),
            sky: corners.map(|corner| corner.sky),
            markers,
        }
    }

    /// Returns the mean light of the corners on the skin.
    pub fn mean_lit(&self) -> SkinLight {
        let mut sum = SkinLight::default();
        let mut count = 0.0;
        for i in (0..4).filter(|&i| self.hits[i].is_some()) {
            sum = SkinLight {
                diffuse: sum.diffuse + self.diffuse[i],
                added: sum.added + self.added[i],
            };
            count += 1.0;
        }
        let count = f64::max(count, 1.0);
        SkinLight {
            diffuse: sum.diffuse / count,
            added: sum.added / count,
        }
    }

    /// Returns the direction of the ray at (`x`, `y`) px from the first corner.
    pub fn ray_direction(&self, x: f64, y: f64) -> Vector3<f64> {
        let [a, b, c, d] = &self.directions;
        let (p, q) = (x / TILE as f64, y / TILE as f64);
        let (top, bottom) = (a + (b - a) * p, c + (d - c) * p);
        top + (bottom - top) * q
    }
}

/// Interpolates between the values of the corners; `x` and `y` in px from the first.
pub fn interpolate_bilinear([a, b, c, d]: &[f64; 4], x: f64, y: f64) -> f64 {
    let (p, q) = (x / TILE as f64, y / TILE as f64);
    let (top, bottom) = (a + (b - a) * p, c + (d - c) * p);
    top + (bottom - top) * q
}

/// Skin within a tile.
pub struct Patch {
    /// Arc length at the corners, m.
    pub s: [f64; 4],
    pub footprint: PixelFootprint,
    /// Largest distance of a point of a pixel from its centre, with a margin.
    pub half_pixel_m: f64,
    /// Largest distance of a ray's hit from the bilinear guess along the wing.
    pub reach_m: f64,
    /// Rates of the hit along a ray.
    pub rates: HitRates,
    /// Clutter near the tile.
    pub near: NearbyClutter,
}

impl Patch {
    /// Creates the patch; `None` if the corners are not on one sheet of the skin.
    pub fn new(
        pose: &DeformedWing,
        clutter: &SkinClutter,
        tile: &Tile,
        hits: [Hit; 4],
    ) -> Option<Self> {
        let [a, b, c, d] = hits;
        let n = 2.0 * TILE as f64;
        let (su, sv) = (
            (b.s - a.s + d.s - c.s).abs() / n,
            (c.s - a.s + d.s - b.s).abs() / n,
        );
        let (zu, zv) = (
            (b.z - a.z + d.z - c.z).abs() / n,
            (c.z - a.z + d.z - b.z).abs() / n,
        );
        let range = |value: fn(&Hit) -> f64| {
            let values = hits.map(|hit| value(&hit));
            values
                .into_iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
                    (l.min(v), h.max(v))
                })
        };
        let (s, z) = (range(|hit| hit.s), range(|hit| hit.z));
        // A sheet is nearly flat over a tile: opposite sides are equally long.
        let spans_sheets = (b.s + c.s - a.s - d.s).abs() > 0.3 * (s.1 - s.0) + 0.01;
        if spans_sheets {
            return None;
        }
        let footprint = PixelFootprint {
            s: su + sv,
            z: zu + zv,
        };
        Some(Self {
            s: hits.map(|hit| hit.s),
            half_pixel_m: 1.3 * 0.5 * (su.hypot(zu) + sv.hypot(zv)),
            reach_m: 0.5 * (s.1 - s.0) + 0.01,
            rates: pose.hit_rates(a.s, &tile.directions[0])?,
            near: clutter.select_nearby(&pose.wing, s, z, &footprint),
            footprint,
        })
    }
}

/// Returns the pixel coordinate of a tile's edge.
pub fn tile_edge(index: usize) -> f64 {
    (index * TILE) as f64 - 0.5
}
