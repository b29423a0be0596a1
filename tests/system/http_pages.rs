//! The read-only pages over real sockets: lists, ranges, archives, and names that try to get out.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::time::Duration;

use crate::common::report_store::{jpeg, solved, store_with};
use wingd_pages::access::Access;
use wingd_pages::{Site, serve};

/// A server for one test; stops when dropped.
pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Server {
    pub(crate) fn start(root: &Path) -> Self {
        Self::guarded(root, Access::default())
    }

    pub(crate) fn guarded(root: &Path, access: Access) -> Self {
        Self::serve(
            Site {
                root: root.to_owned(),
                recorder: None,
            },
            access,
        )
    }

    pub(crate) fn serve(site: Site, access: Access) -> Self {
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let (sender, receiver) = std::sync::mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
                .unwrap();
            runtime.block_on(async move {
                let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
                sender.send(listener.local_addr().unwrap()).unwrap();
                let shutdown = async {
                    let _ = stopped.await;
                };
                serve(site, access, listener, shutdown).await.unwrap();
            });
        });
        Self {
            address: receiver.recv().unwrap(),
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    /// Sends the path unchanged.
    pub(crate) fn request(&self, method: &str, path: &str, headers: &str) -> Answer {
        self.request_for_host("localhost", method, path, headers)
    }

    pub(crate) fn request_for_host(
        &self,
        host: &str,
        method: &str,
        path: &str,
        headers: &str,
    ) -> Answer {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}\r\n"
        )
        .unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        Answer::parse(&bytes)
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        self.request("GET", path, "")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.stop.take().unwrap().send(());
        self.thread.take().unwrap().join().unwrap();
    }
}

pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    fn parse(bytes: &[u8]) -> Self {
        let end = bytes
            .windows(4)
            .position(|w| w == b"\r\n\r\n")
            .expect("an answer with a head");
        let head = String::from_utf8(bytes[..end].to_vec())
            .unwrap()
            .to_lowercase();
        let mut body = bytes[end + 4..].to_vec();
        if head.contains("transfer-encoding: chunked") {
            body = dechunked(&body);
        }
        Self {
            status: head[9..12].parse().unwrap(),
            head,
            body,
        }
    }

    /// Value of a header, in lower case.
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.head
            .lines()
            .find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

fn dechunked(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    loop {
        let line = rest.windows(2).position(|w| w == b"\r\n").unwrap();
        let length =
            usize::from_str_radix(std::str::from_utf8(&rest[..line]).unwrap(), 16).unwrap();
        if length == 0 {
            return body;
        }
        body.extend_from_slice(&rest[line + 2..line + 2 + length]);
        rest = &rest[line + 4 + length..];
    }
}

const FRAME: &str = "/files/f0001/s000001/0001.jpg";

#[test]
fn pages_lead_from_the_flight_to_the_frame() {
    let store = store_with(&[&[solved(2.9, 0.006)], &[solved(2.1, 0.006)]]);
    let server = Server::start(store.path());
    let index = server.get("/");
    assert_eq!(index.status, 200);
    assert!(
        index.text().contains("href=\"/flights/f0001\"")
            && index.head.contains("default-src 'none'")
    );
    let flight = server.get("/flights/f0001").text();
    assert!(flight.contains("href=\"/flights/f0001/s000002\"") && flight.contains("2.1000"));
    assert!(
        flight.contains("wingd copy http://localhost") && flight.contains("Nothing: every shot")
    );
    let series = server.get("/flights/f0001/s000001").text();
    assert!(series.contains(FRAME) && series.contains("tip deflection 2.9000 m"));
    let frame = server.get("/frames/f0001/s000001/0001.jpg").text();
    assert!(
        frame.contains("/overlay/f0001/s000001/0001.jpg.svg") && frame.contains("hidden by glare")
    );
    let thumb = server.get("/thumb/f0001/s000001/0001.jpg.svg");
    assert!(
        thumb.status == 200
            && thumb.text().contains("<circle")
            && thumb.text().contains("data:image/jpeg")
    );
    let known = format!("If-None-Match: {}\r\n", thumb.header("etag").unwrap());
    assert_eq!(
        server
            .request("GET", "/thumb/f0001/s000001/0001.jpg.svg", &known)
            .status,
        304
    );
    for series in ["s000001", "s000002"] {
        let results = server.get(&format!("/files/f0001/{series}/results.jsonl"));
        assert_eq!(results.text().lines().count(), 1, "{series}");
    }
    let status: serde_json::Value =
        serde_json::from_slice(&server.get("/status.json").body).unwrap();
    assert_eq!(
        (&status["frames"], &status["solved"]),
        (&2.into(), &2.into())
    );
}

