//! Time to verify a big store, compared with sha256sum over the same bytes. Run it manually:
//! `cargo test --release --test system -- --ignored --nocapture store_speed` (WINGD: another binary)

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use crate::common::fake_disk::{FakeDisk, read_all_files};
use serde_json::{Map, Value};
use wingd::store::manifest::{SeriesCause, SeriesState, Shot};
use wingd::store::{NewFrame, SeriesPlan, Store, StoreConfig};

use crate::common::store_work::{ROOT, moment};

const SERIES: u32 = 100;
const SHOTS: u32 = 1000;
const FRAME_BYTES: usize = 10_000;

/// Made in memory: 100,000 frames with their syncs would take an hour.
fn make(root: &Path) {
    let disk = Arc::new(FakeDisk::default());
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(ROOT)
    };
    let (store, _) = Store::open(disk.clone(), config).unwrap();
    for number in 0..SERIES {
        let plan = SeriesPlan {
            cause: SeriesCause::Scheduled,
            shots: SHOTS,
        };
        let begin_s = f64::from(number) * 2000.0;
        let (mut series, _) = store.begin_series(plan, &moment(begin_s)).unwrap();
        for shot in 1..=SHOTS {
            let mut bytes = format!("{number} {shot} ")
                .repeat(FRAME_BYTES / 4)
                .into_bytes();
            bytes.truncate(FRAME_BYTES);
            let stamp = moment(begin_s + f64::from(shot));
            let shot = Shot {
                shot,
                stamp,
                duration_s: None,
                exposure: None,
                frame: None,
                failures: Vec::new(),
            };
            let frame = NewFrame {
                bytes: &bytes,
                extension: "jpg",
                format: Value::Null,
                settings: Map::new(),
            };
            series.add_shot(shot, Some(frame)).unwrap();
        }
        let end = moment(begin_s + f64::from(SHOTS));
        store
            .close_series(series, SeriesState::Complete, &end, Vec::new())
            .unwrap();
    }
    for (path, bytes) in read_all_files(disk.as_ref(), Path::new(ROOT)) {
        let path = root.join(path.strip_prefix(ROOT).unwrap());
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    for name in ["incoming", "partial"] {
        std::fs::create_dir_all(root.join(name)).unwrap();
    }
}

/// The shortest of three, s.
fn shortest(command: &mut Command) -> f64 {
    let time = |_| {
        let begin = Instant::now();
        let output = command.output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stdout)
        );
        begin.elapsed().as_secs_f64()
    };
    (0..3).map(time).fold(f64::INFINITY, f64::min)
}

#[test]
#[ignore = "1 GB, run manually"]
fn a_store_of_100_000_frames_verifies_as_fast_as_sha256sum_reads_it() {
    let dir = tempfile::tempdir().unwrap();
    make(dir.path());
    let sums_s = shortest(
        Command::new("sh")
            .args([
                "-c",
                "cd flights/f0001 && sha256sum --check --quiet SHA256SUMS",
            ])
            .current_dir(dir.path()),
    );
    let wingd = std::env::var("WINGD").unwrap_or_else(|_| env!("CARGO_BIN_EXE_wingd").to_owned());
    let verify_s = shortest(Command::new(wingd).arg("verify").arg(dir.path()));
    let frames = SERIES * SHOTS;
    println!(
        "{frames} frames of {FRAME_BYTES} bytes: wingd verify {verify_s:.2} s, sha256sum -c {sums_s:.2} s, ratio {:.2}",
        verify_s / sums_s
    );
    assert!(verify_s < sums_s, "verify is slower than sha256sum");
}
