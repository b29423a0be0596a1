//! Times of images of a card: from a list, their metadata or their names, or as given; and remarks on impossible ones.

use std::collections::BTreeMap;
use std::time::Duration;

use jiff::tz::Offset;
use jiff::{SignedDuration, Timestamp};

pub use super::dated_image::{DatedImage, TimeSource};
use super::time_list::{FIRST_YEAR, TimeList};
use wingd_base::clock::written_time::{WrittenTime, duration_text, offset_text};
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::fault::Fault;
use wingd_measure::estimation::robust::median;

/// Options for dating images and splitting them into series.
#[derive(Clone, Debug)]
pub struct DatingOptions {
    /// Time zone of the camera's clock for images without one; UTC by default.
    pub zone: Option<Offset>,
    /// Camera's clock less its true time; zero by default.
    pub clock_offset: SignedDuration,
    /// List of times, which count before those of the images.
    pub list: Option<TimeList>,
    /// Time of the first image that has none.
    pub start: Option<Timestamp>,
    /// Interval between images without a time.
    pub every: Duration,
    /// Pause that begins a new series: a camera takes the images of a series within seconds of each other.
    pub gap: Duration,
    /// Present time, to notice images from the future.
    pub now: Timestamp,
}

impl Default for DatingOptions {
    fn default() -> Self {
        let (every, gap) = (Duration::from_secs(1), Duration::from_secs(60));
        Self {
            zone: None,
            clock_offset: SignedDuration::ZERO,
            list: None,
            start: None,
            every,
            gap,
            now: Timestamp::MAX,
        }
    }
}

/// Remark, and the options of `wingd import` that help.
pub type TimeRemark = (String, String);

/// Dates the images, given in the order of their files; returns remarks on the times.
///
/// # Errors
/// Returns an error if a list of times is given that does not fit the images.
pub fn date_images(
    pictures: &mut [DatedImage],
    dating: &DatingOptions,
) -> TaskResult<Vec<TimeRemark>> {
    let mut remarks = take_listed_times(pictures, dating)?;
    remarks.extend(drop_repeated_fixes(pictures, dating));
    take_camera_times(pictures, dating);
    remarks.extend(take_name_times(pictures, dating));
    remarks.extend(zone_remarks(pictures, dating));
    remarks.extend(clock_remarks(pictures, dating));
    remarks.extend(date_remaining(pictures, dating));
    Ok(remarks)
}

/// Formats a number of images with the name of the first: `2 images (first IMG_1.JPG)`.
fn count_images(selected: &[&DatedImage]) -> String {
    let first = selected
        .first()
        .map(|p| p.name.as_str())
        .unwrap_or_default();
    format!("{} images (first {first})", selected.len())
}

fn select_images(
    pictures: &[DatedImage],
    select: impl Fn(&DatedImage) -> bool,
) -> Option<Vec<&DatedImage>> {
    let selected: Vec<&DatedImage> = pictures.iter().filter(|p| select(p)).collect();
    (!selected.is_empty()).then_some(selected)
}

fn take_listed_times(
    pictures: &mut [DatedImage],
    dating: &DatingOptions,
) -> TaskResult<Vec<TimeRemark>> {
    let Some(list) = &dating.list else {
        return Ok(vec![]);
    };
    let fault = |line: u64, problem: String, remedy: &str| {
        let place = if line == 0 {
            "file".to_owned()
        } else {
            format!("line {line}")
        };
        Failure::from(Fault::new(&list.file, place, problem, remedy))
    };
    let mut used: BTreeMap<u64, String> = BTreeMap::new();
    for picture in pictures.iter_mut() {
        let Some((line, time)) = list.find(&picture.file) else {
            continue;
        };
        if let Some(other) = used.insert(line, picture.name.clone()) {
            let problem = format!("names two images, {other} and {}", picture.name);
            return Err(fault(line, problem, "write each name with its folder"));
        }
        picture.set_time(time.timestamp(Offset::UTC), Some(&time), TimeSource::List);
    }
    if used.is_empty() && !pictures.is_empty() {
        return Err(fault(
            0,
            "names none of the images".into(),
            "write the names of the files in the column image",
        ));
    }
    let name = list.file.display();
    let missing = select_images(pictures, |p| p.source.is_none()).map(|missing| {
        (
            format!("{} are not in {name}", count_images(&missing)),
            "they are dated like images without a list".into(),
        )
    });
    let lines = list.count();
    let other = (lines > used.len()).then(|| {
        (
            format!("{} lines of {name} name no image", lines - used.len()),
            "check these names".to_owned(),
        )
    });
    Ok(missing.into_iter().chain(other).collect())
}

