//! `orientation.toml`: the camera's attitude, written by `wingd orient`.

use std::collections::BTreeMap;
use std::path::Path;

use image::codecs::png::{PngDecoder, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageDecoder as _, ImageEncoder as _};
use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::{Installation, ORIENTATION_FILE, Reader};
use wingd_base::pending_file::write_atomically;
use wingd_measure::identify::OrientationFit;
use wingd_measure::observation::Observation;
use wingd_measure::points::TEMPLATE_SIDE_PX;
use wingd_measure::raster::Raster;
use wingd_measure::setup::{Orientation, PointTemplate, Shape, SurveyMarker};

/// Keys of `orientation.toml`. Those that no command reads are for people.
#[derive(Serialize, Deserialize)]
struct OrientationTable {
    camera_from_survey: [[f64; 3]; 3],
    /// Of a small rotation about the camera's axes.
    #[serde(skip_deserializing)]
    sigma_mrad: Option<[f64; 3]>,
    covariance_rad2: Option<[[f64; 3]; 3]>,
    #[serde(skip_deserializing)]
    variance_factor: f64,
    #[serde(skip_deserializing)]
    redundancy: usize,
    /// Reason for accepting an orientation that its test refuses.
    accepted: Option<String>,
    /// File name -> SHA-256 of camera, survey and templates.
    #[serde(default)]
    made_with: BTreeMap<String, String>,
    #[serde(skip_deserializing)]
    image: Vec<ImageEntry>,
    /// Markers that were not used, with the reason.
    #[serde(default)]
    unused: Vec<UnusedMarker>,
    #[serde(default)]
    ground: Vec<GroundEntry>,
    /// Points whose templates are in [`TEMPLATES_FILE`], from top to bottom.
    #[serde(default)]
    point: Vec<PointEntry>,
}

#[derive(Serialize)]
struct ImageEntry {
    name: String,
    sha256: String,
    /// Observed less computed place of each marker.
    residuals: Vec<ResidualEntry>,
}

#[derive(Serialize)]
struct ResidualEntry {
    id: String,
    u_px: f64,
    v_px: f64,
}

#[derive(Serialize, Deserialize)]
struct UnusedMarker {
    id: String,
    reason: String,
}

#[derive(Serialize, Deserialize)]
struct GroundEntry {
    id: String,
    u_px: f64,
    v_px: f64,
    covariance_px2: [f64; 3],
}

/// Origin of a template in the ground frame, and place of the point.
#[derive(Serialize, Deserialize)]
struct PointEntry {
    id: String,
    left_px: usize,
    top_px: usize,
    u_px: f64,
    v_px: f64,
}

/// Image of the templates of all points, one below the other.
const TEMPLATES_FILE: &str = "points.png";

/// Remedy for every error of the file.
const ORIENT_AGAIN: &str = "run `wingd orient` again with the ground frames";

/// Largest deviation of the rows from orthonormality that rounding in a text file explains.
const ORTHONORMAL_TOLERANCE: f64 = 1e-6;

/// Contents of `orientation.toml`.
pub(super) struct StoredOrientation {
    pub orientation: Orientation,
    /// Markers that the ground frames did not use, with the reason.
    pub unused: Vec<(usize, String)>,
    /// Reason for accepting an orientation that its test refuses.
    pub accepted: Option<String>,
}

