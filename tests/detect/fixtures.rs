//! Promise: on the bundled frames every marker is found, named correctly and measured with the specified
//! precision, in every light, with consistent standard deviations.

use std::path::Path;

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::installation::{self, Installation};
use wingd::measure::identify::{self, WingView};
use wingd::measure::raster::Raster;
use wingd::measure::setup::{Orientation, Shape};
use wingd::measure::view::{FrameMarkers, FrameView};
use wingd::pipeline::decode::decode_image;
use wingd::pipeline::stages::{ProcessedFrame, detect_only};

/// True position of a marker in one frame.
struct Truth {
    id: String,
    shape: Shape,
    pixel: [f64; 2],
    visible: bool,
}

struct Frame {
    name: String,
    light: String,
    markers: Vec<Truth>,
}

struct Set {
    installation: Installation,
    orientation: Orientation,
    frames: Vec<(Frame, ProcessedFrame, Raster)>,
}

/// Errors of one kind of marker in one kind of light.
#[derive(Default)]
struct Tally {
    errors_px: Vec<f64>,
    normalised: Vec<f64>,
}

impl Tally {
    fn add(&mut self, off: [f64; 2], sigma: [f64; 2]) {
        self.errors_px.push(off[0].hypot(off[1]));
        self.normalised
            .extend([off[0] / sigma[0], off[1] / sigma[1]]);
    }

