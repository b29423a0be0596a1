//! Cameras behind Video for Linux (V4L2): webcams, CSI cameras and frame grabbers.

pub mod controls;
mod find;
mod stream;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use v4l::video::Capture;
use v4l::{Device, FourCC};

use crate::camera::deadline::Deadline;
use crate::camera::delay::delay_fault;
use crate::camera::{
    Camera, CameraError, CameraFactory, CameraFrame, CameraInfo, DriverSection, jpeg,
};
use wingd_base::clock;
use wingd_base::clock::Clock;
use wingd_base::clock::exposure::{ExposureEvidence, MeasuredDelay};
use wingd_base::fault::KeyFault;
use wingd_evaluation::frame_format::Format;

/// Section `[camera]` with `kind = "v4l"`. One of `device` and `card` names the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct V4lSection {
    /// Device node; preferably one of `/dev/v4l/by-id/…`, which keeps its name.
    pub device: Option<PathBuf>,
    /// Name of the card, as printed by `v4l2-ctl --list-devices`.
    pub card: Option<String>,
    /// FourCC, such as `GREY`, `YUYV`, `MJPG`, `RG10`.
    pub format: String,
    pub width: u32,
    pub height: u32,
    /// Number of frames discarded before each shot, while exposure and white level settle.
    #[serde(default = "default_settle")]
    pub settle_frames: u32,
    /// Delay from the driver's stamp of a frame to the middle of its exposure, s; negative for stamps at the frame's end.
    pub stamp_delay_s: Option<f64>,
    pub stamp_delay_sigma_s: Option<f64>,
    /// Control -> value, set before each series and read back.
    #[serde(default)]
    pub controls: BTreeMap<String, i64>,
}

fn default_settle() -> u32 {
    4
}

impl DriverSection for V4lSection {
    fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        if self.device.is_none() && self.card.is_none() {
            faults.push(KeyFault::new(
                "device",
                "no camera is specified",
                "give device or card",
            ));
        }
        if parse_fourcc(&self.format).is_none() {
            let remedy = "use four letters such as GREY, YUYV, MJPG or RG10";
            faults.push(KeyFault::new(
                "format",
                format!("{:?} is not a FourCC", self.format),
                remedy,
            ));
        }
        if self.width < 16 || self.height < 16 {
            let problem = format!(
                "{} x {} px is too small for an image",
                self.width, self.height
            );
            faults.push(KeyFault::new(
                "width",
                problem,
                "give the camera's full size",
            ));
        }
        faults.extend(delay_fault(
            "stamp_delay",
            self.stamp_delay_s,
            self.stamp_delay_sigma_s,
        ));
        for name in self
            .controls
            .keys()
            .filter(|name| controls::control_id(name).is_none())
        {
            let remedy = format!(
                "use 0x followed by the control's id, or one of: {}",
                controls::control_names()
            );
            faults.push(KeyFault::new(
                format!("controls.{name}"),
                "is not a known control",
                remedy,
            ));
        }
        faults
    }

    fn factory(&self, _: Arc<dyn Clock>, _: Duration) -> CameraFactory {
        let section = self.clone();
        Arc::new(move || Box::new(V4lCamera::new(section.clone())))
    }
}

/// Parses a FourCC; `Y10` is short for `Y10 `, as the kernel pads it.
fn parse_fourcc(name: &str) -> Option<FourCC> {
    let mut code = [b' '; 4];
    let bytes = name.as_bytes();
    (bytes.is_ascii() && (3..=4).contains(&bytes.len()))
        .then(|| code[..bytes.len()].copy_from_slice(bytes))?;
    Some(FourCC::new(&code))
}

/// Camera behind Video for Linux; see [`Camera`].
pub struct V4lCamera {
    section: V4lSection,
    opened: Option<OpenDevice>,
}

struct OpenDevice {
    device: Device,
    format: Format,
    /// Minimum number of bytes of a complete frame.
    min_bytes: usize,
    live: Option<LiveStream>,
}

/// Stream of live frames.
struct LiveStream {
    running: stream::RunningStream,
    /// Controls as last read.
    settings: Map<String, Value>,
    /// Number of frames since the controls were read.
    frames: u32,
}

/// Unit of the control `exposure_time_absolute`, s (V4L2 API, camera controls).
const EXPOSURE_UNIT_S: f64 = 1e-4;
/// Number of live frames between two reads of the controls.
const CONTROLS_EVERY: u32 = 50;

impl V4lCamera {
    /// Creates a closed camera; no device is accessed before `open`.
    pub fn new(section: V4lSection) -> Self {
        Self {
            section,
            opened: None,
        }
    }

