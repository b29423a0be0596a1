//! Radiance of every pixel: tiles of rays, sampled finely at edges.

use nalgebra::{Rotation3, Vector2, Vector3};
use rayon::prelude::*;

use super::clutter::SkinClutter;
use super::light::{Illumination, SkinLight};
use super::markers::MarkerDisc;
use super::tile::{Patch, TILE, Tile, TileCorner, interpolate_bilinear, tile_edge};
use super::trace::Hit;
use super::wing::DeformedWing;
use wingd_measure::geometry::Lens;

/// Samples of a pixel with an edge of a marker: a lattice of Fibonacci numbers.
const FINE: (usize, usize) = (233, 144);
/// Samples of a pixel at the wing's outline.
const COARSE: (usize, usize) = (13, 8);

/// Scene of one frame.
pub struct RenderView<'a> {
    pub pose: &'a DeformedWing,
    pub lens: &'a Lens,
    /// Attitude of the camera.
    pub wing_from_camera: Rotation3<f64>,
    /// Visible markers.
    pub markers: &'a [MarkerDisc],
    pub clutter: &'a SkinClutter,
    pub light: &'a Illumination,
}

/// Marker with the box of its image, px.
struct BoxedMarker<'a> {
    marker: &'a MarkerDisc,
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl RenderView<'_> {
    /// Returns the radiance row by row; 1 saturates.
    pub fn radiance(&self) -> Vec<f32> {
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let corners: Vec<Vec<TileCorner>> = (0..=rows)
            .into_par_iter()
            .map(|j| {
                (0..=columns)
                    .map(|i| self.trace_tile_corner(tile_edge(i), tile_edge(j)))
                    .collect()
            })
            .collect();
        let boxes = self.marker_bounding_boxes();
        let mut radiance = vec![0.0f32; width * height];
        radiance
            .par_chunks_mut(TILE * width)
            .enumerate()
            .for_each(|(j, band)| {
                for i in 0..columns {
                    let (above, below) = (&corners[j], &corners[j + 1]);
                    let corners = [&above[i], &above[i + 1], &below[i], &below[i + 1]];
                    let tile = Tile::new(
                        corners,
                        markers_touching_tile(&boxes, tile_edge(i), tile_edge(j)),
                    );
                    self.fill_tile(&tile, band, width, i);
                }
            });
        radiance
    }

    fn pixel_direction(&self, u: f64, v: f64) -> Vector3<f64> {
        let pixel = Vector2::new(u, v);
        let pinhole = || {
            Vector2::new(
                (u - self.lens.cx) / self.lens.fx,
                (v - self.lens.cy) / self.lens.fy,
            )
        };
        let n = self.lens.undistort(&pixel).unwrap_or_else(|_| pinhole());
        self.wing_from_camera * Vector3::new(n.x, n.y, 1.0)
    }

    fn trace_tile_corner(&self, u: f64, v: f64) -> TileCorner {
        let direction = self.pixel_direction(u, v);
        let hit = self.pose.first_hit(&direction);
        let lit = hit.map_or(SkinLight::default(), |hit| {
            self.light.light_at(self.pose, &hit)
        });
        let paint = hit.map_or(0.0, |hit| self.clutter.paint_reflectance(hit.s, hit.z));
        TileCorner {
            direction,
            hit,
            lit,
            paint,
            sky: self.light.sky(&direction),
        }
    }

    fn marker_bounding_boxes(&self) -> Vec<BoxedMarker<'_>> {
        let camera_from_wing = self.wing_from_camera.inverse();
        let boxed = |marker| outline_box(marker, &camera_from_wing, self.lens);
        self.markers
            .iter()
            .filter_map(|marker| boxed(marker).map(|(low, high)| BoxedMarker { marker, low, high }))
            .collect()
    }

    fn fill_tile(&self, tile: &Tile, band: &mut [f32], width: usize, column: usize) {
        if tile.markers.iter().any(|m| m.plate_m.is_some()) {
            return self.fill_plates(tile, band, width, column);
        }
        let patch = match tile.hits {
            [None, None, None, None] => None,
            [Some(a), Some(b), Some(c), Some(d)] => {
                Patch::new(self.pose, self.clutter, tile, [a, b, c, d])
            }
            _ => return self.fill_outline(tile, band, width, column),
        };
        if tile.hits[0].is_some() && patch.is_none() {
            return self.fill_outline(tile, band, width, column);
        }
        fill_pixels(band, width, column, |x, y| match &patch {
            None => interpolate_bilinear(&tile.sky, x, y),
            Some(patch) => self.skin_radiance_at(tile, patch, x, y),
        });
    }

    /// Fills a tile with the wing's outline or a crest: ray by ray, with fine sampling at differences.
    fn fill_outline(&self, tile: &Tile, band: &mut [f32], width: usize, column: usize) {
        let sheets: Vec<Option<Hit>> = (0..(TILE + 1) * (TILE + 1))
            .map(|i| {
                self.pose.first_hit(
                    &tile.ray_direction((i % (TILE + 1)) as f64, (i / (TILE + 1)) as f64),
                )
            })
            .collect();
        let lit = tile.mean_lit();
        fill_pixels(band, width, column, |x, y| {
            let corner = y as usize * (TILE + 1) + x as usize;
            let around = [0, 1, TILE + 1, TILE + 2].map(|k| sheets[corner + k]);
            let lattice = match (tile.markers.is_empty(), spans_sheets(&around)) {
                (false, _) => FINE,
                (true, true) => COARSE,
                (true, false) => (1, 1),
            };
            lattice_mean(lattice, |dx, dy| {
                self.ray_radiance(tile, &lit, x + dx, y + dy)
            })
        });
    }

    /// Fills a tile with plates in front of everything else, in the light of the wing's root.
    fn fill_plates(&self, tile: &Tile, band: &mut [f32], width: usize, column: usize) {
        let lit = tile.mean_lit();
        let on_plates = self.light.light_at(self.pose, &Hit { s: 0.0, z: 0.0 });
        let plates: Vec<&MarkerDisc> = tile
            .markers
            .iter()
            .filter(|m| m.plate_m.is_some())
            .copied()
            .collect();
        let ray = |x: f64, y: f64| {
            let direction = tile.ray_direction(x, y);
            let plate = plates
                .iter()
                .find_map(|m| m.plate_reflectance(m.pattern_point(&direction)));
            plate.map_or_else(
                || self.ray_radiance(tile, &lit, x, y),
                |r| r * on_plates.diffuse + on_plates.added,
            )
        };
        fill_pixels(band, width, column, |x, y| {
            let direction = tile.ray_direction(x, y);
            let pixel = |m: &&&MarkerDisc| m.centre_m.norm() / self.lens.fx;
            let edge =
                |m: &&MarkerDisc| m.plate_edge_within(m.pattern_point(&direction), pixel(&m));
            let inside =
                |m: &&MarkerDisc| m.plate_reflectance(m.pattern_point(&direction)).is_some();
            if plates.iter().any(|m| inside(m) && !edge(m)) {
                return ray(x, y);
            }
            lattice_mean(
                if plates.iter().any(edge) {
                    FINE
                } else {
                    COARSE
                },
                |dx, dy| ray(x + dx, y + dy),
            )
        });
    }

    /// Returns the radiance of one ray.
    fn ray_radiance(&self, tile: &Tile, lit: &SkinLight, x: f64, y: f64) -> f64 {
        let direction = tile.ray_direction(x, y);
        let Some(hit) = self.pose.first_hit(&direction) else {
            return interpolate_bilinear(&tile.sky, x, y);
        };
        let printed = tile
            .markers
            .iter()
            .filter(|m| m.covers(hit.s))
            .find_map(|m| m.reflectance(m.pattern_point(&direction)));
        let reflectance = printed.unwrap_or_else(|| self.clutter.paint_reflectance(hit.s, hit.z));
        reflectance * lit.diffuse + lit.added
    }

    fn skin_radiance_at(&self, tile: &Tile, patch: &Patch, x: f64, y: f64) -> f64 {
        let direction = tile.ray_direction(x, y);
        let guess = interpolate_bilinear(&patch.s, x, y);
        let Some(hit) = self
            .pose
            .near_hit(guess, &patch.rates, patch.reach_m, &direction)
        else {
            let lit = tile.mean_lit();
            return lattice_mean(COARSE, |dx, dy| {
                self.ray_radiance(tile, &lit, x + dx, y + dy)
            });
        };
        let clutter = self.clutter.reflectance_factor(
            &patch.near,
            &self.pose.wing,
            hit.s,
            hit.z,
            &patch.footprint,
        );
        let paint = interpolate_bilinear(&tile.paint, x, y) * clutter;
        let reflectance = tile
            .markers
            .iter()
            .filter(|m| m.covers(hit.s))
            .fold(paint, |below, m| {
                print_reflectance(m, below, tile, patch, x, y)
            });
        reflectance * interpolate_bilinear(&tile.diffuse, x, y)
            + interpolate_bilinear(&tile.added, x, y)
    }
}

