//! The server in whose page a person marks what the detector did not find (`wingd mark`).
//!
//! | path | answers |
//! |---|---|
//! | `/`, `/mark.js` | the page |
//! | `/pictures.json` | the pictures and their marks |
//! | `/picture/{n}.png` | a picture as the detector sees it |
//! | `/picture/{n}.json` | its markers, where lost ones should be, what is solved with the marks and without |
//! | `POST /picture/{n}` | what a person says of a marker ([`Asked`]); durable when the answer comes, which is the same as above |
//!
//! What is posted is JSON of the page's own origin, which no page of another site can send through its visitor's browser.

mod answer;
mod asked;
mod kept;

use std::future::Future;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use axum::Router;
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{Html, IntoResponse, Json, Response};
use axum::routing::get;
use serde_json::{Value, json};
use tokio::net::TcpListener;

use super::access::Access;
use super::{Refusal, dressed, pages, server};
use crate::camera::Format;
use crate::clock::SystemClock;
use crate::installation::Installation;
use crate::measure::setup::Orientation;
use crate::pipeline::marking::{MarkingResult, MarkingSession};
use crate::record::Reason;
use crate::store::{FrameRef, RealDisk, read_frame, sha256_hex};

pub use asked::MarkRequest;
pub use kept::Kept;

/// What a person says is not longer, bytes.
const MAX_REQUEST_BYTES: usize = 16 * 1024;
const SCRIPT: &str = include_str!("../pages/mark.js");
/// Its own script, and pictures that it has fetched.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; connect-src 'self'; \
     img-src 'self' data: blob:; frame-ancestors 'none'";

/// What is marked, and in whose name.
pub struct Workplace {
    /// The wing and its camera.
    pub installation: Installation,
    /// Of pictures in flight; `None`: they are of the wing on ground, and an orientation is sought in each.
    pub orientation: Option<Orientation>,
    /// In order.
    pub pictures: Vec<Picture>,
    /// The marks.
    pub kept: Kept,
    /// Who marks, unless the page says otherwise.
    pub who: String,
    /// How well a hand points, standard deviation of each coordinate, px.
    pub hand_sigma_px: f64,
}

/// A picture that can be marked.
pub struct Picture {
    /// As results name it.
    pub name: String,
    /// Where it is.
    pub source: Source,
}

/// Where a picture is.
pub enum Source {
    /// A file.
    File(PathBuf),
    /// A frame of a store, whose bytes are checked.
    Stored(Box<FrameRef>),
}

impl Picture {
    /// Its bytes, their SHA-256 and how they are read.
    fn read(&self) -> Result<(Vec<u8>, String, Option<Format>), Reason> {
        match &self.source {
            Source::File(path) => {
                let text = |e: io::Error| Reason::new(format!("{} cannot be read ({e})", path.display()), e);
                let bytes = std::fs::read(path).map_err(text)?;
                let digest = sha256_hex(&bytes);
                Ok((bytes, digest, None))
            }
            Source::Stored(frame) => {
                let bytes = read_frame(&RealDisk, frame).map_err(Reason::of)?;
                let format = Format::from_manifest(&frame.entry.format).map_err(Reason::of)?;
                Ok((bytes, frame.entry.sha256.clone(), Some(format)))
            }
        }
    }
}

/// The picture that was asked for last.
struct Open {
    number: usize,
    digest: String,
    desk: MarkingSession,
    /// Without marks.
    bare: MarkingResult,
}

struct Table {
    workplace: Workplace,
    open: Option<Open>,
}

struct Shared {
    table: Mutex<Table>,
    clock: SystemClock,
}

type Context = State<Arc<Shared>>;

/// Serves until `shutdown` is done, then closes what was marked.
///
/// # Errors
/// Where the address gives no connections, or the marks cannot be closed (the next start closes them).
pub async fn serve(
    workplace: Workplace,
    access: Access,
    listener: TcpListener,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let access = Arc::new(access);
    let table = Mutex::new(Table { workplace, open: None });
    let shared = Arc::new(Shared { table, clock: SystemClock::new() });
    let router = Router::new()
        .route("/", get(page))
        .route("/mark.js", get(script))
        .route("/pictures.json", get(pictures))
        .route("/picture/{name}", get(picture).post(say))
        .layer(DefaultBodyLimit::max(MAX_REQUEST_BYTES))
        .fallback(async || Refusal::NotFound);
    let router = dressed(router, access.clone()).with_state(shared.clone());
    server::run(router, access, listener, shutdown).await?;
    let table = shared.table.lock().unwrap_or_else(PoisonError::into_inner);
    table.workplace.kept.close().map_err(io::Error::other)
}

async fn page(State(shared): Context) -> Response {
    let policy = [(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY))];
    let table = shared.table.lock().unwrap_or_else(PoisonError::into_inner);
    let page = pages::mark(&table.workplace.kept.words(), &table.workplace.who);
    (policy, Html(page.into_string())).into_response()
}

async fn script() -> Response {
    ([(header::CONTENT_TYPE, "text/javascript; charset=utf-8")], SCRIPT).into_response()
}

