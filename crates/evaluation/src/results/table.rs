//! Tables shared by the terminal and the report.

use std::fmt::Display;

use super::MarkerCount;
use super::kinds::{MessageKind, gather_messages};
use super::summary::{Mean, SeriesSummary};
use crate::grid::ColumnDefinition::{One, Pair};
use crate::grid::Grid;
use crate::number::{NONE, count_text, decimals_for, format_fixed, format_rounded};
use crate::record::{ImageRecord, MarkerRecord, RecordStatus, Tip, TorsionRecord, variant_name};
use wingd_measure::adjust::{DeflectionReference, VarianceShare};
use wingd_measure::detect::{Detection, Detections};

/// Formats one line per image, then the markers if there is a single image, otherwise the unused markers, then failures and
/// remarks.
pub fn results_text(records: &[ImageRecord], wide: bool) -> String {
    let reference = Tip::most_precise_reference(records.iter().filter_map(|r| r.tip.as_ref()));
    let mut out = image_table(records, &[], reference).text_with_width(wide);
    let notes = image_notes(records);
    out.push_str(&deflection_text(records, reference));
    match records {
        // A frame that could not be read has only a reason.
        [one] if one.markers.iter().any(|m| m.used || m.u_px.is_some()) => {
            out.push_str(&format!(
                "\n{}",
                marker_table(one, reference).text_with_width(wide)
            ));
        }
        [one] if !one.is_solved() => {}
        _ => {
            let unused = unused_markers(records.iter().map(|r| ("", r)));
            if !unused.rows.is_empty() {
                out.push_str(&format!(
                    "\nMarkers not used\n{}",
                    unused.text_with_width(wide)
                ));
            }
        }
    }
    if !notes.is_empty() {
        out.push_str(&format!("\n{notes}"));
    }
    out
}

/// Describes the reference of the table's deflections; for a single image lists all three deflections and the budget.
fn deflection_text(records: &[ImageRecord], reference: DeflectionReference) -> String {
    match records {
        [
            ImageRecord {
                tip: Some(tip),
                budget,
                ..
            },
        ] if tip.reference.is_some() => {
            format!("\n{}{}", self::tip_table(tip).text(), budget_text(budget))
        }
        _ if records.iter().any(|r| r.tip.is_some()) => {
            format!("Deflections are measured {}.\n", reference.description())
        }
        _ => String::new(),
    }
}

/// Lists the three deflections of the tip.
pub fn tip_table(tip: &Tip) -> Grid {
    let reported = tip.reference.unwrap_or_default();
    let deflections: Vec<_> = DeflectionReference::ALL
        .iter()
        .filter_map(|one| Some((*one, tip.deflection(*one)?)))
        .collect();
    Grid::for_rows(&deflections).columns(&[
        One("<deflection of", &|_| tip.label()),
        One("<reference", &|(one, _)| one.description().to_owned()),
        Pair("m", "sigma / m", &|(_, (deflection_m, sigma_m))| {
            format_rounded(Some(*deflection_m), *sigma_m, 4)
        }),
        One("<reported", &|(one, _)| {
            if *one == reported { "yes" } else { "" }.to_owned()
        }),
    ])
}

/// Smallest fraction of the variance for which a source is named in the budget sentence.
const MIN_NAMED_SHARE: f64 = 0.02;

/// Describes an uncertainty budget in a sentence; empty without one.
pub fn budget_text(budget: &[VarianceShare]) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let (large, small): (Vec<_>, Vec<_>) =
        budget.iter().partition(|one| one.share >= MIN_NAMED_SHARE);
    let mut parts: Vec<String> = large
        .iter()
        .map(|one| format!("{} {}", one.source, percent(one.share)))
        .collect();
    let rest: f64 = small.iter().map(|one| one.share).sum();
    if !small.is_empty() {
        parts.push(format!("others {}", percent(rest)));
    }
    if parts.is_empty() {
        return String::new();
    }
    let gains = budget
        .iter()
        .filter_map(|one| Some((one, one.sigma_if_known_m?)));
    let best = gains.min_by(|a, b| a.1.total_cmp(&b.1));
    let best = best.map_or(String::new(), |(one, sigma)| {
        format!(
            "; if {} were known without error, {} mm would remain",
            one.source,
            format_fixed(Some(1e3 * sigma), 1)
        )
    });
    format!("The variance comes from {}{best}.\n", parts.join(", "))
}

