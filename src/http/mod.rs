//! Read-only pages over a store: lists, downloads by range, a flight as one archive, the report.
//!
//! | path | answers |
//! |---|---|
//! | `/` | flights |
//! | `/flights/{flight}` | its series |
//! | `/flights/{flight}/{series}` | its frames and results |
//! | `/files/{flight}/...` | files as they lie in the store; frames and manifests by range |
//! | `/tar/{flight}.tar` | the flight as one archive |
//! | `/report/{flight}` | the report |
//! | `/status.json` | what the store holds, and the daemon's state where one runs |
//!
//! Nothing comes from outside, nothing can be changed, and no name leads out of the store.

mod archive;
mod files;
mod pages;

use std::future::Future;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{Html, IntoResponse, Json, Response};
use axum::routing::get;
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tower_http::set_header::SetResponseHeaderLayer;

use crate::measure::setup::Setup;
use crate::report::{html, source};
use crate::store::StoreError;

/// Asked for the daemon's state.
pub type StatusSource = Arc<dyn Fn() -> Value + Send + Sync>;

/// What is served.
#[derive(Clone)]
pub struct Site {
    /// The store.
    pub root: PathBuf,
    /// For the report's ground shape and lines of sight.
    pub setup: Option<Setup>,
    /// The daemon's state, where one runs.
    pub status: Option<StatusSource>,
}

/// Archives that are streamed at once; a small computer records meanwhile.
const ARCHIVES: usize = 2;

struct Shared {
    site: Site,
    archives: Arc<Semaphore>,
}

type Context = State<Arc<Shared>>;

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

/// Serves until `shutdown` is done; downloads under way may end.
pub async fn serve(
    site: Site,
    listener: TcpListener,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> io::Result<()> {
    axum::serve(listener, router(site)).with_graceful_shutdown(shutdown).await
}

fn router(site: Site) -> Router {
    let shared = Arc::new(Shared { site, archives: Arc::new(Semaphore::new(ARCHIVES)) });
    let policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'";
    let header = |name, value| SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value));
    Router::new()
        .route("/", get(index))
        .route("/flights/{flight}", get(flight))
        .route("/flights/{flight}/{series}", get(series))
        .route("/files/{flight}/{file}", get(flight_file))
        .route("/files/{flight}/{series}/{file}", get(series_file))
        .route("/tar/{name}", get(tar))
        .route("/report/{flight}", get(report))
        .route("/status.json", get(status))
        .fallback(async || Refusal::NotFound)
        .layer(header(header::CONTENT_SECURITY_POLICY, policy))
        .layer(header(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(header(header::REFERRER_POLICY, "no-referrer"))
        .with_state(shared)
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

async fn flight(State(shared): Context, Path(flight): Path<String>) -> Result<Html<String>, Refusal> {
    blocking(shared, move |site| {
        files::check_flight(site, &flight)?;
        let data = source::flight(&site.root, Some(&flight), None)?;
        Ok(Html(pages::flight(&flight, &data).into_string()))
    })
    .await
}

async fn series(
    State(shared): Context,
    Path((flight, series)): Path<(String, String)>,
) -> Result<Html<String>, Refusal> {
    blocking(shared, move |site| {
        files::check_flight(site, &flight)?;
        let data = source::flight(&site.root, Some(&flight), None)?;
        let page = pages::series(&data, &series).ok_or(Refusal::NotFound)?;
        Ok(Html(page.into_string()))
    })
    .await
}

async fn flight_file(
    State(shared): Context,
    Path((flight, file)): Path<(String, String)>,
    request: Request,
) -> Result<Response, Refusal> {
    let place = blocking(shared, move |site| files::in_flight(site, &flight, &file)).await?;
    files::send(place, request).await
}

async fn series_file(
    State(shared): Context,
    Path((flight, series, file)): Path<(String, String, String)>,
    request: Request,
) -> Result<Response, Refusal> {
    let place = blocking(shared, move |site| files::in_series(site, &flight, &series, &file)).await?;
    files::send(place, request).await
}

async fn tar(State(shared): Context, Path(name): Path<String>) -> Result<Response, Refusal> {
    let flight = name.strip_suffix(".tar").ok_or(Refusal::NotFound)?.to_owned();
    let permit = shared.archives.clone().try_acquire_owned().map_err(|_| Refusal::Busy)?;
    let (id, list) = blocking(shared, move |site| {
        let list = files::of_flight(site, &flight)?;
        Ok((flight, list))
    })
    .await?;
    Ok(archive::stream(&id, list, permit))
}

async fn report(State(shared): Context, Path(flight): Path<String>) -> Result<Html<String>, Refusal> {
    blocking(shared, move |site| {
        files::check_flight(site, &flight)?;
        Ok(Html(html::page(&source::flight(&site.root, Some(&flight), site.setup.as_ref())?)))
    })
    .await
}

async fn status(State(shared): Context) -> Result<Json<Value>, Refusal> {
    blocking(shared, |site| Ok(Json(pages::status(site)?))).await
}
