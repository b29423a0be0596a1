//! Cameras with a matrix and a list of coefficients: OpenCV's FileStorage and ROS's camera_info.

use super::declared::{self, foreign_model_fault, is_brown_model, normalize_model_name};
use super::interior::Interior;
use super::keyed::{KeyedValue, Node};
use crate::installation::KeyFault;

pub(super) const SIZE_KEYS: [&str; 2] = ["image_width", "image_height"];
pub(super) const MATRIX_KEY: &str = "camera_matrix";
pub(super) const TERMS_KEY: &str = "distortion_coefficients";
const MODEL_KEY: &str = "distortion_model";
/// Further keys that camera_calibration_parsers and OpenCV's calibration write.
const IGNORED_KEYS: [&str; 25] = [
    "camera_name",
    "camera_id",
    "rectification_matrix",
    "projection_matrix",
    "calibration_time",
    "calibration_date",
    "nr_of_frames",
    "nframes",
    "board_width",
    "board_height",
    "square_size",
    "marker_size",
    "marker_length",
    "fix_aspect_ratio",
    "aspect_ratio",
    "aspectratio",
    "flags",
    "flagvalue",
    "avg_reprojection_error",
    "per_view_reprojection_errors",
    "extrinsic_parameters",
    "image_points",
    "grid_points",
    "nframes_used",
    "type_id",
];
const PLUMB_BOB: &str = "plumb_bob";
const NO_MODEL: &str = "none";
const EXPORT_REMEDY: &str = "export the calibration again, or name its format with --from";

/// Reads a camera's map. ROS declares its model; OpenCV's calibration writes none and has its own order of terms.
pub(super) fn read_matrix_camera(map: &Node, of_ros: bool) -> Result<Interior, KeyFault> {
    let known = [SIZE_KEYS[0], SIZE_KEYS[1], MATRIX_KEY, TERMS_KEY, MODEL_KEY];
    let (left, mut remarks) = declared::check_declared_models(map, &known, &IGNORED_KEYS)?;
    let model = read_model(map, of_ros, &mut remarks)?;
    let side = |key: &str| {
        map.require(
            key,
            "add the size of the images, px: image_width, image_height",
        )?
        .number(key)
    };
    let size = [side(SIZE_KEYS[0])?, side(SIZE_KEYS[1])?];
    let core = parse_camera_matrix(map.require(MATRIX_KEY, EXPORT_REMEDY)?)?;
    let terms = parse_distortion(map.require(TERMS_KEY, EXPORT_REMEDY)?)?;
    let problem = match model.as_str() {
        PLUMB_BOB if terms.len() > 5 => Some(format!(
            "are {} numbers, but {MODEL_KEY} is {PLUMB_BOB}, which has 5",
            terms.len()
        )),
        NO_MODEL if terms.iter().any(|term| *term != 0.0) => {
            Some(format!("are not all 0, but {MODEL_KEY} is {NO_MODEL}"))
        }
        _ => None,
    };
    if let Some(problem) = problem {
        let line = map.require(TERMS_KEY, EXPORT_REMEDY)?.line;
        return Err(KeyFault::on_line(
            line,
            TERMS_KEY,
            problem,
            "name the model that was calibrated",
        ));
    }
    let keys = [SIZE_KEYS[0], MATRIX_KEY, TERMS_KEY];
    Ok(Interior {
        size,
        core,
        terms,
        model,
        keys,
        remarks,
        left,
    })
}

fn read_model(map: &Node, of_ros: bool, remarks: &mut Vec<String>) -> Result<String, KeyFault> {
    let Some(node) = map.get(MODEL_KEY)? else {
        if of_ros {
            let remedy = "name the model that was calibrated: plumb_bob or rational_polynomial";
            return Err(KeyFault::on_line(map.line, MODEL_KEY, "is missing", remedy));
        }
        remarks.push(
            "no lens model is declared: assumed to be OpenCV's k1 k2 p1 p2 k3 k4 k5 k6".into(),
        );
        return Ok("no model declared".into());
    };
    let name = node.text().unwrap_or("a list").trim();
    match normalize_model_name(name).as_str() {
        _ if is_brown_model(name) => Ok(PLUMB_BOB.into()),
        "rationalpolynomial" => Ok("rational_polynomial".into()),
        "none" => Ok(NO_MODEL.into()),
        "" | "null" => Err(KeyFault::on_line(
            node.line,
            MODEL_KEY,
            "is empty: this camera was never calibrated",
            EXPORT_REMEDY,
        )),
        _ => Err(foreign_model_fault(node, MODEL_KEY, name)),
    }
}