async fn pictures(State(shared): Context) -> Json<Value> {
    let table = shared.table.lock().unwrap_or_else(PoisonError::into_inner);
    let Workplace { pictures, kept, .. } = &table.workplace;
    let line = |p: &Picture| json!({"name": p.name, "marks": kept.of(&p.name).len()});
    Json(json!({"pictures": pictures.iter().map(line).collect::<Vec<_>>()}))
}

/// Work on the table, on a thread of its own: one at a time.
async fn blocking<T: Send + 'static>(
    shared: Arc<Shared>,
    work: impl FnOnce(&mut Table, &SystemClock) -> Result<T, Refused> + Send + 'static,
) -> Result<T, Refused> {
    let task = tokio::task::spawn_blocking(move || {
        let mut table = shared.table.lock().unwrap_or_else(PoisonError::into_inner);
        work(&mut table, &shared.clock)
    });
    task.await.map_err(|e| Refused::Failed(e.to_string()))?
}

/// Why there is no answer: a sentence for the person.
enum Refused {
    /// There is no such picture.
    NotFound,
    /// What was said cannot be meant.
    Wrong(String),
    /// It would stand for what is there, and nobody said that it may.
    Asks(String),
    /// It could not be done.
    Failed(String),
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        let (status, reason) = match self {
            Self::NotFound => (StatusCode::NOT_FOUND, "there is no such picture".to_owned()),
            Self::Wrong(reason) => (StatusCode::UNPROCESSABLE_ENTITY, reason),
            Self::Asks(reason) => (StatusCode::CONFLICT, reason),
            Self::Failed(reason) => (StatusCode::INTERNAL_SERVER_ERROR, reason),
        };
        (status, Json(json!({ "reason": reason }))).into_response()
    }
}

async fn picture(State(shared): Context, Path(name): Path<String>) -> Result<Response, Refused> {
    let (number, ending) = name.split_once('.').ok_or(Refused::NotFound)?;
    let number: usize = number.parse().map_err(|_| Refused::NotFound)?;
    match ending {
        "json" => {
            let state = blocking(shared, move |table, _| table.state(number)).await?;
            Ok(Json(state).into_response())
        }
        "png" => {
            let bytes = blocking(shared, move |table, _| table.png(number)).await?;
            Ok(([(header::CONTENT_TYPE, "image/png")], bytes).into_response())
        }
        _ => Err(Refused::NotFound),
    }
}

async fn say(
    State(shared): Context,
    Path(number): Path<usize>,
    headers: HeaderMap,
    body: axum::body::Bytes,
) -> Result<Response, Refused> {
    if !is_of_this_page(&headers) {
        return Err(Refused::Wrong("this can be said from the page of wingd mark alone".into()));
    }
    let asked: MarkRequest = serde_json::from_slice(&body).map_err(|e| Refused::Wrong(e.to_string()))?;
    let state = blocking(shared, move |table, clock| table.say(number, &asked, clock)).await?;
    Ok(Json(state).into_response())
}

/// JSON is sent across origins only after a question that nothing here answers; and browsers say whence a request comes.
fn is_of_this_page(headers: &HeaderMap) -> bool {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let is_json = text(header::CONTENT_TYPE).is_some_and(|kind| kind.starts_with("application/json"));
    let host = text(header::HOST).unwrap_or_default();
    let own = |origin: &str| origin.split_once("://").is_some_and(|(_, of)| of == host);
    is_json && text(header::ORIGIN).is_none_or(own)
}

impl Table {
    /// The picture, read and detected where it is not the one that lies there.
    fn open(&mut self, number: usize) -> Result<(&Workplace, &Open), Refused> {
        if self.open.as_ref().is_none_or(|open| open.number != number) {
            let Workplace { installation, orientation, pictures, .. } = &self.workplace;
            let picture = pictures.get(number).ok_or(Refused::NotFound)?;
            let failed = |reason: Reason| Refused::Failed(format!("{}: {reason}", picture.name));
            let (bytes, digest, format) = picture.read().map_err(failed)?;
            let desk = MarkingSession::open(
                &picture.name,
                &bytes,
                format.as_ref(),
                installation,
                orientation.as_ref(),
            );
            let desk = desk.map_err(failed)?;
            let bare = desk.solve(&[], installation);
            self.open = Some(Open { number, digest, desk, bare });
        }
        let open = self.open.as_ref().ok_or(Refused::NotFound)?;
        Ok((&self.workplace, open))
    }

    fn state(&mut self, number: usize) -> Result<Value, Refused> {
        let (workplace, open) = self.open(number)?;
        Ok(answer::state(workplace, open))
    }

    fn png(&mut self, number: usize) -> Result<Vec<u8>, Refused> {
        let (_, open) = self.open(number)?;
        answer::png(open.desk.raster()).ok_or_else(|| Refused::Failed("the picture cannot be written".into()))
    }

    fn say(&mut self, number: usize, asked: &MarkRequest, clock: &SystemClock) -> Result<Value, Refused> {
        let (workplace, open) = self.open(number)?;
        let marks = asked.marks(workplace, open, clock)?;
        self.workplace.kept.add(marks).map_err(|e| Refused::Failed(format!("not kept: {e}")))?;
        self.state(number)
    }
}
