//! A frame with its markers, and the values of every frame for the script of the page, which shows the selected one.

use std::collections::BTreeMap;

use maud::{Markup, html};
use serde::{Serialize, Serializer};

use super::figures::{SPAN_LABEL, curve_points, is_scattered};
use super::views::{GROUND_COLOUR, PlacedMarker, place_markers};
use wingd_evaluation::figures::figure::{
    BREAK, Figure, FigurePoint, FigureTrack, MAIN_COLOUR, TrackStyle, all_abscissas, all_values,
    rounded_point, script_json,
};
use wingd_evaluation::figures::picture;
use wingd_evaluation::figures::plot::{Axis, round_step};
use wingd_evaluation::number::{format_fixed, format_measured};
use wingd_evaluation::record::{CurveRecord, ImageRecord, MarkerRecord, variant_name};
use wingd_evaluation::results::summary;
use wingd_evaluation::results::summary::SeriesSummary;
use wingd_evaluation::results::{FramePicture, FullRecord, ReportData, frame_ranking, table};
use wingd_measure::adjust::DeflectionReference;
use wingd_measure::estimation::quality::GlobalTest;

const UNUSED_COLOUR: &str = "#b3541e";
/// Length of the longest residual in the figure, as a fraction of the width covered by the markers.
const RESIDUAL_SHARE: f64 = 0.04;

/// Frame as read by the script.
#[derive(Default, Serialize)]
struct FrameValues<'a> {
    series: &'a str,
    image: &'a str,
    doubt: Option<String>,
    /// Result in a sentence.
    said: String,
    /// The sentence is a warning.
    warned: bool,
    curve: Vec<FigurePoint>,
    markers: Vec<MarkerValues>,
    /// Rows of the table of the markers.
    rows: Vec<Vec<String>>,
}

/// Marker as read by the script, which gets the fields in this order without their names: a report has thousands.
struct MarkerValues {
    used: bool,
    /// Image position and its magnified residual, px; v upwards.
    seen: Option<[f64; 4]>,
    /// Position on ground in the wing frame, m; the next field is the position in flight.
    ground: Option<[f64; 3]>,
    flight: Option<[f64; 3]>,
    /// Deflection and its standard deviation, m, as in the curve.
    deflection: Option<(f64, Option<f64>)>,
}

impl Serialize for MarkerValues {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (
            self.used,
            self.seen,
            self.ground,
            self.flight,
            self.deflection,
        )
            .serialize(serializer)
    }
}

/// Values of the frames as read by the script.
#[derive(Serialize)]
struct FrameList<'a> {
    /// The positions are in the wing frame, as the curves are.
    surveyed: bool,
    /// Mean curve of each series whose frames agree.
    means: BTreeMap<&'a str, Vec<FigurePoint>>,
    frames: Vec<FrameValues<'a>>,
}

/// Returns the section with the frame that ranks first. A working script shows any other frame.
pub fn frames_section(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    let total: usize = data.series.iter().map(|s| s.records.len()).sum();
    let magnified = residual_magnification(data);
    let reference = summary::common_reference(&data.series);
    let means = summaries
        .iter()
        .filter(|s| !is_scattered(s))
        .map(|s| (s.name.as_str(), deflection_points(&s.curve, reference)))
        .collect();
    let list = FrameList {
        surveyed: data.site.is_some(),
        means,
        frames: collect_frame_values(data, reference, magnified),
    };
    let shown = data.frames.first();
    let shown = shown.map(|frame| table::marker_table(&frame.record, reference));
    html! {
        h2 id="frame" { "A frame and its markers" }
        @if data.frames.len() < total {
            p { "The " (data.frames.len()) " frames ranked first, of " (total) " frames with a result." }
        }
        @if data.pictures.is_empty() { p { "No image is available." } }
        @if let Some(first) = list.frames.first() {
            div #frames {
                h3 { (first.series) " " (first.image) }
                p role="status" .warning[first.warned] { (first.said) }
                @for p in &data.pictures { (draw_frame_picture(data, p)) }
                figure.positions {
                    (draw_marker_positions(&list.frames))
                    p.caption { "Image positions of the markers. Lines: residuals, magnified " (format_fixed(Some(magnified), 0)) " times." }
                }
                figure.curve { (draw_deflection_curve(&list, reference)) }
                section.live {
                    h3 { "3D view of the wing" }
                    figure.wing { (draw_wing(&list.frames)) p.caption {} }
                }
                details {
                    summary { "Markers of " span { (first.series) " " (first.image) } ", deflections " (reference.description()) }
                    (shown.unwrap_or_default().html())
                }
            }
            script id="frames-data" type="application/json" { (script_json(&list)) }
        }
    }
}

fn draw_frame_picture(data: &ReportData, picture: &FramePicture) -> Markup {
    let of_picture =
        |frame: &&FullRecord| frame.series == picture.series && frame.record.image == picture.image;
    let record = data
        .frames
        .iter()
        .find(of_picture)
        .map(|frame| &frame.record);
    html! {
        figure.picture data-frame={ (picture.series) "/" (picture.image) } { (picture::draw_picture(picture, record)) }
    }
}

