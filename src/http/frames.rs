//! Series and frames are looked at here: a series alone is read, and frames are drawn one at a time.

use axum::extract::{Path, State};
use axum::response::{Html, Response};

use super::{Context, Refusal, RequestHead, Site, blocking, files, pages, send};
use crate::report::html::picture;
use crate::report::{SeriesData, source};
use crate::store::{RealDisk, layout, result_summary, result_sets};

/// A series alone is read, with what is to be said of its results.
fn one_series(site: &Site, flight: &str, series: &str) -> Result<(SeriesData, Option<String>), Refusal> {
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

pub(super) async fn series(
    State(shared): Context,
    Path((flight, series)): Path<(String, String)>,
) -> Result<Html<String>, Refusal> {
    blocking(shared, move |site| {
        let (data, warning) = one_series(site, &flight, &series)?;
        Ok(Html(pages::series(&data, warning.as_deref()).into_string()))
    })
    .await
}

pub(super) async fn frame(
    State(shared): Context,
    Path((flight, series, file)): Path<(String, String, String)>,
) -> Result<Html<String>, Refusal> {
    blocking(shared, move |site| {
        let (data, _) = one_series(site, &flight, &series)?;
        Ok(Html(pages::frame(&data, &file).ok_or(Refusal::NotFound)?.into_string()))
    })
    .await
}

/// Longer side of a small picture, px.
pub(super) const THUMB: usize = 480;
/// Longer side of a large picture, px.
pub(super) const LARGE: usize = 1600;

/// A frame with its markers, known by the digests of both: a browser that has it learns so without drawing.
pub(super) async fn drawn(
    State(shared): Context,
    Path((flight, series, name)): Path<(String, String, String)>,
    asked: RequestHead,
    largest: usize,
) -> Result<Response, Refusal> {
    let file = name.strip_suffix(".svg").ok_or(Refusal::NotFound)?.to_owned();
    // A frame takes tens of MB and of ms: one at a time, whoever asks.
    let _one_at_a_time = shared.pictures.acquire().await.map_err(|e| Refusal::Failed(e.to_string()))?;
    blocking(shared.clone(), move |site| {
        let (data, _) = one_series(site, &flight, &series)?;
        let shot = data.shots.iter().find(|s| s.image.as_deref() == Some(file.as_str()));
        let shot = shot.ok_or(Refusal::NotFound)?;
        let record = data.records.iter().find(|r| r.image == file);
        let state =
            (shot.sha256.as_deref(), record.and(data.inputs.as_deref()), largest, env!("CARGO_PKG_VERSION"));
        let digest = crate::store::sha256_hex(format!("{state:?}").as_bytes());
        if send::is_known(&asked.1, &digest) {
            return files::svg(String::new(), digest).answer(&asked);
        }
        let path = files::check_frame(site, &flight, &series, &file)?;
        let bytes = std::fs::read(&path).map_err(|e| Refusal::Failed(format!("{}: {e}", path.display())))?;
        let drawn = picture::thumbnail(&bytes, shot.format.as_ref(), record, largest);
        let why = || Refusal::Failed(format!("{}: the frame cannot be read", path.display()));
        files::svg(drawn.ok_or_else(why)?, digest).answer(&asked)
    })
    .await
}
