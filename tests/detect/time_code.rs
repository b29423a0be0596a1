//! Images of a screen with the clock: the delay is recovered within its standard deviation, and no time is misread.

use wingd::measure::detect::{Detections, detect};
use wingd::measure::raster::Raster;
use wingd::measure::render::{SeededRandom, SensorModel};
use wingd::measure::time_code::{
    DisplayedTime, Screen, TimeCodeError, estimate_delay, nearest_time, read_time,
};

use crate::common::clock_screen::{BEGIN_S, Display, SIZE_PX, photograph};

fn screen() -> Screen {
    Screen {
        refresh_s: 1.0 / 60.0,
        latency_s: 0.03,
        latency_sigma_s: 0.04 / 12f64.sqrt(),
    }
}

/// Error of the middle of the exposure read from an image, s, with known latency, and its standard deviation.
fn error(shown: &DisplayedTime, middle_s: f64, display: &Display) -> (f64, f64) {
    let screen = Screen {
        latency_s: display.latency_s,
        latency_sigma_s: 0.0,
        ..screen()
    };
    let told_s = 1e-3 * nearest_time(shown, 1e3 * middle_s) + screen.display_delay_s();
    (
        told_s - middle_s,
        screen.read_sigma_s(1e-3 * shown.width_ms),
    )
}

/// Largest possible error, s: both parts are uniform, and 10 % of an exposure is undetermined at either end.
fn max_error_s(shown: &DisplayedTime, exposure_s: f64) -> f64 {
    0.5 * (1e-3 * shown.width_ms + screen().refresh_s) + 0.1 * exposure_s
}

#[test]
fn the_instant_of_exposure_is_read_within_its_standard_deviation() {
    let (mut squares, mut read_pictures, mut unread) = (0.0, 0, vec![]);
    for seed in 0..50u64 {
        let random = &mut SeededRandom::new(seed, 31);
        let display = Display {
            refresh_s: 1.0 / 60.0,
            latency_s: random.uniform(0.01, 0.05),
            phase_s: random.unit(),
        };
        // From 1 % of a tick to three ticks.
        let exposure_s = 0.0002 * 300f64.powf(random.unit());
        let middle_s = BEGIN_S + random.uniform(0.0, 3000.0);
        let sensor = SensorModel {
            blur_px: random.uniform(0.6, 2.5),
            noise: random.uniform(1.0, 5.0),
            gamma: random.uniform(1.8, 2.4),
            ..SensorModel::default()
        };
        let white = random.uniform(0.25, 0.9);
        let picture = photograph(
            &display.lit_fractions(middle_s, exposure_s),
            &sensor,
            white,
            random,
        );
        match read_time(&picture, &detect(&picture)) {
            Ok(shown) => {
                let (error_s, sigma_s) = error(&shown, middle_s, &display);
                assert!(
                    error_s.abs() < max_error_s(&shown, exposure_s),
                    "seed {seed}: {error_s}, {exposure_s}, {shown:?}"
                );
                squares += (error_s / sigma_s).powi(2);
                read_pictures += 1;
            }
            Err(why) => unread.push(format!("{seed} ({:.1} ms): {why:?}", 1e3 * exposure_s)),
        }
    }
    let rms = (squares / f64::from(read_pictures)).sqrt();
    println!("{read_pictures} read, normalised rms {rms:.2}; unread: {unread:?}");
    assert!(unread.is_empty(), "{unread:?}");
    assert!((0.7..1.3).contains(&rms), "{rms}");
}

