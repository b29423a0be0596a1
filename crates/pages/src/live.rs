//! Live page: results and states of the recorder, sent to browsers.
//!
//! A slow browser misses results and delays nobody else.

use std::future::Future;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc::{Sender, channel, error::TrySendError};
use tokio::sync::watch;

use super::recorder::{LiveMessage, LiveResults, Recorder};
use super::send::ChunkBody;
use super::{Refusal, ServerContext, ServerState, pages, policy};

/// Maximum number of browsers that watch at the same time.
pub(super) const MAX_WATCHERS: usize = 16;
/// Maximum number of results queued for a slow browser.
const MAX_WAITING_RESULTS: usize = 4;
/// Timeout for an event of the recorder, which sends its state every second.
const MAX_SILENCE: Duration = Duration::from_secs(4);
/// Pause after which a browser that found the server full may retry, ms.
const RETRY_MS: u32 = 5000;
/// Timeout for the image of the newest frame.
const PICTURE_TIMEOUT: Duration = Duration::from_secs(5);
/// Script of the page.
pub(super) const SCRIPT: &str = include_str!("pages/live.js");

/// Returns the live results of the recorder in this process.
fn live_results(shared: &ServerState) -> Result<Arc<dyn LiveResults>, Refusal> {
    let recorder: Option<&Arc<dyn Recorder>> = shared.site.recorder.as_ref();
    recorder
        .and_then(|recorder| recorder.live())
        .ok_or(Refusal::NotFound)
}

pub(super) async fn live_page(State(shared): ServerContext) -> Response {
    policy::scripted_page(pages::live_page(live_results(&shared).is_ok()))
}

/// Sends server-sent events: one JSON object per result, `state` every second, `down` with a reason while no recorder
/// answers. If the maximum number of browsers is reached, sends one event `full` and ends.
pub(super) async fn live_events(State(shared): ServerContext) -> Result<Response, Refusal> {
    let results = live_results(&shared)?;
    let (sender, receiver) = channel(MAX_WAITING_RESULTS);
    let Ok(permit) = shared.watchers.clone().try_acquire_owned() else {
        return Ok(event_stream_response(full_event()));
    };
    let closing = shared.closing.clone();
    tokio::spawn(async move {
        let _permit = permit;
        send_events(results.as_ref(), &sender, closing).await;
    });
    Ok(event_stream_response(Body::new(ChunkBody(receiver))))
}

fn event_stream_response(body: Body) -> Response {
    let mut response = Response::new(body);
    response.headers_mut().insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("text/event-stream"),
    );
    response
}

/// Returns the event `full`. A refusal by HTTP status would stop the browser from retrying.
fn full_event() -> Body {
    let why = format!("{MAX_WATCHERS} browsers are already watching, which is the maximum");
    let data = serde_json::json!({ "reason": why });
    format!("retry: {RETRY_MS}\nevent: full\ndata: {data}\n\n").into()
}

/// Sends a small image of the newest frame; its headers hold the frame number and the frame's size.
pub(super) async fn newest_frame(State(shared): ServerContext) -> Result<Response, Refusal> {
    let results = live_results(&shared)?;
    let _one_of_few = shared
        .pictures_live
        .acquire()
        .await
        .map_err(|e| Refusal::Failed(e.to_string()))?;
    let made = tokio::task::spawn_blocking(move || results.newest_frame());
    let Ok(Ok(Some(picture))) = tokio::time::timeout(PICTURE_TIMEOUT, made).await else {
        let why = "The recorder has no live frame at the moment.";
        return Ok((StatusCode::SERVICE_UNAVAILABLE, why).into_response());
    };
    let mut response = Response::new(Body::from(picture.jpeg.clone()));
    let value =
        |text: String| HeaderValue::try_from(text).map_err(|e| Refusal::Failed(e.to_string()));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg"));
    headers.insert(
        HeaderName::from_static("x-wingd-frame"),
        value(picture.number.to_string())?,
    );
    let size = format!("{}x{}", picture.size.0, picture.size.1);
    headers.insert(HeaderName::from_static("x-wingd-size"), value(size)?);
    Ok(response)
}

fn down_event(why: &str) -> Bytes {
    let down = serde_json::json!({ "reason": why });
    format!("event: down\ndata: {down}\n\n").into()
}

/// Sends events until the browser disconnects, the recorder ends or the server stops.
async fn send_events(
    results: &dyn LiveResults,
    to: &Sender<io::Result<Bytes>>,
    mut closing: watch::Receiver<bool>,
) {
    let events = results.subscribe();
    let past = format!("event: past\ndata: {}\n\n", results.history());
    let begin = [past.into_bytes(), state_event(&results.state()).to_vec()].concat();
    let work = async {
        if to.try_send(Ok(begin.into())).is_ok() {
            send_subscribed(events, to).await;
        }
    };
    tokio::select! { () = work => {}, _ = closing.wait_for(|closing| *closing) => {} }
}

async fn send_subscribed(mut events: Receiver<Arc<LiveMessage>>, to: &Sender<io::Result<Bytes>>) {
    loop {
        let event = match tokio::time::timeout(MAX_SILENCE, events.recv()).await {
            Err(_) => down_event("the recorder hangs: it runs but has no new state"),
            Ok(Err(RecvError::Lagged(_))) => continue,
            Ok(Err(RecvError::Closed)) => {
                let _ = to.send(Ok(down_event("the recorder has stopped"))).await;
                return;
            }
            Ok(Ok(message)) if message.is_state => state_event(&message.json),
            Ok(Ok(message)) => format!("data: {}\n\n", message.json).into(),
        };
        if let Err(TrySendError::Closed(_)) = to.try_send(Ok(event)) {
            return;
        }
    }
}

fn state_event(state: &str) -> Bytes {
    format!("event: state\ndata: {state}\n\n").into()
}

/// Maximum number of images requested at the same time.
pub(super) const MAX_PICTURES: usize = 4;

/// Wraps the shutdown future; the second value signals the shutdown to event streams.
pub(super) fn shutdown_signal(
    shutdown: impl Future<Output = ()>,
) -> (impl Future<Output = ()>, watch::Receiver<bool>) {
    let (closing, closed) = watch::channel(false);
    let then = async move {
        shutdown.await;
        // It is not an error if nobody is watching.
        let _ = closing.send(true);
    };
    (then, closed)
}
