//! Image files of a command line are read and worked on in parallel, and answered in the order given.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use super::{Failure, interrupt};
use crate::installation::shown_path;
use crate::pipeline::guard::{BROKE_OFF, guarded};
use crate::record::Reason;
use crate::store::FrameRef;

/// Jobs a core at most: more only take memory.
const JOBS_A_CORE: usize = 4;
/// How often a wish to stop is looked for.
const LOOK: Duration = Duration::from_millis(100);

/// A progress bar on standard error; silent where that is not a terminal.
pub fn progress(total: usize, what: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg} [{bar:30}] {pos}/{len} {eta}");
    let bar = indicatif::ProgressBar::new(total as u64).with_message(what.to_owned());
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()));
    bar
}

/// What takes its time, with the time it took so far, on standard error; gone when dropped. Silent where that is no
/// terminal.
#[must_use]
pub fn busy(what: &str) -> Busy {
    let style = indicatif::ProgressStyle::with_template("{msg} {elapsed}");
    let bar = indicatif::ProgressBar::new_spinner().with_message(what.to_owned());
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_spinner()));
    bar.enable_steady_tick(Duration::from_secs(1));
    Busy(bar)
}

/// See [`busy`].
pub struct Busy(indicatif::ProgressBar);

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// Runs `work` over the files, `jobs` at a time (0: the cores); results in the files' order. A file
/// that cannot be read reaches `work` as the reason, a sentence with the mend.
pub fn map<T: Send>(
    files: &[PathBuf],
    jobs: usize,
    what: &str,
    work: impl Fn(&str, Result<&[u8], Reason>) -> T + Sync,
) -> Result<Vec<T>, Failure> {
    let mut results = Vec::with_capacity(files.len());
    each(files, jobs, what, work, |result| {
        results.push(result);
        Ok(())
    })?;
    Ok(results)
}

/// The same, but each result goes to `take` as soon as it and those before it are there. An error of `take` ends it.
pub fn each<T: Send>(
    files: &[PathBuf],
    jobs: usize,
    what: &str,
    work: impl Fn(&str, Result<&[u8], Reason>) -> T + Sync,
    take: impl FnMut(T) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let names = names(files);
    let inputs: Vec<(&PathBuf, &String)> = files.iter().zip(&names).collect();
    run(&inputs, jobs, what, |(file, name)| one(file, name, &work), take)
}

/// Runs `work` over any inputs, each on a thread of the pool; it must not panic.
pub fn run<I: Sync, T: Send>(
    inputs: &[I],
    jobs: usize,
    what: &str,
    work: impl Fn(&I) -> T + Sync,
    mut take: impl FnMut(T) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let jobs = capped(jobs, inputs.len());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    let pool =
        pool.map_err(|e| Failure::Failed(format!("cannot start {jobs} jobs: {e}; use fewer --jobs")))?;
    let bar = progress(inputs.len(), what);
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
        let stopped = stopped();
        loop {
            match receiver.recv_timeout(LOOK) {
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
                return Err(Failure::Failed(format!(
                    "stopped: {next} of {n} pictures are done, the rest is not"
                )));
            }
        }
        Ok(())
    });
    bar.finish_and_clear();
    outcome
}

/// Set by Ctrl-C or SIGTERM, so that what is done is written; a second one ends the program at once.
fn stopped() -> Arc<AtomicBool> {
    let stopped = Arc::new(AtomicBool::new(false));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let (flag, runtime) = (stopped.clone(), runtime);
    std::thread::spawn(move || {
        let Ok(runtime) = runtime else { return };
        runtime.block_on(async {
            interrupt().await;
            flag.store(true, Ordering::Relaxed);
            interrupt().await;
            std::process::exit(1);
        });
    });
    stopped
}

/// Jobs that are worth their memory: no more than files, nor than some a core.
fn capped(jobs: usize, files: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let wanted = if jobs == 0 { cores } else { jobs };
    wanted.min(JOBS_A_CORE * cores).min(files).max(1)
}

/// Frames of a store in the same way: each is checked against its digest.
pub fn stored<T: Send>(
    store: &crate::store::Store,
    frames: &[FrameRef],
    jobs: usize,
    work: impl Fn(&FrameRef, Result<&[u8], Reason>) -> T + Sync,
    take: impl FnMut(T) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let one = |frame: &FrameRef| {
        let bytes = store.read_frame(frame).map_err(Reason::of);
        let readable = bytes.as_deref().map_err(Clone::clone);
        guarded(|| work(frame, readable)).unwrap_or_else(|| work(frame, Err(BROKE_OFF.into())))
    };
    run(frames, jobs, "solving", one, take)
}

