//! Ctrl-C and SIGTERM in commands that take long: nothing stays half made, and the user reads what is kept.

use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::stop_signal;
use wingd_base::output::show_busy;

static IS_STOPPED: AtomicBool = AtomicBool::new(false);
/// Number of tasks that cannot end early.
static LONG_TASKS: AtomicUsize = AtomicUsize::new(0);
static LISTENER: Once = Once::new();

/// Returns whether a signal has asked the command to stop since [`watch_signals`], so that it writes its finished results and
/// ends. A second signal ends the program at once.
pub fn is_stopped() -> bool {
    IS_STOPPED.load(Ordering::Relaxed)
}

/// Runs a task that cannot end early, with its name and elapsed time on standard error. A signal ends the program.
pub fn run_long_task<T>(what: &str, task: impl FnOnce() -> T) -> T {
    watch_signals();
    LONG_TASKS.fetch_add(1, Ordering::Relaxed);
    let outcome = show_busy(what, task);
    LONG_TASKS.fetch_sub(1, Ordering::Relaxed);
    outcome
}

/// Begins to watch for signals; until then one ends the program without a word.
pub fn watch_signals() {
    let wait = async || {
        loop {
            stop_signal().await;
            let is_second = IS_STOPPED.swap(true, Ordering::Relaxed);
            if is_second || LONG_TASKS.load(Ordering::Relaxed) > 0 {
                eprintln!(
                    "wingd: stopped; finished files and results are kept, nothing else is written"
                );
                std::process::exit(1);
            }
        }
    };
    LISTENER.call_once(|| {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        std::thread::spawn(move || runtime.map(|runtime| runtime.block_on(wait())));
    });
}
