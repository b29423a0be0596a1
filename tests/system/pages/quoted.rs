//! Outputs and messages that the pages quote are those of the program; an ellipsis stands for text that is not shown.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use super::running::shell;
use super::{Block, ROOT, blocks, pages};

/// Text that stands for what a page does not quote.
const ELLIPSIS: &str = "…";

/// Returns whether a text has the parts of a quotation in their order.
fn has_parts(text: &str, quotation: &str) -> bool {
    let mut rest = text;
    quotation
        .split(ELLIPSIS)
        .map(str::trim)
        .all(|part| match rest.split_once(part) {
            Some((_, after)) => {
                rest = after;
                true
            }
            None => false,
        })
}

/// Block of output, not of further commands, directly below a block of commands.
pub fn shown_output<'a>(commands: &Block, all: &'a [Block]) -> Option<&'a Block> {
    let below = commands.line + commands.text.lines().count() + 3;
    all.iter().find(|block| {
        block.line == below && block.language == "text" && !block.text.starts_with("wingd ")
    })
}

/// Lines of a quotation that an output does not have in their order.
pub fn missing_lines(quotation: &Block, output: &str) -> Vec<String> {
    let mut lines = output.lines();
    let wanted = quotation
        .text
        .lines()
        .filter(|line| line.trim() != ELLIPSIS && !line.trim().is_empty());
    wanted
        .filter(|line| !lines.any(|printed| has_parts(printed, line)))
        .map(str::to_owned)
        .collect()
}

/// Pages that begin the rows of their tables with messages, quoted.
const PAGES_OF_MESSAGES: [&str; 2] = ["docs/troubleshooting.md", "docs/operations/camera.md"];

/// Shortest part of a message that is compared, characters: shorter ones are words around values.
const MIN_PART: usize = 6;

/// All sources, with the lines of a literal joined.
fn literals() -> String {
    let mut folders = vec![Path::new(ROOT).join("src"), Path::new(ROOT).join("crates")];
    let mut text = String::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.extension() {
                _ if path.is_dir() => folders.push(path),
                Some(ending) if ending == "rs" => {
                    text.push_str(&std::fs::read_to_string(path).unwrap())
                }
                _ => {}
            }
        }
    }
    let mut lines = text.split("\\\n");
    let first = lines.next().unwrap_or_default().to_owned();
    lines
        .fold(first, |joined, line| joined + line.trim_start())
        .replace("\\\"", "\"")
}

#[test]
fn messages_that_the_pages_explain_are_in_the_program() {
    let (sources, mut wrong) = (literals(), vec![]);
    let mut compared = 0;
    for (page, text) in pages()
        .iter()
        .filter(|(page, _)| PAGES_OF_MESSAGES.contains(&page.as_str()))
    {
        for cell in text
            .lines()
            .filter(|l| l.starts_with("| `"))
            .filter_map(|l| l.split(" | ").next())
        {
            for message in cell.split('`').skip(1).step_by(2) {
                compared += 1;
                let words = |part: &&str| part.len() >= MIN_PART;
                let parts = message
                    .split(ELLIPSIS)
                    .map(|part| part.trim_matches([' ', '(', ')', ':', ';', ',']));
                let missing = parts.filter(words).filter(|part| !sources.contains(part));
                wrong.extend(missing.map(|part| format!("{page}: nothing prints `{part}`")));
            }
        }
    }
    assert!(
        wrong.is_empty() && compared > 50,
        "{compared} compared\n{}",
        wrong.join("\n")
    );
}

/// Mean deflection of the outermost marker in the true frames of each series of two, m.
fn true_means() -> Vec<f64> {
    let text = std::fs::read_to_string(Path::new(ROOT).join("fixtures/demo/truth.json")).unwrap();
    let truth: Value = serde_json::from_str(&text).unwrap();
    let deflection = |frame: &Value| {
        let markers = frame["markers"].as_array().unwrap();
        markers.iter().find(|marker| marker["id"] == "M25").unwrap()["deflection_m"]
            .as_f64()
            .unwrap()
    };
    let flight = truth["frames"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|f| f["image"].as_str().unwrap().contains("flight"));
    let deflections: Vec<f64> = flight.map(deflection).collect();
    deflections
        .chunks(2)
        .map(|pair| pair.iter().sum::<f64>() / 2.0)
        .collect()
}

#[test]
fn the_readme_has_the_figures_of_the_demonstration() {
    let folder = tempfile::tempdir().unwrap();
    let printed =
        String::from_utf8(shell(folder.path(), "wingd demo --output demo").stdout).unwrap();
    let readme = std::fs::read_to_string(Path::new(ROOT).join("README.md")).unwrap();
    let quoted = blocks(&readme)
        .into_iter()
        .find(|block| block.text.starts_with("series "))
        .unwrap();
    assert_eq!(missing_lines(&quoted, &printed), [""; 0], "{printed}");
    let rows = printed.lines().filter(|line| line.starts_with("s0"));
    let cells: Vec<Vec<f64>> = rows
        .map(|row| {
            row.split_whitespace()
                .filter_map(|cell| cell.parse().ok())
                .collect()
        })
        .collect();
    let (truth, means): (Vec<f64>, Vec<f64>) =
        (true_means(), cells.iter().map(|row| row[2]).collect());
    let errors_mm: Vec<f64> = truth
        .iter()
        .zip(&means)
        .map(|(truth, mean)| 1e3 * (truth - mean))
        .collect();
    let (least, largest) = (
        errors_mm.iter().copied().fold(f64::MAX, f64::min),
        errors_mm.iter().copied().fold(0.0, f64::max),
    );
    let sigmas = errors_mm
        .iter()
        .zip(&cells)
        .map(|(error, row)| 1e-3 * error / row[3])
        .sum::<f64>()
        / 5.0;
    let text = readme.split_whitespace().collect::<Vec<_>>().join(" ");
    let sentences = [
        format!("{least:.0} to {largest:.0} mm larger, {sigmas:.1} standard deviations"),
        format!(
            "the change from first to last series is right to {:.0} mm",
            (errors_mm[0] - errors_mm[4]).abs().ceil()
        ),
    ];
    for sentence in sentences {
        assert!(text.contains(&sentence), "README.md needs: {sentence}");
    }
}

#[test]
fn the_comparison_of_quotations_detects_errors() {
    let block = |text: &str| Block {
        language: "text".into(),
        line: 1,
        text: text.into(),
    };
    assert_eq!(
        missing_lines(&block("a … c\n…\nd\n"), "x\na b c\ny\nd e\n"),
        [""; 0]
    );
    assert_eq!(missing_lines(&block("d\na\n"), "a\nd\n"), ["a"]);
    let sources: BTreeMap<&str, bool> = [("a c b", false), ("a b c", true)].into();
    sources
        .iter()
        .for_each(|(text, found)| assert_eq!(has_parts(text, "a … b … c"), *found));
}
