//! `wingd mark` serves a page for marking undetected markers manually.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use tracing::level_filters::LevelFilter;

use crate::mark::{ImageSource, MarkStorage, MarkableImage, Workplace, serve_marking};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_notes;
use wingd_evaluation::inputs::default_paths;
use wingd_evaluation::inputs::default_paths::resolve_installation;
use wingd_evaluation::inputs::image_names::image_names;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::inputs::{batch, stop_signal};
use wingd_evaluation::installation::Installation;
use wingd_evaluation::pipeline::marking::MANUAL_SIGMA_PX;
use wingd_pages::access::Access;
use wingd_pages::section::ServeConfig;
use wingd_store as store;
use wingd_store::{RealDisk, StoreError, layout, manual_marks};

/// Mark undetected markers manually in a browser on this machine; who, when and why are stored with each mark.
#[derive(clap::Args)]
pub struct MarkArgs {
    /// Store, or images and folders of images
    #[arg(required = true, value_name = "STORE|IMAGE")]
    what: Vec<PathBuf>,
    /// Installation [default: installation/ in this directory; for a store: the one kept there that its results came from]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Flight of a store [default: the newest]
    #[arg(long, value_name = "FLIGHT")]
    flight: Option<String>,
    /// The images show the wing on the ground: an orientation is estimated in each, for `wingd orient --observations`
    /// [default: if the installation has no orientation yet]
    #[arg(long)]
    ground: bool,
    /// File for the marks in images [default: observations.csv next to the first image]
    #[arg(long, value_name = "FILE.csv")]
    observations: Option<PathBuf>,
    /// Name stored with the marks [default: your user name on this machine]
    #[arg(long, value_name = "NAME")]
    who: Option<String>,
    /// Standard deviation of a manual mark that the detector cannot refine, px
    #[arg(long, value_name = "PX", default_value_t = MANUAL_SIGMA_PX, value_parser = parse_sigma)]
    sigma_px: f64,
    /// Address and port to listen on; other computers need --token-file
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8088")]
    listen: String,
    /// File with a token of at least 16 characters that every request must carry
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

fn parse_sigma(text: &str) -> Result<f64, String> {
    let value: f64 = text
        .parse()
        .map_err(|_| "give a number of pixels, for example 2".to_owned())?;
    Some(value)
        .filter(|v| (0.05..=100.0).contains(v))
        .ok_or_else(|| "give 0.05 to 100 px".to_owned())
}

pub(super) fn run(args: &MarkArgs) -> TaskResult<Completion> {
    wingd_base::logging::start_logging(LevelFilter::WARN);
    let option = |key: &str| {
        (
            PathBuf::from(format!("--{}", key.replace('_', "-"))),
            "value".to_owned(),
        )
    };
    let (listen, token_file) = (args.listen.clone(), args.token_file.clone());
    let config = ServeConfig {
        listen,
        token_file,
        ..ServeConfig::default()
    };
    let (address, access) = config.resolve(option)?;
    let workplace = match args.what.as_slice() {
        [store] if store.join(layout::STORE_FILE).exists() => workplace_for_store(args, store)?,
        _ => workplace_for_images(args)?,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let runtime = runtime.map_err(|e| Failure::Failed(format!("could not start: {e}")))?;
    // Without a token every user of this machine could mark.
    let token = if args.token_file.is_some() {
        None
    } else {
        Some(store::random_id()?)
    };
    let access = match &token {
        Some(token) => access.with_address_token(token),
        None => access,
    };
    runtime.block_on(serve_page(workplace, (access, token), address))
}

async fn serve_page(
    workplace: Workplace,
    (access, token): (Access, Option<String>),
    address: SocketAddr,
) -> TaskResult<Completion> {
    let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
        Failure::Failed(format!(
            "could not listen on {address}: {e}; choose another --listen"
        ))
    })?;
    let bound = listener.local_addr().unwrap_or(address);
    let kept = workplace.storage.description();
    let query = token.map_or(String::new(), |token| format!("?token={token}"));
    eprintln!("wingd: marks are saved with {kept}; open http://{bound}/{query} (stop with Ctrl-C)");
    serve_marking(workplace, access, listener, stop_signal())
        .await
        .map_err(Failure::from_error)?;
    Ok(Completion::All)
}

