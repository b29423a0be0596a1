//! Promise: beyond the loopback interface only a token gives access; attacks are refused, counted and survived.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::{Duration, Instant};

use wingd_pages::access::Access;

use super::http_pages::Server;
use crate::common::report_store::{solved, store_with};

const TOKEN: &str = "correct-horse-battery";

fn guarded(root: &std::path::Path) -> Server {
    Server::guarded(
        root,
        Access::new(Some(TOKEN), vec!["seat12a.local".to_owned()]),
    )
}

#[test]
fn serving_a_network_needs_a_token_of_some_length() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let file = store
        .path()
        .parent()
        .unwrap()
        .join(format!("token-{}", std::process::id()));
    let serve = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
        command
            .arg("serve")
            .arg(store.path())
            .args(arguments)
            .output()
            .unwrap()
    };
    let open = serve(&["--listen", "0.0.0.0:0"]);
    assert_eq!(open.status.code(), Some(78));
    assert!(String::from_utf8_lossy(&open.stderr).contains("--token-file"));
    for text in ["", "short\n", "sixteen characters with spaces"] {
        std::fs::write(&file, text).unwrap();
        let refused = serve(&[
            "--listen",
            "0.0.0.0:0",
            "--token-file",
            file.to_str().unwrap(),
        ]);
        let printed = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(78), "{text}: {printed}");
        assert!(
            text.is_empty() || !printed.contains(text.trim()),
            "the token is not shown: {printed}"
        );
    }
    std::fs::remove_file(&file).unwrap();
    assert_eq!(
        serve(&["--token-file", file.to_str().unwrap()])
            .status
            .code(),
        Some(78),
        "no such file"
    );
}

#[test]
fn the_token_lets_in_and_nothing_else_does() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = guarded(store.path());
    let paths = [
        "/",
        "/tar/f0001.tar",
        "/files/f0001/s000001/0001.jpg",
        "/status.json",
        "/nothing",
    ];
    for path in paths {
        for headers in [
            "",
            "Authorization: Bearer wrong\r\n",
            "Authorization: Bearer\r\n",
            "Cookie: token=x\r\n",
        ] {
            let answer = server.request("GET", path, headers);
            assert_eq!(answer.status, 401, "{path} {headers}");
            assert!(
                answer.head.contains("www-authenticate: bearer"),
                "{}",
                answer.head
            );
            assert!(!answer.text().contains("f0001"), "{}", answer.text());
        }
    }
    let right = format!("Authorization: Bearer {TOKEN}\r\n");
    assert_eq!(server.request("GET", "/tar/f0001.tar", &right).status, 200);
    let status: serde_json::Value =
        serde_json::from_slice(&server.request("GET", "/status.json", &right).body).unwrap();
    assert_eq!(status["refused"]["token"], 4 * paths.len());
}

#[test]
fn a_foreign_host_is_refused() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = Server::start(store.path());
    for host in [
        "evil.example",
        "localhost.evil.example",
        "",
        "evil.example:80",
    ] {
        let answer = server.request_for_host(host, "GET", "/", "");
        assert!(
            matches!(answer.status, 400 | 421),
            "{host}: {}",
            answer.head
        );
    }
    assert_eq!(
        server.request("GET", "/", "Host: evil.example\r\n").status,
        421,
        "two of them"
    );
    assert_eq!(
        server
            .request_for_host("127.0.0.1:8080", "GET", "/", "")
            .status,
        200
    );
    let right = format!("Authorization: Bearer {TOKEN}\r\n");
    assert_eq!(
        guarded(store.path())
            .request_for_host("Seat12a.local:80", "GET", "/", &right)
            .status,
        200
    );
}

#[test]
fn oversized_heads_and_malformed_ranges_are_refused() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = Server::start(store.path());
    let long = format!("X: {}\r\n", "a".repeat(60_000));
    assert_eq!(server.request("GET", "/", &long).status, 431);
    let many = "X: a\r\n".repeat(500);
    assert_eq!(server.request("GET", "/", &many).status, 431);
    let part =
        |range: &str| server.request("GET", "/tar/f0001.tar", &format!("Range: {range}\r\n"));
    let whole = server.request("GET", "/tar/f0001.tar", "").body.len();
    // An invalid range is ignored (RFC 9110, 14.2), one beyond the end refused.
    for range in [
        "bytes=9-1",
        "bytes=a-b",
        "bytes=-",
        "bytes=0-1,3-4",
        "lines=1-2",
    ] {
        let answer = part(range);
        assert_eq!((answer.status, answer.body.len()), (200, whole), "{range}");
    }
    let beyond = part("bytes=18446744073709551616-");
    assert_eq!((beyond.status, beyond.body.len()), (416, 0));
}

