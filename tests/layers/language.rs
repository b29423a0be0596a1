//! The language of names and texts.
//!
//! - Words of the private dialect do not return to doc comments, strings, scripts and pages ([`BANNED`]).
//! - A type's name is unique in its crate; public items are documented.
//!
//! Each check is shown a breach, which it must see.

use std::collections::BTreeMap;
use std::path::Path;

use crate::texts::Texts;

/// Words and phrases with a private meaning; each has a standard term.
const BANNED: [&str; 11] = [
    "tell",
    "told",
    "mend",
    "taught",
    "anew",
    "alike",
    "tachymeter",
    "sought",
    "foretell",
    "so many",
    "by chance",
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
    crate::product_files()
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
    let inside = path
        .strip_prefix("crates/")
        .and_then(|rest| rest.split('/').next());
    inside.unwrap_or("wingd")
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
    all.extend(collect("python", &[".py", ".sql"]));
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
            let hits = banned(line).into_iter();
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
fn public_items_are_documented() {
    let texts = Texts::read(&sources());
    assert!(
        texts.undocumented.is_empty(),
        "{}",
        texts.undocumented.join("\n")
    );
}

#[test]
fn the_checks_of_language_see_a_breach() {
    assert_eq!(
        banned("What flights told, and so  many of them; `told`"),
        ["told", "so many"]
    );
    assert!(banned("Estimates the sharpening. `told`").is_empty());
    let source = "/// Of it.\npub struct A;\npub fn of() -> &'static str { format!(\"so many {}\", 1) }\n\
        #[cfg(test)] mod tests { struct A; fn at() {} }";
    let texts = Texts::read(&[("src/a.rs".into(), source.into())]);
    assert_eq!((texts.types.len(), texts.strings.len()), (1, 1));
    assert_eq!(texts.undocumented, ["src/a.rs: of"]);
    let only = [
        ("src/b.rs".to_owned(), "#[cfg(test)]\nmod tests;".to_owned()),
        ("src/b/tests.rs".to_owned(), "struct C;".to_owned()),
    ];
    assert!(Texts::read(&only).types.is_empty());
}
