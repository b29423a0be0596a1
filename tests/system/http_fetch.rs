//! Promise: `wingd copy URL` completes a flight over a line that breaks, and succeeds only if all of it is there.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use serde_json::Map;
use wingd::store::verify::verify_path;
use wingd::store::{Inputs, RealDisk, Store, StoreConfig};
use wingd_pages::access::Access;

use super::http_pages::Server;
use crate::common::report_store::{solved, store_with};

const TOKEN: &str = "correct-horse-battery";

fn fetch(url: &str, to: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
        .arg("copy")
        .arg(url)
        .arg(to)
        .args(more)
        .output()
        .unwrap()
}

fn text(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// Forwards connections and cuts each off after some bytes, `cuts` times; returns its address.
fn line_that_breaks(to: SocketAddr, cuts: usize) -> (SocketAddr, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let broken = Arc::new(AtomicUsize::new(0));
    let count = broken.clone();
    std::thread::spawn(move || {
        let mut random = StdRng::seed_from_u64(30);
        for stream in listener.incoming().map_while(Result::ok) {
            let cut = count.load(Ordering::Relaxed) < cuts;
            // More than a listing, less than a flight.
            let limit = if cut {
                random.random_range(60_000..120_000)
            } else {
                usize::MAX
            };
            count.fetch_add(usize::from(cut), Ordering::Relaxed);
            std::thread::spawn(move || pass_on(stream, TcpStream::connect(to).unwrap(), limit));
        }
    });
    (address, broken)
}

fn pass_on(client: TcpStream, server: TcpStream, mut left: usize) {
    let (mut from, mut to) = (client.try_clone().unwrap(), server.try_clone().unwrap());
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut from, &mut to);
    });
    let (mut server, mut client) = (server, client);
    let mut buffer = [0; 4096];
    while left > 0 {
        match server.read(&mut buffer) {
            Ok(count) if count > 0 => {
                let count = count.min(left);
                if client.write_all(&buffer[..count]).is_err() {
                    break;
                }
                left -= count;
            }
            _ => break,
        }
    }
    let _ = client.shutdown(std::net::Shutdown::Both);
    let _ = server.shutdown(std::net::Shutdown::Both);
}

#[test]
fn a_flight_arrives_complete_over_a_line_that_breaks_thirty_times() {
    let six = |deflection_m: f64| std::array::from_fn::<_, 6, _>(|_| solved(deflection_m, 0.006));
    let all: Vec<[serde_json::Value; 6]> =
        (0..60).map(|k| six(2.0 + f64::from(k) / 100.0)).collect();
    let series: Vec<&[serde_json::Value]> = all.iter().map(|s| &s[..]).collect();
    let store = store_with(&series);
    let server = Server::start(store.path());
    let (address, broken) = line_that_breaks(server.address, 30);
    let to = tempfile::tempdir().unwrap();
    let url = format!("http://{address}");
    let mut last = fetch(&url, to.path(), &[]);
    for _ in 0..40 {
        if last.status.success() {
            break;
        }
        last = fetch(&url, to.path(), &[]);
    }
    assert_eq!(last.status.code(), Some(0), "{}", text(&last));
    assert!(
        broken.load(Ordering::Relaxed) >= 30,
        "the line broke {broken:?} times"
    );
    let (here, there) = (store.path().join("flights"), to.path().join("flights"));
    let same = Command::new("diff")
        .arg("-r")
        .arg(here)
        .arg(there)
        .status()
        .unwrap();
    assert!(same.success());
    assert_eq!(verify_path(&RealDisk, to.path()).frames, 360);
    // Repeated: nothing is fetched again, later results are added.
    add_results(store.path());
    let again = fetch(&url, to.path(), &["--flight", "f0001"]);
    assert_eq!(again.status.code(), Some(0), "{}", text(&again));
    assert_eq!(verify_path(&RealDisk, to.path()).results, 720);
}

/// Adds results of all frames with other inputs.
fn add_results(root: &Path) {
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(root)
    };
    let (store, _) = Store::open(Arc::new(RealDisk), config).unwrap();
    let inputs = Inputs::new(Map::from_iter([("program".to_owned(), "another".into())]));
    loop {
        let frames = store.unsolved_frames(&inputs).unwrap();
        if frames.is_empty() {
            break;
        }
        for frame in frames {
            assert!(
                store
                    .add_result(&frame, &inputs, solved(2.8, 0.006))
                    .unwrap()
            );
        }
    }
    store.seal();
}

