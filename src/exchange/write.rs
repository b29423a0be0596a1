//! Writing of cameras for other programs.

use std::path::{Path, PathBuf};

use super::format::CameraFormat;
use crate::installation::{write_atomically, write_camera};
use crate::measure::geometry::Lens;

/// Reason why a camera is not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// Rational lens, for which Kalibr's radtan has no terms.
    #[error("Kalibr's radtan has no k4, k5, k6; convert to another format")]
    Rational,
    /// Lens with k3, which Kalibr's radtan does not have.
    #[error(
        "Kalibr's radtan has no k3; calibrate with --select, which drops it if it is not significant, or convert to \
         another format"
    )]
    ThirdRadial,
    /// XML or JSON file: these are read, not written.
    #[error("{} would be XML or JSON, which are not written; name a .yaml file", .0.display())]
    ReadOnly(PathBuf),
    /// File that cannot be written.
    #[error("{} cannot be written ({error}); check permissions and disk space", .file.display())]
    Unwritable {
        /// Path of the file.
        file: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
}

/// Writes a camera in `format`; its covariance is not written.
///
/// # Errors
/// Returns an error if the format cannot represent the lens, or the file cannot be written.
pub fn write_exchange(file: &Path, lens: &Lens, format: CameraFormat) -> Result<(), WriteError> {
    let unwritable = |error| WriteError::Unwritable {
        file: file.into(),
        error,
    };
    let text = match format {
        CameraFormat::Wingd => return write_camera(file, lens, None).map_err(unwritable),
        CameraFormat::Opencv if file.extension().is_some_and(|e| e == "xml" || e == "json") => {
            return Err(WriteError::ReadOnly(file.into()));
        }
        CameraFormat::Opencv => opencv_text(lens),
        CameraFormat::Ros => ros_text(lens),
        CameraFormat::Kalibr if is_rational(lens) => return Err(WriteError::Rational),
        CameraFormat::Kalibr if lens.k3 != 0.0 => return Err(WriteError::ThirdRadial),
        CameraFormat::Kalibr => kalibr_text(lens),
        CameraFormat::Mrcal => mrcal_text(lens),
    };
    write_atomically(file, &text).map_err(unwritable)
}

/// Formats numbers with a decimal point and without exponent: YAML 1.1, which PyYAML reads for ROS and Kalibr, takes `1e-5`
/// for a text and `955` for an integer.
fn format_numbers(values: &[f64]) -> String {
    let number = |value: &f64| {
        let text = value.to_string();
        if text.contains('.') {
            text
        } else {
            text + ".0"
        }
    };
    values.iter().map(number).collect::<Vec<_>>().join(", ")
}

fn format_matrix(l: &Lens) -> String {
    format!(
        "[{}]",
        format_numbers(&[l.fx, 0.0, l.cx, 0.0, l.fy, l.cy, 0.0, 0.0, 1.0])
    )
}

fn is_rational(l: &Lens) -> bool {
    l.denominator != [0.0; 3]
}

/// Formats the distortion terms in OpenCV's order; returns them and their number.
fn format_terms(l: &Lens) -> (String, usize) {
    let count = if is_rational(l) { 8 } else { 5 };
    let [k4, k5, k6] = l.denominator;
    (
        format_numbers(&[l.k1, l.k2, l.p1, l.p2, l.k3, k4, k5, k6][..count]),
        count,
    )
}

fn opencv_text(l: &Lens) -> String {
    let (width, height, matrix, (terms, count)) =
        (l.width, l.height, format_matrix(l), format_terms(l));
    format!(
        "%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\n\
         camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {matrix}\n\
         distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: {count}\n   dt: d\n   data: [{terms}]\n"
    )
}

fn ros_text(l: &Lens) -> String {
    let (width, height, matrix, (terms, count)) =
        (l.width, l.height, format_matrix(l), format_terms(l));
    let model = if is_rational(l) {
        "rational_polynomial"
    } else {
        "plumb_bob"
    };
    let turn = format_numbers(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let projection = format_numbers(&[
        l.fx, 0.0, l.cx, 0.0, 0.0, l.fy, l.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
    ]);
    format!(
        "image_width: {width}\nimage_height: {height}\ncamera_name: wingd\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix}\n\
         distortion_model: {model}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {count}\n  data: [{terms}]\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [{turn}]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{projection}]\n"
    )
}

fn kalibr_text(l: &Lens) -> String {
    let (terms, core) = (
        format_numbers(&[l.k1, l.k2, l.p1, l.p2]),
        format_numbers(&[l.fx, l.fy, l.cx, l.cy]),
    );
    format!(
        "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [{terms}]\n  distortion_model: radtan\n  \
         intrinsics: [{core}]\n  resolution: [{}, {}]\n  rostopic: /cam0/image_raw\n",
        l.width, l.height
    )
}

fn mrcal_text(l: &Lens) -> String {
    let ((terms, count), core) = (format_terms(l), format_numbers(&[l.fx, l.fy, l.cx, l.cy]));
    format!(
        "{{\n    'lensmodel':  'LENSMODEL_OPENCV{count}',\n\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n    \
         'intrinsics': [ {core}, {terms},],\n\n    'imagersize': [ {}, {},]\n}}\n",
        l.width, l.height
    )
}
