//! Definition of tuned numbers: one constant for each subject, whose fields have meaning, unit and origin next to their
//! value.
//!
//! They are constants and not parameters: no caller changes them, and loops keep them in registers.

use std::ops::{Add, Mul};

/// Defines constants, each with its own type, from fields with type and value.
macro_rules! numbers {
    ($(
        $(#[$doc:meta])*
        $name:ident: $group:ident { $($(#[$of_field:meta])* $field:ident: $kind:ty = $value:expr,)* }
    )*) => { $(
        $(#[$doc])*
        pub struct $group { $($(#[$of_field])* pub $field: $kind,)* }

        /// Values in use.
        pub const $name: $group = $group { $($field: $value,)* };
    )* };
}

/// Length that grows with a size or a blur.
pub struct GrowingLength<T = f64> {
    /// Growth with the size.
    pub factor: T,
    /// Length at size 0, px.
    pub px: T,
}

impl<T: Copy + Mul<Output = T> + Add<Output = T>> GrowingLength<T> {
    /// Returns the length at a size, px.
    pub fn at(&self, size: T) -> T {
        self.factor * size + self.px
    }
}

/// Standard deviations from which on a value is significant: for one unknown it changes the weighted sum of squares by 9.
pub const SIGNIFICANT_SIGMAS: f64 = 3.0;

/// Standard deviations beyond which a deviation is no chance, even among the pixels around a marker: 1 in 16,000.
pub const IMPROBABLE_SIGMAS: f64 = 4.0;

/// Smallest number of markers that say something about each other: with fewer, one piece of dirt decides.
pub const MIN_GROUP: usize = 4;

/// Smallest number of markers that predict another one or have a typical value: fewer may all be something else.
pub const MIN_TYPICAL: usize = 5;

/// Smallest divisor and diagonal of normal equations: far below the information of one pixel.
pub const TINY: f64 = 1e-9;
