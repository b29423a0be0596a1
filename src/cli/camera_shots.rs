//! `wingd check --camera N` takes shots with the configured camera, without recorder and store: for mounting and for tests.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use serde_json::json;

use crate::camera::freshness::Freshness;
use crate::camera::{Camera, CameraError, CameraFrame};
use crate::config;
use wingd_base::clock::SystemClock;
use wingd_base::failure::{Completion, TaskResult};
use wingd_base::output::print_json;
use wingd_evaluation::inputs::default_paths::resolve_configuration;

/// Shots of the configured camera.
#[derive(ClapArgs)]
pub struct ShotArgs {
    /// Take N shots with the configured camera instead of the other checks; prints one JSON object for each
    #[arg(long = "camera", value_name = "N", requires = "output", conflicts_with_all = ["installation", "no_camera"])]
    pub shots: Option<u32>,
    /// Maximum time for a shot of --camera, s
    #[arg(long, default_value_t = 20.0, value_name = "S", requires = "shots")]
    deadline: f64,
    /// Attempts per shot of --camera; the camera is reopened between attempts
    #[arg(long, default_value_t = 1, value_name = "N", requires = "shots")]
    attempts: u32,
    /// Existing directory for the frames of --camera, stored as delivered
    #[arg(long, value_name = "DIR", requires = "shots")]
    output: Option<PathBuf>,
}

/// Takes the shots and prints one line of JSON for each.
pub fn take_shots(args: &ShotArgs, shots: u32, config: Option<&Path>) -> TaskResult<Completion> {
    let camera = config::load_camera(&resolve_configuration(config)?)?;
    let mut bench = CameraBench {
        camera: camera.factory(Arc::new(SystemClock::new()), Duration::ZERO)(),
        args,
        open: false,
        saved: 0,
        freshness: Freshness::default(),
    };
    let mut good = 0;
    for number in 0..shots {
        let start = Instant::now();
        let shot = bench.take_with_retries();
        let (error, settings) = match shot {
            Ok(frame) => (
                None,
                json!({"format": frame.format, "settings": frame.settings}),
            ),
            Err(error) => (Some(error.to_string()), json!(null)),
        };
        good += u32::from(error.is_none());
        let seconds = start.elapsed().as_secs_f64();
        print_json(
            &json!({"shot": number, "seconds": seconds, "error": error, "frame": settings}),
        )?;
    }
    bench.camera.close();
    Ok(Completion::from_success(good == shots))
}

struct CameraBench<'a> {
    camera: Box<dyn Camera>,
    args: &'a ShotArgs,
    open: bool,
    saved: u32,
    freshness: Freshness,
}

impl CameraBench<'_> {
    fn shot_deadline(&self) -> Duration {
        Duration::try_from_secs_f64(self.args.deadline).unwrap_or(Duration::from_secs(20))
    }

    /// Takes a shot with up to the given number of attempts, reopening the camera after each failure.
    fn take_with_retries(&mut self) -> Result<CameraFrame, CameraError> {
        let mut result = self.attempt_shot();
        for attempt in 1..self.args.attempts {
            let Err(error) = &result else { break };
            eprintln!("attempt {attempt}: {error}");
            self.camera.close();
            self.open = false;
            std::thread::sleep(Duration::from_millis(300));
            result = self.attempt_shot();
        }
        result
    }

    fn attempt_shot(&mut self) -> Result<CameraFrame, CameraError> {
        if !self.open {
            let info = self.camera.open()?;
            self.freshness.limit_to_loop(info.repeats_after);
            self.open = true;
            let line =
                json!({"camera": info.name, "settings": info.settings, "warnings": info.warnings});
            print_json(&line)
                .map_err(|_| CameraError::Refused("standard output cannot be written".into()))?;
            while let Some(frame) = self.camera.recover(self.shot_deadline())? {
                self.save_test_frame(&frame, "recovered")?;
            }
        }
        let frame = self.camera.shoot(self.shot_deadline())?;
        self.freshness.check(&frame.bytes)?;
        self.save_test_frame(&frame, "shot")?;
        Ok(frame)
    }

    fn save_test_frame(&mut self, frame: &CameraFrame, kind: &str) -> Result<(), CameraError> {
        let folder = self.args.output.as_deref().unwrap_or(Path::new("."));
        let path = folder.join(format!("{kind}-{:03}", self.saved));
        self.saved += 1;
        std::fs::write(&path, &frame.bytes).map_err(|error| {
            CameraError::Refused(format!(
                "{} cannot be written ({error}); name another --output",
                path.display()
            ))
        })?;
        self.camera.release_last()
    }
}
