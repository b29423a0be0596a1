//! Simulated flight in gusts as a time series; its last frame is followed by the first.

use nalgebra::{Rotation3, Vector3};

use super::writer::{FlightMoment, SetFrame};
use super::{InvalidValue, SimulateArgs as Simulate, choose_hidden};
use crate::cli::Failure;
use crate::measure::render::{Light, Scene, SeededRandom};
use crate::measure::setup::Width;

/// Frequencies of the gusts, Hz, rounded to whole periods: a short gust, the wing's first bending mode, a patch of rough
/// air.
const GUSTS_HZ: [f64; 3] = [0.17, 0.6, 1.9];
/// Relative variation of the fuel's bending relief with the fastest gust: the inertia of the fuel responds with its own
/// phase.
const RELIEF_VARIATION: f64 = 0.1;
/// Time in which the mounting drifts by its standard deviation, s.
const MOUNT_WALK_TIME_S: f64 = 60.0;

/// Options of a flight in gusts
#[derive(clap::Args)]
#[command(next_help_heading = "Flight in gusts")]
pub struct GustArgs {
    /// Render a flight of this duration in gusts; its mean deflection is the first of --tip-deflections, and the last frame
    /// is followed by the first, so that a replay can repeat it
    #[arg(long = "gusts", value_name = "SECONDS")]
    pub seconds: Option<f64>,
    /// Frames per second
    #[arg(long, default_value_t = 10.0, value_name = "HZ", requires = "seconds")]
    rate_hz: f64,
    /// Amplitude of the tip deflection of each of 3 gusts, m
    #[arg(long, default_value_t = 0.15, value_name = "M", requires = "seconds")]
    gust: f64,
    /// One or two bending modes excited at random by rough air: frequency, damping ratio, rms of the tip deflection. They
    /// do not end as they began
    #[arg(long, value_delimiter = ',', value_name = "HZ:DAMPING:RMS_M", requires = "seconds", value_parser = BendingMode::parse)]
    modes: Vec<BendingMode>,
}

/// A bending mode of the wing.
#[derive(Clone, Copy, Debug, PartialEq)]
struct BendingMode {
    hz: f64,
    damping: f64,
    rms_m: f64,
}

/// Maximum amplitude of a random vibration relative to its rms.
const MAX_PEAK_TO_RMS: f64 = 4.0;

impl BendingMode {
    fn parse(text: &str) -> Result<Self, InvalidValue> {
        let numbers: Vec<f64> = text.split(':').map_while(|number| number.parse().ok()).collect();
        match numbers[..] {
            [hz, damping, rms_m] if hz > 0.0 && damping > 0.0 && damping < 1.0 && (0.0..2.0).contains(&rms_m) => {
                Ok(Self { hz, damping, rms_m })
            }
            _ => Err(InvalidValue("frequency, damping ratio below 1 and rms, such as 1.3:0.03:0.1".into())),
        }
    }

    /// Samples the mode's amplitude at each frame, m: a damped oscillator driven by white noise, in its steady state.
    fn sample_amplitudes(self, rate_hz: f64, count: usize, random: &mut SeededRandom) -> Vec<f64> {
        let omega = std::f64::consts::TAU * self.hz / rate_hz;
        let decay = (-self.damping * omega).exp();
        let first = 2.0 * decay * (omega * (1.0 - self.damping.powi(2)).sqrt()).cos();
        let second = decay * decay;
        let gain = (1.0 - second) * ((1.0 + second).powi(2) - first * first) / (1.0 + second);
        let settled = (20.0 / (self.damping * omega)).ceil() as usize;
        let (mut last, mut before) = (0.0, 0.0);
        let mut next = || {
            let now = first * last - second * before + self.rms_m * gain.sqrt() * random.normal();
            (last, before) = (now, last);
            now
        };
        (0..settled + count).map(|_| next()).skip(settled).collect()
    }
}

impl GustArgs {
    /// Returns a usage error if an option is out of its range.
    pub fn check_options(&self) -> Result<(), Failure> {
        let wrong = |what: &str| Err(Failure::Usage(what.into()));
        match self.seconds {
            Some(seconds) if !(seconds > 0.0 && seconds <= 3600.0) => {
                wrong("--gusts: give seconds, more than 0 and at most 3600")
            }
            _ if !(self.rate_hz > 0.0 && self.rate_hz <= 100.0) => wrong("--rate-hz: give 0.1 to 100"),
            _ if !(0.0..=2.0).contains(&self.gust) => wrong("--gust: give 0 to 2 m"),
            _ if self.modes.len() > 2 => wrong("--modes: give one or two"),
            _ if self.modes.iter().any(|mode| mode.hz >= 0.5 * self.rate_hz) => {
                wrong("--modes: give frequencies below half of --rate-hz, to avoid aliasing")
            }
            _ => Ok(()),
        }
    }

    /// Returns the maximum deflection added by gusts, m.
    pub fn max_added_deflection_m(&self) -> f64 {
        let modes: f64 = self.modes.iter().map(|mode| MAX_PEAK_TO_RMS * mode.rms_m).sum();
        self.seconds.map_or(0.0, |_| self.gust * GUSTS_HZ.len() as f64 + modes)
    }
}

/// A gust with a whole number of periods in the flight.
struct Gust {
    hz: f64,
    phase: f64,
}

impl Gust {
    fn value_at(&self, time_s: f64) -> f64 {
        (std::f64::consts::TAU * self.hz * time_s + self.phase).sin()
    }
}

