//! Camera with a remote release on GPIO lines. The frame arrives over USB, as a file in a watched folder, or through V4L2.
//! A shot without a frame is an error; a frame without a shot is recorded with the next shot.

mod folder;
mod line;

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::camera::delay::delay_fault;
use crate::camera::freshness::LastName;
#[cfg(feature = "gphoto")]
use crate::camera::gphoto::{GphotoCamera, GphotoSection};
#[cfg(feature = "v4l")]
use crate::camera::v4l::{V4lCamera, V4lSection};
use crate::camera::{Camera, CameraError, CameraFactory, CameraFrame, CameraInfo, DriverSection};
pub use folder::FolderSection;
use folder::WatchedFolder;
pub(crate) use line::GpioLine;
pub use line::LineSection;
use wingd_base::clock;
use wingd_base::clock::Clock;
use wingd_base::clock::exposure::{ExposureEvidence, MeasuredDelay};
use wingd_base::fault::KeyFault;

/// Section `[camera]` with `kind = "release"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReleaseSection {
    /// Contact that releases the shutter.
    pub full_press: LineSection,
    /// Contact that wakes and focuses the camera; active until after the full press.
    pub half_press: Option<LineSection>,
    /// Time from half press to full press, s.
    #[serde(default = "default_half")]
    pub half_press_s: f64,
    /// Length of the full press, s.
    #[serde(default = "default_full")]
    pub full_press_s: f64,
    /// Delay from the full press to the middle of the exposure, s.
    pub exposure_delay_s: Option<f64>,
    pub exposure_delay_sigma_s: Option<f64>,
    /// Source of the frames.
    pub frames: FramesSection,
}

/// Section `[camera.frames]`, chosen by `kind` as [`CameraSection`](crate::camera::section::CameraSection).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FramesSection {
    /// Camera on USB.
    #[cfg(feature = "gphoto")]
    Gphoto(GphotoSection),
    /// Folder of files.
    Folder(FolderSection),
    /// Video stream that delivers on a trigger.
    #[cfg(feature = "v4l")]
    V4l(V4lSection),
}

fn default_half() -> f64 {
    0.8
}

fn default_full() -> f64 {
    0.2
}

impl DriverSection for ReleaseSection {
    fn faults(&self) -> Vec<KeyFault> {
        let frames: Vec<KeyFault> = match &self.frames {
            #[cfg(feature = "gphoto")]
            FramesSection::Gphoto(section) => section.faults(),
            #[cfg(feature = "v4l")]
            FramesSection::V4l(section) => section.faults(),
            FramesSection::Folder(_) => Vec::new(),
        };
        let mut faults: Vec<KeyFault> = frames
            .into_iter()
            .map(|fault| fault.with_section("frames"))
            .collect();
        let lines = [
            ("full_press", Some(&self.full_press)),
            ("half_press", self.half_press.as_ref()),
        ];
        for (key, line) in lines {
            if line.is_some_and(|line| !line.is_clear()) {
                let remedy = "give either name, or chip and offset";
                faults.push(KeyFault::new(
                    key,
                    "does not name exactly one GPIO line",
                    remedy,
                ));
            }
        }
        faults.extend(delay_fault(
            "exposure_delay",
            self.exposure_delay_s,
            self.exposure_delay_sigma_s,
        ));
        for (key, time_s) in [
            ("half_press_s", self.half_press_s),
            ("full_press_s", self.full_press_s),
        ] {
            if !(0.01..=10.0).contains(&time_s) {
                faults.push(KeyFault::new(
                    key,
                    format!("{time_s} s"),
                    "use 0.01 to 10 s",
                ));
            }
        }
        faults
    }

    fn factory(&self, _: Arc<dyn Clock>, _: Duration) -> CameraFactory {
        let (section, last) = (self.clone(), LastName::default());
        Arc::new(move || Box::new(ReleaseCamera::new(section.clone(), last.clone())))
    }
}

/// Frame of a release, its edge, and the names of files that appeared before without a request.
type FiredShot = (CameraFrame, ReleaseEdge, Vec<String>);

/// Source of the frames of a remote release.
trait FrameSource: Camera {
    /// Presses the button and waits for the frame.
    fn fire(&mut self, press: Press, deadline: Duration) -> Result<FiredShot, CameraError>;
}

