//! Driver of the camera, inside the camera process.

use std::time::Duration;

use gphoto2::camera::CameraEvent;
use gphoto2::{Camera, Context};
use serde_json::{Map, Value};

use crate::camera::deadline::Deadline;
use crate::camera::gphoto::protocol::CardImage;
use crate::camera::gphoto::{GphotoSection, REQUEST_TIME_KEY, RESPONSE_TIME_KEY, faults, settings};
use crate::camera::{CameraError, CameraInfo, jpeg};
use wingd_base::clock;

/// Minimum free space on the card, bytes: below it the card counts as full.
const MIN_FREE_BYTES: u64 = 8 << 20;

/// File on the card.
#[derive(Clone, Debug, PartialEq)]
struct CardFile {
    folder: String,
    name: String,
}

impl CardFile {
    fn path(&self) -> String {
        format!("{}/{}", self.folder.trim_end_matches('/'), self.name)
    }

    fn is_jpeg(&self) -> bool {
        let name = self.name.to_ascii_lowercase();
        name.ends_with(".jpg") || name.ends_with(".jpeg")
    }
}

/// Open camera.
pub struct GphotoDriver {
    context: Context,
    camera: Camera,
    delete: bool,
    leftovers: Vec<CardFile>,
    last: Option<CardFile>,
}

impl GphotoDriver {
    /// Finds and sets up the camera.
    pub fn open(section: &GphotoSection) -> Result<(Self, CameraInfo), CameraError> {
        let context = Context::new().map_err(|e| faults::classify_error(&e, "libgphoto2"))?;
        let (camera, model) = find_camera(&context, section)?;
        let (mut settings, mut warnings) = settings::apply_settings(&camera, &section.settings);
        settings.extend(free_space(&camera));
        let mut driver = Self {
            context,
            camera,
            delete: section.delete,
            leftovers: Vec::new(),
            last: None,
        };
        if section.recover > 0 {
            driver.leftovers = driver
                .list_images()
                .map_err(|e| faults::classify_error(&e, "listing the card"))?;
        }
        if driver.leftovers.len() > section.recover {
            warnings.push(format!(
                "{} images on the card are not taken over, as camera.recover is {}: copy them elsewhere and \
                 format the card",
                driver.leftovers.len(),
                section.recover
            ));
            driver.leftovers.clear();
        }
        let serial = settings.get("serialnumber").and_then(Value::as_str);
        let name = serial.map_or(model.clone(), |serial| format!("{model}, serial {serial}"));
        Ok((
            driver,
            CameraInfo {
                name,
                settings,
                warnings,
                repeats_after: None,
            },
        ))
    }

    /// Returns the next leftover image, if any.
    pub fn recover(&mut self) -> Result<(Option<CardImage>, Vec<u8>), CameraError> {
        while let Some(left) = self.leftovers.pop() {
            let (bytes, mut settings) = self.download(&left)?;
            if let Err(why) = jpeg::check_complete(&bytes) {
                // It stays on the card, as part of it may still be recoverable manually.
                tracing::warn!(path = left.path(), %why, "an image on the card is damaged; it is left there");
                continue;
            }
            settings.insert("recovered".to_owned(), true.into());
            let path = left.path();
            self.last = Some(left);
            return Ok((Some(CardImage { path, settings }), bytes));
        }
        Ok((None, Vec::new()))
    }