/// Reads the orientation.
pub(super) fn read_orientation(
    reader: &mut Reader,
    markers: &[SurveyMarker],
) -> Option<StoredOrientation> {
    if !reader.directory.join(ORIENTATION_FILE).exists() {
        return None;
    }
    let (file, text) = reader.read_text(ORIENTATION_FILE, "write it with `wingd orient`")?;
    let table: OrientationTable = reader.parse_toml(&file, &text)?;
    let m = matrix_from_rows(&table.camera_from_survey);
    let defect = (m * m.transpose() - Matrix3::identity()).amax();
    if !(defect < ORTHONORMAL_TOLERANCE && m.determinant() > 0.0) {
        let problem = format!(
            "is not a rotation (largest defect {defect:.1e}, determinant {:.6})",
            m.determinant()
        );
        reader.fault(&file, "camera_from_survey", problem, ORIENT_AGAIN);
        return None;
    }
    let covariance_rad2 = table.covariance_rad2.as_ref().map(matrix_from_rows);
    if covariance_rad2.is_some_and(|c| !is_covariance(&c)) {
        let problem = "is not a covariance (finite, symmetric, positive variances)";
        reader.fault(&file, "covariance_rad2", problem, ORIENT_AGAIN);
    }
    let ground = table
        .ground
        .iter()
        .filter_map(|s| parse_ground_observation(reader, &file, s, markers))
        .collect();
    // Rounding errors are removed so that products of rotations stay rotations.
    let svd = m.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let camera_from_survey = Rotation3::from_matrix_unchecked(rotation);
    let index = |u: UnusedMarker| Some((markers.iter().position(|m| m.id == u.id)?, u.reason));
    let unused = table.unused.into_iter().filter_map(index).collect();
    let templates = if table.point.is_empty() {
        Some(vec![])
    } else {
        read_templates(reader, &table.point, markers)
    };
    check_sources(reader, &file, &table.made_with);
    let templates = templates?;
    let orientation = Orientation {
        camera_from_survey,
        covariance_rad2,
        ground,
        templates,
    };
    Some(StoredOrientation {
        orientation,
        unused,
        accepted: table.accepted,
    })
}

/// Reads the templates of points.
fn read_templates(
    reader: &mut Reader,
    entries: &[PointEntry],
    markers: &[SurveyMarker],
) -> Option<Vec<PointTemplate>> {
    let remedy = ORIENT_AGAIN;
    let (file, bytes) = reader.read_bytes(TEMPLATES_FILE, remedy)?;
    let side = TEMPLATE_SIDE_PX;
    let size = (side as u32, (side * entries.len()) as u32);
    let decoder = PngDecoder::new(std::io::Cursor::new(bytes))
        .ok()
        .filter(|decoder| decoder.dimensions() == size);
    let Some(grey) = decoder
        .and_then(|decoder| DynamicImage::from_decoder(decoder).ok())
        .map(|i| i.to_luma8())
    else {
        let problem = format!(
            "is not an image of {} templates of {side} px",
            entries.len()
        );
        reader.fault(&file, "file", problem, remedy);
        return None;
    };
    let template = |(entry, patch): (&PointEntry, &[u8])| {
        let marker = markers
            .iter()
            .position(|m| m.id == entry.id && m.shape == Shape::Point)?;
        let origin_px = [entry.left_px, entry.top_px];
        let place_px = Vector2::new(entry.u_px, entry.v_px);
        let template = PointTemplate {
            marker,
            patch: Raster::new(side, side, patch.to_vec())?,
            origin_px,
            place_px,
        };
        template.is_centred().then_some(template)
    };
    let templates = entries
        .iter()
        .zip(grey.as_raw().chunks_exact(side * side))
        .map(template);
    let found: Option<Vec<PointTemplate>> = templates.collect();
    if found.is_none() {
        let problem =
            "has a place outside its template, or names a point that the survey does not have";
        reader.fault(
            &reader.directory.join(ORIENTATION_FILE),
            "point",
            problem,
            remedy,
        );
    }
    found
}

/// Writes the image of the templates, and returns its SHA-256.
fn write_templates(
    installation: &Installation,
    templates: &[PointTemplate],
) -> std::io::Result<String> {
    let (side, height) = (
        TEMPLATE_SIDE_PX as u32,
        (TEMPLATE_SIDE_PX * templates.len()) as u32,
    );
    let all: Vec<u8> = templates
        .iter()
        .flat_map(|t| t.patch.luma())
        .copied()
        .collect();
    let mut png = vec![];
    let encoder = PngEncoder::new(&mut png);
    encoder
        .write_image(&all, side, height, ExtendedColorType::L8)
        .map_err(std::io::Error::other)?;
    write_atomically(&installation.directory.join(TEMPLATES_FILE), &png)?;
    Ok(hex::encode(Sha256::digest(&png)))
}

/// Checks that camera and survey are those that the attitude was computed with.
fn check_sources(reader: &mut Reader, file: &Path, made_with: &BTreeMap<String, String>) {
    for (name, digest) in made_with {
        let now = reader
            .digests
            .iter()
            .find(|(n, _)| n == name)
            .map(|(_, d)| d);
        if now != Some(digest) {
            let problem = match now {
                Some(_) => format!("{name} has changed since this was computed with it"),
                None => format!("was computed with {name}, which the installation no longer names"),
            };
            reader.fault(file, "made_with", problem, ORIENT_AGAIN);
        }
    }
}

