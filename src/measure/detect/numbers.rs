//! How tuned numbers are written: a constant by subject, each of its fields with meaning, unit and origin beside its value.
//!
//! They are constants and no parameters: no caller changes them, and loops keep them in registers.

/// Constants, each of a type of its own, whose fields stand with type and value.
macro_rules! numbers {
    ($(
        $(#[$doc:meta])*
        $name:ident: $group:ident { $($(#[$of_field:meta])* $field:ident: $kind:ty = $value:expr,)* }
    )*) => { $(
        $(#[$doc])*
        pub struct $group { $($(#[$of_field])* pub $field: $kind,)* }

        /// The numbers in use.
        pub const $name: $group = $group { $($field: $value,)* };
    )* };
}

/// Keeps divisors off zero and normal equations regular: far below what one pixel tells of anything.
pub const TINY: f64 = 1e-9;
