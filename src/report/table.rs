//! The tables that a terminal and the report share are laid out here.

use super::MarkerCount;
use super::grid::Grid;
use super::number::{NONE, count, decimals_for, fixed, rounded};
use super::summary::{Mean, SeriesSummary};
use crate::measure::detect::{Detection, Detections};
use crate::record::{BudgetShare, ImageRecord, MarkerRecord, Reference, Tip, TorsionRecord, word};

/// One line per image; below it the markers where there is one image only, otherwise the markers
/// that were turned down, then failures and remarks.
pub fn results(records: &[ImageRecord], wide: bool) -> String {
    let reference = Reference::of(records.iter().filter_map(|r| r.tip.as_ref()));
    let mut out = images(records, reference).text_at(wide);
    let notes = notes(records);
    out.push_str(&deflections(records, reference));
    match records {
        // Of a frame that was never read there is nothing to show but the reason.
        [one] if one.markers.iter().any(|m| m.used || m.u_px.is_some()) => {
            out.push_str(&format!("\n{}", markers(one).text_at(wide)));
        }
        [one] if !one.is_solved() => {}
        _ => {
            let unused = unused(records);
            if !unused.rows.is_empty() {
                out.push_str(&format!("\nMarkers not used\n{}", unused.text_at(wide)));
            }
        }
    }
    if !notes.is_empty() {
        out.push_str(&format!("\n{notes}"));
    }
    out
}

/// Which deflection the table shows; of one image all three and the budget.
fn deflections(records: &[ImageRecord], reference: Reference) -> String {
    match records {
        [ImageRecord { tip: Some(tip), budget, .. }] if tip.reference.is_some() => {
            format!("\n{}{}", self::tip(tip).text(), budget_text(budget))
        }
        _ if records.iter().any(|r| r.tip.is_some()) => {
            format!("Deflections are counted {}.\n", reference.words())
        }
        _ => String::new(),
    }
}

/// The tip's three deflections.
pub fn tip(tip: &Tip) -> Grid {
    let shown = tip.reference.unwrap_or_default();
    let deflections: Vec<_> =
        Reference::ALL.iter().filter_map(|one| Some((*one, tip.deflection(*one)?))).collect();
    let pair = |deflection: &(f64, Option<f64>)| rounded(Some(deflection.0), deflection.1, 4);
    Grid::each(&deflections).columns(&[
        ("<deflection of", &|_| tip.marker.clone()),
        ("<counted", &|(one, _)| one.words().to_owned()),
        ("m", &|(_, deflection)| pair(deflection).0),
        ("sigma / m", &|(_, deflection)| pair(deflection).1),
        ("<shown", &|(one, _)| if *one == shown { "yes" } else { "" }.to_owned()),
    ])
}

/// Sources of a share below this are not named one by one in a sentence.
const NAMED_SHARE: f64 = 0.02;

/// A budget in a sentence; empty without one.
pub fn budget_text(budget: &[BudgetShare]) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let (large, small): (Vec<_>, Vec<_>) = budget.iter().partition(|one| one.share >= NAMED_SHARE);
    let mut parts: Vec<String> =
        large.iter().map(|one| format!("{} {}", one.source, percent(one.share))).collect();
    let rest: f64 = small.iter().map(|one| one.share).sum();
    if !small.is_empty() {
        parts.push(format!("others {}", percent(rest)));
    }
    if parts.is_empty() {
        return String::new();
    }
    let helps = budget.iter().filter_map(|one| Some((one, one.sigma_if_known_m?)));
    let best = helps.min_by(|a, b| a.1.total_cmp(&b.1));
    let best = best.map_or(String::new(), |(one, sigma)| {
        format!("; were {} known without error, {} mm would be left", one.source, fixed(Some(1e3 * sigma), 1))
    });
    format!("Its variance comes from {}{best}.\n", parts.join(", "))
}

