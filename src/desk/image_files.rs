//! Image files of a camera's card: found in folders, dated by their metadata, and split into series at pauses.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use jiff::Timestamp;
use jiff::tz::Offset;
use serde_json::{Map, Value};

use super::{Failure, image_names};
use crate::camera::exif::{self, CaptureMetadata};
use crate::camera::replay::format_from_path;
use crate::installation::printable_path;
use crate::pipeline::decode;
use crate::store::sha256_hex;

/// File name extensions of images, for messages.
const IMAGE_EXTENSIONS: &str = ".jpg, .png, .pgm, .ppm or .tif";

/// Options for dating images and splitting them into series.
#[derive(Clone, Debug)]
pub struct DatingOptions {
    /// Time zone of the camera's clock for images without one; UTC by default.
    pub zone: Option<Offset>,
    /// Time of the first image that has none.
    pub start: Option<Timestamp>,
    /// Interval between images without a time.
    pub every: Duration,
    /// Pause that begins a new series: a camera takes the images of a series within seconds of each other.
    pub gap: Duration,
}

impl Default for DatingOptions {
    fn default() -> Self {
        Self { zone: None, start: None, every: Duration::from_secs(1), gap: Duration::from_secs(60) }
    }
}

/// An image file with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct DatedImage {
    pub file: PathBuf,
    pub digest: String,
    /// Metadata of the file.
    pub taken: CaptureMetadata,
    /// Time of the shot, from the metadata or the options; `None` if unknown.
    pub utc: Option<Timestamp>,
}

impl DatedImage {
    /// Returns whether the time is from the image's own metadata.
    pub fn has_own_time(&self) -> bool {
        self.taken.local_time.is_some()
    }

    /// Resolution of the camera's clock, s.
    pub fn clock_step_s(&self) -> f64 {
        0.1f64.powi(self.taken.subsecond_digits as i32)
    }

    /// Returns the file name given by the camera and the settings of the shot.
    pub fn settings(&self) -> Map<String, Value> {
        let mut all = Map::from_iter([("source".to_owned(), image_names::image_name(&self.file).into())]);
        all.extend(self.taken.local_time.map(|t| ("camera_time".to_owned(), t.to_string().into())));
        all.extend(self.taken.settings.iter().map(|(k, v)| ((*k).to_owned(), v.clone().into())));
        all
    }
}

/// Replaces each folder among the arguments by the images in it and below, ordered by name; `note` receives remarks.
///
/// # Errors
/// Returns an error if a folder cannot be read or has no images.
pub fn expand_folders(arguments: &[PathBuf], note: impl Fn(String)) -> Result<Vec<PathBuf>, Failure> {
    let mut all = Vec::new();
    for argument in arguments {
        if !argument.is_dir() {
            all.push(argument.clone());
            continue;
        }
        let (pictures, others): (Vec<PathBuf>, Vec<PathBuf>) =
            list_files(argument)?.into_iter().partition(|f| format_from_path(f).is_some());
        let folder = printable_path(argument);
        if let Some(what) = unsupported_images_note(&pictures, &others) {
            note(format!("{folder}: {what}"));
        }
        if pictures.is_empty() {
            let what = format!("{folder}: contains no images ({IMAGE_EXTENSIONS}); name a folder that does");
            return Err(Failure::Failed(what));
        }
        all.extend(pictures);
    }
    Ok(all)
}

/// Extensions of image formats that are not supported.
const UNSUPPORTED_EXTENSIONS: [&str; 16] = [
    "heic", "heif", "avif", "webp", "dng", "nef", "arw", "cr2", "cr3", "raf", "orf", "rw2", "pef", "srw", "bmp", "jxl",
];

/// Describes images of unsupported formats in a folder, except those next to a supported one, such as a raw file next to
/// its JPEG.
fn unsupported_images_note(pictures: &[PathBuf], others: &[PathBuf]) -> Option<String> {
    let ending = |file: &Path| file.extension().map(|e| e.to_string_lossy().to_lowercase());
    let readable: BTreeSet<PathBuf> = pictures.iter().map(|picture| picture.with_extension("")).collect();
    let alone = |file: &&PathBuf| {
        ending(file).is_some_and(|e| UNSUPPORTED_EXTENSIONS.contains(&e.as_str()))
            && !readable.contains(&file.with_extension(""))
    };
    let alone: Vec<&PathBuf> = others.iter().filter(alone).collect();
    let first = image_names::image_name(alone.first()?);
    let count = alone.len();
    Some(format!("{count} images of unsupported formats are skipped, first {first}; save them as JPEG, PNG or TIFF"))
}

