//! A feed's lines are heard and handed on, whatever the other side does.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use super::config::AircraftConfig;
use crate::daemon::core::Core;
use crate::daemon::status::AircraftStatus;
use crate::store::aircraft::AircraftLine;

/// How often the feed's threads look whether they are to end.
pub(super) const LOOK: Duration = Duration::from_millis(200);
/// Before a feed that is gone is called again.
const AGAIN: Duration = Duration::from_secs(2);
/// A line of text that does not end is cut here, bytes.
const LONGEST_LINE: usize = 4096;

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

    pub fn fault(&self, what: Option<String>) {
        if let Some(what) = &what {
            tracing::warn!(what, "aircraft data");
        }
        self.update(|status| status.fault = what);
    }
}

pub(super) type Lines = SyncSender<AircraftLine>;

/// Hears lines until the feed is over, and calls again where the feed is gone.
pub(super) fn hear(shared: &Shared, lines: &Lines) {
    while !shared.over() {
        let heard = match (&shared.config.udp, &shared.config.tcp) {
            (Some(address), _) => hear_datagrams(shared, *address, lines),
            (None, Some(server)) => hear_server(shared, server, lines),
            (None, None) => return,
        };
        if let Err(error) = heard {
            let place = shared.config.udp.map(|a| a.to_string()).or(shared.config.tcp.clone());
            shared.fault(Some(format!("{}: {error}", place.unwrap_or_default())));
        }
        let until = Instant::now() + AGAIN;
        while Instant::now() < until && !shared.over() {
            std::thread::sleep(LOOK);
        }
    }
}

fn hear_datagrams(shared: &Shared, address: SocketAddr, lines: &Lines) -> std::io::Result<()> {
    let socket = UdpSocket::bind(address)?;
    socket.set_read_timeout(Some(LOOK))?;
    let mut datagram = vec![0; 1 << 16];
    while !shared.over() {
        match socket.recv(&mut datagram) {
            Ok(length) => take(shared, datagram.get(..length).unwrap_or_default(), lines),
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

fn hear_server(shared: &Shared, server: &str, lines: &Lines) -> std::io::Result<()> {
    let unknown = || std::io::Error::other("the host's name is not known");
    let address = server.to_socket_addrs()?.next().ok_or_else(unknown)?;
    let mut stream = TcpStream::connect_timeout(&address, AGAIN)?;
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(AGAIN))?;
    for line in &shared.config.subscribe {
        stream.write_all(format!("{line}\r\n").as_bytes())?;
    }
    let (mut pending, mut bytes) = (Vec::new(), [0; 4096]);
    while !shared.over() {
        match stream.read(&mut bytes) {
            Ok(0) => return Err(std::io::Error::other("the server closed the connection")),
            Ok(length) => {
                pending.extend_from_slice(bytes.get(..length).unwrap_or_default());
                let end = pending.iter().rposition(|b| *b == b'\n').map(|at| at + 1);
                let end = end.or((pending.len() > LONGEST_LINE).then_some(pending.len()));
                let whole: Vec<u8> = pending.drain(..end.unwrap_or(0)).collect();
                take(shared, &whole, lines);
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
        let text = String::from_utf8_lossy(line.get(..LONGEST_LINE).unwrap_or(line));
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