/// One budget as a table.
pub fn budget(shares: &[BudgetShare]) -> Grid {
    Grid::each(shares).columns(&[
        ("<source", &|one| one.source.clone()),
        ("share / %", &|one| fixed(Some(100.0 * one.share), 1)),
        ("sigma of the deflection if it were known / mm", &|one| {
            fixed(one.sigma_if_known_m.map(|sigma| 1e3 * sigma), 2)
        }),
    ])
}

/// The markers of one frame as detected; `ids` in their order, or empty where none are known.
pub fn detections(image: &str, found: &Detections, ids: &[Option<String>], wide: bool) -> String {
    let sigma = |m: &Detection, k: usize| m.covariance_px2.get((k, k)).map(|v| v.sqrt());
    let u = |m: &Detection| rounded(Some(m.centre_px.x), sigma(m, 0), 2);
    let v = |m: &Detection| rounded(Some(m.centre_px.y), sigma(m, 1), 2);
    let none = || NONE.to_owned();
    let named: Vec<(String, &Detection)> = (found.markers.iter().enumerate())
        .map(|(i, m)| (ids.get(i).cloned().flatten().unwrap_or_else(none), m))
        .collect();
    let grid = Grid::each(&named).columns(&[
        ("<id", &|(id, _)| id.clone()),
        ("<shape", &|(_, m)| m.shape.name().to_owned()),
        ("u / px", &|(_, m)| u(m).0),
        ("sigma u / px", &|(_, m)| u(m).1),
        ("v / px", &|(_, m)| v(m).0),
        ("sigma v / px", &|(_, m)| v(m).1),
        ("semi-axes / px", &|(_, m)| format!("{:.1} x {:.1}", m.semi_major_px, m.semi_minor_px)),
        ("angle / deg", &|(_, m)| fixed(Some(m.angle_rad.to_degrees()), 1)),
    ]);
    let psf = found.psf_sigma_px.map(|s| format!(", blur {s:.2} px")).unwrap_or_default();
    format!(
        "{image}: {}, {} turned down{psf}, noise {:.1} grey levels\n{}",
        count(found.markers.len(), "marker"),
        count(found.rejected.len(), "candidate"),
        found.noise,
        grid.text_at(wide)
    )
}

/// One line per series, and what its deflections are.
pub fn series(summaries: &[SeriesSummary], wide: bool) -> String {
    let reference = summaries.first().map(|s| s.reference).unwrap_or_default();
    let grid = series_grid(summaries).text_at(wide);
    format!(
        "{grid}Deflection: mean of the tip marker's, {}; sigma: of one frame; scatter: of single frames about the mean.\n",
        reference.words()
    )
}

/// One row per series; the terminal's and the report's.
pub fn series_grid(summaries: &[SeriesSummary]) -> Grid {
    let angle = |s: &SeriesSummary| mean(s.torsion.first().and_then(|p| p.angle_deg), 2);
    let twist = |s: &SeriesSummary| mean(s.torsion.first().and_then(|p| p.twist_deg), 2);
    Grid::each(summaries).columns(&[
        ("<series", &|s| s.name.clone()),
        ("<begun (UTC)", &|s| s.begun_text()),
        ("frames", &|s| s.shots.to_string()),
        ("solved", &|s| s.solved.to_string()),
        ("mean tip deflection / m", &|s| mean(s.tip_deflection_m, 3).0),
        ("sigma / m", &|s| mean(s.tip_deflection_m, 3).1),
        ("scatter / m", &|s| scatter(s.tip_deflection_m)),
        ("~torsion / deg", &|s| angle(s).0),
        ("~sigma / deg", &|s| angle(s).1),
        ("~twist / deg", &|s| twist(s).0),
        ("~sigma / deg", &|s| twist(s).1),
        ("~variance factor", &|s| s.variance_text()),
        ("test passed", &|s| format!("{}/{}", s.tests_passed, s.tests_made)),
    ])
}

fn mean(value: Option<Mean>, fallback: usize) -> (String, String) {
    rounded(value.map(|m| m.value), value.and_then(|m| m.sigma), fallback)
}

