//! Seams of the skin that meet a disc. A thin dark line that ends at the tip of a flat disc makes it look longer, by too
//! little in each pixel for the robust weights. Next to the disc, the complete line is visible.

use std::ops::Range;

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use super::region::OcclusionBand;
use crate::detect::appearance::parameters::{
    BLUR, EDGE_END_BLURS, LIGHT, MarkerParameters, WHITEST, light_at,
};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::image::scanline::{self, EllipseFrame};
use crate::detect::numbers::IMPROBABLE_SIGMAS;
use crate::detect::occlusion::options::SEAM;
use crate::detect::simd::lanes::{LANES, Lanes, all_lanes, each};
use crate::dispatch::wide;
use crate::ordering::sort_by_value;
use crate::raster::Raster;

/// Pixel of the ring: its position, px, and its darkness relative to the skin, in residual scales.
struct RingPixel {
    at: Vector2<f64>,
    darker: f32,
}

/// Returns the seams next to a disc as bands of the image. The image of the disc is described by `m`; `scale` is that of
/// its residuals, grey levels.
pub fn find_seams(
    image: &Raster,
    ellipse: &Ellipse,
    m: &MarkerParameters,
    scale: f64,
) -> Vec<OcclusionBand> {
    let ring = SeamRing::new(image, ellipse, m, scale);
    let mut signs = ring.dark_pixels();
    sort_by_value(&mut signs, |one| f64::from(-one.darker));
    let mut out = Vec::new();
    for _ in 0..=SEAM.max_seams {
        if out.len() == SEAM.max_seams {
            break;
        }
        let Some(line) = find_line(&signs) else { break };
        signs.retain(|s| line.distance_to(&s.at) > 2.0 * SEAM.half_width_px);
        if let Some(half) = half_width(&ring.ring_pixels_near_line(&line), &line) {
            let band = OcclusionBand {
                axis: line.across,
                from: line.at - half,
                to: line.at + half,
            };
            if ellipse.outline_fraction(|at| band.contains(at)) <= SEAM.max_hidden {
                out.push(band);
            }
        }
    }
    out
}

/// Ring around a disc, by rows.
struct SeamRing<'a> {
    image: &'a Raster,
    ellipse: &'a Ellipse,
    frame: EllipseFrame<'a>,
    m: &'a MarkerParameters,
    scale: f64,
    rows: Vec<(usize, [Range<usize>; 2])>,
}

impl<'a> SeamRing<'a> {
    fn new(image: &'a Raster, ellipse: &'a Ellipse, m: &'a MarkerParameters, scale: f64) -> Self {
        let reach = ellipse.half_extent().add_scalar(SEAM.reach_px + 1.0);
        let (low, high) = (ellipse.centre - reach, ellipse.centre + reach);
        let row = |v: f64| (v.max(0.0) as usize).min(image.height() - 1);
        let all = [0, 0, image.width() - 1, image.height() - 1];
        let frame = EllipseFrame::new(ellipse);
        let ring = scanline::Ring::new(&frame, EDGE_END_BLURS * m[BLUR], SEAM.reach_px);
        let rows =
            (row(low.y)..=row(high.y)).filter_map(|y| Some((y, ring.columns(y as f64, all)?)));
        let rows = rows.collect();
        Self {
            image,
            ellipse,
            frame,
            m,
            scale,
            rows,
        }
    }

    /// Returns the position of a pixel in semi-axes.
    fn normalized_position(&self, x: usize, y: usize) -> (f64, f64) {
        let (s, t) = self.frame.to_local(x as f64, y as f64);
        (s / self.ellipse.major, t / self.ellipse.minor)
    }

    fn ring_pixel(&self, x: usize, y: usize, value: u8) -> RingPixel {
        let (p, q) = self.normalized_position(x, y);
        let darker = ((light_at(self.m, p, q) - f64::from(value)) / self.scale) as f32;
        RingPixel {
            at: Vector2::new(x as f64, y as f64),
            darker,
        }
    }

    /// Returns the ring's pixels that are darker than the skin by `SEAM.sign_scales`.
    fn dark_pixels(&self) -> Vec<RingPixel> {
        let (mut out, mut some) = (Vec::new(), Vec::new());
        for (y, parts) in &self.rows {
            for part in parts {
                let Some(pixels) = self.image.row(*y).get(part.clone()) else {
                    continue;
                };
                find_dark(pixels, self.sign_limit(part.start, *y), &mut some);
                let spots = some
                    .drain(..)
                    .filter_map(|k| Some(self.ring_pixel(part.start + k, *y, *pixels.get(k)?)));
                out.extend(spots.filter(|s| s.darker > SEAM.sign_scales));
            }
        }
        out
    }

