//! Cameras with a list of intrinsics: Kalibr's camchain and mrcal's cameramodel.

use super::declared::{self, foreign};
use super::interior::Interior;
use crate::installation::keyed::{Node, Trouble};

pub(super) const INTRINSICS: &str = "intrinsics";
const COEFFICIENTS: &str = "distortion_coeffs";
const MEND: &str = "export the calibration again, or name its format with --from";

/// `count` numbers of a key.
fn list(map: &Node, key: &str, count: usize) -> Result<Vec<f64>, Trouble> {
    let node = map.need(key, MEND)?;
    let values = node.numbers(key)?;
    if values.len() != count {
        let problem = format!("holds {} numbers, not {count}", values.len());
        return Err(Trouble::new(node.line, key, problem, MEND));
    }
    Ok(values)
}

/// A key's text.
fn name<'a>(map: &'a Node, key: &str) -> Result<(&'a Node, &'a str), Trouble> {
    let node = map.need(key, MEND)?;
    let text = node.text().ok_or_else(|| Trouble::new(node.line, key, "is no name", MEND))?;
    Ok((node, text))
}

/// Kalibr: projection and distortion are declared apart.
pub(super) fn kalibr(map: &Node) -> Result<Interior, Trouble> {
    let known = ["camera_model", "distortion_model", INTRINSICS, COEFFICIENTS, "resolution"];
    let beside = [
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
    let (left, remarks) = declared::check(map, &known, &beside)?;
    let (node, projection) = name(map, "camera_model")?;
    if projection != "pinhole" {
        return Err(foreign(node, "camera_model", projection));
    }
    let (node, distortion) = name(map, "distortion_model")?;
    let terms = match distortion {
        "radtan" => list(map, COEFFICIENTS, 4)?,
        "none" => list(map, COEFFICIENTS, 0)?,
        other => return Err(foreign(node, "distortion_model", other)),
    };
    let (size, core) = (list(map, "resolution", 2)?, list(map, INTRINSICS, 4)?);
    Ok(Interior {
        size: [size[0], size[1]],
        core: [core[0], core[1], core[2], core[3]],
        terms,
        model: format!("{projection}, {distortion}"),
        keys: ["resolution", INTRINSICS, COEFFICIENTS],
        remarks,
        left,
    })
}

/// mrcal: the lens model says how many terms follow fx fy cx cy.
pub(super) fn mrcal(map: &Node) -> Result<Interior, Trouble> {
    let known = ["lensmodel", INTRINSICS, "imagersize"];
    let beside = [
        "extrinsics",
        "rt_cam_ref",
        "valid_intrinsics_region",
        "icam_intrinsics",
        "optimization_inputs",
        "icam_intrinsics_optimization_inputs",
    ];
    let (left, remarks) = declared::check(map, &known, &beside)?;
    let (node, model) = name(map, "lensmodel")?;
    let terms = match model {
        "LENSMODEL_PINHOLE" => 0,
        "LENSMODEL_OPENCV4" => 4,
        "LENSMODEL_OPENCV5" => 5,
        "LENSMODEL_OPENCV8" => 8,
        "LENSMODEL_OPENCV12" => 12,
        other => return Err(foreign(node, "lensmodel", other)),
    };
    let (size, values) = (list(map, "imagersize", 2)?, list(map, INTRINSICS, 4 + terms)?);
    Ok(Interior {
        size: [size[0], size[1]],
        core: [values[0], values[1], values[2], values[3]],
        terms: values[4..].to_vec(),
        model: model.to_owned(),
        keys: ["imagersize", INTRINSICS, INTRINSICS],
        remarks,
        left,
    })
}
