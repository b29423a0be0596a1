//! Lines of IWG1 in a file: with or without a header, and glued together where a line end was lost.

use std::collections::BTreeMap;

use super::Quantity;
use super::layout::IWG1;
use crate::installation::Trouble;

/// The first field of a record.
pub(super) const KEYWORD: &str = "IWG1,";
/// The first field of a header, where a file has one.
const HEADER: &str = "HEADER,";

/// A line with its number.
pub(super) type Numbered = (u64, String);

/// The records of a text, each with its line, and what was mended.
///
/// # Errors
/// Where no line is one of IWG1.
pub(super) fn lines(text: &str) -> Result<(Vec<Numbered>, Vec<String>), Trouble> {
    let (mut found, mut glued, mut remarks) = (Vec::new(), Vec::new(), Vec::new());
    for (k, line) in text.lines().enumerate() {
        let number = k as u64 + 1;
        if line.starts_with(HEADER) {
            remarks.extend(misplaced(number, line));
            continue;
        }
        let parts = if is_record(line) { parts(line) } else { vec![line] };
        if parts.len() > 1 {
            glued.push(number);
        }
        found.extend(parts.into_iter().map(|part| (number, part.to_owned())));
    }
    found.retain(|(_, line): &Numbered| !line.trim().is_empty());
    if !found.iter().any(|(_, line)| is_record(line)) {
        let mend = "leave format = \"iwg1\" out of the mapping, and name its columns";
        return Err(Trouble::new(0, "", "holds no line of IWG1", mend));
    }
    if let Some(line) = glued.first() {
        let glued = glued.len();
        remarks.push(format!(
            "{glued} lines hold several records without a line end between them, line {line} first; they are parted"
        ));
    }
    let (found, other) = of_one_width(found);
    remarks.extend(other);
    Ok((found, remarks))
}

/// Whether a line's first field is the keyword.
fn is_record(line: &str) -> bool {
    let first = line.split(',').next().unwrap_or_default();
    first.trim_matches(['"', ' ', '\t']) == KEYWORD.trim_end_matches(',')
}

/// The records without those of another number of fields than most have, and a word on these: a field that is missing, or
/// one too many, moves all that stand behind it.
fn of_one_width(found: Vec<Numbered>) -> (Vec<Numbered>, Option<String>) {
    let width = |line: &str| line.split(',').count();
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    for (_, line) in found.iter().filter(|(_, line)| is_record(line)) {
        *counts.entry(width(line)).or_default() += 1;
    }
    let usual = counts.into_iter().max_by_key(|(_, count)| *count).map_or(0, |(width, _)| width);
    let (kept, other): (Vec<_>, Vec<_>) =
        found.into_iter().partition(|(_, line)| !is_record(line) || width(line) == usual);
    let word = other.first().map(|(line, _)| {
        let other = other.len();
        format!("left out: {other} records that have not {usual} fields as most have, line {line} first")
    });
    (kept, word)
}

/// A word on each field that a header names otherwise than the definition: IWG1 is read by the places of its fields.
fn misplaced(number: u64, header: &str) -> Vec<String> {
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    let other = |(field, quantity, _, word): (usize, Quantity, f64, &str)| {
        let name = names.get(field - 1).filter(|name| !name.to_lowercase().contains(word))?;
        let quantity = quantity.name();
        Some(format!(
            "to be looked at: line {number} names field {field} \"{name}\", which is read as {quantity}"
        ))
    };
    IWG1.into_iter().filter_map(other).collect()
}

/// A line cut before every keyword.
fn parts(line: &str) -> Vec<&str> {
    let starts: Vec<usize> = line.match_indices(KEYWORD).map(|(at, _)| at).filter(|at| *at > 0).collect();
    let ends = starts.iter().copied().chain([line.len()]);
    let begins = [0].into_iter().chain(starts.iter().copied());
    begins.zip(ends).filter_map(|(from, to)| line.get(from..to)).filter(|part| !part.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn headers_are_passed_over_and_glued_records_parted() {
        let text = "HEADER,TimeStamp\nIWG1,a,1\nIWG1,b,2IWG1,c,3\n\nnoise\n";
        let (lines, remarks) = lines(text).unwrap();
        let texts: Vec<(u64, &str)> = lines.iter().map(|(line, text)| (*line, text.as_str())).collect();
        assert_eq!(texts, [(2, "IWG1,a,1"), (3, "IWG1,b,2"), (3, "IWG1,c,3"), (5, "noise")]);
        assert!(remarks[0].contains("line 3"), "{remarks:?}");
        assert!(super::lines("a,b\n1,2\n").is_err());
    }
}