/// Removes position fixes that a camera repeats without reception: images of other times have the same one.
fn drop_repeated_fixes(pictures: &mut [DatedImage], dating: &DatingOptions) -> Option<TimeRemark> {
    let clock = |p: &DatedImage| camera_time(p.taken.time.as_ref()?, dating);
    let mut sharing: BTreeMap<Timestamp, Vec<Option<Timestamp>>> = BTreeMap::new();
    for picture in pictures.iter() {
        let clocks = picture
            .taken
            .gps_utc
            .map(|fix| sharing.entry(fix).or_default());
        clocks.into_iter().for_each(|all| all.push(clock(picture)));
    }
    sharing.retain(|_, clocks| is_repeated(clocks));
    let repeats = |p: &DatedImage| {
        p.taken
            .gps_utc
            .is_some_and(|fix| sharing.contains_key(&fix))
    };
    let count = count_images(&select_images(pictures, repeats)?);
    for picture in pictures.iter_mut().filter(|p| repeats(p)) {
        picture.taken.gps_utc = None;
    }
    Some((
        format!("{count} repeat the position fix of another image"),
        "they are not used; if the images have no other time, give --times FILE.csv".into(),
    ))
}

/// Largest time for which images of one burst can share a position fix.
const FIX_STEP: SignedDuration = SignedDuration::from_secs(2);

/// Returns whether images with these times of the camera's clock cannot share a position fix.
fn is_repeated(clocks: &[Option<Timestamp>]) -> bool {
    let known = clocks.iter().copied().collect::<Option<Vec<_>>>();
    let span = known.and_then(|k| Some((*k.iter().min()?, *k.iter().max()?)));
    clocks.len() > 1 && span.is_none_or(|(first, last)| last.duration_since(first) > FIX_STEP)
}

/// Takes the times of the camera's clock and, without one, of the position fix.
fn take_camera_times(pictures: &mut [DatedImage], dating: &DatingOptions) {
    for picture in pictures.iter_mut().filter(|p| p.source.is_none()) {
        match (picture.taken.time, picture.taken.gps_utc) {
            (Some(time), _) => picture.set_time(
                camera_time(&time, dating),
                Some(&time),
                TimeSource::Metadata,
            ),
            (None, Some(utc)) => picture.set_time(Some(utc), None, TimeSource::PositionFix),
            (None, None) => {}
        }
    }
}

/// Converts a time of the camera's clock to UTC.
fn camera_time(time: &WrittenTime, dating: &DatingOptions) -> Option<Timestamp> {
    time.timestamp(dating.zone.unwrap_or(Offset::UTC))?
        .checked_sub(dating.clock_offset)
        .ok()
}

