//! A boundary stands about libraries: should one panic, that costs one picture.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

/// Of a picture at which the program itself failed.
pub const BROKE_OFF: &str =
    "the program broke off at this picture, which is its own fault; report it with the picture";

thread_local! {
    static INSIDE: Cell<bool> = const { Cell::new(false) };
}

/// What `work` gives; `None` where it panicked. The panic's own message is not printed: the caller says what it cost.
pub fn guarded<T>(work: impl FnOnce() -> T) -> Option<T> {
    quiet_inside();
    let outside = INSIDE.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    INSIDE.set(outside);
    result.ok()
}

/// The process's message on a panic, but for those inside a boundary.
fn quiet_inside() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !INSIDE.get() {
                usual(panic);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_ends_at_the_boundary() {
        assert_eq!(guarded(|| 7), Some(7));
        assert_eq!(
            guarded(|| if INSIDE.get() {
                panic!("inside")
            }),
            None
        );
        assert!(!INSIDE.get());
        assert_eq!(
            guarded(|| guarded(|| if INSIDE.get() {
                panic!("deeper")
            })),
            Some(None)
        );
    }
}
