//! Promise: the daemon, killed at any moment, loses no acknowledged frame and solves none twice.

use crate::common::store_reading::read_results;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::common::statistics::draws;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::store::manifest::SeriesState;
use wingd::store::verify::verify_path;
use wingd::store::{RealDisk, catalogue};

/// A configuration with quick series of bundled frames, solved with the bundled installation.
pub(crate) fn configuration(dir: &Path) -> std::path::PathBuf {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev");
    let installation = dir.join("installation");
    std::fs::create_dir(&installation).unwrap();
    for file in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(
            fixture.join("installation").join(file),
            installation.join(file),
        )
        .unwrap();
    }
    let oriented = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(["orient", "--installation"])
        .arg(&installation)
        .arg(fixture.join("frames/ground.jpg"))
        .output()
        .unwrap();
    assert!(
        oriented.status.success(),
        "{}",
        String::from_utf8_lossy(&oriented.stderr)
    );
    let text = format!(
        "installation = \"installation\"\n\
         [camera]\nkind = \"replay\"\nfolder = {:?}\n\
         [store]\npath = \"store\"\nreserve_mb = 0\n\
         [status]\nsocket = \"wingd.sock\"\n\
         [series]\ninterval = \"400ms\"\nshots = 3\ngap = \"20ms\"\nstale_window = 1\n",
        fixture.join("frames")
    );
    let path = dir.join("wingd.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// Series, file and hash of every frame that the daemon reported as durable.
type Acknowledged = Arc<Mutex<BTreeSet<[String; 3]>>>;

fn start(config: &Path, acknowledged: &Acknowledged) -> (Child, std::thread::JoinHandle<()>) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .arg("run")
        .arg("--config")
        .arg(config)
        .env("NO_COLOR", "1")
        .env_remove("JOURNAL_STREAM")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let acknowledged = acknowledged.clone();
    let reader = std::thread::spawn(move || {
        for line in lines
            .map_while(Result::ok)
            .filter(|line| line.contains("frame is durable"))
        {
            // … series="s000001" file="0001.jpg" sha256="…"
            let quoted: Vec<String> = line
                .split('"')
                .skip(1)
                .step_by(2)
                .map(str::to_owned)
                .collect();
            let frame = <[String; 3]>::try_from(quoted).expect("series, file and hash in the line");
            acknowledged.lock().unwrap().insert(frame);
        }
    });
    (child, reader)
}

/// Every frame in the finished series, the frame (series, file) and inputs of every result, and the numbers of
/// series and interrupted series.
fn holdings(root: &Path) -> (BTreeSet<[String; 3]>, Vec<[String; 3]>, usize, usize) {
    let (mut frames, mut results, mut series_count, mut interrupted) =
        (BTreeSet::new(), vec![], 0, 0);
    for flight in catalogue::list_flights(&RealDisk, root).unwrap() {
        for series in catalogue::list_series(&RealDisk, &flight).unwrap() {
            let manifest = catalogue::read_series_manifest(&RealDisk, &series).unwrap();
            series_count += 1;
            interrupted += usize::from(manifest.state == SeriesState::Interrupted);
            let of_series = manifest.shots.into_iter().filter_map(|shot| shot.frame);
            frames.extend(of_series.map(|frame| [series.id.clone(), frame.file, frame.sha256]));
            let solved = read_results(&RealDisk, &series).unwrap().into_iter();
            results.extend(solved.map(|record| [series.id.clone(), record.frame, record.inputs]));
        }
    }
    (frames, results, series_count, interrupted)
}

#[test]
fn kills_lose_nothing_acknowledged_and_nothing_is_solved_twice() {
    let dir = tempfile::tempdir().unwrap();
    let config = configuration(dir.path());
    let root = dir.path().join("store");
    let mut random = StdRng::seed_from_u64(20);
    let acknowledged = Arc::new(Mutex::new(BTreeSet::new()));
    for kill in 0..draws(20, 300) {
        let (mut child, reader) = start(&config, &acknowledged);
        std::thread::sleep(Duration::from_millis(random.random_range(60..900)));
        assert!(
            child.try_wait().unwrap().is_none(),
            "kill {kill}: the daemon has ended by itself"
        );
        child.kill().unwrap();
        child.wait().unwrap();
        reader.join().unwrap();
        if root.join("store.toml").exists() {
            let report = verify_path(&RealDisk, &root);
            assert!(report.is_sound(), "kill {kill}: {:#?}", report.faults);
        }
    }
    // A last run, stopped properly, recovers the series of the last kill.
    let (mut child, reader) = start(&config, &acknowledged);
    std::thread::sleep(Duration::from_millis(1500));
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0), "a clean stop");
    reader.join().unwrap();
    let report = verify_path(&RealDisk, &root);
    assert!(report.is_sound(), "{:#?}", report.faults);
    assert!(
        std::fs::read_dir(root.join("incoming"))
            .unwrap()
            .next()
            .is_none(),
        "nothing is left in incoming"
    );
    let (frames, results, series, interrupted) = holdings(&root);
    let acknowledged = acknowledged.lock().unwrap();
    let missing: Vec<_> = acknowledged.difference(&frames).collect();
    assert!(
        missing.is_empty(),
        "acknowledged frames are missing: {missing:?}"
    );
    assert!(
        acknowledged.len() >= 5 && interrupted >= 1,
        "{acknowledged:?} {interrupted}"
    );
    eprintln!(
        "{series} series, {interrupted} interrupted, {} frames, {} results",
        report.frames,
        results.len()
    );
    let solved: BTreeSet<&[String; 3]> = results.iter().collect();
    assert_eq!(
        solved.len(),
        results.len(),
        "a frame is solved twice: {results:?}"
    );
    let stored: BTreeSet<[&str; 2]> = frames
        .iter()
        .map(|[series, file, _]| [series.as_str(), file])
        .collect();
    let unknown =
        |[series, file, _]: &&[String; 3]| !stored.contains(&[series.as_str(), file.as_str()]);
    assert!(
        !results.is_empty() && !results.iter().any(|result| unknown(&result)),
        "{results:?}"
    );
}
