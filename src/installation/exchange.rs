//! Cameras as other programs write them: OpenCV, ROS, Kalibr, mrcal. All count pixels from the centre of the
//! top-left one and use Brown's distortion in OpenCV's order k1 k2 p1 p2 k3, for a rational lens with k4 k5 k6 behind it.

use std::path::Path;

use nalgebra::Vector2;

use super::{Fault, Reader, camera, write_whole};
use crate::measure::geometry::Lens;

/// A file format for cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraFormat {
    /// `camera.toml`.
    Wingd,
    /// OpenCV's FileStorage in YAML.
    Opencv,
    /// camera_info, as camera_calibration_parsers writes it.
    Ros,
    /// Kalibr's camchain.
    Kalibr,
    /// mrcal's cameramodel.
    Mrcal,
}

/// Of a file by its name; YAML by what stands in it where that is known.
pub fn format_of(file: &Path, text: Option<&str>) -> Option<CameraFormat> {
    let name = file.file_name()?.to_string_lossy().to_lowercase();
    let ending = Path::new(&name).extension()?.to_string_lossy().into_owned();
    let inside = |word: &str| text.is_some_and(|t| t.contains(word));
    match ending.as_str() {
        "toml" => Some(CameraFormat::Wingd),
        "cameramodel" => Some(CameraFormat::Mrcal),
        "yaml" | "yml" if inside("opencv-matrix") => Some(CameraFormat::Opencv),
        "yaml" | "yml" if inside("distortion_coeffs") => Some(CameraFormat::Kalibr),
        "yaml" | "yml" if inside("distortion_model") => Some(CameraFormat::Ros),
        "yaml" | "yml" if name.contains("camchain") => Some(CameraFormat::Kalibr),
        "yaml" | "yml" if name.contains("camera_info") => Some(CameraFormat::Ros),
        "yaml" | "yml" => Some(CameraFormat::Opencv),
        _ => None,
    }
}

/// The camera of a file of any format.
///
/// # Errors
/// Every fault with its place and the mend: a model that is not Brown's, numbers that are missing.
pub fn read_exchange(file: &Path, format: CameraFormat) -> Result<Lens, Vec<Fault>> {
    let directory = file.parent().unwrap_or(Path::new("")).to_owned();
    let name = file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut reader = Reader { directory, faults: vec![], digests: vec![] };
    let lens = if format == CameraFormat::Wingd {
        camera::read(&mut reader, &name).map(|(lens, _)| lens)
    } else {
        foreign(&mut reader, &name, format)
    };
    lens.filter(|_| reader.faults.is_empty()).ok_or(reader.faults)
}

fn foreign(reader: &mut Reader, name: &str, format: CameraFormat) -> Option<Lens> {
    let (file, text) = reader.text(name, "name a camera's file")?;
    let mut need = |keys: &[&str], count: usize| {
        let found = numbers(&text, keys).filter(|n| n.len() >= count && n.iter().all(|v| v.is_finite()));
        if found.is_none() {
            let problem = format!("does not hold {count} numbers");
            reader.fault(&file, &keys.join("."), problem, "export it again, or name its format with --from");
        }
        found
    };
    let (size, core, distortion) = match format {
        CameraFormat::Opencv | CameraFormat::Ros => {
            let size = [need(&["image_width"], 1)?[0], need(&["image_height"], 1)?[0]];
            let m = need(&["camera_matrix", "data"], 9)?;
            let d = need(&["distortion_coefficients", "data"], 4)?;
            (size, [m[0], m[4], m[2], m[5]], d)
        }
        CameraFormat::Kalibr => {
            let (size, i) = (need(&["resolution"], 2)?, need(&["intrinsics"], 4)?);
            ([size[0], size[1]], [i[0], i[1], i[2], i[3]], need(&["distortion_coeffs"], 4)?)
        }
        _ => {
            let (size, i) = (need(&["imagersize"], 2)?, need(&["intrinsics"], 4)?);
            ([size[0], size[1]], [i[0], i[1], i[2], i[3]], i[4..].to_vec())
        }
    };
    let model = model(&text, format, distortion.len());
    let rest = distortion.get(8..).unwrap_or(&[]);
    if !model || rest.iter().any(|v| *v != 0.0) {
        let problem =
            "holds another model than Brown's with k1 k2 p1 p2 k3 or the rational one with k4 k5 k6";
        reader.fault(
            &file,
            "distortion",
            problem,
            "calibrate with one of these: OPENCV4, OPENCV5, OPENCV8, radtan, plumb_bob, rational_polynomial",
        );
        return None;
    }
    let d = |k: usize| distortion.get(k).copied().unwrap_or(0.0);
    let pinhole = Lens::pinhole(size[0] as u32, size[1] as u32, core[0], core[2], core[3]);
    let lens = Lens {
        fy: core[1],
        k1: d(0),
        k2: d(1),
        p1: d(2),
        p2: d(3),
        k3: d(4),
        denominator: [d(5), d(6), d(7)],
        ..pinhole
    };
    let corners = [(0.0, 0.0), (size[0], 0.0), (0.0, size[1]), (size[0], size[1])];
    let sound = lens.width > 0 && lens.height > 0 && lens.fx > 0.0 && lens.fy > 0.0;
    if !sound || corners.iter().any(|(u, v)| lens.ray(&Vector2::new(u - 0.5, v - 0.5)).is_err()) {
        let problem = "is no lens, or one that has no inverse over the whole image";
        reader.fault(&file, "distortion", problem, "calibrate again with boards up to the corners");
        return None;
    }
    Some(lens)
}

