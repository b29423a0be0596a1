//! Read-only pages over a store: lists, downloads by range, a flight as one archive.
//!
//! | path | response |
//! |---|---|
//! | `/` | flights |
//! | `/flights/{flight}` | the flight's series |
//! | `/flights/{flight}/{series}` | frames and results of the series, 50 frames a page (`?page=2`) |
//! | `/frames/{flight}/{series}/{file}` | one frame with its markers |
//! | `/thumb/…svg`, `/overlay/…svg` | a frame with its markers drawn, small and large |
//! | `/files/{flight}/...` | files of the store, unchanged; frames and manifests by range |
//! | `/tar/{flight}.tar` | the flight as one archive, by range; unpacked it is a store |
//! | `/bundle/{flight}.json` | the archive's files: name, length, SHA-256, offset of the bytes |
//! | `/live`, `/live.js`, `/figure.js` | the live page and its scripts |
//! | `/live/events` | live results as server-sent events |
//! | `/live/frame.jpg` | a small image of the newest frame |
//! | `/status.json` | contents of the store, and the daemon's state if one runs |
//!
//! The pages load nothing from other servers, change nothing, and no name leads out of the store. [`mark`] is a separate
//! server for marking undetected markers manually.

pub mod access;
mod archive;
mod files;
mod frames;
mod limits;
mod live;
pub mod pages;
pub mod policy;
pub mod recorder;
pub mod section;
mod send;
pub mod server;
pub mod tls;

use std::future::Future;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{Html, IntoResponse, Json, Response};
use axum::routing::get;
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use access::Access;
use limits::AnswerLimits;
use recorder::Recorder;
use wingd_evaluation::figures::FIGURE_SCRIPT;
use wingd_evaluation::results::overview;
use wingd_store::bundle;
use wingd_store::receive::Listing;
use wingd_store::{RealDisk, StoreError, catalogue};

/// Data that the pages show.
#[derive(Clone)]
pub struct Site {
    /// Root folder of the store.
    pub root: PathBuf,
    /// Recorder that runs in this process.
    pub recorder: Option<Arc<dyn Recorder>>,
}

/// Maximum number of threads that read files and the store for pages: the recorder's service may have 128 tasks.
const MAX_THREADS: usize = 8;

/// Creates the event loop of the pages, for one thread.
///
/// # Errors
/// Returns an error if the machine has no resources for it.
pub fn page_runtime() -> io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .max_blocking_threads(MAX_THREADS)
        .enable_all()
        .build()
}

/// Maximum number of archives sent at the same time; a small computer records meanwhile.
const MAX_ARCHIVES: usize = 2;

/// Timeout for an archive's permit; after it the client is asked to retry.
const PERMIT_TIMEOUT: Duration = Duration::from_secs(2);

/// Maximum number of frames decoded for display at the same time.
const MAX_PICTURES: usize = 1;

struct ServerState {
    site: Site,
    series: frames::SeriesCache,
    access: Arc<Access>,
    archives: Arc<Semaphore>,
    pictures: Semaphore,
    watchers: Arc<Semaphore>,
    pictures_live: Semaphore,
    /// Becomes true when the server stops.
    closing: tokio::sync::watch::Receiver<bool>,
}

type ServerContext = State<Arc<ServerState>>;

/// Method and headers of a request.
type RequestHead = (Method, HeaderMap);

/// Reason for an error page.
#[derive(Debug)]
pub enum Refusal {
    NotFound,
    Busy,
    Failed(String),
}

impl From<StoreError> for Refusal {
    fn from(error: StoreError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let (status, text) = match self {
            Self::NotFound => (
                StatusCode::NOT_FOUND,
                "This page or file does not exist.".to_owned(),
            ),
            Self::Busy => (
                StatusCode::SERVICE_UNAVAILABLE,
                "Other downloads are running; try again later.".to_owned(),
            ),
            Self::Failed(reason) => (StatusCode::INTERNAL_SERVER_ERROR, reason),
        };
        (status, Html(pages::message_page(&text).into_string())).into_response()
    }
}

/// Serves the pages until `shutdown` completes; responses in progress then have a few seconds to finish.
pub async fn serve(
    site: Site,
    access: Access,
    listener: TcpListener,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let access = Arc::new(access);
    let (shutdown, closing) = live::shutdown_signal(shutdown);
    server::accept_connections(
        build_router(site, access.clone(), closing),
        access,
        listener,
        shutdown,
    )
    .await
}

fn build_router(
    site: Site,
    access: Arc<Access>,
    closing: tokio::sync::watch::Receiver<bool>,
) -> Router {
    let archives = Arc::new(Semaphore::new(MAX_ARCHIVES));
    let shared = Arc::new(ServerState {
        site,
        series: frames::SeriesCache::default(),
        access: access.clone(),
        archives,
        pictures: Semaphore::new(MAX_PICTURES),
        watchers: Arc::new(Semaphore::new(live::MAX_WATCHERS)),
        pictures_live: Semaphore::new(live::MAX_PICTURES),
        closing,
    });
    let router = Router::new()
        .route("/", get(index_page))
        .route("/flights/{flight}", get(flight_page))
        .route("/flights/{flight}/{series}", get(frames::series_page))
        .route("/frames/{flight}/{series}/{file}", get(frames::frame_page))
        .route(
            "/thumb/{flight}/{series}/{file}",
            get(|state, path, head| frames::drawn_frame(state, path, head, frames::THUMBNAIL_PX)),
        )
        .route(
            "/overlay/{flight}/{series}/{file}",
            get(|state, path, head| frames::drawn_frame(state, path, head, frames::OVERLAY_PX)),
        )
        .route("/files/{flight}/{file}", get(send_flight_file))
        .route("/files/{flight}/{series}/{file}", get(send_series_file))
        .route("/tar/{name}", get(send_tar))
        .route("/bundle/{name}", get(send_file_listing))
        .route("/status.json", get(send_status))
        .route_layer(axum::middleware::from_fn_with_state(
            AnswerLimits::new(access.clone()),
            limits::limit_answers,
        ))
        .route("/live", get(live::live_page))
        .route(
            "/live.js",
            get(async || policy::script_response(live::SCRIPT)),
        )
        .route(
            "/figure.js",
            get(async || policy::script_response(FIGURE_SCRIPT)),
        )
        .route("/live/events", get(live::live_events))
        .route("/live/frame.jpg", get(live::newest_frame))
        .fallback(async || Refusal::NotFound);
    add_common_layers(router, access).with_state(shared)
}

