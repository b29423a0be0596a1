//! Pictures of a camera's card are found in folders, dated by what they say of themselves, and parted into series by pauses.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use jiff::Timestamp;
use jiff::tz::Offset;
use serde_json::{Map, Value};

use super::{Failure, frames};
use crate::camera::exif::{self, Taken};
use crate::camera::replay::format_of;
use crate::installation::shown_path;
use crate::pipeline::decode;
use crate::store::sha256;

/// Endings of pictures, for messages.
const ENDINGS: &str = ".jpg, .png, .pgm, .ppm or .tif";

/// How pictures are dated and parted.
#[derive(clap::Args, Clone, Debug)]
pub struct Dating {
    /// Zone of the camera's clock for pictures that do not say it, for example +02:00 [default: UTC]
    #[arg(long, value_name = "ZONE", value_parser = zone, allow_hyphen_values = true)]
    zone: Option<Offset>,
    /// When the first picture without a time was taken, for example 2026-03-01T07:00:00Z
    #[arg(long, value_name = "TIME")]
    start: Option<Timestamp>,
    /// From one picture without a time to the next
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = duration)]
    every: Duration,
    /// A longer pause begins a new series
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = duration)]
    gap: Duration,
}

impl Default for Dating {
    fn default() -> Self {
        Self { zone: None, start: None, every: Duration::from_secs(1), gap: GAP }
    }
}

/// A longer pause begins a new series: a camera takes the pictures of a series within seconds of each other.
const GAP: Duration = Duration::from_secs(60);

fn zone(text: &str) -> Result<Offset, String> {
    exif::offset(text).ok_or_else(|| "give hours and minutes from UTC, as in +02:00".to_owned())
}

fn duration(text: &str) -> Result<Duration, String> {
    let fault = || "give a duration above 0, as in 60s or 5m".to_owned();
    let read: jiff::SignedDuration = text.parse().map_err(|_| fault())?;
    Duration::try_from(read).ok().filter(|d| !d.is_zero()).ok_or_else(fault)
}

/// A picture on the card.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Where it lies.
    pub file: PathBuf,
    /// SHA-256 of its bytes, hex.
    pub digest: String,
    /// What it says of itself.
    pub taken: Taken,
    /// When it was taken: by what it says, or by what the user says; `None` where nobody does.
    pub utc: Option<Timestamp>,
}

impl Picture {
    /// Whether the time is the picture's own.
    pub fn says_when(&self) -> bool {
        self.taken.local.is_some()
    }

    /// The step in which the camera's clock counts, s.
    pub fn step_s(&self) -> f64 {
        0.1f64.powi(self.taken.digits as i32)
    }

    /// The name that the camera gave it, and what it says of the shot.
    pub fn settings(&self) -> Map<String, Value> {
        let mut all = Map::from_iter([("source".to_owned(), frames::name(&self.file).into())]);
        all.extend(self.taken.local.map(|t| ("camera_time".to_owned(), t.to_string().into())));
        all.extend(self.taken.settings.iter().map(|(k, v)| ((*k).to_owned(), v.clone().into())));
        all
    }
}

/// What stands on a command line: files as they are, and of folders the pictures in them and below, in the order of their names.
///
/// # Errors
/// Where a folder cannot be read, or holds none.
pub fn expand(arguments: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut all = Vec::new();
    for argument in arguments {
        if !argument.is_dir() {
            all.push(argument.clone());
            continue;
        }
        let (pictures, others): (Vec<PathBuf>, Vec<PathBuf>) =
            within(argument)?.into_iter().partition(|f| format_of(f).is_some());
        if let Some(what) = passed_over(&pictures, &others) {
            eprintln!("wingd: {}: {what}", shown_path(argument));
        }
        if pictures.is_empty() {
            let what =
                format!("{}: holds no pictures ({ENDINGS}); name a folder that does", shown_path(argument));
            return Err(Failure::Failed(what));
        }
        all.extend(pictures);
    }
    Ok(all)
}

/// Endings of pictures that are not read.
const OTHER_ENDINGS: [&str; 16] = [
    "heic", "heif", "avif", "webp", "dng", "nef", "arw", "cr2", "cr3", "raf", "orf", "rw2", "pef", "srw",
    "bmp", "jxl",
];

