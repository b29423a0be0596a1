//! `wingd import` takes pictures of a camera's card into a store, as if a recorder had taken them.

mod take;

use std::path::PathBuf;

use serde_json::json;

use super::pictures::{self, Dating, Picture};
use super::{Done, Failure, load_installation, print, stores};
use take::{Import, Taken};

use crate::installation::shown_path;

/// Take pictures of a camera's card into a store: dated, in series, each once.
#[derive(clap::Args)]
pub struct Args {
    /// Pictures, or folders with pictures in them and below
    #[arg(required = true, value_name = "PICTURE|FOLDER")]
    pictures: Vec<PathBuf>,
    /// The store; made where there is none
    #[arg(long, value_name = "STORE")]
    store: PathBuf,
    /// The installation, to be kept in the store: `wingd solve STORE` takes it
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// The flight they belong to: one of the store (f0001), or a name of yours for a new one
    /// [default: by the pictures' times; a pause of 3 hours begins a new one]
    #[arg(long, value_name = "NAME")]
    flight: Option<String>,
    #[command(flatten)]
    dating: Dating,
    /// How far the camera's clock may be off UTC, standard deviation, s; without it the aircraft's data are not joined
    #[arg(long, value_name = "S", value_parser = clock_sigma)]
    clock_sigma: Option<f64>,
    /// One JSON object per series
    #[arg(long)]
    json: bool,
}

fn clock_sigma(text: &str) -> Result<f64, String> {
    let read = text.parse().ok().filter(|s: &f64| *s > 0.0 && *s <= 86_400.0);
    read.ok_or_else(|| "give seconds above 0, a day at most".to_owned())
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    // Before anything is copied: a fault of the installation is mended first.
    let installation = args.installation.as_deref().map(load_installation).transpose()?;
    let files = installation.as_ref().map(|i| i.files()).transpose()?;
    let card = pictures::card(&args.pictures, &args.dating, 0)?;
    for (file, known) in &card.twice {
        eprintln!("wingd: {}: the same picture as {}; taken once", shown_path(file), shown_path(known));
    }
    for (file, why) in &card.refused {
        eprintln!("wingd: {}: {why}", shown_path(file));
    }
    for (what, mend) in &card.remarks {
        eprintln!("wingd: {what}; {mend}");
    }
    if card.series.is_empty() {
        return Err(Failure::Failed("none of the files is a picture that can be taken".to_owned()));
    }
    let (store, recovery) = stores::open(&args.store)?;
    for series in &recovery.series {
        eprintln!("wingd: {series}: broken off earlier; what it has is kept, the rest is taken now");
    }
    let oriented = installation.is_some_and(|i| i.orientation.is_some());
    match (&files, &args.installation) {
        (Some(files), _) if oriented => store.keep_installation(files)?,
        (Some(_), Some(directory)) => eprintln!(
            "wingd: {}: has no orientation yet, and is not kept; run `wingd orient --installation {} GROUND_FRAME`",
            directory.display(),
            directory.display()
        ),
        _ => {}
    }
    let count = card.series.iter().map(Vec::len).sum();
    let import = Import::new(&store, args.flight.clone(), args.clock_sigma, count)?;
    let mut all: Vec<(Vec<Picture>, Taken)> = Vec::new();
    let outcome = import.all(card.series, |pictures, taken| all.push((pictures, taken)));
    store.seal();
    all.iter().try_for_each(|(pictures, taken)| said(args, pictures, taken))?;
    outcome?;
    if !args.json {
        print(&summary(args, &all, oriented))?;
    }
    Ok(Done::all(card.refused.is_empty()))
}

fn said(args: &Args, pictures: &[Picture], taken: &Taken) -> Result<(), Failure> {
    let name = |p: Option<&Picture>| p.map_or_else(String::new, |p| super::frames::name(&p.file));
    let time = |p: Option<&Picture>| p.and_then(|p| p.utc).map(|t| t.to_string());
    let (first, last) = (pictures.first(), pictures.last());
    if args.json {
        let names: Vec<String> = pictures.iter().map(|p| name(Some(p))).collect();
        let line = json!({
            "flight": taken.flight, "series": taken.series, "pictures": pictures.len(), "taken": taken.taken,
            "already": taken.already, "began": time(first), "ended": time(last), "sources": names,
        });
        return print(&line.to_string());
    }
    let when = time(first).map_or_else(|| "no time".to_owned(), |t| format!("from {t}"));
    let already = match taken.already {
        0 => String::new(),
        n => format!(", {n} there already"),
    };
    let place =
        taken.series.as_ref().map_or_else(|| taken.flight.clone(), |s| format!("{}/{s}", taken.flight));
    let (first, last) = (name(first), name(last));
    print(&format!("{place}  {} taken{already}  {when}  {first} to {last}", taken.taken))
}

fn summary(args: &Args, all: &[(Vec<Picture>, Taken)], kept: bool) -> String {
    let taken: usize = all.iter().map(|(_, t)| t.taken).sum();
    let already: usize = all.iter().map(|(_, t)| t.already).sum();
    let store = args.store.display();
    let given = args.installation.as_ref().map_or_else(|| "DIR".to_owned(), |d| d.display().to_string());
    let next = if kept { String::new() } else { format!(" --installation {given}") };
    format!(
        "\n{taken} pictures taken into {store}, {already} there already\nNext: wingd solve {store}{next} --report report.html"
    )
}