/// Function that presses the button once.
type Press<'a> = &'a (dyn Fn() -> Result<ReleaseEdge, CameraError> + Sync);

#[cfg(feature = "gphoto")]
impl FrameSource for GphotoCamera {
    fn fire(&mut self, press: Press, deadline: Duration) -> Result<FiredShot, CameraError> {
        let strays = self.drain_events()?;
        let edge = press()?;
        Ok((self.shoot_or_wait(deadline, false)?, edge, strays))
    }
}

impl FrameSource for WatchedFolder {
    fn fire(&mut self, press: Press, deadline: Duration) -> Result<FiredShot, CameraError> {
        let strays = self.unexpected_files()?;
        let edge = press()?;
        Ok((self.shoot(deadline)?, edge, strays))
    }
}

#[cfg(feature = "v4l")]
impl FrameSource for V4lCamera {
    /// Starts the stream before the release, or its frame would be missed.
    fn fire(&mut self, press: Press, deadline: Duration) -> Result<FiredShot, CameraError> {
        std::thread::scope(|scope| {
            let pressing = scope.spawn(press);
            let frame = self.shoot(deadline);
            let broke_off = |_| {
                Err(CameraError::Gone(
                    "the release failed unexpectedly".to_owned(),
                ))
            };
            let edge = pressing.join().unwrap_or_else(broke_off)?;
            Ok((frame?, edge, Vec::new()))
        })
    }
}

/// Camera on a remote release; see [`Camera`].
pub struct ReleaseCamera {
    section: ReleaseSection,
    lines: Option<ReleaseLines>,
    source: Box<dyn FrameSource>,
}

struct ReleaseLines {
    full: GpioLine,
    half: Option<GpioLine>,
}

/// Interval in which the line became active, times since boot, s.
#[derive(Clone, Copy)]
struct ReleaseEdge {
    from_s: f64,
    to_s: f64,
}

impl ReleaseLines {
    /// Presses the button once. The lines are always released.
    fn press(&self, half_s: f64, full_s: f64) -> Result<ReleaseEdge, CameraError> {
        let hold =
            |seconds| std::thread::sleep(Duration::try_from_secs_f64(seconds).unwrap_or_default());
        let half = self
            .half
            .as_ref()
            .map_or(Ok(()), |half| half.set(true).map(|()| hold(half_s)));
        let edge = half.and_then(|()| {
            let from_s = clock::since_boot_s();
            self.full.set(true).map(|()| ReleaseEdge {
                from_s,
                to_s: clock::since_boot_s(),
            })
        });
        if edge.is_ok() {
            hold(full_s);
        }
        let let_go = self
            .full
            .set(false)
            .and(self.half.as_ref().map_or(Ok(()), |half| half.set(false)));
        edge.and_then(|edge| let_go.map(|()| edge))
    }
}

impl ReleaseCamera {
    /// Creates a closed camera; no device is accessed before `open`.
    pub fn new(section: ReleaseSection, last_name: LastName) -> Self {
        let source: Box<dyn FrameSource> = match section.frames.clone() {
            #[cfg(feature = "gphoto")]
            FramesSection::Gphoto(section) => Box::new(GphotoCamera::new(section, last_name)),
            FramesSection::Folder(section) => Box::new(WatchedFolder::new(section, last_name)),
            #[cfg(feature = "v4l")]
            FramesSection::V4l(section) => Box::new(V4lCamera::new(section)),
        };
        Self {
            section,
            lines: None,
            source,
        }
    }
}

/// Sets the most precise evidence for the exposure: the edge if its delay was measured, else a driver's stamp, else edge
/// and delivery.
fn with_evidence(
    mut frame: CameraFrame,
    edge: ReleaseEdge,
    delay: Option<MeasuredDelay>,
) -> CameraFrame {
    let ReleaseEdge { from_s, to_s } = edge;
    frame.exposed = match (delay, frame.exposed) {
        (Some(delay), _) => Some(ExposureEvidence::Edge {
            from_s,
            to_s,
            delay,
        }),
        (None, Some(ExposureEvidence::Between { to_s, .. })) => {
            Some(ExposureEvidence::Between { from_s, to_s })
        }
        (None, Some(stamped)) => Some(stamped),
        (None, None) => Some(ExposureEvidence::Between {
            from_s,
            to_s: clock::since_boot_s(),
        }),
    };
    frame
}

