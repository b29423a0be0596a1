//! A camera written for other programs.

use std::path::{Path, PathBuf};

use super::format::CameraFormat;
use crate::installation::{camera, write_whole};
use crate::measure::geometry::Lens;

/// Why a camera is not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// Kalibr's radtan has four terms.
    #[error("Kalibr's radtan has no k4, k5, k6; convert to another format")]
    Rational,
    /// The same.
    #[error(
        "Kalibr's radtan has no k3; calibrate with --select, which drops it where it is not significant, or convert to \
         another format"
    )]
    ThirdRadial,
    /// XML and JSON are read, not written.
    #[error("{} would be XML or JSON, which are only read; name a .yaml file", .0.display())]
    ReadOnly(PathBuf),
    /// The disk.
    #[error("{} cannot be written ({error}); check rights and space", .file.display())]
    Unwritable {
        /// The file.
        file: PathBuf,
        /// Why.
        error: std::io::Error,
    },
}

/// Writes a camera; its covariance has no place in formats but our own.
///
/// # Errors
/// The format cannot hold the lens, or the file cannot be written.
pub fn write_exchange(file: &Path, lens: &Lens, format: CameraFormat) -> Result<(), WriteError> {
    let unwritable = |error| WriteError::Unwritable { file: file.into(), error };
    let text = match format {
        CameraFormat::Wingd => return camera::write_camera(file, lens, None).map_err(unwritable),
        CameraFormat::Opencv if file.extension().is_some_and(|e| e == "xml" || e == "json") => {
            return Err(WriteError::ReadOnly(file.into()));
        }
        CameraFormat::Opencv => opencv(lens),
        CameraFormat::Ros => ros(lens),
        CameraFormat::Kalibr if rational(lens) => return Err(WriteError::Rational),
        CameraFormat::Kalibr if lens.k3 != 0.0 => return Err(WriteError::ThirdRadial),
        CameraFormat::Kalibr => kalibr(lens),
        CameraFormat::Mrcal => mrcal(lens),
    };
    write_whole(file, &text).map_err(unwritable)
}

/// Numbers with a point and without exponent: YAML 1.1, by which PyYAML reads for ROS and Kalibr, takes `1e-5` for a text
/// and `955` for no float.
fn list(values: &[f64]) -> String {
    let number = |value: &f64| {
        let text = value.to_string();
        if text.contains('.') { text } else { text + ".0" }
    };
    values.iter().map(number).collect::<Vec<_>>().join(", ")
}

fn matrix(l: &Lens) -> String {
    format!("[{}]", list(&[l.fx, 0.0, l.cx, 0.0, l.fy, l.cy, 0.0, 0.0, 1.0]))
}

fn rational(l: &Lens) -> bool {
    l.denominator != [0.0; 3]
}

/// The distortion's terms in OpenCV's order, and their number.
fn terms(l: &Lens) -> (String, usize) {
    let count = if rational(l) { 8 } else { 5 };
    let [k4, k5, k6] = l.denominator;
    (list(&[l.k1, l.k2, l.p1, l.p2, l.k3, k4, k5, k6][..count]), count)
}

fn opencv(l: &Lens) -> String {
    let (width, height, matrix, (terms, count)) = (l.width, l.height, matrix(l), terms(l));
    format!(
        "%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\n\
         camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {matrix}\n\
         distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: {count}\n   dt: d\n   data: [{terms}]\n"
    )
}

fn ros(l: &Lens) -> String {
    let (width, height, matrix, (terms, count)) = (l.width, l.height, matrix(l), terms(l));
    let model = if rational(l) { "rational_polynomial" } else { "plumb_bob" };
    let turn = list(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let projection = list(&[l.fx, 0.0, l.cx, 0.0, 0.0, l.fy, l.cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    format!(
        "image_width: {width}\nimage_height: {height}\ncamera_name: wingd\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix}\n\
         distortion_model: {model}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {count}\n  data: [{terms}]\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [{turn}]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{projection}]\n"
    )
}

fn kalibr(l: &Lens) -> String {
    let (terms, core) = (list(&[l.k1, l.k2, l.p1, l.p2]), list(&[l.fx, l.fy, l.cx, l.cy]));
    format!(
        "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [{terms}]\n  distortion_model: radtan\n  \
         intrinsics: [{core}]\n  resolution: [{}, {}]\n  rostopic: /cam0/image_raw\n",
        l.width, l.height
    )
}

fn mrcal(l: &Lens) -> String {
    let ((terms, count), core) = (terms(l), list(&[l.fx, l.fy, l.cx, l.cy]));
    format!(
        "{{\n    'lensmodel':  'LENSMODEL_OPENCV{count}',\n\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n    \
         'intrinsics': [ {core}, {terms},],\n\n    'imagersize': [ {}, {},]\n}}\n",
        l.width, l.height
    )
}
