//! Results and the recorder's state go to whoever listens, as lines at a Unix socket and as datagrams. A listener that hangs loses its lines, which
//! are counted, and stops nobody: what waits for it is bounded.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use base64::Engine;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UdpSocket, UnixListener, UnixStream};
use tokio::sync::Semaphore;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::broadcast::{Receiver, Sender};

use super::preview::Preview;
use super::result::Given;
use super::shared::Shared;
use super::state;
use crate::daemon::endpoint;

/// Results that wait for a slow listener: three seconds at 20 a second.
pub(super) const WAITING: usize = 64;
/// Listeners at a time.
const LISTENERS: usize = 32;
/// A listener that takes nothing for so long is gone.
const STALL: Duration = Duration::from_secs(30);
/// How often what a listener loses is looked at.
const LOOK: Duration = Duration::from_millis(200);
/// After an error of the machine.
const PAUSE: Duration = Duration::from_secs(2);
/// A longer line is no command.
const MAX_LINE: u64 = 64;

/// Where results are heard.
#[derive(Clone)]
pub(crate) struct Tap {
    pub(super) given: Sender<Arc<Given>>,
    pub(super) preview: Arc<Preview>,
    pub(super) shared: Shared,
}

impl Tap {
    /// The socket and the datagrams, for ever.
    pub async fn serve(self) {
        let (socket, udp) = (self.shared.config.socket.clone(), self.shared.config.udp.clone());
        if let Some(to) = udp {
            tokio::spawn(send(self.clone(), to));
        }
        tokio::spawn(state::tell(self.shared.clone(), self.given.clone()));
        let Some(path) = socket else { return };
        match endpoint::listen(&path) {
            Ok(listener) => self.accept(listener).await,
            Err(error) => self.shared.fault("socket", &format!("{}: {error}", path.display())),
        }
    }

    async fn accept(self, listener: UnixListener) {
        let places = Arc::new(Semaphore::new(LISTENERS));
        let client = |stream| {
            // One too many is let go at once.
            let Ok(permit) = places.clone().try_acquire_owned() else { return };
            let tap = self.clone();
            let results = self.given.subscribe();
            tokio::spawn(async move {
                let _ = tap.talk(stream, results).await;
                drop(permit);
            });
        };
        endpoint::accept(listener, client).await;
    }

    /// Lines until the listener goes; asked for the frame it gets that, too, and the state from when it asks for it.
    async fn talk(&self, stream: UnixStream, mut results: Receiver<Arc<Given>>) -> io::Result<()> {
        let (read, mut write) = stream.into_split();
        let (asked, mut asks) = tokio::sync::mpsc::channel(1);
        let listening = tokio::spawn(hear(read, asked));
        let end = async {
            let mut states = false;
            loop {
                let line = tokio::select! {
                    result = results.recv() => match result {
                        Ok(given) if given.state && !states => continue,
                        Ok(given) => given.line.clone(),
                        Err(RecvError::Lagged(lines)) => {
                            self.shared.update(|live| live.lines_lost += lines);
                            continue;
                        }
                        Err(RecvError::Closed) => return Ok(()),
                    },
                    Some(wish) = asks.recv() => match wish {
                        Wish::State => {
                            states = true;
                            state::line(&self.shared.core.board.snapshot())
                        }
                        Wish::Frame => match self.frame().await {
                            Some(line) => line,
                            None => continue,
                        },
                    },
                };
                self.say(&mut write, &line, &mut results).await?;
            }
        };
        let ended = end.await;
        listening.abort();
        ended
    }

    /// While a listener takes nothing, what it loses is counted.
    async fn say(
        &self,
        write: &mut OwnedWriteHalf,
        line: &str,
        results: &mut Receiver<Arc<Given>>,
    ) -> io::Result<()> {
        let whole = async {
            write.write_all(line.as_bytes()).await?;
            write.write_all(b"\n").await
        };
        tokio::pin!(whole);
        let begun = tokio::time::Instant::now();
        while begun.elapsed() < STALL {
            tokio::select! {
                done = &mut whole => return done,
                () = tokio::time::sleep(LOOK) => {}
            }
            // More than are kept: the next answer is how many are gone.
            if results.len() > WAITING
                && let Err(TryRecvError::Lagged(lines)) = results.try_recv()
            {
                self.shared.update(|live| live.lines_lost += lines);
            }
        }
        Err(io::ErrorKind::TimedOut.into())
    }

    async fn frame(&self) -> Option<String> {
        let preview = self.preview.clone();
        let picture = tokio::task::spawn_blocking(move || preview.newest()).await.ok()??;
        let jpeg = base64::engine::general_purpose::STANDARD.encode(&picture.jpeg);
        let (width, height) = picture.size;
        Some(
            serde_json::json!({ "frame": picture.number, "width": width, "height": height, "jpeg": jpeg })
                .to_string(),
        )
    }
}

/// What a listener may ask for, by a line with this word.
enum Wish {
    /// One picture.
    Frame,
    /// The state, now and from now on.
    State,
}

/// A listener's wishes; ends with it.
async fn hear(read: OwnedReadHalf, asked: tokio::sync::mpsc::Sender<Wish>) {
    let mut reader = BufReader::new(read);
    loop {
        let mut line = String::new();
        match (&mut reader).take(MAX_LINE).read_line(&mut line).await {
            Ok(0) | Err(_) => return,
            Ok(_) => {
                let wish = match line.trim() {
                    "frame" => Wish::Frame,
                    "state" => Wish::State,
                    _ => continue,
                };
                let _ = asked.try_send(wish);
            }
        }
    }
}

/// A datagram for each result.
async fn send(tap: Tap, to: String) {
    let mut results = tap.given.subscribe();
    loop {
        match address(&to).await {
            Ok((socket, address)) => {
                tap.shared.clear("udp");
                loop {
                    match results.recv().await {
                        Ok(given) => {
                            let sent = socket.send_to(given.datagram.as_bytes(), address).await.is_ok();
                            tap.shared.update(|live| {
                                *(if sent { &mut live.datagrams } else { &mut live.datagrams_lost }) += 1;
                            });
                        }
                        Err(RecvError::Lagged(lost)) => tap.shared.update(|live| live.datagrams_lost += lost),
                        Err(RecvError::Closed) => return,
                    }
                }
            }
            Err(error) => {
                tap.shared.fault("udp", &format!("live.udp = \"{to}\": {error}"));
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}

/// The name may be one that the network does not know yet.
async fn address(to: &str) -> io::Result<(UdpSocket, std::net::SocketAddr)> {
    let found = tokio::net::lookup_host(to).await?.next();
    let address = found.ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "the name has no address"))?;
    let own = if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let socket = UdpSocket::bind(own).await?;
    socket.set_broadcast(true)?;
    Ok((socket, address))
}
