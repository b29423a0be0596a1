//! The wing as it is measured: results relayed from the recorder's live socket to browsers.
//!
//! A browser that is slow misses results, and stops nobody.

use std::future::Future;
use std::io;
use std::path::Path;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{Html, IntoResponse, Response};
use base64::Engine;
use serde::Deserialize;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::mpsc::{Sender, channel, error::TrySendError};
use tokio::sync::watch;

use super::send::Chunks;
use super::{Context, Refusal, pages};

/// Browsers that may watch at a time.
pub(super) const WATCHERS: usize = 16;
/// Results that wait for a slow browser.
const WAITING: usize = 4;
/// Before a recorder that is not there is called again.
const AGAIN: Duration = Duration::from_secs(2);
/// A recorder tells its state every second; after so long without a line it hangs.
const SILENCE: Duration = Duration::from_secs(4);
/// For a browser that finds no place: it is to come again after, ms.
const COME_AGAIN_MS: u32 = 5000;
/// For a picture of the frame.
const PICTURE_TIME: Duration = Duration::from_secs(5);
const SCRIPT: &str = include_str!("pages/live.js");
const PLOTS: &str = include_str!("pages/live-plot.js");
/// Its own script, and pictures that it has fetched.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; connect-src 'self'; \
     img-src 'self' data: blob:; frame-ancestors 'none'";

pub(super) async fn page(State(shared): Context) -> Response {
    let policy = [(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY))];
    (policy, Html(pages::live(shared.site.live.is_some()).into_string())).into_response()
}

pub(super) async fn script() -> Response {
    ([(header::CONTENT_TYPE, "text/javascript; charset=utf-8")], SCRIPT).into_response()
}

/// What the script draws with.
pub(super) async fn plots() -> Response {
    ([(header::CONTENT_TYPE, "text/javascript; charset=utf-8")], PLOTS).into_response()
}

/// Server-sent events: one object of JSON per result; `state` every second, `down` with a sentence while no recorder answers.
/// Where so many watch that there is no place, one event `full`, and the end.
pub(super) async fn events(State(shared): Context) -> Result<Response, Refusal> {
    let socket = shared.site.live.clone().ok_or(Refusal::NotFound)?;
    let (sender, receiver) = channel(WAITING);
    let Ok(permit) = shared.watchers.clone().try_acquire_owned() else {
        return Ok(stream(full()));
    };
    let closing = shared.closing.clone();
    tokio::spawn(async move {
        let _permit = permit;
        relay(&socket, &sender, closing).await;
    });
    Ok(stream(Body::new(Chunks(receiver))))
}

fn stream(body: Body) -> Response {
    let mut response = Response::new(body);
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    response
}

/// A refusal by its status would be the last that the browser asks.
fn full() -> Body {
    let why = format!("{WATCHERS} browsers watch already, which is the limit");
    let said = serde_json::json!({ "reason": why });
    format!("retry: {COME_AGAIN_MS}\nevent: full\ndata: {said}\n\n").into()
}

/// A small picture of the newest frame; its number and the frame's size are in the head.
pub(super) async fn frame(State(shared): Context) -> Result<Response, Refusal> {
    let socket = shared.site.live.clone().ok_or(Refusal::NotFound)?;
    let _one_of_few = shared.pictures_live.acquire().await.map_err(|e| Refusal::Failed(e.to_string()))?;
    let asked = tokio::time::timeout(PICTURE_TIME, ask_frame(&socket)).await;
    let missing = |why: &str| (StatusCode::SERVICE_UNAVAILABLE, why.to_owned()).into_response();
    let Ok(Ok(picture)) = asked else { return Ok(missing("The recorder has no live frame now.")) };
    let jpeg = base64::engine::general_purpose::STANDARD.decode(&picture.jpeg);
    let jpeg = jpeg.map_err(|e| Refusal::Failed(e.to_string()))?;
    let mut response = Response::new(Body::from(jpeg));
    let value = |text: String| HeaderValue::try_from(text).map_err(|e| Refusal::Failed(e.to_string()));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg"));
    headers.insert(HeaderName::from_static("x-wingd-frame"), value(picture.frame.to_string())?);
    let size = format!("{}x{}", picture.width, picture.height);
    headers.insert(HeaderName::from_static("x-wingd-size"), value(size)?);
    Ok(response)
}

/// A line of the live socket that brings a picture.
#[derive(Deserialize)]
struct Picture {
    frame: u64,
    width: usize,
    height: usize,
    jpeg: String,
}

async fn connect(socket: &Path) -> io::Result<(Lines<BufReader<OwnedReadHalf>>, OwnedWriteHalf)> {
    let (read, write) = UnixStream::connect(socket).await?.into_split();
    Ok((BufReader::new(read).lines(), write))
}

async fn ask_frame(socket: &Path) -> io::Result<Picture> {
    let (mut lines, mut write) = connect(socket).await?;
    write.write_all(b"frame\n").await?;
    while let Some(line) = lines.next_line().await? {
        if let Some(picture) = picture(&line) {
            return serde_json::from_str(picture).map_err(Into::into);
        }
    }
    Err(io::ErrorKind::UnexpectedEof.into())
}

/// A line that brings a picture, which begins so.
fn picture(line: &str) -> Option<&str> {
    line.starts_with("{\"frame\":").then_some(line)
}

/// What a line that brings the state says.
fn state(line: &str) -> Option<&str> {
    line.strip_prefix("{\"state\":")?.strip_suffix('}')
}

fn down(why: &str) -> Bytes {
    let down = serde_json::json!({ "reason": why });
    format!("event: down\ndata: {down}\n\n").into()
}

/// Until the browser goes or the server stops.
async fn relay(socket: &Path, to: &Sender<io::Result<Bytes>>, mut closing: watch::Receiver<bool>) {
    let work = async {
        while !to.is_closed() {
            let why = match listen(socket, to).await {
                Ok(()) => "the recorder has ended, or live mode is off".to_owned(),
                Err(error) => format!("no recorder in live mode answers at {}: {error}", socket.display()),
            };
            if to.send(Ok(down(&why))).await.is_err() {
                return;
            }
            tokio::time::sleep(AGAIN).await;
        }
    };
    tokio::select! { () = work => {}, _ = closing.wait_for(|closing| *closing) => {} }
}

/// `Ok`: the other side has ended, or the browser.
async fn listen(socket: &Path, to: &Sender<io::Result<Bytes>>) -> io::Result<()> {
    // The writing half is kept: its end would be heard.
    let (mut lines, mut write) = connect(socket).await?;
    write.write_all(b"state\n").await?;
    loop {
        let event = match tokio::time::timeout(SILENCE, lines.next_line()).await {
            Err(_) => down("the recorder hangs: it is there, and says nothing"),
            Ok(line) => match line? {
                None => return Ok(()),
                Some(line) if picture(&line).is_some() => continue,
                Some(line) => match state(&line) {
                    Some(state) => format!("event: state\ndata: {state}\n\n").into(),
                    None => format!("data: {line}\n\n").into(),
                },
            },
        };
        if let Err(TrySendError::Closed(_)) = to.try_send(Ok(event)) {
            return Ok(());
        }
    }
}

/// Pictures that are asked for at a time.
pub(super) const PICTURES: usize = 4;

/// The server stops: whoever looks at the second ends.
pub(super) fn stopping(
    shutdown: impl Future<Output = ()>,
) -> (impl Future<Output = ()>, watch::Receiver<bool>) {
    let (closing, closed) = watch::channel(false);
    let then = async move {
        shutdown.await;
        // Nobody watching is no error.
        let _ = closing.send(true);
    };
    (then, closed)
}
