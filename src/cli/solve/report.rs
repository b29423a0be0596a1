//! `wingd solve … --report FILE.html`: figures and tables of the results, as written by `wingd report`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use wingd_base::clock::Stamp;
use wingd_base::failure::CHECK_WRITE_ACCESS;
use wingd_base::failure::{TaskResult, not_on_board};
use wingd_base::output::{print_notes, write_output};
use wingd_evaluation::frame_format::format_from_path;
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::default_paths::load_setup;
use wingd_evaluation::inputs::image_names::image_names;
use wingd_evaluation::inputs::image_times::{DatedImage, DatingOptions};
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::record::ImageRecord;
use wingd_evaluation::results::source;
use wingd_evaluation::results::source::{PICTURES_FLIGHT, ResultChoice};
use wingd_evaluation::results::{FramePicture, ReportBuilder, ReportData, SeriesData, ShotData};
use wingd_store::Store;

/// File for a report, with the builder.
#[derive(Clone, Copy)]
pub(super) struct ReportFile<'a> {
    file: &'a Path,
    builder: ReportBuilder,
}

impl<'a> ReportFile<'a> {
    /// Returns the file of the option `--report`, if it is given.
    ///
    /// # Errors
    /// Returns an error if this program builds no reports.
    pub(super) fn from_option(
        file: Option<&'a Path>,
        reports: Option<ReportBuilder>,
    ) -> TaskResult<Option<Self>> {
        let Some(file) = file else { return Ok(None) };
        let builder = reports.ok_or_else(|| not_on_board("`wingd solve --report`"))?;
        Ok(Some(Self { file, builder }))
    }
}

/// Writes the report of a flight of the store, by default the newest.
pub(super) fn write_store_report(
    page: &ReportFile,
    store: &Store,
    flight: Option<&str>,
    directory: Option<&Path>,
) -> TaskResult<()> {
    let choice = ResultChoice {
        flight,
        inputs: None,
    };
    let data = source::read_flight(store.root(), choice, load_setup(directory)?.as_ref())?;
    print_notes(data.warnings.iter().chain(&data.notes));
    write_page(page, &data)
}

/// Writes the report of images that are in no store, in series by their own times.
pub(super) fn write_image_report(
    page: &ReportFile,
    files: &[PathBuf],
    records: Vec<ImageRecord>,
    installation: &Installation,
) -> TaskResult<()> {
    let names: BTreeMap<&PathBuf, String> = files.iter().zip(image_names(files)).collect();
    let mut of_name: BTreeMap<String, ImageRecord> = records
        .into_iter()
        .map(|record| (record.image.clone(), record))
        .collect();
    let card = batch::read_collection(files, &DatingOptions::default())?;
    let name = |picture: &DatedImage| names.get(&picture.file).cloned().unwrap_or_default();
    let series = card.series.iter().enumerate().map(|(k, pictures)| {
        let records = pictures
            .iter()
            .filter_map(|p| of_name.remove(&name(p)))
            .collect();
        let shots: Vec<ShotData> = (1..)
            .zip(pictures)
            .map(|(number, p)| shot_data(number, p, name(p)))
            .collect();
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
        let bytes = wingd_base::regular_file::read_regular_file(
            file,
            wingd_base::regular_file::MAX_DATA_BYTES,
        )
        .ok()?;
        let format = shot.format.clone();
        Some(FramePicture {
            series: series.name.clone(),
            image,
            bytes,
            format,
            fault: None,
        })
    };
    let mut data = source::pictures_report(series.collect(), &installation.setup, of_shot);
    data.warnings
        .extend(card.remarks.into_iter().map(|(what, _)| what));
    write_page(page, &data)
}

fn shot_data(number: u32, picture: &DatedImage, name: String) -> ShotData {
    let digest = &picture.digest;
    let stamp = picture.utc.map(|utc| Stamp {
        utc,
        utc_synchronised: false,
        boot_id: digest.clone(),
        since_boot_s: 0.0,
    });
    ShotData {
        number,
        image: Some(name),
        stamp,
        sha256: Some(digest.clone()),
        format: format_from_path(&picture.file),
        ..ShotData::default()
    }
}

fn write_page(page: &ReportFile, data: &ReportData) -> TaskResult<()> {
    let content = run_long_task("writing the report", || (page.builder)(data));
    write_output(page.file, content, CHECK_WRITE_ACCESS)?;
    eprintln!("wingd: report: {}", page.file.display());
    Ok(())
}