/// Whether the file names Brown's model.
fn model(text: &str, format: CameraFormat, terms: usize) -> bool {
    match format {
        CameraFormat::Ros => {
            text.contains("plumb_bob") || (text.contains("rational_polynomial") && terms > 5)
        }
        CameraFormat::Kalibr => text.contains("radtan") && text.contains("pinhole") && !text.contains("omni"),
        CameraFormat::Mrcal => match terms {
            0 => text.contains("LENSMODEL_PINHOLE"),
            4 => text.contains("LENSMODEL_OPENCV4"),
            5 => text.contains("LENSMODEL_OPENCV5"),
            8 => text.contains("LENSMODEL_OPENCV8"),
            12 => text.contains("LENSMODEL_OPENCV12"),
            _ => false,
        },
        _ => true,
    }
}

/// The numbers behind a path of keys: a single one, a list in brackets, or lines that begin with a dash.
fn numbers(text: &str, keys: &[&str]) -> Option<Vec<f64>> {
    let mut rest = text;
    for key in keys {
        rest = after(rest, key)?;
    }
    let rest = rest.trim_start();
    if let Some(list) = rest.strip_prefix('[') {
        let inner = list.split(']').next()?;
        let cells = inner.split([',', '\n']).map(str::trim).filter(|c| !c.is_empty());
        return cells.map(|c| c.parse().ok()).collect();
    }
    if rest.starts_with("- ") {
        let lines = rest.lines().map(str::trim).map_while(|l| l.strip_prefix("- "));
        return lines.map(|l| l.trim().parse().ok()).collect();
    }
    let scalar = rest.split(['\n', ',', '#', '}']).next()?;
    Some(vec![scalar.trim().parse().ok()?])
}

/// What follows `key:` at the beginning of an entry, quoted or not.
fn after<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let starts = text.match_indices(key);
    starts.map(|(at, _)| (at, at + key.len())).find_map(|(at, end)| {
        let before = text[..at].chars().next_back().unwrap_or('\n');
        let rest = text[end..].trim_start_matches(['\'', '"']).trim_start_matches(' ');
        let begins = !(before.is_alphanumeric() || before == '_');
        begins.then(|| rest.strip_prefix(':')).flatten()
    })
}

/// Writes a camera; its covariance has no place in these formats.
///
/// # Errors
/// A sentence with the mend: the format cannot hold the lens, or the file cannot be written.
pub fn write_exchange(file: &Path, lens: &Lens, format: CameraFormat) -> Result<(), String> {
    if format == CameraFormat::Wingd {
        return camera::write_camera(file, lens, None).map_err(|e| unwritable(file, &e));
    }
    let text = match format {
        CameraFormat::Opencv => opencv(lens),
        CameraFormat::Ros => ros(lens),
        CameraFormat::Kalibr if rational(lens) => {
            return Err("Kalibr's radtan has no k4, k5, k6; convert to another format".into());
        }
        CameraFormat::Kalibr if lens.k3 != 0.0 => {
            return Err(
                "Kalibr's radtan has no k3; calibrate with --select, which drops it where it is not \
                        significant, or convert to another format"
                    .into(),
            );
        }
        CameraFormat::Kalibr => kalibr(lens),
        _ => mrcal(lens),
    };
    write_whole(file, &text).map_err(|e| unwritable(file, &e))
}

fn unwritable(file: &Path, error: &std::io::Error) -> String {
    format!("{} cannot be written ({error}); check rights and space", file.display())
}

