//! The layers of `src/lib.rs` hold: no `use` points up or sideways, and `measure` stays pure.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};

use syn::visit::Visit;

/// Module -> layer; the table of `src/lib.rs`.
const LAYERS: [(&str, usize); 13] = [
    ("measure", 1),
    ("installation", 2),
    ("clock", 2),
    ("record", 2),
    ("camera", 3),
    ("store", 3),
    ("pipeline", 4),
    ("report", 5),
    ("daemon", 5),
    ("http", 6),
    ("upload", 6),
    ("config", 7),
    ("cli", 8),
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
