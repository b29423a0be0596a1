//! Parallel processing of images in the order given, with progress on standard error.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use super::stopping::{is_stopped, watch_signals};
use crate::inputs::image_files;
use crate::inputs::image_files::ImageCollection;
use crate::inputs::image_names::image_names;
use crate::inputs::image_times::DatingOptions;
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::record::Reason;
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::output::{print_notes, progress_bar};
use wingd_base::text::printable_path;
use wingd_store as store;
use wingd_store::{FrameRef, RealDisk};

/// Maximum number of jobs per core: more only take memory.
const MAX_JOBS_PER_CORE: usize = 4;
/// Interval between checks for a request to stop.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Runs `work` on the files, `jobs` at a time (0: number of cores), and passes each result to `take` as soon as it and those
/// before it are done. If a file cannot be read, `work` receives the reason, a sentence with the remedy. An error of `take`
/// ends the run.
pub fn for_each_image<T: Send>(
    files: &[PathBuf],
    jobs: usize,
    what: &str,
    work: impl Fn(&str, Result<&[u8], Reason>) -> T + Sync,
    take: impl FnMut(T) -> TaskResult<()>,
) -> TaskResult<()> {
    let names = image_names(files);
    let inputs: Vec<(&PathBuf, &String)> = files.iter().zip(&names).collect();
    let one = |(file, name): &(&PathBuf, &String)| {
        let text = |e: &std::io::Error| {
            format!(
                "{} cannot be read ({e}); check the path",
                printable_path(file)
            )
        };
        let bytes = wingd_base::regular_file::read_regular_file(
            file,
            wingd_base::regular_file::MAX_DATA_BYTES,
        )
        .map_err(|e| Reason::new(text(&e), e));
        catch_or_fail(bytes, |bytes| work(name, bytes))
    };
    run_jobs(&inputs, jobs, what, one, take)
}

/// Runs `work` on frames of a store, like [`for_each_image`]; each frame is verified against its digest.
pub fn for_each_stored_frame<T: Send>(
    frames: &[FrameRef],
    jobs: usize,
    what: &str,
    work: impl Fn(&FrameRef, Result<&[u8], Reason>) -> T + Sync,
    take: impl FnMut(T) -> TaskResult<()>,
) -> TaskResult<()> {
    let one = |frame: &FrameRef| {
        let bytes = store::read_frame(&RealDisk, frame).map_err(Reason::from_error);
        catch_or_fail(bytes, |bytes| work(frame, bytes))
    };
    run_jobs(frames, jobs, what, one, take)
}

/// Replaces each folder among the arguments by the images in it, and prints notes on the others.
pub fn expand_folders(arguments: &[PathBuf]) -> TaskResult<Vec<PathBuf>> {
    image_files::expand_folders(arguments, |note| print_notes([note]))
}

/// Reads and dates images and splits them into series.
pub fn read_collection(files: &[PathBuf], dating: &DatingOptions) -> TaskResult<ImageCollection> {
    let mut images = Vec::with_capacity(files.len());
    run_jobs(
        files,
        0,
        "reading",
        |file| (file.clone(), image_files::read_image(file)),
        collect_into(&mut images),
    )?;
    ImageCollection::from_images(images, dating)
}

/// Returns a `take` that keeps all results.
pub fn collect_into<T>(results: &mut Vec<T>) -> impl FnMut(T) -> TaskResult<()> {
    |result| {
        results.push(result);
        Ok(())
    }
}

/// Runs `work` on the bytes of an image; if it panics, on the reason.
fn catch_or_fail<T>(
    bytes: Result<Vec<u8>, Reason>,
    work: impl Fn(Result<&[u8], Reason>) -> T,
) -> T {
    let readable = bytes.as_deref().map_err(Clone::clone);
    catch_panic(|| work(readable)).unwrap_or_else(|| work(Err(PANIC_REASON.into())))
}

/// Runs `work` on any inputs, each on a thread of the pool; `work` must not panic.
pub fn run_jobs<I: Sync, T: Send>(
    inputs: &[I],
    jobs: usize,
    what: &str,
    work: impl Fn(&I) -> T + Sync,
    mut take: impl FnMut(T) -> TaskResult<()>,
) -> TaskResult<()> {
    let jobs = job_count(jobs, inputs.len());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    let pool = pool
        .map_err(|e| Failure::Failed(format!("cannot start {jobs} jobs: {e}; use fewer --jobs")))?;
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
        watch_signals();
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
            if is_stopped() {
                ended.store(true, Ordering::Relaxed);
                let n = inputs.len();
                return Err(Failure::Failed(format!(
                    "stopped: {next} of {n} images were processed; everything written so far is complete"
                )));
            }
        }
        Ok(())
    });
    bar.finish_and_clear();
    outcome
}

/// Limits the number of parallel jobs: at most one per file and [`MAX_JOBS_PER_CORE`] per core.
fn job_count(jobs: usize, files: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let wanted = if jobs == 0 { cores } else { jobs };
    wanted.min(MAX_JOBS_PER_CORE * cores).min(files).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

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
                if k == 12 {
                    Err(Failure::Failed("full".into()))
                } else {
                    Ok(())
                }
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
        let mut results = vec![];
        assert!(for_each_image(&files, 3, "", work, collect_into(&mut results)).is_ok());
        let there: Vec<bool> = results.iter().map(Option::is_some).collect();
        assert_eq!(there, [true, true, true, false, true]);
    }

    #[test]
    fn jobs_are_limited_by_files_and_per_core() {
        assert_eq!(job_count(1_000_000, 3), 3);
        assert!(
            job_count(1_000_000, 1_000_000)
                <= 4 * std::thread::available_parallelism().map_or(1, usize::from)
        );
        assert_eq!(job_count(0, 0), 1);
    }
}
