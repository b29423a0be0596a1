//! The structure of `src`, read from its sources.
//!
//! - The layers of `src/lib.rs`: no import points up or sideways, and `measure` touches no file, clock, network or log.
//! - The stages of detection: each uses only those below it.
//! - In every folder, at every depth, no imports of its files run in a circle. A folder in it counts as one file, with the
//!   file of its own name. What a folder's own file lends out by `use` counts as the file that it comes from.
//! - No file is longer than 400 lines, no function longer than 70; in `tests` and `benches` too.
//!
//! Each check is shown a breach, which it must see. Tests in the sources may name what they like.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use syn::visit::Visit;

#[path = "layers/language.rs"]
mod language;
#[path = "layers/named.rs"]
mod named;

#[path = "layers/texts.rs"]
mod texts;

use named::{Named, Place, place};

/// Module -> layer; the table of `src/lib.rs`.
const LAYERS: [(&str, usize); 17] = [
    ("measure", 1),
    ("installation", 2),
    ("clock", 2),
    ("record", 2),
    ("aircraft", 3),
    ("exchange", 3),
    ("camera", 4),
    ("store", 4),
    ("pipeline", 5),
    ("quantities", 6),
    ("report", 7),
    ("daemon", 7),
    ("http", 8),
    ("upload", 8),
    ("config", 9),
    ("desk", 10),
    ("cli", 11),
];

/// What `measure` may not touch.
const IMPURE: [&str; 9] =
    ["std::fs", "std::net", "std::time", "std::thread", "std::process", "std::env", "tokio", "tracing", "jiff"];

/// The stages of `src/measure/detect`, lowest first: each uses only those before it, and itself.
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

