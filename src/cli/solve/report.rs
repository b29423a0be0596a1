//! `wingd solve … --report FILE.html`: figures and tables of the results, as written by `wingd report`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::camera::replay::format_from_path;
use crate::cli::image_files::{self, DatedImage, DatingOptions};
use crate::cli::{CHECK_WRITE_ACCESS, Failure, image_batch, write_failure};
use crate::clock::Stamp;
use crate::installation::{self, Installation};
use crate::record::ImageRecord;
use crate::report::source::{self, PICTURES_FLIGHT, ResultChoice};
use crate::report::{ReportData, SeriesData, ShotData, html};
use crate::store::Store;

/// Writes the report of a flight of the store, by default the newest.
pub(super) fn write_store_report(
    page: &Path,
    store: &Store,
    flight: Option<&str>,
    directory: Option<&Path>,
) -> Result<(), Failure> {
    let installation = directory.map(installation::load_without_orientation).transpose()?;
    let choice = ResultChoice { flight, inputs: None };
    let data = source::read_flight(store.root(), choice, installation.as_ref().map(|i| &i.setup))?;
    for note in data.warnings.iter().chain(&data.notes) {
        eprintln!("wingd: {note}");
    }
    write_page(page, &data)
}

/// Writes the report of images that are in no store, in series by their own times.
pub(super) fn write_image_report(
    page: &Path,
    files: &[PathBuf],
    records: Vec<ImageRecord>,
    installation: &Installation,
) -> Result<(), Failure> {
    let names: BTreeMap<&PathBuf, String> = files.iter().zip(image_batch::image_names(files)).collect();
    let mut of_name: BTreeMap<String, ImageRecord> =
        records.into_iter().map(|record| (record.image.clone(), record)).collect();
    let card = image_files::read_collection(files, &DatingOptions::default(), 0)?;
    let name = |picture: &DatedImage| names.get(&picture.file).cloned().unwrap_or_default();
    let series = card.series.iter().enumerate().map(|(k, pictures)| {
        let records = pictures.iter().filter_map(|p| of_name.remove(&name(p))).collect();
        let shots: Vec<ShotData> = pictures.iter().enumerate().map(|(k, p)| shot_data(k, p, name(p))).collect();
        SeriesData {
            flight: PICTURES_FLIGHT.to_owned(),
            name: (k + 1).to_string(),
            begun: shots.first().and_then(|shot| shot.stamp.clone()),
            planned: shots.len(),
            records,
            shots,
            ..SeriesData::default()
        }
    });
    let of_shot = |series: &SeriesData, shot: &ShotData| {
        let image = shot.image.clone()?;
        let file = names.iter().find(|(_, name)| **name == image)?.0;
        let bytes = std::fs::read(file).ok()?;
        let format = shot.format.clone();
        Some(crate::report::FramePicture { series: series.name.clone(), image, bytes, format, fault: None })
    };
    let mut data = source::pictures_report(series.collect(), &installation.setup, of_shot);
    data.warnings.extend(card.remarks.into_iter().map(|(what, _)| what));
    write_page(page, &data)
}

fn shot_data(place: usize, picture: &DatedImage, name: String) -> ShotData {
    let stamp = picture.utc.map(|utc| Stamp {
        utc,
        utc_synchronised: false,
        boot_id: picture.digest.clone(),
        since_boot_s: 0.0,
    });
    ShotData {
        number: u32::try_from(place + 1).unwrap_or(u32::MAX),
        image: Some(name),
        stamp,
        sha256: Some(picture.digest.clone()),
        format: format_from_path(&picture.file),
        ..ShotData::default()
    }
}

fn write_page(page: &Path, data: &ReportData) -> Result<(), Failure> {
    std::fs::write(page, html::report_page(data)).map_err(write_failure(page, CHECK_WRITE_ACCESS))?;
    eprintln!("wingd: report: {}", page.display());
    Ok(())
}
