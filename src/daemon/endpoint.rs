//! Unix sockets of the daemon: binding them, accepting clients, removing them.

use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Pause after an error of the operating system.
const RETRY_PAUSE: Duration = Duration::from_secs(2);
/// Pause before a socket that cannot be bound is tried again.
const BIND_PAUSE: Duration = Duration::from_secs(10);
/// Time after which a socket that neither accepts nor refuses a connection counts as used.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(1);

/// A bound socket. Its file is removed at the end, unless another process has replaced it.
struct BoundSocket {
    listener: UnixListener,
    path: PathBuf,
    /// Identity of the file.
    file: Option<SocketFile>,
}

impl Drop for BoundSocket {
    fn drop(&mut self) {
        if self.file.is_some() && socket_file(&self.path) == self.file {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Device, inode and time of creation, s and ns: an inode may be used again.
type SocketFile = (u64, u64, i64, i64);

fn socket_file(path: &Path) -> Option<SocketFile> {
    let meta = std::fs::symlink_metadata(path).ok()?;
    Some((meta.dev(), meta.ino(), meta.mtime(), meta.mtime_nsec()))
}

/// Returns the reason why a socket cannot be bound at a path: another kind of file is there.
pub fn occupied_socket_reason(path: &Path) -> Option<&'static str> {
    let occupied = std::fs::symlink_metadata(path).is_ok_and(|meta| !meta.file_type().is_socket());
    occupied.then_some("is a file that is not a socket; remove it, or name another path")
}

/// Binds a Unix socket and takes over a socket file that a killed daemon left. The store's lock has already excluded a
/// second daemon with this store, so a socket that answers belongs to a daemon with another store.
async fn bind_socket(path: &Path) -> io::Result<BoundSocket> {
    if let Some(reason) = occupied_socket_reason(path) {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, reason));
    }
    if socket_file(path).is_some() {
        let answered = tokio::time::timeout(CONNECT_TIMEOUT, UnixStream::connect(path)).await;
        if answered.is_err() || answered.is_ok_and(|connected| connected.is_ok()) {
            let problem = "another daemon answers there; give each its own socket";
            return Err(io::Error::new(io::ErrorKind::AddrInUse, problem));
        }
        std::fs::remove_file(path)?;
    }
    if let Some(parent) = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty())
    {
        std::fs::create_dir_all(parent)?;
    }
    let listener = UnixListener::bind(path)?;
    Ok(BoundSocket {
        listener,
        path: path.to_owned(),
        file: socket_file(path),
    })
}

/// Serves a socket forever; one that cannot be bound is reported and tried again. At most `max_clients` are served at a
/// time, each until its permit is dropped; others are disconnected at once.
pub(crate) async fn serve_socket(
    path: &Path,
    max_clients: usize,
    report: impl Fn(Option<String>),
    mut client: impl FnMut(UnixStream, OwnedSemaphorePermit),
) {
    let socket = loop {
        match bind_socket(path).await {
            Ok(socket) => break socket,
            Err(error) => report(Some(format!("{}: {error}", path.display()))),
        }
        tokio::time::sleep(BIND_PAUSE).await;
    };
    report(None);
    let permits = Arc::new(Semaphore::new(max_clients));
    loop {
        match socket.listener.accept().await {
            Ok((stream, _)) => {
                if let Ok(permit) = permits.clone().try_acquire_owned() {
                    client(stream, permit);
                }
            }
            Err(error) => {
                report(Some(format!(
                    "{}: cannot accept a client: {error}",
                    path.display()
                )));
                tokio::time::sleep(RETRY_PAUSE).await;
                report(None);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn only_the_own_socket_is_removed_and_no_other_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("wingd.sock");
        let first = bind_socket(&path).await.unwrap();
        assert!(
            bind_socket(&path)
                .await
                .is_err_and(|error| error.kind() == io::ErrorKind::AddrInUse)
        );
        assert!(path.exists(), "the second one removes nothing");
        std::fs::remove_file(&path).unwrap();
        let other = bind_socket(&path).await.unwrap();
        drop(first);
        assert!(path.exists(), "it belongs to the other one");
        drop(other);
        assert!(!path.exists());
        std::fs::write(&path, "notes").unwrap();
        assert!(
            bind_socket(&path)
                .await
                .is_err_and(|error| error.to_string().contains("not a socket"))
        );
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "notes");
    }
}
