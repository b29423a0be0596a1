//! A flight in time swings in gusts, and its last frame is followed by the first.

use nalgebra::{Rotation3, Vector3};

use super::writer::SetFrame;
use super::{Args as Simulate, hidden};
use crate::cli::Failure;
use crate::measure::render::{Light, Random, Scene};

/// Gusts: about how often a second they swing, Hz. A short gust, the wing's first bending, and a patch of rough air.
const GUSTS_HZ: [f64; 3] = [0.17, 0.6, 1.9];
/// How far the fuel's relief swings with the fastest of them, as a share of itself: the weights' inertia answers a gust in
/// its own time.
const RELIEF: f64 = 0.1;
/// The mounting walks by its drift in this time, s.
const WALK_S: f64 = 60.0;

/// A flight in time
#[derive(clap::Args)]
#[command(next_help_heading = "Flight in gusts")]
pub struct Args {
    /// Render so many seconds in gusts; level lift is the first of --tip-lifts, and the last frame is followed by the
    /// first, so that a replay may go on
    #[arg(long = "gusts", value_name = "SECONDS")]
    pub seconds: Option<f64>,
    /// Frames a second
    #[arg(long, default_value_t = 10.0, value_name = "HZ", requires = "seconds")]
    rate_hz: f64,
    /// Lift of each of three gusts, m
    #[arg(long, default_value_t = 0.15, value_name = "M", requires = "seconds")]
    gust: f64,
}

impl Args {
    pub fn check(&self) -> Result<(), Failure> {
        let wrong = |what: &str| Err(Failure::Usage(what.into()));
        match self.seconds {
            Some(seconds) if !(seconds > 0.0 && seconds <= 3600.0) => {
                wrong("--gusts: give seconds, more than 0 and at most 3600")
            }
            _ if !(self.rate_hz > 0.0 && self.rate_hz <= 100.0) => wrong("--rate-hz: give 0.1 to 100"),
            _ if !(0.0..=2.0).contains(&self.gust) => wrong("--gust: give 0 to 2 m"),
            _ => Ok(()),
        }
    }

    /// What gusts add to the level lift at most, m.
    pub fn highest_m(&self) -> f64 {
        self.seconds.map_or(0.0, |_| self.gust * GUSTS_HZ.len() as f64)
    }
}

/// A gust that swings a whole number of times in the flight.
struct Gust {
    hz: f64,
    phase: f64,
}

impl Gust {
    fn at(&self, time_s: f64) -> f64 {
        (std::f64::consts::TAU * self.hz * time_s + self.phase).sin()
    }
}

/// The ground frame, and the flight's frames in one light.
pub(super) fn shots(args: &Simulate, scene: &Scene, seconds: f64) -> Vec<SetFrame> {
    let mut random = Random::new(args.seed, 21);
    let mut mount = Rotation3::identity();
    let quality = args.picture.quality;
    let gusts = GUSTS_HZ.map(|hz| Gust {
        hz: (hz * seconds).round().max(1.0) / seconds,
        phase: random.between(0.0, std::f64::consts::TAU),
    });
    let (rate_hz, gust_m) = (args.gusts.rate_hz, args.gusts.gust);
    let level_m = args.tip_lifts.first().copied().unwrap_or(2.0);
    let light = args.lights.first().copied().unwrap_or(Light::Plain);
    let count = (seconds * rate_hz).round().max(1.0) as u64;
    let digits = count.to_string().len();
    let seed = |i: u64| args.seed.wrapping_mul(1_000_000).wrapping_add(i);
    let hidden = hidden(&mut random, args.hide, scene.markers.len());
    let ground = args.picture.applied(scene.ground_shot(seed(0)));
    let mut frames = vec![SetFrame { image: "ground.jpg".into(), shot: ground, quality, time_s: None }];
    let walk = scene.setup.uncertainty.mount_drift_rad * (1.0 / (rate_hz * WALK_S)).sqrt();
    for i in 0..count {
        let time_s = i as f64 / rate_hz;
        if args.remount.is_some_and(|first| i + 1 == first as u64) {
            mount = scene.remount(&mut random);
        }
        let step = Vector3::from_fn(|_, _| walk * random.normal());
        mount = Rotation3::from_scaled_axis(step) * mount;
        let swing: f64 = gusts.iter().map(|gust| gust_m * gust.at(time_s)).sum();
        let mut shot = args.picture.applied(scene.flight_shot(level_m + swing, light, seed(i + 1)));
        shot.light_seed = seed(1);
        shot.state.load.relief *= 1.0 + RELIEF * gusts[2].at(time_s + 0.1);
        shot.mount = mount;
        shot.hidden = hidden.clone();
        let image = format!("flight-{:0digits$}.jpg", i + 1);
        frames.push(SetFrame { image, shot, quality, time_s: Some(time_s) });
    }
    frames
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        simulate: Simulate,
    }

    #[test]
    fn a_flight_swings_about_its_level_and_closes() {
        let words =
            "wingd --output o --gusts 20 --rate-hz 50 --tip-lifts 2 --gust 0.1 --side left --markers 8";
        let args = Cli::try_parse_from(words.split(' ')).unwrap_or_else(|e| e.exit()).simulate;
        args.gusts.check().unwrap_or_else(|_| unreachable!());
        let scene = crate::cli::simulate::scene(&args).unwrap_or_else(|_| unreachable!());
        let flight = shots(&args, &scene, 20.0).split_off(1);
        assert_eq!((flight.len(), flight[50].time_s), (1000, Some(1.0)));
        let lifts: Vec<f64> = flight.iter().map(|f| f.shot.state.tip_lift_m).collect();
        let mean = lifts.iter().sum::<f64>() / 1000.0;
        let scatter = (lifts.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / 1000.0).sqrt();
        // Three sines over whole periods.
        assert!(
            (mean - 2.0).abs() < 1e-9 && (scatter - 0.1 * 1.5_f64.sqrt()).abs() < 1e-9,
            "{mean} {scatter}"
        );
        let fastest = 0.1 * std::f64::consts::TAU * GUSTS_HZ.iter().sum::<f64>() * 1.1 / 50.0;
        let steps = (0..1000).map(|i| (lifts[(i + 1) % 1000] - lifts[i]).abs());
        assert!(steps.fold(0.0, f64::max) < fastest, "the last frame is followed by the first");
        assert!(flight.iter().all(|f| f.shot.light_seed == flight[0].shot.light_seed));
        assert!(flight.windows(2).all(|pair| pair[0].shot.seed != pair[1].shot.seed));
    }
}
