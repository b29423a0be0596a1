//! Receives the lines of a feed. A feed that falls silent is called again, because it cannot be distinguished from one that
//! is gone.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use super::config::AircraftConfig;
use crate::daemon::budget::RateBudget;
use crate::daemon::core::{Core, SERIES_NICE, lower_priority};
use crate::daemon::status::{AIRCRAFT_PART, AircraftStatus, format_span};
use wingd_base::tcp_keepalive::keep_alive;
use wingd_evaluation::aircraft::Layout;
use wingd_store::aircraft::AircraftLine;

/// Interval at which the feed's threads check whether the daemon ends.
pub(super) const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Pause before a lost feed is called again.
const RECONNECT_PAUSE: Duration = Duration::from_secs(2);
/// Maximum length of a line of text, bytes; longer lines are cut.
const MAX_LINE_BYTES: usize = 4096;

/// Bytes of recorded lines per second, over a long time: ten feeds at 10 Hz.
const MAX_BYTES_PER_S: f64 = 60e3;
/// Bytes of recorded lines in a burst.
const MAX_BURST_BYTES: f64 = 600e3;
/// Share of the burst that is for lines that can be parsed: those that cannot do not displace them.
const SHARE_FOR_READABLE: f64 = 0.5;
/// Bytes that the store adds to each line.
const LINE_OVERHEAD_BYTES: usize = 150;

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
    pub fn update<T>(&self, f: impl FnOnce(&mut AircraftStatus) -> T) -> T {
        self.core
            .board
            .update(|status| f(status.aircraft.get_or_insert_default()))
    }

    /// Sets or clears the feed's fault in the status.
    pub fn set_fault(&self, fault: Option<String>) {
        self.update(|_| ());
        self.core.board.set_fault(AIRCRAFT_PART, fault);
    }

    /// Returns an error if there was no line for the configured time.
    fn check_idle(&self, last: Instant) -> std::io::Result<()> {
        if last.elapsed() <= self.config.idle {
            return Ok(());
        }
        let silent = format_span(self.config.idle.as_secs_f64());
        Err(std::io::Error::other(format!(
            "no line for {silent}; check the sender"
        )))
    }
}

/// Receiver of a feed's lines, with the budget of the recorded lines.
pub(super) struct LineIntake {
    shared: FeedContext,
    lines: SyncSender<AircraftLine>,
    layout: Layout,
    budget: RateBudget,
}

impl LineIntake {
    /// Creates a receiver that passes lines on to `lines`.
    pub fn new(shared: FeedContext, lines: SyncSender<AircraftLine>) -> Self {
        let layout = shared.config.layout();
        Self {
            shared,
            lines,
            layout,
            budget: RateBudget::new(MAX_BYTES_PER_S, MAX_BURST_BYTES),
        }
    }

    /// Receives lines until the daemon ends. A lost feed is called again.
    pub fn run(mut self) {
        // A flood must not take the processor from live solving.
        lower_priority(SERIES_NICE);
        let shared = self.shared.clone();
        if let Some(address) = shared.config.udp {
            while !shared.is_ending() {
                let ended = self.receive_datagrams(address);
                pause_after_end(&shared, &address.to_string(), ended);
            }
        }
        if let Some(server) = &shared.config.tcp {
            while !shared.is_ending() {
                let ended = self.receive_from_server(server);
                pause_after_end(&shared, server, ended);
            }
        }
    }

    /// Receives datagrams of the configured senders.
    fn receive_datagrams(&mut self, address: SocketAddr) -> std::io::Result<()> {
        let socket = UdpSocket::bind(address)?;
        socket.set_read_timeout(Some(POLL_INTERVAL))?;
        let mut datagram = vec![0; 1 << 16];
        let mut last = Instant::now();
        while !self.shared.is_ending() {
            match socket.recv_from(&mut datagram) {
                Ok((length, from)) => {
                    let senders = &self.shared.config.senders;
                    let expected = senders.is_empty() || senders.contains(&from.ip());
                    if expected && self.forward_lines(datagram.get(..length).unwrap_or_default()) {
                        last = Instant::now();
                    }
                }
                Err(error) if is_timeout(&error) => {}
                Err(error) => return Err(error),
            }
            if let Err(silent) = self.shared.check_idle(last) {
                self.shared.set_fault(Some(format!("{address}: {silent}")));
            }
        }
        Ok(())
    }

    /// Receives lines from a server until it closes the connection or sends no line.
    fn receive_from_server(&mut self, server: &str) -> std::io::Result<()> {
        let mut stream = connect_to_server(server)?;
        keep_alive(&stream)?;
        stream.set_read_timeout(Some(POLL_INTERVAL))?;
        stream.set_write_timeout(Some(RECONNECT_PAUSE))?;
        for line in &self.shared.config.subscribe {
            stream.write_all(format!("{line}\r\n").as_bytes())?;
        }
        let (mut pending, mut bytes, mut last) = (Vec::new(), [0; 4096], Instant::now());
        while !self.shared.is_ending() {
            match stream.read(&mut bytes) {
                Ok(0) => {
                    return Err(std::io::Error::other(
                        "the server closed the connection; connecting again",
                    ));
                }
                Ok(length) => {
                    pending.extend_from_slice(bytes.get(..length).unwrap_or_default());
                    let end = pending.iter().rposition(|b| *b == b'\n').map(|at| at + 1);
                    let end = end.or((pending.len() > MAX_LINE_BYTES).then_some(pending.len()));
                    let whole: Vec<u8> = pending.drain(..end.unwrap_or(0)).collect();
                    if self.forward_lines(&whole) {
                        last = Instant::now();
                    }
                }
                Err(error) if is_timeout(&error) => {}
                Err(error) => return Err(error),
            }
            self.shared.check_idle(last)?;
        }
        Ok(())
    }

    /// Forwards the received lines; returns whether there was one. Lines beyond the budget, or for which the queue has no
    /// space, are counted as lost.
    fn forward_lines(&mut self, bytes: &[u8]) -> bool {
        let at = self.shared.core.clock.stamp();
        let (mut any, mut lost) = (false, 0);
        for line in bytes.split(|b| *b == b'\n') {
            let text = String::from_utf8_lossy(line.get(..MAX_LINE_BYTES).unwrap_or(line));
            let text = text.trim_end_matches(['\r', '\0']);
            if text.is_empty() {
                continue;
            }
            any = true;
            let floor = if self.layout.read(text).is_some() {
                0.0
            } else {
                SHARE_FOR_READABLE
            };
            let sent = self.budget.take(
                (text.len() + LINE_OVERHEAD_BYTES) as f64,
                floor,
                at.since_boot_s,
            ) && self
                .lines
                .try_send(AircraftLine {
                    at: Some(at.clone()),
                    line: text.to_owned(),
                })
                .is_ok();
            lost += u64::from(!sent);
        }
        if any {
            self.shared.update(|status| {
                status.lost += lost;
                status.last = Some(at);
            });
        }
        any
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
