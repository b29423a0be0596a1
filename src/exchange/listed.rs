//! Cameras with a list of intrinsics: Kalibr's camchain and mrcal's cameramodel.

use super::declared::{self, foreign_model_fault};
use super::interior::Interior;
use super::keyed::Node;
use crate::installation::KeyFault;

pub(super) const INTRINSICS_KEY: &str = "intrinsics";
const COEFFICIENTS_KEY: &str = "distortion_coeffs";
const EXPORT_REMEDY: &str = "export the calibration again, or name its format with --from";

/// Reads `count` numbers of a key.
fn read_numbers(map: &Node, key: &str, count: usize) -> Result<Vec<f64>, KeyFault> {
    let node = map.require(key, EXPORT_REMEDY)?;
    let values = node.numbers(key)?;
    if values.len() != count {
        let problem = format!("has {} numbers, not {count}", values.len());
        return Err(KeyFault::on_line(node.line, key, problem, EXPORT_REMEDY));
    }
    Ok(values)
}

/// Reads the text of a key.
fn read_name<'a>(map: &'a Node, key: &str) -> Result<(&'a Node, &'a str), KeyFault> {
    let node = map.require(key, EXPORT_REMEDY)?;
    let text = node
        .text()
        .ok_or_else(|| KeyFault::on_line(node.line, key, "is not a name", EXPORT_REMEDY))?;
    Ok((node, text))
}

/// Reads a camera of Kalibr, which declares projection and distortion separately.
pub(super) fn read_kalibr(map: &Node) -> Result<Interior, KeyFault> {
    let known = [
        "camera_model",
        "distortion_model",
        INTRINSICS_KEY,
        COEFFICIENTS_KEY,
        "resolution",
    ];
    let ignored = [
        "rostopic",
        "cam_overlaps",
        "T_cn_cnm1",
        "T_cam_imu",
        "timeshift_cam_imu",
        "line_delay",
        "T_cam_body",
        "image_width",
        "image_height",
    ];
    let (left, remarks) = declared::check_declared_models(map, &known, &ignored)?;
    let (node, projection) = read_name(map, "camera_model")?;
    if projection != "pinhole" {
        return Err(foreign_model_fault(node, "camera_model", projection));
    }
    let (node, distortion) = read_name(map, "distortion_model")?;
    let terms = match distortion {
        "radtan" => read_numbers(map, COEFFICIENTS_KEY, 4)?,
        "none" => read_numbers(map, COEFFICIENTS_KEY, 0)?,
        other => return Err(foreign_model_fault(node, "distortion_model", other)),
    };
    let (size, core) = (
        read_numbers(map, "resolution", 2)?,
        read_numbers(map, INTRINSICS_KEY, 4)?,
    );
    Ok(Interior {
        size: [size[0], size[1]],
        core: [core[0], core[1], core[2], core[3]],
        terms,
        model: format!("{projection}, {distortion}"),
        keys: ["resolution", INTRINSICS_KEY, COEFFICIENTS_KEY],
        remarks,
        left,
    })
}

/// Reads a camera of mrcal, whose lens model implies the number of terms after fx fy cx cy.
pub(super) fn read_mrcal(map: &Node) -> Result<Interior, KeyFault> {
    let known = ["lensmodel", INTRINSICS_KEY, "imagersize"];
    let ignored = [
        "extrinsics",
        "rt_cam_ref",
        "valid_intrinsics_region",
        "icam_intrinsics",
        "optimization_inputs",
        "icam_intrinsics_optimization_inputs",
    ];
    let (left, remarks) = declared::check_declared_models(map, &known, &ignored)?;
    let (node, model) = read_name(map, "lensmodel")?;
    let terms = match model {
        "LENSMODEL_PINHOLE" => 0,
        "LENSMODEL_OPENCV4" => 4,
        "LENSMODEL_OPENCV5" => 5,
        "LENSMODEL_OPENCV8" => 8,
        "LENSMODEL_OPENCV12" => 12,
        other => return Err(foreign_model_fault(node, "lensmodel", other)),
    };
    let (size, values) = (
        read_numbers(map, "imagersize", 2)?,
        read_numbers(map, INTRINSICS_KEY, 4 + terms)?,
    );
    Ok(Interior {
        size: [size[0], size[1]],
        core: [values[0], values[1], values[2], values[3]],
        terms: values[4..].to_vec(),
        model: model.to_owned(),
        keys: ["imagersize", INTRINSICS_KEY, INTRINSICS_KEY],
        remarks,
        left,
    })
}
