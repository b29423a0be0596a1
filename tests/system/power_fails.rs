//! Promise: after a stop or a power failure the recorder has everything durable within a specified time,
//! for any behaviour of the camera; when the power is back it continues.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use wingd::store::manifest::{SeriesManifest, SeriesState};
use wingd::store::verify::verify_path;
use wingd::store::{RealDisk, catalogue};

/// Time limit of steps without a limit of their own.
const PATIENCE: Duration = Duration::from_secs(60);

/// A recorder whose camera hangs at the second shot.
struct Recorder {
    dir: tempfile::TempDir,
    child: Child,
    lines: Receiver<String>,
}

impl Recorder {
    fn start(power: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let frames = dir.path().join("frames");
        std::fs::create_dir(&frames).unwrap();
        for n in 0..9_u8 {
            std::fs::write(frames.join(format!("{n}.jpg")), picture(n)).unwrap();
        }
        std::fs::write(dir.path().join("online"), "1\n").unwrap();
        let text = format!(
            "[camera]\nkind = \"replay\"\nfolder = \"frames\"\n\
             [[camera.fault]]\nshot = 2\nkind = \"hang\"\n\
             [store]\npath = \"store\"\nreserve_mb = 0\n[status]\nsocket = \"wingd.sock\"\n\
             [series]\ninterval = \"400ms\"\nshots = 3\ngap = \"20ms\"\nshot_deadline = \"1h\"\n[power]\n{power}"
        );
        let config = dir.path().join("wingd.toml");
        std::fs::write(&config, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
        command
            .args(["run", "--config"])
            .arg(&config)
            .env("NO_COLOR", "1")
            .env_remove("JOURNAL_STREAM");
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let (say, lines) = channel();
        let errors = BufReader::new(child.stderr.take().unwrap()).lines();
        std::thread::spawn(move || {
            errors
                .map_while(Result::ok)
                .all(|line| say.send(line).is_ok())
        });
        Self { dir, child, lines }
    }

    fn store(&self) -> PathBuf {
        self.dir.path().join("store")
    }

    fn set_power(&self, online: &str) {
        std::fs::write(self.dir.path().join("online"), online).unwrap();
    }

    /// Waits for the next line with these words.
    fn wait_for_line(&self, words: &str) -> String {
        let end = Instant::now() + PATIENCE;
        let mut all = Vec::new();
        while let Ok(line) = self
            .lines
            .recv_timeout(end.saturating_duration_since(Instant::now()))
        {
            if line.contains(words) {
                return line;
            }
            all.push(line);
        }
        panic!("no line with {words:?}: {all:#?}");
    }

    /// Waits for lines with each of these words; threads may write them in any order.
    fn wait_for_lines(&self, words: &[&str]) {
        let end = Instant::now() + PATIENCE;
        let (mut left, mut all) = (words.to_vec(), Vec::new());
        while !left.is_empty() {
            let line = self
                .lines
                .recv_timeout(end.saturating_duration_since(Instant::now()));
            let Ok(line) = line else {
                panic!("no line with {left:?}: {all:#?}")
            };
            left.retain(|words| !line.contains(words));
            all.push(line);
        }
    }

    fn terminate(&mut self) -> Option<i32> {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
        self.child.wait().unwrap().code()
    }

    fn manifests(&self) -> Vec<SeriesManifest> {
        let report = verify_path(&RealDisk, &self.store());
        assert!(report.is_sound(), "{:#?}", report.faults);
        let left = std::fs::read_dir(self.store().join("incoming"))
            .unwrap()
            .count();
        assert_eq!(left, 0, "the series under way was closed");
        let flights = catalogue::list_flights(&RealDisk, &self.store()).unwrap();
        let series = flights
            .iter()
            .flat_map(|flight| catalogue::list_series(&RealDisk, flight).unwrap());
        series
            .map(|series| catalogue::read_series_manifest(&RealDisk, &series).unwrap())
            .collect()
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A small JPEG file with a number in a comment, so that no two are equal.
pub fn picture(number: u8) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/jpeg/baseline-1x1.jpg");
    let file = std::fs::read(path).unwrap();
    [&file[..2], &[0xFF, 0xFE, 0, 3, number], &file[2..]].concat()
}

#[test]
fn a_stop_abandons_a_hanging_shot_and_ends_in_time() {
    let within = Duration::from_secs(4);
    let mut recorder = Recorder::start("stop_within = \"4s\"\n");
    recorder.wait_for_line("frame is durable");
    std::thread::sleep(Duration::from_millis(300));
    let begin = Instant::now();
    assert_eq!(recorder.terminate(), Some(0), "a clean stop");
    let took = begin.elapsed();
    println!("stopped after {took:?} of {within:?}");
    assert!(took < within, "{took:?}");
    let manifests = recorder.manifests();
    let [series] = manifests.as_slice() else {
        panic!("{manifests:?}")
    };
    assert_eq!(
        (series.state, series.shots.len()),
        (SeriesState::Interrupted, 2)
    );
    assert!(series.shots[0].frame.is_some(), "the frame before is there");
    assert!(
        series.shots[1].failures[0].reason.contains("wingd stops"),
        "{:?}",
        series.shots[1]
    );
}

#[test]
fn a_power_failure_makes_all_durable_in_time_and_recording_resumes_with_power() {
    let hold_up = Duration::from_secs(3);
    let mut recorder = Recorder::start("hold_up = \"3s\"\nfile = \"online\"\n");
    recorder.wait_for_line("frame is durable");
    std::thread::sleep(Duration::from_millis(300));
    let begin = Instant::now();
    recorder.set_power("0\n");
    recorder.wait_for_line("the power fails");
    recorder.wait_for_line("series closed");
    let took = begin.elapsed();
    println!("durable after {took:?} of {hold_up:?}");
    assert!(took < hold_up, "{took:?}");
    // Two intervals and more: nothing is begun.
    std::thread::sleep(Duration::from_secs(1));
    let manifests = recorder.manifests();
    let [series] = manifests.as_slice() else {
        panic!("{manifests:?}")
    };
    assert_eq!(
        (series.state, series.remarks.as_slice()),
        (
            SeriesState::Interrupted,
            &["the power failed".to_owned()][..]
        )
    );
    recorder.set_power("1\n");
    recorder.wait_for_line("the power is back");
    recorder.wait_for_line("series begins");
    recorder.wait_for_line("frame is durable");
    assert_eq!(recorder.terminate(), Some(0));
    assert!(recorder.manifests().len() > 1);
}

#[test]
fn a_supply_that_cannot_be_monitored_does_not_prevent_recording() {
    let mut recorder = Recorder::start("file = \"no-such-file\"\nstop_within = \"2s\"\n");
    recorder.wait_for_lines(&["the supply cannot be watched", "frame is durable"]);
    assert_eq!(recorder.terminate(), Some(0));
}