/// Returns true if the rays meet different sheets of skin, or some of them none.
fn spans_sheets(hits: &[Option<Hit>; 4]) -> bool {
    match hits {
        [None, None, None, None] => false,
        [Some(a), Some(b), Some(c), Some(d)] => (b.s + c.s - a.s - d.s).abs() > 0.5,
        _ => true,
    }
}

/// Returns the reflectance of a pixel of a marker over the paint `below`.
fn print_reflectance(
    marker: &MarkerDisc,
    below: f64,
    tile: &Tile,
    patch: &Patch,
    x: f64,
    y: f64,
) -> f64 {
    let at = |x: f64, y: f64| marker.pattern_point(&tile.ray_direction(x, y));
    let centre = at(x, y);
    if !marker.edge_within(centre, patch.half_pixel_m) {
        return marker.reflectance(centre).unwrap_or(below);
    }
    lattice_mean(FINE, |dx, dy| {
        marker.reflectance(at(x + dx, y + dy)).unwrap_or(below)
    })
}

/// Averages over a pixel by a rank-1 lattice, whose projections are even in every direction.
fn lattice_mean((count, generator): (usize, usize), value: impl Fn(f64, f64) -> f64) -> f64 {
    let n = count as f64;
    let place = |i: usize| (i as f64 + 0.5) / n - 0.5;
    (0..count)
        .map(|i| value(place(i), place(i * generator % count)))
        .sum::<f64>()
        / n
}