    /// Releases the shutter (or waits for an external release) and downloads the image.
    pub fn shoot(
        &mut self,
        deadline: Duration,
        trigger: bool,
    ) -> Result<(CardImage, Vec<u8>), CameraError> {
        let deadline = Deadline::new(deadline);
        let unexpected = if trigger {
            self.drain_events()
        } else {
            Vec::new()
        };
        let asked_s = clock::since_boot_s();
        if trigger {
            self.trigger(&deadline)
                .map_err(|error| self.check_card_full(error))?;
        }
        let (image, others) = self
            .wait_for_image(&deadline)
            .map_err(|error| self.check_card_full(error))?;
        let answered_s = clock::since_boot_s();
        let (mut bytes, mut settings) = self.download(&image)?;
        if jpeg::check_complete(&bytes).is_err() {
            deadline.remaining("a second download")?;
            (bytes, settings) = self.download(&image)?;
        }
        jpeg::check_complete(&bytes)
            .map_err(|why| CameraError::BadFrame(format!("{}: {why}", image.path())))?;
        for (key, list) in [("other_files", others), ("unexpected_files", unexpected)] {
            if !list.is_empty() {
                settings.insert(
                    key.to_owned(),
                    list.iter().map(CardFile::path).collect::<Vec<_>>().into(),
                );
            }
        }
        settings.insert(REQUEST_TIME_KEY.to_owned(), asked_s.into());
        settings.insert(RESPONSE_TIME_KEY.to_owned(), answered_s.into());
        let path = image.path();
        self.last = Some(image);
        Ok((CardImage { path, settings }, bytes))
    }

    /// Returns images that appeared without a shot.
    pub fn unexpected_images(&mut self) -> Vec<String> {
        self.drain_events().iter().map(CardFile::path).collect()
    }

    /// Deletes the last image on the card, whose copy is durable.
    pub fn delete_last(&mut self) -> Result<(), CameraError> {
        match self.last.take().filter(|_| self.delete) {
            Some(last) => {
                let deletion = self
                    .camera
                    .fs()
                    .delete_file(&last.folder, &last.name)
                    .wait();
                deletion
                    .map_err(|e| faults::classify_error(&e, &format!("deleting {}", last.path())))
            }
            None => Ok(()),
        }
    }

    /// Drains earlier events, which must not be taken for this shot's, and returns the files among them: shots that were
    /// not requested.
    fn drain_events(&mut self) -> Vec<CardFile> {
        let mut files = Vec::new();
        for _ in 0..100 {
            match self.camera.wait_event(Duration::from_millis(1)).wait() {
                Ok(CameraEvent::NewFile(path)) => files.push(card_file_from_path(&path)),
                Ok(CameraEvent::Timeout) | Err(_) => break,
                Ok(_) => {}
            }
        }
        files
    }

    fn trigger(&mut self, deadline: &Deadline) -> Result<(), CameraError> {
        loop {
            match self
                .camera
                .trigger_capture()
                .wait()
                .map_err(|e| faults::classify_error(&e, "release"))
            {
                // The camera is typically still writing the last image.
                Err(CameraError::Busy(why)) => match deadline.remaining("") {
                    Ok(left) if left > Duration::from_secs(2) => {
                        std::thread::sleep(Duration::from_millis(200))
                    }
                    _ => return Err(CameraError::Busy(why)),
                },
                other => return other,
            }
        }
    }

    /// Waits for the first JPEG, and returns the other files that came with it.
    fn wait_for_image(
        &mut self,
        deadline: &Deadline,
    ) -> Result<(CardFile, Vec<CardFile>), CameraError> {
        let mut others = Vec::new();
        loop {
            let left = deadline
                .remaining("the image after the release")?
                .min(Duration::from_secs(1));
            match self
                .camera
                .wait_event(left)
                .wait()
                .map_err(|e| faults::classify_error(&e, "waiting for the image"))?
            {
                CameraEvent::NewFile(path) => {
                    let file = card_file_from_path(&path);
                    if file.is_jpeg() {
                        return Ok((file, others));
                    }
                    others.push(file);
                }
                CameraEvent::CaptureComplete if !others.is_empty() => {
                    let names: Vec<_> = others.iter().map(CardFile::path).collect();
                    let remedy = "set imagequality or imageformat to a JPEG format";
                    return Err(CameraError::Refused(format!(
                        "the camera wrote {} and no JPEG; {remedy}",
                        names.join(", ")
                    )));
                }
                _ => {}
            }
        }
    }

    fn download(&self, image: &CardFile) -> Result<(Vec<u8>, Map<String, Value>), CameraError> {
        let failed = |e: gphoto2::Error| {
            faults::classify_error(&e, &format!("downloading {}", image.path()))
        };
        let file = self
            .camera
            .fs()
            .download(&image.folder, &image.name)
            .wait()
            .map_err(failed)?;
        let bytes = file
            .get_data(&self.context)
            .wait()
            .map_err(failed)?
            .into_vec();
        let mut settings = Map::new();
        settings.insert("camera_path".to_owned(), image.path().into());
        settings.insert("camera_time_unix_s".to_owned(), file.mtime().into());
        Ok((bytes, settings))
    }