#[test]
fn an_incomplete_fetch_fails_and_leaves_no_store() {
    let store = store_with(&[&[solved(2.9, 0.006), solved(2.8, 0.006)]]);
    // A frame of the right length with other bytes: the page cannot detect it, the receiver does.
    let frame = store.path().join("flights/f0001/s000001/0002.jpg");
    let mut bytes = std::fs::read(&frame).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&frame, bytes).unwrap();
    let server = Server::start(store.path());
    let to = tempfile::tempdir().unwrap();
    let output = fetch(&format!("http://{}", server.address), to.path(), &[]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    assert!(
        text(&output).contains("0002.jpg") && !to.path().join("store.toml").exists(),
        "{}",
        text(&output)
    );
    let nobody = fetch(
        &format!("http://{}", server.address),
        to.path(),
        &["--flight", "f0009"],
    );
    assert!(
        nobody.status.code() == Some(1) && text(&nobody).contains("no such flight"),
        "{}",
        text(&nobody)
    );
}

fn tls_file(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/tls")
        .join(name)
}

fn serve_over_tls(store: &Path) -> Server {
    serve_with_certificate(store, "certificate.pem", "key.pem")
}

fn serve_with_certificate(store: &Path, certificate: &str, key: &str) -> Server {
    let tls = wingd_pages::tls::tls_acceptor(&tls_file(certificate), &tls_file(key)).unwrap();
    Server::guarded(store, Access::new(Some(TOKEN), vec![]).with_tls(Some(tls)))
}

#[test]
#[cfg(feature = "tls")]
fn fetching_over_tls_needs_the_right_certificate_and_token() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = serve_over_tls(store.path());
    let (to, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let certificate = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tls/certificate.pem");
    let certificate = certificate.to_str().unwrap();
    let token = dir.path().join("token");
    std::fs::write(&token, TOKEN).unwrap();
    let token = token.to_str().unwrap();
    let url = format!("https://localhost:{}", server.address.port());
    let refused = fetch(&url, to.path(), &["--certificate", certificate]);
    assert!(
        refused.status.code() == Some(1) && text(&refused).contains("401"),
        "{}",
        text(&refused)
    );
    let unknown = fetch(&url, to.path(), &["--token-file", token]);
    assert!(
        unknown.status.code() == Some(1) && text(&unknown).contains("--certificate"),
        "{}",
        text(&unknown)
    );
    let plain = format!("http://localhost:{}", server.address.port());
    assert_eq!(
        fetch(&plain, to.path(), &["--token-file", token])
            .status
            .code(),
        Some(1),
        "no plain text there"
    );
    let done = fetch(
        &url,
        to.path(),
        &["--certificate", certificate, "--token", token],
    );
    assert_eq!(done.status.code(), Some(0), "{}", text(&done));
    assert!(!text(&done).contains(TOKEN));
}

/// Errors that no further attempt removes are named at once, with dates, scheme or certificate.
#[test]
#[cfg(feature = "tls")]
fn permanent_errors_of_a_connection_are_named_at_once() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let dir = tempfile::tempdir().unwrap();
    let refused = |scheme: &str, server: &Server, certificate: Option<&str>, words: &str| {
        let url = format!("{scheme}://localhost:{}", server.address.port());
        let certificate = certificate.map(|name| tls_file(name).display().to_string());
        let more = certificate.iter().flat_map(|file| ["--certificate", file]);
        let begun = std::time::Instant::now();
        let fetched = fetch(&url, &dir.path().join("copy"), &more.collect::<Vec<_>>());
        let printed = text(&fetched);
        assert!(
            fetched.status.code() == Some(1) && printed.contains(words),
            "{words}: {printed}"
        );
        assert!(!printed.contains("run the same command again"), "{printed}");
        assert!(begun.elapsed().as_secs() < 8, "{:?}", begun.elapsed());
    };
    let future = serve_with_certificate(store.path(), "future.pem", "dated-key.pem");
    let words = "validity begins on 2100-01-01T00:00:00Z, and this machine's clock shows 20";
    refused("https", &future, Some("future.pem"), words);
    let expired = serve_with_certificate(store.path(), "expired.pem", "dated-key.pem");
    let words = "validity ended on 2021-01-01T00:00:00Z";
    refused("https", &expired, Some("expired.pem"), words);
    let sound = serve_over_tls(store.path());
    let words = "presents another certificate than --certificate";
    refused("https", &sound, Some("future.pem"), words);
    refused("http", &sound, None, "give https:// and --certificate FILE");
    let plain = Server::guarded(store.path(), Access::new(None, vec![]));
    let words = "does not answer in TLS; give http://";
    refused("https", &plain, Some("certificate.pem"), words);
    let warning = wingd_pages::tls::validity_warning(&tls_file("expired.pem"));
    assert!(warning.unwrap().contains("ended on 2021-01-01"));
    assert_eq!(
        wingd_pages::tls::validity_warning(&tls_file("certificate.pem")),
        None
    );
}

