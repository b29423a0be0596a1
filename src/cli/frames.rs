//! Image files of a command line: read and worked on in parallel, answered in the order given.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::Failure;
use crate::pipeline::guard::guarded;

/// Of a picture at which the program itself failed.
const BROKE_OFF: &str =
    "the program broke off at this picture, which is its own fault; report it with the picture";

/// A progress bar on standard error; silent where that is not a terminal.
pub fn progress(total: usize, what: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg} [{bar:30}] {pos}/{len} {eta}");
    let bar = indicatif::ProgressBar::new(total as u64).with_message(what.to_owned());
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()));
    bar
}

/// Runs `work` over the files, `jobs` at a time (0: the cores); results in the files' order. A file
/// that cannot be read reaches `work` as the reason, a sentence with the mend.
pub fn map<T: Send>(
    files: &[PathBuf],
    jobs: usize,
    what: &str,
    work: impl Fn(&str, Result<&[u8], String>) -> T + Sync,
) -> Result<Vec<T>, Failure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    let pool =
        pool.map_err(|e| Failure::Undone(format!("cannot start {jobs} jobs: {e}; use fewer --jobs")))?;
    let bar = progress(files.len(), what);
    let one = |file: &PathBuf| {
        let bytes = std::fs::read(file);
        let readable =
            bytes.as_deref().map_err(|e| format!("{} cannot be read ({e}); check the path", file.display()));
        let name = name(file);
        let result = guarded(|| work(&name, readable)).unwrap_or_else(|| work(&name, Err(BROKE_OFF.into())));
        bar.inc(1);
        result
    };
    let results = pool.install(|| files.par_iter().map(one).collect());
    bar.finish_and_clear();
    Ok(results)
}

/// The file's name as it stands in results.
pub fn name(file: &Path) -> String {
    file.file_name().map_or_else(|| file.display().to_string(), |n| n.to_string_lossy().into_owned())
}