/// Standard deviation of single frames about their mean.
pub fn scatter(value: Option<Mean>) -> String {
    value.and_then(|m| m.scatter).map_or(NONE.to_owned(), |s| fixed(Some(s), decimals_for(s)))
}

/// One row per image; the terminal's and the report's.
pub fn images(records: &[ImageRecord], reference: Reference) -> Grid {
    image_rows(&records.iter().map(|r| (r, MarkerCount::of(r))).collect::<Vec<_>>(), reference)
}

/// The same of records whose markers were left out.
pub fn images_counted(records: &[ImageRecord], counts: &[MarkerCount], reference: Reference) -> Grid {
    image_rows(&records.iter().zip(counts.iter().copied()).collect::<Vec<_>>(), reference)
}

fn image_rows(rows: &[(&ImageRecord, MarkerCount)], reference: Reference) -> Grid {
    let tip = |r: &ImageRecord| r.tip.as_ref().map_or(NONE.to_owned(), |t| t.marker.clone());
    let deflection = |r: &ImageRecord| {
        let (deflection_m, sigma_m) = r.tip.as_ref().and_then(|tip| tip.deflection(reference)).unzip();
        rounded(deflection_m, sigma_m.flatten(), 3)
    };
    let pair = |r: &ImageRecord, of: fn(&TorsionRecord) -> (Option<f64>, Option<f64>)| {
        let (value, sigma) = r.torsion.first().map(of).unwrap_or_default();
        rounded(value, sigma, 2)
    };
    let angle = |r: &ImageRecord| pair(r, |p| (p.angle_deg, p.sigma_deg));
    let twist = |r: &ImageRecord| pair(r, |p| (p.twist_deg, p.sigma_twist_deg));
    Grid::each(rows).columns(&[
        ("<image", &|(r, _)| r.image.clone()),
        ("~<status", &|(r, _)| word(r.status)),
        ("~<method", &|(r, _)| if r.flight { "flight".to_owned() } else { word(r.method) }),
        ("<tip", &|(r, _)| tip(r)),
        ("deflection / m", &|(r, _)| deflection(r).0),
        ("sigma / m", &|(r, _)| deflection(r).1),
        ("~torsion / deg", &|(r, _)| angle(r).0),
        ("~sigma / deg", &|(r, _)| angle(r).1),
        ("twist / deg", &|(r, _)| twist(r).0),
        ("sigma / deg", &|(r, _)| twist(r).1),
        ("used", &|(_, count)| format!("{}/{}", count.used, count.surveyed)),
        ("variance factor", &|(r, _)| fixed(r.variance_factor, 2)),
        ("<global test", &|(r, _)| r.global_test.map_or(NONE.to_owned(), word)),
    ])
}

/// Every marker of one image; the terminal's and the report's.
pub fn markers(record: &ImageRecord) -> Grid {
    let distance = |m: &MarkerRecord| rounded(m.distance_m, m.sigma_distance_m, 3);
    let reference = record.tip.as_ref().and_then(|tip| tip.reference).unwrap_or_default();
    let deflection = |m: &MarkerRecord| {
        let (value, sigma) = m.deflection(reference);
        rounded(value, sigma, 3)
    };
    Grid::each(&record.markers).columns(&[
        ("<marker", &|m| m.id.clone()),
        ("~<shape", &|m| m.shape.name().to_owned()),
        ("u / px", &|m| rounded(m.u_px, m.sigma_u_px, 2).0),
        ("v / px", &|m| rounded(m.v_px, m.sigma_v_px, 2).0),
        ("~sigma u / px", &|m| rounded(m.u_px, m.sigma_u_px, 2).1),
        ("~sigma v / px", &|m| rounded(m.v_px, m.sigma_v_px, 2).1),
        ("residual u / px", &|m| fixed(m.residual_u_px, 3)),
        ("residual v / px", &|m| fixed(m.residual_v_px, 3)),
        ("~distance / m", &|m| distance(m).0),
        ("~sigma / m", &|m| distance(m).1),
        ("deflection / m", &|m| deflection(m).0),
        ("sigma / m", &|m| deflection(m).1),
        ("~w", &|m| fixed(m.w_test, 1)),
        ("<remark", &remark),
    ])
}