/// Draws the first frame, with axes that cover all frames.
fn draw_first_frame(
    name: &str,
    frames: &[FrameValues],
    tracks: impl Fn(&FrameValues) -> Vec<FigureTrack>,
    axes: impl Fn(&[FigureTrack]) -> [Axis; 2],
) -> Markup {
    let all: Vec<FigureTrack> = frames.iter().flat_map(&tracks).collect();
    let [x, y] = axes(&all);
    Figure {
        name: name.to_owned(),
        height: 320.0,
        x,
        y,
        tracks: frames.first().map(tracks).unwrap_or_default(),
    }
    .draw()
}

/// Builds a track of the markers for which `point` returns one, with their names.
fn marker_track(
    name: &str,
    colour: &str,
    frame: &FrameValues,
    point: impl Fn(&MarkerValues) -> Option<FigurePoint>,
) -> FigureTrack {
    let named = frame.markers.iter().zip(&frame.rows);
    let (points, texts) = named
        .filter_map(|(m, row)| Some((point(m)?, row.first().cloned()?)))
        .unzip();
    FigureTrack {
        style: TrackStyle::Dots,
        texts,
        ..FigureTrack::from_points(name, colour, points)
    }
}

/// Builds a track of one line per marker.
fn line_track(
    name: &str,
    colour: &str,
    frame: &FrameValues,
    ends: impl Fn(&MarkerValues) -> Option<[FigurePoint; 2]>,
) -> FigureTrack {
    let points = frame
        .markers
        .iter()
        .filter_map(ends)
        .flat_map(|[from, to]| [from, to, BREAK])
        .collect();
    FigureTrack::from_points(name, colour, points)
}

fn draw_marker_positions(frames: &[FrameValues]) -> Markup {
    let of_kind = |used: bool| {
        move |m: &MarkerValues| {
            m.seen
                .filter(|_| m.used == used)
                .map(|[u, v, ..]| (u, v, None))
        }
    };
    let residual = |m: &MarkerValues| {
        m.seen
            .filter(|_| m.used)
            .map(|[u, v, du, dv]| [(u, v, None), (u + du, v + dv, None)])
    };
    let tracks = |frame: &FrameValues| {
        vec![
            marker_track("used", MAIN_COLOUR, frame, of_kind(true)),
            marker_track("not used", UNUSED_COLOUR, frame, of_kind(false)),
            line_track("residuals", "#b3177f", frame, residual),
        ]
    };
    let axes = |all: &[FigureTrack]| {
        let v = Axis::from_values(all_values(all).map(|v| -v), "v / px").reversed();
        [Axis::from_values(all_abscissas(all), "u / px"), v]
    };
    draw_first_frame("Image positions", frames, tracks, axes)
}

fn draw_deflection_curve(list: &FrameList, reference: DeflectionReference) -> Markup {
    let tracks = |frame: &FrameValues| {
        let mean = list.means.get(frame.series).cloned().unwrap_or_default();
        // Without an installation the spans of the markers have a guessed origin.
        let deflected = |used: bool| {
            move |m: &MarkerValues| {
                let shown = list.surveyed && m.used == used;
                let ([span, ..], (value, sigma)) = m.ground.zip(m.deflection).filter(|_| shown)?;
                Some((span, value, sigma))
            }
        };
        let mut tracks = vec![
            FigureTrack::from_points("this frame", MAIN_COLOUR, frame.curve.clone()),
            marker_track("markers", "#1d6b4f", frame, deflected(true)),
            marker_track("markers, predicted", UNUSED_COLOUR, frame, deflected(false)),
        ];
        if !list.means.is_empty() {
            tracks.push(FigureTrack {
                dashed: true,
                ..FigureTrack::from_points("mean of its series", "#8a4b00", mean)
            });
        }
        tracks
    };
    let axes = |all: &[FigureTrack]| {
        let label = format!("deflection {} / m", reference.description());
        let y = Axis::from_values(all_values(all).chain([0.0]), &label);
        [Axis::from_values(all_abscissas(all), SPAN_LABEL), y]
    };
    draw_first_frame("Deflection of a frame", &list.frames, tracks, axes)
}

/// Draws the wing along the chord; the script of the page turns it.
fn draw_wing(frames: &[FrameValues]) -> Markup {
    let flat = |[x, y, _]: [f64; 3]| (x, y, None);
    let tracks = |frame: &FrameValues| {
        vec![
            marker_track("on ground", GROUND_COLOUR, frame, |m| m.ground.map(flat)),
            marker_track("in flight", MAIN_COLOUR, frame, |m| m.flight.map(flat)),
            line_track("deflection", MAIN_COLOUR, frame, |m| {
                Some([flat(m.ground?), flat(m.flight?)])
            }),
        ]
    };
    let axes = |all: &[FigureTrack]| {
        [
            Axis::from_values(all_abscissas(all), "across / m"),
            Axis::from_values(all_values(all), "up / m"),
        ]
    };
    draw_first_frame("Wing", frames, tracks, axes)
}

