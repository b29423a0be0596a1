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
    // A camera may have several nodes; the first one delivers images, others metadata.
    let is_wanted = |node: &VideoNode| node.index == 0 && Some(&node.card) == section.card.as_ref();
    let node = list_video_nodes(class).into_iter().find(is_wanted);
    node.map(|node| node.path).ok_or_else(|| {
        let card = section.card.as_deref().unwrap_or_default();
        CameraError::Gone(format!(
            "no camera with card {card:?}; {}",
            describe_present(class)
        ))
    })
}

/// Video node as described by sysfs.
struct VideoNode {
    path: PathBuf,
    card: String,
    index: u32,
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
        number: name.strip_prefix("video")?.parse().ok()?,
    })
}

/// Describes the connected devices, for the message.
fn describe_present(class: &Path) -> String {
    let list: Vec<_> = list_video_nodes(class)
        .iter()
        .map(|node| format!("{} ({:?})", node.path.display(), node.card))
        .collect();
    match list.is_empty() {
        true => "no video device is connected; check cable and power".to_owned(),
        false => format!("connected: {}", list.join("; ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_found_by_its_card_whatever_its_number() {
        let class = tempfile::tempdir().unwrap();
        for (name, index) in [("video3", "0"), ("video4", "1")] {
            let node = class.path().join(name);
            fs::create_dir_all(&node).unwrap();
            fs::write(node.join("name"), "Wing cam\n").unwrap();
            fs::write(node.join("index"), index).unwrap();
        }
        let found = |card: &str| {
            let text = format!("card='{card}'\nformat='GREY'\nwidth=2\nheight=2");
            find_device_node(&toml::from_str(&text).unwrap(), class.path())
        };
        assert_eq!(found("Wing cam").unwrap(), Path::new("/dev/video3"));
        let message = found("B8").unwrap_err().to_string();
        assert!(
            message.contains("card \"B8\"") && message.contains("/dev/video3"),
            "{message}"
        );
    }
}
