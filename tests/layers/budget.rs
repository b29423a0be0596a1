//! The size of the product: characters that are not blank in the Rust sources of `src` and `crates`, doc comments and unit
//! tests included. Each folder has a budget in `tests/layers/budget.csv` that commits only lower.
//!
//! Comments and unit tests pay for nothing: their proportion to the code does not fall.

use std::collections::BTreeMap;

/// Proportion of comments and of unit tests in the code, at least, of all folders together.
const MIN_COMMENTS: f64 = 0.293;
const MIN_UNIT_TESTS: f64 = 0.0995;

/// Non-blank characters of a text or folder, by purpose.
#[derive(Clone, Copy, Default)]
struct Size {
    code: usize,
    comments: usize,
    unit_tests: usize,
}

impl Size {
    fn total(self) -> usize {
        self.code + self.comments + self.unit_tests
    }

    fn add(&mut self, other: Self) {
        self.code += other.code;
        self.comments += other.comments;
        self.unit_tests += other.unit_tests;
    }
}

fn characters(line: &str) -> usize {
    line.chars().filter(|c| !c.is_whitespace()).count()
}

/// Size of a formatted source. A module of unit tests ends at the first brace that is indented as its attribute.
fn measure(text: &str, is_test: bool) -> Size {
    let mut size = Size::default();
    let mut end_of_tests: Option<String> = None;
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let count = characters(line);
        let bare = line.trim_start();
        if end_of_tests.is_none() && bare == "#[cfg(test)]" {
            let inline = lines.peek().is_some_and(|next| next.ends_with('{'));
            let indent = &line[..line.len() - bare.len()];
            end_of_tests = inline.then(|| format!("{indent}}}"));
        }
        if is_test || end_of_tests.is_some() {
            size.unit_tests += count;
        } else if bare.starts_with("//") {
            size.comments += count;
        } else {
            size.code += count;
        }
        end_of_tests.take_if(|end| line == end);
    }
    size
}

/// A crate of `crates` or `src`, and in it the first folder.
fn folder(path: &str) -> String {
    let parts: Vec<&str> = path.split('/').collect();
    let own = if parts[0] == "crates" { 3 } else { 1 };
    let folders = &parts[..parts.len() - 1];
    folders[..folders.len().min(own + 1)].join("/")
}

fn sizes() -> BTreeMap<String, Size> {
    let mut sizes = BTreeMap::<String, Size>::new();
    for (path, text) in crate::product_files() {
        let name = path.rsplit('/').next().unwrap_or_default();
        let is_test = name == "tests.rs" || path.contains("/tests/");
        let size = sizes.entry(folder(&path)).or_default();
        size.add(measure(&text, is_test));
    }
    sizes
}

fn budgets() -> BTreeMap<String, usize> {
    let row = |line: &str| {
        let (folder, kilo) = line.split_once(',').expect("folder,kilo_characters");
        let kilo: f64 = kilo.parse().expect("kilo_characters is a number");
        (folder.to_owned(), (kilo * 1000.0).round() as usize)
    };
    let table = include_str!("budget.csv");
    table.lines().skip(1).map(row).collect()
}

#[test]
fn each_folder_is_within_its_budget() {
    let (sizes, budgets) = (sizes(), budgets());
    let mut all = Size::default();
    let mut faults = vec![];
    println!(
        "folder: code, comments, unit tests, sum, budget (thousands of characters that are not blank)"
    );
    for (folder, size) in &sizes {
        all.add(*size);
        let budget = budgets.get(folder).copied().unwrap_or(0);
        let [code, comments, tests, sum, limit] = [
            size.code,
            size.comments,
            size.unit_tests,
            size.total(),
            budget,
        ]
        .map(|n| n as f64 / 1000.0);
        println!("{folder}: {code:.1}, {comments:.1}, {tests:.1}, {sum:.1}, {limit:.1}");
        if size.total() > budget {
            faults.push(format!("{folder} has {sum:.1} of {limit:.1}"));
        }
    }
    let gone = budgets.keys().filter(|folder| !sizes.contains_key(*folder));
    faults.extend(gone.map(|folder| format!("{folder} has a budget and no file")));
    let comments = all.comments as f64 / all.code as f64;
    let tests = all.unit_tests as f64 / all.code as f64;
    println!(
        "all: {} characters; comments {comments:.4}, unit tests {tests:.4} of the code",
        all.total()
    );
    if comments < MIN_COMMENTS || tests < MIN_UNIT_TESTS {
        faults.push(format!(
            "comments {comments:.4} (at least {MIN_COMMENTS}) or unit tests {tests:.4} (at least {MIN_UNIT_TESTS}) pay for code"
        ));
    }
    assert!(
        faults.is_empty(),
        "tests/layers/budget.csv:\n{}",
        faults.join("\n")
    );
}

#[test]
fn the_count_separates_code_comments_and_unit_tests() {
    let text = "//! Head.\nfn f() {\n    // why\n    a();\n}\n#[cfg(test)]\nmod tests {\n    fn g() {}\n}\nconst A: u8 = 1;\n";
    let size = measure(text, false);
    assert_eq!((size.comments, size.unit_tests), (13, 12 + 9 + 7 + 1));
    assert_eq!(size.code, 6 + 4 + 1 + 12);
    let size = measure("#[cfg(test)]\nmod tests;\nfn f() {}\n", false);
    assert_eq!((size.unit_tests, size.code), (0, 12 + 9 + 7));
    assert_eq!(folder("src/main.rs"), "src");
    assert_eq!(folder("src/daemon/live/mod.rs"), "src/daemon");
    assert_eq!(
        folder("crates/measure/src/detect/a.rs"),
        "crates/measure/src/detect"
    );
    assert_eq!(folder("crates/measure/src/lib.rs"), "crates/measure/src");
}
