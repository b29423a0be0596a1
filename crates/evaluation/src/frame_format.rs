//! Format of a frame's bytes.

use std::path::Path;

use serde_json::Value;

/// Format of a frame's bytes; also determines the file extension.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Format {
    /// Complete JPEG file (MJPEG frames too).
    Jpeg,
    /// Complete PNG, PNM or TIFF file; the extension is kept.
    File {
        /// Extension without the dot.
        extension: String,
    },
    /// Raw samples of a V4L2 device.
    Raw {
        /// FourCC such as `GREY`, `YUYV`, `BA81`, `RG10`, `RG12`.
        fourcc: String,
        width: u32,
        height: u32,
        /// Number of bytes from one row to the next.
        stride: u32,
    },
}

impl Format {
    /// Reads the format from a series' manifest.
    ///
    /// # Errors
    /// Returns an error if the value is no format.
    pub fn from_manifest(kept: &Value) -> Result<Self, UnknownFormat> {
        Ok(serde_json::from_value(kept.clone())?)
    }
}

/// Missing or invalid format in a manifest.
#[derive(Debug, thiserror::Error)]
#[error("series.json has no valid format for the frame: {0}")]
pub struct UnknownFormat(#[from] serde_json::Error);

/// Returns the file extension for a format, without the dot.
pub fn file_extension(format: &Format) -> &str {
    match format {
        Format::Jpeg => "jpg",
        Format::File { extension } => extension,
        Format::Raw { fourcc, .. } => fourcc.trim(),
    }
}

/// Returns the format by the file's extension; `None` if it is not an image.
pub fn format_from_path(path: &Path) -> Option<Format> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    match extension.as_str() {
        "jpg" | "jpeg" | "jpe" | "jfif" | "mpo" => Some(Format::Jpeg),
        "png" | "pgm" | "ppm" | "pnm" | "tif" | "tiff" => Some(Format::File { extension }),
        _ => None,
    }
}