#[test]
fn frames_are_sent_completely_and_by_range() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = Server::start(store.path());
    let jpeg = jpeg();
    let whole = server.get(FRAME);
    assert_eq!((whole.status, &whole.body), (200, &jpeg));
    assert!(!whole.head.contains("immutable") && whole.head.contains("accept-ranges: bytes"));
    let part = server.request("GET", FRAME, "Range: bytes=10-19\r\n");
    assert_eq!((part.status, &part.body[..]), (206, &jpeg[10..20]));
    assert!(
        part.head
            .contains(&format!("content-range: bytes 10-19/{}", jpeg.len()))
    );
    let tail = server.request(
        "GET",
        FRAME,
        &format!("Range: bytes={}-\r\n", jpeg.len() - 5),
    );
    assert_eq!(
        (tail.status, &tail.body[..]),
        (206, &jpeg[jpeg.len() - 5..])
    );
    assert_eq!(
        server
            .request("GET", FRAME, "Range: bytes=99999999-\r\n")
            .status,
        416
    );
    // RFC 9110, 14.1 and 14.2: another unit, several ranges and methods other than GET get the complete file.
    assert_eq!(
        server.request("GET", FRAME, "Range: Bytes=0-9\r\n").status,
        206
    );
    for (method, range) in [
        ("GET", "items=0-1"),
        ("GET", "bytes=0-1,5-6"),
        ("HEAD", "bytes=0-1"),
    ] {
        let answer = server.request(method, FRAME, &format!("Range: {range}\r\n"));
        assert!(
            answer.status == 200 && !answer.head.contains("content-range"),
            "{method} {range}: {}",
            answer.head
        );
    }
    let head = server.request("HEAD", FRAME, "");
    assert_eq!((head.status, head.body.len()), (200, 0));
}

#[test]
fn a_growing_file_is_sent_completely() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = Server::start(store.path());
    let whole = std::fs::read(store.path().join("flights/f0001/s000001/results.jsonl")).unwrap();
    let answer = server.request(
        "GET",
        "/files/f0001/s000001/results.jsonl",
        "Range: bytes=3-9\r\n",
    );
    assert_eq!((answer.status, answer.body), (200, whole));
}

#[test]
fn an_archive_contains_every_file_of_the_flight() {
    let store = store_with(&[
        &[solved(2.9, 0.006), solved(2.8, 0.006)],
        &[solved(2.1, 0.006)],
    ]);
    let server = Server::start(store.path());
    let answer = server.get("/tar/f0001.tar");
    assert_eq!(answer.status, 200);
    let mut archive = tar::Archive::new(&answer.body[..]);
    let mut names = Vec::new();
    for entry in archive.entries().unwrap() {
        let mut entry = entry.unwrap();
        let name = entry.path().unwrap().to_string_lossy().into_owned();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        assert_eq!(
            bytes,
            std::fs::read(store.path().join(&name)).unwrap(),
            "{name}"
        );
        names.push(name);
    }
    // The store's format file and counter, the flight's record, chain and sums, two files per series, three frames.
    assert_eq!(names.len(), 2 + 3 + 2 * 2 + 3, "{names:?}");
}

#[test]
fn no_name_leads_out_of_the_store() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    std::fs::write(store.path().join("secret.json"), "secret").unwrap();
    let series = store.path().join("flights/f0001/s000001");
    std::fs::write(series.join("secret.txt"), "secret").unwrap();
    std::os::unix::fs::symlink(store.path().join("secret.json"), series.join("0002.jpg")).unwrap();
    std::os::unix::fs::symlink("/", store.path().join("flights/f0002")).unwrap();
    let server = Server::start(store.path());
    for path in [
        "/files/f0001/s000001/../../../secret.json",
        "/files/f0001/s000001/..%2f..%2f..%2fsecret.json",
        "/files/f0001/..%2fs000001/0001.jpg",
        "/files/f0001/s000001/%2e%2e/%2e%2e/%2e%2e/secret.json",
        "/files/f0001/s000001//etc/passwd",
        "/files/f0001/s000001/%2fetc%2fpasswd",
        "/files/f0001/s000001/secret.txt",
        "/files/f0001/s000001/0002.jpg",
        "/files/f0001/s000001/0001.jpg%00.json",
        "/files/f0001/s000001/0001.jpg/",
        "/files/f0002/flight.json",
        "/files/../secret.json",
        "/files/f0001/secret.json",
        "/flights/f0002",
        "/flights/..%2f..",
        "/tar/f0002.tar",
        "/bundle/f0002.json",
        "/frames/f0001/s000001/secret.txt",
        "/thumb/f0001/s000001/secret.txt.svg",
        "/thumb/f0001/s000001/..%2f..%2f..%2fsecret.json.svg",
        "/overlay/f0001/s000001/0002.jpg.svg",
        "/flights/f0001/..%2fs000001",
        "/tar/..%2f..tar",
        "/tar/f0001",
        "/store.toml",
        "/files/f9999/flight.json",
    ] {
        let answer = server.get(path);
        assert!(
            matches!(answer.status, 400 | 404),
            "{path}: {}",
            answer.head
        );
        assert!(!answer.text().contains("secret"), "{path}");
    }
    let archive = server.get("/tar/f0001.tar");
    assert!(archive.status == 200 && !archive.text().contains("secret"));
}

#[test]
fn requests_cannot_change_the_store() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = Server::start(store.path());
    for method in ["POST", "PUT", "DELETE", "PATCH"] {
        let answer = server.request(method, FRAME, "Content-Length: 0\r\n");
        assert_eq!(answer.status, 405, "{method}");
    }
    assert_eq!(server.get(FRAME).body, jpeg());
}

#[test]
fn a_directory_that_is_no_store_gives_a_message() {
    let empty = tempfile::tempdir().unwrap();
    let server = Server::start(empty.path());
    let answer = server.get("/");
    assert_eq!(answer.status, 500);
    assert!(answer.text().contains("is not a store"));
}
