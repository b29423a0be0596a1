//! The language of names and texts: standard terms, one for one thing, and names that say what they name.
//!
//! - Words of the private dialect do not return to doc comments, strings, scripts and pages ([`BANNED`]).
//! - A type's name is unique in its crate, no function is named by a preposition, public items are documented.
//! - Rates of words and of one-word names stay below those that hinder a reader.
//!
//! Each check is shown a breach, which it must see.

use std::collections::BTreeMap;
use std::path::Path;

use crate::texts::Texts;

/// Words and phrases with a private meaning; each has a standard term.
const BANNED: [&str; 43] = [
    "tell",
    "tells",
    "told",
    "telling",
    "mend",
    "mends",
    "mended",
    "mending",
    "taught",
    "teach",
    "teaches",
    "foretell",
    "foretells",
    "foretold",
    "anew",
    "beforehand",
    "by hand",
    "so many",
    "sought",
    "turned down",
    "left out",
    "to be looked at",
    "held against",
    "jolt",
    "jolts",
    "jolted",
    "tachymeter",
    "slip of the pen",
    "whole search",
    "feigns",
    "hearsay",
    "lesson",
    "lessons",
    "sighting",
    "sightings",
    "rung",
    "rungs",
    "what of it",
    "the same of",
    "told best",
    "by chance",
    "no chance",
    "mounted anew",
];

/// Where a banned phrase has its ordinary meaning: file, phrase.
const ALLOWED: [(&str, &str); 0] = [];

/// Names that say where or how, and not what a function does or returns.
const PREPOSITIONS: [&str; 36] = [
    "of", "at", "in", "on", "by", "with", "within", "without", "from", "to", "for", "as", "beside",
    "besides", "between", "among", "under", "over", "above", "below", "before", "after", "during",
    "through", "across", "against", "into", "out", "off", "up", "upon", "about", "around", "along",
    "beyond", "together",
];

/// Words with which a doc comment does not make sense alone, besides [`PREPOSITIONS`].
const PRONOUNS: [&str; 41] = [
    "since", "until", "per", "than", "via", "near", "like", "what", "which", "who", "whom",
    "whose", "where", "when", "whether", "how", "why", "that", "this", "these", "those", "it",
    "its", "they", "them", "their", "he", "his", "one", "ones", "same", "such", "so", "there",
    "if", "while", "because", "nothing", "none", "some", "others",
];

fn words(text: &str) -> Vec<String> {
    let prose = text.split('`').step_by(2).collect::<Vec<_>>().join(" ");
    let split = prose.split(|c: char| !c.is_alphanumeric() && c != '_' && c != '\'');
    split
        .filter(|word| word.contains(char::is_alphabetic))
        .map(str::to_lowercase)
        .collect()
}

/// Banned phrases of a text.
fn banned(text: &str) -> Vec<&'static str> {
    let words = words(text);
    let holds = |phrase: &&&str| {
        let sought: Vec<&str> = phrase.split(' ').collect();
        words
            .windows(sought.len())
            .any(|window| window.iter().eq(sought.iter()))
    };
    BANNED.iter().filter(holds).copied().collect()
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The product's sources, by path from the root.
fn sources() -> Vec<(String, String)> {
    crate::files("src")
        .into_iter()
        .map(|(path, text)| (format!("src/{path}"), text))
        .collect()
}

/// Files with an ending below a folder, by path from the root.
fn collect(folder: &str, endings: &[&str]) -> Vec<(String, String)> {
    let mut found = vec![];
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let path = format!("{folder}/{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                folders.push(path);
            } else if endings.iter().any(|ending| path.ends_with(ending)) {
                found.push((path, std::fs::read_to_string(entry.path()).unwrap()));
            }
        }
    }
    found.sort();
    found
}

/// The crate that a source belongs to.
fn krate(path: &str) -> &str {
    if path.starts_with("src/measure/") {
        "measure"
    } else {
        "wingd"
    }
}

fn prose(texts: &Texts) -> impl Iterator<Item = &(String, String)> {
    texts.docs.iter().chain(
        texts
            .strings
            .iter()
            .filter(|(_, text)| text.trim().contains(' ')),
    )
}

#[test]
fn the_dialect_does_not_return() {
    let texts = Texts::read(&sources());
    let mut all: Vec<(String, String)> = prose(&texts).cloned().collect();
    all.extend(collect("docs", &[".md", ".schema.json"]));
    all.extend(collect("fleet", &[".py", ".sql"]));
    all.extend(collect("src", &[".js"]));
    all.extend(collect("config", &[".toml"]));
    for page in ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"] {
        all.push((
            page.to_owned(),
            std::fs::read_to_string(root().join(page)).unwrap(),
        ));
    }
    let mut found = vec![];
    for (file, text) in &all {
        for (number, line) in text.lines().enumerate() {
            let hits = banned(line)
                .into_iter()
                .filter(|phrase| !ALLOWED.contains(&(file.as_str(), *phrase)));
            found.extend(hits.map(|phrase| {
                format!("{file}, line {} of the text: {phrase}: {line}", number + 1)
            }));
        }
    }
    assert!(
        found.is_empty(),
        "{} lines in dialect:\n{}",
        found.len(),
        found.join("\n")
    );
}