/// Pictures of a folder that are not read and lie beside none that is, as a raw file does beside its JPEG.
fn passed_over(pictures: &[PathBuf], others: &[PathBuf]) -> Option<String> {
    let ending = |file: &Path| file.extension().map(|e| e.to_string_lossy().to_lowercase());
    let beside: BTreeSet<PathBuf> = pictures.iter().map(|picture| picture.with_extension("")).collect();
    let alone = |file: &&PathBuf| {
        ending(file).is_some_and(|e| OTHER_ENDINGS.contains(&e.as_str()))
            && !beside.contains(&file.with_extension(""))
    };
    let alone: Vec<&PathBuf> = others.iter().filter(alone).collect();
    let first = frames::name(alone.first()?);
    let count = alone.len();
    Some(format!(
        "{count} pictures that are not read are passed over, {first} first; save them as JPEG, PNG or TIFF"
    ))
}

/// Whether a folder holds a picture, in it or below.
pub fn holds_any(folder: &Path) -> bool {
    within(folder).is_ok_and(|all| all.iter().any(|file| format_of(file).is_some()))
}

/// Every file in a folder and below, by name; hidden ones and links to folders are left out.
fn within(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let unreadable = |e: std::io::Error| {
        Failure::Failed(format!("{} cannot be read ({e}); check the path", shown_path(folder)))
    };
    let mut entries = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        if !hidden {
            entries.push((natural(&frames::name(&entry.path())), entry));
        }
    }
    entries.sort_by(|a, b| a.0.cmp(&b.0));
    let mut all = Vec::new();
    for (_, entry) in entries {
        match entry.file_type().map_err(unreadable)? {
            kind if kind.is_dir() => all.extend(within(&entry.path())?),
            _ if entry.path().is_file() => all.push(entry.path()),
            _ => {}
        }
    }
    Ok(all)
}

