//! Image files of a camera's card: found in folders, dated by their metadata, and split into series at pauses.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

use jiff::Timestamp;

use super::image_names;
use super::image_times::{DatedImage, DatingOptions, TimeRemark, date_images};
use crate::exif;
use crate::frame_format::format_from_path;
use crate::pipeline::decode;
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::regular_file::{MAX_DATA_BYTES, read_regular_file};
use wingd_base::text::printable_path;
use wingd_store::sha256_hex;

/// File name extensions of images, for messages.
const IMAGE_EXTENSIONS: &str = ".jpg, .png, .pgm, .ppm or .tif";

/// Replaces each folder among the arguments by the images in it and below, ordered by name; `note` receives remarks.
///
/// # Errors
/// Returns an error if a folder cannot be read or has no images.
pub fn expand_folders(arguments: &[PathBuf], note: impl Fn(String)) -> TaskResult<Vec<PathBuf>> {
    let mut all = Vec::new();
    for argument in arguments {
        if !argument.is_dir() {
            all.push(argument.clone());
            continue;
        }
        let mut left_out = BTreeMap::new();
        let (pictures, others): (Vec<PathBuf>, Vec<PathBuf>) = list_files(argument, &mut left_out)?
            .into_iter()
            .partition(|f| format_from_path(f).is_some());
        let folder = printable_path(argument);
        if !left_out.is_empty() {
            let (count, places): (usize, Vec<&str>) = (
                left_out.values().sum(),
                left_out.keys().map(String::as_str).collect(),
            );
            note(format!(
                "{folder}: {count} thumbnails, deleted and hidden images are skipped ({}); name such a folder to use it",
                places.join(", ")
            ));
        }
        if let Some(what) = unsupported_images_note(&pictures, &others) {
            note(format!("{folder}: {what}"));
        }
        if pictures.is_empty() {
            let what = format!(
                "{folder}: contains no images ({IMAGE_EXTENSIONS}); name a folder that does"
            );
            return Err(Failure::Failed(what));
        }
        all.extend(pictures);
    }
    Ok(all)
}

/// Extensions of image formats that are not supported.
const UNSUPPORTED_EXTENSIONS: [&str; 16] = [
    "heic", "heif", "avif", "webp", "dng", "nef", "arw", "cr2", "cr3", "raf", "orf", "rw2", "pef",
    "srw", "bmp", "jxl",
];

/// Describes images of unsupported formats in a folder, except those next to a supported one, such as a raw file next to
/// its JPEG.
fn unsupported_images_note(pictures: &[PathBuf], others: &[PathBuf]) -> Option<String> {
    let ending = |file: &Path| file.extension().map(|e| e.to_string_lossy().to_lowercase());
    let readable: BTreeSet<PathBuf> = pictures
        .iter()
        .map(|picture| picture.with_extension(""))
        .collect();
    let alone = |file: &&PathBuf| {
        ending(file).is_some_and(|e| UNSUPPORTED_EXTENSIONS.contains(&e.as_str()))
            && !readable.contains(&file.with_extension(""))
    };
    let alone: Vec<&PathBuf> = others.iter().filter(alone).collect();
    let first = image_names::image_name(alone.first()?);
    let count = alone.len();
    Some(format!(
        "{count} images of unsupported formats are skipped, first {first}; save them as JPEG, PNG or TIFF"
    ))
}

/// Returns whether a folder contains an image, at any depth.
pub fn contains_images(folder: &Path) -> bool {
    list_files(folder, &mut BTreeMap::new())
        .is_ok_and(|all| all.iter().any(|file| format_from_path(file).is_some()))
}

/// First characters of folders of a system or another program: hidden ones, and those of a NAS or a recycle bin.
const SYSTEM_STARTS: [char; 5] = ['.', '@', '$', '#', '~'];
/// Beginnings of the names of folders of thumbnails, of deleted images and of pieces found by a file system check.
const FOREIGN_STARTS: [&str; 5] = ["thm", "thumb", "_thumb", "recycle", "found.0"];
/// Names of folders of deleted images, of a file system check, and of a camera's own data.
const FOREIGN_FOLDERS: [&str; 6] = [
    "trash",
    "deleted",
    "lost+found",
    "misc",
    "canonmsc",
    "system volume information",
];