    /// Returns the grey value below which a pixel of a row may be a candidate, as a polynomial of its distance from `x`,
    /// px.
    fn sign_limit(&self, x: usize, y: usize) -> [f32; 3] {
        /// Possible rounding error in single precision, grey levels: for values below 256 and a few operations.
        const SAFE: f64 = 0.02;
        let [light, first, second] = self.skin_polynomial(x, y);
        [
            light - f64::from(SEAM.sign_scales) * self.scale + SAFE,
            first,
            second,
        ]
        .map(|v| v as f32)
    }

    /// Returns the grey value of the skin along a row, as a polynomial of the distance from `x`, px.
    fn skin_polynomial(&self, x: usize, y: usize) -> [f64; 3] {
        let m = self.m;
        let (p, q) = self.normalized_position(x, y);
        let (by_p, by_q) = (
            self.frame.cos / self.ellipse.major,
            -self.frame.sin / self.ellipse.minor,
        );
        [
            light_at(m, p, q),
            (m[LIGHT + 1] + 2.0 * m[LIGHT + 3] * p) * by_p + m[LIGHT + 2] * by_q,
            m[LIGHT + 3] * by_p * by_p,
        ]
    }

    fn ring_pixels_near_line(&self, line: &SeamLine) -> Vec<RingPixel> {
        let through = scanline::EdgeLine {
            at: line.across * line.at,
            across: line.across,
        };
        let mut out = Vec::new();
        for (y, parts) in &self.rows {
            let (from, to) = through.row_interval(*y as f64, SEAM.beside_px.end + 1.0);
            let (from, to) = (from.max(0.0) as usize, to.max(0.0) as usize);
            for part in parts {
                let near = part.start.max(from)..part.end.min(to.saturating_add(1));
                let pixels = self.image.row(*y).get(near.clone()).unwrap_or_default();
                out.extend(near.zip(pixels).map(|(x, &v)| self.ring_pixel(x, *y, v)));
            }
        }
        out
    }
}

/// Returns the darkness on a line relative to the skin next to it, and the darkness of that skin, in residual scales, from
/// the sums of a strip: sum and count, and next to the line also the sum of squares. `None` if the line is less dark than a
/// seam.
fn seam_contrast([sum, count]: [f64; 2], [other, others, squares]: [f64; 3]) -> Option<(f64, f64)> {
    if count < SEAM.min_signs as f64 || others < SEAM.min_signs as f64 {
        return None;
    }
    let skin = other / others;
    let noise = (squares / others - skin * skin)
        .max(SEAM.min_variance)
        .sqrt();
    let peak = sum / count - skin;
    let certain = peak > SEAM.darker_scales && peak * count.sqrt() > SEAM.significance * noise;
    certain.then_some((peak, skin))
}

wide! {
    /// Appends the indices of the pixels of a row below a polynomial of the position.
    fn find_dark(pixels: &[u8], below: [f32; 3], out: &mut Vec<usize>) = find_dark_pixels_generic
}

#[inline(always)]
fn find_dark_pixels_generic(pixels: &[u8], below: [f32; 3], out: &mut Vec<usize>) {
    let [c, b, a] = below;
    for (k, some) in pixels.chunks(LANES).enumerate() {
        let first = (k * LANES) as f32;
        let mut grey = Lanes::splat(WHITEST);
        for (grey, &v) in grey.iter_mut().zip(some) {
            *grey = f32::from(v);
        }
        let over = each(|i| {
            let x = first + i as f32;
            grey[i] - (c + (b + a * x) * x)
        });
        if !all_lanes(|i| over[i] >= 0.0) {
            out.extend(
                (0..some.len())
                    .filter(|&i| over[i] < 0.0)
                    .map(|i| k * LANES + i),
            );
        }
    }
}

/// Straight line: the points whose product with the unit vector `across` is `at`, px.
#[derive(Clone, Copy)]
struct SeamLine {
    across: Vector2<f64>,
    at: f64,
}

impl SeamLine {
    fn distance_to(&self, at: &Vector2<f64>) -> f64 {
        (self.across.dot(at) - self.at).abs()
    }
}

/// Returns the line on which most of the darkest candidates lie. The candidates are sorted, darkest first.
fn find_line(signs: &[RingPixel]) -> Option<SeamLine> {
    if signs.len() < SEAM.min_signs {
        return None;
    }
    let few: Vec<&Vector2<f64>> = signs.iter().take(SEAM.max_signs).map(|s| &s.at).collect();
    let origin = *few.first()?;
    let mut places = [[f32::MAX; SEAM.max_signs]; 2];
    for (k, at) in few.iter().enumerate() {
        (places[0][k], places[1][k]) = ((at.x - origin.x) as f32, (at.y - origin.y) as f32);
    }
    let [i, j] = best_pair(&places, few.len())?;
    let along = few.get(j)?.to_owned() - few.get(i)?.to_owned();
    let across = Vector2::new(-along.y, along.x).normalize();
    let mut line = SeamLine {
        across,
        at: across.dot(few.get(i)?),
    };
    for _ in 0..2 {
        line = fit_line(
            signs
                .iter()
                .map(|s| &s.at)
                .filter(|at| line.distance_to(at) < SEAM.half_width_px),
        )?;
    }
    (signs
        .iter()
        .filter(|s| line.distance_to(&s.at) < SEAM.half_width_px)
        .count()
        >= SEAM.min_signs)
        .then_some(line)
}