/// Takes the times in the names of images that have no other, if all these names have one.
fn take_name_times(pictures: &mut [DatedImage], dating: &DatingOptions) -> Option<TimeRemark> {
    let named =
        |p: &DatedImage| WrittenTime::find(&p.file.file_stem()?.to_string_lossy(), FIRST_YEAR);
    let undated = |p: &&mut DatedImage| p.source.is_none();
    let latest = dating.now.saturating_add(MAX_AHEAD).ok()?;
    let sound = |p: &DatedImage| {
        named(p)
            .and_then(|t| camera_time(&t, dating))
            .is_some_and(|t| t <= latest)
    };
    let all = select_images(pictures, |p| p.source.is_none())?;
    if !all.iter().all(|p| sound(p)) {
        return None;
    }
    let what = format!("{} have their times from their names", count_images(&all));
    for picture in pictures.iter_mut().filter(undated) {
        let Some(time) = named(picture) else { continue };
        picture.set_time(camera_time(&time, dating), Some(&time), TimeSource::Name);
    }
    Some((
        what,
        "if these times are wrong, give --times FILE.csv (image,utc)".into(),
    ))
}

/// Reports images without a zone, and zones of images that differ from the one given.
fn zone_remarks(pictures: &[DatedImage], dating: &DatingOptions) -> Vec<TimeRemark> {
    let mut remarks = vec![];
    if let (Some(without), None) = (select_images(pictures, |p| p.zoneless), dating.zone) {
        let what = format!("{} images have no time zone: assumed UTC", without.len());
        remarks.push((
            what,
            "if the camera was set to another zone, give --zone".into(),
        ));
    }
    let other = |p: &DatedImage| {
        let own = p
            .taken
            .time
            .and_then(|t| t.offset)
            .filter(|_| p.source == Some(TimeSource::Metadata));
        own.filter(|own| dating.zone.is_some_and(|zone| zone != *own))
    };
    if let Some(others) = select_images(pictures, |p| other(p).is_some()) {
        let own = others
            .first()
            .and_then(|p| other(p))
            .map(offset_text)
            .unwrap_or_default();
        let what = format!(
            "{} name their zone, {own}, which counts",
            count_images(&others)
        );
        remarks.push((
            what,
            "--zone is for images without one; if their clock was wrong, give --clock-offset"
                .into(),
        ));
    }
    remarks
}

/// Largest difference between a camera's clock and its position fix, s: a fix may be minutes old.
const MAX_FIX_AGE_S: f64 = 180.0;
/// Largest difference between a position fix and a whole number of quarter hours that points to a zone, s.
const MAX_ZONE_REST_S: f64 = 90.0;
/// Step of the time zones in use, s.
const QUARTER_HOUR_S: f64 = 900.0;
/// Largest time that an image is ahead of this computer: a zone, and a clock that is not exact.
const MAX_AHEAD: SignedDuration = SignedDuration::from_hours(36);
/// First year with cameras that write Exif (its version 1.0).
const FIRST_EXIF_YEAR: i16 = 1995;

