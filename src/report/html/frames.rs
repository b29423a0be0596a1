//! Every frame to choose: its values go into the page, and the page's script shows the one that is chosen.

use maud::{Markup, html};
use serde::Serialize;

use super::super::{ReportData, SeriesData, Site, Whole, frame_ranking, summary};
use super::chart::{brief, json, point};
use super::views::{Placed, frame_of, placed};
use crate::record::{GlobalTest, ImageRecord, MarkerRecord, Reference};

/// A frame as the script reads it.
#[derive(Serialize)]
struct Frame<'a> {
    series: &'a str,
    image: &'a str,
    solved: bool,
    why: &'a str,
    doubt: Option<String>,
    /// Of the tip with its sigma, m.
    deflection: [Option<f64>; 2],
    factor: Option<f64>,
    test: Option<GlobalTest>,
    /// Span, deflection, sigma, m.
    curve: Vec<[Option<f64>; 3]>,
    markers: Vec<Marker<'a>>,
}

#[derive(Serialize)]
struct Marker<'a> {
    id: &'a str,
    used: bool,
    why: &'a str,
    /// Image and residual, px.
    at: Option<[Option<f64>; 4]>,
    /// In the wing frame, m.
    ground: Option<[f64; 3]>,
    flight: Option<[f64; 3]>,
    /// Against the survey with its sigma, m, as the curve's.
    deflection: [Option<f64>; 2],
}

/// The section; without the script it says so.
pub fn section(data: &ReportData) -> Markup {
    let frames = frames(data);
    let total: usize = data.series.iter().map(|s| s.records.len()).sum();
    html! {
        @if !frames.is_empty() {
            section.live {
                h2 id="every" { "Every frame" }
                @if data.frames.len() < total {
                    p { "Of " (total) " frames with a result the " (data.frames.len()) " that are to be looked at first." }
                }
                div id="frames" {}
                script id="frames-data" type="application/json" { (json(&Frames { counted: summary::reference(&data.series).words(), surveyed: data.site.is_some(), frames })) }
            }
        }
    }
}

#[derive(Serialize)]
struct Frames<'a> {
    /// Against what the tips' deflections are counted.
    counted: &'static str,
    /// Markers stand in the wing frame, as the curves do.
    surveyed: bool,
    frames: Vec<Frame<'a>>,
}

fn frames(data: &ReportData) -> Vec<Frame<'_>> {
    let unfinished = data.series.iter().flat_map(|s| {
        let images = s.shots.iter().filter_map(|shot| shot.image.as_deref());
        let open = move |image: &&str| !s.records.iter().any(|r| r.image == *image);
        images.filter(open).map(|image| empty(s, image))
    });
    let reference = summary::reference(&data.series);
    data.frames.iter().map(|frame| whole(frame, data.site.as_ref(), reference)).chain(unfinished).collect()
}

fn empty<'a>(series: &'a SeriesData, image: &'a str) -> Frame<'a> {
    Frame {
        series: &series.name,
        image,
        solved: false,
        why: "it is not solved yet.",
        doubt: None,
        deflection: [None; 2],
        factor: None,
        test: None,
        curve: Vec::new(),
        markers: Vec::new(),
    }
}

fn whole<'a>(frame: &'a Whole, site: Option<&Site>, reference: Reference) -> Frame<'a> {
    let record = &frame.record;
    let (deflection, sigma) = record.tip.as_ref().and_then(|tip| tip.deflection(reference)).unzip();
    Frame {
        series: &frame.series,
        image: &record.image,
        solved: record.is_solved(),
        why: record.reason.as_deref().unwrap_or_default(),
        doubt: frame_ranking::doubt(record),
        deflection: [deflection.and_then(brief), sigma.flatten().and_then(brief)],
        factor: record.variance_factor.and_then(brief),
        test: record.global_test,
        curve: record.curve.iter().map(|p| point(p.span_m, p.deflection_m, p.sigma_deflection_m)).collect(),
        markers: markers(record, site),
    }
}

fn markers<'a>(record: &'a ImageRecord, site: Option<&Site>) -> Vec<Marker<'a>> {
    let places = frame_of(record, site).map(|frame| placed(record, site, &frame)).unwrap_or_default();
    let place = |id: &str| places.iter().find(|p| p.id == id);
    record.markers.iter().map(|m| marker(m, place(&m.id))).collect()
}

fn marker<'a>(m: &'a MarkerRecord, place: Option<&Placed>) -> Marker<'a> {
    let metres = |p: nalgebra::Vector3<f64>| [p.x, p.y, p.z].map(|v| (v * 1e4).round() / 1e4);
    let seen = m.u_px.zip(m.v_px).filter(|(u, v)| u.is_finite() && v.is_finite());
    Marker {
        id: &m.id,
        used: m.used,
        why: m.reason.as_deref().unwrap_or_default(),
        at: seen.map(|(u, v)| {
            [Some(u), Some(v), m.residual_u_px, m.residual_v_px].map(|v| v.map(|v| (v * 1e3).round() / 1e3))
        }),
        ground: place.and_then(|p| p.ground).map(metres),
        flight: place.and_then(|p| p.flight).map(metres),
        deflection: [m.deflection_m.and_then(brief), m.sigma_deflection_m.and_then(brief)],
    }
}
