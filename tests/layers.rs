//! The layers of `src/lib.rs` hold: no `use` points up or sideways, and `measure` stays pure.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};

use syn::visit::Visit;

/// Module -> layer; the table of `src/lib.rs`.
const LAYERS: [(&str, usize); 14] = [
    ("measure", 1),
    ("installation", 2),
    ("clock", 2),
    ("record", 2),
    ("aircraft", 3),
    ("camera", 4),
    ("store", 4),
    ("pipeline", 5),
    ("report", 6),
    ("daemon", 6),
    ("http", 7),
    ("upload", 7),
    ("config", 8),
    ("cli", 9),
];

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

fn layer(module: &str) -> Option<usize> {
    LAYERS.iter().find(|(name, _)| *name == module).map(|(_, layer)| *layer)
}

/// Every path that a file names, `use` trees flattened and inline paths too.
#[derive(Default)]
struct Paths(Vec<String>);

impl<'a> Visit<'a> for Paths {
    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        flatten(&item.tree, String::new(), &mut self.0);
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        let names: Vec<String> = path.segments.iter().map(|s| s.ident.to_string()).collect();
        self.0.push(names.join("::"));
        syn::visit::visit_path(self, path);
    }
}

fn flatten(tree: &syn::UseTree, prefix: String, into: &mut Vec<String>) {
    let join = |name: String| if prefix.is_empty() { name } else { format!("{prefix}::{name}") };
    match tree {
        syn::UseTree::Path(p) => flatten(&p.tree, join(p.ident.to_string()), into),
        syn::UseTree::Name(n) => into.push(join(n.ident.to_string())),
        syn::UseTree::Rename(r) => into.push(join(r.ident.to_string())),
        syn::UseTree::Glob(_) => into.push(prefix),
        syn::UseTree::Group(g) => g.items.iter().for_each(|t| flatten(t, prefix.clone(), into)),
    }
}

/// The faults of one file: (path named, why not).
fn faults(module: &str, source: &str) -> Vec<(String, &'static str)> {
    let mut paths = Paths::default();
    paths.visit_file(&syn::parse_file(source).expect("source parses"));
    let own = layer(module).expect("module has a layer");
    let mut found = vec![];
    for path in paths.0 {
        let target = path.strip_prefix("crate::").and_then(|rest| rest.split("::").next());
        if let Some(target) = target.filter(|t| *t != module) {
            match layer(target) {
                Some(theirs) if theirs < own => {}
                Some(_) => found.push((path.clone(), "points up or sideways")),
                None => found.push((path.clone(), "names a module without a layer")),
            }
        }
        let hit = |root: &&str| path == **root || path.starts_with(&format!("{root}::"));
        if module == "measure" && IMPURE.iter().any(hit) {
            found.push((path, "is not pure"));
        }
    }
    found
}

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

/// The modules of detection that a file names, but for its tests, which may show what is above: paths below `detect`.
struct Named {
    own: Vec<String>,
    found: Vec<Vec<String>>,
}

impl Named {
    fn add(&mut self, path: &str) {
        let path = path.strip_prefix("crate::measure::detect::").map(str::to_owned).or_else(|| {
            let (mut rest, mut up) = (path, 0);
            while let Some(shorter) = rest.strip_prefix("super::") {
                (rest, up) = (shorter, up + 1);
            }
            let parents = self.own.get(..self.own.len().checked_sub(up)?)?;
            (up > 0).then(|| parents.iter().map(String::as_str).chain([rest]).collect::<Vec<_>>().join("::"))
        });
        self.found.extend(path.map(|path| path.split("::").map(str::to_owned).collect()));
    }
}

impl<'a> Visit<'a> for Named {
    fn visit_item_mod(&mut self, _: &'a syn::ItemMod) {}

    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        let mut paths = vec![];
        flatten(&item.tree, String::new(), &mut paths);
        paths.iter().for_each(|path| self.add(path));
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        let names: Vec<String> = path.segments.iter().map(|s| s.ident.to_string()).collect();
        self.add(&names.join("::"));
        syn::visit::visit_path(self, path);
    }
}

