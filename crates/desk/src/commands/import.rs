//! `wingd import` imports the images of a camera's card into a store, as if a recorder had taken them.

use std::path::PathBuf;
use std::time::Duration;

use jiff::tz::Offset;
use jiff::{SignedDuration, Timestamp};
use serde_json::json;

use crate::import::{ImportedSeries, Importer};
use wingd_base::clock::written_time::parse_offset;
use wingd_base::clock::{Clock, SystemClock};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line, print_notes, progress_bar};
use wingd_base::text::printable_path;
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::default_paths::load_installation;
use wingd_evaluation::inputs::image_files::ImageCollection;
use wingd_evaluation::inputs::image_times::{DatedImage, DatingOptions};
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::inputs::time_list::TimeList;

/// Import the images of a camera's card into a store: dated, in series, each once.
#[derive(clap::Args)]
pub struct ImportArgs {
    /// Images, or folders with images in them and below
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    pictures: Vec<PathBuf>,
    /// Store; created if it does not exist
    #[arg(long, value_name = "STORE")]
    store: PathBuf,
    /// Installation to keep in the store, for `wingd solve STORE`
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Flight for the images: one of the store (f0001), or your name for a new one [default: by the images' times; a pause
    /// of 3 hours begins a new flight]
    #[arg(long, value_name = "NAME")]
    flight: Option<String>,
    /// Time zone of the camera's clock for images without one, for example +02:00 [default: UTC]
    #[arg(long, value_name = "ZONE", value_parser = parse_zone, allow_hyphen_values = true)]
    zone: Option<Offset>,
    /// Camera's clock less its true time, for example -42s or 3653d: subtracted from the times of its images
    #[arg(long, value_name = "DURATION", default_value = "0s", value_parser = parse_offset_duration, allow_hyphen_values = true)]
    clock_offset: SignedDuration,
    /// Times of the images, CSV with the columns image and utc; before those of the images themselves
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Time of the first image that has none, for example 2026-03-01T07:00:00Z
    #[arg(long, value_name = "TIME")]
    start: Option<Timestamp>,
    /// Interval between images without a time
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = parse_duration)]
    every: Duration,
    /// Pause that begins a new series
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = parse_duration)]
    gap: Duration,
    /// Standard deviation of the camera's clock relative to UTC, s; without it the aircraft's data are not used
    #[arg(long, value_name = "S", value_parser = parse_clock_sigma)]
    clock_sigma: Option<f64>,
    /// Print one JSON object per series
    #[arg(long)]
    json: bool,
}

fn parse_zone(text: &str) -> Result<Offset, String> {
    parse_offset(text).ok_or_else(|| "give the offset from UTC, for example +02:00".to_owned())
}

fn parse_duration(text: &str) -> Result<Duration, String> {
    let read = text
        .parse()
        .ok()
        .and_then(|read: jiff::SignedDuration| Duration::try_from(read).ok());
    read.filter(|d| !d.is_zero())
        .ok_or_else(|| "give a duration above 0, for example 60s or 5m".to_owned())
}

/// Parses a duration, or a number of seconds.
fn parse_offset_duration(text: &str) -> Result<SignedDuration, String> {
    let seconds = || {
        text.parse()
            .ok()
            .and_then(|s: f64| SignedDuration::try_from_secs_f64(s).ok())
    };
    // A calendar's day counts as 24 hours.
    let span = || {
        let hours = jiff::SpanRelativeTo::days_are_24_hours();
        text.parse::<jiff::Span>().ok()?.to_duration(hours).ok()
    };
    seconds()
        .or_else(span)
        .ok_or_else(|| "give a duration or seconds, for example -42s, 1h, 3653d or 0.25".to_owned())
}

fn parse_clock_sigma(text: &str) -> Result<f64, String> {
    let read = text
        .parse()
        .ok()
        .filter(|s: &f64| *s > 0.0 && *s <= 86_400.0);
    read.ok_or_else(|| "give seconds above 0, at most 86400".to_owned())
}

