//! Reading of a camera from a file of any format.

use std::path::Path;

use super::format::{self, CameraFormat};
use super::interior::Interior;
use super::keyed::{self, Node, Syntax};
use super::{listed, matrix};
use crate::installation::{self, CameraFile, Fault, KeyFault, Reader};
use crate::measure::geometry::Lens;

/// Camera read from a file, with remarks for the user.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadCamera {
    pub lens: Lens,
    /// Format of the file.
    pub format: CameraFormat,
    /// Name of the camera, if the file has named cameras.
    pub name: Option<String>,
    /// Lens model as the file declares it.
    pub model: String,
    /// Remarks on unusual values and unknown keys.
    pub remarks: Vec<String>,
    /// Keys that are not part of an interior orientation.
    pub left: Vec<String>,
}

/// Reads a camera in `format`, or in the detected format; `camera` selects one of several.
///
/// # Errors
/// Returns an error with its place and remedy if the model is not supported, a value is impossible, the file has several
/// cameras, or neither name nor content determine the format.
pub fn read_exchange(
    file: &Path,
    format: Option<CameraFormat>,
    camera: Option<&str>,
) -> Result<ReadCamera, Vec<Fault>> {
    let ours = Some(CameraFormat::Wingd);
    if format == ours || (format.is_none() && format::format_from_name(file).0 == ours) {
        return Reader::read_file(file, |reader, name| read_own_format(reader, name, camera));
    }
    Reader::read_file(file, |reader, name| {
        read_foreign_format(reader, name, format, camera)
    })
}

fn read_own_format(reader: &mut Reader, name: &Path, chosen: Option<&str>) -> Option<ReadCamera> {
    let CameraFile {
        lens, covariance, ..
    } = installation::read_camera(reader, name)?;
    if let Some(chosen) = chosen {
        let file = reader.directory.join(name);
        reader.fault(
            &file,
            "file",
            format!("has one camera, not named {chosen}"),
            "omit --camera",
        );
    }
    let model = if lens.denominator == [0.0; 3] {
        "Brown's"
    } else {
        "rational"
    };
    let left = covariance
        .map(|_| "covariance".to_owned())
        .into_iter()
        .collect();
    Some(ReadCamera {
        lens,
        format: CameraFormat::Wingd,
        name: None,
        model: model.into(),
        remarks: vec![],
        left,
    })
}

fn read_foreign_format(
    reader: &mut Reader,
    name: &Path,
    format: Option<CameraFormat>,
    camera: Option<&str>,
) -> Option<ReadCamera> {
    let (file, text) = reader.read_text(name, "name a camera file")?;
    match parse_exchange(&file, &text, format, camera) {
        Ok(read) => Some(read),
        Err(fault) => {
            reader.add_key_fault(&file, fault);
            None
        }
    }
}

fn parse_exchange(
    file: &Path,
    text: &str,
    format: Option<CameraFormat>,
    camera: Option<&str>,
) -> Result<ReadCamera, KeyFault> {
    let (named, syntax) = format::format_from_name(file);
    let tree = keyed::parse_keyed(text, syntax.unwrap_or_else(|| guess_syntax(text, format)))
        .map_err(|fault| {
            // If the file's name does not imply a syntax, the syntax is a guess.
            let guessed = syntax.is_none() && format.is_none();
            if guessed {
                KeyFault::on_line(0, "", format!("{NO_CAMERA} ({fault})"), FORMAT_REMEDY)
            } else {
                fault
            }
        })?;
    let by_syntax = named.filter(|_| syntax == Some(Syntax::Literal));
    let format = format
        .or(by_syntax)
        .or_else(|| format::format_from_keys(&tree))
        .or(named);
    let format = format.ok_or_else(|| KeyFault::on_line(0, "", NO_CAMERA, FORMAT_REMEDY))?;
    let (name, map) = choose_camera(&tree, format, camera)?;
    let mut interior = read_interior(map, format)?;
    let lens = interior.check_lens(map)?;
    let Interior {
        model,
        remarks,
        left,
        ..
    } = interior;
    Ok(ReadCamera {
        lens,
        format,
        name,
        model,
        remarks,
        left,
    })
}

const NO_CAMERA: &str = "has no known camera";
const FORMAT_REMEDY: &str =
    "give OpenCV's, ROS's, Kalibr's or mrcal's file, or name its format with --from";

/// Returns the likely syntax of a file whose name does not imply it.
fn guess_syntax(text: &str, format: Option<CameraFormat>) -> Syntax {
    match format {
        Some(CameraFormat::Mrcal) => Syntax::Literal,
        _ if text.trim_start().starts_with('<') => Syntax::Xml,
        _ => Syntax::Yaml,
    }
}

fn read_interior(map: &Node, format: CameraFormat) -> Result<Interior, KeyFault> {
    match format {
        CameraFormat::Ros => matrix::read_matrix_camera(map, true),
        CameraFormat::Opencv | CameraFormat::Wingd => matrix::read_matrix_camera(map, false),
        CameraFormat::Kalibr => listed::read_kalibr(map),
        CameraFormat::Mrcal => listed::read_mrcal(map),
    }
}

/// Returns the camera's map: the file itself, or the selected part.
fn choose_camera<'a>(
    tree: &'a Node,
    format: CameraFormat,
    camera: Option<&str>,
) -> Result<(Option<String>, &'a Node), KeyFault> {
    let keys: &[&str] = match format {
        CameraFormat::Kalibr | CameraFormat::Mrcal => &[listed::INTRINSICS_KEY],
        _ => &[matrix::MATRIX_KEY, matrix::TERMS_KEY, matrix::SIZE_KEYS[0]],
    };
    let is_camera = |map: &Node| {
        map.entries()
            .iter()
            .any(|e| keys.iter().any(|k| e.key.eq_ignore_ascii_case(k)))
    };
    let itself = is_camera(tree);
    let parts: Vec<_> = tree
        .entries()
        .iter()
        .filter(|e| is_camera(&e.node))
        .collect();
    let names: Vec<&str> = parts.iter().map(|e| e.key.as_str()).collect();
    match (itself, camera, &parts[..]) {
        (true, None, _) => Ok((None, tree)),
        (true, Some(camera), _) => {
            let problem = format!("has one camera, not named {camera}");
            Err(KeyFault::on_line(0, "", problem, "omit --camera"))
        }
        (false, None, [one]) => Ok((Some(one.key.clone()), &one.node)),
        (false, _, []) => {
            let there: Vec<&str> = tree
                .entries()
                .iter()
                .map(|e| e.key.as_str())
                .take(MAX_KEYS_NAMED)
                .collect();
            let problem = format!("is missing; the file has {}", there.join(", "));
            Err(KeyFault::on_line(0, keys[0], problem, FORMAT_REMEDY))
        }
        (false, None, _) => {
            let problem = format!("has {} cameras: {}", parts.len(), names.join(", "));
            Err(KeyFault::on_line(
                0,
                "",
                problem,
                format!("select one: --camera {}", names[0]),
            ))
        }
        (false, Some(camera), _) => {
            let found = parts.iter().find(|e| e.key == camera);
            let found = found.map(|e| (Some(e.key.clone()), &e.node));
            found.ok_or_else(|| {
                let problem = format!("has no camera {camera}");
                KeyFault::on_line(
                    0,
                    "",
                    problem,
                    format!("its cameras are {}", names.join(", ")),
                )
            })
        }
    }
}

/// Largest number of keys named in the error for a file without a camera.
const MAX_KEYS_NAMED: usize = 8;
