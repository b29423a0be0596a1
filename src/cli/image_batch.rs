//! Parallel processing of image files in the order given, with progress on standard error.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use super::{Failure, stop_signal};
use crate::installation::printable_path;
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::record::Reason;
use crate::store::FrameRef;

/// Maximum number of jobs per core: more only take memory.
const MAX_JOBS_PER_CORE: usize = 4;
/// Interval between checks for a request to stop.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Creates a progress bar on standard error; invisible unless that is a terminal.
pub fn progress_bar(total: usize, what: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg} [{bar:30}] {pos}/{len} {eta}");
    let bar = indicatif::ProgressBar::new(total as u64).with_message(what.to_owned());
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()));
    bar
}

/// Shows a running task and its elapsed time on standard error until dropped; invisible unless that is a terminal.
#[must_use]
pub fn show_busy(what: &str) -> BusyIndicator {
    let style = indicatif::ProgressStyle::with_template("{msg} {elapsed}");
    let bar = indicatif::ProgressBar::new_spinner().with_message(what.to_owned());
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_spinner()));
    bar.enable_steady_tick(Duration::from_secs(1));
    BusyIndicator(bar)
}

/// Indicator of a running task, see [`show_busy`].
pub struct BusyIndicator(indicatif::ProgressBar);

impl Drop for BusyIndicator {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// Runs `work` on the files, `jobs` at a time (0: number of cores), and returns the results in the order of the files. If a
/// file cannot be read, `work` receives the reason, a sentence with the remedy.
pub fn process_images<T: Send>(
    files: &[PathBuf],
    jobs: usize,
    what: &str,
    work: impl Fn(&str, Result<&[u8], Reason>) -> T + Sync,
) -> Result<Vec<T>, Failure> {
    let mut results = Vec::with_capacity(files.len());
    for_each_image(files, jobs, what, work, |result| {
        results.push(result);
        Ok(())
    })?;
    Ok(results)
}

/// Runs `work` on the files and passes each result to `take` as soon as it and those before it are done. An error of `take`
/// ends the run.
pub fn for_each_image<T: Send>(
    files: &[PathBuf],
    jobs: usize,
    what: &str,
    work: impl Fn(&str, Result<&[u8], Reason>) -> T + Sync,
    take: impl FnMut(T) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let names = image_names(files);
    let inputs: Vec<(&PathBuf, &String)> = files.iter().zip(&names).collect();
    run_jobs(&inputs, jobs, what, |(file, name)| process_file(file, name, &work), take)
}

/// Runs `work` on any inputs, each on a thread of the pool; `work` must not panic.
pub fn run_jobs<I: Sync, T: Send>(
    inputs: &[I],
    jobs: usize,
    what: &str,
    work: impl Fn(&I) -> T + Sync,
    mut take: impl FnMut(T) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let jobs = job_count(jobs, inputs.len());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    let pool = pool.map_err(|e| Failure::Failed(format!("cannot start {jobs} jobs: {e}; use fewer --jobs")))?;
    let bar = progress_bar(inputs.len(), what);
    let ended = AtomicBool::new(false);
    let (sender, receiver) = mpsc::channel();
    let (work, ended_here) = (&work, &ended);
    let outcome = pool.in_place_scope_fifo(|scope| {
        for (k, input) in inputs.iter().enumerate() {
            let sender = sender.clone();
            scope.spawn_fifo(move |_| {
                if !ended_here.load(Ordering::Relaxed) {
                    let _ = sender.send((k, work(input)));
                }
            });
        }
        drop(sender);
        let (mut waiting, mut next) = (BTreeMap::new(), 0);
        let stopped = stop_flag();
        loop {
            match receiver.recv_timeout(POLL_INTERVAL) {
                Ok((k, result)) => waiting.insert(k, result),
                Err(RecvTimeoutError::Disconnected) => break,
                Err(RecvTimeoutError::Timeout) => None,
            };
            while let Some(result) = waiting.remove(&next) {
                next += 1;
                if let Err(failure) = bar.suspend(|| take(result)) {
                    ended.store(true, Ordering::Relaxed);
                    return Err(failure);
                }
                bar.inc(1);
            }
            if stopped.load(Ordering::Relaxed) {
                ended.store(true, Ordering::Relaxed);
                let n = inputs.len();
                return Err(Failure::Failed(format!("stopped: {next} of {n} images were processed")));
            }
        }
        Ok(())
    });
    bar.finish_and_clear();
    outcome
}

/// Returns a flag that Ctrl-C or SIGTERM sets, so that finished results are written; a second signal ends the program at
/// once.
fn stop_flag() -> Arc<AtomicBool> {
    let stopped = Arc::new(AtomicBool::new(false));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let (flag, runtime) = (stopped.clone(), runtime);
    std::thread::spawn(move || {
        let Ok(runtime) = runtime else { return };
        runtime.block_on(async {
            stop_signal().await;
            flag.store(true, Ordering::Relaxed);
            stop_signal().await;
            std::process::exit(1);
        });
    });
    stopped
}

/// Limits the number of parallel jobs: at most one per file and [`MAX_JOBS_PER_CORE`] per core.
fn job_count(jobs: usize, files: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let wanted = if jobs == 0 { cores } else { jobs };
    wanted.min(MAX_JOBS_PER_CORE * cores).min(files).max(1)
}

/// Runs `work` on frames of a store; each is verified against its digest.
pub fn for_each_stored_frame<T: Send>(
    store: &crate::store::Store,
    frames: &[FrameRef],
    jobs: usize,
    work: impl Fn(&FrameRef, Result<&[u8], Reason>) -> T + Sync,
    take: impl FnMut(T) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let one = |frame: &FrameRef| {
        let bytes = store.read_frame(frame).map_err(Reason::from_error);
        let readable = bytes.as_deref().map_err(Clone::clone);
        catch_panic(|| work(frame, readable)).unwrap_or_else(|| work(frame, Err(PANIC_REASON.into())))
    };
    run_jobs(frames, jobs, "solving", one, take)
}

fn process_file<T>(file: &Path, name: &str, work: &(impl Fn(&str, Result<&[u8], Reason>) -> T + Sync)) -> T {
    let text = |e: &std::io::Error| format!("{} cannot be read ({e}); check the path", printable_path(file));
    let bytes = crate::store::read_regular_file(file).map_err(|e| Reason::new(text(&e), e));
    let readable = bytes.as_deref().map_err(Clone::clone);
    catch_panic(|| work(name, readable)).unwrap_or_else(|| work(name, Err(PANIC_REASON.into())))
}

/// Returns the name of a file as used in results; bytes that are not UTF-8 are written as `\xfc`.
pub fn image_name(file: &Path) -> String {
    file.file_name().map_or_else(|| printable_path(file), printable_path)
}

/// Returns the names of files as used in results: each with the shortest part of its path that makes it unique.
pub(super) fn image_names(files: &[PathBuf]) -> Vec<String> {
    let mut taken: BTreeMap<&Path, usize> = files.iter().map(|f| (f.as_path(), 1)).collect();
    loop {
        let mut like: BTreeMap<String, Vec<&Path>> = BTreeMap::new();
        taken.iter().for_each(|(file, parts)| like.entry(path_tail(file, *parts)).or_default().push(file));
        let alike = like.into_values().filter(|l| l.len() > 1).flatten();
        let longer: Vec<&Path> = alike.filter(|f| taken[f] < f.components().count()).collect();
        if longer.is_empty() {
            return files.iter().map(|f| path_tail(f, taken[f.as_path()])).collect();
        }
        longer.into_iter().for_each(|f| *taken.entry(f).or_default() += 1);
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
        assert_eq!(of(&["/x/a/1.jpg", "/x/b/1.jpg", "/x/b/2.jpg"]), ["a/1.jpg", "b/1.jpg", "2.jpg"]);
        assert_eq!(of(&["a/c/1.jpg", "b/c/1.jpg"]), ["a/c/1.jpg", "b/c/1.jpg"]);
        assert_eq!(of(&["1.jpg", "1.jpg"]), ["1.jpg", "1.jpg"], "one file twice");
        assert_eq!(of(&["1.jpg", "b/1.jpg"]), ["1.jpg", "b/1.jpg"]);
    }

    #[test]
    fn names_that_are_not_utf8_stay_distinct() {
        let of = |bytes: &[u8]| PathBuf::from(OsStr::from_bytes(bytes));
        let files = [of(b"/x/fl\xfcgel.jpg"), of(b"/x/fl\xe4gel.jpg"), of("/x/fl\u{fc}gel.jpg".as_bytes())];
        assert_eq!(image_names(&files), ["fl\\xfcgel.jpg", "fl\\xe4gel.jpg", "fl\u{fc}gel.jpg"]);
        assert_eq!(image_names(&[of(b"a/\xfc/1.jpg"), of(b"a/\xe4/1.jpg")]), ["\\xfc/1.jpg", "\\xe4/1.jpg"]);
    }

    #[test]
    fn results_are_delivered_in_order_as_soon_as_they_are_done() {
        let files: Vec<PathBuf> = (0..20).map(|k| PathBuf::from(format!("{k}.jpg"))).collect();
        let number = |name: &str| name.trim_end_matches(".jpg").parse::<usize>().unwrap_or(99);
        let mut seen = vec![];
        let taken = for_each_image(
            &files,
            4,
            "",
            |name, _| number(name),
            |k| {
                seen.push(k);
                if k == 12 { Err(Failure::Failed("full".into())) } else { Ok(()) }
            },
        );
        assert!(matches!(taken, Err(Failure::Failed(_))));
        assert_eq!(seen, (0..13).collect::<Vec<_>>());
    }

    #[test]
    fn a_panic_costs_one_picture() {
        let files: Vec<PathBuf> = (0..5).map(|k| PathBuf::from(format!("{k}.jpg"))).collect();
        let work = |name: &str, bytes: Result<&[u8], Reason>| match bytes {
            Err(reason) if reason.text() == PANIC_REASON => None,
            _ if name == "3.jpg" => panic!("inside"),
            _ => Some(name.to_owned()),
        };
        let results = process_images(&files, 3, "", work).unwrap_or_default();
        let there: Vec<bool> = results.iter().map(Option::is_some).collect();
        assert_eq!(there, [true, true, true, false, true]);
    }

    #[test]
    fn jobs_are_limited_by_files_and_per_core() {
        assert_eq!(job_count(1_000_000, 3), 3);
        assert!(job_count(1_000_000, 1_000_000) <= 4 * std::thread::available_parallelism().map_or(1, usize::from));
        assert_eq!(job_count(0, 0), 1);
    }
}