/// A name by which `IMG_9` comes before `IMG_10`: its runs of digits by their number.
fn natural(name: &str) -> Vec<(u64, String)> {
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

/// What came of reading a card.
#[derive(Debug, Default)]
pub struct Card {
    /// Series by series, each in the order taken.
    pub series: Vec<Vec<Picture>>,
    /// Pictures that are there twice, and as which others.
    pub twice: Vec<(PathBuf, PathBuf)>,
    /// Files that are no pictures or cannot be read, and why.
    pub refused: Vec<(PathBuf, String)>,
    /// What is to be said of their times, and what `wingd import` can do about it.
    pub remarks: Vec<(String, &'static str)>,
}

/// Reads, dates and parts the pictures that a command line names.
///
/// # Errors
/// Where there is nothing to read.
pub fn card(arguments: &[PathBuf], dating: &Dating, jobs: usize) -> Result<Card, Failure> {
    let files = expand(arguments)?;
    let mut card = Card::default();
    let mut pictures: Vec<Picture> = Vec::new();
    let read = |file: &PathBuf| (file.clone(), picture(file));
    frames::run(&files, jobs, "reading", read, |(file, read)| {
        match read {
            Err(why) => card.refused.push((file, why)),
            Ok(one) => match pictures.iter().find(|known| known.digest == one.digest) {
                Some(known) => card.twice.push((file, known.file.clone())),
                None => pictures.push(one),
            },
        }
        Ok(())
    })?;
    card.remarks = date(&mut pictures, dating);
    card.series = parted(pictures, dating.gap);
    Ok(card)
}

fn picture(file: &Path) -> Result<Picture, String> {
    if format_of(file).is_none() {
        return Err(format!("is no picture that is read; give {ENDINGS}"));
    }
    let bytes = std::fs::read(file).map_err(|e| format!("cannot be read ({e}); check the card"))?;
    if bytes.is_empty() {
        return Err("is empty; copy it from the camera again".to_owned());
    }
    if let Some(why) = decode::unread(&bytes) {
        return Err(why.to_string());
    }
    Ok(Picture { file: file.to_owned(), digest: sha256(&bytes), taken: exif::all(&bytes), utc: None })
}

/// Dates the pictures; what is to be said of it comes back.
fn date(pictures: &mut [Picture], dating: &Dating) -> Vec<(String, &'static str)> {
    let mut undated: u32 = 0;
    let mut zoneless = 0;
    for picture in pictures.iter_mut() {
        let Some(local) = picture.taken.local else {
            let since = dating.every.checked_mul(undated);
            picture.utc = dating.start.zip(since).and_then(|(start, since)| start.checked_add(since).ok());
            undated += 1;
            continue;
        };
        zoneless += usize::from(picture.taken.offset.is_none());
        let zone = picture.taken.offset.or(dating.zone).unwrap_or(Offset::UTC);
        picture.utc = zone.to_timestamp(local).ok();
    }
    let mut said = Vec::new();
    if zoneless > 0 && dating.zone.is_none() {
        let what = format!("{zoneless} pictures do not say the zone of their time: taken as UTC");
        said.push((what, "if the camera was set otherwise, give --zone"));
    }
    let undated_are = |how: &str| format!("{undated} pictures do not say when they were taken: {how}");
    match dating.start {
        _ if undated == 0 => {}
        None => {
            let how = undated_are("in the order of the files, without a time");
            said.push((how, "give --start and --every if they are known"));
        }
        Some(start) => {
            let how = format!("from {start} on, in the order of the files, every {:?}", dating.every);
            said.push((undated_are(&how), "as --start and --every say"));
        }
    }
    said
}

/// In the order of time, parted by pauses; what has no time comes last, as it was given, by itself.
fn parted(mut pictures: Vec<Picture>, gap: Duration) -> Vec<Vec<Picture>> {
    // Stable: pictures of one second stay in the order of the files.
    pictures.sort_by_key(|p| (p.utc.is_none(), p.utc));
    let mut series: Vec<Vec<Picture>> = Vec::new();
    for picture in pictures {
        let last = series.last().and_then(|s| s.last());
        let goes_on = last.is_some_and(|last| match (last.utc, picture.utc) {
            (Some(a), Some(b)) => {
                b.duration_since(a) <= jiff::SignedDuration::try_from(gap).unwrap_or_default()
            }
            (None, None) => true,
            _ => false,
        });
        match series.last_mut() {
            Some(open) if goes_on => open.push(picture),
            _ => series.push(vec![picture]),
        }
    }
    series
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn at(utc: Option<&str>, digest: &str) -> Picture {
        let utc = utc.map(|t| t.parse().unwrap());
        Picture { file: PathBuf::from(digest), digest: digest.into(), taken: Taken::default(), utc }
    }

    #[test]
    fn pauses_part_series_and_what_has_no_time_comes_last_as_given() {
        let pictures = vec![
            at(None, "z"),
            at(Some("2026-03-01T07:10:00Z"), "c"),
            at(Some("2026-03-01T07:00:00.5Z"), "b"),
            at(Some("2026-03-01T07:00:00.25Z"), "a"),
            at(None, "y"),
        ];
        let series = parted(pictures, Duration::from_secs(60));
        let names: Vec<Vec<&str>> =
            series.iter().map(|s| s.iter().map(|p| p.digest.as_str()).collect()).collect();
        assert_eq!(names, [vec!["a", "b"], vec!["c"], vec!["z", "y"]]);
    }

    #[test]
    fn pictures_that_are_not_read_are_named_but_beside_their_jpeg() {
        let files = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let of = |others: &[&str]| passed_over(&files(&["a/1.jpg", "a/2.JPG"]), &files(others));
        assert_eq!(of(&["a/1.dng", "a/2.NEF", "a/notes.txt"]), None);
        let said = of(&["a/1.dng", "a/3.HEIC", "b/1.dng"]).unwrap();
        assert!(said.starts_with("2 pictures") && said.contains("3.HEIC first"), "{said}");
    }

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = ["IMG_10.JPG", "IMG_9.JPG", "IMG_009b.JPG", "A.JPG", "99999999999999999999999.JPG"];
        names.sort_by_key(|n| natural(n));
        assert_eq!(
            names,
            ["99999999999999999999999.JPG", "A.JPG", "IMG_9.JPG", "IMG_009b.JPG", "IMG_10.JPG"]
        );
    }

    #[test]
    fn zones_and_durations_are_read_or_refused() {
        assert_eq!(zone("+02:00").unwrap().seconds(), 7200);
        assert!(zone("Berlin").is_err() && duration("0s").is_err() && duration("-5s").is_err());
        assert_eq!(duration("5m"), Ok(Duration::from_secs(300)));
    }
}
