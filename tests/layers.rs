//! The structure of `src` and `crates`, read from their sources.
//!
//! - `measure` touches no file, clock, network or log. Imports between crates are the compiler's concern.
//! - The stages of detection: each uses only those below it.
//! - In every folder, at every depth, no imports of its files run in a circle. A folder in it counts as one file, with the
//!   file of its own name. What a folder's own file lends out by `use` counts as the file that it comes from.
//! - No file is longer than 500 lines; clippy limits functions to 100.
//!
//! Each check is shown a breach, which it must see. Tests in the sources may name what they like.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use syn::visit::Visit;

#[path = "layers/budget.rs"]
mod budget;
#[path = "layers/language.rs"]
mod language;
#[path = "layers/named.rs"]
mod named;

#[path = "layers/texts.rs"]
mod texts;

use named::{Named, Place, place};

/// What `measure` may not touch.
const IMPURE: [&str; 9] = [
    "std::fs",
    "std::net",
    "std::time",
    "std::thread",
    "std::process",
    "std::env",
    "tokio",
    "tracing",
    "jiff",
];

/// The stages of `crates/measure/src/detect`, lowest first: each uses only those before it, and itself.
const STAGES: [&str; 16] = [
    "numbers",
    "simd",
    "image",
    "detection",
    "appearance",
    "segment",
    "occlusion",
    "hypothesis",
    "sample",
    "estimate",
    "propose",
    "accept",
    "attempt",
    "revise",
    "scope",
    "search",
];

/// Lines of a file, at most.
const MAX_FILE_LINES: usize = 500;

/// Modules and what each names.
struct Sources(BTreeMap<Place, Read>);

struct Read {
    written: Vec<String>,
    places: Vec<Place>,
    taken: BTreeMap<String, Place>,
}

impl Sources {
    /// From modules and their texts.
    fn of(texts: &[(Place, String)]) -> Self {
        let modules: BTreeSet<Place> = texts.iter().map(|(place, _)| place.clone()).collect();
        let (mut all, mut for_tests) = (BTreeMap::new(), vec![]);
        for (own, text) in texts {
            let (written, places, taken, tests) = (vec![], vec![], BTreeMap::new(), vec![]);
            let mut named = Named {
                own: own.clone(),
                modules: &modules,
                written,
                places,
                taken,
                tests,
            };
            named.visit_file(&syn::parse_file(text).expect("source parses"));
            let Named {
                written,
                places,
                taken,
                tests,
                ..
            } = named;
            all.insert(
                own.clone(),
                Read {
                    written,
                    places,
                    taken,
                },
            );
            for_tests.extend(tests);
        }
        all.retain(|own, _| !for_tests.iter().any(|tests| own.starts_with(tests)));
        Self(all)
    }

    /// The module that something comes from: the longest beginning that is one, or whence that one has the name.
    fn origin(&self, named: &[String]) -> Place {
        let mut path = named.to_vec();
        for _ in 0..path.len() + 8 {
            let length = (0..=path.len())
                .rev()
                .find(|k| self.0.contains_key(&path[..*k]))
                .unwrap_or(0);
            let Some(name) = path.get(length) else { break };
            let lent = self
                .0
                .get(&path[..length])
                .and_then(|read| read.taken.get(name));
            match lent {
                Some(from) if *from != path[..=length] => {
                    path = [&from[..], &path[length + 1..]].concat()
                }
                _ => return path[..length].to_vec(),
            }
        }
        path
    }

    /// Of each folder which of its files names which, with an example.
    fn folders(&self) -> BTreeMap<Place, BTreeMap<(String, String), String>> {
        let mut folders = BTreeMap::<Place, BTreeMap<(String, String), String>>::new();
        for (own, read) in &self.0 {
            for named in &read.places {
                let from = self.origin(named);
                let depth = own.iter().zip(&from).take_while(|(a, b)| a == b).count();
                // A folder's own file is above or below all that is in it.
                if let (Some(one), Some(other)) = (own.get(depth), from.get(depth)) {
                    let pair = (one.clone(), other.clone());
                    let words = || format!("{} names {}", own.join("::"), named.join("::"));
                    folders
                        .entry(own[..depth].to_vec())
                        .or_default()
                        .entry(pair)
                        .or_insert_with(words);
                }
            }
        }
        folders
    }

