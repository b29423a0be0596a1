//! A feed's lines are heard and handed on, whatever the other side does. One that falls silent is called again: nobody can tell
//! it from one that is gone.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use super::config::{AircraftConfig, Servers};
use crate::daemon::core::Core;
use crate::daemon::status::{AircraftStatus, span};
use crate::daemon::tcp_keepalive::keep_alive;
use crate::store::aircraft::AircraftLine;

/// How often the feed's threads look whether they are to end.
pub(super) const LOOK: Duration = Duration::from_millis(200);
/// Before a feed that is gone is called again.
const AGAIN: Duration = Duration::from_secs(2);
/// A line of text that does not end is cut here, bytes.
const MAX_LINE_BYTES: usize = 4096;

/// What the two threads of the feed share.
#[derive(Clone)]
pub(super) struct Shared {
    pub core: Core,
    pub config: AircraftConfig,
}

impl Shared {
    pub fn over(&self) -> bool {
        self.core.halt.ending()
    }

    pub fn update(&self, f: impl FnOnce(&mut AircraftStatus)) {
        self.core.board.update(|status| f(status.aircraft.get_or_insert_default()));
    }

    /// What is wrong from now on; said once.
    pub fn fault(&self, what: Option<String>) {
        let mut news = false;
        self.update(|status| {
            news = status.fault != what;
            status.fault.clone_from(&what);
        });
        if let Some(what) = what.filter(|_| news) {
            tracing::warn!(what, "aircraft data");
        }
    }

    fn silence(&self) -> String {
        format!("no line for {}", span(self.config.idle.as_secs_f64()))
    }
}

pub(super) type Lines = SyncSender<AircraftLine>;

/// Hears lines until the feed is over, and calls again where the feed is gone: of several servers the next.
pub(super) fn hear(shared: &Shared, lines: &Lines) {
    let servers = shared.config.tcp.iter().flat_map(Servers::places).cycle();
    match shared.config.udp {
        Some(address) => {
            while !shared.over() {
                heard(shared, &address.to_string(), hear_datagrams(shared, address, lines));
            }
        }
        None => {
            for server in servers.take_while(|_| !shared.over()) {
                heard(shared, server, hear_server(shared, server, lines));
            }
        }
    }
}

/// Why it ended is said; then a pause.
fn heard(shared: &Shared, place: &str, ended: std::io::Result<()>) {
    if let Err(error) = ended {
        shared.fault(Some(format!("{place}: {error}")));
    }
    let until = Instant::now() + AGAIN;
    while Instant::now() < until && !shared.over() {
        std::thread::sleep(LOOK);
    }
}

fn hear_datagrams(shared: &Shared, address: SocketAddr, lines: &Lines) -> std::io::Result<()> {
    let socket = UdpSocket::bind(address)?;
    socket.set_read_timeout(Some(LOOK))?;
    let mut datagram = vec![0; 1 << 16];
    let mut last = Instant::now();
    while !shared.over() {
        match socket.recv(&mut datagram) {
            Ok(length) => {
                last = Instant::now();
                take(shared, datagram.get(..length).unwrap_or_default(), lines);
            }
            Err(error) if is_silence(&error) && last.elapsed() > shared.config.idle => {
                shared.fault(Some(format!("{address}: {}", shared.silence())));
            }
            Err(error) if is_silence(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

fn is_silence(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), TimedOut | WouldBlock | Interrupted)
}

/// The first of the name's addresses that answers.
fn connect(server: &str) -> std::io::Result<TcpStream> {
    let mut failed = std::io::Error::other("the host's name is not known");
    for address in server.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, AGAIN) {
            Ok(stream) => return Ok(stream),
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

/// Until the server goes, or falls silent.
fn hear_server(shared: &Shared, server: &str, lines: &Lines) -> std::io::Result<()> {
    let mut stream = connect(server)?;
    keep_alive(&stream)?;
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(AGAIN))?;
    for line in &shared.config.subscribe {
        stream.write_all(format!("{line}\r\n").as_bytes())?;
    }
    let (mut pending, mut bytes, mut last) = (Vec::new(), [0; 4096], Instant::now());
    while !shared.over() {
        match stream.read(&mut bytes) {
            Ok(0) => return Err(std::io::Error::other("the server closed the connection")),
            Ok(length) => {
                last = Instant::now();
                pending.extend_from_slice(bytes.get(..length).unwrap_or_default());
                let end = pending.iter().rposition(|b| *b == b'\n').map(|at| at + 1);
                let end = end.or((pending.len() > MAX_LINE_BYTES).then_some(pending.len()));
                let whole: Vec<u8> = pending.drain(..end.unwrap_or(0)).collect();
                take(shared, &whole, lines);
            }
            Err(error) if is_silence(&error) && last.elapsed() > shared.config.idle => {
                return Err(std::io::Error::other(format!("{}; it is called again", shared.silence())));
            }
            Err(error) if is_silence(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Hands on what came; what finds no place is counted.
fn take(shared: &Shared, bytes: &[u8], lines: &Lines) {
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
