//! Pages of a series and of a frame: only that series is read, and frames are drawn one at a time.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use axum::extract::{Path, State};
use axum::http::Uri;
use axum::response::{Html, Response};

use super::{Refusal, RequestHead, ServerContext, Site, files, pages, run_blocking, send};
use wingd_evaluation::figures::picture;
use wingd_evaluation::results::ShotData;
use wingd_evaluation::results::source::SeriesIndex;
use wingd_store::{Disk, RealDisk, layout};

/// State of the files of a series, which changes with each result.
type SeriesFiles = (PathBuf, [Option<(u64, SystemTime)>; 2]);

/// The series that was read last: a page, its frames and their drawings read the store once.
#[derive(Default)]
pub(super) struct SeriesCache(Mutex<Option<(SeriesFiles, Arc<SeriesIndex>)>>);

impl SeriesCache {
    /// Returns a series as it is now.
    fn series(&self, site: &Site, flight: &str, series: &str) -> Result<Arc<SeriesIndex>, Refusal> {
        let series = files::check_series(site, flight, series)?;
        let state = |file: &str| {
            let meta = std::fs::metadata(series.folder.join(file)).ok()?;
            Some((meta.len(), meta.modified().ok()?))
        };
        let state = (
            series.folder.clone(),
            [layout::SERIES_FILE, layout::RESULTS_FILE].map(state),
        );
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match &*last {
            Some((known, index)) if *known == state => Ok(index.clone()),
            _ => {
                let index = Arc::new(SeriesIndex::read(&RealDisk, &series)?);
                *last = Some((state, index.clone()));
                Ok(index)
            }
        }
    }
}

/// Number of shots on a page of a series.
const SHOTS_PER_PAGE: usize = 50;

pub(super) async fn series_page(
    State(shared): ServerContext,
    Path((flight, series)): Path<(String, String)>,
    address: Uri,
) -> Result<Html<String>, Refusal> {
    // Page of a long series, from 1.
    let page = address
        .query()
        .and_then(|query| query.strip_prefix("page=")?.parse::<usize>().ok())
        .unwrap_or(1);
    run_blocking(shared.clone(), move |site| {
        let index = shared.series.series(site, &flight, &series)?;
        let pages = index.data.shots.len().div_ceil(SHOTS_PER_PAGE).max(1);
        let page = page.clamp(1, pages);
        let shots = index
            .data
            .shots
            .iter()
            .skip((page - 1) * SHOTS_PER_PAGE)
            .take(SHOTS_PER_PAGE);
        let record = |shot: &ShotData| index.record(&RealDisk, shot.image.as_deref()?);
        let shots: Vec<_> = shots.map(|shot| (shot, record(shot))).collect();
        Ok(Html(
            pages::series_page(&index, &shots, (page, pages)).into_string(),
        ))
    })
    .await
}

pub(super) async fn frame_page(
    State(shared): ServerContext,
    Path((flight, series, file)): Path<(String, String, String)>,
) -> Result<Html<String>, Refusal> {
    run_blocking(shared.clone(), move |site| {
        let index = shared.series.series(site, &flight, &series)?;
        let shot = find_shot(&index, &file)?;
        Ok(Html(
            pages::frame_page(&index.data, shot, index.record(&RealDisk, &file).as_ref())
                .into_string(),
        ))
    })
    .await
}

fn find_shot<'a>(index: &'a SeriesIndex, file: &str) -> Result<&'a ShotData, Refusal> {
    index
        .data
        .shots
        .iter()
        .find(|shot| shot.image.as_deref() == Some(file))
        .ok_or(Refusal::NotFound)
}

/// Longer side of a thumbnail, px.
pub(super) const THUMBNAIL_PX: usize = 480;
/// Longer side of a large overlay, px.
pub(super) const OVERLAY_PX: usize = 1600;

/// Draws a frame with its markers. The ETag comes from the digests of frame and results, so a browser that has the drawing
/// is answered without drawing it again.
pub(super) async fn drawn_frame(
    State(shared): ServerContext,
    Path((flight, series, name)): Path<(String, String, String)>,
    head: RequestHead,
    largest: usize,
) -> Result<Response, Refusal> {
    let file = name
        .strip_suffix(".svg")
        .ok_or(Refusal::NotFound)?
        .to_owned();
    // Drawing a frame takes tens of MB and of ms: one at a time for all clients.
    let _one_at_a_time = shared
        .pictures
        .acquire()
        .await
        .map_err(|e| Refusal::Failed(e.to_string()))?;
    let context = shared.clone();
    run_blocking(shared.clone(), move |site| {
        let index = context.series.series(site, &flight, &series)?;
        let (shot, record) = (find_shot(&index, &file)?, index.record(&RealDisk, &file));
        let inputs = record.as_ref().and(index.data.inputs.as_deref());
        let state = (
            shot.sha256.as_deref(),
            inputs,
            largest,
            env!("CARGO_PKG_VERSION"),
        );
        let digest = wingd_store::sha256_hex(format!("{state:?}").as_bytes());
        if send::is_cached(&head.1, &digest) {
            return files::svg_content(String::new(), digest).respond(&head);
        }
        let path = files::check_frame(site, &flight, &series, &file)?;
        let bytes = RealDisk
            .read(&path)
            .map_err(|e| Refusal::Failed(format!("{}: {e}", path.display())))?;
        let drawn = picture::svg_thumbnail(&bytes, shot.format.as_ref(), record.as_ref(), largest);
        let unreadable =
            || Refusal::Failed(format!("{}: the frame cannot be read", path.display()));
        files::svg_content(drawn.ok_or_else(unreadable)?, digest).respond(&head)
    })
    .await
}
