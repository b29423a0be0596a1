//! `camera.toml`: interior orientation.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::SMatrix;
use serde::{Deserialize, Serialize, Serializer};

use super::Reader;
use wingd_base::fault::Fault;
use wingd_base::pending_file::write_atomically;
use wingd_base::text::printable_path;
use wingd_measure::geometry::Lens;

/// Keys of a camera file; `C` is the table of the calibration.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LensTable<C> {
    width: i64,
    height: i64,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    k4: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    k5: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    k6: f64,
    covariance: Option<Vec<Vec<f64>>>,
    calibration: Option<C>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Keys of `[calibration]` that are read.
#[derive(Deserialize)]
struct CalibrationTable {
    covariance: Option<Vec<Vec<f64>>>,
    accepted: Option<String>,
}

/// Contents of a camera file.
pub(crate) struct CameraFile {
    pub lens: Lens,
    /// Covariance of fx fy cx cy k1 k2 k3 p1 p2, if the file has one.
    pub covariance: Option<SMatrix<f64, 9, 9>>,
    /// Reason for accepting a refused calibration.
    pub accepted: Option<String>,
}

/// Quality of a calibration, which `wingd calibrate` writes under `[calibration]` (docs/reference/files.md).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationReport {
    /// Root mean square of the residuals, px.
    pub rms_px: f64,
    /// Number of images used.
    pub images_used: usize,
    /// Number of images without a board, or that did not fit.
    pub images_rejected: usize,
    /// Number of image points used.
    pub observations: usize,
    /// Verdict: `good` or `poor`; `refused` if it was accepted nevertheless.
    pub verdict: &'static str,
    /// Reason for accepting a refused calibration, in the user's words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accepted: Option<String>,
    /// Standard deviation of projected points at 5, 15 and 40 m, root mean square over the image, px.
    pub projection_sigma_px: Vec<f64>,
    /// Bow of the board along its rows and its columns, m.
    pub board_bow_m: [f64; 2],
    pub board_bow_sigma_m: [f64; 2],
    /// Relative stretch of the board across its rows compared with along them; none if the board is taken as described.
    pub board_stretch: Option<f64>,
    pub board_stretch_sigma: Option<f64>,
    /// Difference at 15 m between calibrations from two halves of the images, and its prediction, px.
    pub halves_px: Option<[f64; 2]>,
    /// Covariance, 9 x 9, in the order of `sigma`.
    pub covariance: Vec<Vec<f64>>,
    /// Standard deviations in the order fx fy cx cy k1 k2 k3 p1 p2; none for a fixed parameter. Written by name.
    #[serde(serialize_with = "by_name")]
    pub sigma: [Option<f64>; 9],
}

fn by_name<S: Serializer>(sigma: &[Option<f64>; 9], serializer: S) -> Result<S::Ok, S::Error> {
    let named = Lens::PARAMETERS.iter().zip(sigma);
    let known: BTreeMap<_, _> = named.filter_map(|(name, s)| Some((name, (*s)?))).collect();
    known.serialize(serializer)
}

const MAX_SIDE: i64 = 100_000;

/// Extensions of camera files of other programs.
const FOREIGN_EXTENSIONS: [&str; 5] = ["yaml", "yml", "xml", "json", "cameramodel"];

