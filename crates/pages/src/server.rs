//! HTTP server: accepts connections, with limits on their number and duration, and shuts down gracefully.

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
use wingd_base::tcp_keepalive::keep_alive;

/// Maximum number of open connections: enough for forty browsers with six each.
const MAX_CONNECTIONS: usize = 256;
/// Timeout for a request's head, and for the next request on an open connection.
const HEAD_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout for a client that accepts no bytes.
const WRITE_TIMEOUT: Duration = Duration::from_secs(30);
/// Timeout for responses in progress when the server stops; the whole shutdown stays below 5 s.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);
/// Buffer of the kernel for each connection, bytes: it counts as memory of the service.
const SEND_BUFFER_BYTES: usize = 64 * 1024;
/// Pause after a failed accept, for example when file descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Maximum size of a request's head, bytes.
const MAX_HEAD_BYTES: usize = 16 * 1024;

/// Accepts connections until `shutdown` completes.
pub async fn accept_connections(
    app: Router,
    access: Arc<Access>,
    listener: TcpListener,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
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
                    tracing::warn!(%error, "could not accept a connection");
                    sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            },
        };
        let Ok(permit) = places.clone().try_acquire_owned() else {
            let count = access.count_connection();
            // One line each time the count doubles: an attack must not fill the log.
            if count.is_power_of_two() {
                tracing::warn!(peer = %peer.ip(), count, "connection refused: {MAX_CONNECTIONS} are open");
            }
            continue;
        };
        // A connection without TCP keepalive or with another buffer still works.
        let _ = keep_alive(&stream);
        let _ = socket2::SockRef::from(&stream).set_send_buffer_size(SEND_BUFFER_BYTES);
        let (app, access, watcher) = (app.clone(), access.clone(), graceful.watcher());
        connections.spawn(async move {
            let _permit = permit;
            serve_connection(app, &access, stream, peer, watcher).await;
        });
    }
    drop(listener);
    let _ = tokio::time::timeout(STOP_TIMEOUT, graceful.shutdown()).await;
    connections.shutdown().await;
    Ok(())
}

/// Serves one connection to its end. A client that disconnects is not an error.
async fn serve_connection(
    app: Router,
    access: &Access,
    stream: TcpStream,
    peer: SocketAddr,
    watcher: Watcher,
) {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(WRITE_TIMEOUT));
    let stream = Box::pin(stream);
    match access.tls() {
        None => serve_http1_stream(app, stream, peer, watcher).await,
        #[cfg(feature = "tls")]
        Some(tls) => {
            if let Ok(Ok(stream)) = tokio::time::timeout(HEAD_TIMEOUT, tls.accept(stream)).await {
                serve_http1_stream(app, stream, peer, watcher).await;
            }
        }
        #[cfg(not(feature = "tls"))]
        Some(never) => match *never {},
    }
}

async fn serve_http1_stream<S>(app: Router, stream: S, peer: SocketAddr, watcher: Watcher)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = TowerToHyperService::new(app.layer(Extension(Peer(peer))));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIMEOUT)
        .max_buf_size(MAX_HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), service);
    let _ = watcher.watch(connection).await;
}
