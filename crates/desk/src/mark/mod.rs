//! Server for marking undetected markers manually (`wingd mark`).
//!
//! | path | response |
//! |---|---|
//! | `/`, `/mark.js` | the page |
//! | `/pictures.json` | the images and their number of marks |
//! | `/picture/{n}.png` | an image as the detector sees it |
//! | `/picture/{n}.json` | markers, predicted positions of lost ones, solutions with and without marks |
//! | `POST /picture/{n}` | adds a mark ([`MarkRequest`]); durable when the response comes, which is the new `/picture/{n}.json` |
//!
//! Posts must be JSON from the page's own origin, which no page of another site can send through its visitor's browser.

mod image_state;
mod page;
mod request;
mod storage;

use std::future::Future;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Json, Response};
use axum::routing::get;
use serde_json::{Value, json};
use tokio::net::TcpListener;

use wingd_base::clock::SystemClock;
use wingd_base::regular_file::{MAX_DATA_BYTES, read_regular_file};
use wingd_evaluation::frame_format::Format;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::pipeline::marking::{MarkingResult, MarkingSession};
use wingd_evaluation::record::Reason;
use wingd_measure::setup::Orientation;
use wingd_pages::access::Access;
use wingd_pages::{Refusal, add_common_layers, policy, server};
use wingd_store::{FrameRef, RealDisk, read_frame, sha256_hex};

pub use request::MarkRequest;
pub use storage::MarkStorage;

/// Maximum size of a request, bytes.
const MAX_REQUEST_BYTES: usize = 16 * 1024;
/// Time within which a request must arrive.
const BODY_TIMEOUT: Duration = Duration::from_secs(10);
const SCRIPT: &str = include_str!("mark.js");

/// Images to be marked, with installation, storage and default name.
pub struct Workplace {
    /// Wing and camera.
    pub installation: Installation,
    /// Orientation for images in flight. `None` for images of the wing on the ground, which are oriented one by one.
    pub orientation: Option<Orientation>,
    /// Images in the order of the page.
    pub images: Vec<MarkableImage>,
    pub storage: MarkStorage,
    /// Name of the person who marks, unless the page gives another.
    pub who: String,
    /// Standard deviation of a manual position, each coordinate, px.
    pub manual_sigma_px: f64,
}

/// Image that can be marked.
pub struct MarkableImage {
    /// Name as in results.
    pub name: String,
    pub source: ImageSource,
}

/// Location of an image.
pub enum ImageSource {
    File(PathBuf),
    /// Frame of a store, whose checksum is verified.
    Stored(Box<FrameRef>),
}

impl MarkableImage {
    /// Reads the bytes; returns them with their SHA-256 and, for a stored frame, the format.
    fn read(&self) -> Result<(Vec<u8>, String, Option<Format>), Reason> {
        match &self.source {
            ImageSource::File(path) => {
                let text = |e: io::Error| {
                    Reason::new(format!("{} cannot be read ({e})", path.display()), e)
                };
                let bytes = read_regular_file(path, MAX_DATA_BYTES).map_err(text)?;
                let digest = sha256_hex(&bytes);
                Ok((bytes, digest, None))
            }
            ImageSource::Stored(frame) => {
                let bytes = read_frame(&RealDisk, frame).map_err(Reason::from_error)?;
                let format =
                    Format::from_manifest(&frame.entry.format).map_err(Reason::from_error)?;
                Ok((bytes, frame.entry.sha256.clone(), Some(format)))
            }
        }
    }
}

/// Most recently requested image, decoded and detected.
struct OpenImage {
    number: usize,
    digest: String,
    session: MarkingSession,
    /// Result without manual marks.
    unmarked: MarkingResult,
}

struct MarkingState {
    workplace: Workplace,
    open: Option<OpenImage>,
}

struct MarkServerState {
    marking: Mutex<MarkingState>,
    clock: SystemClock,
}

type MarkContext = State<Arc<MarkServerState>>;

/// Serves the marking page until `shutdown` completes.
///
/// # Errors
/// Returns an error if the address accepts no connections.
pub async fn serve_marking(
    workplace: Workplace,
    access: Access,
    listener: TcpListener,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let access = Arc::new(access);
    let marking = Mutex::new(MarkingState {
        workplace,
        open: None,
    });
    let shared = Arc::new(MarkServerState {
        marking,
        clock: SystemClock::new(),
    });
    let router = Router::new()
        .route("/", get(mark_page))
        .route("/mark.js", get(async || policy::script_response(SCRIPT)))
        .route("/pictures.json", get(list_images))
        .route("/picture/{name}", get(send_image).post(post_mark))
        .fallback(async || Refusal::NotFound);
    let router = add_common_layers(router, access.clone()).with_state(shared);
    server::accept_connections(router, access, listener, shutdown).await
}

async fn mark_page(State(shared): MarkContext, address: Uri) -> Response {
    let marking = shared
        .marking
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let page = page::mark_page(
        &marking.workplace.storage.description(),
        &marking.workplace.who,
        address.query(),
    );
    policy::scripted_page(page)
}

async fn list_images(State(shared): MarkContext) -> Json<Value> {
    let marking = shared
        .marking
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let Workplace {
        images, storage, ..
    } = &marking.workplace;
    let line =
        |p: &MarkableImage| json!({"name": p.name, "marks": storage.image_marks(&p.name).len()});
    Json(json!({"pictures": images.iter().map(line).collect::<Vec<_>>()}))
}

