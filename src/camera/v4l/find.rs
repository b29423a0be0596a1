//! Search for the camera's device node: the number of `/dev/videoN` changes with every connection.

use std::fs;
use std::path::{Path, PathBuf};

use crate::camera::CameraError;
use crate::camera::v4l::V4lSection;

/// Kernel's list of video nodes.
const CLASS: &str = "/sys/class/video4linux";

/// Returns the node of the configured camera.
pub fn find_device(section: &V4lSection) -> Result<PathBuf, CameraError> {
    find_device_node(section, Path::new(CLASS))
}

fn find_device_node(section: &V4lSection, class: &Path) -> Result<PathBuf, CameraError> {
    if let Some(path) = &section.device {
        return match path.exists() {
            true => Ok(path.clone()),
            false => Err(CameraError::Gone(format!(
                "{} does not exist; {}",
                path.display(),
                describe_present(class)
            ))),
        };
    }
    list_video_nodes(class)
        .into_iter()
        .find(|node| {
            // A camera may have several nodes; the first one delivers images, others metadata.
            node.index == 0
                && section
                    .serial
                    .as_ref()
                    .is_none_or(|serial| node.serial.as_ref() == Some(serial))
                && section.card.as_ref().is_none_or(|card| node.card == *card)
        })
        .map(|node| node.path)
        .ok_or_else(|| {
            let wanted = section
                .serial
                .iter()
                .map(|serial| format!("serial {serial}"));
            let wanted: Vec<_> = wanted
                .chain(section.card.iter().map(|card| format!("card {card:?}")))
                .collect();
            CameraError::Gone(format!(
                "no camera with {}; {}",
                wanted.join(" and "),
                describe_present(class)
            ))
        })
}

/// Video node as described by sysfs.
struct VideoNode {
    path: PathBuf,
    card: String,
    index: u32,
    serial: Option<String>,
    number: u32,
}

fn list_video_nodes(class: &Path) -> Vec<VideoNode> {
    let entries = fs::read_dir(class).into_iter().flatten().flatten();
    let mut nodes: Vec<_> = entries
        .filter_map(|entry| read_video_node(&entry.path()))
        .collect();
    nodes.sort_by_key(|node| node.number);
    nodes
}

fn read_video_node(sysfs: &Path) -> Option<VideoNode> {
    let read = |path: PathBuf| {
        fs::read_to_string(path)
            .ok()
            .map(|text| text.trim().to_owned())
    };
    let name = sysfs.file_name()?.to_str()?;
    Some(VideoNode {
        path: Path::new("/dev").join(name),
        card: read(sysfs.join("name"))?,
        index: read(sysfs.join("index"))
            .and_then(|text| text.parse().ok())
            .unwrap_or(0),
        // A USB interface is below the device that has the serial number.
        serial: read(sysfs.join("device/../serial")).or_else(|| read(sysfs.join("device/serial"))),
        number: name.strip_prefix("video")?.parse().ok()?,
    })
}

/// Describes the connected devices, for the message.
fn describe_present(class: &Path) -> String {
    let list: Vec<_> = list_video_nodes(class)
        .iter()
        .map(|node| {
            let serial = node
                .serial
                .as_ref()
                .map_or(String::new(), |serial| format!(", serial {serial}"));
            format!("{} ({:?}{serial})", node.path.display(), node.card)
        })
        .collect();
    match list.is_empty() {
        true => "no video device is connected; check cable and power".to_owned(),
        false => format!("connected: {}", list.join("; ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn class() -> tempfile::TempDir {
        let class = tempfile::tempdir().unwrap();
        for (name, card, index, serial) in [
            ("video3", "Wing cam", "0", "A7"),
            ("video4", "Wing cam", "1", "A7"),
        ] {
            let interface = class.path().join(name).join("device");
            fs::create_dir_all(&interface).unwrap();
            fs::write(class.path().join(name).join("name"), format!("{card}\n")).unwrap();
            fs::write(class.path().join(name).join("index"), index).unwrap();
            fs::write(class.path().join(name).join("serial"), serial).unwrap();
        }
        class
    }

    fn section(serial: Option<&str>, card: Option<&str>) -> V4lSection {
        let mut section: V4lSection = toml::from_str("format='GREY'\nwidth=2\nheight=2").unwrap();
        section.serial = serial.map(str::to_owned);
        section.card = card.map(str::to_owned);
        section
    }

    #[test]
    fn a_camera_is_found_by_serial_and_card_whatever_its_number() {
        let class = class();
        let found = |serial, card| find_device_node(&section(serial, card), class.path());
        assert_eq!(found(Some("A7"), None).unwrap(), Path::new("/dev/video3"));
        assert_eq!(
            found(None, Some("Wing cam")).unwrap(),
            Path::new("/dev/video3")
        );
        let message = found(Some("B8"), None).unwrap_err().to_string();
        assert!(
            message.contains("serial B8")
                && message.contains("/dev/video3")
                && message.contains("A7"),
            "{message}"
        );
    }
}
