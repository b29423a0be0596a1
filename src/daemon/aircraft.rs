//! The aircraft's data while it flies: a feed is listened to and its lines are recorded. Nothing here can stop capturing: a
//! feed that hangs, floods or is gone, and a disk that is full, cost its lines, which are counted.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::halt::Halt;
use super::status::Board;
use crate::aircraft::{Column, Kind, Layout};
use crate::clock::{Clock, Stamp};
use crate::store::Store;
use crate::store::aircraft::AircraftLine;

/// Lines that may wait to be recorded: a minute of ten feeds of 10 Hz.
const WAITING: usize = 6000;
/// A line is durable at most this long after it came.
const FLUSH: Duration = Duration::from_secs(2);
/// How often a listener looks whether it is to end.
const LOOK: Duration = Duration::from_millis(200);
/// Before a feed that is gone is called again.
const AGAIN: Duration = Duration::from_secs(2);
/// A line of text that does not end is cut here, bytes.
const LONGEST_LINE: usize = 4096;
/// What the end of the recorder waits for the last lines.
const LAST_LINES: Duration = Duration::from_secs(3);

/// `[live.aircraft_data]` of the configuration: where the lines come from, and what stands in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AircraftConfig {
    /// Datagrams to this address and port of ours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub udp: Option<SocketAddr>,
    /// Or a server that sends lines: `host:port`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tcp: Option<String>,
    /// Said to that server once it is connected, a line each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub subscribe: Vec<String>,
    /// `iwg1` or `text`.
    #[serde(default)]
    pub format: Kind,
    /// Of text: lines without this first field are recorded and not read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begins_with: Option<String>,
    /// Of text: between the fields.
    #[serde(default = "comma")]
    pub separator: char,
    /// Of text: the time tag's field, from 1.
    #[serde(default = "first")]
    pub time_field: usize,
    /// Fields that are taken; of IWG1 the platform's own, from 34.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub column: Vec<Column>,
}

fn comma() -> char {
    ','
}

fn first() -> usize {
    1
}

impl AircraftConfig {
    /// Every fault, as `key: what; how to mend it`.
    pub fn faults(&self) -> Vec<String> {
        let mut faults = Vec::new();
        let mut fault = |key: &str, what: &str| faults.push(format!("live.aircraft_data.{key}: {what}"));
        match (&self.udp, &self.tcp) {
            (Some(_), Some(_)) => fault("tcp", "is given beside udp; give one of the two"),
            (None, None) => fault("udp", "is missing; give udp = \"0.0.0.0:7071\" or tcp = \"host:port\""),
            (None, Some(host))
                if host.rsplit_once(':').is_none_or(|(_, port)| port.parse::<u16>().is_err()) =>
            {
                fault("tcp", "is no host and port; write it as \"192.168.1.20:4711\"");
            }
            _ => {}
        }
        if self.tcp.is_none() && !self.subscribe.is_empty() {
            fault("subscribe", "is for tcp; leave it out with udp");
        }
        if self.time_field == 0 || self.column.iter().any(|c| c.field == 0) {
            fault("column", "counts fields from 0; count from 1");
        }
        if self.format == Kind::Text && self.column.is_empty() {
            fault("column", "is missing; say which field of the text is which quantity");
        }
        if self.format == Kind::Iwg1 && self.column.iter().any(|c| c.field <= 2) {
            fault("column", "takes IWG1's keyword or time; a platform's own fields begin at 34");
        }
        if self.column.iter().any(|c| !(c.scale.is_finite() && c.scale != 0.0 && c.offset.is_finite())) {
            fault("column", "has a scale of 0 or no number; give finite numbers");
        }
        faults
    }

    /// Where the fields stand.
    pub fn layout(&self) -> Layout {
        match self.format {
            Kind::Iwg1 => Layout::iwg1(&self.column),
            Kind::Text => Layout {
                begins_with: self.begins_with.clone(),
                ..Layout::text(self.separator, self.time_field, self.column.clone())
            },
        }
    }
}

/// The feed as the status shows it.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct AircraftStatus {
    /// Lines recorded.
    pub recorded: u64,
    /// Of those, lines that could be read.
    pub read: u64,
    /// Lines that came and were not recorded: too many at once, or a full disk.
    pub lost: u64,
    /// When the last one came.
    pub last: Option<Stamp>,
    /// What is wrong with the feed now; `null` where nothing is.
    pub fault: Option<String>,
}

/// What its two threads share.
#[derive(Clone)]
struct Shared {
    config: AircraftConfig,
    clock: Arc<dyn Clock>,
    board: Board,
    halt: Halt,
    over: Arc<AtomicBool>,
}

impl Shared {
    fn over(&self) -> bool {
        self.over.load(Ordering::Relaxed) || self.halt.ending()
    }

    fn update(&self, f: impl FnOnce(&mut AircraftStatus)) {
        self.board.update(|status| f(status.aircraft.get_or_insert_default()));
    }

    fn fault(&self, what: Option<String>) {
        if let Some(what) = &what {
            tracing::warn!(what, "aircraft data");
        }
        self.update(|status| status.fault = what);
    }
}