/// Returns the numbers of a matrix and its shape; their number must agree with rows and columns.
fn matrix_values(node: &Node, key: &str) -> Result<(Vec<f64>, Option<[f64; 2]>), KeyFault> {
    if !matches!(node.value, KeyedValue::Map(_)) {
        return Ok((flatten_rows(node, key)?, None));
    }
    let values = flatten_rows(node.require("data", EXPORT_REMEDY)?, key)?;
    let side = |name: &str| {
        node.get(name)?
            .map(|n| n.number(&format!("{key}.{name}")))
            .transpose()
    };
    let sides: [Option<f64>; 2] = [side("rows")?, side("cols")?];
    let shape = sides[0].zip(sides[1]).map(|(rows, cols)| [rows, cols]);
    if let Some([rows, cols]) = shape.filter(|[rows, cols]| rows * cols != values.len() as f64) {
        let problem = format!("has {} numbers for {rows} rows of {cols}", values.len());
        return Err(KeyFault::on_line(node.line, key, problem, EXPORT_REMEDY));
    }
    Ok((values, shape))
}

/// Returns the numbers of a list, or of rows that are lists.
fn flatten_rows(node: &Node, key: &str) -> Result<Vec<f64>, KeyFault> {
    let KeyedValue::List(items) = &node.value else {
        return node.numbers(key);
    };
    if !items
        .iter()
        .all(|item| matches!(item.value, KeyedValue::List(_)))
    {
        return node.numbers(key);
    }
    let rows: Result<Vec<Vec<f64>>, KeyFault> =
        items.iter().map(|item| item.numbers(key)).collect();
    Ok(rows?.concat())
}

/// Returns fx, fy, cx, cy of a 3 x 3 matrix; its other elements must be those of a camera without skew.
fn parse_camera_matrix(node: &Node) -> Result<[f64; 4], KeyFault> {
    let (m, shape) = matrix_values(node, MATRIX_KEY)?;
    let fault = |problem: String, remedy: &str| {
        Err(KeyFault::on_line(node.line, MATRIX_KEY, problem, remedy))
    };
    if m.len() != 9 || shape.is_some_and(|s| s != [3.0, 3.0]) {
        return fault(
            format!("has {} numbers", m.len()),
            "give 3 rows of 3 numbers",
        );
    }
    if m.iter().all(|v| *v == 0.0) {
        let remedy = "calibrate it, or use the file that its calibration wrote";
        return fault("is zero: this camera was never calibrated".into(), remedy);
    }
    if m[2] == 0.0 && m[5] == 0.0 && (m[6] != 0.0 || m[7] != 0.0) {
        let problem = format!(
            "is transposed: row 3 begins with {} and {}, but cx and cy belong in column 3",
            m[6], m[7]
        );
        return fault(
            problem,
            "give the matrix by rows: [fx 0 cx], [0 fy cy], [0 0 1]",
        );
    }
    if m[1] != 0.0 {
        let problem = format!(
            "has a skew of {} px (row 1, column 2), which is not supported",
            m[1]
        );
        return fault(problem, "calibrate without skew");
    }
    for (k, want) in [(3, 0.0), (6, 0.0), (7, 0.0), (8, 1.0)] {
        if m[k] != want {
            let problem = format!(
                "has {} in row {}, column {}, not {want}",
                m[k],
                k / 3 + 1,
                k % 3 + 1
            );
            return fault(
                problem,
                "give the matrix by rows: [fx 0 cx], [0 fy cy], [0 0 1]",
            );
        }
    }
    Ok([m[0], m[4], m[2], m[5]])
}

/// Returns the distortion coefficients in OpenCV's order.
fn parse_distortion(node: &Node) -> Result<Vec<f64>, KeyFault> {
    let (values, shape) = matrix_values(node, TERMS_KEY)?;
    let line = shape.is_none_or(|s| s.contains(&1.0));
    if [4, 5, 8, 12, 14].contains(&values.len()) && line {
        return Ok(values);
    }
    let problem = format!("has {} numbers", values.len());
    Err(KeyFault::on_line(
        node.line,
        TERMS_KEY,
        problem,
        "give 4, 5 or 8 numbers: k1 k2 p1 p2, k3, k4 k5 k6",
    ))
}