/// Runs work on the marking state on a thread of its own, one request at a time.
async fn run_blocking<T: Send + 'static>(
    shared: Arc<MarkServerState>,
    work: impl FnOnce(&mut MarkingState, &SystemClock) -> Result<T, MarkRefusal> + Send + 'static,
) -> Result<T, MarkRefusal> {
    let task = tokio::task::spawn_blocking(move || {
        let mut marking = shared
            .marking
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        work(&mut marking, &shared.clock)
    });
    task.await.map_err(|e| MarkRefusal::Failed(e.to_string()))?
}

/// Error response: a sentence for the user.
enum MarkRefusal {
    /// The image does not exist.
    NotFound,
    /// The request is invalid.
    Invalid(String),
    /// The mark would replace an observation and needs confirmation.
    NeedsConfirmation(String),
    /// The operation failed.
    Failed(String),
}

impl IntoResponse for MarkRefusal {
    fn into_response(self) -> Response {
        let (status, reason) = match self {
            Self::NotFound => (
                StatusCode::NOT_FOUND,
                "this image does not exist".to_owned(),
            ),
            Self::Invalid(reason) => (StatusCode::UNPROCESSABLE_ENTITY, reason),
            Self::NeedsConfirmation(reason) => (StatusCode::CONFLICT, reason),
            Self::Failed(reason) => (StatusCode::INTERNAL_SERVER_ERROR, reason),
        };
        (status, Json(json!({ "reason": reason }))).into_response()
    }
}

async fn send_image(
    State(shared): MarkContext,
    Path(name): Path<String>,
) -> Result<Response, MarkRefusal> {
    let (number, ending) = name.split_once('.').ok_or(MarkRefusal::NotFound)?;
    let number: usize = number.parse().map_err(|_| MarkRefusal::NotFound)?;
    match ending {
        "json" => {
            let state =
                run_blocking(shared, move |marking, _| marking.opened_image_state(number)).await?;
            Ok(Json(state).into_response())
        }
        "png" => {
            let bytes = run_blocking(shared, move |marking, _| marking.image_png(number)).await?;
            Ok(([(header::CONTENT_TYPE, "image/png")], bytes).into_response())
        }
        _ => Err(MarkRefusal::NotFound),
    }
}

async fn post_mark(
    State(shared): MarkContext,
    Path(number): Path<usize>,
    headers: HeaderMap,
    body: axum::body::Body,
) -> Result<Response, MarkRefusal> {
    let body =
        tokio::time::timeout(BODY_TIMEOUT, axum::body::to_bytes(body, MAX_REQUEST_BYTES)).await;
    let body = body
        .map_err(|_| MarkRefusal::Invalid("the request was not sent completely in time".into()))?;
    let body = body.map_err(|error| MarkRefusal::Invalid(error.to_string()))?;
    if !is_same_origin(&headers) {
        return Err(MarkRefusal::Invalid(
            "marks can be added from the page of wingd mark only".into(),
        ));
    }
    let request: MarkRequest =
        serde_json::from_slice(&body).map_err(|e| MarkRefusal::Invalid(e.to_string()))?;
    let state = run_blocking(shared, move |marking, clock| {
        marking.add_marks(number, &request, clock)
    })
    .await?;
    Ok(Json(state).into_response())
}

/// Returns whether a request is JSON from this page. Browsers send JSON to another origin only after a preflight request,
/// which this server does not answer, and they send the origin of a request.
fn is_same_origin(headers: &HeaderMap) -> bool {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let is_json =
        text(header::CONTENT_TYPE).is_some_and(|kind| kind.starts_with("application/json"));
    let host = text(header::HOST).unwrap_or_default();
    let own = |origin: &str| {
        origin
            .split_once("://")
            .is_some_and(|(_, authority)| authority == host)
    };
    is_json && text(header::ORIGIN).is_none_or(own)
}

impl MarkingState {
    /// Opens an image: reads and detects it unless it is already open.
    fn open_image(&mut self, number: usize) -> Result<(&Workplace, &OpenImage), MarkRefusal> {
        if self.open.as_ref().is_none_or(|open| open.number != number) {
            let Workplace {
                installation,
                orientation,
                images,
                ..
            } = &self.workplace;
            let image = images.get(number).ok_or(MarkRefusal::NotFound)?;
            let failed = |reason: Reason| MarkRefusal::Failed(format!("{}: {reason}", image.name));
            let (bytes, digest, format) = image.read().map_err(failed)?;
            let session = MarkingSession::open(
                &image.name,
                &bytes,
                format.as_ref(),
                &installation.setup,
                orientation.as_ref(),
            );
            let session = session.map_err(failed)?;
            let unmarked = session.solve(&[], installation);
            self.open = Some(OpenImage {
                number,
                digest,
                session,
                unmarked,
            });
        }
        let open = self.open.as_ref().ok_or(MarkRefusal::NotFound)?;
        Ok((&self.workplace, open))
    }

    fn opened_image_state(&mut self, number: usize) -> Result<Value, MarkRefusal> {
        let (workplace, open) = self.open_image(number)?;
        Ok(image_state::image_state(workplace, open))
    }

    fn image_png(&mut self, number: usize) -> Result<Vec<u8>, MarkRefusal> {
        let (_, open) = self.open_image(number)?;
        image_state::encode_png(open.session.raster())
            .ok_or_else(|| MarkRefusal::Failed("the image could not be encoded".into()))
    }

    fn add_marks(
        &mut self,
        number: usize,
        request: &MarkRequest,
        clock: &SystemClock,
    ) -> Result<Value, MarkRefusal> {
        let (workplace, open) = self.open_image(number)?;
        let marks = request.to_marks(workplace, open, clock)?;
        self.workplace
            .storage
            .add(marks)
            .map_err(|e| MarkRefusal::Failed(format!("could not be stored: {e}")))?;
        self.opened_image_state(number)
    }
}