/// Builds the table of an uncertainty budget.
pub fn budget_table(shares: &[VarianceShare]) -> Grid {
    Grid::for_rows(shares).columns(&[
        One("<source", &|one| one.source.to_string()),
        One("contribution / %", &|one| {
            format_fixed(Some(100.0 * one.share), 1)
        }),
        One("sigma of the deflection if known / mm", &|one| {
            format_fixed(one.sigma_if_known_m.map(|sigma| 1e3 * sigma), 2)
        }),
    ])
}

/// Formats the detections of one frame; `ids` in their order, or empty if they are not identified.
pub fn detections_text(
    image: &str,
    found: &Detections,
    ids: &[Option<String>],
    wide: bool,
) -> String {
    let sigma = |m: &Detection, k: usize| m.covariance_px2.get((k, k)).map(|v| v.sqrt());
    let none = || NONE.to_owned();
    let named: Vec<(String, &Detection)> = (found.markers.iter().enumerate())
        .map(|(i, m)| (ids.get(i).cloned().flatten().unwrap_or_else(none), m))
        .collect();
    let grid = Grid::for_rows(&named).columns(&[
        One("<id", &|(id, _)| id.clone()),
        One("<shape", &|(_, m)| m.shape.name().to_owned()),
        Pair("u / px", "sigma u / px", &|(_, m)| {
            format_rounded(Some(m.centre_px.x), sigma(m, 0), 2)
        }),
        Pair("v / px", "sigma v / px", &|(_, m)| {
            format_rounded(Some(m.centre_px.y), sigma(m, 1), 2)
        }),
        One("semi-axes / px", &|(_, m)| {
            format!("{:.1} x {:.1}", m.semi_major_px, m.semi_minor_px)
        }),
        One("angle / deg", &|(_, m)| {
            format_fixed(Some(m.angle_rad.to_degrees()), 1)
        }),
    ]);
    let psf = found
        .psf_sigma_px
        .map(|s| format!(", blur {s:.2} px"))
        .unwrap_or_default();
    format!(
        "{image}: {}, {} rejected{psf}, noise {:.1} grey levels\n{}",
        count_text(found.markers.len(), "marker"),
        count_text(found.rejected.len(), "candidate"),
        found.noise,
        grid.text_with_width(wide)
    )
}

/// Formats one line per series, and an explanation of the deflections.
pub fn series_text(summaries: &[SeriesSummary], wide: bool) -> String {
    let reference = summaries.first().map(|s| s.reference).unwrap_or_default();
    let grid = series_table(summaries).text_with_width(wide);
    format!(
        "{grid}Deflection: mean for the tip marker, {}; sigma: standard deviation of one frame; scatter: of single frames about the mean.\n",
        reference.description()
    )
}

/// Builds the table of the series, for the terminal and the report.
pub fn series_table(summaries: &[SeriesSummary]) -> Grid {
    Grid::for_rows(summaries).columns(&[
        One("<series", &|s| s.name.clone()),
        One("<start (UTC)", &|s| s.begun_text()),
        One("frames", &|s| s.shots.to_string()),
        One("solved", &|s| s.solved.to_string()),
        Pair("mean tip deflection / m", "sigma / m", &|s| {
            mean_text(s.tip_deflection_m, 3)
        }),
        One("scatter / m", &|s| scatter_text(s.tip_deflection_m)),
        Pair("~torsion / deg", "~sigma / deg", &|s| {
            mean_text(s.torsion.first().and_then(|p| p.angle_deg), 2)
        }),
        Pair("~twist / deg", "~sigma / deg", &|s| {
            mean_text(s.torsion.first().and_then(|p| p.twist_deg), 2)
        }),
        One("~variance factor", &|s| s.variance_text()),
        One("tests passed", &|s| {
            format!("{}/{}", s.tests_passed, s.tests_made)
        }),
    ])
}

fn mean_text(value: Option<Mean>, fallback: usize) -> (String, String) {
    format_rounded(
        value.map(|m| m.value),
        value.and_then(|m| m.sigma),
        fallback,
    )
}

