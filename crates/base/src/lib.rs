//! Parts that every other crate shares: clock, faults of the user's files, text, files, output of commands.
//!
//! It knows nothing of wings, images and flights. `README.md` lists where to begin.

/// Prints a line to standard error. It replaces the macro of the standard library in all commands: no name from a file or a
/// server may control the terminal.
#[macro_export]
macro_rules! eprintln {
    ($($text:tt)*) => {
        std::eprintln!("{}", $crate::text::printable_text(&format!($($text)*)))
    };
}

/// Declares commands: the words of the list, the arguments, the function that runs them, the group, and examples. `[name]`
/// after a function names a value that all commands are given and this one takes. Their names are written here alone.
#[macro_export]
macro_rules! commands {
    (
        $list:ident($($value:ident: $kind:ty)?)
        $($(#[doc = $about:literal])+ $(#[cfg($built:meta)])? $(#[command($hidden:ident = true)])?
        $name:ident($args:ty) => $run:path $([$given:ident])?, $group:ident [$($example:literal),* $(,)?];)+
    ) => {
        // Only one value exists per run: its size does not matter.
        #[allow(clippy::large_enum_variant)]
        #[derive(clap::Subcommand)]
        /// Commands, each with its arguments.
        pub enum $list {
            $($(#[doc = $about])+ $(#[cfg($built)])? $(#[command($hidden = true)])? $name($args),)+
        }

        impl $list {
            /// Commands by group, with their examples.
            pub const LISTED: &'static [$crate::listed_command::ListedCommand] = &[
                $($(#[cfg($built)])? $crate::listed_command::ListedCommand {
                    identifier: stringify!($name),
                    group: $crate::listed_command::Group::$group,
                    examples: &[$($example),*],
                },)+
            ];

            /// Runs the command.
            pub fn run(&self $(, $value: $kind)?) -> $crate::failure::TaskResult<$crate::failure::Completion> {
                match self {
                    $($(#[cfg($built)])? Self::$name(args) => $run(args $(, $given)?),)+
                }
            }
        }
    };
}

pub mod clock;
pub mod failure;
pub mod fault;
pub mod listed_command;
pub mod logging;
pub mod output;
pub mod pending_file;
pub mod tcp_keepalive;
pub mod text;
pub mod toml_fault;
