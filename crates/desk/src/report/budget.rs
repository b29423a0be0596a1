//! Variance budget of the tip deflection, and the source whose reduction would gain most.

use maud::{Markup, html};

use wingd_evaluation::number::{count_text, format_fixed};
use wingd_evaluation::record::{ImageRecord, Tip};
use wingd_evaluation::results::{ReportData, distinct_values, summary, table};
use wingd_measure::adjust::VarianceShare;
use wingd_measure::estimation::quality::GlobalTest;
use wingd_measure::ordering::sort_by_value;

/// Returns the section; a sentence if no result has a budget.
pub fn budget_section(data: &ReportData) -> Markup {
    let reference = summary::common_reference(&data.series);
    let records = || data.series.iter().flat_map(summary::solved_records);
    let of_it = |r: &&ImageRecord| r.tip.as_ref().and_then(|tip| tip.reference) == Some(reference);
    let all: Vec<&ImageRecord> = records()
        .filter(of_it)
        .filter(|r| !r.budget.is_empty())
        .collect();
    let split = accepted_frames(&all);
    let shares = mean_budget(&split);
    html! {
        h2 id="budget" { "Uncertainty budget" }
        @if shares.is_empty() {
            p { "No result has a variance budget. Results of older program versions have none; " code { "wingd solve STORE" } " adds new results." }
        } @else {
            p { (table::budget_text(&shares)) }
            @let minor = shares.iter().position(|one| one.share < MINOR_SHARE).unwrap_or(shares.len());
            (table::budget_table(&shares[..minor]).html())
            @if minor < shares.len() {
                details {
                    summary { (count_text(shares.len() - minor, "source")) " below " (format_fixed(Some(1e2 * MINOR_SHARE), 0)) " %" }
                    (table::budget_table(&shares[minor..]).html())
                }
            }
            p.caption {
                "Contributions to the variance of the tip marker's deflection " (reference.description()) ", by propagation of the weighted observations and priors; mean over "
                (split.len()) " of " (count_text(records().count(), "solved frame"))
                @if split.len() < all.len() { ", excluding those whose global test rejects the model" }
                ". The last column is the standard deviation that would remain if the source were known without error. It is smaller than the sum of the other contributions, because knowing one source also constrains the others. Image and survey errors cannot be eliminated."
            }
        }
    }
}

/// Share of the variance below which a source is folded.
const MINOR_SHARE: f64 = 0.01;

/// Returns the frames not rejected by the global test, or all if there are none. A rejected frame's standard deviations are
/// scaled by its residuals, which no source explains.
fn accepted_frames<'a>(all: &[&'a ImageRecord]) -> Vec<&'a ImageRecord> {
    let passed: Vec<_> = all
        .iter()
        .filter(|r| r.global_test != Some(GlobalTest::Rejected))
        .copied()
        .collect();
    if passed.is_empty() {
        all.to_vec()
    } else {
        passed
    }
}

/// Averages the budgets over frames; a source missing in a frame contributes 0 there.
fn mean_budget(records: &[&ImageRecord]) -> Vec<VarianceShare> {
    let n = records.len().max(1) as f64;
    let names = distinct_values(
        records
            .iter()
            .flat_map(|r| &r.budget)
            .map(|one| one.source.as_ref()),
    );
    let one = |name: &str| {
        let share_of_source =
            |r: &&ImageRecord| r.budget.iter().find(|one| one.source == name).cloned();
        let own = |r: &&ImageRecord| r.tip.as_ref().and_then(sigma_shown_m);
        let measured = records
            .iter()
            .filter_map(share_of_source)
            .any(|one| one.sigma_if_known_m.is_some());
        let known = |r: &&ImageRecord| {
            share_of_source(r)
                .and_then(|one| one.sigma_if_known_m)
                .or_else(|| own(r))
        };
        let squares: Option<f64> = records
            .iter()
            .map(|r| known(r).map(|sigma| sigma * sigma))
            .sum();
        VarianceShare {
            source: name.to_owned().into(),
            share: records
                .iter()
                .filter_map(share_of_source)
                .map(|one| one.share)
                .sum::<f64>()
                / n,
            sigma_if_known_m: squares.filter(|_| measured).map(|sum| (sum / n).sqrt()),
        }
    };
    let mut shares: Vec<_> = names.into_iter().map(one).collect();
    sort_by_value(&mut shares, |one| -one.share);
    shares
}

/// Returns the standard deviation of the reported deflection of a frame, m.
fn sigma_shown_m(tip: &Tip) -> Option<f64> {
    tip.deflection(tip.reference.unwrap_or_default())?.1
}