/// Calls `value` with every pixel's centre, in px from the tile's corner.
fn fill_pixels(band: &mut [f32], width: usize, column: usize, value: impl Fn(f64, f64) -> f64) {
    let (start, end) = (column * TILE, (column * TILE + TILE).min(width));
    for (y, row) in band.chunks_mut(width).enumerate() {
        for (x, pixel) in row[start..end].iter_mut().enumerate() {
            *pixel = value(x as f64 + 0.5, y as f64 + 0.5) as f32;
        }
    }
}

fn markers_touching_tile<'a>(boxes: &[BoxedMarker<'a>], u: f64, v: f64) -> Vec<&'a MarkerDisc> {
    let size = TILE as f64 + 2.0;
    let near = |b: &&BoxedMarker<'a>| {
        b.high.x > u - 2.0 && b.low.x < u + size && b.high.y > v - 2.0 && b.low.y < v + size
    };
    boxes.iter().filter(near).map(|b| b.marker).collect()
}

/// Returns the box of a marker's image, px; `None` if part of it is behind the camera.
pub fn outline_box(
    marker: &MarkerDisc,
    camera_from_wing: &Rotation3<f64>,
    lens: &Lens,
) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let mut low = Vector2::repeat(f64::INFINITY);
    let mut high = Vector2::repeat(f64::NEG_INFINITY);
    for point in marker.outline(72).chain(marker.plate_corners()) {
        let pixel = lens.project(&(camera_from_wing * point))?;
        (low, high) = (low.inf(&pixel), high.sup(&pixel));
    }
    Some((low, high))
}

#[cfg(test)]
mod tests {
    use super::super::light::Light;
    use super::super::random::SeededRandom;
    use super::super::{Scene, SceneOptions, SceneShot, SceneSide};
    use super::*;
    use wingd_measure::setup::Shape;

    const PAINT: f64 = 0.5;

    fn scene() -> Scene {
        let mut options = SceneOptions::random(5, SceneSide::Left);
        options.lens = Lens {
            k1: -0.06,
            k2: 0.05,
            ..Lens::pinhole(1600, 1200, 3200.0, 803.0, 597.0)
        };
        let mut scene = Scene::random(5, &options);
        scene.clutter = SkinClutter::bare(PAINT);
        scene
    }

