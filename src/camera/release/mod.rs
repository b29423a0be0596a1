//! A camera whose remote release hangs on GPIO lines. The frame then comes over USB, as a file in a
//! watched folder, or through V4L2. A shot without a frame is an error; a frame without a shot is
//! noted with the next shot.

mod folder;
mod line;

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::camera::deadline::Deadline;
use crate::camera::freshness::Freshness;
#[cfg(feature = "gphoto")]
use crate::camera::gphoto::{GphotoCamera, GphotoSection};
use crate::camera::section::delay_fault;
#[cfg(feature = "v4l")]
use crate::camera::v4l::{V4lCamera, V4lSection};
use crate::camera::{Camera, CameraError, CameraInfo, Frame};
use crate::clock;
use crate::clock::exposure::{Delay, Evidence};
use crate::installation::KeyFault;
use folder::Folder;
pub use folder::FolderSection;
pub(crate) use line::Line;
pub use line::LineSection;

/// `[camera]` with `kind = "release"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReleaseSection {
    /// Contact that takes the picture.
    pub full_press: LineSection,
    /// Contact that wakes and focuses the camera; held until after the full press.
    pub half_press: Option<LineSection>,
    /// From half press to full press, s.
    #[serde(default = "default_half")]
    pub half_press_s: f64,
    /// Length of the full press, s.
    #[serde(default = "default_full")]
    pub full_press_s: f64,
    /// From the full press to the middle of the exposure, s.
    pub exposure_delay_s: Option<f64>,
    /// Standard deviation of that, s.
    pub exposure_delay_sigma_s: Option<f64>,
    /// Where the frames come from.
    pub frames: FramesSection,
}

/// `[camera.frames]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum FramesSection {
    /// Over USB.
    #[cfg(feature = "gphoto")]
    Gphoto(GphotoSection),
    /// As files.
    Folder(FolderSection),
    /// As a video stream that delivers on its trigger.
    #[cfg(feature = "v4l")]
    V4l(V4lSection),
}

fn default_half() -> f64 {
    0.8
}

fn default_full() -> f64 {
    0.2
}

impl ReleaseSection {
    /// Every fault, at its key of the section.
    pub fn faults(&self) -> Vec<KeyFault> {
        let frames = match &self.frames {
            #[cfg(feature = "gphoto")]
            FramesSection::Gphoto(section) => section.faults(),
            #[cfg(feature = "v4l")]
            FramesSection::V4l(section) => section.faults(),
            FramesSection::Folder(_) => Vec::new(),
        };
        let mut faults: Vec<KeyFault> = frames.into_iter().map(|fault| fault.within("frames")).collect();
        let lines = [("full_press", Some(&self.full_press)), ("half_press", self.half_press.as_ref())];
        for (key, line) in lines {
            if line.is_some_and(|line| !line.is_clear()) {
                let mend = "give either name, or chip and offset";
                faults.push(KeyFault::new(key, "no single GPIO line is named", mend));
            }
        }
        faults.extend(delay_fault("exposure_delay", self.exposure_delay_s, self.exposure_delay_sigma_s));
        for (key, time_s) in [("half_press_s", self.half_press_s), ("full_press_s", self.full_press_s)] {
            if !(0.01..=10.0).contains(&time_s) {
                faults.push(KeyFault::new(key, format!("{time_s} s"), "use 0.01 to 10 s"));
            }
        }
        faults
    }
}

enum Frames {
    #[cfg(feature = "gphoto")]
    Gphoto(Box<GphotoCamera>),
    Folder(FolderSection, Option<Folder>),
    #[cfg(feature = "v4l")]
    V4l(Box<V4lCamera>),
}

/// The camera; see [`Camera`].
pub struct ReleaseCamera {
    section: ReleaseSection,
    lines: Option<Lines>,
    frames: Frames,
    freshness: Freshness,
}

struct Lines {
    full: Line,
    half: Option<Line>,
}

/// When the line was pulled: between two times since boot, s.
#[derive(Clone, Copy)]
struct Edge {
    from_s: f64,
    to_s: f64,
}

