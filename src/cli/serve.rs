//! `wingd serve`: the download page for a store, without the daemon.

use std::net::SocketAddr;
use std::path::PathBuf;

use super::{Done, Failure};
use crate::store::{RealDisk, catalogue};
use crate::{http, installation};

/// Serve the download page for a store, without the daemon.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Address and port; 0.0.0.0:8080 lets other computers in
    #[arg(long, default_value = "127.0.0.1:8080")]
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

async fn serve(site: http::Site, address: SocketAddr) -> Result<Done, Failure> {
    let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
        Failure::Undone(format!("could not listen on {address}: {e}; choose another --listen"))
    })?;
    let bound = listener.local_addr().unwrap_or(address);
    eprintln!("wingd: serving {} at http://{bound}/ (Ctrl-C ends)", site.root.display());
    http::serve(site, listener, stopped()).await.map_err(|e| Failure::Undone(e.to_string()))?;
    Ok(Done::All)
}

/// Ctrl-C or SIGTERM.
async fn stopped() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut terminate) => tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = terminate.recv() => {}
        },
        Err(_) => {
            let _ = tokio::signal::ctrl_c().await;
        }
    }
}