    fn extend(&mut self, other: &Self) {
        self.errors_px.extend(&other.errors_px);
        self.normalised.extend(&other.normalised);
    }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn truth(root: &Path) -> Vec<Frame> {
    let text = std::fs::read_to_string(root.join("truth.json")).unwrap();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let marker = |m: &serde_json::Value| Truth {
        id: m["id"].as_str().unwrap().into(),
        shape: if m["shape"] == "quadrant" {
            Shape::Quadrant
        } else {
            Shape::Circle
        },
        pixel: ["u", "v"].map(|k| m[k].as_f64().unwrap_or(f64::NAN)),
        visible: m["visible"].as_bool().unwrap(),
    };
    // The independent set names its lights in its README, in the order of the frames.
    const LIGHTS: [&str; 6] = ["plain", "plain", "gradient", "shadow", "glare", "dusk"];
    let frame = |(k, f): (usize, &serde_json::Value)| Frame {
        name: f["image"].as_str().unwrap().into(),
        light: f["light"].as_str().unwrap_or_else(|| LIGHTS[k]).into(),
        markers: f["markers"]
            .as_array()
            .unwrap()
            .iter()
            .map(marker)
            .collect(),
    };
    value["frames"]
        .as_array()
        .unwrap()
        .iter()
        .enumerate()
        .map(frame)
        .collect()
}

/// Detects the frames of a set after a change of their bytes.
fn set(name: &str, seen: impl Fn(Vec<u8>, u64) -> Vec<u8>) -> Set {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures")
        .join(name);
    let installation = installation::load_without_orientation(&root.join("installation")).unwrap();
    let frames: Vec<(Frame, ProcessedFrame, Raster)> = (truth(&root).into_iter())
        .zip(0..)
        .map(|(frame, seed)| {
            let bytes = seen(
                std::fs::read(root.join("frames").join(&frame.name)).unwrap(),
                seed,
            );
            let (processed, raster) = detect_only(&frame.name, &bytes, None);
            (frame, processed, raster.unwrap())
        })
        .collect();
    let ground = (frames.iter()).filter(|(f, ..)| f.name.starts_with("ground"));
    let ground: Vec<_> = ground
        .map(|(_, s, _)| s.detections.markers.clone())
        .collect();
    let orientation = identify::estimate_orientation(&installation.setup, &ground)
        .unwrap()
        .orientation;
    Set {
        installation,
        orientation,
        frames,
    }
}

/// Compares a set's figures with the promised ones, relaxed by `worse_by`; returns the number of missed
/// markers, and the rms of circles in plain light, px.
fn assert_promised(name: &str, mut set: Set, worse_by: f64) -> (usize, f64) {
    let (mut seen, mut missed, mut extra, mut wrong) = (0, 0, 0, 0);
    let (mut plain, mut worse) = (
        [Tally::default(), Tally::default()],
        [Tally::default(), Tally::default()],
    );
    for (frame, processed, raster) in &mut set.frames {
        let visible = frame.markers.iter().filter(|m| m.visible).count();
        let near = |at: &[f64; 2]| {
            frame
                .markers
                .iter()
                .any(|m| m.visible && (m.pixel[0] - at[0]).hypot(m.pixel[1] - at[1]) < 5.0)
        };
        let places: Vec<[f64; 2]> = processed
            .detections
            .markers
            .iter()
            .map(|d| [d.centre_px.x, d.centre_px.y])
            .collect();
        extra += places.iter().filter(|p| !near(p)).count();
        let wing = WingView::in_flight(&set.installation.setup, &set.orientation);
        let named =
            FrameView::new(&wing, &mut &*raster, &mut |_| ()).name(processed.detections.clone());
        let FrameMarkers {
            detections,
            identities,
            fault,
            ..
        } = named;
        assert_eq!(fault, None, "{}", frame.name);
        let light = if frame.light == "plain" {
            &mut plain
        } else {
            &mut worse
        };
        let identities = identities.unwrap();
        let mut found = 0;
        for (d, marker) in detections.markers.iter().zip(&identities.marker_of) {
            let Some(marker) = marker.and_then(|j| set.installation.setup.markers.get(j)) else {
                continue;
            };
            let truth = frame.markers.iter().find(|m| m.id == marker.id).unwrap();
            let off = [
                d.centre_px.x - truth.pixel[0],
                d.centre_px.y - truth.pixel[1],
            ];
            let sigma = [0, 1].map(|k| d.covariance_px2[(k, k)].sqrt());
            // One partly covered by glare may be named if its position is consistent with its standard deviation.
            let is_there = (off[0] / sigma[0]).hypot(off[1] / sigma[1]) < 3.0;
            if truth.visible && off[0].hypot(off[1]) < 5.0 {
                found += 1;
                light[usize::from(truth.shape == Shape::Circle)].add(off, sigma);
            } else if truth.visible || !is_there {
                wrong += 1;
            }
        }
        seen += visible;
        missed += visible - found;
    }
    let mut all = Tally::default();
    plain.iter().chain(&worse).for_each(|t| all.extend(t));
    let [plain_quadrants, plain_circles] = [&plain[0], &plain[1]].map(|t| rms(&t.errors_px));
    let [quadrants, circles] = [&worse[0], &worse[1]].map(|t| rms(&t.errors_px));
    let (middle, normalised) = (median(&all.errors_px), rms(&all.normalised));
    println!(
        "{name}: missed {missed} of {seen}, wrong {wrong}, extra {extra}; median {middle:.3} px, \
         quadrants {plain_quadrants:.3} (other light {quadrants:.3}), circles {plain_circles:.3} ({circles:.3}), \
         normalised {normalised:.2}"
    );
    assert_eq!(wrong, 0, "{name}: markers named that are not there");
    assert!(100 * missed <= seen, "{name}: {missed} of {seen} missed");
    assert!(
        2 * extra <= set.frames.len(),
        "{name}: {extra} extra detections"
    );
    assert!(middle <= worse_by * 0.04, "{name}: median {middle} px");
    assert!(
        plain_quadrants <= worse_by * 0.10 && quadrants <= 0.20,
        "{name}: quadrants {plain_quadrants} {quadrants} px"
    );
    assert!(
        plain_circles <= worse_by * 0.15 && circles <= 0.30,
        "{name}: circles {plain_circles} {circles} px"
    );
    assert!(
        (0.8..=1.25).contains(&normalised),
        "{name}: normalised errors {normalised}"
    );
    (missed, plain_circles)
}

#[test]
fn the_independent_set_is_measured_as_promised() {
    let (missed, circles) = assert_promised("dev", set("dev", |bytes, _| bytes), 1.0);
    // The decal of M20 covers half of M18, and most of it in the ground frame: with known size it is still
    // measured. Otherwise it is missed there and has an error of 0.3 px in flight, which makes 0.13 px of all circles.
    assert!(
        missed == 0 && circles < 0.1,
        "{missed} missed, {circles} px"
    );
}

#[test]
fn the_flight_of_the_demo_is_measured_as_promised() {
    let _ = assert_promised("demo", set("demo", |bytes, _| bytes), 1.0);
}

/// Degradation of a frame: additional blur, px, motion along rows, px, noise, grey levels, and JPEG.
struct Degradation {
    blur: f64,
    motion: usize,
    noise: f64,
    quality: u8,
}

impl Degradation {
    fn apply(&self, bytes: &[u8], seed: u64) -> Vec<u8> {
        let frame = decode_image(bytes, None).unwrap();
        let (width, height) = (frame.width(), frame.height());
        let light: Vec<f32> = (0..=255u8)
            .map(|v| (f32::from(v) / 255.0).powf(2.2))
            .collect();
        let mut image: Vec<f32> = frame
            .luma()
            .iter()
            .map(|&v| light[usize::from(v)])
            .collect();
        let normal = |k: isize| (-0.5 * (k as f64 / self.blur.max(1e-3)).powi(2)).exp() as f32;
        let focus: Vec<f32> = (-8..=8).map(normal).collect();
        let motion = vec![1.0; self.motion.max(1)];
        for weights in [&focus, &motion] {
            image = filter_rows(&image, width, weights);
        }
        // Columns are filtered as rows of the transposed image.
        let turned = |image: &[f32], width: usize, height: usize| -> Vec<f32> {
            (0..width * height)
                .map(|i| image[(i % height) * width + i / height])
                .collect()
        };
        let columns = filter_rows(&turned(&image, width, height), height, &focus);
        let image = turned(&columns, height, width);
        let mut random = StdRng::seed_from_u64(seed);
        let noise: Vec<f32> = (0..1 << 16)
            .map(|_| {
                (0..12)
                    .map(|_| random.random_range(-0.5f32..0.5))
                    .sum::<f32>()
                    * self.noise as f32
            })
            .collect();
        let grey = |v: &f32| {
            v.max(0.0).powf(1.0 / 2.2) * 255.0 + noise[usize::from(random.random::<u16>())]
        };
        let grey: Vec<u8> = image
            .iter()
            .map(grey)
            .map(|v| v.round().clamp(0.0, 255.0) as u8)
            .collect();
        let mut out = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut out, self.quality);
        encoder
            .encode(
                &grey,
                width as u16,
                height as u16,
                jpeg_encoder::ColorType::Luma,
            )
            .unwrap();
        out
    }
}

