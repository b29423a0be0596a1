//! Lines of IWG1 in a file: with or without a header, and joined if a line end was lost.

use std::collections::BTreeMap;

use super::Quantity;
use super::layout::IWG1;

/// First field of a record.
pub(super) const KEYWORD: &str = "IWG1,";
/// First field of a header, if a file has one.
const HEADER: &str = "HEADER,";

/// Line with its number.
pub(super) type NumberedLine = (u64, String);

/// Returns whether the first line with a text is a record of IWG1 or its header.
pub(super) fn is_iwg1(text: &str) -> bool {
    let first = text.lines().find(|line| !line.trim().is_empty());
    first.is_some_and(|line| line.starts_with(HEADER) || is_record(line))
}

/// Splits a text into records with their line numbers; returns remarks on repairs.
pub(super) fn split_records(text: &str) -> (Vec<NumberedLine>, Vec<String>) {
    let (mut found, mut glued, mut remarks) = (Vec::new(), Vec::new(), Vec::new());
    for (k, line) in text.lines().enumerate() {
        let number = k as u64 + 1;
        if line.starts_with(HEADER) {
            remarks.extend(check_header_names(number, line));
            continue;
        }
        let parts = if is_record(line) {
            split_at_keyword(line)
        } else {
            vec![line]
        };
        if parts.len() > 1 {
            glued.push(number);
        }
        found.extend(parts.into_iter().map(|part| (number, part.to_owned())));
    }
    found.retain(|(_, line): &NumberedLine| !line.trim().is_empty());
    if let Some(line) = glued.first() {
        let glued = glued.len();
        remarks.push(format!(
            "{glued} lines have several records without a line end between them, line {line} first; they were split"
        ));
    }
    let (found, other) = remove_odd_lengths(found);
    remarks.extend(other);
    (found, remarks)
}

/// Returns whether a line's first field is the keyword.
fn is_record(line: &str) -> bool {
    let first = line.split(',').next().unwrap_or_default();
    first.trim_matches(['"', ' ', '\t']) == KEYWORD.trim_end_matches(',')
}

/// Removes records whose number of fields differs from that of most records, with a remark: a missing or additional field
/// shifts those after it.
fn remove_odd_lengths(found: Vec<NumberedLine>) -> (Vec<NumberedLine>, Option<String>) {
    let field_count = |line: &str| line.split(',').count();
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    for (_, line) in found.iter().filter(|(_, line)| is_record(line)) {
        *counts.entry(field_count(line)).or_default() += 1;
    }
    let most_common = counts
        .into_iter()
        .max_by_key(|(_, count)| *count)
        .map_or(0, |(field_count, _)| field_count);
    let (kept, other): (Vec<_>, Vec<_>) = found
        .into_iter()
        .partition(|(_, line)| !is_record(line) || field_count(line) == most_common);
    let remark = other.first().map(|(line, _)| {
        let other = other.len();
        format!("omitted: {other} records that do not have {most_common} fields like most, line {line} first")
    });
    (kept, remark)
}

/// Returns a remark for each field that a header names differently from the definition: IWG1 is read by field position.
fn check_header_names(number: u64, header: &str) -> Vec<String> {
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    let other = |(field, quantity, _, remark): (usize, Quantity, f64, &str)| {
        let name = names
            .get(field - 1)
            .filter(|name| !name.to_lowercase().contains(remark))?;
        let quantity = quantity.name();
        Some(format!(
            "warning: line {number} names field {field} \"{name}\", which is read as {quantity}"
        ))
    };
    IWG1.into_iter().filter_map(other).collect()
}

/// Splits a line before every keyword.
fn split_at_keyword(line: &str) -> Vec<&str> {
    let starts: Vec<usize> = line
        .match_indices(KEYWORD)
        .map(|(at, _)| at)
        .filter(|at| *at > 0)
        .collect();
    let ends = starts.iter().copied().chain([line.len()]);
    let begins = [0].into_iter().chain(starts.iter().copied());
    begins
        .zip(ends)
        .filter_map(|(from, to)| line.get(from..to))
        .filter(|part| !part.is_empty())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_skipped_and_glued_records_split() {
        let text = "HEADER,TimeStamp\nIWG1,a,1\nIWG1,b,2IWG1,c,3\n\nnoise\n";
        let (lines, remarks) = split_records(text);
        let texts: Vec<(u64, &str)> = lines
            .iter()
            .map(|(line, text)| (*line, text.as_str()))
            .collect();
        assert_eq!(
            texts,
            [
                (2, "IWG1,a,1"),
                (3, "IWG1,b,2"),
                (3, "IWG1,c,3"),
                (5, "noise")
            ]
        );
        assert!(remarks[0].contains("line 3"), "{remarks:?}");
        assert!(is_iwg1(text) && !is_iwg1("a,b\n1,2\n"));
    }
}
