//! Promise: the first series is recorded in its time whatever is wrong with page, sockets, store's mark, a flight's owner or
//! another recorder; the fault is in the status, and what appears later is taken up.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use wingd::daemon::query_daemon;
use wingd::store::verify::verify_path;
use wingd::store::{RealDisk, catalogue};

use crate::program::fixture;

/// Time within which the first series must be recorded, on a busy machine.
pub const FIRST_SERIES: Duration = Duration::from_secs(20);
pub const TOKEN: &str = "correct-horse-battery";
/// User and group without rights, under which tests run that need one who is not root.
const NOBODY: u32 = 65534;

/// `wingd run` in a folder; ended when dropped.
pub struct Recorder {
    pub child: Child,
    pub folder: PathBuf,
}

/// Writes a configuration with one series of one shot per second, and more sections.
pub fn configure(folder: &Path, more: &str) {
    let text = format!(
        "[camera]\nkind = \"replay\"\nfolder = {:?}\n[store]\npath = \"store\"\nreserve_mb = 0\n\
         [status]\nsocket = \"wingd.sock\"\n\
         [series]\ninterval = \"1s\"\nshots = 1\ngap = \"1ms\"\nstale_window = 1\n{more}",
        fixture("dev/frames")
    );
    std::fs::write(folder.join("wingd.toml"), text).unwrap();
}

/// Folder with a configuration and the store of a recorder that has ended after its first series.
pub fn recorded_flight() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    configure(dir.path(), "");
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    recorder.end();
    dir
}

impl Recorder {
    pub fn start(folder: &Path) -> Self {
        Self::spawn(folder, Command::new(env!("CARGO_BIN_EXE_wingd")))
    }

    /// Starts it as a user that is not root.
    fn start_unprivileged(folder: &Path) -> Self {
        let program = folder.join("wingd");
        std::fs::copy(env!("CARGO_BIN_EXE_wingd"), &program).unwrap();
        let mut command = Command::new("setpriv");
        command
            .args(["--reuid=65534", "--regid=65534", "--clear-groups"])
            .arg(&program);
        Self::spawn(folder, command)
    }

    fn spawn(folder: &Path, mut command: Command) -> Self {
        let log = std::fs::File::create(folder.join("log")).unwrap();
        let child = command
            .args(["run", "--config"])
            .arg(folder.join("wingd.toml"))
            .stderr(log)
            .stdin(Stdio::null());
        Self {
            child: child.spawn().unwrap(),
            folder: folder.to_owned(),
        }
    }

    fn status(&self) -> Option<Value> {
        query_daemon(&self.folder.join("wingd.sock"), "status").ok()
    }