pub(super) fn run(args: &ImportArgs) -> TaskResult<Completion> {
    // Errors of the installation are reported before anything is copied.
    let installation = args
        .installation
        .as_deref()
        .map(load_installation)
        .transpose()?;
    let files = installation.as_ref().map(|i| i.files()).transpose()?;
    let dating = DatingOptions {
        zone: args.zone,
        clock_offset: args.clock_offset,
        list: args.times.as_deref().map(TimeList::read).transpose()?,
        start: args.start,
        every: args.every,
        gap: args.gap,
        now: SystemClock::new().stamp().utc,
    };
    let card = batch::read_collection(&batch::expand_folders(&args.pictures)?, &dating)?;
    print_notes(card.duplicates.iter().map(|(file, known)| {
        format!(
            "{}: same image as {}; imported once",
            printable_path(file),
            printable_path(known)
        )
    }));
    print_notes(
        card.refused
            .iter()
            .map(|(file, why)| format!("{}: {why}", printable_path(file))),
    );
    print_notes(
        card.remarks
            .iter()
            .map(|(what, remedy)| format!("{what}; {remedy}")),
    );
    if card.series.is_empty() {
        return Err(Failure::Failed(
            "none of the files is an image that can be imported".to_owned(),
        ));
    }
    check_zone_known(args, &card)?;
    let (store, recovery) = stored_flights::open_store(&args.store)?;
    let resumed = |series| {
        format!("{series}: interrupted earlier; its images are kept, the others are imported now")
    };
    print_notes(recovery.series.iter().map(resumed));
    let oriented = installation.is_some_and(|i| i.orientation.is_some());
    match (&files, &args.installation) {
        (Some(files), _) if oriented => store.keep_installation(files)?,
        (Some(_), Some(directory)) => eprintln!(
            "wingd: {}: has no orientation yet, so it is not kept in the store; run `wingd orient --installation {} GROUND_FRAME`",
            directory.display(),
            directory.display()
        ),
        _ => {}
    }
    let bar = progress_bar(card.series.iter().map(Vec::len).sum(), "copying");
    let progress = |images| bar.inc(images);
    let import = Importer::new(&store, args.flight.clone(), args.clock_sigma, &progress)?;
    let mut imported = Vec::new();
    let outcome = import.import_all(card.series, &mut imported);
    bar.finish_and_clear();
    store.seal();
    imported
        .iter()
        .try_for_each(|series| print_series(args, series))?;
    outcome?;
    if !args.json {
        print_line(&summary_text(args, &imported, oriented))?;
    }
    Ok(Completion::from_success(card.refused.is_empty()))
}

/// Checks that `--clock-sigma` is not given for images in an unknown zone, whose times may be wrong by hours.
fn check_zone_known(args: &ImportArgs, card: &ImageCollection) -> TaskResult<()> {
    let without = card.series.iter().flatten().filter(|p| p.zoneless).count();
    if without == 0 || args.zone.is_some() || args.clock_sigma.is_none() {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "--clock-sigma states the error of UTC, but {without} images have no time zone; give --zone (+00:00 if the camera was \
         set to UTC)"
    )))
}

fn print_series(args: &ImportArgs, imported: &ImportedSeries) -> TaskResult<()> {
    let ImportedSeries {
        pictures,
        flight,
        series,
        taken,
        already,
    } = imported;
    let name = |p: &DatedImage| p.name.clone();
    let time = |p: Option<&DatedImage>| p.and_then(|p| p.utc).map(|t| t.to_string());
    let (first, last) = (pictures.first(), pictures.last());
    if args.json {
        return print_json(&json!({
            "flight": flight, "series": series, "pictures": pictures.len(), "taken": taken, "already": already,
            "began": time(first), "ended": time(last), "sources": pictures.iter().map(name).collect::<Vec<_>>(),
        }));
    }
    let when = time(first).map_or_else(|| "no time".to_owned(), |t| format!("from {t}"));
    let already = if *already > 0 {
        format!(", {already} already there")
    } else {
        String::new()
    };
    let place = series
        .as_ref()
        .map_or_else(|| flight.clone(), |s| format!("{flight}/{s}"));
    let [first, last] = [first, last].map(|p| p.map(name).unwrap_or_default());
    print_line(&format!(
        "{place}  {taken} imported{already}  {when}  {first} to {last}"
    ))
}

fn summary_text(args: &ImportArgs, imported: &[ImportedSeries], kept: bool) -> String {
    let taken: usize = imported.iter().map(|series| series.taken).sum();
    let already: usize = imported.iter().map(|series| series.already).sum();
    let store = args.store.display();
    let given = args
        .installation
        .as_ref()
        .map_or_else(|| "DIR".to_owned(), |d| d.display().to_string());
    let next = if kept {
        String::new()
    } else {
        format!(" --installation {given}")
    };
    format!(
        "\n{taken} images imported into {store}, {already} already there\nNext: wingd solve {store}{next} --report report.html"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zones_and_durations_are_read_or_refused() {
        assert_eq!(parse_zone("+02:00").unwrap().seconds(), 7200);
        assert!(
            parse_zone("Berlin").is_err()
                && parse_duration("0s").is_err()
                && parse_duration("-5s").is_err()
        );
        assert_eq!(parse_duration("5m"), Ok(Duration::from_secs(300)));
    }
}