/// The feed of a running recorder.
pub(crate) struct Feed {
    over: Arc<AtomicBool>,
    ended: Receiver<()>,
}

impl Drop for Feed {
    /// The last lines become durable, in a time that is bounded.
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let _ = self.ended.recv_timeout(LAST_LINES);
    }
}

/// Listens and records until it is dropped. Where the machine gives no threads the status says so.
pub(crate) fn listen(
    config: &AircraftConfig,
    store: &Arc<Store>,
    clock: &Arc<dyn Clock>,
    board: &Board,
    halt: &Halt,
) -> Feed {
    let over = Arc::new(AtomicBool::new(false));
    let (config, clock, board, halt) = (config.clone(), clock.clone(), board.clone(), halt.clone());
    let shared = Shared { config, clock, board, halt, over: over.clone() };
    let (lines, inbox) = sync_channel(WAITING);
    let (done, ended) = channel();
    let (hearing, store) = (shared.clone(), store.clone());
    let recording = shared.clone();
    let hear =
        std::thread::Builder::new().name("aircraft-feed".to_owned()).spawn(move || hear(&hearing, &lines));
    let record = std::thread::Builder::new().name("aircraft-store".to_owned()).spawn(move || {
        record(&recording, &store, &inbox);
        let _ = done.send(());
    });
    if let Some(error) = hear.err().or(record.err()) {
        shared.fault(Some(format!("no thread to listen on: {error}")));
    }
    Feed { over, ended }
}

type Lines = SyncSender<AircraftLine>;

