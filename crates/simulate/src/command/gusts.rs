//! Options of a flight in gusts, and its frames.

use nalgebra::{Rotation3, Vector3};

use super::SimulateArgs as Simulate;
use crate::render::Light;
use crate::render::Scene;
use crate::render::SeededRandom;
use crate::render::{BendingMode, GustSeries};
use crate::set::{FlightMoment, SetFrame, choose_hidden};
use wingd_base::failure::{Failure, TaskResult};
use wingd_measure::setup::Width;

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
    #[arg(long, value_delimiter = ',', value_name = "HZ:DAMPING:RMS_M", requires = "seconds", value_parser = parse_mode)]
    modes: Vec<BendingMode>,
}

fn parse_mode(text: &str) -> Result<BendingMode, String> {
    let numbers: Vec<f64> = text
        .split(':')
        .map_while(|number| number.parse().ok())
        .collect();
    match numbers[..] {
        [hz, damping, rms_m]
            if hz > 0.0 && damping > 0.0 && damping < 1.0 && (0.0..2.0).contains(&rms_m) =>
        {
            Ok(BendingMode { hz, damping, rms_m })
        }
        _ => Err("frequency, damping ratio below 1 and rms, such as 1.3:0.03:0.1".into()),
    }
}

impl GustArgs {
    /// Returns a usage error if an option is out of its range.
    pub fn check_options(&self) -> TaskResult<()> {
        let wrong = |what: &str| Err(Failure::Usage(what.into()));
        match self.seconds {
            Some(seconds) if !(seconds > 0.0 && seconds <= 3600.0) => {
                wrong("--gusts: give seconds, more than 0 and at most 3600")
            }
            _ if !(self.rate_hz > 0.0 && self.rate_hz <= 100.0) => {
                wrong("--rate-hz: give 0.1 to 100")
            }
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
        self.seconds.map_or(0.0, |_| {
            GustSeries::max_deflection_m(self.gust, &self.modes)
        })
    }
}

/// Returns the ground frame and the flight's frames, all in one light.
pub(super) fn gust_frames(args: &Simulate, scene: &Scene, seconds: f64) -> Vec<SetFrame> {
    let mut random = SeededRandom::new(args.seed, 21);
    let mut mount = Rotation3::identity();
    let rate_hz = args.gusts.rate_hz;
    let gusts = GustSeries::new(seconds, args.gusts.gust, &mut random);
    let level_m = args.tip_deflections.first().copied().unwrap_or(2.0);
    let light = args.lights.first().copied().unwrap_or(Light::Plain);
    let count = (seconds * rate_hz).round().max(1.0) as u64;
    let seed = |i: u64| args.seed.wrapping_mul(1_000_000).wrapping_add(i);
    let hidden = choose_hidden(&mut random, args.hide, scene.markers.len());
    let mut frames = vec![args.picture.ground_frame(scene, seed(0))];
    let swings: Vec<Vec<f64>> = args
        .gusts
        .modes
        .iter()
        .map(|mode| mode.sample_amplitudes(rate_hz, count as usize, &mut random))
        .collect();
    let walk =
        scene.setup.uncertainty[Width::MountDrift] * (1.0 / (rate_hz * MOUNT_WALK_TIME_S)).sqrt();
    for i in 0..count {
        let time_s = i as f64 / rate_hz;
        if args.remount.is_some_and(|first| i + 1 == first as u64) {
            mount = scene.remount(&mut random);
        }
        let step = Vector3::from_fn(|_, _| walk * random.normal());
        mount = Rotation3::from_scaled_axis(step) * mount;
        let swing = gusts.tip_deflection_m(time_s);
        let modes_m: Vec<f64> = swings
            .iter()
            .filter_map(|swing| swing.get(i as usize).copied())
            .collect();
        let first = modes_m.first().copied().unwrap_or_default();
        let mut shot =
            args.picture
                .apply_to(scene.flight_shot(level_m + swing + first, light, seed(i + 1)));
        shot.state.second_mode_m = modes_m.get(1).copied().unwrap_or_default();
        shot.light_seed = seed(1);
        shot.state.load.relief *= gusts.relief_factor(time_s);
        shot.mount = mount;
        shot.hidden = hidden.clone();
        let moment = Some(FlightMoment { time_s, modes_m });
        frames.push(
            args.picture
                .flight_frame(i as usize + 1, count as usize, shot, moment),
        );
    }
    frames
}

#[cfg(test)]
mod tests {
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
        let args = Cli::try_parse_from(words.split(' '))
            .unwrap_or_else(|e| e.exit())
            .simulate;
        args.gusts
            .check_options()
            .unwrap_or_else(|_| unreachable!());
        let scene = crate::command::create_scene(&args).unwrap_or_else(|_| unreachable!());
        let flight = gust_frames(&args, &scene, 20.0).split_off(1);
        assert_eq!(
            (
                flight.len(),
                flight[50].moment.as_ref().map(|time| time.time_s)
            ),
            (1000, Some(1.0))
        );
        let deflections: Vec<f64> = flight
            .iter()
            .map(|f| f.shot.state.tip_deflection_m)
            .collect();
        let mean = deflections.iter().sum::<f64>() / 1000.0;
        let scatter = (deflections.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / 1000.0).sqrt();
        // Three sines over whole periods.
        assert!(
            (mean - 2.0).abs() < 1e-9 && (scatter - 0.1 * 1.5_f64.sqrt()).abs() < 1e-9,
            "{mean} {scatter}"
        );
        let fastest = 0.1 * std::f64::consts::TAU * (0.17 + 0.6 + 1.9) * 1.1 / 50.0;
        let steps = (0..1000).map(|i| (deflections[(i + 1) % 1000] - deflections[i]).abs());
        assert!(
            steps.fold(0.0, f64::max) < fastest,
            "the last frame is followed by the first"
        );
        assert!(
            flight
                .iter()
                .all(|f| f.shot.light_seed == flight[0].shot.light_seed)
        );
        assert!(
            flight
                .windows(2)
                .all(|pair| pair[0].shot.seed != pair[1].shot.seed)
        );
    }

    #[test]
    fn a_mode_is_read_or_refused() {
        assert_eq!(
            parse_mode("1.3:0.03:0.1"),
            Ok(BendingMode {
                hz: 1.3,
                damping: 0.03,
                rms_m: 0.1
            })
        );
        for wrong in ["1.3", "1.3:0.03", "0:0.1:0.1", "1:1:0.1", "1:0.1:x"] {
            assert!(parse_mode(wrong).is_err(), "{wrong}");
        }
    }
}