/// Returns whether a folder belongs to a system or another program, by its name.
fn is_foreign_folder(name: &str) -> bool {
    let name = name.to_lowercase();
    // A name of several words, such as "thumb targets", is one of the user.
    let rest = FOREIGN_STARTS
        .iter()
        .find_map(|start| name.strip_prefix(start));
    name.starts_with(SYSTEM_STARTS)
        || FOREIGN_FOLDERS.contains(&name.as_str())
        || rest.is_some_and(|rest| !rest.contains([' ', '-', '_']))
}

/// Lists the files in a folder and below, ordered by name, without links to folders; `left_out` receives the number of
/// images in each foreign folder, and of hidden ones.
fn list_files(folder: &Path, left_out: &mut BTreeMap<String, usize>) -> TaskResult<Vec<PathBuf>> {
    let unreadable = |e: std::io::Error| {
        Failure::Failed(format!(
            "{} cannot be read ({e}); check the path",
            printable_path(folder)
        ))
    };
    let mut entries = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let name = image_names::image_name(&entry.path());
        let is_folder = entry.file_type().map_err(unreadable)?.is_dir();
        let images = match is_folder {
            true if is_foreign_folder(&name) => count_images(&entry.path()),
            false if name.starts_with('.') => {
                usize::from(format_from_path(&entry.path()).is_some())
            }
            _ => {
                entries.push((natural_sort_key(&name), entry.path(), is_folder));
                continue;
            }
        };
        if images > 0 {
            *left_out
                .entry(if is_folder {
                    name
                } else {
                    "hidden files".into()
                })
                .or_default() += images;
        }
    }
    entries.sort_by(|a, b| a.0.cmp(&b.0));
    let mut all = Vec::new();
    for (_, path, is_folder) in entries {
        if is_folder {
            all.extend(list_files(&path, left_out)?);
        } else if path.is_file() {
            all.push(path);
        }
    }
    Ok(all)
}

/// Counts the images in a folder and below; 0 if it cannot be read.
fn count_images(folder: &Path) -> usize {
    let mut below = BTreeMap::new();
    let own = list_files(folder, &mut below).unwrap_or_default();
    own.iter()
        .filter(|file| format_from_path(file).is_some())
        .count()
        + below.values().sum::<usize>()
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
    /// Remarks on times and sizes, each with the options of `wingd import` that help.
    pub remarks: Vec<TimeRemark>,
}

impl ImageCollection {
    /// Dates the images, each the result of [`read_image`], and splits them into series.
    ///
    /// # Errors
    /// Returns an error if a list of times is given that does not fit the images.
    pub fn from_images(
        images: Vec<(PathBuf, Result<DatedImage, String>)>,
        dating: &DatingOptions,
    ) -> TaskResult<Self> {
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
        let files: Vec<PathBuf> = pictures.iter().map(|p| p.file.clone()).collect();
        pictures
            .iter_mut()
            .zip(image_names::image_names(&files))
            .for_each(|(p, name)| p.name = name);
        card.remarks = date_images(&mut pictures, dating)?;
        card.remarks.extend(size_remark(&pictures));
        card.series = split_into_series(pictures, dating.gap);
        Ok(card)
    }
}

/// Reports images of another size than most.
fn size_remark(pictures: &[DatedImage]) -> Option<TimeRemark> {
    let mut counts: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    pictures
        .iter()
        .filter_map(|p| p.size)
        .for_each(|size| *counts.entry(size).or_default() += 1);
    let (usual, _) = counts
        .iter()
        .max_by_key(|(size, count)| (**count, **size))?;
    let mut others = pictures
        .iter()
        .filter(|p| p.size.is_some_and(|size| size != *usual));
    let first = others.next()?;
    let ((w, h), (usual_w, usual_h)) = (first.size?, usual);
    let what = format!(
        "{} images have another size than the others: {} has {w} x {h} px, most have {usual_w} x {usual_h} px",
        others.count() + 1,
        first.name
    );
    Some((
        what,
        "thumbnails, crops and other cameras do not belong in this store".into(),
    ))
}

