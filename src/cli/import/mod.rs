//! `wingd import` imports the images of a camera's card into a store, as if a recorder had taken them.

mod importer;

use std::path::PathBuf;

use serde_json::json;

use super::image_files::{self, DatedImage, DatingOptions};
use super::{Completion, Failure, load_installation, print_line, store_access};
use importer::{ImportedSeries, Importer};

use crate::installation::printable_path;

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
    #[command(flatten)]
    dating: DatingOptions,
    /// Standard deviation of the camera's clock relative to UTC, s; without it the aircraft's data are not used
    #[arg(long, value_name = "S", value_parser = parse_clock_sigma)]
    clock_sigma: Option<f64>,
    /// Print one JSON object per series
    #[arg(long)]
    json: bool,
}

fn parse_clock_sigma(text: &str) -> Result<f64, String> {
    let read = text.parse().ok().filter(|s: &f64| *s > 0.0 && *s <= 86_400.0);
    read.ok_or_else(|| "give seconds above 0, at most 86400".to_owned())
}

pub(super) fn run(args: &ImportArgs) -> Result<Completion, Failure> {
    // Errors of the installation are reported before anything is copied.
    let installation = args.installation.as_deref().map(load_installation).transpose()?;
    let files = installation.as_ref().map(|i| i.files()).transpose()?;
    let card = image_files::read_collection(&args.pictures, &args.dating, 0)?;
    for (file, known) in &card.duplicates {
        eprintln!("wingd: {}: same image as {}; imported once", printable_path(file), printable_path(known));
    }
    for (file, why) in &card.refused {
        eprintln!("wingd: {}: {why}", printable_path(file));
    }
    for (what, remedy) in &card.remarks {
        eprintln!("wingd: {what}; {remedy}");
    }
    if card.series.is_empty() {
        return Err(Failure::Failed("none of the files is an image that can be imported".to_owned()));
    }
    let (store, recovery) = store_access::open_store(&args.store)?;
    for series in &recovery.series {
        eprintln!("wingd: {series}: interrupted earlier; its images are kept, the others are imported now");
    }
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
    let count = card.series.iter().map(Vec::len).sum();
    let import = Importer::new(&store, args.flight.clone(), args.clock_sigma, count)?;
    let mut all: Vec<(Vec<DatedImage>, ImportedSeries)> = Vec::new();
    let outcome = import.import_all(card.series, |pictures, taken| all.push((pictures, taken)));
    store.seal();
    all.iter().try_for_each(|(pictures, taken)| print_series(args, pictures, taken))?;
    outcome?;
    if !args.json {
        print_line(&summary_text(args, &all, oriented))?;
    }
    Ok(Completion::from_success(card.refused.is_empty()))
}

fn print_series(args: &ImportArgs, pictures: &[DatedImage], taken: &ImportedSeries) -> Result<(), Failure> {
    let name = |p: Option<&DatedImage>| p.map_or_else(String::new, |p| super::image_batch::image_name(&p.file));
    let time = |p: Option<&DatedImage>| p.and_then(|p| p.utc).map(|t| t.to_string());
    let (first, last) = (pictures.first(), pictures.last());
    if args.json {
        let names: Vec<String> = pictures.iter().map(|p| name(Some(p))).collect();
        let line = json!({
            "flight": taken.flight, "series": taken.series, "pictures": pictures.len(), "taken": taken.taken,
            "already": taken.already, "began": time(first), "ended": time(last), "sources": names,
        });
        return print_line(&line.to_string());
    }
    let when = time(first).map_or_else(|| "no time".to_owned(), |t| format!("from {t}"));
    let already = match taken.already {
        0 => String::new(),
        n => format!(", {n} already there"),
    };
    let place = taken.series.as_ref().map_or_else(|| taken.flight.clone(), |s| format!("{}/{s}", taken.flight));
    let (first, last) = (name(first), name(last));
    print_line(&format!("{place}  {} imported{already}  {when}  {first} to {last}", taken.taken))
}

fn summary_text(args: &ImportArgs, all: &[(Vec<DatedImage>, ImportedSeries)], kept: bool) -> String {
    let taken: usize = all.iter().map(|(_, t)| t.taken).sum();
    let already: usize = all.iter().map(|(_, t)| t.already).sum();
    let store = args.store.display();
    let given = args.installation.as_ref().map_or_else(|| "DIR".to_owned(), |d| d.display().to_string());
    let next = if kept { String::new() } else { format!(" --installation {given}") };
    format!(
        "\n{taken} images imported into {store}, {already} already there\nNext: wingd solve {store}{next} --report report.html"
    )
}
