//! A camera of a file of any format.

use std::path::Path;

use super::format::{self, CameraFormat};
use super::interior::Interior;
use super::{listed, matrix};
use crate::installation::keyed::{self, Node, Syntax, Trouble};
use crate::installation::{Fault, Reader, camera};
use crate::measure::geometry::Lens;

/// A camera as it was read, with what somebody should see of it.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadCamera {
    /// The camera.
    pub lens: Lens,
    /// The format of its file.
    pub format: CameraFormat,
    /// Its name where the file holds cameras by name.
    pub name: Option<String>,
    /// The lens model as the file declares it.
    pub model: String,
    /// What is unusual or was not read.
    pub remarks: Vec<String>,
    /// Keys that are no part of an interior orientation.
    pub left: Vec<String>,
}

/// Reads a camera; `format` where the user names one, `camera` where he names one of several.
///
/// # Errors
/// What is wrong with its place and the mend: a model that is not ours by its name, an element that cannot be, several
/// cameras, a format that neither name nor content tell.
pub fn read_exchange(
    file: &Path,
    format: Option<CameraFormat>,
    camera: Option<&str>,
) -> Result<ReadCamera, Vec<Fault>> {
    let (mut reader, name) = Reader::of_file(file);
    let ours = Some(CameraFormat::Wingd);
    let read = if format == ours || (format.is_none() && format::by_name(file).0 == ours) {
        own(&mut reader, &name, camera)
    } else {
        foreign(&mut reader, &name, format, camera)
    };
    read.filter(|_| reader.faults.is_empty()).ok_or(reader.faults)
}

fn own(reader: &mut Reader, name: &Path, chosen: Option<&str>) -> Option<ReadCamera> {
    let camera::CameraFile { lens, covariance, .. } = camera::read(reader, name)?;
    if let Some(chosen) = chosen {
        let file = reader.directory.join(name);
        reader.fault(&file, "file", format!("holds one camera, none named {chosen}"), "leave --camera out");
    }
    let model = if lens.denominator == [0.0; 3] { "Brown's" } else { "rational" };
    let left = covariance.map(|_| "covariance".to_owned()).into_iter().collect();
    Some(ReadCamera {
        lens,
        format: CameraFormat::Wingd,
        name: None,
        model: model.into(),
        remarks: vec![],
        left,
    })
}

fn foreign(
    reader: &mut Reader,
    name: &Path,
    format: Option<CameraFormat>,
    camera: Option<&str>,
) -> Option<ReadCamera> {
    let (file, text) = reader.text(name, "name a camera's file")?;
    match read(&file, &text, format, camera) {
        Ok(read) => Some(read),
        Err(trouble) => {
            reader.trouble(&file, trouble);
            None
        }
    }
}

fn read(
    file: &Path,
    text: &str,
    format: Option<CameraFormat>,
    camera: Option<&str>,
) -> Result<ReadCamera, Trouble> {
    let (named, syntax) = format::by_name(file);
    let tree = keyed::parse(text, syntax.unwrap_or_else(|| syntax_of(text, format))).map_err(|trouble| {
        // Of a file whose name says nothing the syntax is a guess.
        let guessed = syntax.is_none() && format.is_none();
        if guessed { Trouble::new(0, "", format!("{NO_CAMERA} ({trouble})"), GIVE) } else { trouble }
    })?;
    let by_syntax = named.filter(|_| syntax == Some(Syntax::Literal));
    let format = format.or(by_syntax).or_else(|| format::by_keys(&tree)).or(named);
    let format = format.ok_or_else(|| Trouble::new(0, "", NO_CAMERA, GIVE))?;
    let (name, map) = choose(&tree, format, camera)?;
    let mut interior = interior(map, format)?;
    let lens = interior.lens(map)?;
    let Interior { model, remarks, left, .. } = interior;
    Ok(ReadCamera { lens, format, name, model, remarks, left })
}

const NO_CAMERA: &str = "holds no camera that is known";
const GIVE: &str = "give OpenCV's, ROS's, Kalibr's or mrcal's file, or name its format with --from";

/// Of a file whose name says nothing.
fn syntax_of(text: &str, format: Option<CameraFormat>) -> Syntax {
    match format {
        Some(CameraFormat::Mrcal) => Syntax::Literal,
        _ if text.trim_start().starts_with('<') => Syntax::Xml,
        _ => Syntax::Yaml,
    }
}

fn interior(map: &Node, format: CameraFormat) -> Result<Interior, Trouble> {
    match format {
        CameraFormat::Ros => matrix::read(map, true),
        CameraFormat::Opencv | CameraFormat::Wingd => matrix::read(map, false),
        CameraFormat::Kalibr => listed::kalibr(map),
        CameraFormat::Mrcal => listed::mrcal(map),
    }
}

/// The camera's map: the file itself, or the one of its parts that is named.
fn choose<'a>(
    tree: &'a Node,
    format: CameraFormat,
    camera: Option<&str>,
) -> Result<(Option<String>, &'a Node), Trouble> {
    let keys: &[&str] = match format {
        CameraFormat::Kalibr | CameraFormat::Mrcal => &[listed::INTRINSICS],
        _ => &[matrix::MATRIX, matrix::TERMS, matrix::SIZE[0]],
    };
    let is_camera =
        |map: &Node| map.entries().iter().any(|e| keys.iter().any(|k| e.key.eq_ignore_ascii_case(k)));
    let itself = is_camera(tree);
    let parts: Vec<_> = tree.entries().iter().filter(|e| is_camera(&e.node)).collect();
    let names: Vec<&str> = parts.iter().map(|e| e.key.as_str()).collect();
    match (itself, camera, &parts[..]) {
        (true, None, _) => Ok((None, tree)),
        (true, Some(camera), _) => {
            let problem = format!("holds one camera, none named {camera}");
            Err(Trouble::new(0, "", problem, "leave --camera out"))
        }
        (false, None, [one]) => Ok((Some(one.key.clone()), &one.node)),
        (false, _, []) => {
            let there: Vec<&str> = tree.entries().iter().map(|e| e.key.as_str()).take(SHOWN).collect();
            let problem = format!("is missing; the file has {}", there.join(", "));
            Err(Trouble::new(0, keys[0], problem, GIVE))
        }
        (false, None, _) => {
            let problem = format!("holds {} cameras: {}", parts.len(), names.join(", "));
            Err(Trouble::new(0, "", problem, format!("say which: --camera {}", names[0])))
        }
        (false, Some(camera), _) => {
            let found = parts.iter().find(|e| e.key == camera);
            let found = found.map(|e| (Some(e.key.clone()), &e.node));
            found.ok_or_else(|| {
                let problem = format!("holds no camera {camera}");
                Trouble::new(0, "", problem, format!("its cameras are {}", names.join(", ")))
            })
        }
    }
}

/// Keys of a file without a camera that are said.
const SHOWN: usize = 8;