impl Lines {
    /// One press of the button. The lines are let go of whatever happens.
    fn press(&self, half_s: f64, full_s: f64) -> Result<Edge, CameraError> {
        let hold = |seconds| std::thread::sleep(Duration::try_from_secs_f64(seconds).unwrap_or_default());
        let half = self.half.as_ref().map_or(Ok(()), |half| half.set(true).map(|()| hold(half_s)));
        let edge = half.and_then(|()| {
            let from_s = clock::since_boot_s();
            self.full.set(true).map(|()| Edge { from_s, to_s: clock::since_boot_s() })
        });
        if edge.is_ok() {
            hold(full_s);
        }
        let let_go = self.full.set(false).and(self.half.as_ref().map_or(Ok(()), |half| half.set(false)));
        edge.and_then(|edge| let_go.map(|()| edge))
    }
}

impl ReleaseCamera {
    /// Nothing is touched before `open`.
    pub fn new(section: ReleaseSection, freshness: Freshness) -> Self {
        let frames = match section.frames.clone() {
            #[cfg(feature = "gphoto")]
            FramesSection::Gphoto(section) => {
                Frames::Gphoto(Box::new(GphotoCamera::new(section, freshness.clone())))
            }
            FramesSection::Folder(section) => Frames::Folder(section, None),
            #[cfg(feature = "v4l")]
            FramesSection::V4l(section) => Frames::V4l(Box::new(V4lCamera::new(section, freshness.clone()))),
        };
        Self { section, lines: None, frames, freshness }
    }

    /// Presses and takes the frame; also the frames that came before, unasked.
    fn fire(&mut self, deadline: Duration) -> Result<(Frame, Vec<String>), CameraError> {
        let closed = || CameraError::Gone("the camera is not open".to_owned());
        let lines = self.lines.as_ref().ok_or_else(closed)?;
        let (half_s, full_s) = (self.section.half_press_s, self.section.full_press_s);
        let delay = Delay::of(self.section.exposure_delay_s, self.section.exposure_delay_sigma_s);
        match &mut self.frames {
            #[cfg(feature = "gphoto")]
            Frames::Gphoto(camera) => {
                let strays = camera.drain()?;
                let edge = lines.press(half_s, full_s)?;
                let frame = camera.shoot_or_wait(deadline, false)?;
                Ok((exposed(frame, edge, delay), strays))
            }
            Frames::Folder(_, folder) => {
                let folder = folder.as_mut().ok_or_else(closed)?;
                let strays = folder.unexpected()?;
                let edge = lines.press(half_s, full_s)?;
                let frame = folder.wait(&Deadline::after(deadline))?;
                let name = frame.settings.get("camera_path").and_then(Value::as_str);
                self.freshness.check(&frame.bytes, name)?;
                Ok((exposed(frame, edge, delay), strays))
            }
            // The stream must run before the release, or its frame is missed.
            #[cfg(feature = "v4l")]
            Frames::V4l(camera) => std::thread::scope(|scope| {
                let press = scope.spawn(|| lines.press(half_s, full_s));
                let frame = camera.shoot(deadline);
                let pressed = press.join().unwrap_or_else(|_| Err(closed()));
                pressed.and_then(|edge| Ok((exposed(frame?, edge, delay), Vec::new())))
            }),
        }
    }

    fn source(&mut self) -> Option<&mut dyn Camera> {
        match &mut self.frames {
            #[cfg(feature = "gphoto")]
            Frames::Gphoto(camera) => Some(camera.as_mut()),
            #[cfg(feature = "v4l")]
            Frames::V4l(camera) => Some(camera.as_mut()),
            Frames::Folder(..) => None,
        }
    }
}

/// The edge tells the exposure best where its delay was measured; else a driver's stamp, else edge and delivery.
fn exposed(mut frame: Frame, edge: Edge, delay: Option<Delay>) -> Frame {
    let Edge { from_s, to_s } = edge;
    frame.exposed = match (delay, frame.exposed) {
        (Some(delay), _) => Some(Evidence::Edge { from_s, to_s, delay }),
        (None, Some(Evidence::Between { to_s, .. })) => Some(Evidence::Between { from_s, to_s }),
        (None, Some(stamped)) => Some(stamped),
        (None, None) => Some(Evidence::Between { from_s, to_s: clock::since_boot_s() }),
    };
    frame
}

