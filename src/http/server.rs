//! Connections are accepted here: so many, so long, and so they end.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::{GracefulShutdown, Watcher};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::sleep;
use tokio_io_timeout::TimeoutStream;

use super::access::{Access, Peer};
use crate::daemon::keep_alive;

/// A browser takes six at most, one that watches live mode two or three: for forty of these.
const CONNECTIONS: usize = 256;
/// For a request's head, and for the next request on an open connection.
const HEAD_TIME: Duration = Duration::from_secs(10);
/// A client that takes no byte for so long is gone.
const STALL_TIME: Duration = Duration::from_secs(30);
/// For answers under way when the server stops; with what follows under 5 s.
const STOP_TIME: Duration = Duration::from_secs(3);
/// Pause after a failed accept: out of descriptors, for instance.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// A request's head at most.
const HEAD_BYTES: usize = 16 * 1024;

/// Accepts until `shutdown` is done.
pub(super) async fn run(
    app: Router,
    access: Arc<Access>,
    listener: TcpListener,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    let graceful = GracefulShutdown::new();
    let mut connections = JoinSet::new();
    tokio::pin!(shutdown);
    loop {
        let (stream, peer) = tokio::select! {
            () = &mut shutdown => break,
            Some(_) = connections.join_next() => continue,
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be accepted");
                    sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            },
        };
        let Ok(permit) = places.clone().try_acquire_owned() else {
            let count = access.count_connection();
            // One line each time the count doubles: an attack must not fill the log.
            if count.is_power_of_two() {
                tracing::warn!(peer = %peer.ip(), count, "connection refused: {CONNECTIONS} are open");
            }
            continue;
        };
        // A connection that the kernel does not watch is still one.
        let _ = keep_alive(&stream);
        let (app, access, watcher) = (app.clone(), access.clone(), graceful.watcher());
        connections.spawn(async move {
            let _permit = permit;
            talk(app, &access, stream, peer, watcher).await;
        });
    }
    drop(listener);
    let _ = tokio::time::timeout(STOP_TIME, graceful.shutdown()).await;
    connections.shutdown().await;
    Ok(())
}

/// One connection, to its end. A client that breaks off is no fault of ours.
async fn talk(app: Router, access: &Access, stream: TcpStream, peer: SocketAddr, watcher: Watcher) {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(STALL_TIME));
    let stream = Box::pin(stream);
    match access.tls() {
        None => converse(app, stream, peer, watcher).await,
        #[cfg(feature = "tls")]
        Some(tls) => {
            if let Ok(Ok(stream)) = tokio::time::timeout(HEAD_TIME, tls.accept(stream)).await {
                converse(app, stream, peer, watcher).await;
            }
        }
        #[cfg(not(feature = "tls"))]
        Some(never) => match *never {},
    }
}

async fn converse<S>(app: Router, stream: S, peer: SocketAddr, watcher: Watcher)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = TowerToHyperService::new(app.layer(Extension(Peer(peer))));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIME)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), service);
    let _ = watcher.watch(connection).await;
}
