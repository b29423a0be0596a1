//! Head of the report: the result in one sentence, whether it may be used, and the causes if not.

use maud::{Markup, html};

use wingd_evaluation::number::{count_text, format_measured};
use wingd_evaluation::record::{ImageRecord, RecordStatus};
use wingd_evaluation::results::ReportData;
use wingd_evaluation::results::kinds::{MessageKind, gather_messages};
use wingd_evaluation::results::summary::SeriesSummary;
use wingd_measure::estimation::quality::GlobalTest;

/// Maximum number of kinds of remarks that are unfolded.
const MAX_OPEN_REMARKS: usize = 4;

/// Cause of a rejection that no diagnosis explains.
const UNEXPLAINED: &str = "the global test rejects the model or the configured standard deviations; no single cause is \
     found, see the residuals of the frame";

/// Returns the sentence, the other causes and the remarks.
pub fn answer_section(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    let causes = gather_causes(data);
    let first = causes.first().map(|cause| cause.text.as_str());
    let (sentence, is_sound) = answer_sentence(data, summaries, first);
    html! {
        p.answer.warning[!is_sound] { (sentence) }
        // A single cause is in the sentence.
        @if causes.len() > 1 {
            ul.causes { @for cause in &causes {
                li { b { (count_text(cause.count, "frame")) } ": " (cause.text) " " span.soft { "(first in " (cause.first) ")" } }
            } }
        }
        @for note in data.warnings.iter().chain(&data.notes) { p.warning { (note) } }
        @let remarks = gather_remarks(data);
        @if !remarks.is_empty() {
            details open[remarks.len() <= MAX_OPEN_REMARKS] {
                summary { (count_text(remarks.len(), "kind")) " of remarks" }
                ul.causes { @for one in &remarks {
                    li { (one.text) " " span.soft { "(" @if one.count > 1 { (one.count) " times, first " } "in " (one.first) ")" } }
                } }
            }
        }
    }
}

/// Gathers the remarks of series and frames.
fn gather_remarks(data: &ReportData) -> Vec<MessageKind> {
    gather_messages(data.series.iter().flat_map(|s| {
        let place = |r: &ImageRecord| format!("{}/{}", s.name, r.image);
        let of_series = s.remarks.iter().map(|text| (text, s.name.clone()));
        let of_frames = s.records.iter();
        let of_frames =
            of_frames.flat_map(move |r| r.remarks.iter().map(move |text| (text, place(r))));
        of_series
            .chain(of_frames)
            .map(|(text, at)| (text.as_str(), at, ""))
    }))
}

/// Gathers why frames have no result or a rejected one, the most frequent cause first.
fn gather_causes(data: &ReportData) -> Vec<MessageKind> {
    let records = data.series.iter().flat_map(|s| {
        let of_series = s.records.iter();
        of_series.filter_map(|r| Some((frame_cause(r)?, format!("{}/{}", s.name, r.image), "")))
    });
    let open = data.series.iter().flat_map(|s| {
        let place = |number: u32| format!("{}, shot {number}", s.name);
        let state = |image: &Option<String>| match image {
            None => Some("the camera delivered no frame; see Camera failures"),
            Some(image) if s.records.iter().all(|r| r.image != *image) => {
                Some("not solved yet; run `wingd solve STORE`")
            }
            Some(_) => None,
        };
        let shots = s.shots.iter();
        shots.filter_map(move |shot| Some((state(&shot.image)?, place(shot.number), "")))
    });
    let mut causes = gather_messages(records.chain(open));
    causes.sort_by_key(|cause| std::cmp::Reverse(cause.count));
    causes
}

fn frame_cause(record: &ImageRecord) -> Option<&str> {
    let known = record.cause.as_deref().or(record.reason.as_deref());
    let is_rejected = record.global_test == Some(GlobalTest::Rejected);
    (is_rejected || !record.is_solved()).then(|| known.unwrap_or(UNEXPLAINED))
}

/// Returns the result and whether it may be used, in one sentence, and true if every frame is sound.
fn answer_sentence(
    data: &ReportData,
    summaries: &[SeriesSummary],
    cause: Option<&str>,
) -> (String, bool) {
    let sum = |f: fn(&SeriesSummary) -> usize| summaries.iter().map(f).sum::<usize>();
    let (frames, solved) = (sum(|s| s.shots), sum(|s| s.solved));
    let (made, passed) = (sum(|s| s.tests_made), sum(|s| s.tests_passed));
    let records = data.series.iter().flat_map(|s| &s.records);
    let doubtful = records
        .filter(|r| r.status == RecordStatus::Doubtful)
        .count();
    let because = cause.map_or(String::new(), |cause| format!(": {cause}"));
    let deflections = summaries.iter().filter_map(|s| s.greatest.as_ref());
    let greatest = deflections.max_by(|a, b| a.deflection_m.total_cmp(&b.deflection_m));
    let Some(one) = greatest.filter(|_| solved > 0) else {
        return match frames {
            0 => ("The store holds no series yet.".to_owned(), false),
            n if doubtful > 0 => {
                let others = if doubtful < n {
                    " and the others missing"
                } else {
                    ""
                };
                (
                    format!(
                        "No deflection may be used, because {doubtful} of {n} results are doubtful{others}{because}."
                    ),
                    false,
                )
            }
            n => (
                format!(
                    "No deflection: none of {} is solved{because}.",
                    count_text(n, "frame")
                ),
                false,
            ),
        };
    };
    let reference = summaries.first().map(|s| s.reference).unwrap_or_default();
    let extent = if solved > 1 { "up to " } else { "" };
    let measured = format_measured(Some(one.deflection_m), one.sigma_m, 3);
    let marker = &one.marker;
    let result = format!(
        "Tip deflection ({marker}) {extent}{measured} m {}",
        reference.description()
    );
    let verdict = match (frames - solved, made - passed) {
        (0, 0) => {
            format!(
                "the results may be used, {solved} of {frames} frames are solved and {passed} of {made} global tests passed"
            )
        }
        (0, rejected) => format!(
            "{rejected} of {made} global tests rejected, so those results may be used with care only, with their enlarged standard deviations{because}"
        ),
        (missing, rejected) => {
            let tests = if rejected > 0 {
                format!(", {rejected} of {made} global tests rejected")
            } else {
                String::new()
            };
            format!(
                "{solved} of {frames} frames may be used, {missing} have no usable result{tests}{because}"
            )
        }
    };
    (
        format!("{result}: {verdict}."),
        frames == solved && made == passed,
    )
}
