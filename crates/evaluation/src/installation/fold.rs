//! Combination of errors with the same cause.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use wingd_base::fault::{Fault, FaultSubject};

/// Largest number of similar errors that are reported individually; of more, the first represents all.
pub(super) const MAX_SIMILAR_FAULTS: usize = 3;

/// Combines the errors of each line without numbers: rows of units, repeated headers, totals. If many lines are affected,
/// the cause is the columns.
fn fold_lines_without_numbers(faults: Vec<Fault>) -> Vec<Fault> {
    let line = |f: &Fault| match f.subject {
        FaultSubject::Cell { line, .. } | FaultSubject::NoNumber { line, .. } => {
            Some((f.file.clone(), line))
        }
        _ => None,
    };
    let mut counts: BTreeMap<_, usize> = BTreeMap::new();
    let numbers = faults
        .iter()
        .filter(|f| matches!(f.subject, FaultSubject::NoNumber { .. }));
    numbers
        .filter_map(line)
        .for_each(|line| *counts.entry(line).or_default() += 1);
    counts.retain(|_, count| *count > MAX_SIMILAR_FAULTS);
    if counts.len() > MAX_SIMILAR_FAULTS {
        return faults;
    }
    let (of_these, mut kept): (Vec<_>, Vec<_>) = faults
        .into_iter()
        .partition(|f| line(f).is_some_and(|line| counts.contains_key(&line)));
    let remedy = "delete the line if it is a row of units, a second header or a total";
    let one = |(file, line): (PathBuf, u64)| {
        let problem = "has no numbers in columns that need them";
        Fault::in_table(file, FaultSubject::Line(line), problem, remedy)
    };
    kept.splice(
        0..0,
        of_these
            .iter()
            .filter_map(line)
            .collect::<BTreeSet<_>>()
            .into_iter()
            .map(one),
    );
    kept
}

/// Combines errors with the same cause on many lines, or in many cells of a line.
pub(super) fn fold_repeated(faults: Vec<Fault>) -> Vec<Fault> {
    let faults = fold_lines_without_numbers(faults);
    let kind = |f: &Fault| {
        let group = match f.subject {
            FaultSubject::Cell { column, .. } | FaultSubject::NoNumber { column, .. } => column,
            FaultSubject::Marker => "marker",
            FaultSubject::Line(_) => "line",
            FaultSubject::Place => f.place.as_str(),
        };
        (f.file.clone(), group.to_owned(), f.remedy.clone())
    };
    let kinds: Vec<_> = faults.iter().map(kind).collect();
    let mut kept: Vec<Fault> = vec![];
    for (k, mut fault) in faults.into_iter().enumerate() {
        let similar = kinds.iter().filter(|other| **other == kinds[k]).count();
        if similar > MAX_SIMILAR_FAULTS {
            if kinds[..k].contains(&kinds[k]) {
                continue;
            }
            fault.problem = format!("{}, and {} similar errors", fault.problem, similar - 1);
        }
        kept.push(fault);
    }
    kept
}
