//! Still cameras on USB, through libgphoto2.
//!
//! The library keeps one global thread, and a call into it cannot be cancelled: a hung camera would hang the recorder. It
//! therefore runs in a process of its own (this program, started again), which is killed at its deadline and restarted.
//! Between series there is no such process.

pub mod child;
mod driver;
mod faults;
mod process;
mod protocol;
mod settings;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::camera::freshness::LastName;
use crate::camera::{
    Camera, CameraError, CameraFactory, CameraFrame, CameraInfo, DriverSection, jpeg,
};
use process::CameraProcess;
use protocol::{CameraAnswer, CardImage, Request};
use wingd_base::clock::Clock;
use wingd_base::clock::exposure::ExposureEvidence;
use wingd_base::fault::KeyFault;
use wingd_evaluation::frame_format::Format;

/// Key in a shot's settings: time since boot before the trigger, s. Both processes share that clock.
const REQUEST_TIME_KEY: &str = "asked_since_boot_s";
/// Key in a shot's settings: time since boot of the camera's image event, s.
const RESPONSE_TIME_KEY: &str = "response_since_boot_s";
/// Hidden command that makes this program a camera process.
pub const CHILD_COMMAND: &str = "camera-child";
/// Deadline of requests that neither wait for the shutter nor transfer an image.
const SHORT_LIMIT: Duration = Duration::from_secs(10);
/// Running program, even if an upgrade has replaced its file.
const PROGRAM: &str = "/proc/self/exe";
/// Returns the time after which the camera process is killed: after its own deadline, and before the recorder gives up the
/// camera.
fn kill_deadline(deadline: Duration) -> Duration {
    deadline + (deadline / 8).max(Duration::from_millis(150))
}

/// Section `[camera]` with `kind = "gphoto"`. Without `model` and `port`, the only camera there is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GphotoSection {
    /// Part of the model's name, as `gphoto2 --auto-detect` prints it.
    pub model: Option<String>,
    /// Port, such as `usb:001,004`; it changes with every connection.
    pub port: Option<String>,
    /// Setting -> value, as `gphoto2 --get-config NAME` prints it; set and read back before each series.
    pub settings: BTreeMap<String, String>,
    /// Maximum time for finding and setting up the camera, s.
    pub open_s: f64,
    /// Delete an image on the card once our copy is durable.
    pub delete: bool,
    /// Take over images found on the card, if there are at most this many; more are assumed to be somebody else's and left
    /// alone. 0: never.
    pub recover: usize,
}

impl Default for GphotoSection {
    fn default() -> Self {
        Self {
            model: None,
            port: None,
            settings: BTreeMap::new(),
            open_s: 30.0,
            delete: true,
            recover: 40,
        }
    }
}

impl DriverSection for GphotoSection {
    fn faults(&self) -> Vec<KeyFault> {
        let sane = (1.0..=600.0).contains(&self.open_s);
        let fault = || KeyFault::new("open_s", format!("{} s", self.open_s), "use 1 to 600 s");
        (!sane).then(fault).into_iter().collect()
    }

    fn factory(&self, _: Arc<dyn Clock>, _: Duration) -> CameraFactory {
        let (section, last) = (self.clone(), LastName::default());
        Arc::new(move || Box::new(GphotoCamera::new(section.clone(), last.clone())))
    }
}

/// Still camera on USB; see [`Camera`].
pub struct GphotoCamera {
    section: GphotoSection,
    process: Option<CameraProcess>,
    last_name: LastName,
}

impl GphotoCamera {
    /// Creates a closed camera; no device is accessed before `open`.
    pub fn new(section: GphotoSection, last_name: LastName) -> Self {
        Self {
            section,
            process: None,
            last_name,
        }
    }

