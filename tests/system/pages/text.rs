//! Links lead to pages and headings, tables are complete, sections are short and begin with their subject.

use std::path::{Path, PathBuf};

use super::{ROOT, pages};

/// Anchor of a heading in a link.
fn anchor(heading: &str) -> String {
    let kept = heading
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .collect::<String>();
    kept.trim().replace(' ', "-")
}

#[test]
fn links_lead_somewhere_and_every_page_is_in_the_book() {
    let pages = pages();
    let summary = &pages
        .iter()
        .find(|(page, _)| page == "docs/SUMMARY.md")
        .unwrap()
        .1;
    let mut wrong = vec![];
    for (page, text) in &pages {
        let folder = Path::new(page).parent().unwrap();
        let targets = text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split(')').next());
        for target in targets.filter(|t| !t.contains("://") && !t.contains(' ')) {
            let (file, place) = target.split_once('#').unwrap_or((target, ""));
            let path = if file.is_empty() {
                PathBuf::from(page)
            } else {
                folder.join(file)
            };
            let found = Path::new(ROOT).join(&path);
            let there = found.exists();
            let text = if there && !place.is_empty() {
                std::fs::read_to_string(&found).unwrap_or_default()
            } else {
                String::new()
            };
            let headed = |l: &str| l.starts_with('#') && anchor(l.trim_start_matches('#')) == place;
            if !there || !place.is_empty() && !text.lines().any(headed) {
                wrong.push(format!("{page}: {target}"));
            }
        }
        let listed = page
            .strip_prefix("docs/")
            .filter(|name| *name != "SUMMARY.md");
        if let Some(name) = listed.filter(|name| !summary.contains(&format!("({name})"))) {
            wrong.push(format!("docs/SUMMARY.md does not list {name}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Maximum number of words of prose in a section, and in a paragraph.
const MAX_SECTION_WORDS: usize = 600;
const MAX_PARAGRAPH_WORDS: usize = 120;

/// Whether a line of a page is neither prose nor in a list: a table, a heading, a block.
fn is_aside(line: &str) -> bool {
    line.is_empty()
        || ["|", "#", "```", "!["]
            .iter()
            .any(|mark| line.starts_with(mark))
}

#[test]
fn no_section_and_no_paragraph_is_too_long_to_read() {
    let mut wrong = vec![];
    for (page, text) in pages() {
        let (mut inside, mut paragraph, mut section, mut heading) = (false, 0, 0, "its beginning");
        for (number, line) in text.lines().chain(["", "# end"]).enumerate() {
            let line = line.trim_start();
            inside ^= line.starts_with("```");
            let item = |l: &str| {
                l.trim_start_matches(|c: char| c.is_ascii_digit())
                    .starts_with(". ")
            };
            let aside = inside || is_aside(line);
            if aside || line.starts_with("- ") || line.starts_with("* ") || item(line) {
                if paragraph > MAX_PARAGRAPH_WORDS {
                    wrong.push(format!("{page}:{number}: a paragraph of {paragraph} words"));
                }
                paragraph = 0;
            }
            if !inside && line.starts_with('#') {
                if section > MAX_SECTION_WORDS {
                    wrong.push(format!("{page}: {section} words below {heading}"));
                }
                (section, heading) = (0, line);
            }
            let words = if aside {
                0
            } else {
                line.split_whitespace().count()
            };
            (paragraph, section) = (paragraph + words, section + words);
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// First words with which the first sentence of a page does not name its subject.
const UNNAMED: [&str; 27] = [
    "of", "in", "at", "on", "by", "with", "for", "from", "to", "what", "which", "where", "when",
    "how", "why", "who", "that", "this", "these", "those", "it", "its", "they", "their", "here",
    "there", "as",
];

#[test]
fn the_first_sentence_of_a_page_names_its_subject() {
    let begins = |text: &str| {
        let lines = text
            .lines()
            .skip_while(|line| line.starts_with('#') || line.trim().is_empty());
        let line = lines.map(str::trim).next().unwrap_or_default().to_owned();
        let word = line
            .split(|c: char| !c.is_alphanumeric())
            .find(|word| !word.is_empty());
        let unnamed = word.is_some_and(|word| UNNAMED.contains(&word.to_lowercase().as_str()));
        (is_aside(&line) || line.starts_with("- ") || unnamed).then_some(line)
    };
    let manual = pages()
        .into_iter()
        .filter(|(page, _)| page != "docs/SUMMARY.md");
    let wrong: Vec<String> = manual
        .filter_map(|(page, text)| Some(format!("{page}: {}", begins(&text)?)))
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(begins("# A\n\nOf it.\n").is_some() && begins("# A\n\nThe camera.\n").is_none());
}

/// Cells of a row of a table; `\\|` and code may contain the separator.
fn cells(row: &str) -> usize {
    row.trim()
        .replace("\\|", "")
        .trim_matches('|')
        .split('|')
        .count()
}

/// A blank line in a table separates its rows from its heading, and they are shown as text.
#[test]
fn every_table_has_a_heading() {
    let mut wrong = vec![];
    for (page, text) in pages() {
        let lines: Vec<&str> = text.lines().map(str::trim_start).collect();
        let begins =
            |k: usize| lines[k].starts_with('|') && (k == 0 || !lines[k - 1].starts_with('|'));
        let headed = |k: usize| lines.get(k + 1).is_some_and(|line| line.starts_with("|--"));
        wrong.extend(
            (0..lines.len())
                .filter(|k| begins(*k) && !headed(*k))
                .map(|k| format!("{page}:{}", k + 1)),
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_row_of_a_table_has_its_headings_columns() {
    let mut wrong = vec![];
    for (page, text) in pages() {
        let mut columns = None;
        for (number, line) in text.lines().enumerate() {
            if !line.trim_start().starts_with('|') {
                columns = None;
                continue;
            }
            let (wanted, there) = (*columns.get_or_insert(cells(line)), cells(line));
            if wanted != there {
                wrong.push(format!(
                    "{page}:{}: {there} cells under {wanted} headings",
                    number + 1
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A manual describes the present; history belongs in a decision.
const DIARY: [&str; 6] = [
    "used to be",
    "no longer",
    "previously",
    "formerly",
    "| before |",
    "as of today",
];

#[test]
fn a_manual_is_no_diary() {
    let mut wrong = vec![];
    for (page, text) in pages()
        .iter()
        .filter(|(page, _)| !page.starts_with("docs/decisions/"))
    {
        let text = text.to_lowercase();
        wrong.extend(
            DIARY
                .iter()
                .filter(|word| text.contains(**word))
                .map(|word| format!("{page}: {word}")),
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
