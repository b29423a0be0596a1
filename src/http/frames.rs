//! Pages of a series and of a frame: only that series is read, and frames are drawn one at a time.

use axum::extract::{Path, State};
use axum::response::{Html, Response};

use super::{Refusal, RequestHead, ServerContext, Site, files, pages, run_blocking, send};
use crate::report::html::picture;
use crate::report::{SeriesData, source};
use crate::store::{RealDisk, layout, result_sets, result_summary};

/// Reads one series, with a warning if its results come from several inputs.
fn read_series_data(site: &Site, flight: &str, series: &str) -> Result<(SeriesData, Option<String>), Refusal> {
    let series = files::check_series(site, flight, series)?;
    let bytes = std::fs::read(series.folder.join(layout::RESULTS_FILE)).unwrap_or_default();
    let mut gather = result_sets::ResultGrouper::default();
    gather.add_series(&series.id, &result_summary::parse_summaries(&bytes, &[]));
    let sets = gather.finish();
    let mut notes = Vec::new();
    let data = source::read_series(&RealDisk, &series, sets.choose_set(None), &mut notes);
    let data = data.ok_or_else(|| Refusal::Failed(notes.join("; ")))?;
    Ok((data, sets.mixed_inputs_warning(&series.id, None)))
}

pub(super) async fn series_page(
    State(shared): ServerContext,
    Path((flight, series)): Path<(String, String)>,
) -> Result<Html<String>, Refusal> {
    run_blocking(shared, move |site| {
        let (data, warning) = read_series_data(site, &flight, &series)?;
        Ok(Html(pages::series_page(&data, warning.as_deref()).into_string()))
    })
    .await
}

pub(super) async fn frame_page(
    State(shared): ServerContext,
    Path((flight, series, file)): Path<(String, String, String)>,
) -> Result<Html<String>, Refusal> {
    run_blocking(shared, move |site| {
        let (data, _) = read_series_data(site, &flight, &series)?;
        Ok(Html(pages::frame_page(&data, &file).ok_or(Refusal::NotFound)?.into_string()))
    })
    .await
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
    let file = name.strip_suffix(".svg").ok_or(Refusal::NotFound)?.to_owned();
    // Drawing a frame takes tens of MB and of ms: one at a time for all clients.
    let _one_at_a_time = shared.pictures.acquire().await.map_err(|e| Refusal::Failed(e.to_string()))?;
    run_blocking(shared.clone(), move |site| {
        let (data, _) = read_series_data(site, &flight, &series)?;
        let shot = data.shots.iter().find(|s| s.image.as_deref() == Some(file.as_str()));
        let shot = shot.ok_or(Refusal::NotFound)?;
        let record = data.records.iter().find(|r| r.image == file);
        let state = (shot.sha256.as_deref(), record.and(data.inputs.as_deref()), largest, env!("CARGO_PKG_VERSION"));
        let digest = crate::store::sha256_hex(format!("{state:?}").as_bytes());
        if send::is_cached(&head.1, &digest) {
            return files::svg_content(String::new(), digest).respond(&head);
        }
        let path = files::check_frame(site, &flight, &series, &file)?;
        let bytes = std::fs::read(&path).map_err(|e| Refusal::Failed(format!("{}: {e}", path.display())))?;
        let drawn = picture::svg_thumbnail(&bytes, shot.format.as_ref(), record, largest);
        let unreadable = || Refusal::Failed(format!("{}: the frame cannot be read", path.display()));
        files::svg_content(drawn.ok_or_else(unreadable)?, digest).respond(&head)
    })
    .await
}
