//! What the variance of the tip's deflection comes from, and what would help most.

use maud::{Markup, html};

use super::super::number::{count, fixed};
use super::super::{ReportData, distinct, summary, table};
use crate::record::{BudgetShare, GlobalTest, ImageRecord, Tip};

/// The section; a sentence where no result has a budget.
pub fn section(data: &ReportData) -> Markup {
    let reference = summary::reference(&data.series);
    let records = || data.series.iter().flat_map(summary::solved);
    let of_it = |r: &&ImageRecord| r.tip.as_ref().and_then(|tip| tip.reference) == Some(reference);
    let all: Vec<&ImageRecord> = records().filter(of_it).filter(|r| !r.budget.is_empty()).collect();
    let split = accepted(&all);
    let shares = mean(&split);
    html! {
        h2 id="budget" { "What the uncertainty comes from" }
        @if shares.is_empty() {
            p { "No result says what its variance comes from: results of older programs have no budget; " code { "wingd solve STORE" } " adds new ones." }
        } @else {
            p { (helps(&split, &shares)) }
            div.scroll { (table::budget(&shares).html()) }
            p.caption {
                "Shares of the variance of the tip marker's deflection " (reference.words()) ", by propagation through the adjustment as it was weighted; mean over "
                (split.len()) " of " (count(records().count(), "solved frame"))
                @if split.len() < all.len() { ", without those whose global test rejects the model" }
                ". Beside a share stands the standard deviation that would be left if the source were known without error; images and survey are never that. It is not what the other shares add up to: a source that is known tells of the others, too."
            }
        }
    }
}

/// Frames whose standard deviations are those of the sources; all where there are no others. A rejected frame's are scaled by
/// what its residuals say, which no source explains.
fn accepted<'a>(all: &[&'a ImageRecord]) -> Vec<&'a ImageRecord> {
    let passed: Vec<_> =
        all.iter().filter(|r| r.global_test != Some(GlobalTest::Rejected)).copied().collect();
    if passed.is_empty() { all.to_vec() } else { passed }
}

/// Means over frames; a source that a frame does not have has no share there, and brings nothing.
fn mean(records: &[&ImageRecord]) -> Vec<BudgetShare> {
    let n = records.len().max(1) as f64;
    let names = distinct(records.iter().flat_map(|r| &r.budget).map(|one| one.source.as_str()));
    let one = |name: &str| {
        let of = |r: &&ImageRecord| r.budget.iter().find(|one| one.source == name).cloned();
        let own = |r: &&ImageRecord| r.tip.as_ref().and_then(sigma_shown_m);
        let measured = records.iter().filter_map(of).any(|one| one.sigma_if_known_m.is_some());
        let known = |r: &&ImageRecord| of(r).and_then(|one| one.sigma_if_known_m).or_else(|| own(r));
        let squares: Option<f64> = records.iter().map(|r| known(r).map(|sigma| sigma * sigma)).sum();
        BudgetShare {
            source: name.to_owned(),
            share: records.iter().filter_map(of).map(|one| one.share).sum::<f64>() / n,
            sigma_if_known_m: squares.filter(|_| measured).map(|sum| (sum / n).sqrt()),
        }
    };
    let mut shares: Vec<_> = names.into_iter().map(one).collect();
    shares.sort_by(|a, b| b.share.total_cmp(&a.share));
    shares
}

/// Of the deflection that a frame shows, m.
fn sigma_shown_m(tip: &Tip) -> Option<f64> {
    tip.deflection(tip.reference.unwrap_or_default())?.1
}

/// What would help most.
fn helps(records: &[&ImageRecord], shares: &[BudgetShare]) -> String {
    let sigmas = records.iter().filter_map(|r| r.tip.as_ref().and_then(sigma_shown_m));
    let (sum, count) = sigmas.fold((0.0, 0.0), |(sum, count), sigma| (sum + sigma * sigma, count + 1.0));
    let mm = |metres: f64| fixed(Some(1e3 * metres), 1);
    let now = if count > 0.0 { format!(" of {} mm", mm(f64::sqrt(sum / count))) } else { String::new() };
    let known = shares.iter().filter_map(|one| Some((one, one.sigma_if_known_m?)));
    match (known.min_by(|a, b| a.1.total_cmp(&b.1)), shares.first()) {
        (Some((one, sigma)), _) => format!(
            "What would help most if it were known without error: {}. The standard deviation{now} of the tip's deflection would fall to {} mm.",
            one.source,
            mm(sigma)
        ),
        (None, Some(first)) => format!("The largest share of the variance is of: {}.", first.source),
        (None, None) => String::new(),
    }
}