/// Returns whether a folder contains an image, at any depth.
pub fn contains_images(folder: &Path) -> bool {
    list_files(folder).is_ok_and(|all| all.iter().any(|file| format_from_path(file).is_some()))
}

/// Lists the files in a folder and below, ordered by name, without hidden files and links to folders.
fn list_files(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let unreadable =
        |e: std::io::Error| Failure::Failed(format!("{} cannot be read ({e}); check the path", printable_path(folder)));
    let mut entries = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        if !hidden {
            entries.push((natural_sort_key(&image_names::image_name(&entry.path())), entry));
        }
    }
    entries.sort_by(|a, b| a.0.cmp(&b.0));
    let mut all = Vec::new();
    for (_, entry) in entries {
        match entry.file_type().map_err(unreadable)? {
            kind if kind.is_dir() => all.extend(list_files(&entry.path())?),
            _ if entry.path().is_file() => all.push(entry.path()),
            _ => {}
        }
    }
    Ok(all)
}

/// Returns a sort key that puts `IMG_9` before `IMG_10`: runs of digits compare by value.
fn natural_sort_key(name: &str) -> Vec<(u64, String)> {
    let mut parts: Vec<(u64, String)> = vec![(0, String::new())];
    let mut digits = String::new();
    for c in name.chars().chain(['\0']) {
        if c.is_ascii_digit() {
            digits.push(c);
            continue;
        }
        if !digits.is_empty() {
            parts.push((digits.parse().unwrap_or(u64::MAX), String::new()));
            digits.clear();
        }
        if let Some((_, text)) = parts.last_mut() {
            text.push(c);
        }
    }
    parts
}

