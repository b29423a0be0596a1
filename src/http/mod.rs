//! Read-only pages over a store: lists, downloads by range, a flight as one archive, the report.
//!
//! | path | answers |
//! |---|---|
//! | `/` | flights |
//! | `/flights/{flight}` | its series |
//! | `/flights/{flight}/{series}` | its frames and results |
//! | `/frames/{flight}/{series}/{file}` | one frame with its markers |
//! | `/thumb/…svg`, `/overlay/…svg` | a frame with its markers drawn, small and large |
//! | `/results/{flight}.jsonl` | the results of all its series |
//! | `/files/{flight}/...` | files as they lie in the store; frames and manifests by range |
//! | `/tar/{flight}.tar` | the flight as one archive, by range: unpacked it is a store |
//! | `/bundle/{flight}.json` | the archive's files: name, length, SHA-256, where its bytes begin |
//! | `/report/{flight}` | the report |
//! | `/live`, `/live.js`, `/live-plot.js` | the wing as it is measured |
//! | `/live/events` | its results as server-sent events |
//! | `/live/frame.jpg` | a small picture of the newest frame |
//! | `/status.json` | what the store holds, and the daemon's state where one runs |
//!
//! Nothing comes from outside, nothing can be changed, and no name leads out of the store. [`mark`] is a server of its own,
//! in whose pages a person marks what the detector did not find.

pub mod access;
mod archive;
pub mod client;
pub mod fetch;
mod files;
mod frames;
mod live;
pub mod mark;
mod pages;
mod policy;
pub mod section;
mod send;
mod server;
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
use tower_http::set_header::SetResponseHeaderLayer;

use crate::daemon::StatusBoard;
use crate::measure::setup::Setup;
use crate::report::html;
use crate::report::overview;
use crate::report::source::{self, Choice};
use crate::store::bundle::{self, FlightBundle};
use crate::store::receive::Listing;
use crate::store::{FlightRef, RealDisk, StoreError, catalogue};
use access::Access;
use send::Content;

/// What is served.
#[derive(Clone)]
pub struct Site {
    /// The store.
    pub root: PathBuf,
    /// For the report's ground shape and lines of sight.
    pub setup: Option<Setup>,
    /// The daemon's state, where one runs.
    pub status: Option<StatusBoard>,
    /// Where a recorder in live mode gives out its results.
    pub live: Option<PathBuf>,
}

/// Archives that are streamed at once; a small computer records meanwhile.
const ARCHIVES: usize = 2;

/// For an archive's permit before a client is to come again.
const PERMIT_TIME: Duration = Duration::from_secs(2);

/// Reports that are made at once: each may take a flight's worth of memory.
const REPORTS: usize = 1;

/// Frames that are decoded at once, to be shown.
const PICTURES: usize = 1;

struct Shared {
    site: Site,
    access: Arc<Access>,
    archives: Arc<Semaphore>,
    reports: Semaphore,
    pictures: Semaphore,
    watchers: Arc<Semaphore>,
    pictures_live: Semaphore,
    /// True once the server stops.
    closing: tokio::sync::watch::Receiver<bool>,
}

type Context = State<Arc<Shared>>;

/// Method and headers of a request.
type RequestHead = (Method, HeaderMap);

/// Why there is no page.
#[derive(Debug)]
enum Refusal {
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
            Self::NotFound => (StatusCode::NOT_FOUND, "There is no such page or file.".to_owned()),
            Self::Busy => {
                (StatusCode::SERVICE_UNAVAILABLE, "Other downloads are running; try again later.".to_owned())
            }
            Self::Failed(reason) => (StatusCode::INTERNAL_SERVER_ERROR, reason),
        };
        (status, Html(pages::message(&text).into_string())).into_response()
    }
}

