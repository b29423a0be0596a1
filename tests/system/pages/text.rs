//! Links lead somewhere, tables are whole, and nothing is too long to read.

use std::path::{Path, PathBuf};

use super::{ROOT, pages};

/// A heading as a link names it.
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
    let summary = &pages.iter().find(|(page, _)| page == "docs/SUMMARY.md").unwrap().1;
    let mut wrong = vec![];
    for (page, text) in &pages {
        let folder = Path::new(page).parent().unwrap();
        let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for target in targets.filter(|t| !t.contains("://") && !t.contains(' ')) {
            let (file, place) = target.split_once('#').unwrap_or((target, ""));
            let path = if file.is_empty() { PathBuf::from(page) } else { folder.join(file) };
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
        let listed = page.strip_prefix("docs/").filter(|name| *name != "SUMMARY.md");
        if let Some(name) = listed.filter(|name| !summary.contains(&format!("({name})"))) {
            wrong.push(format!("docs/SUMMARY.md does not list {name}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Words a page may have, and a paragraph, which a reader takes in at once.
const LONGEST_PAGE: usize = 3000;
const LONGEST_PARAGRAPH: usize = 120;

#[test]
fn no_page_and_no_paragraph_is_too_long_to_read() {
    let mut wrong = vec![];
    for (page, text) in pages() {
        let words = text.split_whitespace().count();
        if words > LONGEST_PAGE {
            wrong.push(format!("{page}: {words} words"));
        }
        let mut inside = false;
        let mut words = 0;
        for (number, line) in text.lines().chain([""]).enumerate() {
            let line = line.trim_start();
            inside ^= line.starts_with("```");
            let item = |l: &str| l.trim_start_matches(|c: char| c.is_ascii_digit()).starts_with(". ");
            let aside =
                inside || line.is_empty() || ["|", "#", "```"].iter().any(|mark| line.starts_with(mark));
            let begins = aside || line.starts_with("- ") || line.starts_with("* ") || item(line);
            if begins {
                if words > LONGEST_PARAGRAPH {
                    wrong.push(format!("{page}:{number}: a paragraph of {words} words"));
                }
                words = 0;
            }
            words += if aside { 0 } else { line.split_whitespace().count() };
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Cells of a table's row; `\\|` and code may hold the mark itself.
fn cells(row: &str) -> usize {
    row.trim().replace("\\|", "").trim_matches('|').split('|').count()
}

/// A blank line in a table parts its rows from its heading, and they are shown as text.
#[test]
fn every_table_has_a_heading() {
    let mut wrong = vec![];
    for (page, text) in pages() {
        let lines: Vec<&str> = text.lines().map(str::trim_start).collect();
        let begins = |k: usize| lines[k].starts_with('|') && (k == 0 || !lines[k - 1].starts_with('|'));
        let headed = |k: usize| lines.get(k + 1).is_some_and(|line| line.starts_with("|--"));
        wrong.extend(
            (0..lines.len()).filter(|k| begins(*k) && !headed(*k)).map(|k| format!("{page}:{}", k + 1)),
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
                wrong.push(format!("{page}:{}: {there} cells under {wanted} headings", number + 1));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A manual says what is; what was belongs into a decision.
const DIARY: [&str; 6] = ["used to be", "no longer", "previously", "formerly", "| before |", "as of today"];

#[test]
fn a_manual_is_no_diary() {
    let mut wrong = vec![];
    for (page, text) in pages().iter().filter(|(page, _)| !page.starts_with("docs/decisions/")) {
        let text = text.to_lowercase();
        wrong.extend(DIARY.iter().filter(|word| text.contains(**word)).map(|word| format!("{page}: {word}")));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