/// Adds the access rules and the headers that every response has.
pub fn add_common_layers<S: Clone + Send + Sync + 'static>(
    router: Router<S>,
    access: Arc<Access>,
) -> Router<S> {
    router
        .layer(axum::middleware::from_fn_with_state(
            access,
            access::check_access,
        ))
        .layer(axum::middleware::map_response(set_headers))
}

/// A handler may have set a cache rule and policy.
async fn set_headers(mut response: Response) -> Response {
    let text = HeaderValue::from_static;
    let headers = response.headers_mut();
    headers
        .entry(header::CACHE_CONTROL)
        .or_insert(text("no-store"));
    headers
        .entry(header::CONTENT_SECURITY_POLICY)
        .or_insert(text(policy::PLAIN));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, text("nosniff"));
    headers.insert(header::REFERRER_POLICY, text("no-referrer"));
    response
}

/// Runs file access on a thread of its own, so that a slow disk delays no other response.
async fn run_blocking<T: Send + 'static>(
    shared: Arc<ServerState>,
    work: impl FnOnce(&Site) -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Refusal> {
    let task = tokio::task::spawn_blocking(move || work(&shared.site));
    task.await.map_err(|e| Refusal::Failed(e.to_string()))?
}

async fn index_page(State(shared): ServerContext) -> Result<Html<String>, Refusal> {
    run_blocking(shared, |site| {
        Ok(Html(pages::index_page(site)?.into_string()))
    })
    .await
}

async fn flight_page(
    State(shared): ServerContext,
    Path(flight): Path<String>,
    headers: HeaderMap,
) -> Result<Html<String>, Refusal> {
    let scheme = if shared.access.tls().is_some() {
        "https"
    } else {
        "http"
    };
    let host = headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok())
        .unwrap_or("localhost");
    let address = format!("{scheme}://{host}");
    run_blocking(shared, move |site| {
        let found = files::check_flight(site, &flight)?;
        let overview = overview::read_overview(&RealDisk, &found)?;
        Ok(Html(pages::flight_page(&overview, &address).into_string()))
    })
    .await
}

async fn send_flight_file(
    State(shared): ServerContext,
    Path((flight, file)): Path<(String, String)>,
    head: RequestHead,
) -> Result<Response, Refusal> {
    run_blocking(shared, move |site| {
        files::flight_file_content(site, &flight, &file)?.respond(&head)
    })
    .await
}

async fn send_series_file(
    State(shared): ServerContext,
    Path((flight, series, file)): Path<(String, String, String)>,
    head: RequestHead,
) -> Result<Response, Refusal> {
    run_blocking(shared, move |site| {
        files::series_file_content(site, &flight, &series, &file)?.respond(&head)
    })
    .await
}

/// Waits for an archive permit. The permit of a response that was just sent is released a moment later.
async fn archive_permit(shared: &ServerState) -> Result<OwnedSemaphorePermit, Refusal> {
    let waiting =
        tokio::time::timeout(PERMIT_TIMEOUT, shared.archives.clone().acquire_owned()).await;
    waiting.ok().and_then(Result::ok).ok_or(Refusal::Busy)
}

/// Sends all files of a flight as one archive, which holds a permit while it is sent.
async fn send_tar(
    State(shared): ServerContext,
    Path(name): Path<String>,
    head: RequestHead,
) -> Result<Response, Refusal> {
    let flight = name
        .strip_suffix(".tar")
        .ok_or(Refusal::NotFound)?
        .to_owned();
    let permit = archive_permit(&shared).await?;
    run_blocking(shared, move |site| {
        let found = files::check_flight(site, &flight)?;
        let bundle = bundle::bundle_flight(&RealDisk, &site.root, &found)?;
        let begun = catalogue::read_flight_manifest(&RealDisk, &found)?.started;
        let begun_s = u64::try_from(begun.utc.as_second()).unwrap_or(0);
        archive::tar_content(&flight, bundle, begun_s, permit)?.respond(&head)
    })
    .await
}

async fn send_file_listing(
    State(shared): ServerContext,
    Path(name): Path<String>,
) -> Result<Json<Listing>, Refusal> {
    let flight = name
        .strip_suffix(".json")
        .ok_or(Refusal::NotFound)?
        .to_owned();
    run_blocking(shared, move |site| {
        let found = files::check_flight(site, &flight)?;
        let bundle = bundle::bundle_flight(&RealDisk, &site.root, &found)?;
        Ok(Json(archive::archive_listing(&flight, &bundle)))
    })
    .await
}

async fn send_status(State(shared): ServerContext) -> Result<Json<Value>, Refusal> {
    let refused = shared.access.refusal_counts();
    run_blocking(shared, move |site| {
        let mut status = pages::status_json(site)?;
        if let Some(status) = status.as_object_mut() {
            status.insert("refused".to_owned(), refused);
        }
        Ok(Json(status))
    })
    .await
}