fn create_workplace(
    args: &MarkArgs,
    installation: Installation,
    pictures: Vec<MarkableImage>,
    kept: MarkStorage,
) -> Workplace {
    let orientation = installation.orientation.clone().filter(|_| !args.ground);
    let login = || {
        std::env::var("USER")
            .or_else(|_| std::env::var("LOGNAME"))
            .unwrap_or_default()
    };
    let who = args.who.clone().unwrap_or_else(login);
    Workplace {
        installation,
        orientation,
        images: pictures,
        storage: kept,
        who,
        manual_sigma_px: args.sigma_px,
    }
}

fn load_installation(args: &MarkArgs, directory: &Path) -> TaskResult<Installation> {
    let load = if args.ground {
        default_paths::load_without_orientation
    } else {
        default_paths::load_installation
    };
    load(directory)
}

fn workplace_for_store(args: &MarkArgs, root: &Path) -> TaskResult<Workplace> {
    if args.observations.is_some() {
        return Err(Failure::Usage(
            "--observations is only for images: a store saves its own marks".into(),
        ));
    }
    let flight = stored_flights::select_flights(root, args.flight.as_deref())?.pop();
    let flight = flight.ok_or_else(|| Failure::from_path_error(root, "has no flight yet"))?;
    let directory =
        stored_flights::flight_installation(args.installation.as_deref(), root, &flight)?;
    let installation = load_installation(args, &directory)?;
    let frames = stored_flights::flight_frames(&RealDisk, &flight, None)?;
    if frames.is_empty() {
        return Err(Failure::from_path_error(
            root,
            format!("{} has no frame", flight.id),
        ));
    }
    match stored_flights::open_store(root) {
        Ok((_, recovery)) => print_notes(&recovery.remarks),
        // Marks can be added as soon as it is free.
        Err(error @ StoreError::Locked { .. }) => print_notes([error]),
        Err(error) => return Err(error.into()),
    }
    let (known, notes) = manual_marks::read_marks(&RealDisk, root, &flight)?;
    print_notes(notes);
    let picture = |frame: wingd_store::FrameRef| MarkableImage {
        name: stored_flights::frame_name(&frame),
        source: ImageSource::Stored(Box::new(frame)),
    };
    let pictures = frames.into_iter().map(picture).collect();
    Ok(create_workplace(
        args,
        installation,
        pictures,
        MarkStorage::from_flight(root.to_owned(), flight, known),
    ))
}

fn workplace_for_images(args: &MarkArgs) -> TaskResult<Workplace> {
    if let Some(flight) = &args.flight {
        return Err(Failure::Usage(format!(
            "--flight {flight} names a flight of a store; give the store too"
        )));
    }
    let files = batch::expand_folders(&args.what)?;
    let installation =
        load_installation(args, &resolve_installation(args.installation.as_deref())?)?;
    let names = image_names(&files);
    let default_file = || {
        files
            .first()
            .and_then(|f| f.parent())
            .unwrap_or(Path::new(""))
            .join(DEFAULT_OBSERVATIONS_FILE)
    };
    let kept = MarkStorage::from_file(
        args.observations.clone().unwrap_or_else(default_file),
        &installation.setup,
    )?;
    let pictures = files
        .into_iter()
        .zip(names)
        .map(|(file, name)| MarkableImage {
            name,
            source: ImageSource::File(file),
        });
    let pictures = pictures.collect();
    Ok(create_workplace(args, installation, pictures, kept))
}

/// File for the marks in images, next to the first one.
const DEFAULT_OBSERVATIONS_FILE: &str = "observations.csv";