    /// Every import that belongs to a circle, by folder.
    fn circles(&self) -> BTreeMap<String, Vec<String>> {
        let in_circles = |names: &BTreeMap<(String, String), String>| {
            let reaches = |from: &str, to: &str| {
                let (mut seen, mut ahead) = (BTreeSet::new(), vec![from]);
                while let Some(next) = ahead.pop() {
                    let there = names
                        .keys()
                        .filter(|(one, _)| one == next)
                        .map(|(_, other)| other.as_str());
                    ahead.extend(there.filter(|other| seen.insert(*other)));
                }
                seen.contains(to)
            };
            let back = names.iter().filter(|((one, other), _)| reaches(other, one));
            back.map(|(_, words)| words.clone()).collect::<Vec<_>>()
        };
        let all = self
            .folders()
            .into_iter()
            .map(|(folder, names)| (folder.join("/"), in_circles(&names)));
        all.filter(|(_, circles)| !circles.is_empty()).collect()
    }

    /// What of `measure` is not pure.
    fn impure(&self) -> Vec<String> {
        let hit = |path: &&String| {
            IMPURE
                .iter()
                .any(|root| place(path).starts_with(&place(root)))
        };
        let of_measure = |own: &Place| own.first().is_some_and(|krate| krate == "measure");
        let mut found = vec![];
        for (own, read) in self.0.iter().filter(|(own, _)| of_measure(own)) {
            let impure = read.written.iter().filter(hit);
            found.extend(
                impure.map(|path| format!("{} names {path}, which is not pure", own.join("::"))),
            );
        }
        found
    }

    /// What names a stage of detection above its own.
    fn stages(&self) -> Vec<String> {
        let detect = place("measure::detect");
        let stage = |path: &Place| {
            let name = path.strip_prefix(&detect[..])?.first()?;
            STAGES.iter().position(|stage| stage == name)
        };
        let inside = self
            .0
            .iter()
            .filter(|(own, _)| own.len() > 2 && own.starts_with(&detect));
        let named = inside.flat_map(|(own, read)| read.places.iter().map(move |path| (own, path)));
        let own_files = named.filter(|(_, path)| path.len() > 2 && path.starts_with(&detect));
        let up = own_files
            .filter(|(own, path)| stage(path).is_none_or(|s| stage(own).is_none_or(|o| s > o)));
        up.map(|(own, path)| format!("{} names {}", own.join("::"), path.join("::")))
            .collect()
    }
}

