//! Promise: a slow disk delays neither live results nor, on the camera's card, the deletion of frames that are durable.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::Value;
use wingd::camera::replay::ReplayCamera;
use wingd::camera::{Camera, CameraError, CameraFrame, CameraInfo};
use wingd::store::verify::verify_path;

use super::live::LiveRun;
use crate::common::fake_disk::FakeDisk;

#[derive(Clone, Copy, Debug, PartialEq)]
enum CameraCall {
    Shot,
    Live,
    Release,
}

/// Camera that keeps a copy of each frame, as one with a card.
struct CopyingCamera {
    replay: ReplayCamera,
    calls: Arc<Mutex<Vec<CameraCall>>>,
}

impl CopyingCamera {
    fn note(&self, call: CameraCall) {
        self.calls.lock().unwrap().push(call);
    }
}

impl Camera for CopyingCamera {
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        self.replay.open()
    }
    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        self.note(CameraCall::Shot);
        self.replay.shoot(deadline)
    }
    fn next_live_frame(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        self.note(CameraCall::Live);
        self.replay.shoot(deadline)
    }
    fn release_last(&mut self) -> Result<(), CameraError> {
        self.note(CameraCall::Release);
        Ok(())
    }
    fn close(&mut self) {
        self.replay.close();
    }
}

/// Times between the exposures of consecutive results, s, on a disk whose every fsync takes 400 ms.
fn gaps_on_a_slow_disk(keeps_copies: bool) -> (Vec<f64>, Vec<CameraCall>) {
    let mut ride = LiveRun::new(20.0);
    let disk = Arc::new(FakeDisk::slow(Duration::from_millis(400)));
    (ride.seconds, ride.disk) = (2.2, disk.clone());
    let calls = Arc::new(Mutex::new(vec![]));
    if keeps_copies {
        let calls = calls.clone();
        ride.camera = Arc::new(move |replay| {
            Box::new(CopyingCamera {
                replay,
                calls: calls.clone(),
            })
        });
    }
    let lines = ride.listener();
    let status = ride.run_flight();
    assert!(
        status.counts.series_complete >= 1 && status.counts.series_refused == 0,
        "{status:?}"
    );
    let report = verify_path(disk.as_ref(), &ride.root());
    assert!(report.is_sound(), "{:#?}", report.faults);
    let exposed = |line: &String| {
        serde_json::from_str::<Value>(line).unwrap()["exposure_since_boot_s"]
            .as_f64()
            .unwrap()
    };
    let exposed: Vec<f64> = lines.join().unwrap().iter().map(exposed).collect();
    assert!(exposed.is_sorted(), "in the order of exposure");
    let calls = calls.lock().unwrap().clone();
    (
        exposed.windows(2).map(|pair| pair[1] - pair[0]).collect(),
        calls,
    )
}

/// A shot waits for three calls of the disk, the beginning and the end of a series for more.
#[test]
fn a_slow_disk_leaves_no_gap_in_the_results_during_series() {
    let (gaps, _) = gaps_on_a_slow_disk(false);
    assert!(
        gaps.len() > 20 && gaps.iter().all(|gap| *gap < 0.4),
        "{gaps:?}"
    );
    // A camera that keeps a copy of each frame is left alone until the frame is durable.
    let (gaps, calls) = gaps_on_a_slow_disk(true);
    assert!(gaps.iter().any(|gap| *gap > 0.8), "{gaps:?}");
    // Live frames do not stay on its card.
    let next =
        |pair: &[CameraCall]| (pair[0] == CameraCall::Release) != (pair[1] == CameraCall::Release);
    assert!(
        calls.contains(&CameraCall::Shot) && calls.windows(2).all(next),
        "{calls:?}"
    );
}