/// Filters rows; the filter is truncated at their ends.
fn filter_rows(image: &[f32], width: usize, weights: &[f32]) -> Vec<f32> {
    let (half, total) = (weights.len() / 2, weights.iter().sum::<f32>());
    let mut out = vec![0.0; image.len()];
    for (row, out) in image.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        for (k, weight) in weights.iter().enumerate().filter(|(_, w)| **w > 1e-6) {
            let (to, from) = (half.saturating_sub(k), k.saturating_sub(half));
            let share = weight / total;
            out[to..]
                .iter_mut()
                .zip(&row[from..])
                .for_each(|(out, v)| *out += share * v);
        }
    }
    out
}

fn assert_promised_degraded(name: &str, worse: Degradation) {
    assert_promised(
        name,
        set("dev", |bytes, seed| worse.apply(&bytes, seed)),
        2.0,
    );
}

#[test]
fn the_independent_set_out_of_focus_is_measured_as_promised() {
    assert_promised_degraded(
        "dev, blurred",
        Degradation {
            blur: 1.8,
            motion: 1,
            noise: 0.0,
            quality: 92,
        },
    );
}

#[test]
fn the_independent_set_in_motion_is_measured_as_promised() {
    assert_promised_degraded(
        "dev, moved",
        Degradation {
            blur: 0.0,
            motion: 5,
            noise: 1.0,
            quality: 90,
        },
    );
}

#[test]
fn the_independent_set_with_noise_and_jpeg_is_measured_as_promised() {
    assert_promised_degraded(
        "dev, noisy",
        Degradation {
            blur: 0.0,
            motion: 1,
            noise: 5.0,
            quality: 60,
        },
    );
}

#[test]
fn the_independent_set_with_all_of_that_is_measured_as_promised() {
    assert_promised_degraded(
        "dev, all",
        Degradation {
            blur: 1.8,
            motion: 1,
            noise: 5.0,
            quality: 60,
        },
    );
}
