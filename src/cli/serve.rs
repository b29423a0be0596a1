//! `wingd serve` serves the download page of a store, without the recorder.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use tracing::level_filters::LevelFilter;

use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_evaluation::inputs::stop_signal;
use wingd_pages as http;
use wingd_pages::access::Access;
use wingd_pages::section;
use wingd_pages::section::ServeConfig;
use wingd_store::{RealDisk, catalogue};

/// Serve the download page of a store, without the recorder.
#[derive(clap::Args)]
pub struct ServeArgs {
    /// Store
    store: PathBuf,
    /// Address and port to listen on; other computers (0.0.0.0:8080) need --token-file
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080", value_parser = parse_listen)]
    listen: String,
    /// File with a token of at least 16 characters that every request must carry (Authorization: Bearer TOKEN, or as the
    /// password that a browser asks for)
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Name by which clients may address this machine, in addition to its addresses and localhost
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// Certificate (PEM): pages are served by TLS only
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
    /// Private key of the certificate (PEM)
    #[arg(long, value_name = "FILE", requires = "certificate")]
    key: Option<PathBuf>,
}

pub(super) fn run(args: &ServeArgs) -> TaskResult<Completion> {
    wingd_base::logging::start_logging(LevelFilter::WARN);
    let (address, access) = open_access(args)?;
    catalogue::check_format(&RealDisk, &args.store).map_err(|e| Failure::Failed(e.to_string()))?;
    let site = http::Site {
        root: args.store.clone(),
        recorder: None,
    };
    let runtime = http::page_runtime();
    let runtime = runtime.map_err(|e| Failure::Failed(format!("could not start: {e}")))?;
    let done = runtime.block_on(serve_store(site, access, address));
    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
    done
}

/// Invalid address for `--listen`.
#[derive(Debug, thiserror::Error)]
#[error("{0}; give HOST:PORT, for example localhost:8080")]
struct ListenError(#[from] section::ListenAddressError);

fn parse_listen(text: &str) -> Result<String, ListenError> {
    section::resolve_address(text)?;
    Ok(text.to_owned())
}

/// Time allowed for open downloads when the server stops.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Opens access control with the token that other computers need.
fn open_access(args: &ServeArgs) -> TaskResult<(SocketAddr, Access)> {
    let config = ServeConfig {
        listen: args.listen.clone(),
        token_file: args.token_file.clone(),
        hosts: args.hosts.clone(),
        certificate: args.certificate.clone(),
        key: args.key.clone(),
    };
    let option = |key: &str| {
        (
            PathBuf::from(format!("--{}", key.replace('_', "-"))),
            "value".to_owned(),
        )
    };
    for warning in config.warnings() {
        eprintln!("wingd: warning: {warning}");
    }
    Ok(config.resolve(option)?)
}

async fn serve_store(
    site: http::Site,
    access: Access,
    address: SocketAddr,
) -> TaskResult<Completion> {
    let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
        Failure::Failed(format!(
            "could not listen on {address}: {e}; choose another --listen"
        ))
    })?;
    let bound = listener.local_addr().unwrap_or(address);
    let scheme = if access.tls().is_some() {
        "https"
    } else {
        "http"
    };
    eprintln!(
        "wingd: serving {} at {scheme}://{bound}/ (stop with Ctrl-C)",
        site.root.display()
    );
    http::serve(site, access, listener, stop_signal())
        .await
        .map_err(|e| Failure::Failed(e.to_string()))?;
    Ok(Completion::All)
}