/// Lines of a file, and of a function from its first to its last, at most.
const MAX_FILE_LINES: usize = 400;
const MAX_FUNCTION_LINES: usize = 70;

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
            let mut named = Named { own: own.clone(), modules: &modules, written, places, taken, tests };
            named.visit_file(&syn::parse_file(text).expect("source parses"));
            let Named { written, places, taken, tests, .. } = named;
            all.insert(own.clone(), Read { written, places, taken });
            for_tests.extend(tests);
        }
        all.retain(|own, _| !for_tests.iter().any(|tests| own.starts_with(tests)));
        Self(all)
    }

    /// The module that something comes from: the longest beginning that is one, or whence that one has the name.
    fn origin(&self, named: &[String]) -> Place {
        let mut path = named.to_vec();
        for _ in 0..path.len() + 8 {
            let length = (0..=path.len()).rev().find(|k| self.0.contains_key(&path[..*k])).unwrap_or(0);
            let Some(name) = path.get(length) else { break };
            let lent = self.0.get(&path[..length]).and_then(|read| read.taken.get(name));
            match lent {
                Some(from) if *from != path[..=length] => path = [&from[..], &path[length + 1..]].concat(),
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
                    folders.entry(own[..depth].to_vec()).or_default().entry(pair).or_insert_with(words);
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
                    let there = names.keys().filter(|(one, _)| one == next).map(|(_, other)| other.as_str());
                    ahead.extend(there.filter(|other| seen.insert(*other)));
                }
                seen.contains(to)
            };
            let back = names.iter().filter(|((one, other), _)| reaches(other, one));
            back.map(|(_, words)| words.clone()).collect::<Vec<_>>()
        };
        let all = self.folders().into_iter().map(|(folder, names)| (folder.join("/"), in_circles(&names)));
        all.filter(|(_, circles)| !circles.is_empty()).collect()
    }

    /// What is named above the own layer, or sideways, and what of `measure` is not pure.
    fn above(&self) -> Vec<String> {
        let layer = |module: &String| LAYERS.iter().find(|(name, _)| name == module).map(|(_, layer)| *layer);
        let mut found = vec![];
        for (own, read) in &self.0 {
            let Some(module) = own.first() else { continue };
            let height = layer(module).unwrap_or_else(|| panic!("{module} has no layer"));
            let others = read.places.iter().filter_map(|p| p.first().filter(|other| *other != module));
            let up = others.filter(|other| layer(other).is_none_or(|theirs| theirs >= height));
            found.extend(up.map(|other| format!("{} names {other}, up or sideways", own.join("::"))));
            let hit = |path: &&String| IMPURE.iter().any(|root| place(path).starts_with(&place(root)));
            let impure = read.written.iter().filter(|path| module == "measure" && hit(path));
            found.extend(impure.map(|path| format!("{} names {path}, which is not pure", own.join("::"))));
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
        let inside = self.0.iter().filter(|(own, _)| own.len() > 2 && own.starts_with(&detect));
        let named = inside.flat_map(|(own, read)| read.places.iter().map(move |path| (own, path)));
        let own_files = named.filter(|(_, path)| path.len() > 2 && path.starts_with(&detect));
        let up = own_files.filter(|(own, path)| stage(path).is_none_or(|s| stage(own).is_none_or(|o| s > o)));
        up.map(|(own, path)| format!("{} names {}", own.join("::"), path.join("::"))).collect()
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
                let inside = path.strip_prefix(root).unwrap().to_string_lossy().into_owned();
                into.push((inside, read(&path)));
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut files = vec![];
    collect(&root, &root, &mut files);
    files
}

/// A source file, its paths as the whole program names them: within the package `measure` they begin at its own root.
fn read(file: &Path) -> String {
    let source = std::fs::read_to_string(file).unwrap();
    let measure = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/measure");
    if file.starts_with(measure) { source.replace("crate::", "crate::measure::") } else { source }
}

fn sources() -> Sources {
    let module = |(path, text): (String, String)| {
        let mut own = place(&path.trim_end_matches(".rs").replace('/', "::"));
        own.pop_if(|last| ["mod", "lib"].contains(&last.as_str()));
        (own, text)
    };
    let program = |(path, _): &(String, String)| path == "main.rs";
    let files = files("src");
    assert!(files.len() > 300, "only {} sources found", files.len());
    Sources::of(&files.into_iter().filter(|file| !program(file)).map(module).collect::<Vec<_>>())
}

/// Files and functions that are too long, by file. The sources are formatted: a function ends at the first brace that
/// stands as far in as it began.
fn too_long(files: &[(String, String)]) -> BTreeMap<String, Vec<String>> {
    let mut found = BTreeMap::<String, Vec<String>>::new();
    for (path, text) in files {
        let lines: Vec<&str> = text.lines().collect();
        let mut note = |what: String| found.entry(path.clone()).or_default().push(what);
        if lines.len() > MAX_FILE_LINES {
            note(format!("has {} lines", lines.len()));
        }
        for (first, line) in lines.iter().enumerate().filter(|(_, line)| begins_function(line)) {
            let indent = &line[..line.len() - line.trim_start().len()];
            let rest = lines[first..].iter().position(|line| *line == format!("{indent}}}"));
            let length = rest.map_or(0, |last| last + 1);
            if length > MAX_FUNCTION_LINES && !line.ends_with(['}', ';']) {
                note(format!("line {}: a function of {length} lines", first + 1));
            }
        }
    }
    found
}

fn begins_function(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let leads = |word: &&str| ["async", "const", "unsafe"].contains(word) || word.starts_with("pub");
    words.find(|word| !leads(word)) == Some("fn")
}

#[test]
fn no_import_points_up_and_measure_is_pure() {
    let found = sources().above();
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
    let words = circles.iter().map(|(folder, imports)| format!("src/{folder}:\n  {}", imports.join("\n  ")));
    assert!(circles.is_empty(), "{}", words.collect::<Vec<_>>().join("\n"));
}

#[test]
fn no_file_and_no_function_is_too_long() {
    let of = |folder: &&str| {
        let found = too_long(&files(folder));
        found.into_iter().map(|(file, what)| format!("{folder}/{file}: {}", what.join("; "))).collect::<Vec<_>>()
    };
    let found = ["src", "tests", "benches"].iter().flat_map(of).collect::<Vec<_>>();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Modules by their paths, with their texts.
fn drawn(texts: &[(&str, &str)]) -> Sources {
    Sources::of(&texts.iter().map(|(path, text)| (place(path), (*text).to_owned())).collect::<Vec<_>>())
}

#[test]
fn the_checks_of_layers_and_stages_see_a_breach() {
    let above = |own: &str, text: &str| drawn(&[(own, text)]).above().len();
    assert_eq!(above("store", "use crate::{daemon::X, measure::Y};"), 1);
    assert_eq!(above("store::a", "fn f() { crate::camera::open(); super::b(); }"), 1);
    assert_eq!(above("measure", "use std::{fs, io};"), 1);
    assert_eq!(above("measure", "fn f() { std::time::Instant::now(); }"), 1);
    assert_eq!(above("cli", "use crate::daemon::run; use std::fs;"), 0);
    let stages = |own: &str, text: &str| drawn(&[(own, text)]).stages();
    let up = stages("measure::detect::simd::a", "use crate::measure::detect::image::b::B;");
    assert_eq!(up, ["measure::detect::simd::a names measure::detect::image::b::B"]);
    assert_eq!(stages("measure::detect::simd::a", "fn f() { super::super::search::g(); }").len(), 1);
    assert_eq!(stages("measure::detect::image::b", "use super::super::simd::A; use super::c;").len(), 0);
    assert_eq!(stages("measure::detect::image", "#[cfg(test)] mod tests { use super::super::search; }").len(), 0);
}

#[test]
fn the_check_of_circles_sees_one_at_every_depth_and_through_what_is_lent_out() {
    let circles = |texts: &[(&str, &str)]| drawn(texts).circles().into_keys().collect::<Vec<_>>();
    let down = [("a::b", "use super::c::C;"), ("a::c", "use super::d;"), ("a::d", "")];
    assert_eq!(circles(&down), [""; 0]);
    let round = [("a::b", "use super::c::C;"), ("a::c", "use super::d;"), ("a::d", "fn f() { super::b::g() }")];
    assert_eq!(circles(&round), ["a"]);
    assert_eq!(drawn(&round).circles()["a"].len(), 3);
    // A folder is one file, with the file of its name.
    let folder = [("a::b", "use super::c::C;"), ("a::c", ""), ("a::c::d", "use crate::a::b;")];
    assert_eq!(circles(&folder), ["a"]);
    let deep = [("a::b::c", "use super::d;"), ("a::b::d", "use super::{c, e::E};"), ("a::b::e", "")];
    assert_eq!(circles(&deep), ["a/b"]);
    // What the folder's own file lends out, under another name, too.
    let lent = [("a", "mod b; mod c; pub use b::X as Y;"), ("a::b", "use super::c;"), ("a::c", "use super::Y;")];
    assert_eq!(circles(&lent), ["a"]);
    let own = [("a", "mod b; fn f() { b::g() } pub struct X;"), ("a::b", "use super::X;")];
    assert_eq!(circles(&own), [""; 0]);
    assert_eq!(circles(&[("x", "use crate::y::Y;"), ("y", "use crate::x;")]), [""]);
}

#[test]
fn the_check_of_length_sees_a_long_file_and_a_long_function() {
    let function = |lines: usize| format!("    pub async fn f(\n{}    }}\n", "        a();\n".repeat(lines - 2));
    let found = |text: String| too_long(&[("a.rs".to_owned(), text)]).remove("a.rs").unwrap_or_default();
    assert_eq!(found(function(70) + &function(70)), [""; 0]);
    assert_eq!(found(function(71)), ["line 1: a function of 71 lines"]);
    assert_eq!(found("//\n".repeat(401)), ["has 401 lines"]);
}
