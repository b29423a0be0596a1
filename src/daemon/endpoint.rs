//! The daemon answers at Unix sockets, which are opened and served here.

use std::io;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream as Client};

/// Listens; a socket that a killed daemon left is taken over. The store's lock has already kept a
/// second daemon out, so that a living socket belongs to a daemon with another store.
pub(crate) fn listen(path: &Path) -> io::Result<UnixListener> {
    if path.exists() {
        if UnixStream::connect(path).is_ok() {
            let what = "another daemon answers there; give each its own [status] socket";
            return Err(io::Error::new(io::ErrorKind::AddrInUse, what));
        }
        std::fs::remove_file(path)?;
    }
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent)?;
    }
    UnixListener::bind(path)
}

/// After an error of the machine.
const PAUSE: Duration = Duration::from_secs(2);

/// Accepts clients for ever.
pub(crate) async fn accept(listener: UnixListener, mut client: impl FnMut(Client)) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => client(stream),
            Err(error) => {
                tracing::warn!(%error, "a client could not be accepted");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}
