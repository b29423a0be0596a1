//! Unix sockets of the daemon: binding them and accepting clients.

use std::io;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream as Client};

/// Binds a Unix socket and takes over a socket file that a killed daemon left. The store's lock has already excluded a
/// second daemon with this store, so a socket that answers belongs to a daemon with another store.
pub(crate) fn bind_socket(path: &Path) -> io::Result<UnixListener> {
    if path.exists() {
        if UnixStream::connect(path).is_ok() {
            let problem = "another daemon answers there; give each its own [status] socket";
            return Err(io::Error::new(io::ErrorKind::AddrInUse, problem));
        }
        std::fs::remove_file(path)?;
    }
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent)?;
    }
    UnixListener::bind(path)
}

/// Pause after an error of the operating system.
const RETRY_PAUSE: Duration = Duration::from_secs(2);

/// Accepts clients forever.
pub(crate) async fn accept_clients(listener: UnixListener, mut client: impl FnMut(Client)) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => client(stream),
            Err(error) => {
                tracing::warn!(%error, "cannot accept a client; trying again");
                tokio::time::sleep(RETRY_PAUSE).await;
            }
        }
    }
}
