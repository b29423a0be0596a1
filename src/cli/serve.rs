//! `wingd serve`: the download page for a store, without the daemon.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use super::{Done, Failure, interrupt};
use crate::store::{RealDisk, catalogue};
use crate::{http, installation};

/// Serve the download page for a store, without the daemon.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Address and port; 0.0.0.0:8080 lets other computers in
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080", value_parser = address)]
    listen: SocketAddr,
    /// The installation, for the report's ground shape and lines of sight
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    catalogue::check_format(&RealDisk, &args.store).map_err(|e| Failure::Undone(e.to_string()))?;
    let installation = args.installation.as_deref().map(installation::load_without_orientation);
    let setup = installation.transpose()?.map(|i| i.setup);
    let site = http::Site { root: args.store.clone(), setup, status: None };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|e| Failure::Undone(format!("could not start: {e}")))?;
    runtime.block_on(serve(site, args.listen))
}

/// A name or number with a port; of several addresses an old-style one, which a browser tries in any case.
fn address(text: &str) -> Result<SocketAddr, String> {
    let found =
        text.to_socket_addrs().map_err(|e| format!("{e}; give HOST:PORT, for example localhost:8080"))?;
    let all: Vec<SocketAddr> = found.collect();
    let first = all.iter().find(|a| a.is_ipv4()).or(all.first());
    first.copied().ok_or_else(|| "has no address; give HOST:PORT".into())
}

async fn serve(site: http::Site, address: SocketAddr) -> Result<Done, Failure> {
    let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
        Failure::Undone(format!("could not listen on {address}: {e}; choose another --listen"))
    })?;
    let bound = listener.local_addr().unwrap_or(address);
    eprintln!("wingd: serving {} at http://{bound}/ (Ctrl-C ends)", site.root.display());
    http::serve(site, listener, interrupt()).await.map_err(|e| Failure::Undone(e.to_string()))?;
    Ok(Done::All)
}