/// Serves until `shutdown` is done; answers under way have a few seconds to end.
pub async fn serve(
    site: Site,
    access: Access,
    listener: TcpListener,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let access = Arc::new(access);
    let (shutdown, closing) = live::stopping(shutdown);
    server::run(router(site, access.clone(), closing), access, listener, shutdown).await
}

fn router(site: Site, access: Arc<Access>, closing: tokio::sync::watch::Receiver<bool>) -> Router {
    let archives = Arc::new(Semaphore::new(ARCHIVES));
    let shared = Arc::new(Shared {
        site,
        access: access.clone(),
        archives,
        reports: Semaphore::new(REPORTS),
        pictures: Semaphore::new(PICTURES),
        watchers: Arc::new(Semaphore::new(live::WATCHERS)),
        pictures_live: Semaphore::new(live::PICTURES),
        closing,
    });
    let router = Router::new()
        .route("/", get(index))
        .route("/flights/{flight}", get(flight))
        .route("/flights/{flight}/{series}", get(frames::series))
        .route("/frames/{flight}/{series}/{file}", get(frames::frame))
        .route(
            "/thumb/{flight}/{series}/{file}",
            get(|state, path, asked| frames::drawn(state, path, asked, frames::THUMB)),
        )
        .route(
            "/overlay/{flight}/{series}/{file}",
            get(|state, path, asked| frames::drawn(state, path, asked, frames::LARGE)),
        )
        .route("/results/{name}", get(results))
        .route("/files/{flight}/{file}", get(flight_file))
        .route("/files/{flight}/{series}/{file}", get(series_file))
        .route("/tar/{name}", get(tar))
        .route("/bundle/{name}", get(listing))
        .route("/report/{flight}", get(report))
        .route("/live", get(live::page))
        .route("/live.js", get(live::script))
        .route("/live-plot.js", get(live::plots))
        .route("/live/events", get(live::events))
        .route("/live/frame.jpg", get(live::frame))
        .route("/status.json", get(status))
        .fallback(async || Refusal::NotFound);
    dressed(router, access).with_state(shared)
}

