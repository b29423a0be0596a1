//! `wingd mark` serves a page on which a person marks what the detector did not find.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use tracing::level_filters::LevelFilter;

use super::{Done, Failure, default_paths, frames, interrupt, pictures, stores};
use crate::http::access::Access;
use crate::http::mark::{Kept, Picture, Source, Workplace, serve};
use crate::http::section::ServeConfig;
use crate::installation::{self, Installation};
use crate::pipeline::marking::HAND_SIGMA_PX;
use crate::store::{FlightRef, RealDisk, layout, marks};

/// Mark markers by hand in a page on this machine, with who, when and why.
#[derive(clap::Args)]
pub struct Args {
    /// A store, or pictures and folders of them
    #[arg(required = true, value_name = "STORE|PICTURE")]
    what: Vec<PathBuf>,
    /// The installation [default: installation/ of this folder; of a store: the one kept there that its results came from]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Of a store: the flight [default: the newest]
    #[arg(long, value_name = "FLIGHT")]
    flight: Option<String>,
    /// The pictures show the wing on ground: an orientation is sought in each, for `wingd orient --observations`
    /// [default: where the installation has no orientation yet]
    #[arg(long)]
    ground: bool,
    /// Beside pictures: where the marks are kept [default: observations.csv beside the first picture]
    #[arg(long, value_name = "FILE.csv")]
    observations: Option<PathBuf>,
    /// Who marks [default: the user's name on this machine]
    #[arg(long, value_name = "NAME")]
    who: Option<String>,
    /// How well a hand points where the detector measures nothing, standard deviation, px
    #[arg(long, value_name = "PX", default_value_t = HAND_SIGMA_PX, value_parser = sigma)]
    sigma_px: f64,
    /// Address and port; beyond this machine with --token-file only
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8088")]
    listen: String,
    /// A file with a token of at least 16 characters that every request must bring
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

fn sigma(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "give a number of pixels, as in 2".to_owned())?;
    Some(value).filter(|v| (0.05..=100.0).contains(v)).ok_or_else(|| "give 0.05 to 100 px".to_owned())
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    super::logging::start_at(LevelFilter::WARN);
    let option = |key: &str| (PathBuf::from(format!("--{}", key.replace('_', "-"))), "value".to_owned());
    let config = ServeConfig {
        listen: args.listen.clone(),
        token_file: args.token_file.clone(),
        hosts: vec![],
        certificate: None,
        key: None,
    };
    let (address, access) = config.open(option)?;
    let workplace = match args.what.as_slice() {
        [store] if store.join(layout::STORE_FILE).exists() => of_store(args, store)?,
        _ => of_pictures(args)?,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|e| Failure::Failed(format!("could not start: {e}")))?;
    runtime.block_on(listen(workplace, access, address))
}

async fn listen(workplace: Workplace, access: Access, address: SocketAddr) -> Result<Done, Failure> {
    let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
        Failure::Failed(format!("could not listen on {address}: {e}; choose another --listen"))
    })?;
    let bound = listener.local_addr().unwrap_or(address);
    let kept = workplace.kept.words();
    eprintln!("wingd: marks are kept with {kept}; open http://{bound}/ (Ctrl-C ends)");
    serve(workplace, access, listener, interrupt()).await.map_err(|e| Failure::Failed(e.to_string()))?;
    Ok(Done::All)
}

fn workplace(args: &Args, installation: Installation, pictures: Vec<Picture>, kept: Kept) -> Workplace {
    let orientation = installation.orientation.clone().filter(|_| !args.ground);
    let login = || std::env::var("USER").or_else(|_| std::env::var("LOGNAME")).unwrap_or_default();
    let who = args.who.clone().unwrap_or_else(login);
    Workplace { installation, orientation, pictures, kept, who, hand_sigma_px: args.sigma_px }
}

fn load(args: &Args, directory: &Path) -> Result<Installation, Failure> {
    let read = if args.ground { installation::load_without_orientation } else { installation::load };
    let installation = read(directory)?;
    super::say_doubts(&installation);
    Ok(installation)
}

fn of_store(args: &Args, root: &Path) -> Result<Workplace, Failure> {
    if args.observations.is_some() {
        return Err(Failure::Usage(
            "--observations belongs to pictures: a store keeps its marks itself".into(),
        ));
    }
    let none = || Failure::Failed(format!("{}: holds no flight yet", root.display()));
    let flight: FlightRef = stores::flights(root, args.flight.as_deref())?.pop().ok_or_else(none)?;
    let directory = match &args.installation {
        Some(directory) => directory.clone(),
        None => stores::installation_of(root, &flight)?,
    };
    let installation = load(args, &directory)?;
    let frames = stores::frames(&RealDisk, &flight, None)?;
    if frames.is_empty() {
        return Err(Failure::Failed(format!("{}: {} holds no frame", root.display(), flight.id)));
    }
    let (store, recovery) = stores::open(root)?;
    for remark in &recovery.remarks {
        eprintln!("wingd: {remark}");
    }
    let (known, notes) = marks::read(store.disk(), root, &flight)?;
    for note in notes {
        eprintln!("wingd: {note}");
    }
    let picture = |frame: crate::store::FrameRef| Picture {
        name: stores::name_of(&frame),
        source: Source::Stored(Box::new(frame)),
    };
    let pictures = frames.into_iter().map(picture).collect();
    Ok(workplace(args, installation, pictures, Kept::with_flight(store, flight.id, known)))
}

fn of_pictures(args: &Args) -> Result<Workplace, Failure> {
    if let Some(flight) = &args.flight {
        return Err(Failure::Usage(format!("--flight {flight} names a flight of a store; name the store")));
    }
    let files = pictures::expand(&args.what)?;
    let installation = load(args, &default_paths::installation(args.installation.as_deref())?)?;
    let names = frames::names(&files);
    let beside = || files.first().and_then(|f| f.parent()).unwrap_or(Path::new("")).join(OBSERVATIONS);
    let kept = Kept::in_file(args.observations.clone().unwrap_or_else(beside), &installation.setup)?;
    let pictures =
        files.into_iter().zip(names).map(|(file, name)| Picture { name, source: Source::File(file) });
    let pictures = pictures.collect();
    Ok(workplace(args, installation, pictures, kept))
}

/// Beside pictures.
const OBSERVATIONS: &str = "observations.csv";