/// The files of a folder by their place in it.
fn files(folder: &str) -> Vec<(String, String)> {
    fn collect(root: &Path, directory: &Path, into: &mut Vec<(String, String)>) {
        for entry in std::fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                collect(root, &path, into);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let inside = path
                    .strip_prefix(root)
                    .unwrap()
                    .to_string_lossy()
                    .into_owned();
                into.push((inside, std::fs::read_to_string(&path).unwrap()));
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut files = vec![];
    collect(&root, &root, &mut files);
    files
}

/// The product's sources, by path from the root: `src` and `crates`, without the tests of crates.
fn product_files() -> Vec<(String, String)> {
    let mut all = vec![];
    for folder in ["src", "crates"] {
        let found = files(folder).into_iter();
        all.extend(found.map(|(path, text)| (format!("{folder}/{path}"), text)));
    }
    all.retain(|(path, _)| path.split('/').nth(2) != Some("tests") || !path.starts_with("crates/"));
    all
}

/// The place of a source: its crate (`wingd` for `src`), then its modules.
fn module_place(path: &str) -> Place {
    let inside = path.trim_end_matches(".rs").replace('/', "::");
    let mut own = match inside.strip_prefix("crates::") {
        Some(rest) => place(&rest.replacen("::src", "", 1)),
        None => place(&inside.replacen("src", "wingd", 1)),
    };
    own.pop_if(|last| ["mod", "lib"].contains(&last.as_str()));
    own
}

fn sources() -> Sources {
    let mut files = product_files();
    files.retain(|(path, _)| path != "src/main.rs");
    assert!(files.len() > 300, "only {} sources found", files.len());
    let module = |(path, text): (String, String)| (module_place(&path), text);
    Sources::of(&files.into_iter().map(module).collect::<Vec<_>>())
}

/// Files that are too long.
fn too_long(files: &[(String, String)]) -> Vec<String> {
    let length = |(path, text): &(String, String)| (path.clone(), text.lines().count());
    let long = files
        .iter()
        .map(length)
        .filter(|(_, lines)| *lines > MAX_FILE_LINES);
    long.map(|(path, lines)| format!("{path} has {lines} lines"))
        .collect()
}

#[test]
fn measure_is_pure() {
    let found = sources().impure();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn the_stages_of_detection_name_only_those_below() {
    let found = sources().stages();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn no_imports_of_a_folder_run_in_a_circle() {
    let circles = sources().circles();
    let words = circles
        .iter()
        .map(|(folder, imports)| format!("{folder}:\n  {}", imports.join("\n  ")));
    assert!(
        circles.is_empty(),
        "{}",
        words.collect::<Vec<_>>().join("\n")
    );
}

#[test]
fn no_file_is_too_long() {
    let found = too_long(&product_files());
    assert!(found.is_empty(), "{}", found.join("\n"));
    let file = |lines: usize| vec![("a.rs".to_owned(), "//\n".repeat(lines))];
    assert_eq!(too_long(&file(500)), [""; 0]);
    assert_eq!(too_long(&file(501)), ["a.rs has 501 lines"]);
}

/// Modules by their paths, with their texts.
fn drawn(texts: &[(&str, &str)]) -> Sources {
    Sources::of(
        &texts
            .iter()
            .map(|(path, text)| (place(path), (*text).to_owned()))
            .collect::<Vec<_>>(),
    )
}

#[test]
fn the_checks_of_purity_and_stages_see_a_breach() {
    let impure = |own: &str, text: &str| drawn(&[(own, text)]).impure().len();
    assert_eq!(impure("measure", "use std::{fs, io};"), 1);
    let clock = "fn f() { std::time::Instant::now(); }";
    assert_eq!(impure("measure::a", clock), 1);
    assert_eq!(impure("wingd::cli", clock), 0);
    let stages = |own: &str, text: &str| drawn(&[(own, text)]).stages();
    let up = stages(
        "measure::detect::simd::a",
        "use crate::detect::image::b::B;",
    );
    assert_eq!(
        up,
        ["measure::detect::simd::a names measure::detect::image::b::B"]
    );
    assert_eq!(
        stages(
            "measure::detect::simd::a",
            "fn f() { super::super::search::g(); }"
        )
        .len(),
        1
    );
    assert_eq!(
        stages(
            "measure::detect::image::b",
            "use super::super::simd::A; use super::c;"
        )
        .len(),
        0
    );
    assert_eq!(
        stages(
            "measure::detect::image",
            "#[cfg(test)] mod tests { use super::super::search; }"
        )
        .len(),
        0
    );
}

#[test]
fn the_check_of_circles_sees_one_at_every_depth_and_through_what_is_lent_out() {
    let circles = |texts: &[(&str, &str)]| drawn(texts).circles().into_keys().collect::<Vec<_>>();
    let down = [
        ("a::b", "use super::c::C;"),
        ("a::c", "use super::d;"),
        ("a::d", ""),
    ];
    assert_eq!(circles(&down), [""; 0]);
    let round = [
        ("a::b", "use super::c::C;"),
        ("a::c", "use super::d;"),
        ("a::d", "fn f() { super::b::g() }"),
    ];
    assert_eq!(circles(&round), ["a"]);
    assert_eq!(drawn(&round).circles()["a"].len(), 3);
    // A folder is one file, with the file of its name.
    let folder = [
        ("a::b", "use super::c::C;"),
        ("a::c", ""),
        ("a::c::d", "use crate::b;"),
    ];
    assert_eq!(circles(&folder), ["a"]);
    let deep = [
        ("a::b::c", "use super::d;"),
        ("a::b::d", "use super::{c, e::E};"),
        ("a::b::e", ""),
    ];
    assert_eq!(circles(&deep), ["a/b"]);
    // What the folder's own file lends out, under another name, too.
    let lent = [
        ("a", "mod b; mod c; pub use b::X as Y;"),
        ("a::b", "use super::c;"),
        ("a::c", "use super::Y;"),
    ];
    assert_eq!(circles(&lent), ["a"]);
    let own = [
        ("a", "mod b; fn f() { b::g() } pub struct X;"),
        ("a::b", "use super::X;"),
    ];
    assert_eq!(circles(&own), [""; 0]);
    assert_eq!(
        circles(&[("a::x", "use crate::y::Y;"), ("a::y", "use crate::x;")]),
        ["a"]
    );
}