/// A thousand clients that send nothing, some that read nothing: others are refused at once, and the
/// server stops within its time.
#[test]
fn slow_clients_do_not_keep_the_server_from_stopping() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let frame = store.path().join("flights/f0001/s000001/0001.jpg");
    std::fs::OpenOptions::new()
        .write(true)
        .open(frame)
        .unwrap()
        .set_len(1 << 26)
        .unwrap();
    let manifest = store.path().join("flights/f0001/s000001/series.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let length = crate::common::report_store::jpeg().len();
    let text = text.replace(
        &format!("\"bytes\": {length}"),
        &format!("\"bytes\": {}", 1 << 26),
    );
    std::fs::write(&manifest, text).unwrap();
    let server = Server::start(store.path());
    let mut slow = Vec::new();
    for n in 0..1000 {
        let mut stream = TcpStream::connect(server.address).unwrap();
        let path = if n < 8 {
            "/files/f0001/s000001/0001.jpg HTTP/1.1\r\nHost: localhost\r\n\r\n"
        } else {
            "/"
        };
        let _ = write!(stream, "GET {path}");
        slow.push(stream);
    }
    let mut last = slow.pop().unwrap();
    last.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let mut bytes = Vec::new();
    let refused = last.read_to_end(&mut bytes);
    assert!(refused.is_err_and(|e| e.kind() != std::io::ErrorKind::WouldBlock) || bytes.is_empty());
    let begun = Instant::now();
    drop(server);
    let took = begun.elapsed();
    assert!(took < Duration::from_secs(5), "{took:?}");
    eprintln!("stopped in {took:?} with {} slow clients", slow.len());
}

/// A recorder of bundled frames with a page, on a port that was free a moment ago.
fn recorder(dir: &std::path::Path, listen: &str, token: &str) -> std::path::PathBuf {
    let frames = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/frames");
    let text = format!(
        "[camera]\nkind = \"replay\"\nfolder = {frames:?}\n[store]\npath = \"store\"\nreserve_mb = 0\n\
         [status]\nsocket = \"wingd.sock\"\n\
         [series]\ninterval = \"500ms\"\nshots = 1\ngap = \"1ms\"\nstale_window = 1\n\
         [serve]\nlisten = \"{listen}\"\n{token}"
    );
    let file = dir.join("wingd.toml");
    std::fs::write(&file, text).unwrap();
    file
}

#[test]
fn the_recorder_serves_its_page_and_stops_in_time_despite_open_connections() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("token"), TOKEN).unwrap();
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let config = recorder(dir.path(), &free.to_string(), "token_file = \"token\"\n");
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(["run", "--config"])
        .arg(&config)
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let ask = |headers: &str| {
        let mut stream = TcpStream::connect(free).ok()?;
        stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
        write!(
            stream,
            "GET /status.json HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{headers}\r\n"
        )
        .ok()?;
        let mut text = String::new();
        stream.read_to_string(&mut text).ok()?;
        Some(text)
    };
    let right = format!("Authorization: Bearer {TOKEN}\r\n");
    let begun = Instant::now();
    let status = loop {
        assert!(
            begun.elapsed() < Duration::from_secs(30),
            "no page with frames"
        );
        let text = ask(&right).unwrap_or_default();
        let body = text
            .split("\r\n\r\n")
            .nth(1)
            .and_then(|body| serde_json::from_str::<serde_json::Value>(body).ok());
        match body.filter(|status| status["frames"].as_u64() > Some(1)) {
            Some(status) => break status,
            None => std::thread::sleep(Duration::from_millis(50)),
        }
    };
    assert!(
        status["daemon"]["health"] == "ok" && status["free_mb"].is_u64(),
        "{status}"
    );
    assert!(ask("").unwrap().starts_with("HTTP/1.1 401"));
    // Connections that send nothing, and one in the middle of its head, delay nobody.
    let mut held: Vec<TcpStream> = (0..40).map(|_| TcpStream::connect(free).unwrap()).collect();
    held[0].write_all(b"GET / HTTP/1.1\r\nHost: loc").unwrap();
    let begun = Instant::now();
    assert!(
        Command::new("kill")
            .arg(daemon.id().to_string())
            .status()
            .unwrap()
            .success()
    );
    assert!(daemon.wait().unwrap().success());
    assert!(
        begun.elapsed() < Duration::from_secs(5),
        "stopped after {:?}",
        begun.elapsed()
    );
    assert!(
        wingd::store::verify::verify_path(&wingd::store::RealDisk, &dir.path().join("store"))
            .is_sound()
    );
}

#[test]
fn a_page_that_everybody_could_read_is_a_fault_of_the_configuration() {
    let dir = tempfile::tempdir().unwrap();
    for (listen, more, named) in [
        ("0.0.0.0:8080", "", "serve.listen"),
        (
            "127.0.0.1:8080",
            "token_file = \"nowhere\"\n",
            "serve.token_file",
        ),
        (
            "127.0.0.1:8080",
            "certificate = \"wingd.toml\"\nkey = \"wingd.toml\"\n",
            "serve.certificate",
        ),
        (
            "127.0.0.1:8080",
            "certificate = \"wingd.toml\"\n",
            "serve.certificate",
        ),
        ("here", "", "serve.listen"),
    ] {
        let config = recorder(dir.path(), listen, more);
        let checked = Command::new(env!("CARGO_BIN_EXE_wingd"))
            .args(["check", "--config"])
            .arg(&config)
            .output()
            .unwrap();
        let printed = String::from_utf8_lossy(&checked.stderr).into_owned();
        assert!(
            checked.status.code() == Some(78) && printed.contains(named),
            "{listen} {more}: {printed}"
        );
    }
}
