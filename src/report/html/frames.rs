//! Data of every frame for the script of the page, which shows the selected one.

use maud::{Markup, html};
use serde::Serialize;

use super::super::{FullRecord, ReportData, ReportSite, SeriesData, frame_ranking, summary};
use super::chart::{chart_point, rounded_value, script_json};
use super::views::{PlacedMarker, place_markers, wing_frame};
use crate::record::{GlobalTestVerdict, ImageRecord, MarkerRecord, Reference};

/// Frame as read by the script.
#[derive(Serialize)]
struct FrameValues<'a> {
    series: &'a str,
    image: &'a str,
    solved: bool,
    why: &'a str,
    doubt: Option<String>,
    /// Tip deflection and its sigma, m.
    deflection: [Option<f64>; 2],
    factor: Option<f64>,
    test: Option<GlobalTestVerdict>,
    /// Span, deflection, sigma, m.
    curve: Vec<[Option<f64>; 3]>,
    markers: Vec<MarkerValues<'a>>,
}

#[derive(Serialize)]
struct MarkerValues<'a> {
    id: &'a str,
    used: bool,
    why: &'a str,
    /// Image position and residual, px.
    at: Option<[Option<f64>; 4]>,
    /// Position on ground in the wing frame, m; the next field is the position in flight.
    ground: Option<[f64; 3]>,
    flight: Option<[f64; 3]>,
    /// Deflection relative to the survey and its sigma, m, as in the curve.
    deflection: [Option<f64>; 2],
}

/// Returns the section, which only pages with a working script show.
pub fn frames_section(data: &ReportData) -> Markup {
    let frames = frame_values(data);
    let total: usize = data.series.iter().map(|s| s.records.len()).sum();
    html! {
        @if !frames.is_empty() {
            section.live {
                h2 id="every" { "Every frame" }
                @if data.frames.len() < total {
                    p { "The " (data.frames.len()) " frames ranked first, of " (total) " frames with a result." }
                }
                div id="frames" {}
                script id="frames-data" type="application/json" { (script_json(&FrameList { counted: summary::common_reference(&data.series).description(), surveyed: data.site.is_some(), frames })) }
            }
        }
    }
}

#[derive(Serialize)]
struct FrameList<'a> {
    /// Reference of the tip deflections.
    counted: &'static str,
    /// Marker positions are in the wing frame, as the curves are.
    surveyed: bool,
    frames: Vec<FrameValues<'a>>,
}

fn frame_values(data: &ReportData) -> Vec<FrameValues<'_>> {
    let unfinished = data.series.iter().flat_map(|s| {
        let images = s.shots.iter().filter_map(|shot| shot.image.as_deref());
        let open = move |image: &&str| !s.records.iter().any(|r| r.image == *image);
        images.filter(open).map(|image| unsolved_frame(s, image))
    });
    let reference = summary::common_reference(&data.series);
    data.frames.iter().map(|frame| solved_frame(frame, data.site.as_ref(), reference)).chain(unfinished).collect()
}

fn unsolved_frame<'a>(series: &'a SeriesData, image: &'a str) -> FrameValues<'a> {
    FrameValues {
        series: &series.name,
        image,
        solved: false,
        why: "not solved yet.",
        doubt: None,
        deflection: [None; 2],
        factor: None,
        test: None,
        curve: Vec::new(),
        markers: Vec::new(),
    }
}

fn solved_frame<'a>(frame: &'a FullRecord, site: Option<&ReportSite>, reference: Reference) -> FrameValues<'a> {
    let record = &frame.record;
    let (deflection, sigma) = record.tip.as_ref().and_then(|tip| tip.deflection(reference)).unzip();
    FrameValues {
        series: &frame.series,
        image: &record.image,
        solved: record.is_solved(),
        why: record.reason.as_deref().unwrap_or_default(),
        doubt: frame_ranking::frame_warning(record),
        deflection: [deflection.and_then(rounded_value), sigma.flatten().and_then(rounded_value)],
        factor: record.variance_factor.and_then(rounded_value),
        test: record.global_test,
        curve: record.curve.iter().map(|p| chart_point(p.span_m, p.deflection_m, p.sigma_deflection_m)).collect(),
        markers: all_marker_values(record, site),
    }
}

fn all_marker_values<'a>(record: &'a ImageRecord, site: Option<&ReportSite>) -> Vec<MarkerValues<'a>> {
    let places = wing_frame(record, site).map(|frame| place_markers(record, site, &frame)).unwrap_or_default();
    let place = |id: &str| places.iter().find(|p| p.id == id);
    record.markers.iter().map(|m| marker_values(m, place(&m.id))).collect()
}

fn marker_values<'a>(m: &'a MarkerRecord, place: Option<&PlacedMarker>) -> MarkerValues<'a> {
    let metres = |p: nalgebra::Vector3<f64>| [p.x, p.y, p.z].map(|v| (v * 1e4).round() / 1e4);
    let seen = m.u_px.zip(m.v_px).filter(|(u, v)| u.is_finite() && v.is_finite());
    MarkerValues {
        id: &m.id,
        used: m.used,
        why: m.reason.as_deref().unwrap_or_default(),
        at: seen.map(|(u, v)| {
            [Some(u), Some(v), m.residual_u_px, m.residual_v_px].map(|v| v.map(|v| (v * 1e3).round() / 1e3))
        }),
        ground: place.and_then(|p| p.ground).map(metres),
        flight: place.and_then(|p| p.flight).map(metres),
        deflection: [m.deflection_m.and_then(rounded_value), m.sigma_deflection_m.and_then(rounded_value)],
    }
}