    /// Radiance with the given markers over radiance without any.
    fn reflectance(scene: &Scene, shot: &SceneShot, markers: &[MarkerDisc]) -> Vec<f64> {
        let pose = scene.wing.deform(&shot.state);
        let light = Illumination::random(Light::Plain, &mut SeededRandom::new(1, 1), &pose);
        let wing_from_camera = scene.camera_from_wing(shot).inverse();
        let view = |markers| RenderView {
            pose: &pose,
            lens: &scene.setup.lens,
            wing_from_camera,
            markers,
            clutter: &scene.clutter,
            light: &light,
        };
        let (with, without) = (view(markers).radiance(), view(&[]).radiance());
        with.iter()
            .zip(&without)
            .map(|(a, b)| f64::from(*a) / f64::from(*b) - 1.0)
            .collect()
    }

    /// Area and first moments of a polygon (signed).
    fn moments(polygon: &[Vector2<f64>]) -> [f64; 3] {
        let mut sums = [0.0; 3];
        for (i, a) in polygon.iter().enumerate() {
            let b = polygon[(i + 1) % polygon.len()];
            let cross = a.x * b.y - b.x * a.y;
            sums[0] += cross / 2.0;
            sums[1] += cross * (a.x + b.x) / 6.0;
            sums[2] += cross * (a.y + b.y) / 6.0;
        }
        sums
    }

    /// Projected sectors of the outline, each with the sign of its print.
    fn expected(scene: &Scene, shot: &SceneShot, placed: &MarkerDisc, shape: Shape) -> [f64; 3] {
        let camera_from_wing = scene.camera_from_wing(shot);
        let project = |p: Vector3<f64>| scene.setup.lens.project(&(camera_from_wing * p)).unwrap();
        // Edges follow the curved skin: polar coordinates of each sector's outline.
        let polar = |share: f64, angle: f64| {
            project(placed.surface_point(
                &(Vector2::new(angle.cos(), angle.sin()) * (share * placed.radius_m)),
            ))
        };
        let steps = || (0..500).map(|i| f64::from(i) / 500.0);
        let mut sums = [0.0; 3];
        for quarter in 0..4 {
            let turn = |share: f64| (f64::from(quarter) + share) * std::f64::consts::FRAC_PI_2;
            let mut sector: Vec<_> = steps().map(|r| polar(r, turn(0.0))).collect();
            sector.extend(steps().map(|q| polar(1.0, turn(q))));
            sector.extend(steps().map(|r| polar(1.0 - r, turn(1.0))));
            let white = shape == Shape::Quadrant && quarter % 2 == 0;
            let weight = if white { 0.82 } else { 0.045 } / PAINT - 1.0;
            let part = moments(&sector);
            let sign = weight * part[0].signum();
            (0..3).for_each(|k| sums[k] += sign * part[k]);
        }
        sums
    }

    #[test]
    fn markers_are_rendered_at_their_true_positions() {
        let scene = scene();
        for shot in [
            scene.ground_shot(1),
            scene.flight_shot(2.0, Light::Plain, 2),
        ] {
            let pose = scene.wing.deform(&shot.state);
            for (marker, placed) in scene
                .markers
                .iter()
                .zip(scene.marker_discs(&pose, &[]))
                .step_by(3)
            {
                let image = reflectance(&scene, &shot, std::slice::from_ref(&placed));
                let mut rendered = [0.0; 3];
                for (i, value) in image.iter().enumerate() {
                    let (x, y) = ((i % 1600) as f64, (i / 1600) as f64);
                    [1.0, x, y]
                        .iter()
                        .zip(&mut rendered)
                        .for_each(|(m, sum)| *sum += m * value);
                }
                let expected = expected(&scene, &shot, &placed, marker.shape);
                // Displacement of the marker that corresponds to the first moments.
                let pixel = scene
                    .truth(&shot)
                    .markers
                    .iter()
                    .find(|m| m.id == marker.id)
                    .unwrap()
                    .pixel
                    .unwrap();
                let area = std::f64::consts::PI
                    * scene
                        .marker_image(&shot, &pose, &placed)
                        .1
                        .fold(0.25, |product, side| product * side);
                let off = |k: usize| {
                    let about = |sums: &[f64; 3]| sums[k] - pixel[k - 1] * sums[0];
                    (about(&rendered) - about(&expected)) / area
                };
                assert!(
                    off(1).abs() < 0.005 && off(2).abs() < 0.005,
                    "{} {} {}",
                    marker.id,
                    off(1),
                    off(2)
                );
            }
        }
    }
}
