//! `wingd serve` shows the download page for a store, without the daemon.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use tracing::level_filters::LevelFilter;

use super::{Done, Failure, interrupt};
use crate::http::access::Access;
use crate::http::section::{self, ServeConfig};
use crate::store::{RealDisk, catalogue};
use crate::{http, installation};

/// Serve the download page for a store, without the daemon.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Address and port; 0.0.0.0:8080 lets other computers in, with --token-file only
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080", value_parser = listen)]
    listen: String,
    /// A file with a token of at least 16 characters that every request must bring
    /// (Authorization: Bearer TOKEN, or as the password that a browser asks for)
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// A name by which clients may call this machine, besides its addresses and localhost
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// A certificate (PEM): pages come by TLS alone
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
    /// Its private key (PEM)
    #[arg(long, value_name = "FILE", requires = "certificate")]
    key: Option<PathBuf>,
    /// The installation, for the report's ground shape and lines of sight [default: the one that the store keeps]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Where a recorder in live mode gives out its results, [live] socket of its configuration: for the page /live
    #[arg(long, value_name = "PATH", default_value = "/run/wingd/live.sock")]
    live_socket: PathBuf,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    super::logging::start_at(LevelFilter::WARN);
    let (address, access) = open(args)?;
    catalogue::check_format(&RealDisk, &args.store).map_err(|e| Failure::Failed(e.to_string()))?;
    let installation = args.installation.as_deref().map(installation::load_without_orientation);
    let setup = installation.transpose()?.map(|i| i.setup);
    let site =
        http::Site { root: args.store.clone(), setup, status: None, live: Some(args.live_socket.clone()) };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|e| Failure::Failed(format!("could not start: {e}")))?;
    let done = runtime.block_on(serve(site, access, address));
    runtime.shutdown_timeout(LAST_WORK);
    done
}

/// Wrong usage of `--listen`.
#[derive(Debug, thiserror::Error)]
#[error("{0}; give HOST:PORT, for example localhost:8080")]
struct WrongListen(#[from] section::NoAddress);

fn listen(text: &str) -> Result<String, WrongListen> {
    section::address(text)?;
    Ok(text.to_owned())
}

/// For files that are being read when the server stops.
const LAST_WORK: Duration = Duration::from_secs(1);

/// Beyond the loopback only who has the token gets in.
fn open(args: &Args) -> Result<(SocketAddr, Access), Failure> {
    let config = ServeConfig {
        listen: args.listen.clone(),
        token_file: args.token_file.clone(),
        hosts: args.hosts.clone(),
        certificate: args.certificate.clone(),
        key: args.key.clone(),
    };
    let option = |key: &str| (PathBuf::from(format!("--{}", key.replace('_', "-"))), "value".to_owned());
    Ok(config.open(option)?)
}

async fn serve(site: http::Site, access: Access, address: SocketAddr) -> Result<Done, Failure> {
    let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
        Failure::Failed(format!("could not listen on {address}: {e}; choose another --listen"))
    })?;
    let bound = listener.local_addr().unwrap_or(address);
    let scheme = if access.tls().is_some() { "https" } else { "http" };
    eprintln!("wingd: serving {} at {scheme}://{bound}/ (Ctrl-C ends)", site.root.display());
    http::serve(site, access, listener, interrupt()).await.map_err(|e| Failure::Failed(e.to_string()))?;
    Ok(Done::All)
}