    /// Replaces an error by a full card if the card is full: the camera does not name that error.
    fn check_card_full(&self, error: CameraError) -> CameraError {
        let full = matches!(&error, CameraError::Gone(_) | CameraError::Timeout { .. })
            && is_card_full(&self.camera);
        if full {
            CameraError::Refused(faults::card_full_message(&error.to_string()))
        } else {
            error
        }
    }

    /// Lists every JPEG below a DCIM folder, the oldest name last.
    fn list_images(&self) -> Result<Vec<CardFile>, gphoto2::Error> {
        let mut found = Vec::new();
        let mut folders = vec!["/".to_owned()];
        while let Some(folder) = folders.pop() {
            if folder.contains("/DCIM") {
                let files = self.camera.fs().list_files(&folder).wait()?;
                found.extend(
                    files
                        .map(|name| CardFile {
                            folder: folder.clone(),
                            name,
                        })
                        .filter(CardFile::is_jpeg),
                );
            }
            let inner = self.camera.fs().list_folders(&folder).wait()?;
            folders.extend(inner.map(|name| format!("{}/{name}", folder.trim_end_matches('/'))));
        }
        found.sort_by_key(|image| std::cmp::Reverse(image.path()));
        Ok(found)
    }
}

fn card_file_from_path(path: &gphoto2::file::CameraFilePath) -> CardFile {
    CardFile {
        folder: path.folder().into_owned(),
        name: path.name().into_owned(),
    }
}

fn find_camera(
    context: &Context,
    section: &GphotoSection,
) -> Result<(Camera, String), CameraError> {
    let all: Vec<_> = context
        .list_cameras()
        .wait()
        .map_err(|e| faults::classify_error(&e, "searching for cameras"))?
        .collect();
    let names: Vec<_> = all
        .iter()
        .map(|camera| format!("{} on {}", camera.model, camera.port))
        .collect();
    let mut matching = all.iter().filter(|camera| {
        section
            .model
            .as_ref()
            .is_none_or(|model| camera.model.contains(model))
            && section
                .port
                .as_ref()
                .is_none_or(|port| camera.port == *port)
    });
    let Some(camera) = matching.next() else {
        let connected = if names.is_empty() {
            "none".to_owned()
        } else {
            names.join(", ")
        };
        return Err(CameraError::Gone(format!(
            "no matching camera on USB (connected: {connected}); check cable and power, and set the \
             camera's USB mode to PTP"
        )));
    };
    if matching.next().is_some() {
        let remedy = "name one with camera.model or camera.port";
        return Err(CameraError::Refused(format!(
            "several cameras: {}; {remedy}",
            names.join(", ")
        )));
    }
    let opened = context.get_camera(camera).wait();
    opened
        .map(|open| (open, camera.model.clone()))
        .map_err(|e| faults::classify_error(&e, &format!("opening {}", camera.model)))
}

/// Returns the free space as settings, as far as the camera reports it.
fn free_space(camera: &Camera) -> Map<String, Value> {
    let mut settings = Map::new();
    for storage in camera.storages().wait().unwrap_or_default() {
        // The binding's name says kB, but its value is in bytes.
        if let Some(bytes) = storage.free_kb() {
            settings.insert("card_free_bytes".to_owned(), bytes.into());
        }
        if let Some(images) = storage.free_images() {
            settings.insert("card_free_images".to_owned(), images.into());
        }
    }
    settings
}

fn is_card_full(camera: &Camera) -> bool {
    let storages = camera.storages().wait().unwrap_or_default();
    !storages.is_empty()
        && storages.iter().all(|storage| {
            storage.free_images() == Some(0)
                || storage
                    .free_kb()
                    .is_some_and(|bytes| bytes < MIN_FREE_BYTES)
        })
}