fn one<T>(file: &Path, name: &str, work: &(impl Fn(&str, Result<&[u8], Reason>) -> T + Sync)) -> T {
    let text = |e: &std::io::Error| format!("{} cannot be read ({e}); check the path", shown_path(file));
    let bytes = std::fs::read(file).map_err(|e| Reason::new(text(&e), e));
    let readable = bytes.as_deref().map_err(Clone::clone);
    guarded(|| work(name, readable)).unwrap_or_else(|| work(name, Err(BROKE_OFF.into())))
}

/// The file's name as it stands in results; a byte that is no UTF-8 as `\xfc`.
pub fn name(file: &Path) -> String {
    file.file_name().map_or_else(|| shown_path(file), shown_path)
}

/// The files' names as they stand in results: each with as much of its path as tells it from the others.
pub(super) fn names(files: &[PathBuf]) -> Vec<String> {
    let mut taken: BTreeMap<&Path, usize> = files.iter().map(|f| (f.as_path(), 1)).collect();
    loop {
        let mut like: BTreeMap<String, Vec<&Path>> = BTreeMap::new();
        taken.iter().for_each(|(file, parts)| like.entry(tail(file, *parts)).or_default().push(file));
        let alike = like.into_values().filter(|l| l.len() > 1).flatten();
        let longer: Vec<&Path> = alike.filter(|f| taken[f] < f.components().count()).collect();
        if longer.is_empty() {
            return files.iter().map(|f| tail(f, taken[f.as_path()])).collect();
        }
        longer.into_iter().for_each(|f| *taken.entry(f).or_default() += 1);
    }
}

/// The last parts of a path.
fn tail(file: &Path, parts: usize) -> String {
    if parts == 1 {
        return name(file);
    }
    let all: Vec<Component> = file.components().collect();
    let last: PathBuf = all[all.len().saturating_sub(parts)..].iter().collect();
    shown_path(&last)
}

#[cfg(test)]
mod tests {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    use super::*;

    #[test]
    fn names_have_as_much_of_the_path_as_it_takes() {
        let of = |files: &[&str]| names(&files.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(of(&["/x/a/1.jpg", "/x/a/2.jpg"]), ["1.jpg", "2.jpg"]);
        assert_eq!(of(&["/x/a/1.jpg", "/x/b/1.jpg", "/x/b/2.jpg"]), ["a/1.jpg", "b/1.jpg", "2.jpg"]);
        assert_eq!(of(&["a/c/1.jpg", "b/c/1.jpg"]), ["a/c/1.jpg", "b/c/1.jpg"]);
        assert_eq!(of(&["1.jpg", "1.jpg"]), ["1.jpg", "1.jpg"], "one file twice");
        assert_eq!(of(&["1.jpg", "b/1.jpg"]), ["1.jpg", "b/1.jpg"]);
    }

    #[test]
    fn names_that_are_no_utf8_stay_two() {
        let of = |bytes: &[u8]| PathBuf::from(OsStr::from_bytes(bytes));
        let files = [of(b"/x/fl\xfcgel.jpg"), of(b"/x/fl\xe4gel.jpg"), of("/x/fl\u{fc}gel.jpg".as_bytes())];
        assert_eq!(names(&files), ["fl\\xfcgel.jpg", "fl\\xe4gel.jpg", "fl\u{fc}gel.jpg"]);
        assert_eq!(names(&[of(b"a/\xfc/1.jpg"), of(b"a/\xe4/1.jpg")]), ["\\xfc/1.jpg", "\\xe4/1.jpg"]);
    }

    #[test]
    fn results_come_in_order_and_as_they_are_done() {
        let files: Vec<PathBuf> = (0..20).map(|k| PathBuf::from(format!("{k}.jpg"))).collect();
        let number = |name: &str| name.trim_end_matches(".jpg").parse::<usize>().unwrap_or(99);
        let mut seen = vec![];
        let taken = each(
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
            Err(reason) if reason.text() == BROKE_OFF => None,
            _ if name == "3.jpg" => panic!("inside"),
            _ => Some(name.to_owned()),
        };
        let results = map(&files, 3, "", work).unwrap_or_default();
        let there: Vec<bool> = results.iter().map(Option::is_some).collect();
        assert_eq!(there, [true, true, true, false, true]);
    }

    #[test]
    fn jobs_are_no_more_than_files_and_some_a_core() {
        assert_eq!(capped(1_000_000, 3), 3);
        assert!(
            capped(1_000_000, 1_000_000) <= 4 * std::thread::available_parallelism().map_or(1, usize::from)
        );
        assert_eq!(capped(0, 0), 1);
    }
}
