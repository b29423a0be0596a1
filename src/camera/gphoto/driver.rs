//! The camera is driven here, inside the camera process.

use std::time::Duration;

use gphoto2::camera::CameraEvent;
use gphoto2::{Camera, Context};
use serde_json::{Map, Value};

use crate::camera::deadline::Deadline;
use crate::camera::gphoto::protocol::Picture;
use crate::camera::gphoto::{ANSWERED, ASKED, GphotoSection, faults, settings};
use crate::camera::{CameraError, CameraInfo, jpeg};
use crate::clock;

/// Below this the card counts as full: no picture fits.
const MIN_FREE_BYTES: u64 = 8 << 20;

/// A picture on the card.
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

/// An open camera.
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
        let context = Context::new().map_err(|e| faults::sort(&e, "libgphoto2"))?;
        let (camera, model) = find(&context, section)?;
        let (mut settings, mut warnings) = settings::apply(&camera, &section.settings);
        settings.extend(space(&camera));
        let mut driver = Self { context, camera, delete: section.delete, leftovers: Vec::new(), last: None };
        if section.recover > 0 {
            driver.leftovers = driver.pictures().map_err(|e| faults::sort(&e, "listing the card"))?;
        }
        if driver.leftovers.len() > section.recover {
            warnings.push(format!(
                "{} pictures on the card are left alone, since camera.recover is {}: take them off and format the card",
                driver.leftovers.len(), section.recover
            ));
            driver.leftovers.clear();
        }
        let serial = settings.get("serialnumber").and_then(Value::as_str);
        let name = serial.map_or(model.clone(), |serial| format!("{model}, serial {serial}"));
        Ok((driver, CameraInfo { name, settings, warnings }))
    }

    /// The next leftover, where there is one.
    pub fn recover(&mut self) -> Result<(Option<Picture>, Vec<u8>), CameraError> {
        while let Some(left) = self.leftovers.pop() {
            let (bytes, mut settings) = self.fetch(&left)?;
            if let Err(why) = jpeg::check_complete(&bytes) {
                // Stays on the card; a person may still read something out of it.
                tracing::warn!(path = left.path(), %why, "a picture on the card is damaged and left there");
                continue;
            }
            settings.insert("recovered".to_owned(), true.into());
            let path = left.path();
            self.last = Some(left);
            return Ok((Some(Picture { path, settings }), bytes));
        }
        Ok((None, Vec::new()))
    }

    /// Releases the shutter (or waits for somebody else's release) and fetches the picture.
    pub fn shoot(&mut self, deadline: Duration, trigger: bool) -> Result<(Picture, Vec<u8>), CameraError> {
        let deadline = Deadline::new(deadline);
        let unexpected = if trigger { self.drain_events() } else { Vec::new() };
        let asked_s = clock::since_boot_s();
        if trigger {
            self.trigger(&deadline).map_err(|error| self.or_card_full(error))?;
        }
        let (picture, others) = self.wait(&deadline).map_err(|error| self.or_card_full(error))?;
        let told_s = clock::since_boot_s();
        let (mut bytes, mut settings) = self.fetch(&picture)?;
        if jpeg::check_complete(&bytes).is_err() {
            deadline.remaining("a second download")?;
            (bytes, settings) = self.fetch(&picture)?;
        }
        jpeg::check_complete(&bytes).map_err(|why| CameraError::BadFrame(format!("{}: {why}", picture.path())))?;
        for (key, list) in [("other_files", others), ("unexpected_files", unexpected)] {
            if !list.is_empty() {
                settings.insert(key.to_owned(), list.iter().map(CardFile::path).collect::<Vec<_>>().into());
            }
        }
        settings.insert(ASKED.to_owned(), asked_s.into());
        settings.insert(ANSWERED.to_owned(), told_s.into());
        let path = picture.path();
        self.last = Some(picture);
        Ok((Picture { path, settings }, bytes))
    }

    /// Pictures that came without a shot.
    pub fn unexpected(&mut self) -> Vec<String> {
        self.drain_events().iter().map(CardFile::path).collect()
    }

    /// The last picture is safe.
    pub fn release(&mut self) -> Result<(), CameraError> {
        match self.last.take().filter(|_| self.delete) {
            Some(last) => {
                let deletion = self.camera.fs().delete_file(&last.folder, &last.name).wait();
                deletion.map_err(|e| faults::sort(&e, &format!("deleting {}", last.path())))
            }
            None => Ok(()),
        }
    }

    /// Events of before, which must not be taken for this shot's; files among them are shots that
    /// nobody asked for.
    fn drain_events(&mut self) -> Vec<CardFile> {
        let mut files = Vec::new();
        for _ in 0..100 {
            match self.camera.wait_event(Duration::from_millis(1)).wait() {
                Ok(CameraEvent::NewFile(path)) => files.push(on_card(&path)),
                Ok(CameraEvent::Timeout) | Err(_) => break,
                Ok(_) => {}
            }
        }
        files
    }

    fn trigger(&mut self, deadline: &Deadline) -> Result<(), CameraError> {
        loop {
            match self.camera.trigger_capture().wait().map_err(|e| faults::sort(&e, "release")) {
                // Still writing the last picture, most of the time.
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

    /// The first JPEG that appears, and the other files that came with it.
    fn wait(&mut self, deadline: &Deadline) -> Result<(CardFile, Vec<CardFile>), CameraError> {
        let mut others = Vec::new();
        loop {
            let left = deadline.remaining("the picture after the release")?.min(Duration::from_secs(1));
            match self
                .camera
                .wait_event(left)
                .wait()
                .map_err(|e| faults::sort(&e, "waiting for the picture"))?
            {
                CameraEvent::NewFile(path) => {
                    let file = on_card(&path);
                    if file.is_jpeg() {
                        return Ok((file, others));
                    }
                    others.push(file);
                }
                CameraEvent::CaptureComplete if !others.is_empty() => {
                    let names: Vec<_> = others.iter().map(CardFile::path).collect();
                    let mend = "set imagequality or imageformat to a JPEG format";
                    return Err(CameraError::Refused(format!(
                        "the camera wrote {} and no JPEG; {mend}",
                        names.join(", ")
                    )));
                }
                _ => {}
            }
        }
    }

    fn fetch(&self, picture: &CardFile) -> Result<(Vec<u8>, Map<String, Value>), CameraError> {
        let failed = |e: gphoto2::Error| faults::sort(&e, &format!("downloading {}", picture.path()));
        let file = self.camera.fs().download(&picture.folder, &picture.name).wait().map_err(failed)?;
        let bytes = file.get_data(&self.context).wait().map_err(failed)?.into_vec();
        let mut settings = Map::new();
        settings.insert("camera_path".to_owned(), picture.path().into());
        settings.insert("camera_time_unix_s".to_owned(), file.mtime().into());
        Ok((bytes, settings))
    }

    /// A full card shows as an error without a name.
    fn or_card_full(&self, error: CameraError) -> CameraError {
        let full =
            matches!(&error, CameraError::Gone(_) | CameraError::Timeout { .. }) && card_full(&self.camera);
        if full { CameraError::Refused(faults::card_full(&error.to_string())) } else { error }
    }

    /// Every JPEG below a DCIM folder, the oldest name last.
    fn pictures(&self) -> Result<Vec<CardFile>, gphoto2::Error> {
        let mut found = Vec::new();
        let mut folders = vec!["/".to_owned()];
        while let Some(folder) = folders.pop() {
            if folder.contains("/DCIM") {
                let files = self.camera.fs().list_files(&folder).wait()?;
                found.extend(
                    files.map(|name| CardFile { folder: folder.clone(), name }).filter(CardFile::is_jpeg),
                );
            }
            let inner = self.camera.fs().list_folders(&folder).wait()?;
            folders.extend(inner.map(|name| format!("{}/{name}", folder.trim_end_matches('/'))));
        }
        found.sort_by_key(|picture| std::cmp::Reverse(picture.path()));
        Ok(found)
    }
}

fn on_card(path: &gphoto2::file::CameraFilePath) -> CardFile {
    CardFile { folder: path.folder().into_owned(), name: path.name().into_owned() }
}

fn find(context: &Context, section: &GphotoSection) -> Result<(Camera, String), CameraError> {
    let all: Vec<_> =
        context.list_cameras().wait().map_err(|e| faults::sort(&e, "looking for cameras"))?.collect();
    let names: Vec<_> = all.iter().map(|camera| format!("{} on {}", camera.model, camera.port)).collect();
    let mut matching = all.iter().filter(|camera| {
        section.model.as_ref().is_none_or(|model| camera.model.contains(model))
            && section.port.as_ref().is_none_or(|port| camera.port == *port)
    });
    let Some(camera) = matching.next() else {
        let there = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        return Err(CameraError::Gone(format!(
            "no matching camera on USB (there: {there}); check cable and power, set the camera's USB mode to PTP"
        )));
    };
    if matching.next().is_some() {
        let mend = "name one with camera.model or camera.port";
        return Err(CameraError::Refused(format!("several cameras: {}; {mend}", names.join(", "))));
    }
    let opened = context.get_camera(camera).wait();
    opened
        .map(|open| (open, camera.model.clone()))
        .map_err(|e| faults::sort(&e, &format!("opening {}", camera.model)))
}

/// Free space, for the record; a camera that cannot say has none in it.
fn space(camera: &Camera) -> Map<String, Value> {
    let mut settings = Map::new();
    for storage in camera.storages().wait().unwrap_or_default() {
        // The binding's name says kB and its value is bytes.
        if let Some(bytes) = storage.free_kb() {
            settings.insert("card_free_bytes".to_owned(), bytes.into());
        }
        if let Some(images) = storage.free_images() {
            settings.insert("card_free_images".to_owned(), images.into());
        }
    }
    settings
}

fn card_full(camera: &Camera) -> bool {
    let storages = camera.storages().wait().unwrap_or_default();
    !storages.is_empty()
        && storages.iter().all(|storage| {
            storage.free_images() == Some(0) || storage.free_kb().is_some_and(|bytes| bytes < MIN_FREE_BYTES)
        })
}