/// The files of detection, as paths of modules, each with those that it names; and what names a stage above its own.
fn stages(files: &[(Vec<String>, String)]) -> (Vec<Vec<usize>>, Vec<String>) {
    let stage =
        |path: &[String]| STAGES.iter().position(|stage| Some(*stage) == path.first().map(String::as_str));
    let (mut uses, mut found) = (vec![], vec![]);
    for (own, source) in files {
        let mut named = Named { own: own.clone(), found: vec![] };
        named.visit_file(&syn::parse_file(source).expect("source parses"));
        for path in &named.found {
            let down = stage(path).zip(stage(own)).is_some_and(|(theirs, own)| theirs <= own);
            if !down {
                found.push(format!("{} names {}", own.join("::"), path.join("::")));
            }
        }
        // The longest path of a file that begins what is named.
        let file = |path: &Vec<String>| {
            let begins = |(_, (file, _)): &(usize, &(Vec<String>, String))| path.starts_with(file);
            files.iter().enumerate().filter(begins).max_by_key(|(_, (file, _))| file.len()).map(|(i, _)| i)
        };
        uses.push(named.found.iter().filter_map(file).collect());
    }
    (uses, found)
}

/// A circle of imports, if there is one: each file names the next one, the last the first.
fn circle(uses: &[Vec<usize>]) -> Option<Vec<usize>> {
    fn walk(i: usize, uses: &[Vec<usize>], way: &mut Vec<usize>, done: &mut [bool]) -> Option<Vec<usize>> {
        if let Some(first) = way.iter().position(|k| *k == i) {
            return Some(way[first..].to_vec());
        }
        if done[i] {
            return None;
        }
        way.push(i);
        let found = uses[i].iter().filter(|k| **k != i).find_map(|k| walk(*k, uses, way, done));
        way.pop();
        done[i] = true;
        found
    }
    let mut done = vec![false; uses.len()];
    (0..uses.len()).find_map(|i| walk(i, uses, &mut vec![], &mut done))
}

#[test]
fn the_stages_of_detection_name_only_those_below_and_no_imports_run_in_a_circle() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/measure/detect");
    let mut paths = vec![];
    sources(&root, &mut paths);
    let file = |path: PathBuf| {
        let inside = path.strip_prefix(&root).unwrap().with_extension("");
        let names = inside.components().map(|c| c.as_os_str().to_string_lossy().into_owned());
        let names = names.filter(|name| name != "mod").collect::<Vec<_>>();
        (names, std::fs::read_to_string(&path).unwrap())
    };
    // The topmost one is above them all.
    let files: Vec<_> = paths.into_iter().map(file).filter(|(names, _)| !names.is_empty()).collect();
    assert!(files.len() > 40, "only {} sources found", files.len());
    let (uses, found) = stages(&files);
    assert!(found.is_empty(), "{}", found.join("\n"));
    let circle = circle(&uses).map(|way| way.iter().map(|i| files[*i].0.join("::")).collect::<Vec<_>>());
    assert_eq!(circle, None);
}

#[test]
fn the_check_of_the_stages_sees_a_breach() {
    let file = |path: &str, source: &str| (path.split("::").map(str::to_owned).collect(), source.to_owned());
    let up = [file("simd::a", "use crate::measure::detect::image::b::B;"), file("image::b", "")];
    assert_eq!(stages(&up).1, ["simd::a names image::b::B"]);
    assert_eq!(stages(&[file("simd::a", "fn f() { super::super::search::g(); }")]).1.len(), 1);
    let round = [file("image::a", "use super::b::B;"), file("image::b", "use super::a;")];
    let (uses, found) = stages(&round);
    assert_eq!((found.len(), circle(&uses)), (0, Some(vec![0, 1])));
    let down = [file("image::b", "use crate::measure::detect::simd::a::A;"), file("simd::a", "")];
    let (uses, found) = stages(&down);
    assert_eq!((found.len(), circle(&uses)), (0, None));
}

fn sources(directory: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

#[test]
fn no_import_points_up_and_measure_is_pure() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = vec![];
    sources(&root, &mut files);
    assert!(files.len() > 20, "only {} sources found", files.len());
    let mut found = vec![];
    for file in files {
        let inside = file.strip_prefix(&root).unwrap();
        let first = inside.components().next().unwrap().as_os_str().to_string_lossy().into_owned();
        let module = first.trim_end_matches(".rs");
        if module == "lib" || module == "main" {
            continue;
        }
        let source = std::fs::read_to_string(&file).unwrap();
        found.extend(
            faults(module, &source).into_iter().map(|f| format!("{}: {} {}", inside.display(), f.0, f.1)),
        );
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn the_check_sees_a_breach() {
    assert_eq!(faults("store", "use crate::{daemon::X, measure::Y};").len(), 1);
    assert_eq!(faults("store", "fn f() { crate::camera::open(); }").len(), 1);
    assert_eq!(faults("measure", "use std::{fs, io};").len(), 1);
    assert_eq!(faults("measure", "fn f() { std::time::Instant::now(); }").len(), 1);
    assert!(faults("cli", "use crate::daemon::run; use std::fs;").is_empty());
}