fn parse_ground_observation(
    reader: &mut Reader,
    file: &Path,
    s: &GroundEntry,
    markers: &[SurveyMarker],
) -> Option<Observation> {
    let [uu, uv, vv] = s.covariance_px2;
    let covariance_px2 = Matrix2::new(uu, uv, uv, vv);
    let finite = s.u_px.is_finite() && s.v_px.is_finite();
    let marker = markers.iter().position(|m| m.id == s.id);
    let sound = finite && uu > 0.0 && covariance_px2.determinant() > 0.0;
    let problem = match (marker, sound) {
        (Some(marker), true) => {
            return Some(Observation {
                marker,
                pixel: Vector2::new(s.u_px, s.v_px),
                covariance_px2,
            });
        }
        (None, _) => "is not in the survey",
        (_, false) => "has no finite pixel with a positive covariance",
    };
    reader.fault(
        file,
        "ground",
        format!("marker \"{}\" {problem}", s.id),
        ORIENT_AGAIN,
    );
    None
}

fn matrix_from_rows(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| rows[r][c])
}

fn is_covariance(c: &Matrix3<f64>) -> bool {
    let finite = c.iter().all(|v| v.is_finite());
    finite && (c - c.transpose()).amax() <= 1e-9 * c.amax() && (0..3).all(|k| c[(k, k)] >= 0.0)
}

/// Writes `orientation.toml`: rotation, standard deviations, residuals, source images.
pub fn write_orientation(
    installation: &Installation,
    fit: &OrientationFit,
    images: &[(String, String)],
    accepted: Option<&str>,
) -> std::io::Result<()> {
    let Orientation {
        camera_from_survey,
        covariance_rad2,
        ground,
        templates,
    } = &fit.orientation;
    let id = |marker: usize| {
        let marker = installation.setup.markers.get(marker);
        marker.map_or(String::new(), |m| m.id.clone())
    };
    let sources = installation.digests.iter();
    let sources = sources.filter(|(name, _)| installation.sources.contains(name));
    let mut made_with: BTreeMap<_, _> = sources.cloned().collect();
    if !templates.is_empty() {
        let digest = write_templates(installation, templates)?;
        made_with.insert(TEMPLATES_FILE.to_owned(), digest);
    }
    let residual = |(_, marker, r): &(usize, usize, Vector2<f64>)| ResidualEntry {
        id: id(*marker),
        u_px: r.x,
        v_px: r.y,
    };
    let image = |(k, (name, sha256)): (usize, &(String, String))| {
        let own = fit.residuals.iter().filter(|(frame, ..)| *frame == k);
        ImageEntry {
            name: name.clone(),
            sha256: sha256.clone(),
            residuals: own.map(residual).collect(),
        }
    };
    let unused = fit.unused_markers(&installation.setup).into_iter();
    let unused = unused.map(|(marker, reason)| UnusedMarker {
        id: id(marker),
        reason,
    });
    let ground = ground.iter().map(|o| GroundEntry {
        id: id(o.marker),
        u_px: o.pixel.x,
        v_px: o.pixel.y,
        covariance_px2: [(0, 0), (0, 1), (1, 1)].map(|k| o.covariance_px2[k]),
    });
    let point = templates.iter().map(|t| PointEntry {
        id: id(t.marker),
        left_px: t.origin_px[0],
        top_px: t.origin_px[1],
        u_px: t.place_px.x,
        v_px: t.place_px.y,
    });
    let table = OrientationTable {
        camera_from_survey: rows_from_matrix(camera_from_survey.matrix()),
        sigma_mrad: covariance_rad2.map(|c| c.diagonal().map(|v| 1e3 * v.sqrt()).into()),
        covariance_rad2: covariance_rad2.as_ref().map(rows_from_matrix),
        variance_factor: fit.variance_factor,
        redundancy: fit.redundancy,
        accepted: accepted.map(str::to_owned),
        made_with,
        image: images.iter().enumerate().map(image).collect(),
        unused: unused.collect(),
        ground: ground.collect(),
        point: point.collect(),
    };
    let text = toml::to_string(&table).map_err(std::io::Error::other)?;
    let head = "# Attitude of the camera on the ground, written by `wingd orient`.\n";
    write_atomically(
        &installation.directory.join(ORIENTATION_FILE),
        format!("{head}{text}"),
    )
}

fn rows_from_matrix(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}