fn hear(shared: &Shared, lines: &Lines) {
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

/// Hands on what came; what finds no room is counted.
fn take(shared: &Shared, bytes: &[u8], lines: &Lines) {
    let at = shared.clock.stamp();
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

/// Writes what has come, every two seconds, and the rest at the end.
fn record(shared: &Shared, store: &Store, inbox: &Receiver<AircraftLine>) {
    let layout = shared.config.layout();
    let (udp, tcp) = (&shared.config.udp, &shared.config.tcp);
    let source = serde_json::json!({"udp": udp, "tcp": tcp, "layout": layout});
    let mut waiting: Vec<AircraftLine> = Vec::new();
    let mut flushed = Instant::now();
    loop {
        let heard = inbox.recv_timeout(LOOK);
        let gone = matches!(heard, Err(RecvTimeoutError::Disconnected));
        waiting.extend(heard);
        waiting.extend(inbox.try_iter().take(WAITING));
        let ending = gone || shared.over();
        // The power may be about to go.
        if ending || shared.halt.wanted() || flushed.elapsed() >= FLUSH {
            flush(shared, store, (&layout, &source), &mut waiting);
            flushed = Instant::now();
        }
        if ending {
            break;
        }
    }
    if let Err(error) = store.close_aircraft() {
        shared.fault(Some(error.to_string()));
    }
}

fn flush(
    shared: &Shared,
    store: &Store,
    (layout, source): (&Layout, &serde_json::Value),
    waiting: &mut Vec<AircraftLine>,
) {
    if waiting.is_empty() {
        return;
    }
    let read = waiting.iter().filter(|line| layout.read(&line.line).is_some()).count() as u64;
    let count = waiting.len() as u64;
    match store.add_aircraft(source, waiting) {
        Ok(true) => {
            waiting.clear();
            shared.update(|status| {
                status.recorded += count;
                status.read += read;
                status.fault =
                    (read == 0).then(|| "lines come and none can be read; look at format".to_owned());
            });
        }
        // The first series begins the flight that they belong to.
        Ok(false) => {
            let over = waiting.len().saturating_sub(WAITING);
            waiting.drain(..over);
            shared.update(|status| status.lost += over as u64);
        }
        Err(error) => {
            waiting.clear();
            shared.update(|status| status.lost += count);
            shared.fault(Some(error.to_string()));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    use crate::clock::System;
    use crate::store::manifest::{Cause, State};
    use crate::store::{Plan, RealDisk, StoreConfig, catalogue, verify};

    struct Bench {
        dir: tempfile::TempDir,
        store: Arc<Store>,
        clock: Arc<dyn Clock>,
        board: Board,
    }

    /// A store with a flight, and `reserve_mb` to be kept free.
    fn bench(reserve_mb: u64) -> Bench {
        let dir = tempfile::tempdir().unwrap();
        let config = |reserve_mb| StoreConfig { reserve_mb, ..StoreConfig::at(dir.path()) };
        let clock: Arc<dyn Clock> = Arc::new(System::new());
        let (store, _) = Store::open(Arc::new(RealDisk), config(0)).unwrap();
        let (series, _) =
            store.begin_series(Plan { cause: Cause::Scheduled, shots: 1 }, &clock.stamp()).unwrap();
        store.close_series(series, State::Interrupted, &clock.stamp(), vec![]).unwrap();
        drop(store);
        let store = Arc::new(Store::open(Arc::new(RealDisk), config(reserve_mb)).unwrap().0);
        let board = Board::new(clock.clone());
        Bench { dir, store, clock, board }
    }

    impl Bench {
        fn listen(&self, config: &str) -> Feed {
            let config: AircraftConfig = toml::from_str(config).unwrap();
            listen(&config, &self.store, &self.clock, &self.board, &Halt::default())
        }

        /// Waits, for a machine that is slow, until the status is as wanted.
        fn until(&self, wanted: impl Fn(&AircraftStatus) -> bool) -> AircraftStatus {
            for _ in 0..600 {
                let status = self.board.snapshot().aircraft.unwrap_or_default();
                if wanted(&status) {
                    return status;
                }
                std::thread::sleep(Duration::from_millis(50));
            }
            self.board.snapshot().aircraft.unwrap_or_default()
        }
    }

    /// A port that nobody has.
    fn free_port() -> u16 {
        UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
    }

    fn send(port: u16, count: usize) {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        for k in 0..count {
            let line = format!("IWG1,2026-03-01T06:00:{:02}.{k:03},1,2\r\nnoise\r\n", k % 60);
            socket.send_to(line.as_bytes(), ("127.0.0.1", port)).unwrap();
        }
    }

    #[test]
    fn datagrams_are_recorded_and_covered_at_the_end() {
        let bench = bench(0);
        let port = free_port();
        let feed = bench.listen(&format!("udp = '127.0.0.1:{port}'"));
        // The socket may not be bound yet: nobody promises a datagram's arrival.
        let status = bench.until(|status| {
            send(port, 5);
            status.recorded >= 20
        });
        assert!(status.recorded >= 20 && status.lost == 0 && status.fault.is_none(), "{status:?}");
        // Every other line is noise, and kept; the last one may still wait.
        assert!((status.read * 2).abs_diff(status.recorded) <= 1, "{status:?}");
        drop(feed);
        let flight = catalogue::flights(&RealDisk, bench.dir.path()).unwrap().remove(0);
        assert_eq!(crate::store::aircraft::files(&RealDisk, &flight).unwrap().len(), 1);
        assert!(verify::verify(&RealDisk, bench.dir.path()).is_sound());
    }

    #[test]
    fn a_full_disk_costs_the_lines_and_says_so() {
        let bench = bench(u64::MAX / 2_000_000);
        let port = free_port();
        let _feed = bench.listen(&format!("udp = '127.0.0.1:{port}'"));
        let status = bench.until(|status| {
            send(port, 5);
            status.lost > 0
        });
        assert!(status.recorded == 0 && status.lost > 0);
        assert!(status.fault.is_some_and(|fault| fault.contains("reserve")));
    }

    #[test]
    fn a_server_that_hangs_or_goes_is_called_again_and_holds_nothing_up() {
        let bench = bench(0);
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = server.local_addr().unwrap().port();
        let text = format!(
            "tcp = '127.0.0.1:{port}'\nformat = 'text'\nsubscribe = ['add,mach']\n[[column]]\nfield = 2\nquantity = 'mach'\n"
        );
        let feed = bench.listen(&text);
        let (first, _) = server.accept().unwrap();
        // It says nothing, then goes.
        drop(first);
        let status = bench.until(|status| status.fault.is_some());
        assert!(status.fault.is_some_and(|fault| fault.contains(&port.to_string())));
        let (mut second, _) = server.accept().unwrap();
        let mut asked = [0; 10];
        second.read_exact(&mut asked).unwrap();
        assert_eq!(&asked, b"add,mach\r\n");
        second.write_all(b"2026-03-01T06:00:00,0.78\n2026-03-01T06:00:01,0.").unwrap();
        second.write_all(b"79\n").unwrap();
        let status = bench.until(|status| status.read == 2);
        assert_eq!((status.recorded, status.read, status.fault), (2, 2, None));
        // It hangs: the connection stays and nothing comes.
        drop(feed);
        assert!(verify::verify(&RealDisk, bench.dir.path()).is_sound());
    }

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let read = |text: &str| toml::from_str::<AircraftConfig>(text);
        let iwg1 = "udp = '0.0.0.0:7071'\n[[column]]\nfield = 34\nquantity = 'weight_kg'\n";
        let config = read(iwg1).unwrap();
        assert_eq!((config.faults(), config.layout().time_field), (vec![], 2));
        let text = "tcp = 'acars:4711'\nformat = 'text'\ntime_field = 2\nsubscribe = ['add,mach']\n[[column]]\nfield = 3\nquantity = 'mach'\n";
        assert_eq!(read(text).unwrap().faults(), Vec::<String>::new());
        let bad = "udp = '0.0.0.0:7071'\ntcp = 'nowhere'\nsubscribe = []\nformat = 'text'\ntime_field = 0\n";
        let faults = read(bad).unwrap().faults();
        let keys: Vec<&str> = faults.iter().filter_map(|f| f.split(':').next()).collect();
        let expected = ["live.aircraft_data.tcp", "live.aircraft_data.column", "live.aircraft_data.column"];
        assert_eq!(keys, expected, "{faults:?}");
        assert!(read("udp = '0.0.0.0:7071'\nprot = 1\n").is_err());
    }
}