/// Formats the standard deviation of single frames about their mean.
pub fn scatter_text(value: Option<Mean>) -> String {
    value
        .and_then(|m| m.scatter)
        .map_or(NONE.to_owned(), |s| format_fixed(Some(s), decimals_for(s)))
}

/// Builds the table of the images, for the terminal and the report. Records without markers have `counts`.
pub fn image_table(
    records: &[ImageRecord],
    counts: &[MarkerCount],
    reference: DeflectionReference,
) -> Grid {
    let counted = |(k, r)| {
        (
            r,
            counts
                .get(k)
                .copied()
                .unwrap_or_else(|| MarkerCount::from_record(r)),
        )
    };
    let rows: Vec<_> = records.iter().enumerate().map(counted).collect();
    let tip = |r: &ImageRecord| r.tip.as_ref().map_or(NONE.to_owned(), Tip::label);
    let deflection = |r: &ImageRecord| {
        let (deflection_m, sigma_m) = r
            .tip
            .as_ref()
            .and_then(|tip| tip.deflection(reference))
            .unzip();
        format_rounded(deflection_m, sigma_m.flatten(), 3)
    };
    let pair = |r: &ImageRecord, values: fn(&TorsionRecord) -> (Option<f64>, Option<f64>)| {
        let (value, sigma) = r.torsion.first().map(values).unwrap_or_default();
        format_rounded(value, sigma, 2)
    };
    Grid::for_rows(&rows).columns(&[
        One("<image", &|(r, _)| r.image.clone()),
        One("~<method", &|(r, _)| {
            if r.flight {
                "flight".to_owned()
            } else {
                variant_name(r.method)
            }
        }),
        One("<tip", &|(r, _)| tip(r)),
        Pair("deflection / m", "sigma / m", &|(r, _)| deflection(r)),
        Pair("~torsion / deg", "~sigma / deg", &|(r, _)| {
            pair(r, |p| (p.angle_deg, p.sigma_deg))
        }),
        Pair("twist / deg", "sigma / deg", &|(r, _)| {
            pair(r, |p| (p.twist_deg, p.sigma_twist_deg))
        }),
        One("used", &|(_, count)| {
            format!("{}/{}", count.used, count.surveyed)
        }),
        One("variance factor", &|(r, _)| {
            format_fixed(r.variance_factor, 2)
        }),
        One("<verdict", &|(r, _)| verdict_text(r)),
    ])
}

/// Returns the verdict of the global test, or the status of a result that must not be used.
fn verdict_text(record: &ImageRecord) -> String {
    match record.status {
        RecordStatus::Ok => record.global_test.map_or(NONE.to_owned(), variant_name),
        other => variant_name(other),
    }
}

/// Builds the table of the markers of one image, for the terminal and the report.
pub fn marker_table(record: &ImageRecord, reference: DeflectionReference) -> Grid {
    let deflection = |m: &MarkerRecord| {
        let (value, sigma) = m.deflection(reference);
        format_rounded(value, sigma, 3)
    };
    Grid::for_rows(&record.markers).columns(&[
        One("<marker", &|m| m.id.clone()),
        One("~<shape", &|m| m.shape.name().to_owned()),
        One("u / px", &|m| format_rounded(m.u_px, m.sigma_u_px, 2).0),
        One("v / px", &|m| format_rounded(m.v_px, m.sigma_v_px, 2).0),
        One("~sigma u / px", &|m| {
            format_rounded(m.u_px, m.sigma_u_px, 2).1
        }),
        One("~sigma v / px", &|m| {
            format_rounded(m.v_px, m.sigma_v_px, 2).1
        }),
        One("residual u / px", &|m| format_fixed(m.residual_u_px, 3)),
        One("residual v / px", &|m| format_fixed(m.residual_v_px, 3)),
        Pair("~distance / m", "~sigma / m", &|m| {
            format_rounded(m.distance_m, m.sigma_distance_m, 3)
        }),
        Pair("deflection / m", "sigma / m", &deflection),
        One("~w", &|m| format_fixed(m.w_test, 1)),
        One("<remark", &|m| marker_remark(m).to_owned()),
    ])
}

