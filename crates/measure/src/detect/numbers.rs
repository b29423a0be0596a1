//! Definition of tuned numbers: one constant for each subject, whose fields have meaning, unit and origin next to their
//! value.
//!
//! They are constants and not parameters: no caller changes them, and loops keep them in registers.

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

/// Smallest divisor and diagonal of normal equations: far below the information of one pixel.
pub const TINY: f64 = 1e-9;