/// Reads an image and its metadata; it has no time yet.
///
/// # Errors
/// Returns the reason why the file is not an image that can be imported.
pub fn read_image(file: &Path) -> Result<DatedImage, String> {
    if format_from_path(file).is_none() {
        return Err(format!("is not a supported image; give {IMAGE_EXTENSIONS}"));
    }
    let bytes = read_regular_file(file, MAX_DATA_BYTES)
        .map_err(|e| format!("cannot be read ({e}); check the card"))?;
    if bytes.is_empty() {
        return Err("is empty; copy it from the camera again".to_owned());
    }
    let size = decode::read_size(&bytes).map_err(|why| why.to_string())?;
    let (digest, taken) = (sha256_hex(&bytes), exif::read_metadata(&bytes));
    Ok(DatedImage {
        file: file.to_owned(),
        digest,
        size,
        taken,
        ..DatedImage::default()
    })
}

/// Sorts images by time and splits them at pauses; images without a time form the last series, in the order given.
fn split_into_series(mut pictures: Vec<DatedImage>, gap: Duration) -> Vec<Vec<DatedImage>> {
    // The sort is stable: images of the same second stay in the order of the files.
    pictures.sort_by_key(|p| (p.utc.is_none(), p.utc));
    split_at_pauses(pictures, gap, |picture| picture.utc, |picture| picture.utc)
}

/// Splits a sequence where the time from the end of an item to the beginning of the next exceeds `pause`. Items without
/// times stay together.
pub fn split_at_pauses<T>(
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
    use super::*;

    fn at(utc: Option<&str>, digest: &str) -> DatedImage {
        let utc = utc.map(|t| t.parse().unwrap());
        DatedImage {
            file: PathBuf::from(digest),
            digest: digest.into(),
            utc,
            ..DatedImage::default()
        }
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
        let names: Vec<Vec<&str>> = series
            .iter()
            .map(|s| s.iter().map(|p| p.digest.as_str()).collect())
            .collect();
        assert_eq!(names, [vec!["a", "b"], vec!["c"], vec!["z", "y"]]);
    }

    #[test]
    fn unsupported_images_are_named_unless_they_are_next_to_their_jpeg() {
        let files = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let of = |others: &[&str]| {
            unsupported_images_note(&files(&["a/1.jpg", "a/2.JPG"]), &files(others))
        };
        assert_eq!(of(&["a/1.dng", "a/2.NEF", "a/notes.txt"]), None);
        let remarks = of(&["a/1.dng", "a/3.HEIC", "b/1.dng"]).unwrap();
        assert!(
            remarks.starts_with("2 images") && remarks.contains("first 3.HEIC"),
            "{remarks}"
        );
    }

    #[test]
    fn folders_of_systems_and_programs_are_left_out() {
        for name in [
            "@eaDir",
            "$RECYCLE.BIN",
            "#recycle",
            "lost+found",
            ".Trashes",
            "THMBNL",
            "MISC",
            "FOUND.001",
            "Thumbs",
        ] {
            assert!(is_foreign_folder(name), "{name}");
        }
        for name in [
            "DCIM",
            "100CANON",
            "misc flights",
            "2026-06-01",
            "Thumb_targets",
        ] {
            assert!(!is_foreign_folder(name), "{name}");
        }
    }

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = [
            "IMG_10.JPG",
            "IMG_9.JPG",
            "IMG_009b.JPG",
            "A.JPG",
            "99999999999999999999999.JPG",
        ];
        names.sort_by_key(|n| natural_sort_key(n));
        assert_eq!(
            names,
            [
                "99999999999999999999999.JPG",
                "A.JPG",
                "IMG_9.JPG",
                "IMG_009b.JPG",
                "IMG_10.JPG"
            ]
        );
    }
}
