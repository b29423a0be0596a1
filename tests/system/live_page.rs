//! Promise: the page shows the results and states of the recorder in its process, and reports if it stops.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::broadcast::{Receiver, Sender, channel};
use wingd_pages::Site;
use wingd_pages::access::Access;
use wingd_pages::recorder::{LiveMessage, LiveResults, PreviewImage, Recorder, RecorderState};

use crate::common::report_store::{solved, store_with};
use crate::http_pages::Server;

/// Recorder with one result and one frame.
struct OneResult {
    messages: Mutex<Option<Sender<Arc<LiveMessage>>>>,
    has_frame: bool,
}

impl OneResult {
    fn new(has_frame: bool) -> Arc<Self> {
        let messages = Mutex::new(Some(channel(4).0));
        Arc::new(Self {
            messages,
            has_frame,
        })
    }

    /// Sends the result as soon as somebody listens, then stops if wanted.
    fn send(self: &Arc<Self>, then_stop: bool) {
        let own = self.clone();
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(Duration::from_millis(20));
                let mut messages = own.messages.lock().unwrap();
                let Some(sender) = messages.as_ref() else {
                    return;
                };
                if sender.receiver_count() > 0 {
                    let (json, datagram) = ("{\"number\":7}".to_owned(), String::new());
                    let is_state = false;
                    let _ = sender.send(Arc::new(LiveMessage {
                        is_state,
                        json,
                        datagram,
                    }));
                    if then_stop {
                        *messages = None;
                    }
                    return;
                }
            }
        });
    }
}

impl LiveResults for OneResult {
    fn subscribe(&self) -> Receiver<Arc<LiveMessage>> {
        let messages = self.messages.lock().unwrap();
        messages.as_ref().unwrap().subscribe()
    }

    fn state(&self) -> String {
        "{\"health\":\"ok\"}".to_owned()
    }

    fn history(&self) -> String {
        "[]".to_owned()
    }

    fn newest_frame(&self) -> Option<Arc<PreviewImage>> {
        let (number, size, jpeg) = (7, (40, 30), b"an image".to_vec());
        self.has_frame
            .then(|| Arc::new(PreviewImage { number, size, jpeg }))
    }
}

struct LiveRecorder(Arc<OneResult>);

impl Recorder for LiveRecorder {
    fn state(&self) -> RecorderState {
        RecorderState {
            health: "ok".to_owned(),
            is_healthy: true,
            activity: "live".to_owned(),
            reasons: vec![],
            last_fault: None,
            next_series_s: None,
            reserve_mb: 0,
            status: serde_json::json!({ "health": "ok" }),
        }
    }

    fn live(&self) -> Option<Arc<dyn LiveResults>> {
        Some(self.0.clone())
    }
}

fn server(store: &Path, live: &Arc<OneResult>) -> Server {
    let recorder: Arc<dyn Recorder> = Arc::new(LiveRecorder(live.clone()));
    Server::serve(
        Site {
            root: store.to_owned(),
            recorder: Some(recorder),
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
fn results_and_the_frame_reach_the_page() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let live = OneResult::new(true);
    live.send(false);
    let server = server(store.path(), &live);
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
    let events = events_until(&server, "\"number\":7}");
    assert!(
        events.contains("event: state\ndata: {\"health\":\"ok\"}\n\n"),
        "{events}"
    );
    assert!(
        events.contains("text/event-stream") && events.contains("data: {\"number\":7}"),
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
fn a_recorder_that_stops_and_a_page_without_one_say_so() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let live = OneResult::new(false);
    live.send(true);
    let server = server(store.path(), &live);
    let events = events_until(&server, "event: down");
    assert!(events.contains("the recorder has stopped"), "{events}");
    assert_eq!(server.get("/live/frame.jpg").status, 503);
    let alone = Server::start(store.path());
    assert!(alone.get("/live").text().contains("Live mode is off"));
    assert_eq!(alone.get("/live/events").status, 404);
}