/// With the rules of who gets in, and the heads that every answer has.
fn dressed<S: Clone + Send + Sync + 'static>(router: Router<S>, access: Arc<Access>) -> Router<S> {
    let header = |name, value| SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value));
    router
        .layer(axum::middleware::from_fn_with_state(access, access::check))
        .layer(SetResponseHeaderLayer::if_not_present(
            header::CACHE_CONTROL,
            HeaderValue::from_static("no-store"),
        ))
        .layer(SetResponseHeaderLayer::if_not_present(
            header::CONTENT_SECURITY_POLICY,
            HeaderValue::from_static(policy::PLAIN),
        ))
        .layer(header(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(header(header::REFERRER_POLICY, "no-referrer"))
}

/// Files are read on a thread of their own, so that a slow disk stops no other answer.
async fn blocking<T: Send + 'static>(
    shared: Arc<Shared>,
    work: impl FnOnce(&Site) -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Refusal> {
    let task = tokio::task::spawn_blocking(move || work(&shared.site));
    task.await.map_err(|e| Refusal::Failed(e.to_string()))?
}

async fn index(State(shared): Context) -> Result<Html<String>, Refusal> {
    blocking(shared, |site| Ok(Html(pages::index(site)?.into_string()))).await
}

async fn flight(
    State(shared): Context,
    Path(flight): Path<String>,
    headers: HeaderMap,
) -> Result<Html<String>, Refusal> {
    let scheme = if shared.access.tls().is_some() { "https" } else { "http" };
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or("localhost");
    let address = format!("{scheme}://{host}");
    blocking(shared, move |site| {
        let found = files::check_flight(site, &flight)?;
        let overview = overview::flight(&RealDisk, &found)?;
        Ok(Html(pages::flight(&overview, &address).into_string()))
    })
    .await
}

async fn flight_file(
    State(shared): Context,
    Path((flight, file)): Path<(String, String)>,
    asked: RequestHead,
) -> Result<Response, Refusal> {
    blocking(shared, move |site| files::in_flight(site, &flight, &file)?.answer(&asked)).await
}

async fn series_file(
    State(shared): Context,
    Path((flight, series, file)): Path<(String, String, String)>,
    asked: RequestHead,
) -> Result<Response, Refusal> {
    blocking(shared, move |site| files::in_series(site, &flight, &series, &file)?.answer(&asked)).await
}

/// One of the archives' permits. That of an answer that has just been sent comes back a moment later.
async fn permit(shared: &Shared) -> Result<OwnedSemaphorePermit, Refusal> {
    let waiting = tokio::time::timeout(PERMIT_TIME, shared.archives.clone().acquire_owned()).await;
    waiting.ok().and_then(Result::ok).ok_or(Refusal::Busy)
}

/// All files of a flight as one answer, which holds a permit while it is sent; the `name` ends like this.
async fn bundled(
    shared: Arc<Shared>,
    (name, ending): (String, &str),
    asked: RequestHead,
    content: fn(&FlightRef, FlightBundle, OwnedSemaphorePermit) -> Result<Content, Refusal>,
) -> Result<Response, Refusal> {
    let flight = name.strip_suffix(ending).ok_or(Refusal::NotFound)?.to_owned();
    let permit = permit(&shared).await?;
    let work = move |site: &Site| {
        let found = files::check_flight(site, &flight)?;
        content(&found, bundle::bundle_flight(&RealDisk, &site.root, &found)?, permit)?.answer(&asked)
    };
    blocking(shared, work).await
}

/// All results of a flight, one after the other.
async fn results(
    State(shared): Context,
    Path(name): Path<String>,
    asked: RequestHead,
) -> Result<Response, Refusal> {
    let content = |flight: &FlightRef, bundle, permit| Ok(archive::results(&flight.id, bundle, permit));
    bundled(shared, (name, ".jsonl"), asked, content).await
}

async fn tar(
    State(shared): Context,
    Path(name): Path<String>,
    asked: RequestHead,
) -> Result<Response, Refusal> {
    let content = |flight: &FlightRef, bundle, permit| {
        let begun_s = catalogue::read_flight_manifest(&RealDisk, flight)?.started.utc.as_second();
        archive::layout(&flight.id, bundle, u64::try_from(begun_s).unwrap_or(0), permit)
    };
    bundled(shared, (name, ".tar"), asked, content).await
}

async fn listing(State(shared): Context, Path(name): Path<String>) -> Result<Json<Listing>, Refusal> {
    let flight = name.strip_suffix(".json").ok_or(Refusal::NotFound)?.to_owned();
    blocking(shared, move |site| {
        let found = files::check_flight(site, &flight)?;
        let bundle = bundle::bundle_flight(&RealDisk, &site.root, &found)?;
        Ok(Json(archive::listing(&flight, &bundle)))
    })
    .await
}

/// The report's script runs by its hash, and none beside it.
async fn report(State(shared): Context, Path(flight): Path<String>) -> Result<Response, Refusal> {
    let _one_at_a_time = shared.reports.acquire().await.map_err(|e| Refusal::Failed(e.to_string()))?;
    blocking(shared.clone(), move |site| {
        files::check_flight(site, &flight)?;
        let data = source::flight(&site.root, Choice::flight(&flight), site.setup.as_ref())?;
        let policy = [(header::CONTENT_SECURITY_POLICY, policy::report())];
        Ok((policy, Html(html::page(&data))).into_response())
    })
    .await
}

async fn status(State(shared): Context) -> Result<Json<Value>, Refusal> {
    let refused = shared.access.refused();
    blocking(shared, move |site| {
        let mut status = pages::status(site)?;
        if let Some(status) = status.as_object_mut() {
            status.insert("refused".to_owned(), refused);
        }
        Ok(Json(status))
    })
    .await
}