fn remark(m: &MarkerRecord) -> String {
    match (&m.reason, m.used) {
        (Some(reason), _) => reason.clone(),
        (None, true) => String::new(),
        (None, false) => "not used".to_owned(),
    }
}

/// Markers that took no part, with the reason; the same marker and reason once, with its frames counted.
pub fn unused(records: &[ImageRecord]) -> Grid {
    unused_of(records.iter().map(|r| (String::new(), r)))
}

/// The same of several series, each record with what goes before its name.
pub fn unused_of<'a>(records: impl Iterator<Item = (String, &'a ImageRecord)>) -> Grid {
    let mut seen: Vec<(String, String, usize, String)> = Vec::new();
    for (prefix, r) in records.filter(|(_, r)| r.is_solved()) {
        for m in r.markers.iter().filter(|m| !m.used) {
            let reason = remark(m);
            match seen.iter_mut().find(|s| s.0 == m.id && s.1 == reason) {
                Some(s) => s.2 += 1,
                None => seen.push((m.id.clone(), reason, 1, format!("{prefix}{}", r.image))),
            }
        }
    }
    seen.sort_by(|a, b| a.0.cmp(&b.0));
    Grid::each(&seen).columns(&[
        ("<marker", &|s| s.0.clone()),
        ("<reason", &|s| s.1.clone()),
        ("frames", &|s| s.2.to_string()),
        ("<first in", &|s| s.3.clone()),
    ])
}

/// Reasons and remarks; the same one once, with its images counted.
fn notes(records: &[ImageRecord]) -> String {
    let mut seen: Vec<(&str, &str, usize)> = Vec::new();
    for r in records {
        for text in r.reason.iter().chain(&r.remarks) {
            match seen.iter_mut().find(|known| known.0 == text) {
                Some(known) => known.2 += 1,
                None => seen.push((text, &r.image, 0)),
            }
        }
    }
    let line = |(text, image, more): &(&str, &str, usize)| match more {
        // A file that could not be read names itself.
        0 if text.starts_with(image) => format!("{text}\n"),
        0 => format!("{image}: {text}\n"),
        _ => format!("{image} and {more} more: {text}\n"),
    };
    seen.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    #[test]
    fn a_solved_image_shows_deflection_torsion_and_its_markers() {
        let text = results(&[sample::record("f01.jpg", 2.93)], true);
        for word in ["f01.jpg", "2.9300", "0.0060", "6.30", "0.20", "2.70", "passed", "M01", "hidden"] {
            assert!(text.contains(word), "{word} is missing in\n{text}");
        }
    }

    #[test]
    fn a_failed_image_shows_its_reason_and_no_number() {
        let text = results(&[sample::failed("f02.jpg", "the file is cut short; copy it again")], true);
        assert!(text.contains("f02.jpg: the file is cut short; copy it again"));
        assert!(!text.contains("NaN") && text.contains("failed"));
    }

    #[test]
    fn several_images_list_the_markers_left_out_once() {
        let text = results(&[sample::record("a.jpg", 2.9), sample::record("b.jpg", 2.8)], true);
        let lines: Vec<&str> = text.lines().filter(|l| l.contains("hidden")).collect();
        assert_eq!(lines.len(), 1, "{text}");
        assert!(lines[0].contains('2') && lines[0].contains("a.jpg"));
    }

    #[test]
    fn a_remark_of_several_images_stands_once() {
        let images = ["a.jpg", "b.jpg", "c.jpg"].map(|image| {
            let remarks = vec!["curvature of 8 terms, chosen by test".to_owned()];
            ImageRecord { remarks, ..sample::record(image, 2.9) }
        });
        let text = results(&images, true);
        assert!(text.contains("a.jpg and 2 more: curvature of 8 terms"), "{text}");
        assert_eq!(text.matches("curvature").count(), 1);
    }

    #[test]
    fn no_images_give_headings_only() {
        assert_eq!(results(&[], true).lines().count(), 2);
    }
}