    /// Sends a request to the camera process; drops the process if it can no longer be used.
    fn ask<T: DeserializeOwned>(
        &mut self,
        request: &Request,
        limit: Duration,
        what: &str,
    ) -> CameraAnswer<(T, Vec<u8>)> {
        let process = self.process.as_mut().ok_or_else(CameraError::closed)?;
        let answer = process.ask(request, limit, what);
        if matches!(answer, Err(CameraError::Gone(_))) || !process.is_alive() {
            self.process = None;
        }
        answer
    }

    /// Returns images that appeared without a shot; called just before an external release of the shutter.
    pub fn drain_events(&mut self) -> Result<Vec<String>, CameraError> {
        self.ask(&Request::Drain, SHORT_LIMIT, "the camera's events")
            .map(|(paths, _)| paths)
    }

    /// Takes a shot, or with `trigger` false waits for one released externally.
    pub fn shoot_or_wait(
        &mut self,
        deadline: Duration,
        trigger: bool,
    ) -> Result<CameraFrame, CameraError> {
        let request = Request::Shoot {
            deadline_s: deadline.as_secs_f64(),
            trigger,
        };
        let (image, bytes): (CardImage, _) =
            self.ask(&request, kill_deadline(deadline), "a shot")?;
        jpeg::check_complete(&bytes).map_err(|why| CameraError::BadFrame(why.to_string()))?;
        self.last_name.check(&image.path)?;
        let exposed = exposure_evidence(&image.settings);
        Ok(CameraFrame {
            bytes,
            format: Format::Jpeg,
            settings: image.settings,
            exposed,
        })
    }
}

/// Returns the interval between the trigger and the camera's image event.
fn exposure_evidence(
    settings: &serde_json::Map<String, serde_json::Value>,
) -> Option<ExposureEvidence> {
    let time = |key: &str| settings.get(key).and_then(serde_json::Value::as_f64);
    Some(ExposureEvidence::Between {
        from_s: time(REQUEST_TIME_KEY)?,
        to_s: time(RESPONSE_TIME_KEY)?,
    })
}

impl Camera for GphotoCamera {
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        self.close();
        self.process = Some(CameraProcess::start(PROGRAM, &[CHILD_COMMAND])?);
        let request = Request::Open {
            section: self.section.clone(),
        };
        let limit =
            Duration::try_from_secs_f64(self.section.open_s).unwrap_or(Duration::from_secs(30));
        let opened = self.ask(&request, limit, "the setup of the camera");
        if opened.is_err() {
            self.close();
        }
        opened.map(|(info, _)| info)
    }

    fn recover(&mut self, deadline: Duration) -> Result<Option<CameraFrame>, CameraError> {
        let (image, bytes) = self.ask(&Request::Recover, deadline, "an image from the card")?;
        let frame = |image: CardImage| CameraFrame {
            bytes,
            format: Format::Jpeg,
            settings: image.settings,
            exposed: None,
        };
        Ok(Option::map(image, frame))
    }

    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        self.shoot_or_wait(deadline, true)
    }

    fn release_last(&mut self) -> Result<(), CameraError> {
        self.ask(
            &Request::Release,
            SHORT_LIMIT,
            "the deletion of an image on the card",
        )
        .map(|((), _)| ())
    }

    fn close(&mut self) {
        self.process = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let section: GphotoSection =
            toml::from_str("model='D750'\n[settings]\nfocusmode='Manual'\n'f-number'='f/8'")
                .unwrap();
        assert_eq!(section.settings["f-number"], "f/8");
        assert!(section.delete && section.recover > 0);
        assert_eq!(section.faults(), []);
        let odd = GphotoSection {
            open_s: f64::NAN,
            ..GphotoSection::default()
        };
        assert_eq!(odd.faults().len(), 1);
        assert!(toml::from_str::<GphotoSection>("modle='D750'").is_err());
    }

    #[test]
    fn a_closed_camera_is_gone() {
        let mut camera = GphotoCamera::new(GphotoSection::default(), LastName::default());
        assert!(matches!(
            camera.shoot(Duration::from_secs(1)),
            Err(CameraError::Gone(_))
        ));
        assert!(matches!(camera.release_last(), Err(CameraError::Gone(_))));
    }
}