/// Reports times of a camera's clock that was not set, or differs from the position fixes.
fn clock_remarks(pictures: &[DatedImage], dating: &DatingOptions) -> Vec<TimeRemark> {
    let mut remarks = vec![];
    let of_camera = |p: &DatedImage| p.source == Some(TimeSource::Metadata);
    let zone = |p: &DatedImage| {
        p.taken
            .time
            .and_then(|t| t.offset)
            .or(dating.zone)
            .unwrap_or(Offset::UTC)
    };
    let corrected = |p: &DatedImage| {
        p.utc
            .filter(|_| of_camera(p))
            .map(|utc| zone(p).to_datetime(utc))
    };
    let correct = || {
        "if they are wrong, give --clock-offset (camera's clock less true time) or --times FILE.csv"
            .to_owned()
    };
    let unset = |p: &DatedImage| {
        corrected(p).is_some_and(|t| t.year() < FIRST_EXIF_YEAR || (t.month(), t.day()) == (1, 1))
    };
    if let Some(unset) = select_images(pictures, unset) {
        let day = unset
            .first()
            .and_then(|p| corrected(p))
            .map(|t| t.date().to_string())
            .unwrap_or_default();
        let what = format!(
            "{} are dated {day}, the day from which a clock counts that was never set or lost its battery",
            count_images(&unset)
        );
        remarks.push((what, correct()));
    }
    let future = |p: &DatedImage| {
        p.utc
            .is_some_and(|utc| utc.duration_since(dating.now) > MAX_AHEAD)
    };
    if let Some(future) = select_images(pictures, future) {
        let utc = future
            .first()
            .and_then(|p| p.utc)
            .map(|t| t.to_string())
            .unwrap_or_default();
        remarks.push((
            format!("{} are dated in the future: {utc}", count_images(&future)),
            correct(),
        ));
    }
    let ahead = |p: &DatedImage| {
        Some(
            p.utc
                .filter(|_| of_camera(p))?
                .duration_since(p.taken.gps_utc?)
                .as_secs_f64(),
        )
    };
    let Some(ahead_s) = median(pictures.iter().filter_map(ahead).collect()) else {
        return remarks;
    };
    let first = pictures.iter().find(|p| ahead(p).is_some());
    if let Some(first) = first.filter(|_| ahead_s.abs() > MAX_FIX_AGE_S) {
        let (name, used) = (&first.name, zone(first));
        let time = |t: Option<Timestamp>| t.map(|t| t.to_string()).unwrap_or_default();
        let way = if ahead_s > 0.0 { "ahead of" } else { "behind" };
        let what = format!(
            "the camera's clock is {} {way} its own position fixes ({name}: {} by the clock, {} by GPS)",
            duration_text(ahead_s),
            time(first.utc),
            time(first.taken.gps_utc)
        );
        let quarters_s = (ahead_s / QUARTER_HOUR_S).round() * QUARTER_HOUR_S;
        let true_zone = Offset::from_seconds(used.seconds() + quarters_s as i32).ok();
        let true_zone = true_zone.filter(|z| {
            z.seconds().abs() <= 14 * 3600 && (ahead_s - quarters_s).abs() < MAX_ZONE_REST_S
        });
        let remedy = match true_zone.filter(|_| first.zoneless) {
            Some(zone) => format!("give --zone {}", offset_text(zone)),
            None => format!(
                "give --clock-offset {:.0}s",
                ahead_s + dating.clock_offset.as_secs_f64()
            ),
        };
        remarks.push((what, remedy));
    }
    remarks
}

/// Dates images without a time from the time given.
fn date_remaining(pictures: &mut [DatedImage], dating: &DatingOptions) -> Vec<TimeRemark> {
    let undated: Vec<usize> = (0..pictures.len())
        .filter(|k| pictures[*k].source.is_none())
        .collect();
    if undated.is_empty() {
        return vec![];
    }
    let count = format!("{} images have no time", undated.len());
    let mut remarks = vec![];
    if let Some(damaged) = select_images(pictures, |p| p.source.is_none() && p.taken.damaged) {
        let what = format!(
            "the Exif block of {} without a time is damaged",
            count_images(&damaged)
        );
        remarks.push((
            what,
            "copy them from the camera again, or give --times FILE.csv".into(),
        ));
    }
    if let Some(start) = dating.start {
        for (k, index) in undated.iter().enumerate() {
            let since = u32::try_from(k)
                .ok()
                .and_then(|k| dating.every.checked_mul(k));
            let utc = since.and_then(|since| start.checked_add(since).ok());
            pictures[*index].set_time(utc, None, TimeSource::Start);
        }
        let what = format!(
            "{count}: dated in the order of the files, from {start} every {:?}",
            dating.every
        );
        remarks.push((what, "as given by --start and --every".into()));
        return remarks;
    }
    remarks.push((
        format!("{count}: kept in the order of the files"),
        "give --start and --every, or --times FILE.csv, if you know them".into(),
    ));
    remarks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fix_of_images_at_other_times_is_repeated() {
        let at = |s: i64| Some(Timestamp::from_second(1_780_300_800 + s).unwrap());
        assert!(is_repeated(&[at(0), at(60)]) && is_repeated(&[None, None]));
        assert!(!is_repeated(&[at(0), at(1)]) && !is_repeated(&[at(0)]));
    }
}
