//! Panic boundary around libraries: a panic costs one image.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

/// Reason for an image at which the program itself panicked.
pub const PANIC_REASON: &str =
    "the program failed at this image because of an internal error; report it with the image";

thread_local! {
    static INSIDE: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work` and returns its result; `None` if it panicked. The panic's message is not printed: the caller reports the
/// loss.
pub fn catch_panic<T>(work: impl FnOnce() -> T) -> Option<T> {
    silence_caught_panics();
    let outside = INSIDE.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    INSIDE.set(outside);
    result.ok()
}

/// Suppresses the process's panic message inside a boundary.
fn silence_caught_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let default_hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !INSIDE.get() {
                default_hook(panic);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_ends_at_the_boundary() {
        assert_eq!(catch_panic(|| 7), Some(7));
        assert_eq!(
            catch_panic(|| if INSIDE.get() {
                panic!("inside")
            }),
            None
        );
        assert!(!INSIDE.get());
        assert_eq!(
            catch_panic(|| catch_panic(|| if INSIDE.get() {
                panic!("deeper")
            })),
            Some(None)
        );
    }
}