/// A proxy that does not pass ranges on sends the whole archive, which is used.
#[test]
fn a_flight_arrives_through_a_proxy_without_ranges() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = Server::guarded(store.path(), Access::new(None, vec!["127.0.0.1".into()]));
    let origin = server.address;
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for mut client in listener.incoming().map_while(Result::ok) {
            let mut head = [0; 4096];
            let length = client.read(&mut head).unwrap_or(0);
            let head = String::from_utf8_lossy(&head[..length]).into_owned();
            let kept = head.split("\r\n").filter(|line| {
                let lower = line.to_lowercase();
                !lower.starts_with("range:") && !lower.starts_with("if-range:")
            });
            let kept = kept.collect::<Vec<_>>().join("\r\n");
            let request = kept.replacen("\r\n", "\r\nConnection: close\r\n", 1);
            let mut server = TcpStream::connect(origin).unwrap();
            server.write_all(request.as_bytes()).unwrap();
            let mut answer = vec![];
            let _ = server.read_to_end(&mut answer);
            let _ = client.write_all(&answer);
        }
    });
    let dir = tempfile::tempdir().unwrap();
    let copy = dir.path().join("copy");
    let fetched = fetch(&format!("http://{address}"), &copy, &[]);
    assert_eq!(fetched.status.code(), Some(0), "{}", text(&fetched));
    assert!(verify_path(&RealDisk, &copy).is_sound());
}

/// A server that answers each path with the next of its answers; returns its address and the number of requests.
fn strange_server(
    answer: impl Fn(&str) -> Vec<u8> + Send + Sync + 'static,
) -> (SocketAddr, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, count) = (
        listener.local_addr().unwrap(),
        Arc::new(AtomicUsize::new(0)),
    );
    let (requests, answer) = (count.clone(), Arc::new(answer));
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let (requests, answer) = (requests.clone(), answer.clone());
            std::thread::spawn(move || {
                let mut head = [0; 4096];
                let length = stream.read(&mut head).unwrap_or(0);
                requests.fetch_add(1, Ordering::Relaxed);
                let head = String::from_utf8_lossy(&head[..length]).into_owned();
                let _ = stream.write_all(&answer(head.split(' ').nth(1).unwrap_or_default()));
            });
        }
    });
    (address, count)
}

fn http_answer(body: &str) -> Vec<u8> {
    format!(
        "HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    )
    .into_bytes()
}

fn listing(length: u64) -> String {
    let file = |name: &str, offset: u64, length: u64| serde_json::json!({"name": name, "length": length, "sha256": "ab".repeat(32), "offset": offset});
    let items = [
        file("store.toml", 512, 100),
        file("flights/f0001/flight.json", 1536, length),
    ];
    serde_json::json!({"flight": "f0001", "digest": "cd".repeat(32), "items": items}).to_string()
}

/// A proxy that ignores ranges answers each request with the whole archive, 200: a few tries with pauses, then an error.
#[test]
fn a_server_without_ranges_is_given_up() {
    let (address, requests) = strange_server(|path| match path.ends_with(".json") {
        true => http_answer(&listing(100)),
        false => http_answer("the whole archive"),
    });
    let dir = tempfile::tempdir().unwrap();
    let fetched = fetch(
        &format!("http://{address}"),
        &dir.path().join("copy"),
        &["--flight", "f0001"],
    );
    assert_eq!(fetched.status.code(), Some(1));
    assert!(
        text(&fetched).contains("no part of the listed files was sent"),
        "{}",
        text(&fetched)
    );
    assert!(requests.load(Ordering::Relaxed) < 40, "{requests:?}");
}

/// Lengths that a server states are not believed.
#[test]
fn impossible_lengths_and_names_are_refused_at_once() {
    let answers = [
        (listing(1 << 60), "MB are needed"),
        (listing(u64::MAX - 100), "impossible"),
        (
            listing(100).replace("flights/f0001/flight.json", "flights/f0001/\\u001b[2J"),
            "is not a file of flight",
        ),
    ];
    for (body, words) in answers {
        let (address, _) = strange_server(move |_| http_answer(&body));
        let dir = tempfile::tempdir().unwrap();
        let fetched = fetch(
            &format!("http://{address}"),
            &dir.path().join("copy"),
            &["--flight", "f0001"],
        );
        assert_eq!(fetched.status.code(), Some(1));
        let printed = text(&fetched);
        assert!(
            printed.contains(words) && !printed.contains('\u{1b}'),
            "{words}: {printed}"
        );
    }
    let (address, requests) = strange_server(|_| http_answer(&"x".repeat(100 << 20)));
    let fetched = fetch(
        &format!("http://{address}"),
        &tempfile::tempdir().unwrap().path().join("copy"),
        &[],
    );
    assert!(
        text(&fetched).contains("longer than allowed"),
        "{}",
        text(&fetched)
    );
    assert_eq!(requests.load(Ordering::Relaxed), 1, "not tried again");
}
