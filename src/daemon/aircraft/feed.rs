//! Receives the lines of a feed. A feed that falls silent is called again, because it cannot be distinguished from one that
//! is gone.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use super::config::{AircraftConfig, Servers};
use crate::daemon::core::Core;
use crate::daemon::status::{AircraftStatus, format_span};
use crate::daemon::tcp_keepalive::keep_alive;
use crate::store::aircraft::AircraftLine;

/// Interval at which the feed's threads check whether the daemon ends.
pub(super) const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Pause before a lost feed is called again.
const RECONNECT_PAUSE: Duration = Duration::from_secs(2);
/// Maximum length of a line of text, bytes; longer lines are cut.
const MAX_LINE_BYTES: usize = 4096;

/// State shared by the two threads of the feed.
#[derive(Clone)]
pub(super) struct FeedContext {
    pub core: Core,
    pub config: AircraftConfig,
}

impl FeedContext {
    /// Returns whether a shutdown was requested.
    pub fn is_ending(&self) -> bool {
        self.core.halt.is_ending()
    }

    /// Changes the aircraft data's part of the status.
    pub fn update(&self, f: impl FnOnce(&mut AircraftStatus)) {
        self.core.board.update(|status| f(status.aircraft.get_or_insert_default()));
    }

    /// Sets or clears the feed's fault in the status, and logs a fault once when it changes.
    pub fn set_fault(&self, fault: Option<String>) {
        let mut changed = false;
        self.update(|status| {
            changed = status.fault != fault;
            status.fault.clone_from(&fault);
        });
        if let Some(what) = fault.filter(|_| changed) {
            tracing::warn!(what, "aircraft data");
        }
    }

    fn silence_message(&self) -> String {
        format!("no line for {}", format_span(self.config.idle.as_secs_f64()))
    }
}

pub(super) type LineSender = SyncSender<AircraftLine>;

/// Receives lines until the daemon ends. A lost feed is called again; of several servers, the next one.
pub(super) fn receive_lines(shared: &FeedContext, lines: &LineSender) {
    let servers = shared.config.tcp.iter().flat_map(Servers::addresses).cycle();
    match shared.config.udp {
        Some(address) => {
            while !shared.is_ending() {
                pause_after_end(shared, &address.to_string(), receive_datagrams(shared, address, lines));
            }
        }
        None => {
            for server in servers.take_while(|_| !shared.is_ending()) {
                pause_after_end(shared, server, receive_from_server(shared, server, lines));
            }
        }
    }
}

/// Reports the error that ended a connection, then waits before the next one.
fn pause_after_end(shared: &FeedContext, place: &str, ended: std::io::Result<()>) {
    if let Err(error) = ended {
        shared.set_fault(Some(format!("{place}: {error}")));
    }
    let until = Instant::now() + RECONNECT_PAUSE;
    while Instant::now() < until && !shared.is_ending() {
        std::thread::sleep(POLL_INTERVAL);
    }
}

fn receive_datagrams(shared: &FeedContext, address: SocketAddr, lines: &LineSender) -> std::io::Result<()> {
    let socket = UdpSocket::bind(address)?;
    socket.set_read_timeout(Some(POLL_INTERVAL))?;
    let mut datagram = vec![0; 1 << 16];
    let mut last = Instant::now();
    while !shared.is_ending() {
        match socket.recv(&mut datagram) {
            Ok(length) => {
                last = Instant::now();
                forward_lines(shared, datagram.get(..length).unwrap_or_default(), lines);
            }
            Err(error) if is_timeout(&error) && last.elapsed() > shared.config.idle => {
                shared.set_fault(Some(format!("{address}: {}; check the sender", shared.silence_message())));
            }
            Err(error) if is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

fn is_timeout(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), TimedOut | WouldBlock | Interrupted)
}

/// Connects to the first address of the host name that answers.
fn connect_to_server(server: &str) -> std::io::Result<TcpStream> {
    let mut failed = std::io::Error::other("the host name has no address; check tcp");
    for address in server.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, RECONNECT_PAUSE) {
            Ok(stream) => return Ok(stream),
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

/// Receives lines from a server until it closes the connection or falls silent.
fn receive_from_server(shared: &FeedContext, server: &str, lines: &LineSender) -> std::io::Result<()> {
    let mut stream = connect_to_server(server)?;
    keep_alive(&stream)?;
    stream.set_read_timeout(Some(POLL_INTERVAL))?;
    stream.set_write_timeout(Some(RECONNECT_PAUSE))?;
    for line in &shared.config.subscribe {
        stream.write_all(format!("{line}\r\n").as_bytes())?;
    }
    let (mut pending, mut bytes, mut last) = (Vec::new(), [0; 4096], Instant::now());
    while !shared.is_ending() {
        match stream.read(&mut bytes) {
            Ok(0) => return Err(std::io::Error::other("the server closed the connection; connecting again")),
            Ok(length) => {
                last = Instant::now();
                pending.extend_from_slice(bytes.get(..length).unwrap_or_default());
                let end = pending.iter().rposition(|b| *b == b'\n').map(|at| at + 1);
                let end = end.or((pending.len() > MAX_LINE_BYTES).then_some(pending.len()));
                let whole: Vec<u8> = pending.drain(..end.unwrap_or(0)).collect();
                forward_lines(shared, &whole, lines);
            }
            Err(error) if is_timeout(&error) && last.elapsed() > shared.config.idle => {
                return Err(std::io::Error::other(format!("{}; connecting again", shared.silence_message())));
            }
            Err(error) if is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Forwards the received lines; lines for which the queue has no space are counted as lost.
fn forward_lines(shared: &FeedContext, bytes: &[u8], lines: &LineSender) {
    let at = shared.core.clock.stamp();
    for line in bytes.split(|b| *b == b'\n') {
        let text = String::from_utf8_lossy(line.get(..MAX_LINE_BYTES).unwrap_or(line));
        let text = text.trim_end_matches(['\r', '\0']);
        if text.is_empty() {
            continue;
        }
        let sent = lines.try_send(AircraftLine { at: Some(at.clone()), line: text.to_owned() });
        shared.update(|status| {
            status.lost += u64::from(sent.is_err());
            status.last = Some(at.clone());
        });
    }
}