    /// Waits until a condition holds; returns the last status.
    pub fn wait(
        &mut self,
        what: &str,
        within: Duration,
        condition: impl Fn(&Value) -> bool,
    ) -> Value {
        let begun = Instant::now();
        let mut last = Value::Null;
        while begun.elapsed() < within {
            assert_eq!(
                self.child.try_wait().unwrap(),
                None,
                "it ended: {}",
                self.log()
            );
            last = self.status().unwrap_or(last);
            if condition(&last) {
                return last;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        panic!("{what}: {last}\n{}", self.log());
    }

    pub fn records(&mut self) -> Value {
        let begun = Instant::now();
        while begun.elapsed() < FIRST_SERIES {
            assert_eq!(
                self.child.try_wait().unwrap(),
                None,
                "it ended: {}",
                self.log()
            );
            if series(&self.folder.join("store")) > 0 {
                return self.status().unwrap_or(Value::Null);
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("no series: {}", self.log());
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.join("log")).unwrap_or_default()
    }

    /// Ends it as the service manager does.
    pub fn end(mut self) {
        self.signal();
        assert!(self.child.wait().unwrap().success(), "{}", self.log());
    }

    fn signal(&self) {
        let _ = Command::new("kill")
            .args(["-TERM", &self.child.id().to_string()])
            .status();
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            self.signal();
            let _ = self.child.wait();
        }
    }
}

/// Number of series in the flights of a store.
pub fn series(store: &Path) -> usize {
    let flights = catalogue::list_flights(&RealDisk, store).unwrap_or_default();
    flights
        .iter()
        .map(|flight| {
            catalogue::list_series(&RealDisk, flight)
                .unwrap_or_default()
                .len()
        })
        .sum()
}

pub fn assert_sound(store: &Path) {
    let report = verify_path(&RealDisk, store);
    assert!(report.is_sound(), "{:#?}", report.faults);
}

pub fn free_address() -> std::net::SocketAddr {
    std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
}

/// Status of a page's answer; `None` if there is no page.
pub fn page(address: std::net::SocketAddr, path: &str) -> Option<(u16, String)> {
    let mut stream = TcpStream::connect(address).ok()?;
    let head = format!(
        "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: Bearer {TOKEN}\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).ok()?;
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8_lossy(&bytes).into_owned();
    Some((text.get(9..12)?.parse().ok()?, text))
}

pub fn fault_of(status: &Value, part: &str) -> String {
    status["faults"][part]
        .as_str()
        .unwrap_or_default()
        .to_owned()
}

/// Every fault of `[serve]` leaves the recorder running; the page comes up when the fault is corrected.
#[test]
fn a_page_that_cannot_be_served_is_a_fault_and_is_tried_again() {
    let token = "token_file = \"token\"\n";
    let tls = "certificate = \"certificate.pem\"\nkey = \"key.pem\"\n";
    let tls_files = fixture("../tests/tls");
    type Break = fn(&Path);
    let lost: Break = |folder| drop(std::fs::remove_file(folder.join("token")));
    let empty: Break = |folder| std::fs::write(folder.join("token"), "").unwrap();
    let damaged: Break =
        |folder| std::fs::write(folder.join("certificate.pem"), "-----BEGIN").unwrap();
    let none: Break = |_| ();
    let cases = [
        ("lost", "", lost, false),
        ("empty", "", empty, false),
        ("damaged", tls, damaged, true),
    ];
    let no_name = ("name", "", none, true);
    let running: Vec<_> = cases
        .into_iter()
        .chain([no_name])
        .map(|(case, more, harm, stays)| {
            let dir = tempfile::tempdir().unwrap();
            let address = free_address();
            let listen = if case == "name" {
                "no-such-host.invalid:8080".to_owned()
            } else {
                address.to_string()
            };
            configure(
                dir.path(),
                &format!("[serve]\nlisten = \"{listen}\"\n{token}{more}"),
            );
            std::fs::write(dir.path().join("token"), TOKEN).unwrap();
            for file in ["certificate.pem", "key.pem"] {
                std::fs::copy(tls_files.join(file), dir.path().join(file)).unwrap();
            }
            harm(dir.path());
            (case, Recorder::start(dir.path()), dir, address, stays)
        })
        .collect();
    for (case, mut recorder, dir, address, stays) in running {
        recorder.records();
        let status = recorder.wait(case, FIRST_SERIES, |status| {
            !fault_of(status, "web page").is_empty()
        });
        assert_eq!(status["health"], "degraded", "{case}: {status}");
        assert!(page(address, "/").is_none(), "{case}");
        if !stays {
            std::fs::write(dir.path().join("token"), TOKEN).unwrap();
            recorder.wait(case, FIRST_SERIES, |status| {
                fault_of(status, "web page").is_empty()
            });
            assert_eq!(page(address, "/").unwrap().0, 200, "{case}");
        }
        let lines = recorder
            .log()
            .lines()
            .filter(|line| line.contains("web page"))
            .count();
        assert!(lines < 6, "logged at growing intervals: {}", recorder.log());
        recorder.end();
        assert_sound(&dir.path().join("store"));
    }
}

#[test]
fn a_page_takes_up_an_address_that_is_free_later() {
    let dir = tempfile::tempdir().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    configure(dir.path(), &format!("[serve]\nlisten = \"{address}\"\n"));
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    recorder.wait("a fault", FIRST_SERIES, |status| {
        !fault_of(status, "web page").is_empty()
    });
    drop(taken);
    recorder.wait("the page", FIRST_SERIES, |status| {
        fault_of(status, "web page").is_empty()
    });
    assert_eq!(page(address, "/status.json").unwrap().0, 200);
    recorder.end();
}

/// Refusals are not logged one by one.
#[test]
fn a_hundred_guesses_are_a_few_lines_of_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let address = free_address();
    configure(
        dir.path(),
        &format!("[serve]\nlisten = \"{address}\"\ntoken_file = \"token\"\n"),
    );
    std::fs::write(dir.path().join("token"), TOKEN.to_uppercase()).unwrap();
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    let begun = Instant::now();
    while page(address, "/").is_none() && begun.elapsed() < FIRST_SERIES {
        std::thread::sleep(Duration::from_millis(50));
    }
    let guesses: Vec<_> = (0..100)
        .map(|_| std::thread::spawn(move || page(address, "/").unwrap()))
        .collect();
    assert!(
        guesses
            .into_iter()
            .all(|guess| guess.join().unwrap().0 == 401)
    );
    let lines = recorder.log().matches("request refused").count();
    assert!((1..=9).contains(&lines), "{lines}");
    let begun = Instant::now();
    page(address, "/").unwrap();
    assert!(
        begun.elapsed() >= Duration::from_millis(150),
        "a guess is slowed down"
    );
}

#[test]
fn a_damaged_or_lost_mark_of_the_store_is_rebuilt_from_the_chains() {
    let dir = recorded_flight();
    let store = dir.path().join("store");
    let mark = store.join("store.toml");
    let whole = std::fs::read_to_string(&mark).unwrap();
    for damage in [Some(&b""[..]), Some(b"\0\0\0"), Some(b"format = "), None] {
        let before = series(&store);
        match damage {
            Some(bytes) => std::fs::write(&mark, bytes).unwrap(),
            None => std::fs::remove_file(&mark).unwrap(),
        }
        let mut recorder = Recorder::start(dir.path());
        recorder.wait("a series", FIRST_SERIES, |_| series(&store) > before);
        recorder.end();
        assert_eq!(std::fs::read_to_string(&mark).unwrap(), whole, "{damage:?}");
        assert_sound(&store);
    }
}

/// As after a run by root: the flight's folder belongs to root, the recorder runs as another user.
#[test]
fn a_flight_that_belongs_to_root_is_followed_by_another() {
    if !rustix::process::geteuid().is_root() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    std::fs::set_permissions(dir.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    let frames = dir.path().join("frames");
    std::fs::create_dir(&frames).unwrap();
    for entry in std::fs::read_dir(fixture("dev/frames")).unwrap().flatten() {
        std::fs::copy(entry.path(), frames.join(entry.file_name())).unwrap();
    }
    configure(dir.path(), "");
    let file = dir.path().join("wingd.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(
        &file,
        text.replace(fixture("dev/frames").to_str().unwrap(), "frames"),
    )
    .unwrap();
    let store = dir.path().join("store");
    std::fs::create_dir(&store).unwrap();
    for path in [dir.path(), &store] {
        chown(path, Some(NOBODY), Some(NOBODY)).unwrap();
    }
    // Root's own run leaves the files to the store's owner.
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    recorder.end();
    let folder = store.join("flights/f0001");
    for path in [
        &folder,
        &folder.join("chain.jsonl"),
        &store.join("counter.json"),
        &store.join("store.toml"),
    ] {
        assert_eq!(
            std::fs::metadata(path).unwrap().uid(),
            NOBODY,
            "{}",
            path.display()
        );
    }
    // A store that an older version left with a flight of root.
    chown(&folder, Some(0), Some(0)).unwrap();
    let checked = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(["check", "--config"])
        .arg(&file)
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&checked.stderr).into_owned();
    assert!(
        checked.status.code() == Some(78) && printed.contains("f0001 cannot be written to"),
        "{printed}"
    );
    let before = series(&store);
    let mut recorder = Recorder::start_unprivileged(dir.path());
    let status = recorder.wait("a series", FIRST_SERIES, |status| {
        series(&store) > before && status["counts"]["series_complete"].as_u64() > Some(0)
    });
    assert_eq!(
        (&status["flight"], &status["store"]["unclosed"]),
        (&Value::from("f0002"), &Value::Null)
    );
    recorder.end();
    assert_sound(&store);
}

/// While the last series cannot be moved to its flight, health is failed; it is well again afterwards.
#[test]
fn series_that_cannot_be_closed_fail_health() {
    let dir = tempfile::tempdir().unwrap();
    configure(dir.path(), "");
    let store = dir.path().join("store");
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    // A file in the place of the flight's folder: nobody can write to it, root neither.
    let (flights, away) = (store.join("flights"), store.join("away"));
    let rename = |from: &Path, to: &Path| {
        assert!(
            Command::new("mv")
                .args([from, to])
                .status()
                .unwrap()
                .success()
        )
    };
    rename(&flights, &away);
    std::fs::write(&flights, "").unwrap();
    let status = recorder.wait("failed health", FIRST_SERIES, |status| {
        status["store"]["unclosed"].is_string()
    });
    assert_eq!(status["health"], "failed", "{status}");
    std::fs::remove_file(&flights).unwrap();
    rename(&away, &flights);
    recorder.wait("good health", FIRST_SERIES, |status| {
        status["store"]["unclosed"].is_null() && status["store"]["stranded"] == 0
    });
    let remains = recorder.log().matches("remains in incoming").count();
    recorder.end();
    assert!(remains < 20, "each remark is logged once: {remains}");
    assert_sound(&store);
}

#[test]
fn a_second_recorder_leaves_the_first_ones_socket() {
    let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    for dir in &dirs {
        configure(dir.path(), "");
    }
    let other = std::fs::read_to_string(dirs[1].path().join("wingd.toml")).unwrap();
    let socket = dirs[0].path().join("wingd.sock");
    std::fs::write(
        dirs[1].path().join("wingd.toml"),
        other.replace("wingd.sock", socket.to_str().unwrap()),
    )
    .unwrap();
    let mut first = Recorder::start(dirs[0].path());
    first.records();
    let mut second = Recorder::start(dirs[1].path());
    second.records();
    second.end();
    assert!(first.status().is_some(), "the first one still answers");
    first.end();
}

#[test]
fn clients_of_the_status_do_not_use_up_the_files() {
    let dir = tempfile::tempdir().unwrap();
    configure(dir.path(), "");
    let socket = dir.path().join("wingd.sock");
    let mut first = Recorder::start(dir.path());
    first.records();
    let clients: Vec<_> = (0..300)
        .filter_map(|_| UnixStream::connect(&socket).ok())
        .collect();
    std::thread::sleep(Duration::from_millis(300));
    let files = std::fs::read_dir(format!("/proc/{}/fd", first.child.id()))
        .unwrap()
        .count();
    assert!(files < 120, "{files}");
    drop(clients);
    first.wait("an answer", FIRST_SERIES, |status| status["health"] == "ok");
    first.end();
}