/// Images read from a card.
#[derive(Debug, Default)]
pub struct ImageCollection {
    /// Images by series, in the order taken.
    pub series: Vec<Vec<DatedImage>>,
    /// Duplicate images, each with the file it repeats.
    pub duplicates: Vec<(PathBuf, PathBuf)>,
    /// Files that are not images or cannot be read, with the reason.
    pub refused: Vec<(PathBuf, String)>,
    /// Remarks on the times, each with the options of `wingd import` that help.
    pub remarks: Vec<(String, &'static str)>,
}

impl ImageCollection {
    /// Dates the images, each the result of [`read_image`], and splits them into series.
    pub fn from_images(images: Vec<(PathBuf, Result<DatedImage, String>)>, dating: &DatingOptions) -> Self {
        let mut card = Self::default();
        let mut pictures: Vec<DatedImage> = Vec::new();
        for (file, read) in images {
            match read {
                Err(why) => card.refused.push((file, why)),
                Ok(one) => match pictures.iter().find(|known| known.digest == one.digest) {
                    Some(known) => card.duplicates.push((file, known.file.clone())),
                    None => pictures.push(one),
                },
            }
        }
        card.remarks = date_images(&mut pictures, dating);
        card.series = split_into_series(pictures, dating.gap);
        card
    }
}

/// Reads an image and its metadata; it has no time yet.
///
/// # Errors
/// Returns the reason why the file is not an image that can be imported.
pub fn read_image(file: &Path) -> Result<DatedImage, String> {
    if format_from_path(file).is_none() {
        return Err(format!("is not a supported image; give {IMAGE_EXTENSIONS}"));
    }
    let bytes = crate::store::read_regular_file(file).map_err(|e| format!("cannot be read ({e}); check the card"))?;
    if bytes.is_empty() {
        return Err("is empty; copy it from the camera again".to_owned());
    }
    if let Some(why) = decode::unreadable_cause(&bytes) {
        return Err(why.to_string());
    }
    Ok(DatedImage { file: file.to_owned(), digest: sha256_hex(&bytes), taken: exif::read_metadata(&bytes), utc: None })
}

/// Dates the images and returns remarks on their times.
fn date_images(pictures: &mut [DatedImage], dating: &DatingOptions) -> Vec<(String, &'static str)> {
    let mut undated: u32 = 0;
    let mut zoneless = 0;
    for picture in pictures.iter_mut() {
        let Some(local) = picture.taken.local_time else {
            let since = dating.every.checked_mul(undated);
            picture.utc = dating.start.zip(since).and_then(|(start, since)| start.checked_add(since).ok());
            undated += 1;
            continue;
        };
        zoneless += usize::from(picture.taken.offset.is_none());
        let zone = picture.taken.offset.or(dating.zone).unwrap_or(Offset::UTC);
        picture.utc = zone.to_timestamp(local).ok();
    }
    let mut remarks = Vec::new();
    if zoneless > 0 && dating.zone.is_none() {
        let what = format!("{zoneless} images have no time zone: assumed UTC");
        remarks.push((what, "if the camera was set to another zone, give --zone"));
    }
    let undated_are = |how: &str| format!("{undated} images have no time: {how}");
    match dating.start {
        _ if undated == 0 => {}
        None => {
            let how = undated_are("kept in the order of the files");
            remarks.push((how, "give --start and --every if you know them"));
        }
        Some(start) => {
            let how = format!("dated in the order of the files, from {start} every {:?}", dating.every);
            remarks.push((undated_are(&how), "as given by --start and --every"));
        }
    }
    remarks
}

/// Sorts images by time and splits them at pauses; images without a time form the last series, in the order given.
fn split_into_series(mut pictures: Vec<DatedImage>, gap: Duration) -> Vec<Vec<DatedImage>> {
    // The sort is stable: images of the same second stay in the order of the files.
    pictures.sort_by_key(|p| (p.utc.is_none(), p.utc));
    split_at_pauses(pictures, gap, |picture| picture.utc, |picture| picture.utc)
}

/// Splits a sequence where the time from the end of an item to the beginning of the next exceeds `pause`. Items without
/// times stay together.
pub(super) fn split_at_pauses<T>(
    items: Vec<T>,
    pause: Duration,
    begin: impl Fn(&T) -> Option<Timestamp>,
    end: impl Fn(&T) -> Option<Timestamp>,
) -> Vec<Vec<T>> {
    let pause = jiff::SignedDuration::try_from(pause).unwrap_or_default();
    let mut parts: Vec<Vec<T>> = Vec::new();
    for item in items {
        let last = parts.last().and_then(|part| part.last());
        let goes_on = last.is_some_and(|last| match (end(last), begin(&item)) {
            (Some(ended), Some(begun)) => begun.duration_since(ended).abs() <= pause,
            (None, None) => true,
            _ => false,
        });
        match parts.last_mut() {
            Some(open) if goes_on => open.push(item),
            _ => parts.push(vec![item]),
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn at(utc: Option<&str>, digest: &str) -> DatedImage {
        let utc = utc.map(|t| t.parse().unwrap());
        DatedImage { file: PathBuf::from(digest), digest: digest.into(), taken: CaptureMetadata::default(), utc }
    }

    #[test]
    fn pauses_split_series_and_images_without_time_come_last_as_given() {
        let pictures = vec![
            at(None, "z"),
            at(Some("2026-03-01T07:10:00Z"), "c"),
            at(Some("2026-03-01T07:00:00.5Z"), "b"),
            at(Some("2026-03-01T07:00:00.25Z"), "a"),
            at(None, "y"),
        ];
        let series = split_into_series(pictures, Duration::from_secs(60));
        let names: Vec<Vec<&str>> = series.iter().map(|s| s.iter().map(|p| p.digest.as_str()).collect()).collect();
        assert_eq!(names, [vec!["a", "b"], vec!["c"], vec!["z", "y"]]);
    }

    #[test]
    fn unsupported_images_are_named_unless_they_are_next_to_their_jpeg() {
        let files = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let of = |others: &[&str]| unsupported_images_note(&files(&["a/1.jpg", "a/2.JPG"]), &files(others));
        assert_eq!(of(&["a/1.dng", "a/2.NEF", "a/notes.txt"]), None);
        let remarks = of(&["a/1.dng", "a/3.HEIC", "b/1.dng"]).unwrap();
        assert!(remarks.starts_with("2 images") && remarks.contains("first 3.HEIC"), "{remarks}");
    }

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = ["IMG_10.JPG", "IMG_9.JPG", "IMG_009b.JPG", "A.JPG", "99999999999999999999999.JPG"];
        names.sort_by_key(|n| natural_sort_key(n));
        assert_eq!(names, ["99999999999999999999999.JPG", "A.JPG", "IMG_9.JPG", "IMG_009b.JPG", "IMG_10.JPG"]);
    }
}
