//! Takes shots with the configured camera, without recorder and store: for mounting and for tests.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use serde_json::json;

use crate::camera::freshness::Freshness;
use crate::camera::{Camera, CameraError, Frame};
use crate::cli::{Done, Failure, print};
use crate::clock::System;
use crate::config;

/// Arguments.
#[derive(ClapArgs)]
pub struct Args {
    /// Configuration, of which only [camera] is used [default: wingd.toml of this folder]
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
    /// Shots to take
    #[arg(long, default_value_t = 1, value_name = "N")]
    shots: u32,
    /// Longest time for a shot, s
    #[arg(long, default_value_t = 20.0, value_name = "S")]
    deadline: f64,
    /// Attempts for a shot; the camera is reopened in between
    #[arg(long, default_value_t = 1, value_name = "N")]
    attempts: u32,
    /// Existing directory that takes the frames, as delivered
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
}

/// One line of JSON on standard output for each shot.
pub fn run(args: &Args) -> Result<Done, Failure> {
    let camera = config::load_camera(&super::default_paths::configuration(args.config.as_deref())?)?;
    let mut bench = Bench {
        camera: camera.factory(Arc::new(System::new()), Duration::ZERO)(),
        args,
        open: false,
        saved: 0,
        freshness: Freshness::default(),
    };
    let mut good = 0;
    for number in 0..args.shots {
        let start = Instant::now();
        let shot = bench.shot();
        let (error, settings) = match shot {
            Ok(frame) => (None, json!({"format": frame.format, "settings": frame.settings})),
            Err(error) => (Some(error.to_string()), json!(null)),
        };
        good += u32::from(error.is_none());
        let seconds = start.elapsed().as_secs_f64();
        print(&json!({"shot": number, "seconds": seconds, "error": error, "frame": settings}).to_string())?;
    }
    bench.camera.close();
    Ok(Done::all(good == args.shots))
}

struct Bench<'a> {
    camera: Box<dyn Camera>,
    args: &'a Args,
    open: bool,
    saved: u32,
    freshness: Freshness,
}

impl Bench<'_> {
    fn deadline(&self) -> Duration {
        Duration::try_from_secs_f64(self.args.deadline).unwrap_or(Duration::from_secs(20))
    }

    /// Up to the given number of attempts, reopening after each that failed.
    fn shot(&mut self) -> Result<Frame, CameraError> {
        let mut result = self.attempt();
        for attempt in 1..self.args.attempts {
            let Err(error) = &result else { break };
            eprintln!("attempt {attempt}: {error}");
            self.camera.close();
            self.open = false;
            std::thread::sleep(Duration::from_millis(300));
            result = self.attempt();
        }
        result
    }

    fn attempt(&mut self) -> Result<Frame, CameraError> {
        if !self.open {
            let info = self.camera.open()?;
            self.open = true;
            let line = json!({"camera": info.name, "settings": info.settings, "warnings": info.warnings});
            print(&line.to_string())
                .map_err(|_| CameraError::Refused("standard output cannot be written".into()))?;
            while let Some(frame) = self.camera.recover(self.deadline())? {
                self.save(&frame, "recovered")?;
            }
        }
        let frame = self.camera.shoot(self.deadline())?;
        self.freshness.check(&frame.bytes)?;
        self.save(&frame, "shot")?;
        Ok(frame)
    }

    fn save(&mut self, frame: &Frame, kind: &str) -> Result<(), CameraError> {
        let path = self.args.output.join(format!("{kind}-{:03}", self.saved));
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