/// Returns the ground frame and the flight's frames, all in one light.
pub(super) fn gust_frames(args: &Simulate, scene: &Scene, seconds: f64) -> Vec<SetFrame> {
    let mut random = SeededRandom::new(args.seed, 21);
    let mut mount = Rotation3::identity();
    let quality = args.picture.quality;
    let gusts = GUSTS_HZ.map(|hz| Gust {
        hz: (hz * seconds).round().max(1.0) / seconds,
        phase: random.uniform(0.0, std::f64::consts::TAU),
    });
    let (rate_hz, gust_m) = (args.gusts.rate_hz, args.gusts.gust);
    let level_m = args.tip_deflections.first().copied().unwrap_or(2.0);
    let light = args.lights.first().copied().unwrap_or(Light::Plain);
    let count = (seconds * rate_hz).round().max(1.0) as u64;
    let digits = count.to_string().len();
    let seed = |i: u64| args.seed.wrapping_mul(1_000_000).wrapping_add(i);
    let hidden = choose_hidden(&mut random, args.hide, scene.markers.len());
    let ground = args.picture.apply_to(scene.ground_shot(seed(0)));
    let mut frames = vec![SetFrame { image: "ground.jpg".into(), shot: ground, quality, moment: None }];
    let swings: Vec<Vec<f64>> =
        args.gusts.modes.iter().map(|mode| mode.sample_amplitudes(rate_hz, count as usize, &mut random)).collect();
    let walk = scene.setup.uncertainty[Width::MountDrift] * (1.0 / (rate_hz * MOUNT_WALK_TIME_S)).sqrt();
    for i in 0..count {
        let time_s = i as f64 / rate_hz;
        if args.remount.is_some_and(|first| i + 1 == first as u64) {
            mount = scene.remount(&mut random);
        }
        let step = Vector3::from_fn(|_, _| walk * random.normal());
        mount = Rotation3::from_scaled_axis(step) * mount;
        let swing: f64 = gusts.iter().map(|gust| gust_m * gust.value_at(time_s)).sum();
        let modes_m: Vec<f64> = swings.iter().filter_map(|swing| swing.get(i as usize).copied()).collect();
        let first = modes_m.first().copied().unwrap_or_default();
        let mut shot = args.picture.apply_to(scene.flight_shot(level_m + swing + first, light, seed(i + 1)));
        shot.state.second_mode_m = modes_m.get(1).copied().unwrap_or_default();
        shot.light_seed = seed(1);
        if gust_m > 0.0 {
            shot.state.load.relief *= 1.0 + RELIEF_VARIATION * gusts[2].value_at(time_s + 0.1);
        }
        shot.mount = mount;
        shot.hidden = hidden.clone();
        let image = format!("flight-{:0digits$}.jpg", i + 1);
        frames.push(SetFrame { image, shot, quality, moment: Some(FlightMoment { time_s, modes_m }) });
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
    fn a_flight_oscillates_about_its_level_and_closes() {
        let words = "wingd --output o --gusts 20 --rate-hz 50 --tip-deflections 2 --gust 0.1 --side left --markers 8";
        let args = Cli::try_parse_from(words.split(' ')).unwrap_or_else(|e| e.exit()).simulate;
        args.gusts.check_options().unwrap_or_else(|_| unreachable!());
        let scene = crate::cli::simulate::create_scene(&args).unwrap_or_else(|_| unreachable!());
        let flight = gust_frames(&args, &scene, 20.0).split_off(1);
        assert_eq!((flight.len(), flight[50].moment.as_ref().map(|time| time.time_s)), (1000, Some(1.0)));
        let deflections: Vec<f64> = flight.iter().map(|f| f.shot.state.tip_deflection_m).collect();
        let mean = deflections.iter().sum::<f64>() / 1000.0;
        let scatter = (deflections.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / 1000.0).sqrt();
        // Three sines over whole periods.
        assert!((mean - 2.0).abs() < 1e-9 && (scatter - 0.1 * 1.5_f64.sqrt()).abs() < 1e-9, "{mean} {scatter}");
        let fastest = 0.1 * std::f64::consts::TAU * GUSTS_HZ.iter().sum::<f64>() * 1.1 / 50.0;
        let steps = (0..1000).map(|i| (deflections[(i + 1) % 1000] - deflections[i]).abs());
        assert!(steps.fold(0.0, f64::max) < fastest, "the last frame is followed by the first");
        assert!(flight.iter().all(|f| f.shot.light_seed == flight[0].shot.light_seed));
        assert!(flight.windows(2).all(|pair| pair[0].shot.seed != pair[1].shot.seed));
    }

    #[test]
    fn a_mode_has_its_frequency_damping_and_rms() {
        let mode = BendingMode::parse("1.3:0.03:0.1").unwrap();
        let swing = mode.sample_amplitudes(10.0, 200_000, &mut SeededRandom::new(5, 1));
        let mean =
            |lag: usize| swing.iter().zip(&swing[lag..]).map(|(a, b)| a * b).sum::<f64>() / (swing.len() - lag) as f64;
        assert!((mean(0).sqrt() / 0.1 - 1.0).abs() < 0.03, "{}", mean(0).sqrt());
        // Yule and Walker: the recursion from its correlations.
        let (zero, one, two) = (mean(0), mean(1), mean(2));
        let (first, second) =
            (one * (zero - two) / (zero * zero - one * one), (zero * two - one * one) / (zero * zero - one * one));
        let decay = (-second).sqrt();
        let (real, imaginary) = (decay.ln(), (0.5 * first / decay).acos());
        let hz = real.hypot(imaginary) * 10.0 / std::f64::consts::TAU;
        assert!((hz - 1.3).abs() < 0.01 && (-real / real.hypot(imaginary) - 0.03).abs() < 0.005, "{hz}");
        for wrong in ["1.3", "1.3:0.03", "0:0.1:0.1", "1:1:0.1", "1:0.1:x"] {
            assert!(BendingMode::parse(wrong).is_err(), "{wrong}");
        }
    }
}