fn marker_remark(m: &MarkerRecord) -> &str {
    let other = if m.used { "" } else { "not used" };
    m.reason.as_deref().unwrap_or(other)
}

/// Lists the unused markers, one line for each kind of reason; each record comes with the prefix of its
/// name.
pub fn unused_markers<'a>(records: impl Iterator<Item = (impl Display, &'a ImageRecord)>) -> Grid {
    let unused = records
        .filter(|(_, r)| r.is_solved())
        .flat_map(|(prefix, r)| {
            let place = format!("{prefix}{}", r.image);
            let markers = r.markers.iter().filter(|m| !m.used);
            markers.map(move |m| (marker_remark(m), place.clone(), m.id.as_str()))
        });
    let mut kinds = gather_messages(unused);
    kinds.iter_mut().for_each(|kind| kind.subjects.sort());
    kinds.sort_by(|a, b| a.subjects.cmp(&b.subjects));
    Grid::for_rows(&kinds).columns(&[
        One("<marker", &|kind| kind.subjects.join(", ")),
        One("<reason", &|kind| kind.common_text().to_owned()),
        One("frames", &|kind| kind.count.to_string()),
        One("<first in", &|kind| kind.first.clone()),
    ])
}

/// Lists failures and remarks, each kind once with the number of its images.
fn image_notes(records: &[ImageRecord]) -> String {
    let texts = records.iter().flat_map(|r| {
        let all = r.reason.iter().chain(&r.remarks);
        all.map(move |text| (text.as_str(), r.image.clone(), ""))
    });
    let line = |kind: &MessageKind| match (kind.count, &kind.text, &kind.first) {
        // The message for an unreadable file begins with its name.
        (1, text, image) if text.starts_with(image) => format!("{text}\n"),
        (1, text, image) => format!("{image}: {text}\n"),
        (n, text, image) => format!("{image} and {} more: {text}\n", n - 1),
    };
    gather_messages(texts).iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    #[test]
    fn a_solved_image_shows_deflection_torsion_and_its_markers() {
        let text = results_text(&[sample::record("f01.jpg", 2.93)], true);
        for word in [
            "f01.jpg", "2.9300", "0.0060", "6.30", "0.20", "2.70", "passed", "M01", "hidden",
        ] {
            assert!(text.contains(word), "{word} is missing in\n{text}");
        }
    }

    #[test]
    fn a_doubtful_image_is_not_said_to_have_passed() {
        let doubtful = ImageRecord {
            status: RecordStatus::Doubtful,
            ..sample::record("f01.jpg", 2.93)
        };
        let text = results_text(&[doubtful], true);
        assert!(
            text.contains("doubtful") && !text.contains("passed"),
            "{text}"
        );
    }

    #[test]
    fn a_failed_image_shows_its_reason_and_no_number() {
        let text = results_text(
            &[sample::failed(
                "f02.jpg",
                "the file is cut short; copy it again",
            )],
            true,
        );
        assert!(text.contains("f02.jpg: the file is cut short; copy it again"));
        assert!(!text.contains("NaN") && text.contains("failed"));
    }

    #[test]
    fn several_images_list_each_unused_marker_once() {
        let text = results_text(
            &[sample::record("a.jpg", 2.9), sample::record("b.jpg", 2.8)],
            true,
        );
        let lines: Vec<&str> = text.lines().filter(|l| l.contains("hidden")).collect();
        assert_eq!(lines.len(), 1, "{text}");
        assert!(lines[0].contains('2') && lines[0].contains("a.jpg"));
    }

    #[test]
    fn a_remark_of_several_images_is_listed_once() {
        let images = ["a.jpg", "b.jpg", "c.jpg"].map(|image| {
            let remarks = vec!["curvature of 8 terms, chosen by test".to_owned()];
            ImageRecord {
                remarks,
                ..sample::record(image, 2.9)
            }
        });
        let text = results_text(&images, true);
        assert!(
            text.contains("a.jpg and 2 more: curvature of 8 terms"),
            "{text}"
        );
        assert_eq!(text.matches("curvature").count(), 1);
    }

    #[test]
    fn no_images_give_headings_only() {
        assert_eq!(results_text(&[], true).lines().count(), 2);
    }
}
