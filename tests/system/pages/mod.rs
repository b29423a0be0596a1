//! Promises of README and docs: `commands` run, `keys` are known, `named` items exist, outputs are as `quoted`, and the
//! `text` is readable.

use std::path::{Path, PathBuf};

mod commands;
mod keys;
mod named;
mod quoted;
mod running;
mod text;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// A fenced block.
struct Block {
    language: String,
    line: usize,
    text: String,
}

impl Block {
    /// Its lines without comments, one for each command; a backslash continues a line.
    fn lines(&self) -> Vec<String> {
        let whole = self.text.replace("\\\n", " ");
        let lines = whole.lines().map(|line| {
            line.split(" #")
                .next()
                .unwrap_or_default()
                .trim()
                .to_owned()
        });
        lines.filter(|line| !line.is_empty()).collect()
    }
}

fn blocks(text: &str) -> Vec<Block> {
    let (mut all, mut open): (Vec<Block>, Option<Block>) = (vec![], None);
    for (number, line) in text.lines().enumerate() {
        match (line.trim_start().strip_prefix("```"), open.take()) {
            (Some(_), Some(block)) => all.push(block),
            (Some(language), None) => {
                let language = language.trim().to_owned();
                open = Some(Block {
                    language,
                    line: number + 1,
                    text: String::new(),
                });
            }
            (None, Some(mut block)) => {
                block.text.push_str(line);
                block.text.push('\n');
                open = Some(block);
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a block does not end");
    all
}

/// README and every page, decisions too, by their path below the root.
fn pages() -> Vec<(String, String)> {
    let mut all = vec![PathBuf::from("README.md")];
    let mut folders = vec![PathBuf::from("docs")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(Path::new(ROOT).join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let path = folder.join(entry.file_name());
            match path.extension() {
                _ if entry.path().is_dir() => folders.push(path),
                Some(ending) if ending == "md" => all.push(path),
                _ => {}
            }
        }
    }
    all.sort();
    let read = |path: PathBuf| {
        let text = std::fs::read_to_string(Path::new(ROOT).join(&path)).unwrap();
        (path.display().to_string(), text)
    };
    all.into_iter().map(read).collect()
}

/// Lines of blocks, and code within the text.
fn code(text: &str) -> Vec<String> {
    let mut all: Vec<String> = vec![];
    let mut inside = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            inside = !inside;
        } else if inside {
            all.push(
                line.split(" #")
                    .next()
                    .unwrap_or_default()
                    .trim()
                    .to_owned(),
            );
        } else {
            all.extend(line.split('`').skip(1).step_by(2).map(str::to_owned));
        }
    }
    all
}
