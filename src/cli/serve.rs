//! `wingd serve`: the download page for a store, without the daemon.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

use super::{Done, Failure, interrupt};
use crate::http::access::{self, Access};
use crate::installation::Fault;
use crate::store::{RealDisk, catalogue};
use crate::{http, installation};

/// Serve the download page for a store, without the daemon.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Address and port; 0.0.0.0:8080 lets other computers in, with --token-file only
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080", value_parser = address)]
    listen: SocketAddr,
    /// A file with a token of at least 16 characters that every request must bring
    /// (Authorization: Bearer TOKEN, or as the password that a browser asks for)
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// A name by which clients may call this machine, besides its addresses and localhost
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// The installation, for the report's ground shape and lines of sight
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    super::logging::start_at("warn");
    let access = access(args)?;
    catalogue::check_format(&RealDisk, &args.store).map_err(|e| Failure::Undone(e.to_string()))?;
    let installation = args.installation.as_deref().map(installation::load_without_orientation);
    let setup = installation.transpose()?.map(|i| i.setup);
    let site = http::Site { root: args.store.clone(), setup, status: None };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|e| Failure::Undone(format!("could not start: {e}")))?;
    let done = runtime.block_on(serve(site, access, args.listen));
    runtime.shutdown_timeout(LAST_WORK);
    done
}

/// A name or number with a port; of several addresses an old-style one, which a browser tries in any case.
fn address(text: &str) -> Result<SocketAddr, String> {
    let found =
        text.to_socket_addrs().map_err(|e| format!("{e}; give HOST:PORT, for example localhost:8080"))?;
    let all: Vec<SocketAddr> = found.collect();
    let first = all.iter().find(|a| a.is_ipv4()).or(all.first());
    first.copied().ok_or_else(|| "has no address; give HOST:PORT".into())
}

/// For files that are being read when the server stops.
const LAST_WORK: Duration = Duration::from_secs(1);

/// Beyond the loopback only who has the token gets in.
fn access(args: &Args) -> Result<Access, Failure> {
    let token = args.token_file.as_deref().map(|file| {
        access::read_token(file).map_err(|(problem, mend)| Fault {
            file: file.to_owned(),
            place: "token".into(),
            problem,
            mend,
        })
    });
    let token = token.transpose()?;
    if token.is_none() && !args.listen.ip().is_loopback() {
        return Err(Failure::from(Fault {
            file: "--listen".into(),
            place: args.listen.to_string(),
            problem: "everybody on that network could read the store".into(),
            mend: "add --token-file FILE, or listen on 127.0.0.1".into(),
        }));
    }
    Ok(Access::new(token.as_deref(), args.hosts.clone()))
}

async fn serve(site: http::Site, access: Access, address: SocketAddr) -> Result<Done, Failure> {
    let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
        Failure::Undone(format!("could not listen on {address}: {e}; choose another --listen"))
    })?;
    let bound = listener.local_addr().unwrap_or(address);
    eprintln!("wingd: serving {} at http://{bound}/ (Ctrl-C ends)", site.root.display());
    http::serve(site, access, listener, interrupt()).await.map_err(|e| Failure::Undone(e.to_string()))?;
    Ok(Done::All)
}
