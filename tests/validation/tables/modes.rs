//! Live results of a wing that vibrates in two modes.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::common::beam_truth::{ModeShape, rms, rng};
use crate::vibration::{FIRST, RATE_HZ, SECOND, VibratingFlight};

const FIVE_MINUTES: usize = 3000;

/// Writes five minutes of live results and the true modes into `MODES=folder`, for the fleet's test.
pub fn write_modes() {
    let folder =
        PathBuf::from(std::env::var("MODES").unwrap_or_else(|_| "target/modes".to_owned()));
    std::fs::create_dir_all(&folder).unwrap();
    let second_m = std::env::var("SECOND_M")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(SECOND.2);
    let flight = VibratingFlight::new(&mut rng(511), second_m, ModeShape::Uniform, FIVE_MINUTES);
    write_results(&flight, &folder);
    let ids = flight.truth.setup.markers.iter().map(|m| m.id.clone());
    let named = |shape: Vec<f64>| {
        ids.clone()
            .zip(shape)
            .map(|(id, z)| (id, json!(z)))
            .collect::<serde_json::Map<_, _>>()
    };
    let truth_of_modes: Vec<_> = [FIRST, SECOND]
        .iter()
        .zip([flight.shape(0.01, 0.0), flight.shape(0.0, 0.01)])
        .map(|((hz, damping, _), shape)| json!({"hz": hz, "damping": damping, "shape": named(shape)}))
        .collect();
    std::fs::write(folder.join("truth.json"), json!(truth_of_modes).to_string()).unwrap();
    let normalised = rms(&flight.normalised(1));
    println!(
        "deflections {normalised:.2} normalised; MAC {:.4?}; {}",
        flight.assurance(1),
        folder.display()
    );
    assert!((0.35..1.3).contains(&normalised));
}

/// Writes results as `wingd export --table live` does.
fn write_results(flight: &VibratingFlight, folder: &Path) {
    let ids: Vec<&str> = flight
        .truth
        .setup
        .markers
        .iter()
        .map(|m| m.id.as_str())
        .collect();
    let mut csv = String::from("recorder_id,flight,boot_id,since_boot_s,exposure_time");
    ids.iter().for_each(|id| {
        write!(csv, ",u_{id}_px,deflection_{id}_m,sigma_deflection_{id}_m").unwrap()
    });
    csv.push('\n');
    for (k, frame) in flight.results.iter().enumerate() {
        let s = 1000.0 + k as f64 / RATE_HZ;
        let moment =
            jiff::Timestamp::from_microsecond(1_772_000_000_000_000 + (1e6 * s) as i64).unwrap();
        write!(csv, "ab,f0001,boot,{s},{moment}").unwrap();
        for (i, seen) in frame.seen.iter().enumerate() {
            let deflection = frame
                .used()
                .find(|m| m.marker == i)
                .and_then(|m| m.deflection_m);
            // A removed marker has no deflection in this frame.
            match deflection.and_then(|deflection| Some((deflection.value, deflection.sigma?))) {
                Some((value, sigma)) => {
                    write!(csv, ",{:.2},{value},{sigma}", seen.pixel.x).unwrap()
                }
                None => write!(csv, ",{:.2},,", seen.pixel.x).unwrap(),
            }
        }
        csv.push('\n');
    }
    std::fs::write(folder.join("live.csv"), csv).unwrap();
}