/// Reads a camera file; `None` if there are errors.
pub(crate) fn read_camera(reader: &mut Reader, name: impl AsRef<Path>) -> Option<CameraFile> {
    let remedy = "write it with `wingd calibrate`, or name the right file in camera.calibration";
    let (file, text) = reader.read_text(&name, remedy)?;
    if file.extension().is_some_and(|ending| {
        FOREIGN_EXTENSIONS
            .iter()
            .any(|other| ending.eq_ignore_ascii_case(other))
    }) {
        let remedy = format!(
            "convert it: wingd convert {} camera.toml",
            printable_path(&file)
        );
        reader.fault(&file, "file", "is not a camera.toml", remedy);
        return None;
    }
    let table: LensTable<CalibrationTable> = reader.parse_toml(&file, &text)?;
    let before = reader.faults.len();
    for (key, side) in [("width", table.width), ("height", table.height)] {
        if !(1..=MAX_SIDE).contains(&side) {
            reader.fault(
                &file,
                key,
                format!("is {side} px"),
                "give the size of the frames in pixels",
            );
        }
    }
    for (key, f) in [("fx", table.fx), ("fy", table.fy)] {
        if !(f.is_finite() && f > 0.0) {
            reader.fault(
                &file,
                key,
                format!("is {f} px"),
                "give the focal length in pixels, above 0",
            );
        }
    }
    let lens = Lens {
        width: table.width as u32,
        height: table.height as u32,
        fx: table.fx,
        fy: table.fy,
        cx: table.cx,
        cy: table.cy,
        k1: table.k1,
        k2: table.k2,
        k3: table.k3,
        p1: table.p1,
        p2: table.p2,
        denominator: [table.k4, table.k5, table.k6],
    };
    let parameters = lens.parameters();
    let named = Lens::PARAMETERS.into_iter().chain(["k4", "k5", "k6"]);
    let values = parameters.iter().copied().chain(lens.denominator);
    for (key, value) in named
        .zip(values)
        .skip(2)
        .filter(|(_, value)| !value.is_finite())
    {
        reader.fault(&file, key, format!("is {value}"), "give a finite number");
    }
    if reader.faults.len() > before {
        return None;
    }
    if let Err(error) = lens.check_edge() {
        reader.fault(
            &file,
            "k1 to p2",
            error.to_string(),
            "calibrate again with points up to the corners",
        );
    }
    let (of_calibration, accepted) = table
        .calibration
        .map_or((None, None), |c| (c.covariance, c.accepted));
    let given = table.covariance.or(of_calibration);
    let covariance = given.and_then(|rows| parse_covariance(reader, &file, &rows));
    Some(CameraFile {
        lens,
        covariance,
        accepted,
    })
}

/// Reads a camera file alone (`camera.toml`).
///
/// # Errors
/// Returns all errors of the file.
pub fn load_camera(file: &Path) -> Result<Lens, Vec<Fault>> {
    Reader::read_file(file, |reader, name| Some(read_camera(reader, name)?.lens))
}

/// Parses a covariance: 9 x 9, finite, with possible variances and correlations.
fn parse_covariance(
    reader: &mut Reader,
    file: &Path,
    rows: &[Vec<f64>],
) -> Option<SMatrix<f64, 9, 9>> {
    let square = rows.len() == 9
        && rows
            .iter()
            .all(|r| r.len() == 9 && r.iter().all(|v| v.is_finite()));
    let matrix = square.then(|| {
        let m = SMatrix::<f64, 9, 9>::from_fn(|i, j| rows[i][j]);
        (m + m.transpose()) * 0.5
    });
    // A fixed parameter has a variance of 0.
    let correlations = matrix.filter(|m| m.diagonal().min() >= 0.0).map(|m| {
        let sigma = m.diagonal().map(|v| if v > 0.0 { v.sqrt() } else { 1.0 });
        m.component_div(&(sigma * sigma.transpose()))
    });
    // Rounding in the file may leave eigenvalues a little below 0.
    if correlations.is_none_or(|c| c.symmetric_eigenvalues().min() < -1e-6) {
        let remedy = "give 9 rows of 9 numbers in the order fx fy cx cy k1 k2 k3 p1 p2, as `wingd calibrate` writes them";
        reader.fault(
            file,
            "covariance",
            "is not a covariance of nine parameters",
            remedy,
        );
        return None;
    }
    matrix
}

/// Writes `camera.toml` with the result of a calibration.
pub fn write_camera(
    file: &Path,
    lens: &Lens,
    report: Option<&CalibrationReport>,
) -> std::io::Result<()> {
    let [k4, k5, k6] = lens.denominator;
    let table = LensTable {
        width: lens.width.into(),
        height: lens.height.into(),
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        k1: lens.k1,
        k2: lens.k2,
        k3: lens.k3,
        p1: lens.p1,
        p2: lens.p2,
        k4,
        k5,
        k6,
        covariance: None,
        calibration: report,
    };
    let text = toml::to_string(&table).map_err(std::io::Error::other)?;
    write_atomically(file, &text)
}
