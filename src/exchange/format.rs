//! Formats of camera files, and their detection.

use std::fmt;
use std::path::Path;

use super::keyed::{Node, Syntax};

/// File format of cameras. The command line lists the formats by their names and documentation here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum CameraFormat {
    /// camera.toml
    Wingd,
    /// OpenCV's YAML; reads also XML and JSON
    Opencv,
    /// ROS camera_info
    Ros,
    /// Kalibr's camchain
    Kalibr,
    /// mrcal's cameramodel
    Mrcal,
}

impl fmt::Display for CameraFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Wingd => "camera.toml",
            Self::Opencv => "OpenCV",
            Self::Ros => "ROS camera_info",
            Self::Kalibr => "Kalibr camchain",
            Self::Mrcal => "mrcal cameramodel",
        })
    }
}

/// Returns format and syntax that a file's name implies; the format only if it is unambiguous.
pub(super) fn format_from_name(file: &Path) -> (Option<CameraFormat>, Option<Syntax>) {
    let name = file
        .file_name()
        .map(|n| n.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let ending = name.rsplit_once('.').map_or("", |(_, ending)| ending);
    match ending {
        "toml" => (Some(CameraFormat::Wingd), None),
        "cameramodel" => (Some(CameraFormat::Mrcal), Some(Syntax::Literal)),
        "xml" => (Some(CameraFormat::Opencv), Some(Syntax::Xml)),
        "yaml" | "yml" | "json" => {
            let parts = [
                ("camchain", CameraFormat::Kalibr),
                ("camera_info", CameraFormat::Ros),
            ];
            let format = parts
                .into_iter()
                .find(|(part, _)| name.contains(part))
                .map(|(_, format)| format);
            (
                format,
                Some(if ending == "json" {
                    Syntax::Json
                } else {
                    Syntax::Yaml
                }),
            )
        }
        _ => (None, None),
    }
}

/// Returns the format of a file to be written, by its name; other YAML is OpenCV's.
pub fn output_format(file: &Path) -> Option<CameraFormat> {
    match format_from_name(file) {
        (Some(format), _) => Some(format),
        (None, syntax) => syntax.map(|_| CameraFormat::Opencv),
    }
}

/// Returns the format that a file's keys imply.
pub(super) fn format_from_keys(tree: &Node) -> Option<CameraFormat> {
    let mut cameras = vec![tree];
    cameras.extend(tree.entries().iter().map(|e| &e.node));
    let has = |key: &str| {
        cameras
            .iter()
            .any(|c| c.entries().iter().any(|e| e.key.eq_ignore_ascii_case(key)))
    };
    let tagged = cameras
        .iter()
        .any(|c| c.tag.as_deref().is_some_and(|t| t.starts_with("opencv-")));
    let signs = [
        (tagged, CameraFormat::Opencv),
        (has("lensmodel"), CameraFormat::Mrcal),
        (
            has("intrinsics") || has("distortion_coeffs"),
            CameraFormat::Kalibr,
        ),
        (
            has("camera_matrix") && has("distortion_model"),
            CameraFormat::Ros,
        ),
        (has("camera_matrix"), CameraFormat::Opencv),
    ];
    signs
        .into_iter()
        .find(|(there, _)| *there)
        .map(|(_, format)| format)
}