#[test]
fn a_cameras_delay_is_recovered_with_the_screens_latency_in_its_standard_deviation() {
    let (mut squares, mut read, sessions, each) = (0.0, 0, 50, 30);
    for seed in 0..sessions {
        let random = &mut SeededRandom::new(seed, 32);
        let display = Display {
            refresh_s: 1.0 / 60.0,
            latency_s: random.uniform(0.01, 0.05),
            phase_s: random.unit(),
        };
        let (truth_s, jitter_s) = (random.uniform(-0.1, 0.1), random.uniform(0.0, 0.01));
        let pictures: Vec<(f64, f64)> = (0..each)
            .filter_map(|_| {
                let middle_s = BEGIN_S + random.uniform(0.0, 2000.0);
                let event_s = middle_s - truth_s - jitter_s * random.normal();
                let bits = display.lit_fractions(middle_s, 0.004);
                let of = |test: &dyn Fn(f64) -> bool| {
                    bits.iter()
                        .enumerate()
                        .filter(|(_, s)| test(**s))
                        .map(|(bit, _)| 1 << bit)
                        .sum::<u32>()
                };
                let shown = wingd::measure::time_code::decode_time(
                    of(&|s| s > 0.9),
                    of(&|s| (0.1..=0.9).contains(&s)),
                );
                // One truncated between two ticks, with one's parity and the other's count, is rejected.
                let shown = shown?;
                let told_s =
                    1e-3 * nearest_time(&shown, 1e3 * event_s) + screen().display_delay_s();
                Some((
                    told_s - event_s,
                    screen().read_sigma_s(1e-3 * shown.width_ms),
                ))
            })
            .collect();
        read += pictures.len();
        let found = estimate_delay(&pictures, screen().systematic_s()).unwrap();
        squares += ((found.mean_s - truth_s) / found.mean_sigma_s).powi(2);
        assert!(found.sigma_s.unwrap() >= found.mean_sigma_s);
    }
    let rms = (squares / sessions as f64).sqrt();
    println!(
        "normalised rms {rms:.2}, {read} of {} read",
        sessions as usize * each
    );
    assert!(read * 20 >= sessions as usize * each * 19, "{read}");
    // The phase of the refresh counts twice: for images at random times, and for images at a fixed rate.
    assert!((0.7..1.3).contains(&rms), "{rms}");
}

#[test]
fn an_incomplete_clock_is_named_and_never_misread() {
    let none = Raster::new(400, 300, vec![200; 400 * 300]).unwrap();
    assert_eq!(
        read_time(&none, &Detections::default()),
        Err(TimeCodeError::NoDiscs(0))
    );
    let (mut refused, mut right) = (0, 0);
    for seed in 0..60u64 {
        let random = &mut SeededRandom::new(seed, 33);
        let display = Display {
            refresh_s: 1.0 / 60.0,
            latency_s: 0.03,
            phase_s: random.unit(),
        };
        let middle_s = BEGIN_S + random.uniform(0.0, 3000.0);
        // Up to ten ticks: more than can be read reliably.
        let exposure_s = 0.001 * 200f64.powf(random.unit());
        let picture = photograph(
            &display.lit_fractions(middle_s, exposure_s),
            &SensorModel::default(),
            0.7,
            random,
        );
        let found = detect(&picture);
        // Glare or shade as large as some cells, somewhere on the screen.
        let mut luma = picture.luma().to_vec();
        let (u, v, r) = (
            random.uniform(350.0, 850.0),
            random.uniform(300.0, 600.0),
            random.uniform(10.0, 110.0),
        );
        let (level, share) = if seed.is_multiple_of(2) {
            (255.0, random.uniform(0.5, 1.0))
        } else {
            (0.0, random.uniform(0.5, 1.0))
        };
        for (k, grey) in luma.iter_mut().enumerate() {
            let (x, y) = ((k % SIZE_PX.0) as f64, (k / SIZE_PX.0) as f64);
            if (x - u).hypot(y - v) < r {
                *grey = (f64::from(*grey) + share * (level - f64::from(*grey))) as u8;
            }
        }
        let spoiled = Raster::new(SIZE_PX.0, SIZE_PX.1, luma).unwrap();
        match read_time(&spoiled, &found) {
            Err(_) => refused += 1,
            Ok(shown) => {
                let (error_s, _) = error(&shown, middle_s, &display);
                assert!(
                    error_s.abs() < max_error_s(&shown, exposure_s),
                    "seed {seed}: {error_s} {shown:?}"
                );
                right += 1;
            }
        }
    }
    println!("{refused} refused, {right} read");
    assert!(refused >= 10 && right >= 10);
}
