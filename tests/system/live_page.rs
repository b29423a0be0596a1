//! Promise: the page shows the output of the recorder's live socket, and reports if nobody answers there.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::time::Duration;

use base64::Engine;
use wingd::http::Site;
use wingd::http::access::Access;

use crate::common::report_store::{solved, store_with};
use crate::http_pages::Server;

fn server(store: &Path, socket: &Path) -> Server {
    let live = Some(socket.to_owned());
    Server::serve(
        Site {
            root: store.to_owned(),
            setup: None,
            board: None,
            live,
            reports: None,
        },
        Access::default(),
    )
}

/// The stream of events, until it contains these words.
fn events_until(server: &Server, words: &str) -> String {
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    write!(
        stream,
        "GET /live/events HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: 7\r\n\r\n"
    )
    .unwrap();
    let (mut text, mut bytes) = (String::new(), [0; 4096]);
    while !text.contains(words) {
        let count = stream.read(&mut bytes).unwrap();
        assert!(count > 0, "the stream ended: {text}");
        text.push_str(&String::from_utf8_lossy(&bytes[..count]));
    }
    text
}

#[test]
fn results_and_the_frame_are_relayed() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let socket = store.path().join("live.sock");
    let listener = UnixListener::bind(&socket).unwrap();
    let jpeg = base64::engine::general_purpose::STANDARD.encode(b"an image");
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let jpeg = jpeg.clone();
            std::thread::spawn(move || {
                writeln!(stream, "{{\"number\":7}}").unwrap();
                let mut asked = String::new();
                let _ = BufReader::new(stream.try_clone().unwrap()).read_line(&mut asked);
                if asked == "frame\n" {
                    writeln!(
                        stream,
                        "{{\"frame\":7,\"width\":40,\"height\":30,\"jpeg\":\"{jpeg}\"}}"
                    )
                    .unwrap();
                }
            });
        }
    });
    let server = server(store.path(), &socket);
    let page = server.get("/live");
    assert!(
        page.status == 200 && page.head.contains("script-src 'self'"),
        "{}",
        page.head
    );
    assert!(
        page.text().contains("src=\"/live.js\"")
            && server.get("/").text().contains("href=\"/live\"")
    );
    assert!(
        !server.get("/").head.contains("script-src"),
        "no other page runs scripts"
    );
    assert!(server.get("/live.js").text().contains("EventSource"));
    let events = events_until(&server, "\n\n\r\n");
    assert!(
        events.contains("text/event-stream") && events.contains("data: {\"number\":7}\n\n"),
        "{events}"
    );
    let frame = server.get("/live/frame.jpg");
    assert_eq!(
        (frame.status, frame.body.as_slice()),
        (200, b"an image".as_slice())
    );
    assert_eq!(
        (frame.header("x-wingd-frame"), frame.header("x-wingd-size")),
        (Some("7"), Some("40x30"))
    );
}

#[test]
fn without_a_recorder_the_page_says_so() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = server(store.path(), &store.path().join("nobody.sock"));
    let events = events_until(&server, "event: down");
    assert!(events.contains("nobody.sock"), "{events}");
    assert_eq!(server.get("/live/frame.jpg").status, 503);
    let unknown = Server::start(store.path());
    assert!(unknown.get("/live").text().contains("--live-socket"));
    assert_eq!(unknown.get("/live/events").status, 404);
}