fn deflection_points(curve: &[CurveRecord], reference: DeflectionReference) -> Vec<FigurePoint> {
    curve_points(curve, &|p| {
        p.deflection(reference).unwrap_or((f64::NAN, None))
    })
    .into_iter()
    .map(rounded_point)
    .collect()
}

/// Returns the factor by which residuals are magnified, the same for all frames.
fn residual_magnification(data: &ReportData) -> f64 {
    let markers = || data.frames.iter().flat_map(|frame| &frame.record.markers);
    let (left, right) = Axis::from_values(markers().filter_map(|m| m.u_px), "").range();
    let lengths = markers()
        .filter(|m| m.used)
        .filter_map(|m| Some(m.residual_u_px?.hypot(m.residual_v_px?)));
    let longest = lengths
        .filter(|length| length.is_finite())
        .fold(0.0, f64::max);
    if longest > 0.0 {
        round_step(RESIDUAL_SHARE * (right - left) / longest).max(1.0)
    } else {
        1.0
    }
}

/// Lists the result sentence and the markers' values of every frame, also if unsolved, for the page's script.
fn collect_frame_values(
    data: &ReportData,
    reference: DeflectionReference,
    magnified: f64,
) -> Vec<FrameValues<'_>> {
    let unfinished = data.series.iter().flat_map(|s| {
        let images = s.shots.iter().filter_map(|shot| shot.image.as_deref());
        let open = move |image: &&str| !s.records.iter().any(|r| r.image == *image);
        let said = "No result: not solved yet.";
        images.filter(open).map(|image| FrameValues {
            series: &s.name,
            image,
            said: said.to_owned(),
            warned: true,
            ..FrameValues::default()
        })
    });
    data.frames
        .iter()
        .map(|frame| frame_with_record(frame, data, reference, magnified))
        .chain(unfinished)
        .collect()
}

fn frame_with_record<'a>(
    frame: &'a FullRecord,
    data: &ReportData,
    reference: DeflectionReference,
    magnified: f64,
) -> FrameValues<'a> {
    let record = &frame.record;
    let site = data.site.as_ref();
    let places = site
        .map(|site| place_markers(record, site))
        .unwrap_or_default();
    let place = |id: &str| places.iter().find(|p| p.id == id);
    let values = |m: &MarkerRecord| drawn_marker_values(m, place(&m.id), reference, magnified);
    FrameValues {
        series: &frame.series,
        image: &record.image,
        doubt: frame_ranking::frame_warning(record),
        said: result_sentence(record, reference),
        warned: !record.is_solved() || record.global_test == Some(GlobalTest::Rejected),
        curve: deflection_points(&record.curve, reference),
        markers: record.markers.iter().map(values).collect(),
        rows: table::marker_table(record, reference).rows,
    }
}

/// Describes the result of a frame: its tip deflection, variance factor and global test, or the reason why it has none.
fn result_sentence(record: &ImageRecord, reference: DeflectionReference) -> String {
    if !record.is_solved() {
        return format!(
            "No result: {}",
            record.reason.as_deref().unwrap_or_default()
        );
    }
    let (deflection, sigma) = record
        .tip
        .as_ref()
        .and_then(|tip| tip.deflection(reference))
        .unzip();
    let measured = format_measured(deflection, sigma.flatten(), 3);
    let tip = record
        .tip
        .as_ref()
        .map_or(String::new(), |tip| format!(" ({})", tip.label()));
    let mut text = format!(
        "Tip deflection{tip} {measured} m {}",
        reference.description()
    );
    if record.variance_factor.is_some() {
        text.push_str(&format!(
            ", variance factor {}",
            format_fixed(record.variance_factor, 2)
        ));
    }
    if let Some(verdict) = record.global_test {
        text.push_str(&format!(", global test {}", variant_name(verdict)));
    }
    match frame_ranking::frame_warning(record) {
        Some(doubt) if record.global_test != Some(GlobalTest::Rejected) => {
            format!("{text}. Check this frame: {doubt}.")
        }
        _ => format!("{text}."),
    }
}

fn drawn_marker_values(
    m: &MarkerRecord,
    place: Option<&PlacedMarker>,
    reference: DeflectionReference,
    magnified: f64,
) -> MarkerValues {
    let round = |value: f64, parts: f64| (value * parts).round() / parts;
    let metres = |p: nalgebra::Vector3<f64>| [p.x, p.y, p.z].map(|v| round(v, 1e4));
    let (value, sigma) = m.deflection(reference);
    let at = m
        .u_px
        .zip(m.v_px)
        .filter(|(u, v)| u.is_finite() && v.is_finite());
    let [du, dv] = [m.residual_u_px, m.residual_v_px]
        .map(|residual| round(magnified * residual.unwrap_or(0.0), 10.0));
    MarkerValues {
        used: m.used,
        seen: at.map(|(u, v)| [round(u, 1e3), -round(v, 1e3), du, -dv]),
        ground: place.and_then(|p| p.ground).map(metres),
        flight: place.and_then(|p| p.flight).filter(|_| m.used).map(metres),
        deflection: value.map(|value| (round(value, 1e6), sigma.map(|sigma| round(sigma, 1e6)))),
    }
}
