//! Lines of IWG1 in a file: with or without a header, and glued together where a line end was lost.

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
    let (mut found, mut glued) = (Vec::new(), Vec::new());
    for (k, line) in text.lines().enumerate() {
        let number = k as u64 + 1;
        if line.trim().is_empty() || line.starts_with(HEADER) {
            continue;
        }
        let parts = parts(line);
        if parts.len() > 1 {
            glued.push(number);
        }
        found.extend(parts.into_iter().map(|part| (number, part.to_owned())));
    }
    if !found.iter().any(|(_, line)| line.trim_start().starts_with(KEYWORD)) {
        let mend = "leave format = \"iwg1\" out of the mapping, and name its columns";
        return Err(Trouble::new(0, "", "holds no line of IWG1", mend));
    }
    let first = glued.first().map(|line| {
        format!("{} lines hold several records without a line end between them, line {line} first; they are parted", glued.len())
    });
    Ok((found, first.into_iter().collect()))
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
        let text = "HEADER,TimeStamp\nIWG1,a,1\nIWG1,b,2,IWG1,c,3\n\nnoise\n";
        let (lines, remarks) = lines(text).unwrap();
        let texts: Vec<(u64, &str)> = lines.iter().map(|(line, text)| (*line, text.as_str())).collect();
        assert_eq!(texts, [(2, "IWG1,a,1"), (3, "IWG1,b,2,"), (3, "IWG1,c,3"), (5, "noise")]);
        assert!(remarks[0].contains("line 3"), "{remarks:?}");
        assert!(super::lines("a,b\n1,2\n").is_err());
    }
}