    fn open_device(&mut self) -> Result<CameraInfo, CameraError> {
        let path = find::find_device(&self.section)?;
        let node = path.display().to_string();
        let device = Device::with_path(&path).map_err(|e| stream::classify_error(&e, &node))?;
        let caps = device
            .query_caps()
            .map_err(|e| stream::classify_error(&e, &node))?;
        if !caps
            .capabilities
            .contains(v4l::capability::Flags::VIDEO_CAPTURE | v4l::capability::Flags::STREAMING)
        {
            return Err(CameraError::Refused(format!(
                "{node} ({}) does not stream images; name another node",
                caps.card
            )));
        }
        let (format, min_bytes) = negotiate_format(&device, &self.section, &node)?;
        let (mut settings, warnings) = controls::apply_controls(&device, &self.section.controls);
        settings.insert("device".to_owned(), node.into());
        settings.insert("bus".to_owned(), caps.bus.clone().into());
        settings.insert("format".to_owned(), json!(format));
        self.opened = Some(OpenDevice {
            device,
            format,
            min_bytes,
            live: None,
        });
        Ok(CameraInfo {
            name: format!("{} ({}, {})", caps.card, caps.driver, caps.bus),
            settings,
            warnings,
            repeats_after: None,
        })
    }

    /// Takes a shot with a stream of its own.
    fn take_shot(&mut self, deadline: &Deadline) -> Result<CameraFrame, CameraError> {
        let opened = self.opened.as_ref().ok_or_else(CameraError::closed)?;
        let (settings, drift) = controls::restore_controls(&opened.device, &self.section.controls);
        let got = stream::grab_frame(
            &opened.device,
            self.section.settle_frames,
            opened.min_bytes,
            deadline,
        )?;
        if opened.format == Format::Jpeg {
            jpeg::check_complete(&got.bytes)
                .map_err(|why| CameraError::BadFrame(why.to_string()))?;
        }
        Ok(self.build_frame(opened.format.clone(), settings, drift, got))
    }

    fn take_live_frame(&mut self, deadline: &Deadline) -> Result<CameraFrame, CameraError> {
        let opened = self.opened.as_mut().ok_or_else(CameraError::closed)?;
        let mut live = match opened.live.take() {
            Some(live) => live,
            None => LiveStream {
                running: stream::RunningStream::start(&opened.device, self.section.settle_frames)?,
                settings: Map::new(),
                frames: 0,
            },
        };
        let mut drift = Vec::new();
        if live.frames.is_multiple_of(CONTROLS_EVERY) {
            (live.settings, drift) =
                controls::restore_controls(&opened.device, &self.section.controls);
        }
        live.frames = live.frames.wrapping_add(1);
        let got = match live.running.next_frame(opened.min_bytes, deadline) {
            Ok(got) => got,
            Err(error) => {
                live.running.stop();
                return Err(error);
            }
        };
        let (format, settings) = (opened.format.clone(), live.settings.clone());
        opened.live = Some(live);
        Ok(self.build_frame(format, settings, drift, got))
    }

    /// Builds the frame from the driver's data.
    fn build_frame(
        &self,
        format: Format,
        mut settings: Map<String, Value>,
        drift: Vec<String>,
        got: stream::GrabbedFrame,
    ) -> CameraFrame {
        settings.insert("sequence".to_owned(), got.sequence.into());
        settings.insert("driver_time_s".to_owned(), got.time_s.into());
        settings.insert("dropped_frames".to_owned(), got.dropped.into());
        settings.insert("damaged_frames".to_owned(), got.damaged.into());
        settings.insert("stale_frames".to_owned(), got.stale.into());
        if !drift.is_empty() {
            settings.insert("warnings".to_owned(), drift.into());
        }
        let exposed = self.exposure_evidence(&settings, &got);
        CameraFrame {
            bytes: got.bytes,
            format,
            settings,
            exposed,
        }
    }

    fn take_or_close_if_gone(
        &mut self,
        take: impl FnOnce(&mut Self) -> Result<CameraFrame, CameraError>,
    ) -> Result<CameraFrame, CameraError> {
        let taken = catch_panic(|| take(self));
        if matches!(taken, Err(CameraError::Gone(_))) {
            self.close();
        }
        taken
    }

    fn stop_live_stream(&mut self) {
        if let Some(live) = self.opened.as_mut().and_then(|opened| opened.live.take()) {
            live.running.stop();
        }
    }

    /// Returns the evidence from the driver's stamp; `None` if it uses another clock.
    fn exposure_evidence(
        &self,
        settings: &Map<String, Value>,
        got: &stream::GrabbedFrame,
    ) -> Option<ExposureEvidence> {
        let at_s = clock::since_boot_from_monotonic(got.monotonic.then_some(got.time_s)?);
        let length = settings
            .get("exposure_time_absolute")
            .and_then(Value::as_f64);
        let exposure_s = length.map(|units| units * EXPOSURE_UNIT_S);
        let (period_s, delay) = (
            got.period_s,
            MeasuredDelay::from_config(
                self.section.stamp_delay_s,
                self.section.stamp_delay_sigma_s,
            ),
        );
        Some(match got.stamped_at_start {
            true => ExposureEvidence::StartOfExposure {
                at_s,
                exposure_s,
                period_s,
                delay,
            },
            false => ExposureEvidence::EndOfFrame {
                at_s,
                exposure_s,
                period_s,
                delay,
            },
        })
    }
}