/// Columns and rows of the candidates, px from the first; unused entries are far away.
type SignPositions = [[f32; SEAM.max_signs]; 2];

wide! {
    /// Returns the two of the first `count` positions whose line passes the largest number of positions.
    fn best_pair(places: &SignPositions, count: usize) -> Option<[usize; 2]> = best_line_pair_generic
}

#[inline(always)]
fn best_line_pair_generic([x, y]: &SignPositions, count: usize) -> Option<[usize; 2]> {
    let (mut best, mut most) = (None, 0);
    for i in 0..count {
        for j in i + 1..count {
            let (u, v) = (x[j] - x[i], y[j] - y[i]);
            let square = u * u + v * v;
            // Limit of the squared product of the distance from the line and the length of the pair.
            let reach = (SEAM.half_width_px * SEAM.half_width_px) as f32 * square;
            let is_near = |k: usize| {
                let off = (x[k] - x[i]) * v - (y[k] - y[i]) * u;
                u32::from(off * off < reach)
            };
            let near: u32 = (0..SEAM.max_signs).map(is_near).sum();
            if square >= (SEAM.apart_px * SEAM.apart_px) as f32 && near > most {
                (best, most) = (Some([i, j]), near);
            }
        }
    }
    best
}

/// Returns the least-squares line through points.
fn fit_line<'a>(points: impl Iterator<Item = &'a Vector2<f64>> + Clone) -> Option<SeamLine> {
    let count = points.clone().count() as f64;
    if count < 2.0 {
        return None;
    }
    let mean = points.clone().sum::<Vector2<f64>>() / count;
    let scatter: Matrix2<f64> = points.map(|at| (at - mean) * (at - mean).transpose()).sum();
    let eigen = SymmetricEigen::new(scatter);
    let across = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    Some(SeamLine {
        across,
        at: across.dot(&mean),
    })
}

/// Returns half the width of the dark strip along a line, px, if it is a seam: darker than the skin next to it, over its
/// full length.
fn half_width(spots: &[RingPixel], line: &SeamLine) -> Option<f64> {
    let along = Vector2::new(-line.across.y, line.across.x);
    let mut profile = [[0.0f64; 2]; SEAM.bins];
    let mut nearby = [0.0f64; 3];
    let mut pieces: Vec<(i32, [f64; 2])> = Vec::new();
    for spot in spots {
        let (distance, darker) = (line.distance_to(&spot.at), f64::from(spot.darker));
        if let Some(bin) = profile.get_mut((distance / SEAM.bin_px) as usize) {
            bin[0] += darker;
            bin[1] += 1.0;
        }
        if SEAM.beside_px.contains(&distance) {
            let darker = darker.clamp(-IMPROBABLE_SIGMAS, IMPROBABLE_SIGMAS);
            nearby = [
                nearby[0] + darker,
                nearby[1] + 1.0,
                nearby[2] + darker * darker,
            ];
        }
        if distance < 1.0 {
            let piece = (along.dot(&spot.at) / SEAM.piece_px).floor() as i32;
            match pieces.iter_mut().find(|(k, _)| *k == piece) {
                Some((_, sum)) => *sum = [sum[0] + darker, sum[1] + 1.0],
                None => pieces.push((piece, [darker, 1.0])),
            }
        }
    }
    let (sum, count) = (profile[0][0] + profile[1][0], profile[0][1] + profile[1][1]);
    let (peak, skin) = seam_contrast([sum, count], nearby)?;
    let dark = pieces
        .iter()
        .filter(|(_, [sum, count])| sum / count - skin > SEAM.dark_piece * peak)
        .count();
    let certain = pieces.len() >= SEAM.pieces && dark as f64 >= SEAM.unbroken * pieces.len() as f64;
    let ended = |&[sum, count]: &[f64; 2]| count > 0.0 && sum / count - skin < SEAM.ended * peak;
    let half = (profile.iter().position(ended)? as f64 + 0.5) * SEAM.bin_px;
    // At least half a pixel to both sides, blurred; blur darkens another pixel beyond the apparent end.
    certain.then_some(half.max(1.0) + 1.0)
}
