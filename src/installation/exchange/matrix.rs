//! Cameras with a matrix and a list of coefficients: OpenCV's FileStorage and ROS's camera_info.

use super::declared::{self, foreign, is_browns, plain};
use super::interior::Interior;
use crate::installation::keyed::{Node, Trouble, Value};

pub(super) const SIZE: [&str; 2] = ["image_width", "image_height"];
pub(super) const MATRIX: &str = "camera_matrix";
pub(super) const TERMS: &str = "distortion_coefficients";
const MODEL: &str = "distortion_model";
/// What else camera_calibration_parsers and OpenCV's calibration write.
const BESIDE: [&str; 25] = [
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
const MEND: &str = "export the calibration again, or name its format with --from";

/// Reads a camera's map. ROS declares its model; OpenCV's calibration writes none and has its own order of terms.
pub(super) fn read(map: &Node, of_ros: bool) -> Result<Interior, Trouble> {
    let known = [SIZE[0], SIZE[1], MATRIX, TERMS, MODEL];
    let (left, mut remarks) = declared::check(map, &known, &BESIDE)?;
    let model = model(map, of_ros, &mut remarks)?;
    let side =
        |key: &str| map.need(key, "add the size of the pictures, px: image_width, image_height")?.number(key);
    let size = [side(SIZE[0])?, side(SIZE[1])?];
    let core = core(map.need(MATRIX, MEND)?)?;
    let terms = terms(map.need(TERMS, MEND)?)?;
    let problem = match model.as_str() {
        PLUMB_BOB if terms.len() > 5 => {
            Some(format!("are {} numbers, but {MODEL} is {PLUMB_BOB}, which has 5", terms.len()))
        }
        NO_MODEL if terms.iter().any(|term| *term != 0.0) => {
            Some(format!("are not all 0, but {MODEL} is {NO_MODEL}"))
        }
        _ => None,
    };
    if let Some(problem) = problem {
        let line = map.need(TERMS, MEND)?.line;
        return Err(Trouble::new(line, TERMS, problem, "name the model that was calibrated"));
    }
    let keys = [SIZE[0], MATRIX, TERMS];
    Ok(Interior { size, core, terms, model, keys, remarks, left })
}

fn model(map: &Node, of_ros: bool, remarks: &mut Vec<String>) -> Result<String, Trouble> {
    let Some(node) = map.get(MODEL)? else {
        if of_ros {
            let mend = "name the model that was calibrated: plumb_bob or rational_polynomial";
            return Err(Trouble::new(map.line, MODEL, "is missing", mend));
        }
        remarks.push("no lens model is declared: taken for OpenCV's k1 k2 p1 p2 k3 k4 k5 k6".into());
        return Ok("no model declared".into());
    };
    let name = node.text().unwrap_or("a list").trim();
    match plain(name).as_str() {
        _ if is_browns(name) => Ok(PLUMB_BOB.into()),
        "rationalpolynomial" => Ok("rational_polynomial".into()),
        "none" => Ok(NO_MODEL.into()),
        "" | "null" => {
            Err(Trouble::new(node.line, MODEL, "is empty: this camera was never calibrated", MEND))
        }
        _ => Err(foreign(node, MODEL, name)),
    }
}

/// The numbers of a matrix, as many as its rows and columns say.
fn data(node: &Node, key: &str) -> Result<(Vec<f64>, Option<[f64; 2]>), Trouble> {
    if !matches!(node.value, Value::Map(_)) {
        return Ok((flat(node, key)?, None));
    }
    let values = flat(node.need("data", MEND)?, key)?;
    let side = |name: &str| node.get(name)?.map(|n| n.number(&format!("{key}.{name}"))).transpose();
    let sides: [Option<f64>; 2] = [side("rows")?, side("cols")?];
    let shape = sides[0].zip(sides[1]).map(|(rows, cols)| [rows, cols]);
    if let Some([rows, cols]) = shape.filter(|[rows, cols]| rows * cols != values.len() as f64) {
        let problem = format!("holds {} numbers for {rows} rows of {cols}", values.len());
        return Err(Trouble::new(node.line, key, problem, MEND));
    }
    Ok((values, shape))
}

/// A list, or rows as lists of their own.
fn flat(node: &Node, key: &str) -> Result<Vec<f64>, Trouble> {
    let Value::List(items) = &node.value else { return node.numbers(key) };
    if !items.iter().all(|item| matches!(item.value, Value::List(_))) {
        return node.numbers(key);
    }
    let rows: Result<Vec<Vec<f64>>, Trouble> = items.iter().map(|item| item.numbers(key)).collect();
    Ok(rows?.concat())
}

/// fx, fy, cx, cy of a matrix of three rows; its other elements must be those of a camera without skew.
fn core(node: &Node) -> Result<[f64; 4], Trouble> {
    let (m, shape) = data(node, MATRIX)?;
    let fault = |problem: String, mend: &str| Err(Trouble::new(node.line, MATRIX, problem, mend));
    if m.len() != 9 || shape.is_some_and(|s| s != [3.0, 3.0]) {
        return fault(format!("holds {} numbers", m.len()), "give 3 rows of 3 numbers");
    }
    if m.iter().all(|v| *v == 0.0) {
        let mend = "calibrate it, or take the file that its calibration wrote";
        return fault("holds zeros: this camera was never calibrated".into(), mend);
    }
    if m[2] == 0.0 && m[5] == 0.0 && (m[6] != 0.0 || m[7] != 0.0) {
        let problem = format!(
            "is transposed: row 3 begins with {} and {}, where cx and cy stand in column 3",
            m[6], m[7]
        );
        return fault(problem, "give its rows: fx 0 cx, 0 fy cy, 0 0 1");
    }
    if m[1] != 0.0 {
        let problem = format!("has a skew of {} px (row 1, column 2), which no lens of ours has", m[1]);
        return fault(problem, "calibrate without skew");
    }
    for (k, want) in [(3, 0.0), (6, 0.0), (7, 0.0), (8, 1.0)] {
        if m[k] != want {
            let problem = format!("has {} in row {}, column {}, not {want}", m[k], k / 3 + 1, k % 3 + 1);
            return fault(problem, "give its rows: fx 0 cx, 0 fy cy, 0 0 1");
        }
    }
    Ok([m[0], m[4], m[2], m[5]])
}

/// The coefficients in OpenCV's order.
fn terms(node: &Node) -> Result<Vec<f64>, Trouble> {
    let (values, shape) = data(node, TERMS)?;
    let line = shape.is_none_or(|s| s.contains(&1.0));
    if [4, 5, 8, 12, 14].contains(&values.len()) && line {
        return Ok(values);
    }
    let problem = format!("holds {} numbers", values.len());
    Err(Trouble::new(node.line, TERMS, problem, "give 4, 5 or 8 numbers: k1 k2 p1 p2, k3, k4 k5 k6"))
}