/// Sets the video format and checks it: a driver silently chooses another one if it cannot provide it.
fn negotiate_format(
    device: &Device,
    section: &V4lSection,
    node: &str,
) -> Result<(Format, usize), CameraError> {
    let wrong = || {
        CameraError::Refused(format!(
            "format {:?} is not a FourCC; correct camera.format",
            section.format
        ))
    };
    let code = parse_fourcc(&section.format).ok_or_else(wrong)?;
    // A new value with stride and size 0, as the present ones would be kept for the new format.
    let asked = v4l::Format::new(section.width, section.height, code);
    let got = device
        .set_format(&asked)
        .map_err(|e| stream::classify_error(&e, &format!("{node}: format {code}")))?;
    if (got.fourcc, got.width, got.height) != (code, section.width, section.height) {
        return Err(CameraError::Refused(format!(
            "{node} gives {} {} x {} px instead of {code} {} x {} px; it offers {}",
            got.fourcc,
            got.width,
            got.height,
            section.width,
            section.height,
            describe_formats(device)
        )));
    }
    if matches!(&code.repr, b"MJPG" | b"JPEG") {
        return Ok((Format::Jpeg, 4));
    }
    let raw = Format::Raw {
        fourcc: code.to_string().trim_end().to_owned(),
        width: got.width,
        height: got.height,
        stride: got.stride,
    };
    let min_bytes = (got.stride as usize).saturating_mul(got.height as usize);
    Ok((raw, min_bytes))
}

/// Describes formats and sizes of a device, for the message.
fn describe_formats(device: &Device) -> String {
    let formats = device.enum_formats().unwrap_or_default();
    let list: Vec<_> = formats
        .iter()
        .map(|format| {
            let sizes = device.enum_framesizes(format.fourcc).unwrap_or_default();
            let sizes: Vec<_> = sizes.iter().map(|size| size.size.to_string()).collect();
            format!("{} ({})", format.fourcc, sizes.join(", "))
        })
        .collect();
    list.join("; ")
}

/// Converts a panic of the binding to an error of the camera. It panics on some answers of drivers (texts that are not
/// UTF-8, new colour spaces).
fn catch_panic<T>(call: impl FnOnce() -> Result<T, CameraError>) -> Result<T, CameraError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(call)).unwrap_or_else(|_| {
        Err(CameraError::Refused(
            "the driver gave an invalid answer".to_owned(),
        ))
    })
}

impl Camera for V4lCamera {
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        self.close();
        catch_panic(|| self.open_device())
    }

    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        let deadline = Deadline::new(deadline);
        self.stop_live_stream();
        self.take_or_close_if_gone(|camera| camera.take_shot(&deadline))
    }

    fn next_live_frame(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        let deadline = Deadline::new(deadline);
        self.take_or_close_if_gone(|camera| camera.take_live_frame(&deadline))
    }

    fn is_stream(&self) -> bool {
        true
    }

    fn close(&mut self) {
        self.stop_live_stream();
        self.opened = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let text = "card='Wing cam'\nformat='RG10'\nwidth=4000\nheight=3000\n[controls]\nauto_exposure=1\ngain=0\n";
        let section: V4lSection = toml::from_str(text).unwrap();
        assert_eq!(section.faults(), []);
        assert_eq!(section.settle_frames, 4);
        let bad = "format='GREYISH'\nwidth=4000\nheight=0\n[controls]\nexposur=1\n";
        let keys: Vec<_> = toml::from_str::<V4lSection>(bad)
            .unwrap()
            .faults()
            .into_iter()
            .map(|f| f.key)
            .collect();
        assert_eq!(keys, ["device", "format", "width", "controls.exposur"]);
        assert!(toml::from_str::<V4lSection>("format='GREY'\nwidth=1\nheight=1\nwidht=2").is_err());
        assert_eq!(parse_fourcc("Y10").unwrap().repr, *b"Y10 ");
        assert!(parse_fourcc("Ä10").is_none());
    }

    #[test]
    fn a_missing_camera_is_gone_and_a_panic_stays_inside() {
        let section: V4lSection =
            toml::from_str("device='/dev/no-such'\nformat='GREY'\nwidth=16\nheight=16").unwrap();
        assert!(matches!(
            find::find_device(&section),
            Err(CameraError::Gone(_))
        ));
        assert!(matches!(
            catch_panic::<()>(|| unreachable!()),
            Err(CameraError::Refused(_))
        ));
    }
}