impl Camera for ReleaseCamera {
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        self.close();
        let half = self
            .section
            .half_press
            .as_ref()
            .map(GpioLine::take)
            .transpose()?;
        self.lines = Some(ReleaseLines {
            full: GpioLine::take(&self.section.full_press)?,
            half,
        });
        self.source.open()
    }

    fn recover(&mut self, deadline: Duration) -> Result<Option<CameraFrame>, CameraError> {
        self.source.recover(deadline)
    }

    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        let lines = self.lines.as_ref().ok_or_else(CameraError::closed)?;
        let (half_s, full_s) = (self.section.half_press_s, self.section.full_press_s);
        let fired = self.source.fire(&|| lines.press(half_s, full_s), deadline);
        let (mut frame, edge, strays) = fired.map_err(|error| match error {
            CameraError::Timeout { after_s, what } => CameraError::Timeout {
                after_s,
                what: format!(
                    "{what}. The release was pressed and no frame came: check its cable, and the camera's \
                     mode and focus"
                ),
            },
            error => error,
        })?;
        if !strays.is_empty() {
            frame
                .settings
                .insert("unexpected_files".to_owned(), strays.into());
        }
        let delay = MeasuredDelay::from_config(
            self.section.exposure_delay_s,
            self.section.exposure_delay_sigma_s,
        );
        Ok(with_evidence(frame, edge, delay))
    }

    fn release_last(&mut self) -> Result<(), CameraError> {
        self.source.release_last()
    }

    fn close(&mut self) {
        self.lines = None;
        self.source.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let good = "full_press = { name = 'GPIO17' }\n[frames.folder]\npath = '/mnt/card'\n";
        let section: ReleaseSection = toml::from_str(good).unwrap();
        assert_eq!(section.faults(), []);
        let bad = "half_press_s = 0\nexposure_delay_s = 0.05\nfull_press = { name = 'GPIO17', offset = 3 }\n[frames.folder]\npath = '/mnt/card'\n";
        let keys: Vec<_> = toml::from_str::<ReleaseSection>(bad)
            .unwrap()
            .faults()
            .into_iter()
            .map(|f| f.key)
            .collect();
        assert_eq!(
            keys,
            ["full_press", "exposure_delay_sigma_s", "half_press_s"]
        );
        assert!(toml::from_str::<ReleaseSection>(&good.replace("path", "pth")).is_err());
    }

    #[test]
    fn a_measured_delay_makes_the_edge_the_evidence() {
        let edge = ReleaseEdge {
            from_s: 5.0,
            to_s: 5.001,
        };
        let settings = serde_json::Map::new();
        let frame = |exposed| CameraFrame {
            bytes: vec![],
            format: wingd_evaluation::frame_format::Format::Jpeg,
            settings: settings.clone(),
            exposed,
        };
        let delay = MeasuredDelay {
            seconds: 0.05,
            sigma_s: 0.002,
        };
        let dated = with_evidence(frame(None), edge, Some(delay)).exposed;
        assert_eq!(
            dated,
            Some(ExposureEvidence::Edge {
                from_s: 5.0,
                to_s: 5.001,
                delay
            })
        );
        let answered = Some(ExposureEvidence::Between {
            from_s: 1.0,
            to_s: 6.0,
        });
        assert_eq!(
            with_evidence(frame(answered), edge, None).exposed,
            Some(ExposureEvidence::Between {
                from_s: 5.0,
                to_s: 6.0
            })
        );
        let stamped = Some(ExposureEvidence::EndOfFrame {
            at_s: 5.2,
            exposure_s: None,
            period_s: 0.1,
            delay: None,
        });
        assert_eq!(with_evidence(frame(stamped), edge, None).exposed, stamped);
    }

    #[test]
    fn a_missing_line_is_refused_with_its_name() {
        let section = "full_press = { chip = '/dev/no-such-chip', offset = 3 }\n[frames.folder]\npath = '/'\n";
        let mut camera = ReleaseCamera::new(toml::from_str(section).unwrap(), LastName::default());
        let error = camera.open().unwrap_err();
        assert!(
            matches!(&error, CameraError::Refused(why) if why.contains("/dev/no-such-chip")),
            "{error}"
        );
    }
}