fn matrix(l: &Lens) -> String {
    format!("[{:?}, 0., {:?}, 0., {:?}, {:?}, 0., 0., 1.]", l.fx, l.cx, l.fy, l.cy)
}

fn rational(l: &Lens) -> bool {
    l.denominator != [0.0; 3]
}

/// The distortion's terms in OpenCV's order, and their number.
fn terms(l: &Lens) -> (String, usize) {
    let brown = format!("{:?}, {:?}, {:?}, {:?}, {:?}", l.k1, l.k2, l.p1, l.p2, l.k3);
    let [k4, k5, k6] = l.denominator;
    if rational(l) { (format!("{brown}, {k4:?}, {k5:?}, {k6:?}"), 8) } else { (brown, 5) }
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
    format!(
        "image_width: {width}\nimage_height: {height}\ncamera_name: wingd\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix}\n\
         distortion_model: {model}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {count}\n  data: [{terms}]\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{:?}, 0., {:?}, 0., 0., {:?}, {:?}, 0., 0., 0., 1., 0.]\n",
        l.fx, l.cx, l.fy, l.cy
    )
}

fn kalibr(l: &Lens) -> String {
    format!(
        "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [{:?}, {:?}, {:?}, {:?}]\n  distortion_model: radtan\n  \
         intrinsics: [{:?}, {:?}, {:?}, {:?}]\n  resolution: [{}, {}]\n  rostopic: /cam0/image_raw\n",
        l.k1, l.k2, l.p1, l.p2, l.fx, l.fy, l.cx, l.cy, l.width, l.height
    )
}

fn mrcal(l: &Lens) -> String {
    let (terms, count) = terms(l);
    format!(
        "{{\n    'lensmodel':  'LENSMODEL_OPENCV{count}',\n\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n    \
         'intrinsics': [ {:?}, {:?}, {:?}, {:?}, {},],\n\n    'imagersize': [ {}, {},]\n}}\n",
        l.fx, l.fy, l.cx, l.cy, terms, l.width, l.height
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        let pinhole = Lens::pinhole(4000, 3000, 7801.25, 1990.5, 1512.125);
        Lens { fy: 7799.5, k1: -0.0512, k2: 0.09, p1: -3.1e-7, p2: 2e-4, ..pinhole }
    }

    #[test]
    fn every_format_gives_the_camera_back() {
        let directory = tempfile::tempdir().unwrap();
        for (name, format) in [
            ("a.toml", CameraFormat::Wingd),
            ("a.yaml", CameraFormat::Opencv),
            ("camera_info.yaml", CameraFormat::Ros),
            ("a-camchain.yaml", CameraFormat::Kalibr),
            ("a.cameramodel", CameraFormat::Mrcal),
        ] {
            let file = directory.path().join(name);
            assert_eq!(format_of(&file, None), Some(format));
            write_exchange(&file, &lens(), format).unwrap();
            let text = std::fs::read_to_string(&file).unwrap();
            assert_eq!(format_of(&file, Some(&text)), Some(format), "{name}");
            assert_eq!(read_exchange(&file, format).unwrap(), lens(), "{name}");
        }
    }

    #[test]
    fn lists_in_brackets_over_lines_and_with_dashes_are_read() {
        let text = "cam0:\n  intrinsics:\n  - 1.0\n  - 2.5e1\n  resolution: [4000,\n   3000]\n";
        assert_eq!(numbers(text, &["intrinsics"]), Some(vec![1.0, 25.0]));
        assert_eq!(numbers(text, &["resolution"]), Some(vec![4000.0, 3000.0]));
        assert_eq!(numbers("camera_matrix_x: 3\nmatrix: 4 # px\n", &["matrix"]), Some(vec![4.0]));
        assert_eq!(numbers(text, &["distortion"]), None);
    }

    #[test]
    fn what_a_format_cannot_hold_is_refused_with_the_mend() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("camchain.yaml");
        let error = write_exchange(&file, &Lens { k3: 0.1, ..lens() }, CameraFormat::Kalibr).unwrap_err();
        assert!(error.contains("--select") && !file.exists());
        let fisheye = "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]\n  distortion_model: \
                       equidistant\n  intrinsics: [500, 500, 320, 240]\n  resolution: [640, 480]\n";
        std::fs::write(&file, fisheye).unwrap();
        let faults = read_exchange(&file, CameraFormat::Kalibr).unwrap_err();
        assert!(faults[0].to_string().contains("another model"), "{faults:?}");
    }
}
