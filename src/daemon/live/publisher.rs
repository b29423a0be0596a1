//! Publishes results as lines at a Unix socket, and with the recorder's state as datagrams. The queue of each listener is
//! bounded: a listener that hangs loses lines, which are counted, and holds up nobody else.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::json;
use tokio::io::AsyncWriteExt;
use tokio::net::{UdpSocket, UnixStream};
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::broadcast::{Receiver, Sender};

use super::context::LiveContext;
use super::preview::Preview;
use super::state;
use crate::daemon::endpoint;
use wingd_evaluation::pipeline::live::LiveResult;
use wingd_pages::recorder::{LiveMessage, LiveResults, PreviewImage};

/// Maximum number of results that wait for a slow listener: three seconds at 20 per second.
pub(super) const MAX_WAITING: usize = 64;
/// Maximum number of listeners at a time.
const MAX_LISTENERS: usize = 32;
/// Time after which a listener that accepts nothing is disconnected.
const STALL_TIMEOUT: Duration = Duration::from_secs(30);
/// Time between two checks for lines lost by a listener.
const LOSS_CHECK_INTERVAL: Duration = Duration::from_millis(200);
/// Pause after an error of the operating system.
const RETRY_PAUSE: Duration = Duration::from_secs(2);

/// Publishes results to listeners at the socket and as datagrams.
#[derive(Clone)]
pub(crate) struct ResultPublisher {
    pub(super) messages: Sender<Arc<LiveMessage>>,
    pub(super) preview: Arc<Preview>,
    pub(super) history: Arc<Mutex<VecDeque<PastResult>>>,
    pub(super) shared: LiveContext,
}

/// Time for which results are kept for pages that are opened later, s: that of their figures.
const HISTORY_S: f64 = 180.0;

/// Values of a result for the live page's figures.
pub(super) struct PastResult {
    exposed_at_s: f64,
    /// JSON object.
    values: String,
}

impl ResultPublisher {
    /// Keeps the values of a result for pages that are opened later.
    pub(super) fn keep_result(&self, result: &LiveResult) {
        let record = &result.tracked.record;
        let exposed_at_s = result.exposure.exposure_since_boot_s;
        let values = json!({
            "number": result.number, "exposure_time": result.exposure.exposure_time, "latency_ms": result.latency_ms,
            "status": record.status, "global_test": record.global_test,
            "tip": record.tip, "torsion": record.torsion.first().as_slice(),
        })
        .to_string();
        let mut history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        let old = history.partition_point(|past| exposed_at_s - past.exposed_at_s >= HISTORY_S);
        history.drain(..old);
        history.push_back(PastResult {
            exposed_at_s,
            values,
        });
    }

    /// Serves the socket and sends the datagrams, forever.
    pub async fn serve(self) {
        let (socket, udp) = (
            self.shared.config.socket.clone(),
            self.shared.config.udp.clone(),
        );
        if let Some(to) = udp {
            tokio::spawn(send_datagrams(self.clone(), to));
        }
        tokio::spawn(state::publish_state(
            self.shared.clone(),
            self.messages.clone(),
        ));
        let Some(path) = socket else { return };
        let report = |fault: Option<String>| match fault {
            Some(what) => self.shared.set_fault("socket", &what),
            None => self.shared.clear_fault("socket"),
        };
        let client = |stream, permit| {
            let publisher = self.clone();
            let results = self.messages.subscribe();
            tokio::spawn(async move {
                let _ = publisher.serve_listener(stream, results).await;
                drop(permit);
            });
        };
        endpoint::serve_socket(&path, MAX_LISTENERS, report, client).await;
    }

    /// Sends result lines until the listener disconnects.
    async fn serve_listener(
        &self,
        mut stream: UnixStream,
        mut results: Receiver<Arc<LiveMessage>>,
    ) -> io::Result<()> {
        loop {
            match results.recv().await {
                Ok(message) if message.is_state => {}
                Ok(message) => {
                    self.send_line(&mut stream, &message.json, &mut results)
                        .await?
                }
                Err(RecvError::Lagged(lines)) => {
                    self.shared.update(|live| live.lines_lost += lines)
                }
                Err(RecvError::Closed) => return Ok(()),
            }
        }
    }

    /// Sends a line, and counts the lines that the listener loses meanwhile.
    async fn send_line(
        &self,
        write: &mut UnixStream,
        line: &str,
        results: &mut Receiver<Arc<LiveMessage>>,
    ) -> io::Result<()> {
        let whole = async {
            write.write_all(line.as_bytes()).await?;
            write.write_all(b"\n").await
        };
        tokio::pin!(whole);
        let begun = tokio::time::Instant::now();
        while begun.elapsed() < STALL_TIMEOUT {
            tokio::select! {
                done = &mut whole => return done,
                () = tokio::time::sleep(LOSS_CHECK_INTERVAL) => {}
            }
            // The queue has overflowed: the next receipt reports the number of lost lines.
            if results.len() > MAX_WAITING
                && let Err(TryRecvError::Lagged(lines)) = results.try_recv()
            {
                self.shared.update(|live| live.lines_lost += lines);
            }
        }
        Err(io::ErrorKind::TimedOut.into())
    }
}

impl LiveResults for ResultPublisher {
    fn subscribe(&self) -> Receiver<Arc<LiveMessage>> {
        self.messages.subscribe()
    }

    fn state(&self) -> String {
        state::state_json(&self.shared.core.board.snapshot())
    }

    fn history(&self) -> String {
        let now_s = self.shared.core.clock.since_boot().as_secs_f64();
        let with_age = |past: &PastResult| {
            let age_ms = 1e3 * (now_s - past.exposed_at_s);
            past.values
                .replacen('{', &format!("{{\"age_ms\":{age_ms},"), 1)
        };
        let history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        let all: Vec<_> = history.iter().map(with_age).collect();
        format!("[{}]", all.join(","))
    }

    fn newest_frame(&self) -> Option<Arc<PreviewImage>> {
        self.preview.image()
    }
}

/// Sends a datagram for each result and state.
async fn send_datagrams(publisher: ResultPublisher, to: String) {
    let mut results = publisher.messages.subscribe();
    loop {
        match resolve_address(&to).await {
            Ok((socket, address)) => {
                publisher.shared.clear_fault("udp");
                loop {
                    match results.recv().await {
                        Ok(message) => {
                            let sent = socket
                                .send_to(message.datagram.as_bytes(), address)
                                .await
                                .is_ok();
                            publisher.shared.update(|live| {
                                *(if sent {
                                    &mut live.datagrams
                                } else {
                                    &mut live.datagrams_lost
                                }) += 1;
                            });
                        }
                        Err(RecvError::Lagged(lost)) => {
                            publisher.shared.update(|live| live.datagrams_lost += lost)
                        }
                        Err(RecvError::Closed) => return,
                    }
                }
            }
            Err(error) => {
                publisher
                    .shared
                    .set_fault("udp", &format!("live.udp = \"{to}\": {error}"));
                tokio::time::sleep(RETRY_PAUSE).await;
            }
        }
    }
}

/// Resolves `host:port` and opens a UDP socket for it. The network may not know the name yet.
async fn resolve_address(to: &str) -> io::Result<(UdpSocket, std::net::SocketAddr)> {
    let found = tokio::net::lookup_host(to).await?.next();
    let address = found
        .ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "the host name has no address"))?;
    let own = if address.is_ipv4() {
        "0.0.0.0:0"
    } else {
        "[::]:0"
    };
    let socket = UdpSocket::bind(own).await?;
    socket.set_broadcast(true)?;
    Ok((socket, address))
}