impl Camera for ReleaseCamera {
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        self.close();
        let half = self.section.half_press.as_ref().map(Line::take).transpose()?;
        self.lines = Some(Lines { full: Line::take(&self.section.full_press)?, half });
        #[cfg_attr(not(any(feature = "gphoto", feature = "v4l")), allow(irrefutable_let_patterns))]
        if let Frames::Folder(section, folder) = &mut self.frames {
            let name = format!("remote release, files in {}", section.path.display());
            *folder = Some(Folder::open(section.clone())?);
            return Ok(CameraInfo { name, ..CameraInfo::default() });
        }
        self.source().map_or_else(|| Ok(CameraInfo::default()), Camera::open)
    }

    fn recover(&mut self, deadline: Duration) -> Result<Option<Frame>, CameraError> {
        self.source().map_or(Ok(None), |source| source.recover(deadline))
    }

    fn shoot(&mut self, deadline: Duration) -> Result<Frame, CameraError> {
        match self.fire(deadline) {
            Ok((mut frame, strays)) => {
                if !strays.is_empty() {
                    frame.settings.insert("unexpected_files".to_owned(), strays.into());
                }
                Ok(frame)
            }
            Err(CameraError::Timeout { after_s, what }) => {
                let what = format!(
                    "{what}. The release was pressed and no frame came: check its cable, the camera's mode and focus"
                );
                Err(CameraError::Timeout { after_s, what })
            }
            Err(error) => Err(error),
        }
    }

    fn release_last(&mut self) -> Result<(), CameraError> {
        match &mut self.frames {
            Frames::Folder(_, folder) => folder.as_mut().map_or(Ok(()), Folder::release),
            #[cfg(any(feature = "gphoto", feature = "v4l"))]
            _ => self.source().map_or(Ok(()), Camera::release_last),
        }
    }

    fn close(&mut self) {
        self.lines = None;
        match &mut self.frames {
            Frames::Folder(_, folder) => *folder = None,
            #[cfg(any(feature = "gphoto", feature = "v4l"))]
            _ => {
                if let Some(source) = self.source() {
                    source.close();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let good = "full_press = { name = 'GPIO17' }\n[frames]\nkind = 'folder'\npath = '/mnt/card'\n";
        let section: ReleaseSection = toml::from_str(good).unwrap();
        assert_eq!(section.faults(), []);
        let bad = "half_press_s = 0\nexposure_delay_s = 0.05\nfull_press = { name = 'GPIO17', offset = 3 }\n[frames]\nkind = 'folder'\npath = '/mnt/card'\n";
        let keys: Vec<_> =
            toml::from_str::<ReleaseSection>(bad).unwrap().faults().into_iter().map(|f| f.key).collect();
        assert_eq!(keys, ["full_press", "exposure_delay_sigma_s", "half_press_s"]);
        assert!(toml::from_str::<ReleaseSection>(&good.replace("path", "pth")).is_err());
    }

    #[test]
    fn a_measured_delay_makes_the_edge_the_evidence() {
        let edge = Edge { from_s: 5.0, to_s: 5.001 };
        let settings = serde_json::Map::new();
        let frame = |exposed| Frame {
            bytes: vec![],
            format: crate::camera::Format::Jpeg,
            settings: settings.clone(),
            exposed,
        };
        let delay = Delay { seconds: 0.05, sigma_s: 0.002 };
        let told = exposed(frame(None), edge, Some(delay)).exposed;
        assert_eq!(told, Some(Evidence::Edge { from_s: 5.0, to_s: 5.001, delay }));
        let answered = Some(Evidence::Between { from_s: 1.0, to_s: 6.0 });
        assert_eq!(
            exposed(frame(answered), edge, None).exposed,
            Some(Evidence::Between { from_s: 5.0, to_s: 6.0 })
        );
        let stamped = Some(Evidence::EndOfFrame { at_s: 5.2, exposure_s: None, period_s: 0.1, delay: None });
        assert_eq!(exposed(frame(stamped), edge, None).exposed, stamped);
    }

    #[test]
    fn a_missing_line_is_refused_with_its_name() {
        let section = "full_press = { chip = '/dev/no-such-chip', offset = 3 }\n[frames]\nkind = 'folder'\npath = '/'\n";
        let mut camera = ReleaseCamera::new(toml::from_str(section).unwrap(), Freshness::default());
        let error = camera.open().unwrap_err();
        assert!(matches!(&error, CameraError::Refused(why) if why.contains("/dev/no-such-chip")), "{error}");
    }
}
