//! Names of image files in results.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use wingd_base::text::printable_path;

/// Returns the name of a file as used in results; bytes that are not UTF-8 are written as `\xfc`.
pub fn image_name(file: &Path) -> String {
    file.file_name()
        .map_or_else(|| printable_path(file), printable_path)
}

/// Returns the names of files as used in results: each with the shortest part of its path that makes it unique.
pub fn image_names(files: &[PathBuf]) -> Vec<String> {
    let mut taken: BTreeMap<&Path, usize> = files.iter().map(|f| (f.as_path(), 1)).collect();
    loop {
        let mut like: BTreeMap<String, Vec<&Path>> = BTreeMap::new();
        taken
            .iter()
            .for_each(|(file, parts)| like.entry(path_tail(file, *parts)).or_default().push(file));
        let alike = like.into_values().filter(|l| l.len() > 1).flatten();
        let longer: Vec<&Path> = alike
            .filter(|f| taken[f] < f.components().count())
            .collect();
        if longer.is_empty() {
            return files
                .iter()
                .map(|f| path_tail(f, taken[f.as_path()]))
                .collect();
        }
        longer
            .into_iter()
            .for_each(|f| *taken.entry(f).or_default() += 1);
    }
}

/// Returns the last components of a path.
fn path_tail(file: &Path, parts: usize) -> String {
    if parts == 1 {
        return image_name(file);
    }
    let all: Vec<Component> = file.components().collect();
    let last: PathBuf = all[all.len().saturating_sub(parts)..].iter().collect();
    printable_path(&last)
}

#[cfg(test)]
mod tests {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    use super::*;

    #[test]
    fn names_include_as_much_of_the_path_as_needed() {
        let of = |files: &[&str]| image_names(&files.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(of(&["/x/a/1.jpg", "/x/a/2.jpg"]), ["1.jpg", "2.jpg"]);
        assert_eq!(
            of(&["/x/a/1.jpg", "/x/b/1.jpg", "/x/b/2.jpg"]),
            ["a/1.jpg", "b/1.jpg", "2.jpg"]
        );
        assert_eq!(of(&["a/c/1.jpg", "b/c/1.jpg"]), ["a/c/1.jpg", "b/c/1.jpg"]);
        assert_eq!(
            of(&["1.jpg", "1.jpg"]),
            ["1.jpg", "1.jpg"],
            "one file twice"
        );
        assert_eq!(of(&["1.jpg", "b/1.jpg"]), ["1.jpg", "b/1.jpg"]);
    }

    #[test]
    fn names_that_are_not_utf8_stay_distinct() {
        let of = |bytes: &[u8]| PathBuf::from(OsStr::from_bytes(bytes));
        let files = [
            of(b"/x/fl\xfcgel.jpg"),
            of(b"/x/fl\xe4gel.jpg"),
            of("/x/fl\u{fc}gel.jpg".as_bytes()),
        ];
        assert_eq!(
            image_names(&files),
            ["fl\\xfcgel.jpg", "fl\\xe4gel.jpg", "fl\u{fc}gel.jpg"]
        );
        assert_eq!(
            image_names(&[of(b"a/\xfc/1.jpg"), of(b"a/\xe4/1.jpg")]),
            ["\\xfc/1.jpg", "\\xe4/1.jpg"]
        );
    }
}