#[test]
fn names_of_types_are_unique_in_their_crate() {
    let texts = Texts::read(&sources());
    let mut places = BTreeMap::<(&str, &str), Vec<&str>>::new();
    for (file, name) in &texts.types {
        places.entry((krate(file), name)).or_default().push(file);
    }
    // Twins under different features are one type.
    let shared = places
        .iter()
        .filter(|(_, files)| files.iter().any(|file| *file != files[0]));
    let shared: Vec<String> = shared
        .map(|((_, name), files)| format!("{name}: {}", files.join(", ")))
        .collect();
    assert!(
        shared.is_empty(),
        "{} names for several types:\n{}",
        shared.len(),
        shared.join("\n")
    );
}

#[test]
fn no_function_is_named_by_a_preposition() {
    let texts = Texts::read(&sources());
    let bare = texts
        .functions
        .iter()
        .filter(|f| PREPOSITIONS.contains(&f.name.as_str()));
    let found: Vec<String> = bare.map(|f| format!("{}: fn {}", f.file, f.name)).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn public_items_are_documented() {
    let texts = Texts::read(&sources());
    assert!(
        texts.undocumented.is_empty(),
        "{}",
        texts.undocumented.join("\n")
    );
}

/// Percentage of items that a predicate selects.
fn percentage<T>(items: &[T], selects: impl Fn(&T) -> bool) -> f64 {
    100.0 * items.iter().filter(|item| selects(item)).count() as f64 / items.len() as f64
}

fn begins_badly(doc: &str) -> bool {
    words(doc)
        .first()
        .is_some_and(|w| PREPOSITIONS.contains(&w.as_str()) || PRONOUNS.contains(&w.as_str()))
}

/// Occurrences of some words in 10,000.
fn rate(words: &[String], these: &[&str]) -> f64 {
    1e4 * words
        .iter()
        .filter(|word| these.contains(&word.as_str()))
        .count() as f64
        / words.len() as f64
}

/// The bounds lie between the rates of mrcal, ntpd-rs, COLMAP and uv and those at which readers stumbled here.
#[test]
fn names_and_texts_read_as_those_of_other_projects() {
    let texts = Texts::read(&sources());
    let one_word = |name: &str| !name.trim_matches('_').contains('_');
    let free: Vec<_> = texts.functions.iter().filter(|f| f.free).collect();
    let all: Vec<String> = prose(&texts).flat_map(|(_, text)| words(text)).collect();
    let mut uses = BTreeMap::<&str, usize>::new();
    texts
        .types
        .iter()
        .for_each(|(_, name)| *uses.entry(name).or_default() += 1);
    let (what, if_) = (rate(&all, &["what"]), rate(&all, &["if"]));
    let figures = [
        (
            "free functions of one word, %",
            percentage(&free, |f| one_word(&f.name)),
            0.0..=25.0,
        ),
        (
            "functions of one word, %",
            percentage(&texts.functions, |f| one_word(&f.name)),
            0.0..=45.0,
        ),
        (
            "types of a shared name, %",
            percentage(&texts.types, |(_, name)| uses[name.as_str()] > 1),
            0.0..=20.0,
        ),
        (
            "doc comments that begin badly, %",
            percentage(&texts.docs, |(_, d)| begins_badly(d)),
            0.0..=5.0,
        ),
        ("what in 10,000 words", what, 0.0..=30.0),
        ("if in 10,000 words", if_, 20.0..=200.0),
    ];
    let line = |(name, value, bounds): &(&str, f64, std::ops::RangeInclusive<f64>)| {
        format!(
            "{name}: {value:.1} ({bounds:?}){}",
            if bounds.contains(value) {
                ""
            } else {
                "  <- outside"
            }
        )
    };
    let lines: Vec<String> = figures.iter().map(line).collect();
    println!("{}", lines.join("\n"));
    assert!(
        figures
            .iter()
            .all(|(_, value, bounds)| bounds.contains(value)),
        "{}",
        lines.join("\n")
    );
}

#[test]
fn the_checks_of_language_see_a_breach() {
    assert_eq!(
        banned("What flights told, and so  many of them; `told`"),
        ["told", "so many"]
    );
    assert!(banned("Estimates the sharpening. `by hand`").is_empty());
    assert!(
        begins_badly(" Of it.")
            && begins_badly("What it is")
            && !begins_badly("The camera's pixel")
    );
    let source = "/// Of it.\npub struct A;\npub fn of() -> &'static str { format!(\"so many {}\", 1) }\n\
        #[cfg(test)] mod tests { struct A; fn at() {} }";
    let texts = Texts::read(&[("src/a.rs".into(), source.into())]);
    assert_eq!(
        (
            texts.types.len(),
            texts.functions.len(),
            texts.strings.len()
        ),
        (1, 1, 1)
    );
    assert_eq!(texts.undocumented, ["src/a.rs: of"]);
    let only = [
        ("src/b.rs".to_owned(), "#[cfg(test)]\nmod tests;".to_owned()),
        ("src/b/tests.rs".to_owned(), "struct C;".to_owned()),
    ];
    assert!(Texts::read(&only).types.is_empty());
}
